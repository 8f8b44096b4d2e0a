//! Draws the preset's settings as large sliders and switches, within the preset's ranges.

use eframe::egui::text::{LayoutJob, TextWrapping};
use eframe::egui::{
    Align2, Color32, CornerRadius, FontId, Key, Modifiers, Rect, Response, Sense, Stroke, StrokeKind, Ui, WidgetInfo,
    WidgetType, pos2, vec2,
};
use panoscope_editor_model::texts::{text, with_decimal_sign};
use panoscope_graph::edit::GraphEdit;
use panoscope_graph::{ParamKind, ParamValue};

use super::stage::capture_arrows;
use super::{Setting, Theatre};
use panoscope_editor_model::picture::short;
use panoscope_editor_widgets::theme;
use panoscope_editor_widgets::{format_time, unit_suffix};

/// Distance between the name of a setting and its value, points.
const LABEL_GAP: f32 = 8.0;

/// Number of steps of a slider whose parameter has no step.
const STEPS: f64 = 100.0;

/// The values of a slider.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Span {
    low: f64,
    high: f64,
    step: f64,
    whole: bool,
}

/// The range and step of a setting: the preset's range, else the declared one. `None` without a range.
fn span(setting: &Setting) -> Option<Span> {
    let (declared, step, whole) = match &setting.param.kind {
        ParamKind::Int { min, max, step, .. } => {
            (min.zip(*max).map(|(a, b)| (a as f64, b as f64)), step.map(|s| s as f64), true)
        }
        ParamKind::Float { min, max, step, .. } => (min.zip(*max), *step, false),
        _ => return None,
    };
    let (low, high) = setting.range.or(declared)?;
    let finest = if whole { 1.0 } else { (high - low) / STEPS };
    Some(Span { low, high, step: step.unwrap_or(finest).max(f64::MIN_POSITIVE), whole })
}

impl Span {
    /// The nearest allowed value. Steps count from `origin`, the declared minimum.
    fn snap(self, value: f64, origin: f64) -> f64 {
        let stepped = origin + ((value - origin) / self.step).round() * self.step;
        let inside = if stepped < self.low {
            stepped + self.step * ((self.low - stepped) / self.step).ceil()
        } else if stepped > self.high {
            stepped - self.step * ((stepped - self.high) / self.step).ceil()
        } else {
            stepped
        };
        inside.clamp(self.low, self.high)
    }

    fn value(self, number: f64) -> ParamValue {
        if self.whole { ParamValue::Int(number.round() as i64) } else { ParamValue::Float(number) }
    }
}

/// The value that steps count from.
fn origin(setting: &Setting) -> f64 {
    match &setting.param.kind {
        ParamKind::Int { min, .. } => min.unwrap_or(0) as f64,
        ParamKind::Float { min, .. } => min.unwrap_or(0.0),
        _ => 0.0,
    }
}

/// A value with its unit in the language of the window.
fn shown(value: &ParamValue, unit: &str) -> String {
    match value {
        ParamValue::Bool(true) => text!("setting-on").to_owned(),
        ParamValue::Bool(false) => text!("setting-off").to_owned(),
        ParamValue::Float(_) => with_decimal_sign(&message(value, unit)),
        _ => message(value, unit),
    }
}

/// A value with its unit, as the audit log has it.
pub(super) fn message(value: &ParamValue, unit: &str) -> String {
    let with_unit = |text: String| if unit.is_empty() { text } else { format!("{text} {unit}") };
    match value {
        ParamValue::Bool(on) => if *on { "on" } else { "off" }.to_owned(),
        ParamValue::Int(number) => with_unit(number.to_string()),
        ParamValue::Float(number) if unit == "ms" => format_time(*number),
        ParamValue::Float(number) => with_unit(short(*number)),
        ParamValue::Choice { name, .. } => name.replace('_', " "),
        _ => String::new(),
    }
}

