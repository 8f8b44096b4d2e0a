//! Widgets for parameters, made from their declarations: unit, step, range, default.

use eframe::egui::{
    Align, Button, ComboBox, Context, Id, Layout, Response, RichText, Sense, Slider, SliderClamping, TextEdit, Ui,
    UiBuilder, WidgetInfo, WidgetType, vec2,
};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::numbers::drag_value;
use panoscope_graph::{Param, ParamKind, Pick};

use panoscope_editor_model::document::{Document, default_value};
use panoscope_editor_model::graph_view::NodeView;
use panoscope_editor_widgets::theme;
use panoscope_editor_widgets::unit_suffix;

/// A requested change of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The parameter.
    pub param: String,
    /// Its new value; `None` removes it from the file, so that the default applies.
    pub value: Option<toml::Value>,
}

/// A request about a parameter.
#[derive(Clone, Debug, PartialEq)]
pub enum ParamRequest {
    /// Change its value.
    Change(Change),
    /// Pick points or rectangles on an image.
    Pick(String),
    /// Pick a file.
    Browse(String),
}

/// Shows all parameters of a node; returns the user's requests.
pub fn show(ui: &mut Ui, document: &Document, node: &NodeView) -> Vec<ParamRequest> {
    let params = node.node_type.iter().flat_map(|t| &t.params);
    let one = |p: &Param| own_id(ui, node, p, |ui| one(ui, document, node, p, &title(p)));
    params.filter_map(one).collect()
}

/// Gives the widgets of a parameter identities of their own. By default they depend on how many widgets are above, and a slider would lose focus
/// and drag when a line such as "why it is idle" comes or goes there.
pub fn own_id<R>(ui: &mut Ui, node: &NodeView, param: &Param, add: impl FnOnce(&mut Ui) -> R) -> R {
    let id = Id::new(("parameter", node.id(), &param.name));
    ui.scope_builder(UiBuilder::new().id(id), add).inner
}

/// A parameter's name as a title, without the unit, which is shown after the value.
fn title(param: &Param) -> String {
    let unit = format!("_{}", param.unit.replace('/', "_"));
    let bare = param.name.strip_suffix(&unit).filter(|_| !param.unit.is_empty());
    bare.unwrap_or(&param.name).replace('_', " ")
}

/// Shows one parameter under `title`; returns the user's request.
pub fn one(ui: &mut Ui, document: &Document, node: &NodeView, param: &Param, title: &str) -> Option<ParamRequest> {
    let given = node.outline.params.get(&param.name);
    let value = given.cloned().unwrap_or_else(|| default_value(&param.kind));
    let differs = document.differs_from_file(node, &param.name);
    let (mut change, mut request) = (None, None);
    ui.spacing_mut().item_spacing.y = 2.0;
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 18.0;
        let color = if differs { theme::accent() } else { theme::text() };
        let hint = match param.reopen {
            true => format!("{}\n{}", param.doc, text!("param-reopens")),
            false => param.doc.clone(),
        };
        ui.label(RichText::new(title).color(color).size(12.5)).on_hover_text(hint);
        if differs {
            let (rect, dot) = ui.allocate_exact_size(vec2(8.0, 8.0), Sense::hover());
            ui.painter().circle_filled(rect.center(), 3.0, theme::accent());
            let caption = text!("param-differs", param = &param.name);
            dot.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, caption.clone()));
            dot.on_hover_text(text!("param-differs.hint"));
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let mut new = None;
            if let ParamKind::Bool { default } = &param.kind {
                let mut on = value.as_bool().unwrap_or(*default);
                let response = ui.checkbox(&mut on, "");
                name(&response, &param.name);
                new = response.changed().then(|| on.into());
            }
            if given.is_some() {
                let reset =
                    Button::new(RichText::new(text!("param-reset")).size(11.0).color(theme::muted())).frame(false);
                let reset = ui.add(reset).on_hover_text(text!("param-reset.hint"));
                let caption = text!("param-reset.name", param = &param.name);
                reset.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, caption.clone()));
                if reset.clicked() {
                    change = Some(Change { param: param.name.clone(), value: None });
                }
            }
            let on_image = |hint| (text!("param-pick"), hint, text!("param-pick.name", param = &param.name));
            let pick = match param.pick {
                Pick::Points => Some(on_image(text!("param-pick.points"))),
                Pick::Rectangles => Some(on_image(text!("param-pick.rectangles"))),
                Pick::File => {
                    let caption = text!("param-browse.name", param = &param.name);
                    Some((text!("param-browse"), text!("param-browse.hint"), caption))
                }
                Pick::None => None,
            };
            if let Some((words, hint, caption)) = pick {
                let button = Button::new(RichText::new(words).size(11.0).color(theme::accent())).frame(false);
                let button = ui.add(button).on_hover_text(hint);
                button.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, caption.clone()));
                if button.clicked() {
                    let name = param.name.clone();
                    request = Some(if param.pick == Pick::File {
                        ParamRequest::Browse(name)
                    } else {
                        ParamRequest::Pick(name)
                    });
                }
            }
            if new.is_some() {
                change = Some(Change { param: param.name.clone(), value: new });
            }
        });
    });
    if let Some(value) = widget(ui, param, &value) {
        change = Some(Change { param: param.name.clone(), value: Some(value) });
    }
    ui.add_space(2.0 * theme::STEP);
    request.or(change.map(ParamRequest::Change))
}

