//! Distances of tips on an image: a ring around each tip, a line to what it is nearest to, and that distance.

use std::fmt::Write;

use panoscope_imaging::draw::{self, Color};
use panoscope_node::Table;

use crate::bar::{self, Bar, Key};
use crate::marks::{Pen, Words};
use crate::quantity::write_with_error;
use crate::shapes::Shapes;

const CLEAR: Color = [80, 220, 80];
const NEAR: Color = [0, 190, 255];
const CONTACT: Color = [60, 60, 255];
const UNKNOWN: Color = [170, 170, 170];

/// Columns of the table of `proximity` that are drawn.
const COLUMNS: [&str; 8] =
    ["u_px", "v_px", "tissue_u_px", "tissue_v_px", "tissue_mm", "tissue_state", "tip_mm", "tip_state"];

/// Adds the marks of each tip of the table; nothing if the table lacks these columns. Text goes to the bar where the pen says so, with the error from a column
/// `tissue_error_mm`.
pub fn draw(shapes: &mut Shapes, table: &Table<'_>, pen: &Pen, words: &mut String, bar: &mut Bar) {
    let mut places = [0; COLUMNS.len()];
    for (place, name) in places.iter_mut().zip(COLUMNS) {
        let Some(found) = table.names().position(|n| n == name) else { return };
        *place = found;
    }
    let error_at = table.names().position(|n| n == "tissue_error_mm");
    for (number, row) in table.rows().enumerate() {
        let [u, v, tissue_u, tissue_v, tissue_mm, state, tip_mm, tip_state] = places.map(|place| row[place]);
        let at = |u: f64, v: f64| (u as f32 + pen.offset.0, v as f32 + pen.offset.1);
        let (x, y) = at(u, v);
        if !x.is_finite() || !y.is_finite() {
            continue;
        }
        let color = match state {
            s if s < 0.0 => UNKNOWN,
            s if s > 1.5 => CONTACT,
            s if s > 0.5 => NEAR,
            _ => CLEAR,
        };
        // Warnings are thicker too, not only coloured.
        let line_px = if state > 0.5 { 1.6 * pen.line_px } else { pen.line_px };
        let radius = 5.0 * pen.line_px + 4.0;
        let to = at(tissue_u, tissue_v);
        if to.0.is_finite() && to.1.is_finite() {
            shapes.line((x, y), to, line_px, color);
            shapes.disc(to, 1.5 * line_px, color, 1.0);
        }
        shapes.circle((x, y), radius, line_px, color);
        if tip_state > 0.5 {
            shapes.circle((x, y), radius + 2.5 * line_px, 1.6 * pen.line_px, NEAR);
        }
        if pen.words != Words::Picture {
            let key = Key { color, dots: number + 1 };
            if pen.words == Words::Below {
                let disc = |at, radius, color, alpha| shapes.disc(at, radius, color, alpha);
                bar::dots(disc, (x + radius + 3.0 * pen.text_scale, y), key, pen.text_scale);
                plate(bar, row, [tissue_mm, state, tip_mm, tip_state], error_at, key, words);
            }
            continue;
        }
        words.clear();
        let _ = match state {
            s if s < 0.0 => write!(words, "?"),
            s if s > 1.5 => write!(words, "contact {tissue_mm:.1} mm"),
            _ => write!(words, "{tissue_mm:.1} mm"),
        };
        shapes.text((x + radius + 3.0, y + 3.0), words, pen.text_scale, color);
        if tip_state > 0.5 {
            words.clear();
            let _ = write!(words, "tips {tip_mm:.1} mm");
            let below = y + 3.0 + draw::text_size(words, pen.text_scale).1 + 2.0 * pen.text_scale;
            shapes.text((x + radius + 3.0, below), words, pen.text_scale, NEAR);
        }
    }
}

/// Adds the plate of a tip: distance to the tissue, and another tip if it is near.
fn plate(
    bar: &mut Bar,
    row: &[f64],
    [tissue_mm, state, tip_mm, tip_state]: [f64; 4],
    error_at: Option<usize>,
    key: Key,
    words: &mut String,
) {
    words.clear();
    words.push_str(if state > 1.5 { "contact " } else { "tissue " });
    match state {
        s if s < 0.0 => words.push('?'),
        _ => write_with_error(words, tissue_mm, error_at.map_or(f64::NAN, |at| row[at]), "mm"),
    }
    if tip_state > 0.5 {
        words.push_str(", tips ");
        write_with_error(words, tip_mm, f64::NAN, "mm");
    }
    bar.add(words, Some(key));
}
