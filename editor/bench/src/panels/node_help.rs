//! The help of a node type: what it does, its ports and parameters with units and ranges, and graphs that use it. All from the one declaration.

use std::path::PathBuf;

use eframe::egui::{Grid, Label, RichText, ScrollArea, Ui, WidgetInfo, WidgetType};
use panoscope_editor_model::texts::{text, with_decimal_sign};
use panoscope_graph::{NodeType, Param, ParamKind, Port};

use super::inspector::section;
use panoscope_editor_model::picture::short;
use panoscope_editor_widgets::{theme, unit_suffix};

/// Maximum number of examples.
const MAX_EXAMPLES: usize = 6;
/// Width of the names of parameters, points.
const NAMES: f32 = 150.0;

/// A request of this panel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NodeHelpRequest {
    /// Open a graph in a window of its own.
    Open(PathBuf),
}

/// Shows the help of a type.
pub fn show(ui: &mut Ui, node_type: &NodeType, examples: &[PathBuf]) -> Option<NodeHelpRequest> {
    let mut request = None;
    let title = ui.label(RichText::new(&node_type.name).size(18.0));
    title.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, text!("help-of", type = &node_type.name)));
    let about = text!("help-about", family = &node_type.family, plugin = &node_type.plugin);
    let more = [
        (node_type.source, text!("help-source")),
        (node_type.exclusive, text!("help-device")),
        (node_type.side_effects, text!("help-acts")),
    ];
    let more = more.into_iter().filter(|(is_so, _)| *is_so).map(|(_, words)| words);
    let about = std::iter::once(about.as_str()).chain(more).collect::<Vec<_>>().join(", ");
    ui.label(RichText::new(about).size(12.0).color(theme::muted()));
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        ui.add_space(theme::STEP);
        ui.add(Label::new(RichText::new(&node_type.doc).size(13.0)).wrap());
        ports(ui, text!("node-inputs"), &node_type.inputs);
        ports(ui, text!("node-outputs"), &node_type.outputs);
        if !node_type.params.is_empty() {
            section(ui, text!("node-parameters"));
            params(ui, &node_type.params);
        }
        section(ui, text!("help-examples"));
        if examples.is_empty() {
            ui.label(RichText::new(text!("help-examples.none")).color(theme::muted()));
        }
        for example in examples.iter().take(MAX_EXAMPLES) {
            let name = example.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let button = ui.button(&name).on_hover_text(example.display().to_string());
            button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, text!("help-open", name = &name)));
            if button.clicked() {
                request = Some(NodeHelpRequest::Open(example.clone()));
            }
        }
    });
    request
}

fn params(ui: &mut Ui, params: &[Param]) {
    let width = (ui.available_width() - NAMES).max(160.0);
    Grid::new("params").num_columns(2).spacing([20.0, 8.0]).show(ui, |ui| {
        for param in params {
            ui.label(RichText::new(&param.name).color(theme::accent()));
            ui.vertical(|ui| {
                ui.set_width(width);
                ui.add(Label::new(RichText::new(&param.doc).size(12.5)).wrap());
                let limits = ui.label(RichText::new(limits_of(param)).size(12.0).color(theme::muted()));
                let name = text!("help-limits", param = &param.name, limits = limits_of(param));
                limits.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, name.clone()));
            });
            ui.end_row();
        }
    });
}

fn ports(ui: &mut Ui, caption: &str, ports: &[Port]) {
    if ports.is_empty() {
        return;
    }
    section(ui, caption);
    Grid::new(caption).num_columns(3).spacing([20.0, 6.0]).show(ui, |ui| {
        for port in ports {
            ui.label(RichText::new(&port.name).color(theme::packet(&port.packet.name)));
            let packet = port.packet.name.clone();
            let packet = if port.list { text!("help-list", packet = packet) } else { packet };
            let packet = if port.optional { text!("help-optional", packet = packet) } else { packet };
            ui.label(RichText::new(packet).size(12.0).color(theme::muted()));
            ui.add(Label::new(RichText::new(&port.doc).size(12.5)).wrap());
            ui.end_row();
        }
    });
}

/// Range, step and default of a parameter with its unit, such as `16 to 256 px in steps of 16; default 64 px`.
pub fn limits_of(param: &Param) -> String {
    let unit = unit_suffix(&param.unit);
    let with_unit = |text: String| if unit.is_empty() { text } else { format!("{text} {unit}") };
    let range = |low: Option<String>, high: Option<String>, kind: &str| match (low, high) {
        (Some(low), Some(high)) => with_unit(text!("limits-range", low = low, high = high)),
        (Some(low), None) => with_unit(text!("limits-from", low = low)),
        (None, Some(high)) => with_unit(text!("limits-to", high = high)),
        (None, None) => with_unit(kind.to_owned()),
    };
    let (limits, default) = match &param.kind {
        ParamKind::Bool { default } => {
            let default = if *default { text!("value-on") } else { text!("value-off") };
            (text!("limits-switch").to_owned(), default.to_owned())
        }
        ParamKind::Int { default, min, max, step } => {
            let mut limits = range(min.map(|m| m.to_string()), max.map(|m| m.to_string()), text!("limits-whole"));
            if let Some(step) = step.filter(|step| *step > 1) {
                limits = text!("limits-steps", range = limits, step = step);
            }
            (limits, with_unit(default.to_string()))
        }
        ParamKind::Float { default, min, max, .. } => {
            let short = |number: f64| with_decimal_sign(&short(number));
            (range(min.map(short), max.map(short), text!("limits-number")), with_unit(short(*default)))
        }
        ParamKind::Choice { default, choices } => (choices.join(", "), default.clone()),
        ParamKind::Text { default } => (text!("limits-text").to_owned(), quoted(default)),
        ParamKind::Path { default, must_exist } => {
            let kind = if *must_exist { text!("limits-file") } else { text!("limits-path") };
            (kind.to_owned(), quoted(default))
        }
        ParamKind::Floats { default, min_len, max_len } => {
            let count = match max_len {
                Some(max) if max == min_len => text!("limits-numbers", count = *max),
                Some(max) => text!("limits-numbers-range", low = *min_len, high = *max),
                None => text!("limits-any-numbers").to_owned(),
            };
            (with_unit(count), format!("{default:?}"))
        }
    };
    match param.reopen {
        true => text!("limits-default-reopens", limits = limits, value = default),
        false => text!("limits-default", limits = limits, value = default),
    }
}

fn quoted(text: &str) -> String {
    if text.is_empty() { text!("value-empty").to_owned() } else { format!("`{text}`") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_have_units_steps_and_defaults() {
        let param = |unit: &str, kind: ParamKind, reopen: bool| {
            let (name, doc, unit) = ("p".to_owned(), String::new(), unit.to_owned());
            limits_of(&Param { name, doc, unit, kind, reopen, pick: Default::default(), writes: false, shipped: false })
        };
        let int = ParamKind::Int { default: 64, min: Some(16), max: Some(256), step: Some(16) };
        assert_eq!(param("px", int, true), "16 to 256 px in steps of 16; default 64 px; a change reopens the node");
        let float = ParamKind::Float { default: 0.5, min: Some(0.0), max: None, step: None };
        assert_eq!(param("ratio", float, false), "from 0; default 0.50");
        let choice = ParamKind::Choice { default: "a".to_owned(), choices: vec!["a".to_owned(), "b".to_owned()] };
        assert_eq!(param("", choice, false), "a, b; default a");
    }
}
