//! Zoom into the main view: by keys, wheel or pinch, moved by drags and arrow keys. The whole picture stays visible in a corner.

use eframe::egui::{InputState, Modifiers, Rect, Response, Ui, Vec2, pos2, vec2};
use panoscope_editor_widgets::ARROWS;

/// Largest magnification.
const MAX_COUNT: f32 = 8.0;
/// Factor of a key press.
const STEP: f32 = 1.25;
/// How far an arrow key moves the view, as a fraction of what is visible.
const STRIDE: f32 = 0.1;

/// The visible part of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zoom {
    /// Magnification, from 1.
    scale: f32,
    /// Middle of the visible part, as fractions of the picture's width and height.
    middle: Vec2,
}

impl Default for Zoom {
    fn default() -> Self {
        Self { scale: 1.0, middle: Vec2::splat(0.5) }
    }
}

impl Zoom {
    /// The magnification.
    pub fn scale(&self) -> f32 {
        self.scale
    }

    /// Whether only a part is visible.
    pub fn is_on(&self) -> bool {
        self.scale > 1.001
    }

    /// The visible part, as fractions of the picture's width and height.
    pub fn visible(&self) -> Rect {
        let size = Vec2::splat(1.0 / self.scale);
        Rect::from_center_size(self.middle.to_pos2(), size)
    }

    /// Zooms in by a step, or out.
    pub fn step(&mut self, closer: bool) {
        self.by(if closer { STEP } else { 1.0 / STEP }, Vec2::splat(0.5));
    }

    /// Zooms by a factor around a point of the picture's place, as fractions of it.
    fn by(&mut self, factor: f32, around: Vec2) {
        let before = self.visible();
        let fixed = before.min.to_vec2() + around * before.size();
        self.scale = (self.scale * factor).clamp(1.0, MAX_COUNT);
        self.middle = fixed + (Vec2::splat(0.5) - around) / self.scale;
        self.keep_inside();
    }

    fn keep_inside(&mut self) {
        let half = 0.5 / self.scale;
        self.middle = self.middle.clamp(Vec2::splat(half), Vec2::splat(1.0 - half));
    }

    /// Follows wheel, pinch and drags on a picture that is drawn at `rect`.
    pub fn steer(&mut self, ui: &Ui, response: &Response, rect: Rect) {
        let pointer = response.hover_pos().filter(|at| rect.contains(*at));
        if let Some(at) = pointer {
            let (pinch, wheel) = ui.input(|i| (i.zoom_delta(), i.smooth_scroll_delta().y));
            let factor = pinch * (wheel / 240.0).exp();
            if (factor - 1.0).abs() > 1e-4 {
                self.by(factor, (at - rect.min) / rect.size());
            }
        }
        if response.dragged() && self.is_on() {
            self.middle -= response.drag_delta() / rect.size() / self.scale;
            self.keep_inside();
        }
    }

    /// Follows the arrow keys while only a part is visible.
    pub fn steer_by_key(&mut self, input: &mut InputState) {
        if !self.is_on() {
            return;
        }
        for (key, [x, y]) in ARROWS {
            let count = input.count_and_consume_key(Modifiers::NONE, key) as f32;
            self.middle += vec2(x, y) * (STRIDE * count / self.scale);
        }
        self.keep_inside();
    }

    /// The visible part in a picture of the whole that is drawn at `rect`.
    pub fn frame_in(&self, rect: Rect) -> Rect {
        let part = self.visible();
        let at = |x: f32, y: f32| pos2(rect.left() + x * rect.width(), rect.top() + y * rect.height());
        Rect::from_min_max(at(part.left(), part.top()), at(part.right(), part.bottom()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_visible_part_stays_inside_and_keeps_its_fixed_point() {
        let mut zoom = Zoom::default();
        assert!(!zoom.is_on() && zoom.visible() == Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0)));
        zoom.by(2.0, vec2(0.25, 0.25));
        let part = zoom.visible();
        assert!((part.left() + 0.25 * part.width() - 0.25).abs() < 1e-6, "the point under the pointer stays: {part:?}");
        for _ in 0..40 {
            zoom.step(true);
            assert!(zoom.visible().min.x >= -1e-6 && zoom.visible().max.y <= 1.0 + 1e-6);
        }
        assert!((zoom.scale() - MAX_COUNT).abs() < 1e-3);
        for _ in 0..40 {
            zoom.step(false);
        }
        assert_eq!(zoom.visible(), Zoom::default().visible());
    }
}
