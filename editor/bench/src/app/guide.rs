//! The guided tour of the first start: six stops of ten seconds, each on the running graph. It can be skipped, and started again.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use eframe::egui::{
    self, Align2, Color32, Context, Frame, Margin, Order, ProgressBar, Rect, RichText, Stroke, StrokeKind, WidgetInfo,
    WidgetType, pos2, vec2,
};

use super::App;
use crate::actions::{Action, key_name};
use panoscope_base::files;
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::numbered::create_folder;
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// How long a stop lasts if nothing is done.
const STOP: Duration = Duration::from_secs(10);
/// Width of the words, points.
const WIDTH: f32 = 340.0;
/// File in the folder of settings that says that the tour was seen.
const SEEN: &str = "guide_seen";

/// What a stop points at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Target {
    Node,
    Canvas,
    Side,
    Top,
}

/// What ends a stop before its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Until {
    Selected,
    Changed,
    Nothing,
}

/// A stop of the tour.
struct Stop {
    heading: fn() -> &'static str,
    words: fn() -> String,
    target: Target,
    until: Until,
}

const STOPS: &[Stop] = &[
    Stop {
        heading: || text!("guide-runs"),
        words: || text!("guide-runs.words").to_owned(),
        target: Target::Canvas,
        until: Until::Nothing,
    },
    Stop {
        heading: || text!("guide-look"),
        words: || text!("guide-look.words", help = key_name(Action::NodeHelp)),
        target: Target::Node,
        until: Until::Selected,
    },
    Stop {
        heading: || text!("guide-change"),
        words: || text!("guide-change.words", undo = key_name(Action::Undo)),
        target: Target::Side,
        until: Until::Changed,
    },
    Stop {
        heading: || text!("guide-closely"),
        words: || text!("guide-closely.words", view = key_name(Action::View), compare = key_name(Action::Compare)),
        target: Target::Canvas,
        until: Until::Nothing,
    },
    Stop {
        heading: || text!("guide-wire"),
        words: || text!("guide-wire.words", add = key_name(Action::Add)),
        target: Target::Canvas,
        until: Until::Nothing,
    },
    Stop {
        heading: || text!("guide-find"),
        words: || {
            text!(
                "guide-find.words",
                commands = key_name(Action::Commands),
                problem = key_name(Action::NextProblem),
                help = key_name(Action::Help),
                save = key_name(Action::Save)
            )
        },
        target: Target::Top,
        until: Until::Nothing,
    },
];

/// The tour while it is shown.
#[derive(Clone, Debug)]
pub(super) struct Guide {
    at: usize,
    since: Instant,
    /// Undo steps when the stop began.
    steps: usize,
}

fn seen_file(config: &Path) -> PathBuf {
    config.join(SEEN)
}

/// Whether the tour is to be shown at the start: it was not seen yet, by this user.
pub(super) fn is_first_start(config: Option<&Path>) -> bool {
    config.is_some_and(|config| !seen_file(config).exists())
}

impl App {
    /// Starts the tour.
    pub(super) fn start_guide(&mut self) {
        self.guide = Some(Guide { at: 0, since: Instant::now(), steps: self.document.steps() });
    }

    /// Ends the tour, and remembers that it was seen; returns whether it was shown.
    pub(super) fn end_guide(&mut self) -> bool {
        if self.guide.take().is_none() {
            return false;
        }
        if let Some(config) = self.config.clone() {
            let written = create_folder(&config).is_ok() && files::replace(&seen_file(&config), b"").is_ok();
            if !written {
                self.notify(text!("guide-not-kept", folder = config.display().to_string()), true);
            }
        }
        true
    }

    /// Number of the shown stop of the tour, from 0.
    pub fn guide_stop(&self) -> Option<usize> {
        self.guide.as_ref().map(|guide| guide.at)
    }

    fn next_stop(&mut self) {
        let steps = self.document.steps();
        match &mut self.guide {
            Some(guide) if guide.at + 1 < STOPS.len() => {
                *guide = Guide { at: guide.at + 1, since: Instant::now(), steps };
            }
            _ => {
                self.end_guide();
            }
        }
    }

