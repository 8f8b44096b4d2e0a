//! The emergency stop of a robot arm in the graph: one tap stops it, holding releases it.

use eframe::egui::{
    Color32, Context, InputState, Key, Painter, Pos2, Rect, Response, Sense, Shape, Stroke, StrokeKind, Ui, WidgetInfo,
    WidgetType, pos2, vec2,
};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;
use panoscope_graph::ParamValue;
use panoscope_graph::edit::GraphEdit;
use panoscope_host::audit::Event;

use super::marks::{fitting, focus_frame};
use super::{Action, HOLD, Theatre, actions, key_name, plan, time};

/// Height of a stop button, points, from which its two texts are one above the other.
const TWO_LINES: f32 = 54.0;

pub(super) const STOP_RED: Color32 = Color32::from_rgb(0xD6, 0x2F, 0x1F);

impl Theatre {
    /// Stops the arm at once, or releases it.
    pub fn emergency_stop(&mut self, on: bool) {
        if self.plan.stops.is_empty() {
            return;
        }
        self.emergency = on;
        let mut resets = Vec::new();
        for stop in &self.plan.stops {
            // Takes effect at once, even while a change of the graph is being applied.
            self.runner.set_at_once(&stop.node, plan::EMERGENCY_STOP, on);
            let values = self.runner.values(&stop.node);
            if let Some(ParamValue::Int(number)) = stop.reset.and_then(|at| values?.into_iter().nth(at))
                && !on
            {
                resets.push((stop.node.clone(), number.wrapping_add(1).max(0)));
            }
        }
        let stops = &self.plan.stops;
        let text = GraphEdit::parse(&self.text).and_then(|mut edit| {
            stops.iter().try_for_each(|stop| edit.set_param(&stop.node, plan::EMERGENCY_STOP, &on.into()))?;
            resets.iter().try_for_each(|(node, number)| edit.set_param(node, plan::RESET, &(*number).into()))?;
            Ok(edit.text())
        });
        match text {
            // Also set in the graph's text, so that later changes of the graph keep it.
            Ok(text) => self.run(text),
            Err(error) => self.notify(error.to_string(), true),
        }
        self.audit.log(Event::EmergencyStop { stopped: on });
        self.see_refused_stops();
    }

    /// Releases the arm once the button or the key was held long enough.
    fn release(&mut self, ctx: &Context, held: bool) {
        let held = held || ctx.input(|i| actions::is_held(i, Action::Stop, &self.pedal.keys));
        match self.releasing {
            Some(_) if !held => self.releasing = None,
            Some(since) if time::since(since) >= HOLD => {
                self.releasing = None;
                self.emergency_stop(false);
            }
            Some(_) => ctx.request_repaint(),
            None => {}
        }
    }

    /// Whether the arm was stopped from this window.
    pub fn is_stopped(&self) -> bool {
        self.emergency
    }

    /// The stop button, always visible while the graph has an arm. One tap stops the arm; holding releases it.
    pub(super) fn stop_button(&mut self, ui: &mut Ui, rect: Rect) {
        let response = ui.interact(rect, ui.id().with("stop"), Sense::click_and_drag());
        let label = if self.emergency { text!("stop-arm.release") } else { text!("stop-arm.name") };
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, label));
        let held = is_pressed(&response);
        // The press that has released the arm does not stop it again.
        self.has_released &= held;
        if response.has_focus() {
            focus_frame(ui, rect);
        }
        let painter = ui.painter();
        let fill = if self.emergency { Color32::from_rgb(0x4A, 0x17, 0x12) } else { STOP_RED };
        painter.rect(rect, 12.0, fill, Stroke::new(3.0, Color32::WHITE), StrokeKind::Inside);
        if !self.emergency {
            // On press, not on release, so that nothing delays the stop.
            if (held || response.clicked()) && !self.has_released {
                self.emergency_stop(true);
                self.releasing = None;
            }
        } else {
            // Held by touch, or by the keys that press the focused button.
            let by_key = response.has_focus() && ui.input(|i| i.key_down(Key::Space) || i.key_down(Key::Enter));
            if held && ui.input(|i| i.pointer.any_pressed()) || by_key && response.clicked() {
                self.releasing = Some(time::now());
            }
            self.release(ui.ctx(), held || by_key);
            self.has_released = !self.emergency && held;
            let share = self.releasing.map_or(0.0, |s| time::since(s).as_secs_f32() / HOLD.as_secs_f32());
            let done = Rect::from_min_size(rect.min, vec2(rect.width() * share.min(1.0), rect.height())).shrink(6.0);
            painter.rect_filled(done, 8.0, STOP_RED.gamma_multiply(0.6));
        }
        let (message, below) = if self.emergency {
            (text!("arm-stopped"), text!("arm-stopped.hold").to_owned())
        } else {
            (text!("stop-arm"), text!("stop-arm.key", key = key_name(Action::Stop)))
        };
        let sign_size = (rect.height() * 0.36).min(20.0);
        octagon(painter, pos2(rect.left() + 18.0 + sign_size, rect.center().y), sign_size);
        let left = rect.left() + 30.0 + 2.0 * sign_size;
        let width = rect.right() - 8.0 - left;
        let (y, pale) = (rect.center().y, Color32::from_white_alpha(210));
        let put = |at: Pos2, words: &str, size: f32, width: f32, color: Color32| {
            let galley = fitting(painter, words, theme::legible(ui.ctx(), size), width, color);
            painter.galley(pos2(at.x, at.y - galley.size().y / 2.0), galley, color);
        };
        if rect.height() >= TWO_LINES {
            put(pos2(left, y - 9.0), message, 22.0, width, Color32::WHITE);
            put(pos2(left, y + 15.0), &below, 14.0, width, pale);
        } else {
            put(pos2(left, y), message, 22.0, width * 0.48, Color32::WHITE);
            put(pos2(left + width * 0.52, y), &below, 14.0, width * 0.48, pale);
        }
    }
}

/// Whether a pointer or a finger is held on a widget. egui ends the press of a finger that stays for a while, because it takes that for a click.
pub(super) fn is_pressed(response: &Response) -> bool {
    let on = |at: Option<Pos2>| at.is_some_and(|at| response.rect.contains(at));
    let is_held =
        |i: &InputState| i.pointer.primary_down() && on(i.pointer.press_origin()) && on(i.pointer.latest_pos());
    response.is_pointer_button_down_on() || response.ctx.input(is_held)
}

/// Draws a stop sign.
fn octagon(painter: &Painter, at: Pos2, size: f32) {
    let corner = |k: usize| {
        let angle = (k as f32 + 0.5) * std::f32::consts::FRAC_PI_4;
        at + vec2(angle.cos(), angle.sin()) * size
    };
    painter.add(Shape::convex_polygon((0..8).map(corner).collect(), Color32::WHITE, Stroke::NONE));
    painter.rect_filled(Rect::from_center_size(at, vec2(size * 0.8, size * 0.8)), 2.0, STOP_RED);
}
