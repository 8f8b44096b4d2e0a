//! A pair of the user's with truth of the user's.

use std::path::PathBuf;

use panoscope_data::calibration::packet;
use panoscope_imaging::stereo::{Rectification, StereoCameras, score_surface};

use super::data::Picture;
use super::judge::{Judge, REACH_MM, Truth};
use super::picture;
use super::rectified::{Rectified, points};
use super::truth_files::{self, Loaded};
use crate::error::{Context, Result, bail, ensure};

/// A pair of the user's.
#[derive(Clone, Debug)]
pub struct Pair {
    /// Left view, rectified unless `rectify` is set.
    pub left: PathBuf,
    /// Right view of the same instant.
    pub right: PathBuf,
    /// Truth for the left view: disparity or depth as PFM, NPY, f32 TIFF or PNG, points as XYZ or PLY (left rectified camera, mm).
    /// Without it only the consistency of left and right is judged.
    pub truth: Option<PathBuf>,
    /// The truth is depth in mm, not disparity in px.
    pub truth_is_depth: bool,
    /// What the values of a PNG are divided by: 1 for whole px, 256 as KITTI has it. 0 is unknown.
    pub truth_scale: f32,
    /// Calibration of the pair, for depth, points and `rectify`; one file or two halves.
    pub calibration: Vec<PathBuf>,
    /// Rectifies the pair first.
    pub rectify: bool,
    /// Smallest disparity that is searched.
    pub first_px: i32,
    /// Width of the disparity search, a multiple of 16.
    pub search_px: usize,
}

impl Judge<'_> {
    pub fn given(&mut self, given: &Pair) -> Result<()> {
        let (left, right) = (&given.left, &given.right);
        let mut views = [Picture::read(left)?, Picture::read(right)?];
        let size = (views[0].width, views[0].height);
        ensure!((views[1].width, views[1].height) == size, "the views differ in size");
        let mut geometry: Option<Rectification> = None;
        if !given.calibration.is_empty() {
            let calibration = panoscope_data::calibration::read(&given.calibration)?;
            geometry = Some(packet::rectification(&calibration)?);
            if given.rectify {
                let cameras = StereoCameras {
                    left: packet::camera(&calibration.left)?,
                    right: packet::camera(&calibration.right)?,
                    rotation: std::array::from_fn(|i| {
                        std::array::from_fn(|j| calibration.right_from_left_rotation[3 * i + j])
                    }),
                    translation_mm: calibration.right_from_left_mm,
                };
                let rectified = Rectified::new(&cameras, views)?;
                views = rectified.views;
                geometry = Some(rectified.geometry);
            }
        }
        let name = left.file_stem().map_or_else(|| "given".into(), |stem| stem.to_string_lossy().into_owned());
        let Some(path) = &given.truth else {
            return self.consistency(&name, &name, &views, given.first_px, given.search_px);
        };
        let needed = || geometry.as_ref().context("depth and points need --calibration");
        match truth_files::read(path, given.truth_scale)? {
            Loaded::Plane(plane) => {
                ensure!(
                    (plane.width, plane.height) == size,
                    "{} is {}x{}, the views are {}x{}",
                    path.display(),
                    plane.width,
                    plane.height,
                    size.0,
                    size.1
                );
                let disparity = if given.truth_is_depth {
                    let views = needed()?;
                    let shift = views.left.cx - views.right.cx;
                    let scale = views.left.focal_px * views.baseline_mm;
                    plane.data.iter().map(|z| (scale / f64::from(*z) + shift) as f32).collect()
                } else {
                    plane.data
                };
                let truth = Truth { disparity, mask: None };
                self.pair(&name, [&views[0], &views[1]], given.first_px, given.search_px, &truth)
            }
            Loaded::Points(surface) => {
                if given.truth_is_depth {
                    bail!("{} holds points: leave --depth out", path.display());
                }
                let geometry = needed()?.clone();
                self.given_surface(&name, geometry, &views, &surface, given)
            }
        }
    }

    fn given_surface(
        &mut self,
        name: &str,
        geometry: Rectification,
        views: &[Picture; 2],
        surface: &[[f32; 3]],
        given: &Pair,
    ) -> Result<()> {
        let size = (views[0].width, views[0].height);
        ensure!((geometry.width, geometry.height) == size, "the calibration was made for views of another size");
        let input =
            format!("{name} {}x{}, {} true points, farther than 4 mm counts as 4 mm", size.0, size.1, surface.len());
        for made in self.run(&views[0], &views[1], given.first_px, given.search_px)? {
            let points = points(&geometry, &made.disparity)?;
            let score = score_surface(&points, surface, REACH_MM)?;
            let chain = made.chain;
            self.add(format!("surface_mm/{name}/{chain}"), score.median_mm, "mm", &input);
            self.add(format!("surface_p95_mm/{name}/{chain}"), score.p95_mm, "mm", &input);
            self.add(format!("density/{name}/{chain}"), 100.0 * score.points as f64 / points.len() as f64, "%", &input);
            if let Some(folder) = self.pictures {
                picture::map(&folder.join(format!("{name}_{chain}.png")), size, &made.disparity)?;
            }
        }
        Ok(())
    }
}