    /// The part of the window that a stop points at.
    fn target(&self, target: Target, whole: Rect) -> Rect {
        let canvas = self.canvas.rect;
        match target {
            Target::Canvas => canvas,
            Target::Node => {
                self.canvas.node_rects().first().map_or(canvas, |(_, rect)| rect.expand(6.0).intersect(canvas))
            }
            Target::Side => self.docks.rect(Panel::Node).unwrap_or(canvas),
            Target::Top => Rect::from_min_max(whole.min, pos2(whole.right(), whole.top() + 44.0)),
        }
    }

    /// Draws the tour, if it is shown.
    pub(super) fn show_guide(&mut self, ctx: &Context) {
        let Some(guide) = self.guide.clone() else { return };
        let Stop { heading, words, target, until } = &STOPS[guide.at];
        let heading = heading();
        let done = match until {
            Until::Selected => !self.canvas.selected.is_empty(),
            Until::Changed => self.document.steps() > guide.steps,
            Until::Nothing => false,
        };
        if done && guide.since.elapsed() > Duration::from_millis(600) || guide.since.elapsed() > STOP {
            return self.next_stop();
        }
        ctx.request_repaint_after(Duration::from_millis(100));
        let whole = ctx.content_rect();
        let spot = self.target(*target, whole);
        let painter = ctx.layer_painter(egui::LayerId::new(Order::Middle, "guide".into()));
        // The rest is darker; nothing takes the pointer.
        let dark = Color32::from_black_alpha(96);
        for rect in [
            Rect::from_min_max(whole.min, pos2(whole.right(), spot.top())),
            Rect::from_min_max(pos2(whole.left(), spot.bottom()), whole.max),
            Rect::from_min_max(pos2(whole.left(), spot.top()), spot.left_bottom()),
            Rect::from_min_max(spot.right_top(), pos2(whole.right(), spot.bottom())),
        ] {
            painter.rect_filled(rect, 0.0, dark);
        }
        painter.rect_stroke(spot, 6.0, Stroke::new(2.0, theme::accent()), StrokeKind::Inside);
        let (mut next, mut skip) = (false, false);
        let frame = Frame::popup(&ctx.global_style()).inner_margin(Margin::same(18));
        let middle = vec2(self.canvas.rect.center().x - whole.center().x, -40.0);
        egui::Area::new("guide words".into()).order(Order::Foreground).anchor(Align2::CENTER_BOTTOM, middle).show(
            ctx,
            |ui| {
                frame.show(ui, |ui| {
                    ui.set_width(WIDTH);
                    let title = ui.label(RichText::new(heading).size(17.0));
                    let name = text!("guide-name", at = guide.at + 1, count = STOPS.len(), heading = heading);
                    title.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, name.clone()));
                    ui.label(RichText::new(words()).size(13.5));
                    ui.add_space(theme::STEP);
                    let share = (guide.at as f32 + guide.since.elapsed().as_secs_f32() / STOP.as_secs_f32())
                        / STOPS.len() as f32;
                    ui.add(ProgressBar::new(share).desired_height(4.0));
                    ui.add_space(theme::STEP);
                    ui.horizontal(|ui| {
                        next = ui.button(text!("guide-next")).clicked();
                        skip = ui.button(text!("guide-skip")).on_hover_text(text!("key-escape")).clicked();
                    });
                });
            },
        );
        if skip {
            self.end_guide();
        } else if next {
            self.next_stop();
        }
    }
}

#[cfg(test)]
mod tests {
    use panoscope_editor_model::texts::{Language, set_language};

    use super::*;

    #[test]
    fn the_tour_takes_a_minute_and_names_keys_that_exist() {
        assert_eq!(STOP * STOPS.len() as u32, Duration::from_secs(60));
        for language in Language::ALL {
            set_language(language);
            for stop in STOPS {
                let words = (stop.words)();
                assert!(!words.contains(['{', '}']) && !(stop.heading)().is_empty(), "{words}");
            }
        }
        assert!(!is_first_start(None));
    }
}
