//! The panel of the selected node: preview, times, inputs, parameters.

use std::collections::HashMap;

use eframe::egui::{
    Align, Button, ComboBox, Grid, Image, Label, Layout, RichText, ScrollArea, Sense, Ui, WidgetInfo, WidgetType, vec2,
};

use panoscope_editor_model::texts::{decimal, text, with_decimal_sign};
use panoscope_eval::sweep::can_sweep;

use super::params;
use super::prose::prose;
use crate::actions::{self, Action};
use crate::canvas::Canvas;
use crate::probing;
use panoscope_editor_model::document::Document;
use panoscope_editor_model::graph_view::{GraphView, NodeView, PartView, without_name};
use panoscope_editor_model::idle;
use panoscope_editor_model::observe::{Counters, Output};
use panoscope_editor_model::probe::Probe;
use panoscope_editor_model::problems::{action_name, cause_name};
use panoscope_editor_model::session::{Phase, Status};
use panoscope_editor_widgets::theme;
use panoscope_editor_widgets::{OutputCache, format_time};

/// A request about the selected node.
#[derive(Clone, Debug, PartialEq)]
pub enum InspectorRequest {
    /// A request about a parameter.
    Param(params::ParamRequest),
    /// Sweep one of its parameters.
    Sweep,
    /// Connect an input to an output, or disconnect it.
    Input {
        /// The input.
        input: String,
        /// Index in a list.
        index: usize,
        /// The output; `None` to disconnect.
        from: Option<Output>,
    },
    /// Show an output in the viewer.
    ViewLarge(Output),
    /// Read the value at this point of the picture, as fractions of its width and height.
    Probe([f32; 2]),
    /// Show this output on the node.
    Thumbnail(String),
    /// Rename the node.
    Rename(String),
    /// Go to another node.
    Go(String),
    /// Show why its newest dropped tick was dropped.
    Trace,
    /// Show the help of its type.
    Help,
    /// Open its source.
    Source,
    /// Open the part.
    Open,
    /// Put the part's nodes in its place.
    Dissolve,
    /// Take its fault out of the picture.
    Acknowledge,
}

/// Shows the panel of a node; returns the user's requests.
pub fn show(
    ui: &mut Ui,
    document: &Document,
    (counters, status): (&Counters, &Status),
    shown: (&OutputCache, &HashMap<Output, Probe>),
    canvas: &Canvas,
    (node, is_python): (usize, bool),
) -> Vec<InspectorRequest> {
    let view = document.view();
    let this = &view.nodes[node];
    let mut requests = Vec::new();
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        title(ui, this, is_python, &mut requests);
        picture(ui, document, shown, canvas, node, &mut requests);
        if let Some(part) = view.part(this.id()).filter(|_| this.is_part) {
            part_buttons(ui, part, &mut requests);
        }
        for mistake in &this.mistakes {
            let color = if view.is_unfinished_at(node) { theme::muted() } else { theme::fault() };
            ui.add(Label::new(RichText::new(without_name(mistake, this.id())).color(color)).wrap());
        }
        why_idle(ui, (view, counters, status), this, &mut requests);
        numbers(ui, counters, this, &mut requests);
        let node_type = this.node_type.as_ref();
        if node_type.is_some_and(|t| !t.inputs.is_empty()) {
            section(ui, text!("node-inputs"));
            inputs(ui, document, node, &mut requests);
        }
        if node_type.is_some_and(|t| !t.params.is_empty()) {
            section(ui, text!("node-parameters"));
            if node_type.is_some_and(|t| t.params.iter().any(|p| can_sweep(&p.kind))) {
                let button = Button::new(RichText::new(text!("node-sweep")).size(11.0).color(theme::accent()));
                let sweep = ui.add(button.frame(false)).on_hover_text(actions::hint(Action::Sweep));
                sweep.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, text!("node-sweep.name")));
                if sweep.clicked() {
                    requests.push(InspectorRequest::Sweep);
                }
                ui.add_space(theme::STEP);
            }
            requests.extend(params::show(ui, document, this).into_iter().map(InspectorRequest::Param));
        }
        ui.add_space(6.0 * theme::STEP);
    });
    requests
}

