//! Surfaces under the hand: turned, moved, enlarged.

use eframe::egui::{InputState, Key, Modifiers, PointerButton, Response, Ui};

use crate::ARROWS;
use panoscope_editor_model::surface::Sight;

/// Smallest and largest size.
const ZOOM: std::ops::RangeInclusive<f32> = 0.05..=12.0;
/// Farthest turn from above or below, radians.
const PITCH: f32 = 1.5;

/// A drag turns a surface, one with the right or middle button or with Shift moves it, the wheel and two fingers enlarge it, a double click puts
/// it back. `turn` is in radians per point.
pub fn steer(ui: &Ui, response: &Response, sight: &mut Sight, turn: f32) {
    let drag = response.drag_delta();
    let shift = ui.input(|i| i.modifiers.shift);
    if response.dragged_by(PointerButton::Primary) && !shift {
        sight.yaw -= drag.x * turn;
        sight.pitch = (sight.pitch + drag.y * turn).clamp(-PITCH, PITCH);
    } else if response.dragged() {
        let width = response.rect.width().max(1.0);
        sight.shift = [sight.shift[0] + drag.x / width, sight.shift[1] + drag.y / width];
    }
    if response.hovered() {
        let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta().y, i.zoom_delta()));
        sight.zoom = (sight.zoom * pinch * (scroll * 0.002).exp()).clamp(*ZOOM.start(), *ZOOM.end());
    }
    if response.double_clicked() {
        put_back(sight);
    }
}

/// Radians of one press of an arrow key, and part of the picture's width that it moves with Shift.
const KEY_TURN: f32 = 0.06;
const KEY_SHIFT: f32 = 0.02;
/// Steps of enlarging in an octave.
const KEY_ZOOM: f32 = 6.0;

/// Enlarges by steps, or makes smaller.
pub fn zoom_by(sight: &mut Sight, steps: f32) {
    sight.zoom = (sight.zoom * (steps / KEY_ZOOM).exp2()).clamp(*ZOOM.start(), *ZOOM.end());
}

/// The same by keys: arrows turn, with Shift they move, + and - enlarge, Home puts back.
pub fn steer_by_key(input: &mut InputState, sight: &mut Sight) {
    for (key, [x, y]) in ARROWS {
        let moved = input.count_and_consume_key(Modifiers::SHIFT, key) as f32 * KEY_SHIFT;
        sight.shift = [sight.shift[0] + x * moved, sight.shift[1] + y * moved];
        let turned = input.count_and_consume_key(Modifiers::NONE, key) as f32 * KEY_TURN;
        sight.yaw -= x * turned;
        sight.pitch = (sight.pitch + y * turned).clamp(-PITCH, PITCH);
    }
    for (key, steps) in [(Key::Plus, 1.0), (Key::Equals, 1.0), (Key::Minus, -1.0)] {
        zoom_by(sight, steps * input.count_and_consume_key(Modifiers::NONE, key) as f32);
    }
    if input.consume_key(Modifiers::NONE, Key::Home) {
        put_back(sight);
    }
}

/// As it is seen at first, with the same cuts.
fn put_back(sight: &mut Sight) {
    *sight = Sight { size_px: sight.size_px, clip_mm: sight.clip_mm, ..Sight::default() };
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::Event;

    #[test]
    fn keys_turn_move_enlarge_and_put_back() {
        let clip_mm = [20.0, 90.0];
        let mut sight = Sight { clip_mm, ..Sight::default() };
        let start = sight;
        let mut press = |modifiers, key| {
            let event = Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers };
            let mut input = InputState::default();
            input.events.push(event);
            steer_by_key(&mut input, &mut sight);
            sight
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
