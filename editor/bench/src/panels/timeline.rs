//! The panel of a recording: scrubbing, stepping, playing a part again and again, and a second recording beside it.

use std::path::{Path, PathBuf};

use eframe::egui::{Button, Id, Key, Modifiers, RichText, Slider, TextEdit, Ui, WidgetInfo, WidgetType};

use crate::actions::{self, Action};
use crate::panels::files::Target;
use panoscope_editor_model::texts::{decimal, text};
use panoscope_editor_model::timeline::Timeline;
use panoscope_editor_widgets::numbers::drag_value;
use panoscope_editor_widgets::theme;

/// A request of this panel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TimelineRequest {
    /// Open a recording.
    Open(PathBuf),
    /// Put a second recording beside it.
    Compare(PathBuf),
    /// Take the second recording away.
    EndCompare,
    /// Pick the file of a recording.
    Browse(Target),
    /// Record the graph, or end the recording.
    Record,
    /// Compute the outputs that the recording lacks.
    Compute,
    /// Close the recording.
    Close,
}

/// The state of the panel.
#[derive(Default)]
pub struct TimelinePanel {
    file: String,
    second: String,
    /// The beginning of a range whose end is not chosen yet, s.
    from_s: Option<f64>,
    /// The slider of the moment.
    slider: Option<Id>,
}