/// Shows the widget of one parameter; returns a new value.
fn widget(ui: &mut Ui, param: &Param, value: &toml::Value) -> Option<toml::Value> {
    let unit = unit_suffix(&param.unit);
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let label = param.name.clone();
    ui.spacing_mut().slider_width = (ui.available_width() - 92.0).max(60.0);
    let (response, new): (_, Option<toml::Value>) = match &param.kind {
        // The checkbox is shown beside the name.
        ParamKind::Bool { .. } => return None,
        ParamKind::Int { default, min, max, step } => {
            let number = value.as_integer().unwrap_or(*default);
            int_widget(ui, &label, &unit, number, (*min, *max), step.unwrap_or(1).max(1))
        }
        ParamKind::Float { default, min, max, step } => {
            let number = value.as_float().or(value.as_integer().map(|i| i as f64)).unwrap_or(*default);
            float_widget(ui, &label, &unit, number, (*min, *max), *step)
        }
        ParamKind::Choice { default, choices } => {
            let now = value.as_str().unwrap_or(default).to_owned();
            let mut picked = now.clone();
            let combo = ComboBox::from_id_salt("choice").selected_text(&now).width(ui.available_width() - 8.0);
            let response = combo.show_ui(ui, |ui| {
                for choice in choices {
                    ui.selectable_value(&mut picked, choice.clone(), choice);
                }
            });
            let new = (picked != now).then(|| picked.into());
            (response.response, new)
        }
        ParamKind::Text { default } | ParamKind::Path { default, .. } => {
            let now = value.as_str().unwrap_or(default);
            return text_field(ui, &label, now, |text| Some(text.into()));
        }
        ParamKind::Floats { default, .. } => {
            let numbers = value.as_array().map_or_else(
                || default.clone(),
                |a| a.iter().filter_map(|v| v.as_float().or(v.as_integer().map(|i| i as f64))).collect(),
            );
            let now = numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
            return text_field(ui, &label, &now, |text| {
                let parts = text.split([',', ' ']).filter(|p| !p.is_empty());
                let numbers: Option<Vec<f64>> = parts.map(|p| p.parse().ok()).collect();
                Some(numbers?.into())
            });
        }
    };
    if !matches!(param.kind, ParamKind::Int { .. } | ParamKind::Float { .. }) {
        name(&response, &label);
    }
    // Showing a rounded value must not change it.
    new.filter(|new| new != value)
}