/// Shows the heading of a section.
pub fn section(ui: &mut Ui, caption: &str) {
    ui.add_space(3.0 * theme::STEP);
    ui.label(RichText::new(caption.to_uppercase()).size(11.0).color(theme::muted()).extra_letter_spacing(0.8));
    ui.add_space(theme::STEP / 2.0);
}

fn title(ui: &mut Ui, this: &NodeView, is_python: bool, requests: &mut Vec<InspectorRequest>) {
    ui.horizontal(|ui| {
        let (rect, _) = ui.allocate_exact_size(vec2(4.0, 20.0), Sense::hover());
        ui.painter().rect_filled(rect, 2.0, theme::family(this.family()));
        let id = ui.make_persistent_id(("name", this.id()));
        let local = this.id().rsplit('/').next().unwrap_or_default();
        let mut name = ui.data(|d| d.get_temp::<String>(id)).unwrap_or_else(|| local.to_owned());
        let field = eframe::egui::TextEdit::singleline(&mut name)
            .font(eframe::egui::TextStyle::Heading)
            .frame(eframe::egui::Frame::NONE)
            .desired_width(f32::INFINITY);
        let response = ui.add(field).on_hover_text(text!("node-name.hint"));
        response.ctx.accesskit_node_builder(response.id, |node| node.set_label(text!("node-name")));
        if response.has_focus() {
            ui.data_mut(|d| d.insert_temp(id, name));
        } else {
            ui.data_mut(|d| d.remove_temp::<String>(id));
            if response.lost_focus() && name != local {
                requests.push(InspectorRequest::Rename(name));
            }
        }
    });
    let caption = match &this.node_type {
        Some(t) => format!("{} · {}", t.name, t.plugin),
        None => text!("node-unknown", type = &this.outline.type_name),
    };
    ui.horizontal(|ui| {
        ui.label(RichText::new(caption).size(11.5).color(theme::muted()));
        let mut link = |caption: &str, name: &str, action, request| {
            let button = Button::new(RichText::new(caption).size(11.0).color(theme::accent())).frame(false);
            let button = ui.add(button).on_hover_text(actions::hint(action));
            button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, name.to_owned()));
            if button.clicked() {
                requests.push(request);
            }
        };
        if this.node_type.is_some() && !this.is_part {
            link(text!("node-help"), text!("node-help.name"), Action::NodeHelp, InspectorRequest::Help);
        }
        if is_python {
            link(text!("node-source"), text!("node-source.name"), Action::Source, InspectorRequest::Source);
        }
    });
    if let Some(line) = this.node_type.as_ref().and_then(|t| t.doc.lines().next()) {
        prose(ui, line, theme::text());
    }
    ui.add_space(theme::STEP);
}

/// Shows what can be done with a part, and how often its file is used.
fn part_buttons(ui: &mut Ui, part: &PartView, requests: &mut Vec<InspectorRequest>) {
    ui.horizontal(|ui| {
        if ui.button(text!("part-open")).on_hover_text(actions::hint(Action::OpenPart)).clicked() {
            requests.push(InspectorRequest::Open);
        }
        if ui.button(text!("part-dissolve")).on_hover_text(actions::hint(Action::Dissolve)).clicked() {
            requests.push(InspectorRequest::Dissolve);
        }
        if part.users.len() > 1 {
            let caption = text!("part-users", count = part.users.len());
            ui.label(RichText::new(caption).size(12.0).color(theme::warn())).on_hover_text(part.users.join(", "));
        }
    });
}

