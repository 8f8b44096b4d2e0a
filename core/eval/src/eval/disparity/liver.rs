//! The rendered liver: which way its cameras' pose is written, judged by where its model falls in both masks; then its surface.

use std::path::Path;

use panoscope_imaging::stereo::{CameraModel, StereoCameras, score_surface};

use super::data::{self, Picture};
use super::judge::{Judge, REACH_MM};
use super::picture;
use super::rectified::Rectified;
use crate::error::Result;
use crate::session::note;

const CASE: &str = "synthetic_liver";
/// Distance of the model's points, mm, and the side of the square that each covers in a mask, px.
const STEP_MM: f32 = 0.5;
const SPLAT_PX: i64 = 1;
/// The model must fill a mask at least this well for a pose to be believed.
const GOOD_IOU: f64 = 0.98;

/// One reading of `calib.l2r.txt`.
struct Reading {
    name: &'static str,
    rotation: [[f64; 3]; 3],
    translation_mm: [f64; 3],
}

/// Intersection over union of the model seen by a camera and a mask.
fn iou(points: &[[f64; 3]], camera: &CameraModel, mask: &[u8], reading: &Reading) -> f64 {
    let (width, height) = (camera.width as i64, camera.height as i64);
    let mut drawn = vec![false; mask.len()];
    let (r, t) = (&reading.rotation, &reading.translation_mm);
    for p in points {
        let [x, y, z] = [0, 1, 2].map(|i| r[i][0] * p[0] + r[i][1] * p[1] + r[i][2] * p[2] + t[i]);
        if z <= 0.0 {
            continue;
        }
        let (u, v) = camera.project(x / z, y / z);
        let (u, v) = (u.round() as i64, v.round() as i64);
        for row in (v - SPLAT_PX).max(0)..=(v + SPLAT_PX).min(height - 1) {
            for column in (u - SPLAT_PX).max(0)..=(u + SPLAT_PX).min(width - 1) {
                drawn[(row * width + column) as usize] = true;
            }
        }
    }
    let (mut both, mut any) = (0usize, 0usize);
    for (drawn, mask) in drawn.iter().zip(mask) {
        both += usize::from(*drawn && *mask > 127);
        any += usize::from(*drawn || *mask > 127);
    }
    both as f64 / any.max(1) as f64
}

/// The readings of three rows of a rotation and one of a translation that are in question.
fn readings(folder: &Path) -> Result<[Reading; 3]> {
    let (r, translation_mm) = data::rotation_and_translation(folder)?;
    let transposed = std::array::from_fn(|i| std::array::from_fn(|j| r[j][i]));
    let twice = std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| r[i][k] * r[k][j]).sum()));
    Ok([
        Reading { name: "as_written", rotation: r, translation_mm },
        Reading { name: "rotation_transposed", rotation: transposed, translation_mm },
        Reading { name: "rotation_twice_no_baseline", rotation: twice, translation_mm: [0.0; 3] },
    ])
}

impl Judge<'_> {
    pub fn liver(&mut self) -> Result<()> {
        let Some(left) = self.file(CASE, "synthetic_liver/synthetic-left.png", "give --data") else {
            return Ok(());
        };
        let beside = |name: &str| left.with_file_name(name);
        let views = [Picture::read(&left)?, Picture::read(&beside("synthetic-right.png"))?];
        let size = (views[0].width, views[0].height);
        let (left_camera, right_camera) = data::intrinsics(&beside("calib"), size)?;
        let masks = [data::gray(&beside("mask-left.png"))?, data::gray(&beside("mask-right.png"))?];
        let to_world = data::matrix4(&beside("model_to_world.txt"))?;
        let camera = data::matrix4(&beside("camera_to_world.txt"))?;
        // Model to world, and by the inverse of `camera_to_world` into the left camera: the left mask proves it.
        let place = |p: [f32; 3]| -> [f64; 3] {
            let p = p.map(f64::from);
            let world: [f64; 3] = std::array::from_fn(|i| {
                (0..3).map(|j| to_world[4 * i + j] * p[j]).sum::<f64>() + to_world[4 * i + 3] - camera[4 * i + 3]
            });
            std::array::from_fn(|i| (0..3).map(|j| camera[4 * j + i] * world[j]).sum())
        };
        let model: Vec<[f64; 3]> = data::surface(&beside("liver-H07.ply"), STEP_MM)?.into_iter().map(place).collect();
        let eye = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
        let own = Reading { name: "left_pose", rotation: eye, translation_mm: [0.0; 3] };
        let input = "synthetic_liver 1920x1080, the model drawn into a mask under one reading of the pose files";
        let left_iou = iou(&model, &left_camera, &masks[0], &own);
        self.add(format!("mask_iou/{CASE}/{}", own.name), left_iou, "1", input);
        let mut best: Option<(f64, Reading)> = None;
        for reading in readings(&beside("calib"))? {
            let found = iou(&model, &right_camera, &masks[1], &reading);
            self.add(format!("mask_iou/{CASE}/{}", reading.name), found, "1", input);
            if best.as_ref().is_none_or(|(most, _)| found > *most) {
                best = Some((found, reading));
            }
        }
        let Some((most, reading)) = best else { return Ok(()) };
        if left_iou < GOOD_IOU || most < GOOD_IOU || reading.translation_mm == [0.0; 3] {
            note!(
                self.session,
                "skipped: surface of {CASE}: of all readings of its pose the right mask fits `{}` best (IoU {most:.4}, left {left_iou:.4}); a pair without a baseline shows no depth",
                reading.name
            );
            return Ok(());
        }
        let cameras = StereoCameras {
            left: left_camera,
            right: right_camera,
            rotation: reading.rotation,
            translation_mm: reading.translation_mm,
        };
        self.liver_surface(&cameras, views, &masks[0], &model)
    }

    fn liver_surface(
        &mut self,
        cameras: &StereoCameras,
        views: [Picture; 2],
        mask: &[u8],
        model: &[[f64; 3]],
    ) -> Result<()> {
        let rectified = Rectified::new(cameras, views)?;
        let mask = rectified.mask(mask)?;
        let turn = |p: &[f64; 3]| -> [f32; 3] {
            std::array::from_fn(|i| (0..3).map(|j| rectified.rotation[i][j] * p[j]).sum::<f64>() as f32)
        };
        let surface: Vec<[f32; 3]> = model.iter().map(turn).collect();
        let size = (rectified.geometry.width, rectified.geometry.height);
        let input = "synthetic_liver 1920x1080, surface of the model in the mask, farther than 4 mm counts as 4 mm";
        for made in self.run(&rectified.views[0], &rectified.views[1], 32, 128)? {
            let points = rectified.points(&made.disparity)?;
            // Every sixth column of every sixth row: tens of thousands of points are enough.
            let counts = |index: &usize| {
                (index % size.0).is_multiple_of(6) && (index / size.0).is_multiple_of(6) && mask[*index] > 127
            };
            let inside: Vec<[f32; 3]> = (0..points.len()).filter(counts).map(|index| points[index]).collect();
            let score = score_surface(&inside, &surface, REACH_MM)?;
            let chain = made.chain;
            self.add(format!("surface_mm/{CASE}/{chain}"), score.median_mm, "mm", input);
            self.add(format!("surface_p95_mm/{CASE}/{chain}"), score.p95_mm, "mm", input);
            if let Some(folder) = self.pictures {
                picture::map(&folder.join(format!("{CASE}_{chain}.png")), size, &made.disparity)?;
            }
        }
        Ok(())
    }
}
