//! The form for arguments and overlays of a graph, as both windows show it.

use eframe::egui::{Align, ComboBox, Label, Layout, Response, RichText, ScrollArea, TextEdit, Ui};
use panoscope_editor_model::arguments::Form;
use panoscope_editor_model::texts::{text, with_decimal_sign};
use panoscope_graph::{Arg, ArgKind};

use crate::numbers::drag_value;
use crate::theme;

/// What the user asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FormRequest {
    /// Take the values.
    Apply,
    /// Leave everything as it is.
    Cancel,
    /// Pick a file for an argument.
    Browse(String),
}

/// How a form is shown.
#[derive(Clone, Copy, Debug)]
pub struct FormStyle<'a> {
    /// Caption of the button that takes the values.
    pub apply: &'a str,
    /// Whether files can be picked in a list.
    pub browse: bool,
    /// Size of the text in points.
    pub size: f32,
    /// Maximum height of the fields in points.
    pub height: f32,
}

/// Shows a form; returns what the user asks for.
pub fn show(ui: &mut Ui, form: &mut Form, style: FormStyle<'_>) -> Option<FormRequest> {
    let mut request = None;
    ScrollArea::vertical().max_height(style.height).auto_shrink([false, true]).show(ui, |ui| {
        overlays(ui, form, style);
        for arg in form.args.clone() {
            ui.push_id(&arg.name, |ui| {
                if let Some(asked) = field(ui, form, &arg, style) {
                    request = Some(asked);
                }
            });
            ui.add_space(1.5 * theme::STEP);
        }
    });
    let small = theme::legible(ui.ctx(), SMALL * style.size);
    for problem in &form.problems {
        ui.add(Label::new(RichText::new(problem).size(style.size).color(theme::fault())).wrap());
    }
    ui.add_space(theme::STEP);
    ui.horizontal(|ui| {
        let button = |ui: &mut Ui, caption: &str| ui.button(RichText::new(caption).size(style.size)).clicked();
        if button(ui, style.apply) {
            request = Some(FormRequest::Apply);
        }
        if button(ui, text!("form-cancel")) {
            request = Some(FormRequest::Cancel);
        }
        ui.label(RichText::new(text!("form-unchanged")).size(small).color(theme::muted()));
    });
    request
}

fn overlays(ui: &mut Ui, form: &mut Form, style: FormStyle<'_>) {
    if form.overlays.is_empty() {
        return;
    }
    ui.label(RichText::new(text!("form-overlays")).size(style.size).strong());
    let now = form.chosen().map(|overlay| overlay.path.clone());
    let own = ui.radio(now.is_none(), RichText::new(text!("form-own")).size(style.size));
    if own.clicked() {
        form.choose(None);
    }
    for overlay in form.overlays.clone() {
        let is_chosen = now.as_ref() == Some(&overlay.path);
        let caption = RichText::new(&overlay.name).size(style.size);
        let response = ui.radio(is_chosen, caption).on_hover_text(&overlay.doc);
        name(&response, &text!("form-overlay", name = &overlay.name));
        if response.clicked() && !is_chosen {
            form.choose(Some(&overlay.path));
        }
    }
    ui.add_space(2.0 * theme::STEP);
}

/// Size of details, as a fraction of the size of the text.
const SMALL: f32 = 0.85;
/// Room for a button beside a field, points.
const FIELD_BUTTON: f32 = 84.0;

/// Shows one argument with its documentation, unit, range and default.
fn field(ui: &mut Ui, form: &mut Form, arg: &Arg, style: FormStyle<'_>) -> Option<FormRequest> {
    let mut request = None;
    let small = theme::legible(ui.ctx(), SMALL * style.size);
    heading(ui, form, arg, style);
    if !arg.doc.is_empty() {
        ui.add(Label::new(RichText::new(&arg.doc).size(small).color(theme::muted())).wrap());
    }
    let now = form.values.get(&arg.name).cloned().or_else(|| arg.default.clone()).unwrap_or_default();
    let new = match arg.kind {
        ArgKind::Flag => {
            let mut on = now == "true";
            let response = ui.checkbox(&mut on, "");
            name(&response, &text!("form-argument", argument = &arg.name));
            response.changed().then(|| on.to_string())
        }
        ArgKind::Choice => {
            let mut picked = now.clone();
            let combo = ComboBox::from_id_salt("choice").selected_text(&now).width(ui.available_width() - 8.0);
            let response = combo.show_ui(ui, |ui| {
                for choice in &arg.choices {
                    ui.selectable_value(&mut picked, choice.clone(), choice);
                }
            });
            name(&response.response, &text!("form-argument", argument = &arg.name));
            (picked != now).then_some(picked)
        }
        ArgKind::Number | ArgKind::Whole => number(ui, arg, &now),
        ArgKind::Source | ArgKind::File | ArgKind::Path | ArgKind::Text => {
            let (typed, asked) = text_field(ui, form, arg, style);
            request = asked;
            typed
        }
    };
    if let Some(new) = new {
        form.values.insert(arg.name.clone(), new);
        form.problems.clear();
    }
    request
}

