//! The history of parameter changes, newest first. A click restores the values after a change.

use eframe::egui::{Button, Grid, RichText, ScrollArea, Ui, WidgetInfo, WidgetType};
use toml::Value;

use crate::actions::{self, Action};
use panoscope_editor_model::document::{Document, default_value};
use panoscope_editor_model::picture::short;
use panoscope_editor_model::texts::{text, with_decimal_sign};
use panoscope_editor_widgets::theme;

/// Maximum number of rows.
const MAX_ROWS: usize = 200;

/// Formats a value; `None` is the default.
fn format_value(document: &Document, node: &str, param: &str, value: Option<&Value>) -> String {
    let declared = || {
        let view = document.view();
        let node_type = view.nodes[view.node(node)?].node_type.as_ref()?;
        node_type.params.iter().find(|p| p.name == param).map(|p| default_value(&p.kind))
    };
    let shown = |value: &Value| match value {
        Value::Float(number) => with_decimal_sign(&short(*number)),
        Value::String(text) if text.is_empty() => text!("history-empty").to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    match value {
        Some(value) => shown(value),
        None => match declared() {
            Some(value) => text!("history-default-is", value = shown(&value)),
            None => text!("history-default").to_owned(),
        },
    }
}

/// Shows the panel; returns the number of changes to apply.
pub fn show(ui: &mut Ui, document: &Document) -> Option<usize> {
    let history = document.history();
    let (count, at) = (history.changes().len(), history.at());
    let mut go = None;
    ui.horizontal(|ui| {
        let back =
            ui.add_enabled(at > 0, Button::new(text!("history-back"))).on_hover_text(actions::hint(Action::Back));
        let forth = ui
            .add_enabled(at < count, Button::new(text!("history-forward")))
            .on_hover_text(actions::hint(Action::Forward));
        go = (back.clicked().then(|| at.saturating_sub(1))).or(forth.clicked().then_some(at + 1));
        let summary = match count {
            _ if at < count => text!("history-applied", at = at, count = count),
            _ => text!("history-count", count = count),
        };
        ui.label(RichText::new(summary).color(theme::muted()));
    });
    ui.add_space(theme::STEP);
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        Grid::new("history").num_columns(4).spacing([24.0, 4.0]).show(ui, |ui| {
            for (number, change) in history.changes().enumerate().rev().take(MAX_ROWS) {
                let applied = number < at;
                let [from, to] =
                    [&change.from, &change.to].map(|v| format_value(document, &change.node, &change.param, v.as_ref()));
                let name = format!("{}.{}", change.node, change.param);
                let color = if applied { theme::text() } else { theme::muted() };
                let tick = match change.tick {
                    Some(tick) => text!("history-tick", tick = tick),
                    None => text!("history-waits").to_owned(),
                };
                ui.label(RichText::new(tick).size(12.0).color(theme::muted()));
                ui.label(RichText::new(change.by.word()).size(12.0).color(theme::muted()));
                let last = applied && number + 1 == at;
                let button = Button::new(RichText::new(&name).size(12.5).color(color)).selected(last);
                let row = ui.add(button.frame_when_inactive(last)).on_hover_text(text!("history-restore"));
                let description = text!("history-change", number = number + 1, param = &name, from = &from, to = &to);
                row.widget_info(|| WidgetInfo::selected(WidgetType::Button, true, last, description.clone()));
                if row.clicked() {
                    go = Some(number + 1);
                }
                ui.label(RichText::new(text!("history-from-to", from = from, to = to)).size(12.5).color(color));
                ui.end_row();
            }
        });
    });
    go.filter(|go| *go != at)
}
