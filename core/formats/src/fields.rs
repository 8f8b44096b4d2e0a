//! The fields of packets in tables, declared once for JSON lines and CSV.

use panoscope_abi::{self as abi, Detection, Homography, Joints, Pose, Roi, Scalar, Tip};
use panoscope_base::packet::name as padded;

use crate::json;

/// Receives the named fields of a packet.
pub trait Fields {
    /// A number; a NaN means unknown.
    fn number(&mut self, name: &str, value: f64);
    /// Several numbers of one kind.
    fn numbers(&mut self, name: &str, values: &[f64]);
    /// A text.
    fn text(&mut self, name: &str, value: &str);
}

/// `f32` without the digits that widening to `f64` would add.
fn short(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

/// The parts of a [`Homography`].
pub fn homography(value: &Homography, out: &mut dyn Fields) {
    out.numbers("left_from_right", &value.left_from_right);
    out.number("rms_px", value.rms_px);
    out.number("inliers", f64::from(value.inliers));
    let state = match value.state {
        abi::STATE_FRESH => "fresh",
        abi::STATE_HELD => "held",
        _ => "lost",
    };
    out.text("state", state);
}

/// The parts of a [`Roi`].
pub fn roi(value: &Roi, out: &mut dyn Fields) {
    out.number("x", value.x.into());
    out.number("y", value.y.into());
    out.number("width", value.width.into());
    out.number("height", value.height.into());
}

/// The parts of a [`Tip`].
pub fn tip(value: &Tip, out: &mut dyn Fields) {
    out.number("u_px", value.u_px);
    out.number("v_px", value.v_px);
    let xyz = if value.xyz_valid == 1 { value.xyz_mm } else { [f64::NAN; 3] };
    out.numbers("xyz_mm", &xyz);
    out.number("score", value.score);
    out.number("class_index", value.class_index.into());
    out.number("track_id", value.track_id as f64);
}

/// The parts of a [`Pose`].
pub fn pose(value: &Pose, out: &mut dyn Fields) {
    out.text("a", &padded(&value.a));
    out.text("b", &padded(&value.b));
    out.numbers("a_from_b_wxyz", &value.a_from_b_wxyz);
    out.numbers("a_from_b_mm", &value.a_from_b_mm);
}

/// The parts of [`Joints`].
pub fn joints(value: &Joints, out: &mut dyn Fields) {
    let count = (value.count as usize).min(abi::MAX_JOINTS);
    out.numbers("position_rad", &value.position_rad[..count]);
    out.numbers("velocity_rad_s", &value.velocity_rad_s[..count]);
}

/// The parts of a [`Scalar`].
pub fn scalar(value: &Scalar, out: &mut dyn Fields) {
    out.text("name", &padded(&value.name));
    out.number("value", value.value);
    out.text("unit", &padded(&value.unit));
}

/// The parts of a [`Detection`].
pub fn detection(value: &Detection, label: &str, out: &mut dyn Fields) {
    out.number("x_px", short(value.x_px));
    out.number("y_px", short(value.y_px));
    out.number("width_px", short(value.width_px));
    out.number("height_px", short(value.height_px));
    out.number("score", short(value.score));
    out.number("class_index", value.class_index.into());
    out.text("label", label);
    out.number("track_id", value.track_id as f64);
}

/// Fields of a JSON object that is open at the end of a text.
pub struct JsonFields<'a>(pub &'a mut String);

impl Fields for JsonFields<'_> {
    fn number(&mut self, name: &str, value: f64) {
        json::key(self.0, name);
        json::number(self.0, value);
    }

    fn numbers(&mut self, name: &str, values: &[f64]) {
        json::key(self.0, name);
        self.0.push('[');
        for (index, value) in values.iter().enumerate() {
            if index > 0 {
                self.0.push(',');
            }
            json::number(self.0, *value);
        }
        self.0.push(']');
    }

    fn text(&mut self, name: &str, value: &str) {
        json::key(self.0, name);
        json::string(self.0, value);
    }
}

/// Cells of one CSV line, with their column names.
#[derive(Clone, Debug, Default)]
pub struct CsvFields {
    /// Put before every column's name.
    pub prefix: String,
    /// Column name and cell.
    pub cells: Vec<(String, String)>,
}

impl CsvFields {
    fn push(&mut self, name: &str, cell: String) {
        self.cells.push((format!("{}{name}", self.prefix), cell));
    }
}

/// A cell, quoted where RFC 4180 asks for it.
pub fn csv_cell(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

impl Fields for CsvFields {
    fn number(&mut self, name: &str, value: f64) {
        self.push(name, if value.is_finite() { value.to_string() } else { String::new() });
    }

    fn numbers(&mut self, name: &str, values: &[f64]) {
        for (index, value) in values.iter().enumerate() {
            self.number(&format!("{name}_{index}"), *value);
        }
    }

    fn text(&mut self, name: &str, value: &str) {
        self.push(name, csv_cell(value));
    }
}
