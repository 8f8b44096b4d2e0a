//! What the cases share: folders, figures, scores of one map.

use std::path::{Path, PathBuf};

use panoscope_imaging::View;
use panoscope_imaging::stereo::{BAD_PX, score_disparity};

use super::chains::{self, ChainOutput};
use super::data::Picture;
use super::edges::{edge_errors, near_edges};
use super::own_graph::OwnGraph;
use super::picture;
use crate::error::Result;
use crate::figures::Figure;
use crate::inputs::find;
use crate::session::{Session, note};

/// Distance to the true surface from which on points count alike.
pub const REACH_MM: f32 = 4.0;

/// What the cases share.
pub struct Judge<'a> {
    pub session: &'a dyn Session,
    /// Where data sets are searched.
    pub folders: Vec<PathBuf>,
    /// The user's graph.
    pub own: Option<OwnGraph>,
    /// Folder for pictures.
    pub pictures: Option<&'a Path>,
    pub figures: Vec<Figure>,
}

/// True disparity of a pair.
pub struct Truth {
    pub disparity: Vec<f32>,
    /// Pixels that count are not 0; all count without it.
    pub mask: Option<Vec<u8>>,
}

impl Judge<'_> {
    /// The file, or a line that says why the case is skipped.
    pub fn file(&self, case: &str, name: &str, help: &str) -> Option<PathBuf> {
        let found = find(&self.folders, name);
        if found.is_none() {
            note!(self.session, "skipped: {case}: there is no {name} in the data folders ({help})");
        }
        found
    }

    pub fn add(&mut self, name: String, value: f64, unit: &'static str, input: &str) {
        self.figures.push(Figure::new(&name, value, unit, input));
    }

    /// All chains on a pair, the user's graph last.
    pub fn run(&self, left: &Picture, right: &Picture, first_px: i32, search_px: usize) -> Result<Vec<ChainOutput>> {
        let mut all = chains::run(left, right, first_px, search_px)?;
        all.extend(self.own_graph(left, right)?);
        Ok(all)
    }

    /// The user's graph on a pair, if there is one.
    pub fn own_graph(&self, left: &Picture, right: &Picture) -> Result<Option<ChainOutput>> {
        let Some(own) = &self.own else { return Ok(None) };
        let (disparity, confidence) = own.disparity(self.session, left, right)?;
        let disparity_noise_px = own.disparity_noise_px;
        Ok(Some(ChainOutput { chain: "graph", disparity, confidence, disparity_noise_px }))
    }

    pub fn against(
        &mut self,
        case: &str,
        chain: &str,
        size: (usize, usize),
        found: &[f32],
        truth: &Truth,
        input: &str,
    ) -> Result<()> {
        let plane = |data| View::new(data, size.0, size.1, 1);
        let mask = truth.mask.as_ref().map(|mask| View::new(&mask[..], size.0, size.1, 1));
        let score = score_disparity(plane(found), plane(&truth.disparity), mask)?;
        for (limit_px, share) in BAD_PX.iter().zip(score.bad) {
            self.add(format!("bad{limit_px}/{case}/{chain}"), 100.0 * share, "%", input);
        }
        self.add(format!("bad2_of_known/{case}/{chain}"), 100.0 * score.bad_of_known[1], "%", input);
        self.add(format!("density/{case}/{chain}"), 100.0 * score.density, "%", input);
        self.add(format!("mean_error/{case}/{chain}"), score.mean_error_px, "px", input);
        let counts = |index: usize| truth.mask.as_ref().is_none_or(|mask| mask[index] != 0);
        let (sum, count) = edge_errors(&near_edges(&truth.disparity, size), found, &truth.disparity, counts);
        if count > 0 {
            self.add(format!("edge_error/{case}/{chain}"), sum / count as f64, "px", input);
        }
        if let Some(folder) = self.pictures {
            picture::map(&folder.join(format!("{case}_{chain}.png")), size, found)?;
            picture::errors(&folder.join(format!("{case}_{chain}_error.png")), size, found, &truth.disparity, counts)?;
        }
        Ok(())
    }

    pub fn pair(
        &mut self,
        case: &str,
        views: [&Picture; 2],
        first_px: i32,
        search_px: usize,
        truth: &Truth,
    ) -> Result<()> {
        let size = (views[0].width, views[0].height);
        let input = format!("{case} {}x{}, {search_px} disparities", size.0, size.1);
        for made in self.run(views[0], views[1], first_px, search_px)? {
            self.against(case, made.chain, size, &made.disparity, truth, &input)?;
        }
        Ok(())
    }

    /// Where no truth exists: how much is known, and how far both views agree.
    pub fn consistency(
        &mut self,
        picture: &str,
        case: &str,
        views: &[Picture; 2],
        first_px: i32,
        search_px: usize,
    ) -> Result<()> {
        let size = (views[0].width, views[0].height);
        let input = format!("{picture} {}x{}, {search_px} disparities, no truth", size.0, size.1);
        // The views swapped and mirrored give the right view's map by the same chain.
        let mirrored = |view: &Picture| {
            let flip = |row: &[u8]| row.chunks_exact(3).rev().flatten().copied().collect::<Vec<u8>>();
            Picture::new(size.0, size.1, view.bgr.chunks_exact(3 * size.0).flat_map(flip).collect())
        };
        let there = self.run(&views[0], &views[1], first_px, search_px)?;
        let back = self.run(&mirrored(&views[1]), &mirrored(&views[0]), first_px, search_px)?;
        for (made, other) in there.iter().zip(&back) {
            let (mut known, mut seen, mut apart) = (0usize, 0usize, 0usize);
            for (index, disparity) in made.disparity.iter().enumerate().filter(|(_, d)| d.is_finite()) {
                known += 1;
                let (x, y) = (index % size.0, index / size.0);
                let to = x as f32 - disparity;
                if to < 0.0 || to > (size.0 - 1) as f32 {
                    continue;
                }
                let column = size.0 - 1 - to.round() as usize;
                let answer = other.disparity[y * size.0 + column];
                if answer.is_finite() {
                    seen += 1;
                    apart += usize::from((answer - disparity).abs() > 1.0);
                }
            }
            let name = if picture == case { case.to_owned() } else { format!("{case}/{picture}") };
            let chain = made.chain;
            self.add(format!("density/{name}/{chain}"), 100.0 * known as f64 / (size.0 * size.1) as f64, "%", &input);
            self.add(
                format!("left_right_apart/{name}/{chain}"),
                100.0 * apart as f64 / seen.max(1) as f64,
                "%",
                &input,
            );
            if let Some(folder) = self.pictures {
                picture::map(&folder.join(format!("{picture}_{chain}.png")), size, &made.disparity)?;
            }
        }
        Ok(())
    }
}