fn picture(
    ui: &mut Ui,
    document: &Document,
    (shown, probes): (&OutputCache, &HashMap<Output, Probe>),
    canvas: &Canvas,
    node: usize,
    requests: &mut Vec<InspectorRequest>,
) {
    let view = document.view();
    let Some((output, _)) = canvas.shown_output(view, node) else { return };
    let width = ui.available_width();
    if let Some((texture, size)) = shown.texture(&output) {
        let fit = (width / size.x).min(240.0 / size.y);
        let image = Image::new((texture, size * fit)).corner_radius(4.0).sense(Sense::click());
        let response = ui.add(image).on_hover_text(text!("node-picture.hint"));
        let caption = text!("node-picture", output = output.to_string());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, caption.clone()));
        if let Some(at) = response.hover_pos() {
            let share = (at - response.rect.min) / response.rect.size();
            requests.push(InspectorRequest::Probe([share.x, share.y]));
        }
        if response.clicked() {
            requests.push(InspectorRequest::ViewLarge(output.clone()));
        }
        if let Some(probe) = probes.get(&output) {
            // The line is always there, so that nothing moves under the pointer.
            let words = probe.words().unwrap_or_else(|| text!("node-picture.probe").to_owned());
            let color = if probe.at.is_some() { theme::text() } else { theme::muted() };
            ui.label(RichText::new(words).size(12.0).color(color));
            probing::histogram(ui, probe);
        }
    }
    if let Some(caption) = shown.text(&output) {
        ui.label(RichText::new(caption).size(12.0).color(theme::muted()));
    }
    let outputs = view.nodes[node].node_type.as_ref().map_or(&[][..], |t| &t.outputs);
    if outputs.len() > 1 {
        let combo = ComboBox::from_id_salt("shown").selected_text(&output.port).width(width - 8.0);
        let response = combo.show_ui(ui, |ui| {
            for port in outputs {
                let caption = format!("{} ({})", port.name, port.packet.name);
                if ui.selectable_label(port.name == output.port, caption).clicked() {
                    requests.push(InspectorRequest::Thumbnail(port.name.clone()));
                }
            }
        });
        let id = response.response.id;
        ui.ctx().accesskit_node_builder(id, |node| node.set_label(text!("node-output")));
    }
}

/// Says why the node does nothing, where it does not.
fn why_idle(
    ui: &mut Ui,
    (view, counters, status): (&GraphView, &Counters, &Status),
    this: &NodeView,
    requests: &mut Vec<InspectorRequest>,
) {
    if this.is_part || !matches!(status.phase, Phase::Running) {
        return;
    }
    let Some(reason) = idle::reason(view, counters, status, this.id()) else { return };
    section(ui, text!("node-idle"));
    let caption = RichText::new(&reason.words).size(12.0).color(theme::warn());
    ui.add(Label::new(caption).wrap());
    if let Some(cause) = reason.cause
        && ui.small_button(text!("go-to", node = &cause)).clicked()
    {
        requests.push(InspectorRequest::Go(cause));
    }
}

fn numbers(ui: &mut Ui, counters: &Counters, this: &NodeView, requests: &mut Vec<InspectorRequest>) {
    let Some(c) = counters.nodes.get(this.id()) else { return };
    ui.add_space(theme::STEP);
    let mut rows: Vec<(&str, String)> = vec![
        (text!("node-rate"), text!("node-rate-is", rate = decimal(c.fps, 1))),
        (text!("node-time"), text!("node-median", median = format_time(c.p50_ms), slow = format_time(c.p99_ms))),
    ];
    if let (Some(p50), Some(p99)) = (c.age_p50_ms, c.age_p99_ms) {
        rows.push((text!("node-age"), text!("node-median", median = format_time(p50), slow = format_time(p99))));
    }
    rows.push((text!("node-ticks"), text!("node-ticks-are", count = c.count, dropped = c.dropped)));
    if c.copies > 0 {
        rows.push((text!("node-copies"), c.copies.to_string()));
    }
    for (name, value) in c.metrics.iter().take(8) {
        rows.push((name, with_decimal_sign(&panoscope_editor_model::picture::short(*value))));
    }
    Grid::new("numbers").num_columns(2).spacing([16.0, 4.0]).show(ui, |ui| {
        for (name, value) in rows {
            ui.label(RichText::new(name).size(12.0).color(theme::muted()));
            ui.label(RichText::new(value).size(12.0));
            ui.end_row();
        }
    });
    if c.dropped > 0 && !this.is_part {
        let button = Button::new(RichText::new(text!("node-trace")).size(11.0).color(theme::accent())).frame(false);
        let button = ui.add(button).on_hover_text(actions::hint(Action::Trace));
        button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, text!("node-trace.name")));
        if button.clicked() {
            requests.push(InspectorRequest::Trace);
        }
    }
    if let Some(fault) = counters.faults.get(this.id()) {
        section(ui, text!("node-fault"));
        let words = without_name(&fault.words, this.id());
        ui.add(Label::new(RichText::new(words).size(12.0).color(theme::warn())).wrap());
        let caption = text!(
            "node-fault-is",
            cause = cause_name(fault.cause),
            count = c.faults.max(fault.count),
            done = action_name(fault.done)
        );
        ui.label(RichText::new(caption).size(11.5).color(theme::muted()));
        if ui.button(text!("node-fault.seen")).on_hover_text(actions::hint(Action::Acknowledge)).clicked() {
            requests.push(InspectorRequest::Acknowledge);
        }
    }
}

