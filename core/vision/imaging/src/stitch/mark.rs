//! Marks on the panorama: lost or held geometry, and which way is up.

use super::params::{Canvas, CompositeParams, GeometryState};
use crate::ViewMut;
use crate::draw::{self, Color};

const RED: Color = [40, 40, 230];
const AMBER: Color = [30, 170, 255];
const WHITE: Color = [255, 255, 255];

/// Whether [`draw_marks`] draws anything.
pub fn has_marks(state: GeometryState, params: &CompositeParams) -> bool {
    let is_marked = match state {
        GeometryState::Fresh => false,
        GeometryState::Held => params.mark_held,
        GeometryState::Lost => params.mark_lost,
    };
    is_marked || params.up_cue_deg.is_some_and(f32::is_finite)
}

/// Draws the marks that `params` ask for.
pub fn draw_marks(out: &mut ViewMut<u8>, canvas: Canvas, state: GeometryState, params: &CompositeParams) {
    let unit = (canvas.height.min(canvas.width) as f32 / 120.0).clamp(2.0, 12.0);
    match state {
        GeometryState::Lost if params.mark_lost => {
            let (w, h, t) = (canvas.width as i32, canvas.height as i32, unit as i32);
            for (x, y, w, h) in [(0, 0, w, t), (0, h - t, w, t), (0, 0, t, h), (w - t, 0, t, h)] {
                draw::fill_rectangle(out, x, y, w, h, RED, 1.0);
            }
            draw::text(out, 3.0 * unit, 3.0 * unit, "STITCH LOST", unit / 2.0, RED);
        }
        GeometryState::Held if params.mark_held => {
            let (x, y) = (2.0 * unit, 2.0 * unit);
            let corner = [(x, y), (x + 5.0 * unit, y), (x, y + 5.0 * unit)];
            draw::fill_polygon(out, &corner, AMBER, 1.0);
        }
        _ => {}
    }
    if let Some(degrees) = params.up_cue_deg.filter(|d| d.is_finite()) {
        let radius = 5.0 * unit;
        let centre = (canvas.width as f32 - 8.0 * unit, 8.0 * unit);
        let (s, c) = degrees.to_radians().sin_cos();
        let at = |across: f32, along: f32| {
            (centre.0 + radius * (across * c + along * s), centre.1 + radius * (across * s - along * c))
        };
        draw::fill_circle(out, centre.0, centre.1, 1.25 * radius, [0, 0, 0], 0.4);
        draw::fill_polygon(out, &[at(0.0, 1.0), at(0.65, -0.7), at(0.0, -0.3), at(-0.65, -0.7)], WHITE, 1.0);
    }
}
