//! `panoscope eval disparity`: disparity maps beside true disparities and surfaces, and beside themselves.

mod chains;
mod data;
mod given;
mod liver;
mod outside;
pub mod phantom;
mod picture;
mod truth_files;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use panoscope_imaging::stereo::{
    Rectification, RectifyParams, RemapTable, ReprojectInput, ReprojectParams, StereoCameras, reproject,
    score_disparity,
};
use panoscope_imaging::{Rect, Serial, View, ViewMut};

use crate::commands::bench::record::Figure;
use crate::terminal::tell;
use data::Picture;
pub use data::find;

/// Arguments of `eval disparity`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Only these cases; may be given again. Without it all.
    #[arg(long, value_parser = CASES)]
    case: Vec<String>,
    /// Folder of data sets, searched before the usual ones. May be given again.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    #[command(flatten)]
    given: given::Given,
    /// Folder for pictures of disparities and errors.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

const CASES: [&str; 8] =
    ["truth", "range", "phantom", "aloe", "motorcycle", "synthetic_liver", "silicone_heart", "hamlyn"];

/// Distance to the true surface from which on points count alike.
const REACH_MM: f32 = 4.0;

/// Pairs of the Hamlyn sequence that are judged.
const HAMLYN: [&str; 5] = ["1", "251", "501", "751", "1001"];

/// What the cases share.
struct Judge<'a> {
    folders: Vec<PathBuf>,
    pictures: Option<&'a Path>,
    figures: Vec<Figure>,
}