/// Shows a row for each entry of each input, with the outputs that fit.
fn inputs(ui: &mut Ui, document: &Document, node: usize, requests: &mut Vec<InspectorRequest>) {
    let view = document.view();
    let this = &view.nodes[node];
    let Some(node_type) = &this.node_type else { return };
    for port in &node_type.inputs {
        let wires: Vec<_> = view.wires_into(node, &port.name).collect();
        let places = if port.list { wires.len() + 1 } else { 1 };
        for index in 0..places {
            let from = wires.get(index).map(|w| Output::new(view.nodes[w.from].id(), &w.output));
            let name = if port.list { format!("{} {}", port.name, index + 1) } else { port.name.clone() };
            ui.horizontal(|ui| {
                let color = if from.is_none() && !port.optional { theme::fault() } else { theme::muted() };
                let label = RichText::new(name.replace('_', " ")).size(12.0).color(color);
                ui.allocate_ui_with_layout(vec2(88.0, 24.0), Layout::left_to_right(Align::Center), |ui| {
                    ui.set_min_width(88.0);
                    let label = ui.add(Label::new(label).truncate());
                    label.on_hover_text(format!("{} ({})", port.doc, port.packet.name));
                });
                let now = from.as_ref().map_or_else(|| text!("node-not-connected").to_owned(), Output::to_string);
                let combo =
                    ComboBox::from_id_salt((&port.name, index)).selected_text(now).width(ui.available_width() - 8.0);
                let response = combo.show_ui(ui, |ui| {
                    if from.is_some() && ui.selectable_label(false, text!("node-not-connected")).clicked() {
                        requests.push(InspectorRequest::Input { input: port.name.clone(), index, from: None });
                    }
                    for output in candidates(document, node, &port.name) {
                        let same = from.as_ref() == Some(&output);
                        if ui.selectable_label(same, output.to_string()).clicked() && !same {
                            requests.push(InspectorRequest::Input {
                                input: port.name.clone(),
                                index,
                                from: Some(output),
                            });
                        }
                    }
                });
                let id = response.response.id;
                ui.ctx().accesskit_node_builder(id, |n| {
                    n.set_label(text!("node-input", input = format!("{}.{name}", this.id())))
                });
            });
        }
    }
}

/// The outputs that fit an input.
pub fn candidates(document: &Document, node: usize, input: &str) -> Vec<Output> {
    let view = document.view();
    let mut found = Vec::new();
    for (from, other) in view.nodes.iter().enumerate().filter(|(n, _)| *n != node) {
        for port in other.node_type.iter().flat_map(|t| &t.outputs) {
            if view.check_wire(from, &port.name, node, input).is_ok() {
                found.push(Output::new(other.id(), &port.name));
            }
        }
    }
    found
}
