//! A calibration as text and pictures: views, errors, cameras.

use std::fmt::Write as _;
use std::path::Path;

use panoscope_abi::{Calibration, Camera};
use panoscope_data::calibration::{ViewState, equidistant_of};
use panoscope_engine::memory::FrameRef;
use panoscope_engine::text_table::table;

use super::source::Source;
use crate::error::{Context, FileAction, OnFile, Result};
use crate::packets::Table;

/// One row of the node's table.
struct View {
    name: String,
    state: Option<ViewState>,
    points: f64,
    error_px: [f64; 2],
    epipolar_px: f64,
    area_pct: [f64; 2],
    is_solved: bool,
}

/// All views that were looked at.
pub struct Views(Vec<View>);

impl Views {
    /// From the node's table.
    pub fn of(rows: &Table, source: &Source) -> Self {
        let view = |row: &Vec<f64>| {
            let [index, state, points, left, right, epipolar, area_left, area_right, solved, ..] = row[..] else {
                return None;
            };
            Some(View {
                name: source.name(index as usize),
                state: ViewState::of_code(state),
                points,
                error_px: [left, right],
                epipolar_px: epipolar,
                area_pct: [area_left, area_right],
                is_solved: solved > 0.0,
            })
        };
        Self(rows.rows.iter().filter_map(view).collect())
    }

    /// Views looked at.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether no view was looked at.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Views that could take part.
    pub fn used(&self) -> usize {
        self.0.iter().filter(|view| view.state == Some(ViewState::Used)).count()
    }

    /// Views that took part.
    pub fn solved(&self) -> usize {
        self.0.iter().filter(|view| view.is_solved).count()
    }

    /// Mean distance of matching points from one row, px.
    pub fn epipolar_px(&self) -> f64 {
        let known: Vec<f64> = self.0.iter().map(|view| view.epipolar_px).filter(|e| e.is_finite()).collect();
        known.iter().sum::<f64>() / known.len().max(1) as f64
    }

    /// A line for each view that was skipped, with the reason; those of a stream that only show nothing new are counted.
    pub fn skipped(&self) -> Vec<String> {
        let mut lines = Vec::new();
        let quiet = [ViewState::Alike, ViewState::NotNeeded];
        for view in &self.0 {
            if let Some(state) = view.state.filter(|state| *state != ViewState::Used && !quiet.contains(state)) {
                lines.push(format!("left out: {}: {}", view.name, state.words()));
            }
        }
        for state in quiet {
            let count = self.0.iter().filter(|view| view.state == Some(state)).count();
            if count > 0 {
                lines.push(format!("left out: {count} views: {}", state.words()));
            }
        }
        lines
    }

    /// The views that took part, as text, one per line.
    pub fn table(&self) -> String {
        let head = ["view", "points", "left px", "right px", "rows px", "left %", "right %"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        for view in self.0.iter().filter(|view| view.is_solved) {
            rows.push(vec![
                view.name.clone(),
                format!("{:.0}", view.points),
                format!("{:.3}", view.error_px[0]),
                format!("{:.3}", view.error_px[1]),
                format!("{:.3}", view.epipolar_px),
                format!("{:.0}", view.area_pct[0]),
                format!("{:.0}", view.area_pct[1]),
            ]);
        }
        table(&rows)
    }
}

fn camera(text: &mut String, name: &str, camera: &Camera) {
    let fisheye = equidistant_of(camera);
    let last = camera.distortion.iter().rposition(|k| *k != 0.0).map_or(0, |last| last + 1);
    let coefficients: Vec<String> =
        camera.distortion[..fisheye.map_or(last, |k| k.len())].iter().map(|k| format!("{k:.4}")).collect();
    let _ = writeln!(
        text,
        "{name:9}  fx {:.2}  fy {:.2}  cx {:.2}  cy {:.2} px, {} {}",
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        if fisheye.is_some() { "equidistant" } else { "distortion" },
        if coefficients.is_empty() { "none".to_owned() } else { coefficients.join(" ") }
    );
}

/// Both cameras and how well they fit, as text.
pub fn summary(calibration: &Calibration, views: &Views) -> String {
    let mut text = format!(
        "{} of {} views, reprojection error {:.3} px, rows {:.3} px\n",
        views.solved(),
        views.len(),
        calibration.rms_px,
        views.epipolar_px()
    );
    camera(&mut text, "left", &calibration.left);
    camera(&mut text, "right", &calibration.right);
    let [x, y, z] = calibration.right_from_left_mm;
    let _ = writeln!(text, "apart      {x:.3} {y:.3} {z:.3} mm (left camera seen from the right one)");
    text
}

/// Writes a BGR picture.
pub fn save(frame: &FrameRef, path: &Path) -> Result<()> {
    let (described, bytes) = (frame.frame(), frame.bytes());
    let (width, height, stride) =
        (described.width as usize, described.height as usize, described.stride_bytes as usize);
    let mut rgb = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        let row = bytes.get(y * stride..y * stride + 3 * width).context("a picture is cut off")?;
        rgb.extend(row.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]));
    }
    image::save_buffer(path, &rgb, width as u32, height as u32, image::ColorType::Rgb8).on_file(FileAction::Write, path)
}