/// Draws a setting with its value in `rect`; returns a new value when the user changes it.
pub fn show(ui: &mut Ui, rect: Rect, setting: &Setting, value: Option<&ParamValue>) -> Option<ParamValue> {
    let id = ui.id().with(("setting", &setting.node, &setting.param.name));
    let response = ui.interact(rect, id, Sense::click_and_drag());
    let painter = ui.painter().clone();
    let color = if response.has_focus() { theme::accent() } else { theme::muted() };
    let shown = value.map_or_else(|| "-".to_owned(), |v| shown(v, unit_suffix(&setting.param.unit)));
    let value_rect =
        painter.text(rect.right_top(), Align2::RIGHT_TOP, &shown, FontId::proportional(18.0), theme::text());
    let mut label = LayoutJob::simple_singleline(setting.label.clone(), FontId::proportional(16.0), color);
    label.wrap = TextWrapping::truncate_at_width((value_rect.left() - rect.left() - LABEL_GAP).max(1.0));
    painter.galley(rect.left_top(), painter.layout_job(label), color);
    let Some(value) = value else {
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Label, false, setting.label.clone()));
        return None;
    };
    if response.has_focus() {
        capture_arrows(ui, response.id);
    }
    match (span(setting), value) {
        (Some(span), ParamValue::Int(_) | ParamValue::Float(_)) => {
            let now = match value {
                ParamValue::Int(n) => *n as f64,
                ParamValue::Float(x) => *x,
                _ => return None,
            };
            slider(ui, rect, &response, setting, span, now)
        }
        (_, ParamValue::Bool(on)) => {
            let label = setting.label.clone();
            response.widget_info(|| WidgetInfo::selected(WidgetType::Checkbox, true, *on, label.clone()));
            switch(ui, rect, *on);
            response.clicked().then_some(ParamValue::Bool(!on))
        }
        (_, ParamValue::Choice { index, .. }) => {
            let ParamKind::Choice { choices, .. } = &setting.param.kind else { return None };
            let label = setting.label.clone();
            response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, label.clone()));
            let area = Rect::from_min_max(pos2(rect.left(), rect.bottom() - 32.0), rect.max);
            painter.rect_filled(area, 8.0, theme::raised());
            painter.text(
                area.center(),
                Align2::CENTER_CENTER,
                text!("setting-next"),
                FontId::proportional(15.0),
                theme::muted(),
            );
            let next = (index + 1) % choices.len().max(1);
            let name = choices.get(next)?.clone();
            response.clicked().then_some(ParamValue::Choice { index: next, name })
        }
        _ => None,
    }
}

fn slider(ui: &Ui, rect: Rect, response: &Response, setting: &Setting, span: Span, now: f64) -> Option<ParamValue> {
    let label = setting.label.clone();
    response.widget_info(|| WidgetInfo::slider(true, now, label.clone()));
    let rail = Rect::from_min_max(pos2(rect.left(), rect.bottom() - 28.0), rect.max).shrink2(vec2(14.0, 0.0));
    let share = ((now - span.low) / (span.high - span.low).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0) as f32;
    let x = rail.left() + share * rail.width();
    let y = rail.center().y;
    let painter = ui.painter();
    let line = |from: f32, to: f32| Rect::from_min_max(pos2(from, y - 4.0), pos2(to, y + 4.0));
    painter.rect_filled(line(rail.left() - 4.0, rail.right() + 4.0), CornerRadius::same(4), theme::raised());
    painter.rect_filled(line(rail.left() - 4.0, x), CornerRadius::same(4), theme::accent().gamma_multiply(0.7));
    painter.circle(pos2(x, y), 13.0, Color32::from_rgb(0xE8, 0xED, 0xF2), Stroke::new(2.0, theme::accent()));
    let dragged = response.is_pointer_button_down_on() || response.dragged() || response.clicked();
    let pointer = response.interact_pointer_pos().filter(|_| dragged);
    let wanted = pointer.map(|at| {
        let share = f64::from(((at.x - rail.left()) / rail.width().max(1.0)).clamp(0.0, 1.0));
        span.low + share * (span.high - span.low)
    });
    let by_key = |key| response.has_focus() && ui.ctx().input_mut(|i| i.consume_key(Modifiers::NONE, key));
    // At least a hundredth of the range, so that a key press has a visible effect.
    let stride = ((span.high - span.low) / STEPS / span.step).round().max(1.0) * span.step;
    let stepped = match () {
        () if by_key(Key::ArrowRight) => Some(now + stride),
        () if by_key(Key::ArrowLeft) => Some(now - stride),
        () => None,
    };
    let new = span.snap(wanted.or(stepped)?, origin(setting));
    ((new - now).abs() > span.step * 1e-6).then(|| span.value(new))
}

