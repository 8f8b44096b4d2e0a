//! The fields of packets in tables, declared once for JSON lines and CSV.

use std::fmt::{self, Write as _};

use panoscope_abi::{self as abi, Detection, Homography, Joints, Pose, Roi, Scalar, Tip};
use panoscope_base::packet::name as padded;

use crate::formats::json;

/// Receives the named fields of a packet.
pub trait Fields {
    /// A number; a NaN means unknown.
    fn number(&mut self, name: &str, value: f64);
    /// Several numbers of one kind.
    fn numbers(&mut self, name: &str, values: &[f64]);
    /// A text.
    fn text(&mut self, name: &str, value: &str);
}

/// Converts `f32` without the digits that widening to `f64` would add.
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

/// Cells of one CSV line, with the names of their columns. Keeps its memory when it is cleared.
#[derive(Clone, Debug, Default)]
pub struct CsvFields {
    prefix: String,
    /// Names and cells, one after the other.
    text: String,
    /// End of each name and cell in `text`.
    ends: Vec<[usize; 2]>,
}

impl CsvFields {
    /// Removes all cells and the prefix.
    pub fn clear(&mut self) {
        self.prefix.clear();
        self.truncate(0);
    }

    /// Removes all cells but the first ones.
    pub fn truncate(&mut self, cells: usize) {
        self.ends.truncate(cells);
        self.text.truncate(self.ends.last().map_or(0, |[_, end]| *end));
    }

    /// Sets a prefix of the names of further columns.
    pub fn set_prefix(&mut self, parts: &[&str]) {
        self.prefix.clear();
        self.prefix.extend(parts.iter().copied());
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether it has no cell.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Name of the column and cell at an index.
    pub fn get(&self, index: usize) -> Option<(&str, &str)> {
        let [name_end, end] = *self.ends.get(index)?;
        let start = index.checked_sub(1).map_or(0, |before| self.ends[before][1]);
        Some((&self.text[start..name_end], &self.text[name_end..end]))
    }

    /// Names of columns and cells.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        (0..self.len()).filter_map(|index| self.get(index))
    }

    /// Adds a whole number. [`Fields::number`] would round large ones.
    pub fn integer(&mut self, name: &str, value: i128) {
        self.push(format_args!("{name}"), |out| {
            let _ = write!(out, "{value}");
        });
    }

    fn push(&mut self, name: fmt::Arguments<'_>, cell: impl FnOnce(&mut String)) {
        let _ = write!(self.text, "{}{name}", self.prefix);
        let name_end = self.text.len();
        cell(&mut self.text);
        self.ends.push([name_end, self.text.len()]);
    }

    fn push_number(&mut self, name: fmt::Arguments<'_>, value: f64) {
        self.push(name, |out| {
            if value.is_finite() {
                let _ = write!(out, "{value}");
            }
        });
    }
}

/// Appends a cell, quoted if RFC 4180 requires it.
pub fn csv_cell(out: &mut String, text: &str) {
    if !text.contains([',', '"', '\n', '\r']) {
        out.push_str(text);
        return;
    }
    out.push('"');
    for (index, part) in text.split('"').enumerate() {
        out.push_str(if index == 0 { "" } else { "\"\"" });
        out.push_str(part);
    }
    out.push('"');
}

/// Appends a line of unquoted cells.
pub fn csv_line(out: &mut String, cells: &[String]) {
    for (index, cell) in cells.iter().enumerate() {
        out.push_str(if index == 0 { "" } else { "," });
        csv_cell(out, cell);
    }
    out.push('\n');
}

impl Fields for CsvFields {
    fn number(&mut self, name: &str, value: f64) {
        self.push_number(format_args!("{name}"), value);
    }

    fn numbers(&mut self, name: &str, values: &[f64]) {
        for (index, value) in values.iter().enumerate() {
            self.push_number(format_args!("{name}_{index}"), *value);
        }
    }

    fn text(&mut self, name: &str, value: &str) {
        self.push(format_args!("{name}"), |out| csv_cell(out, value));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_that_follow_the_head_are_replaced() {
        let mut line = CsvFields::default();
        line.integer("capture_ns", (1 << 60) + 1);
        line.set_prefix(&["tip", "."]);
        line.numbers("xyz_mm", &[1.5, f64::NAN]);
        let head = line.len();
        line.text("name", "a \"b\", c");
        let cells: Vec<_> = line.iter().collect();
        let expected = [
            ("capture_ns", "1152921504606846977"),
            ("tip.xyz_mm_0", "1.5"),
            ("tip.xyz_mm_1", ""),
            ("tip.name", "\"a \"\"b\"\", c\""),
        ];
        assert_eq!(cells, expected);
        line.truncate(head);
        line.set_prefix(&[]);
        line.number("score", 0.25);
        assert_eq!((line.len(), line.get(3), line.get(4)), (4, Some(("score", "0.25")), None));
        line.clear();
        assert!(line.is_empty());
    }
}