impl TimelinePanel {
    /// Shows the panel; returns the user's requests.
    ///
    /// `recording` is the file that the running graph is recorded to, `graph` the text of the graph.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        timeline: Option<&Timeline>,
        recording: Option<&Path>,
        graph: &str,
    ) -> Option<TimelineRequest> {
        let Some(timeline) = timeline else {
            return self.closed(ui, recording);
        };
        let mut request = None;
        let position = timeline.position();
        let (tick, count) = timeline.tick();
        ui.horizontal(|ui| {
            let name = timeline.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
            let title = ui.label(RichText::new(text!("timeline-title", file = name)).size(14.0).color(theme::warn()));
            title.on_hover_text(text!("timeline-title.hint"));
            if ui.button(text!("timeline-close")).clicked() {
                request = Some(TimelineRequest::Close);
            }
        });
        ui.horizontal(|ui| self.controls(ui, timeline));
        self.step_by_keys(ui, timeline);
        let mut at_s = timeline.position().at_s;
        ui.spacing_mut().slider_width = (ui.available_width() - 24.0).max(120.0);
        let slider = ui.add(Slider::new(&mut at_s, 0.0..=timeline.length_s().max(1e-3)).show_value(false));
        ui.ctx().accesskit_node_builder(slider.id, |node| node.set_label(text!("timeline-moment")));
        self.slider = Some(slider.id);
        if slider.changed() {
            timeline.play(false);
            timeline.seek(at_s);
        }
        let words = text!(
            "timeline-at",
            at = decimal(position.at_s, 3),
            length = decimal(timeline.length_s(), 3),
            tick = tick,
            count = count
        );
        let label = ui.label(RichText::new(&words).size(12.0).color(theme::muted()));
        label.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, text!("timeline-at-name", moment = &words)));
        if let Some(problem) = timeline.problem() {
            ui.label(RichText::new(problem).color(theme::fault()));
        }
        if let Some(computation) = timeline.computation() {
            if let Some(reason) = computation.problem() {
                ui.label(RichText::new(text!("timeline-compute.failed", reason = reason)).color(theme::fault()));
            }
            let mut again =
                || ui.button(text!("timeline-compute")).on_hover_text(text!("timeline-compute.hint")).clicked();
            if !computation.is_of(graph) && again() {
                request = Some(TimelineRequest::Compute);
            }
        }
        request.or(ui.horizontal(|ui| self.second_recording(ui, timeline)).inner)
    }

    /// Draws the buttons: playing, speed and the loop.
    fn controls(&mut self, ui: &mut Ui, timeline: &Timeline) {
        let position = timeline.position();
        if ui.button(text!("timeline-back")).on_hover_text(actions::hint(Action::TickBack)).clicked() {
            timeline.step(-1);
        }
        let caption = if position.plays { text!("timeline-pause") } else { text!("timeline-play") };
        if ui.button(caption).on_hover_text(actions::hint(Action::Play)).clicked() {
            timeline.play(!position.plays);
        }
        if ui.button(text!("timeline-forward")).on_hover_text(actions::hint(Action::TickForward)).clicked() {
            timeline.step(1);
        }
        let mut speed = position.speed;
        let drag = ui.add(drag_value(&mut speed).range(0.05..=20.0).speed(0.02).suffix(" x"));
        ui.ctx().accesskit_node_builder(drag.id, |node| node.set_label(text!("timeline-speed")));
        if drag.changed() {
            timeline.set_speed(speed);
        }
        if ui.button(text!("timeline-loop-from")).clicked() {
            self.from_s = Some(position.at_s);
            timeline.set_range(None);
        }
        let from_s = self.from_s.filter(|from| *from < position.at_s);
        if ui.add_enabled(from_s.is_some(), Button::new(text!("timeline-loop-to"))).clicked() {
            timeline.set_range(from_s.map(|from| (from, position.at_s)));
            self.from_s = None;
            timeline.play(true);
        }
        if let Some((from, to)) = position.range_s {
            if ui.button(text!("timeline-loop-end")).clicked() {
                timeline.set_range(None);
            }
            ui.label(
                RichText::new(text!("timeline-range", from = decimal(from, 2), to = decimal(to, 2)))
                    .size(12.0)
                    .color(theme::muted()),
            );
        }
    }

    /// Draws the row of the recording to compare with.
    fn second_recording(&mut self, ui: &mut Ui, timeline: &Timeline) -> Option<TimelineRequest> {
        if let Some(path) = timeline.second_path() {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            ui.label(RichText::new(text!("timeline-beside", file = name)).size(12.0).color(theme::muted()));
            return ui.button(text!("timeline-compare-end")).clicked().then_some(TimelineRequest::EndCompare);
        }
        let names = (text!("timeline-second"), text!("timeline-second.open"), text!("timeline-second.browse"));
        file_row(ui, &mut self.second, names).map(|picked| match picked {
            Some(path) => TimelineRequest::Compare(path),
            None => TimelineRequest::Browse(Target::SecondTimeline),
        })
    }

    /// Shows the panel without a recording: opens one, or makes one.
    fn closed(&mut self, ui: &mut Ui, recording: Option<&Path>) -> Option<TimelineRequest> {
        let about = match recording {
            Some(file) => text!("record-runs", file = file.display().to_string()),
            None => text!("timeline-about").to_owned(),
        };
        ui.label(RichText::new(about).color(theme::muted()));
        let caption = if recording.is_some() { text!("record-stop") } else { text!("record-start") };
        if ui.button(caption).on_hover_text(actions::hint(Action::Record)).clicked() {
            return Some(TimelineRequest::Record);
        }
        let names = (text!("timeline-file"), text!("timeline-file.open"), text!("timeline-file.browse"));
        file_row(ui, &mut self.file, names).map(|picked| match picked {
            Some(path) => TimelineRequest::Open(path),
            None => TimelineRequest::Browse(Target::Timeline),
        })
    }

    /// Arrow keys on the slider go from tick to tick; by themselves they would move it by a point, which is less.
    fn step_by_keys(&self, ui: &Ui, timeline: &Timeline) {
        if !self.slider.is_some_and(|slider| ui.memory(|memory| memory.has_focus(slider))) {
            return;
        }
        let steps = ui.input_mut(|input| {
            let mut count = |key| input.count_and_consume_key(Modifiers::NONE, key) as isize;
            count(Key::ArrowRight) - count(Key::ArrowLeft)
        });
        if steps != 0 {
            timeline.step(steps);
        }
    }
}

/// Shows a field for a file, a button that takes it, and one that lists files; returns the file when it is taken, `None` in it for the list.
fn file_row(ui: &mut Ui, file: &mut String, (name, caption, browse): (&str, &str, &str)) -> Option<Option<PathBuf>> {
    ui.horizontal(|ui| {
        let field = ui.add(TextEdit::singleline(file).id_salt(name).hint_text("file.mcap").desired_width(360.0));
        ui.ctx().accesskit_node_builder(field.id, |node| node.set_label(name));
        let entered = field.lost_focus() && ui.input(|i| i.key_pressed(eframe::egui::Key::Enter));
        let pressed = ui.add_enabled(!file.trim().is_empty(), Button::new(caption)).clicked();
        let lists = ui.button(text!("form-browse"));
        ui.ctx().accesskit_node_builder(lists.id, |node| node.set_label(browse));
        if lists.clicked() {
            return Some(None);
        }
        ((pressed || entered) && !file.trim().is_empty()).then(|| Some(PathBuf::from(file.trim())))
    })
    .inner
}
