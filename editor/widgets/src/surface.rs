//! Pointer and key control of the viewpoint on a surface: rotate, move, zoom.

use eframe::egui::{InputState, Key, Modifiers, PointerButton, Response, Ui};

use crate::ARROWS;
use panoscope_editor_model::surface::Viewpoint;

/// Smallest and largest magnification.
const ZOOM: std::ops::RangeInclusive<f32> = 0.05..=12.0;
/// Maximum rotation upwards and downwards, radians.
const PITCH: f32 = 1.5;

/// A drag rotates a surface; a drag with Shift or with another button moves it; the wheel and two fingers zoom; a double click resets the
/// viewpoint. `turn` is in radians per point.
pub fn steer(ui: &Ui, response: &Response, viewpoint: &mut Viewpoint, turn: f32) {
    let drag = response.drag_delta();
    let shift = ui.input(|i| i.modifiers.shift);
    if response.dragged_by(PointerButton::Primary) && !shift {
        viewpoint.yaw -= drag.x * turn;
        viewpoint.pitch = (viewpoint.pitch + drag.y * turn).clamp(-PITCH, PITCH);
    } else if response.dragged() {
        let width = response.rect.width().max(1.0);
        viewpoint.shift = [viewpoint.shift[0] + drag.x / width, viewpoint.shift[1] + drag.y / width];
    }
    if response.hovered() {
        let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta().y, i.zoom_delta()));
        viewpoint.zoom = (viewpoint.zoom * pinch * (scroll * 0.002).exp()).clamp(*ZOOM.start(), *ZOOM.end());
    }
    if response.double_clicked() {
        reset(viewpoint);
    }
}

/// Rotation by one press of an arrow key, radians.
const KEY_TURN: f32 = 0.06;
/// Movement by one press of Shift and an arrow key, as a fraction of the image's width.
const KEY_SHIFT: f32 = 0.02;
/// Number of zoom steps that double the size.
const KEY_ZOOM: f32 = 6.0;

/// Zooms in by a number of steps, or out when it is negative.
pub fn zoom_by(viewpoint: &mut Viewpoint, steps: f32) {
    viewpoint.zoom = (viewpoint.zoom * (steps / KEY_ZOOM).exp2()).clamp(*ZOOM.start(), *ZOOM.end());
}

/// Key control: arrows rotate, Shift and arrows move, + and - zoom, Home resets the viewpoint.
pub fn steer_by_key(input: &mut InputState, viewpoint: &mut Viewpoint) {
    for (key, [x, y]) in ARROWS {
        let moved = input.count_and_consume_key(Modifiers::SHIFT, key) as f32 * KEY_SHIFT;
        viewpoint.shift = [viewpoint.shift[0] + x * moved, viewpoint.shift[1] + y * moved];
        let turned = input.count_and_consume_key(Modifiers::NONE, key) as f32 * KEY_TURN;
        viewpoint.yaw -= x * turned;
        viewpoint.pitch = (viewpoint.pitch + y * turned).clamp(-PITCH, PITCH);
    }
    for (key, steps) in [(Key::Plus, 1.0), (Key::Equals, 1.0), (Key::Minus, -1.0)] {
        zoom_by(viewpoint, steps * input.count_and_consume_key(Modifiers::NONE, key) as f32);
    }
    if input.consume_key(Modifiers::NONE, Key::Home) {
        reset(viewpoint);
    }
}

/// Resets the viewpoint but keeps the depth range.
fn reset(viewpoint: &mut Viewpoint) {
    *viewpoint = Viewpoint { size_px: viewpoint.size_px, clip_mm: viewpoint.clip_mm, ..Viewpoint::default() };
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::Event;

    #[test]
    fn keys_turn_move_enlarge_and_put_back() {
        let clip_mm = [20.0, 90.0];
        let mut viewpoint = Viewpoint { clip_mm, ..Viewpoint::default() };
        let start = viewpoint;
        let mut press = |modifiers, key| {
            let event = Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers };
            let mut input = InputState::default();
            input.events.push(event);
            steer_by_key(&mut input, &mut viewpoint);
            viewpoint
        };
        assert!(press(Modifiers::NONE, Key::ArrowLeft).yaw > start.yaw);
        let moved = press(Modifiers::SHIFT, Key::ArrowDown);
        assert!(moved.shift[1] > 0.0 && moved.pitch == start.pitch, "{moved:?}");
        assert!(press(Modifiers::NONE, Key::Plus).zoom > start.zoom);
        for _ in 0..60 {
            assert!(press(Modifiers::NONE, Key::ArrowDown).pitch <= PITCH);
        }
        assert_eq!(press(Modifiers::NONE, Key::Home), start);
    }
}