/// Shows the name of an argument, its state, range and unit, and a button that clears it.
fn heading(ui: &mut Ui, form: &mut Form, arg: &Arg, style: FormStyle<'_>) {
    let small = theme::legible(ui.ctx(), SMALL * style.size);
    let is_given = form.values.get(&arg.name).is_some_and(|v| !v.is_empty());
    ui.horizontal(|ui| {
        ui.label(RichText::new(arg.name.replace('_', " ")).size(style.size).strong());
        let is_required = form.required.contains(&arg.name);
        let (state, color) = match (is_given, &arg.default) {
            (true, Some(default)) => (text!("form-default-is", value = default), theme::muted()),
            (false, Some(_)) => (text!("form-default").to_owned(), theme::muted()),
            (true, None) => (String::new(), theme::muted()),
            (false, None) if is_required => (text!("form-required").to_owned(), theme::warn()),
            (false, None) => (text!("form-not-used").to_owned(), theme::muted()),
        };
        ui.label(RichText::new(state).size(small).color(color));
        let range = arg.range.map(|(low, high)| {
            let [low, high] = [low, high].map(|limit| with_decimal_sign(&limit.to_string()));
            text!("form-range", low = low, high = high)
        });
        let limits = [range.as_deref(), Some(arg.unit.as_str())];
        let limits: Vec<&str> = limits.into_iter().flatten().filter(|t| !t.is_empty()).collect();
        ui.label(RichText::new(limits.join(" ")).size(small).color(theme::muted()));
        if is_given {
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                let clear = ui.small_button(text!("form-clear")).on_hover_text(text!("form-clear.hint"));
                name(&clear, &text!("form-clear.name", argument = &arg.name));
                if clear.clicked() {
                    form.values.remove(&arg.name);
                }
            });
        }
    });
}

/// Shows a field for text, with buttons for cameras and files where the argument takes them. Returns a new text.
fn text_field(ui: &mut Ui, form: &Form, arg: &Arg, style: FormStyle<'_>) -> (Option<String>, Option<FormRequest>) {
    let mut request = None;
    let mut typed = form.values.get(&arg.name).cloned().unwrap_or_default();
    let before = typed.clone();
    ui.horizontal(|ui| {
        let devices = &form.devices;
        let pick_camera = arg.kind == ArgKind::Source && !devices.is_empty();
        let pick_file = style.browse && arg.kind != ArgKind::Text;
        let room = FIELD_BUTTON * f32::from(u8::from(pick_camera) + u8::from(pick_file));
        let hint = arg.default.clone().unwrap_or_default();
        let field = TextEdit::singleline(&mut typed).hint_text(hint).desired_width(ui.available_width() - room - 16.0);
        let field = ui.add(field.font(eframe::egui::FontId::proportional(style.size)));
        name(&field, &text!("form-argument", argument = &arg.name));
        if pick_camera {
            let menu = ui.menu_button(text!("form-cameras"), |ui| {
                for (device, model) in devices {
                    if ui.button(format!("{device}  {model}")).clicked() {
                        typed.clone_from(device);
                    }
                }
            });
            name(&menu.response, &text!("form-cameras.name", argument = &arg.name));
        }
        if pick_file {
            let browse = ui.button(text!("form-browse"));
            name(&browse, &text!("form-browse.name", argument = &arg.name));
            if browse.clicked() {
                request = Some(FormRequest::Browse(arg.name.clone()));
            }
        }
    });
    ((typed != before).then_some(typed), request)
}

/// Shows a number within its range.
fn number(ui: &mut Ui, arg: &Arg, now: &str) -> Option<String> {
    let mut number: f64 = now.parse().unwrap_or(arg.range.map_or(0.0, |(low, _)| low));
    let (low, high) = arg.range.unwrap_or((f64::MIN, f64::MAX));
    let unit = if arg.unit.is_empty() { String::new() } else { format!(" {}", arg.unit) };
    let whole = arg.kind == ArgKind::Whole;
    let speed = arg.range.map_or(0.1, |(low, high)| (high - low) / 500.0);
    let drag = drag_value(&mut number).range(low..=high).clamp_existing_to_range(false).suffix(unit);
    let drag = if whole { drag.speed(speed.max(0.25)).max_decimals(0) } else { drag.speed(speed).max_decimals(4) };
    let response = ui.add(drag);
    name(&response, &text!("form-argument", argument = &arg.name));
    response.changed().then(|| if whole { format!("{}", number.round()) } else { format!("{number}") })
}

/// Labels a widget for screen readers and tests.
fn name(response: &Response, label: &str) {
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label(label.to_owned()));
}
