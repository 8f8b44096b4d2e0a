//! Surfaces under the hand: turned, moved, enlarged.

use eframe::egui::{PointerButton, Response, Ui};

use crate::surface::Sight;

/// Smallest and largest size.
const ZOOM: std::ops::RangeInclusive<f32> = 0.2..=12.0;

/// A drag turns a surface, one with the right or middle button or with Shift moves it, the wheel and two fingers enlarge it, a double click puts
/// it back. `turn` is in radians per point.
pub fn steer(ui: &Ui, response: &Response, sight: &mut Sight, turn: f32) {
    let drag = response.drag_delta();
    let shift = ui.input(|i| i.modifiers.shift);
    if response.dragged_by(PointerButton::Primary) && !shift {
        sight.yaw -= drag.x * turn;
        sight.pitch = (sight.pitch + drag.y * turn).clamp(-1.5, 1.5);
    } else if response.dragged() {
        let width = response.rect.width().max(1.0);
        sight.shift = [sight.shift[0] + drag.x / width, sight.shift[1] + drag.y / width];
    }
    if response.hovered() {
        let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta().y, i.zoom_delta()));
        sight.zoom = (sight.zoom * pinch * (scroll * 0.002).exp()).clamp(*ZOOM.start(), *ZOOM.end());
    }
    if response.double_clicked() {
        *sight = Sight { size_px: sight.size_px, clip_mm: sight.clip_mm, ..Sight::default() };
    }
}
