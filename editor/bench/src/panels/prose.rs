//! Texts with commands and names in them.

use eframe::egui::{Color32, RichText, Ui, WidgetInfo, WidgetType, vec2};
use panoscope_editor_model::texts::text;

/// Shows a text. What is between backticks is in mono type, a command with a button that copies it.
pub(super) fn prose(ui: &mut Ui, text: &str, color: Color32) {
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing = vec2(0.0, 0.0);
        // Before the layout begins: its first row would be higher than the others.
        ui.spacing_mut().interact_size.y = 0.0;
        ui.horizontal_wrapped(|ui| {
            for (n, part) in text.split('`').enumerate() {
                // Between a pair of backticks.
                if n % 2 == 0 {
                    ui.label(RichText::new(part).size(12.0).color(color));
                    continue;
                }
                ui.label(RichText::new(part).monospace().size(11.5));
                if part.contains(' ') {
                    let copy = ui.small_button(text!("overview-copy"));
                    copy.widget_info(|| {
                        WidgetInfo::labeled(WidgetType::Button, true, text!("overview-copy.name", command = part))
                    });
                    if copy.clicked() {
                        ui.ctx().copy_text(part.to_owned());
                    }
                }
            }
        });
    });
}
