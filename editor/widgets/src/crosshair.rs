//! A crosshair for choosing a point on an image by keys, without a pointer.

use eframe::egui::{Color32, InputState, Key, Modifiers, Painter, Rect, Stroke, pos2, vec2};

use crate::ARROWS;
use crate::theme;

/// Distance that an arrow key moves it, as a fraction of the image's width; a tenth of that with Shift.
const STRIDE: f32 = 0.02;
/// Outer and inner end of its lines, in points from the centre.
const REACH: (f32, f32) = (18.0, 5.0);

/// A position as fractions of an image's width and height; hidden until a key moves it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Crosshair {
    at: Option<[f32; 2]>,
}

impl Crosshair {
    /// Moves it by the arrow keys; the first one shows it in the centre. Returns its position when Enter is pressed. `aspect` is the image's
    /// width divided by its height.
    pub fn steer(&mut self, input: &mut InputState, aspect: f32) -> Option<[f32; 2]> {
        for (key, [x, y]) in ARROWS {
            for (modifiers, stride) in [(Modifiers::SHIFT, STRIDE / 10.0), (Modifiers::NONE, STRIDE)] {
                let count = input.count_and_consume_key(modifiers, key) as f32;
                if count == 0.0 {
                    continue;
                }
                let by = [x * stride * count, y * stride * count * aspect.max(1e-3)];
                self.at = Some(match self.at {
                    Some(at) => [0, 1].map(|k| (at[k] + by[k]).clamp(0.0, 1.0)),
                    None => [0.5, 0.5],
                });
            }
        }
        self.at.filter(|_| input.consume_key(Modifiers::NONE, Key::Enter))
    }

    /// Its position, as fractions of the image's width and height; `None` while it is hidden.
    pub fn position(&self) -> Option<[f32; 2]> {
        self.at
    }

    /// Draws it on an image that is drawn at `rect`.
    pub fn draw(&self, painter: &Painter, rect: Rect) {
        let Some([x, y]) = self.at else { return };
        let at = pos2(rect.left() + x * rect.width(), rect.top() + y * rect.height());
        let (far, near) = REACH;
        for stroke in [Stroke::new(5.0, Color32::from_black_alpha(160)), Stroke::new(2.0, theme::accent())] {
            for direction in [vec2(1.0, 0.0), vec2(-1.0, 0.0), vec2(0.0, 1.0), vec2(0.0, -1.0)] {
                painter.line_segment([at + direction * near, at + direction * far], stroke);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::Event;

    fn press(crosshair: &mut Crosshair, modifiers: Modifiers, key: Key) -> Option<[f32; 2]> {
        let event = Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers };
        let mut input = InputState::default();
        input.events.push(event);
        crosshair.steer(&mut input, 2.0)
    }

    #[test]
    fn it_moves_in_coarse_and_fine_steps_and_enter_chooses() {
        let mut crosshair = Crosshair::default();
        assert_eq!(press(&mut crosshair, Modifiers::NONE, Key::Enter), None, "nowhere yet");
        press(&mut crosshair, Modifiers::NONE, Key::ArrowRight);
        assert_eq!(crosshair.at, Some([0.5, 0.5]), "the first key shows it");
        press(&mut crosshair, Modifiers::NONE, Key::ArrowRight);
        press(&mut crosshair, Modifiers::SHIFT, Key::ArrowUp);
        let [x, y] = press(&mut crosshair, Modifiers::NONE, Key::Enter).expect("chosen");
        assert!((x - 0.52).abs() < 1e-6 && (y - 0.496).abs() < 1e-6, "{x} {y}");
        for _ in 0..60 {
            press(&mut crosshair, Modifiers::NONE, Key::ArrowLeft);
        }
        assert_eq!(crosshair.at.map(|at| at[0]), Some(0.0), "it stays on the picture");
    }
}
