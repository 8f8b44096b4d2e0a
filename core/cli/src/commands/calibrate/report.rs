//! What a calibration is told as: views, errors, cameras, pictures.

use std::path::Path;

use anyhow::{Context, Result};
use panoscope_abi::{Calibration, Camera};
use panoscope_calibration::ViewState;
use panoscope_engine::memory::FrameRef;

use super::plan::Source;
use crate::commands::eval::look::Table;
use crate::terminal::{raw, say, table, tell};

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

    /// Names the views that were left out, with the reason; those of a stream that only show nothing new are counted.
    pub fn tell_left_out(&self) {
        let quiet = [ViewState::Alike, ViewState::NotNeeded];
        for view in &self.0 {
            if let Some(state) = view.state.filter(|state| *state != ViewState::Used && !quiet.contains(state)) {
                tell!("left out: {}: {}", view.name, state.words());
            }
        }
        for state in quiet {
            let count = self.0.iter().filter(|view| view.state == Some(state)).count();
            if count > 0 {
                tell!("left out: {count} views: {}", state.words());
            }
        }
    }

    /// The views that took part, one a line.
    pub fn show(&self) {
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
        raw(&table(&rows));
    }
}

/// The packet's bytes as the packet.
pub fn calibration(bytes: &[u8]) -> Option<Calibration> {
    panoscope_base::packet::decode(bytes).ok()
}

fn camera(name: &str, camera: &Camera) {
    let last = camera.distortion.iter().rposition(|k| *k != 0.0).map_or(0, |last| last + 1);
    let coefficients: Vec<String> = camera.distortion[..last].iter().map(|k| format!("{k:.4}")).collect();
    say!(
        "{name:9}  fx {:.2}  fy {:.2}  cx {:.2}  cy {:.2} px, distortion {}",
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        if coefficients.is_empty() { "none".to_owned() } else { coefficients.join(" ") }
    );
}

/// Both cameras and how well they fit.
pub fn show(calibration: &Calibration, views: &Views) {
    say!("");
    say!(
        "{} of {} views, reprojection error {:.3} px, rows {:.3} px",
        views.solved(),
        views.len(),
        calibration.rms_px,
        views.epipolar_px()
    );
    camera("left", &calibration.left);
    camera("right", &calibration.right);
    let [x, y, z] = calibration.right_from_left_mm;
    say!("apart      {x:.3} {y:.3} {z:.3} mm (left camera seen from the right one)");
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
    image::save_buffer(path, &rgb, width as u32, height as u32, image::ColorType::Rgb8)
        .with_context(|| format!("cannot write {}", path.display()))
}