fn switch(ui: &Ui, rect: Rect, on: bool) {
    let track = Rect::from_min_size(pos2(rect.left(), rect.bottom() - 30.0), vec2(60.0, 28.0));
    let fill = if on { theme::accent().gamma_multiply(0.7) } else { theme::raised() };
    let painter = ui.painter();
    painter.rect(track, 14.0, fill, Stroke::new(1.0, theme::line()), StrokeKind::Inside);
    let x = if on { track.right() - 14.0 } else { track.left() + 14.0 };
    painter.circle_filled(pos2(x, track.center().y), 10.0, Color32::from_rgb(0xE8, 0xED, 0xF2));
}

impl Theatre {
    /// Current value of a setting: the one chosen in this window, else the running node's.
    pub(super) fn value(&self, setting: &Setting) -> Option<ParamValue> {
        if let Some(chosen) = self.chosen.get(&(setting.node.clone(), setting.param.name.clone())) {
            return Some(chosen.clone());
        }
        self.runner.values(&setting.node)?.into_iter().nth(setting.index)
    }

    /// Sets the value of a setting in the running graph; the file is not changed.
    pub fn choose(&mut self, node: &str, param: &str, value: ParamValue) {
        let Some(toml) = toml_of(&value) else { return };
        let text = GraphEdit::parse(&self.text).and_then(|mut edit| {
            edit.set_param(node, param, &toml)?;
            Ok(edit.text())
        });
        match text {
            Ok(text) => {
                self.audit.setting(node, param, &value);
                self.chosen.insert((node.to_owned(), param.to_owned()), value);
                self.run(text);
            }
            Err(error) => self.notify(error.to_string(), true),
        }
    }
}

/// A value of a setting as a file writes it.
pub(super) fn toml_of(value: &ParamValue) -> Option<toml::Value> {
    Some(match value {
        ParamValue::Bool(on) => (*on).into(),
        ParamValue::Int(number) => (*number).into(),
        ParamValue::Float(number) => (*number).into(),
        ParamValue::Choice { name, .. } => name.as_str().into(),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_graph::Param;

    fn setting(kind: ParamKind, range: Option<(f64, f64)>) -> Setting {
        let param = Param {
            name: "p".to_owned(),
            doc: String::new(),
            unit: "px".to_owned(),
            kind,
            reopen: false,
            pick: Default::default(),
            writes: false,
            shipped: false,
        };
        Setting { node: "n".to_owned(), param, index: 0, label: "P".to_owned(), range }
    }

    #[test]
    fn values_stay_inside_the_presets_range_and_on_the_declared_steps() {
        let kind = ParamKind::Int { default: 16, min: Some(16), max: Some(256), step: Some(16) };
        let s = setting(kind, Some((40.0, 120.0)));
        let span = span(&s).unwrap();
        assert_eq!((span.low, span.high, span.step), (40.0, 120.0, 16.0));
        let snapped: Vec<f64> = [0.0, 41.0, 70.0, 119.0, 500.0].map(|v| span.snap(v, origin(&s))).to_vec();
        assert_eq!(snapped, [48.0, 48.0, 64.0, 112.0, 112.0]);
        assert_eq!(span.value(48.0), ParamValue::Int(48));
    }

    #[test]
    fn what_has_no_range_has_no_slider() {
        let open = ParamKind::Float { default: 0.0, min: Some(0.0), max: None, step: None };
        assert_eq!(span(&setting(open.clone(), None)), None);
        assert!(span(&setting(open, Some((0.0, 1.0)))).is_some_and(|s| !s.whole));
        assert_eq!(message(&ParamValue::Float(3.25), "mm"), "3.25 mm");
    }
}