/// A whole number with its unit: a slider and a field where it has both limits, else a field. Returns a new value.
fn int_widget(
    ui: &mut Ui,
    label: &str,
    unit: &str,
    mut number: i64,
    (min, max): (Option<i64>, Option<i64>),
    step: i64,
) -> (Response, Option<toml::Value>) {
    let response = if let (Some(min), Some(max)) = (min, max) {
        // Steps count from the minimum; egui's slider steps count from 0.
        let mut steps = (number - min).div_euclid(step);
        let before = steps;
        ui.horizontal(|ui| {
            let slider = Slider::new(&mut steps, 0..=(max - min).div_euclid(step));
            let slider = ui.add(slider.show_value(false).clamping(SliderClamping::Edits));
            if steps != before {
                number = min + steps * step;
            }
            let typed = drag_value(&mut number).range(min..=max).clamp_existing_to_range(false);
            let typed = ui.add(typed.speed(step as f64 / 8.0).suffix(unit));
            if typed.changed() {
                number = min + ((number - min) as f64 / step as f64).round() as i64 * step;
            }
            beside(slider, typed, label)
        })
        .inner
    } else {
        let range = min.unwrap_or(i64::MIN)..=max.unwrap_or(i64::MAX);
        let drag = ui.add(drag_value(&mut number).range(range).clamp_existing_to_range(false).suffix(unit));
        name(&drag, label);
        drag
    };
    let new = response.changed().then(|| number.into());
    (response, new)
}

/// As [`int_widget`] for a number. A range over three decades has a logarithmic slider.
fn float_widget(
    ui: &mut Ui,
    label: &str,
    unit: &str,
    mut number: f64,
    (min, max): (Option<f64>, Option<f64>),
    step: Option<f64>,
) -> (Response, Option<toml::Value>) {
    let response = if let (Some(min), Some(max)) = (min, max) {
        let is_wide = min > 0.0 && max / min >= 1000.0;
        ui.horizontal(|ui| {
            let slider = Slider::new(&mut number, min..=max).logarithmic(is_wide).show_value(false);
            let slider = slider.clamping(SliderClamping::Edits);
            let slider = ui.add(match step {
                Some(step) => slider.step_by(step),
                None => slider.max_decimals(3),
            });
            let speed = step.unwrap_or((max - min) / 500.0);
            let typed = drag_value(&mut number).range(min..=max).clamp_existing_to_range(false);
            let typed = ui.add(typed.speed(speed).max_decimals(3).suffix(unit));
            beside(slider, typed, label)
        })
        .inner
    } else {
        let range = min.unwrap_or(f64::MIN)..=max.unwrap_or(f64::MAX);
        let drag = drag_value(&mut number).range(range).clamp_existing_to_range(false);
        let drag = ui.add(drag.speed(step.unwrap_or(0.1)).suffix(unit));
        name(&drag, label);
        drag
    };
    let new = response.changed().then(|| number.into());
    (response, new)
}

/// Labels a slider and the number field beside it; a change of either counts.
fn beside(slider: Response, typed: Response, label: &str) -> Response {
    name(&typed, &text!("param-value", param = label));
    name(&slider, label);
    slider.union(typed)
}

/// Where the name of the parameter is kept whose widget is to get the keys when it is shown.
fn wanted() -> Id {
    Id::new("parameter that is searched")
}

/// Shows a parameter of the panel that is drawn next, and gives its widget the keys.
pub fn go_to(ctx: &Context, param: &str) {
    ctx.data_mut(|d| d.insert_temp(wanted(), param.to_owned()));
}

/// Labels a widget for screen readers and tests.
fn name(response: &Response, label: &str) {
    if response.ctx.data(|d| d.get_temp::<String>(wanted())).is_some_and(|param| param == label) {
        response.ctx.data_mut(|d| d.remove_temp::<String>(wanted()));
        response.request_focus();
        response.scroll_to_me(Some(Align::Center));
    }
    response.ctx.accesskit_node_builder(response.id, |node| node.set_label(label.to_owned()));
}

/// A text field whose value counts when Enter is pressed or the field loses the focus.
fn text_field(ui: &mut Ui, label: &str, now: &str, read: impl Fn(&str) -> Option<toml::Value>) -> Option<toml::Value> {
    let id = ui.make_persistent_id(("typed", label));
    let mut typed = ui.data(|d| d.get_temp::<String>(id)).unwrap_or_else(|| now.to_owned());
    let response = ui.add(TextEdit::singleline(&mut typed).desired_width(f32::INFINITY));
    name(&response, label);
    if response.has_focus() {
        ui.data_mut(|d| d.insert_temp(id, typed));
        return None;
    }
    ui.data_mut(|d| d.remove_temp::<String>(id));
    if response.lost_focus() && typed != now { read(&typed) } else { None }
}
