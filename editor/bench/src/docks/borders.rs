//! The borders between parts: dragged, or moved by arrow keys.

use eframe::egui::{CursorIcon, EventFilter, Id, Key, Modifiers, Sense, Ui, WidgetInfo, WidgetType, vec2};

use super::{Docks, STEP, title};
use crate::docks::arrange::Border;
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Distance from the line within which the pointer takes it, points.
const REACH: f32 = 3.0;
/// Range of a size, points.
const SIZES: std::ops::RangeInclusive<f32> = 80.0..=4000.0;

impl Docks {
    /// Draws the borders and handles input on them.
    pub(super) fn show_borders(&mut self, ui: &mut Ui) {
        for border in self.borders.clone() {
            let across = if border.row { vec2(REACH, 0.0) } else { vec2(0.0, REACH) };
            let id = Id::new(("border", border.panels, border.row));
            let response = ui.interact(border.line.expand2(across), id, Sense::click_and_drag());
            let cursor = if border.row { CursorIcon::ResizeHorizontal } else { CursorIcon::ResizeVertical };
            let response = response.on_hover_and_drag_cursor(cursor);
            let [a, b] = border.panels.map(title);
            response.widget_info(|| {
                WidgetInfo::labeled(WidgetType::Slider, true, text!("panel-border", first = a, second = b))
            });
            let color = match (response.dragged() || response.has_focus(), response.hovered()) {
                (true, _) => theme::accent(),
                (_, true) => theme::muted(),
                _ => theme::line(),
            };
            ui.painter().rect_filled(border.line, 0.0, color);
            let mut by = if border.row { response.drag_delta().x } else { response.drag_delta().y };
            if response.has_focus() {
                let filter = EventFilter {
                    horizontal_arrows: border.row,
                    vertical_arrows: !border.row,
                    ..EventFilter::default()
                };
                ui.memory_mut(|memory| memory.set_focus_lock_filter(id, filter));
                let keys = if border.row { [Key::ArrowRight, Key::ArrowLeft] } else { [Key::ArrowDown, Key::ArrowUp] };
                let count = |key| ui.input_mut(|input| input.count_and_consume_key(Modifiers::NONE, key)) as f32;
                by += (count(keys[0]) - count(keys[1])) * STEP / 2.0;
            }
            if by != 0.0 {
                self.move_border(&border, by);
            }
        }
    }

    fn move_border(&mut self, border: &Border, by: f32) {
        let Some(parts) = self.layout.root.parts_at(&border.path) else { return };
        for (n, (part, size)) in border.between.iter().zip(border.sizes).enumerate() {
            let by = if n == 0 { by } else { -by };
            if let (Some(part), Some(size)) = (parts.get_mut(*part), size) {
                part.size = (size + by).clamp(*SIZES.start(), *SIZES.end());
            }
        }
    }
}