/// Judges; `None` when the arguments are wrong.
pub fn judge(arguments: &Arguments) -> Result<Option<Vec<Figure>>> {
    let usual = ["target/data", "../shared/data/stereo", "/usr/share/doc/opencv-doc/examples/data"];
    let folders = arguments.data.iter().cloned().chain(usual.map(PathBuf::from)).collect();
    if let Some(folder) = &arguments.pictures {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    let mut judge = Judge { folders, pictures: arguments.pictures.as_deref(), figures: Vec::new() };
    if arguments.given.is_given() {
        judge.given(&arguments.given)?;
        return Ok(Some(judge.figures));
    }
    for case in CASES.iter().filter(|case| arguments.case.is_empty() || arguments.case.iter().any(|c| c == *case)) {
        if crate::interrupt::asked() {
            anyhow::bail!("interrupted");
        }
        match *case {
            "truth" => judge.outside()?,
            "range" => judge.range()?,
            "phantom" => judge.phantom()?,
            "aloe" => judge.aloe()?,
            "motorcycle" => judge.motorcycle()?,
            "synthetic_liver" => judge.liver()?,
            "silicone_heart" => judge.heart()?,
            _ => judge.hamlyn()?,
        }
    }
    Ok(Some(judge.figures))
}

/// True disparity of a pair.
struct Truth {
    disparity: Vec<f32>,
    mask: Option<Vec<u8>>,
}

impl Judge<'_> {
    /// The file, or a line that says what is left out.
    fn file(&self, case: &str, name: &str, mend: &str) -> Option<PathBuf> {
        let found = data::find(&self.folders, name);
        if found.is_none() {
            tell!("skipped: {case}: there is no {name} in the data folders ({mend})");
        }
        found
    }

    fn add(&mut self, name: String, value: f64, unit: &'static str, input: &str) {
        self.figures.push(Figure::new(&name, value, unit, input));
    }

    fn against(
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
        for (name, share) in ["bad1", "bad2", "bad4"].iter().zip(score.bad) {
            self.add(format!("{name}/{case}/{chain}"), 100.0 * share, "%", input);
        }
        self.add(format!("bad2_of_known/{case}/{chain}"), 100.0 * score.bad_of_known[1], "%", input);
        self.add(format!("density/{case}/{chain}"), 100.0 * score.density, "%", input);
        self.add(format!("mean_error/{case}/{chain}"), score.mean_error_px, "px", input);
        if let Some(folder) = self.pictures {
            let counts = |index: usize| truth.mask.as_ref().is_none_or(|mask| mask[index] != 0);
            picture::map(&folder.join(format!("{case}_{chain}.png")), size, found)?;
            picture::errors(&folder.join(format!("{case}_{chain}_error.png")), size, found, &truth.disparity, counts)?;
        }
        Ok(())
    }

    fn pair(&mut self, case: &str, views: [&Picture; 2], first_px: i32, search_px: usize, truth: &Truth) -> Result<()> {
        let size = (views[0].width, views[0].height);
        let input = format!("{case} {}x{}, {search_px} disparities", size.0, size.1);
        for made in chains::run(views[0], views[1], first_px, search_px)? {
            self.against(case, made.chain, size, &made.disparity, truth, &input)?;
        }
        Ok(())
    }

    fn aloe(&mut self) -> Result<()> {
        let Some(left) = self.file("aloe", "aloeL.jpg", "Debian package opencv-doc") else { return Ok(()) };
        let Some(truth) = self.file("aloe", "aloeGT.png", "Debian package opencv-doc") else { return Ok(()) };
        let views = [Picture::read(&left)?, Picture::read(&left.with_file_name("aloeR.jpg"))?];
        let known = |d: u8| if d == 0 { f32::NAN } else { f32::from(d) };
        let disparity = data::gray(&truth)?.into_iter().map(known).collect();
        self.pair("aloe", [&views[0], &views[1]], 0, 256, &Truth { disparity, mask: None })
    }

    fn motorcycle(&mut self) -> Result<()> {
        let Some(truth) = self.file("motorcycle", "motorcycle/motorcycle_disp.npz", "cargo xtask data") else {
            return Ok(());
        };
        let read = |name: &str| Picture::read(&truth.with_file_name(name));
        let views = [read("motorcycle_left.png")?, read("motorcycle_right.png")?];
        let truth = data::npz(&truth)?;
        anyhow::ensure!((truth.width, truth.height) == (views[0].width, views[0].height), "motorcycle: sizes differ");
        let known = |d: f32| if d > 0.0 { d } else { f32::NAN };
        let disparity = truth.data.into_iter().map(known).collect();
        self.pair("motorcycle", [&views[0], &views[1]], 0, 96, &Truth { disparity, mask: None })
    }

    fn heart(&mut self) -> Result<()> {
        let Some(left) = self.file("silicone_heart", "silicone_heart/f7_dynamic_deint_L_0100.png", "give --data")
        else {
            return Ok(());
        };
        let views = [Picture::read(&left)?, Picture::read(&left.with_file_name("f7_dynamic_deint_R_0100.png"))?];
        let folder = left.parent().unwrap_or(Path::new("."));
        let cameras = data::cameras(folder, (views[0].width, views[0].height))?;
        let rectified = Rectified::new(&cameras, views)?;
        self.consistency("silicone_heart", "silicone_heart", &rectified.views, 0, 64)
    }

    fn hamlyn(&mut self) -> Result<()> {
        let Some(first) = self.file("hamlyn", "hamlyn_640x480/left/1.png", "give --data") else { return Ok(()) };
        let Some(folder) = first.parent().and_then(Path::parent) else { return Ok(()) };
        for name in HAMLYN {
            let read = |side: &str| Picture::read(&folder.join(side).join(format!("{name}.png")));
            self.consistency(&format!("hamlyn_{name}"), "hamlyn", &[read("left")?, read("right")?], 0, 128)?;
        }
        Ok(())
    }

    /// Where no truth exists: how much is known, and how far both views agree.
    fn consistency(
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
        let there = chains::run(&views[0], &views[1], first_px, search_px)?;
        let back = chains::run(&mirrored(&views[1]), &mirrored(&views[0]), first_px, search_px)?;
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

/// A pair after rectification.
struct Rectified {
    geometry: Rectification,
    rotation: [[f64; 3]; 3],
    views: [Picture; 2],
    table: RemapTable,
}

impl Rectified {
    fn new(cameras: &StereoCameras, views: [Picture; 2]) -> Result<Self> {
        let geometry = Rectification::new(cameras, RectifyParams::default())?;
        let (width, height) = (geometry.width, geometry.height);
        let all = Rect::whole(width, height);
        let table = RemapTable::left(&cameras.left, &geometry, all, &Serial)?;
        let right = RemapTable::right(&cameras.right, &geometry, all, &Serial)?;
        let turn = |table: &RemapTable, view: &Picture| -> Result<Picture> {
            let mut bgr = vec![0; 3 * width * height];
            let source = View::new(&view.bgr[..], view.width, view.height, 3);
            table.remap(source, ViewMut::new(&mut bgr, width, height, 3), &Serial)?;
            Ok(Picture::new(width, height, bgr))
        };
        let views = [turn(&table, &views[0])?, turn(&right, &views[1])?];
        Ok(Self { rotation: geometry.rotation_left, geometry, views, table })
    }

    fn mask(&self, mask: &[u8]) -> Result<Vec<u8>> {
        let (width, height) = (self.geometry.width, self.geometry.height);
        anyhow::ensure!(mask.len() == width * height, "the mask has another size than the views");
        let mut out = vec![0; width * height];
        let source = View::new(mask, width, height, 1);
        self.table.remap(source, ViewMut::new(&mut out, width, height, 1), &Serial)?;
        Ok(out)
    }

    fn points(&self, disparity: &[f32]) -> Result<Vec<[f32; 3]>> {
        points(&self.geometry, disparity)
    }
}

/// Points in the rectified left camera, NaN where unknown.
fn points(geometry: &Rectification, disparity: &[f32]) -> Result<Vec<[f32; 3]>> {
    let (width, height) = (geometry.width, geometry.height);
    let (mut depth, mut points) = (vec![0.0; width * height], vec![0.0; 3 * width * height]);
    let input = ReprojectInput {
        disparity: View::new(disparity, width, height, 1),
        confidence: None,
        roi: Rect::whole(width, height),
    };
    let (to, to_points) = (ViewMut::new(&mut depth, width, height, 1), ViewMut::new(&mut points, width, height, 3));
    reproject(input, geometry, &ReprojectParams::default(), &Serial, to, Some(to_points))?;
    Ok(points.as_chunks::<3>().0.to_vec())
}
