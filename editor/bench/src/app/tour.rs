//! The tour of problems: from one to the next, each with its place, its cause and what to do.

use eframe::egui::{self, Align2, Context, Frame, Margin, RichText, WidgetInfo, WidgetType, vec2};

use super::App;
use crate::actions::{Action, hint};
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::problems::{self, Problem};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Width of the tour's window, points.
const WIDTH: f32 = 560.0;

/// The problem that is shown.
#[derive(Clone, Debug, Default)]
pub(super) struct ProblemTour {
    /// The shown problem, as it was found; `None` while the tour is closed.
    shown: Option<Problem>,
    /// Its position among all, for when it is gone.
    at: usize,
}

impl App {
    /// All problems of the graph and its run.
    fn problems(&self) -> Vec<Problem> {
        problems::problems(&self.document, &self.session.status(), &self.observer.counters())
    }

    /// Shows the problem after the shown one, or with `back` the one before it.
    pub(super) fn step_problem(&mut self, back: bool) {
        let all = self.problems();
        if all.is_empty() {
            self.tour = ProblemTour::default();
            return self.notify(text!("tour-nothing"), false);
        }
        let known = self.tour.shown.as_ref().map(|shown| {
            // Words such as counts change; the place stays.
            let same = |p: &Problem| (&p.place, p.is_error) == (&shown.place, shown.is_error);
            (all.iter().position(|p| p == shown)).or_else(|| all.iter().position(same)).unwrap_or(self.tour.at)
        });
        let at = match (known, back) {
            (None, false) => 0,
            (None, true) => all.len() - 1,
            (Some(at), false) => (at + 1) % all.len(),
            (Some(at), true) => (at + all.len() - 1) % all.len(),
        };
        let problem = all[at].clone();
        if let Some(line) = problem.line {
            self.reading.go_to(line);
            if problem.node.is_none() {
                self.docks.open(Panel::Text);
            }
        }
        if let Some(node) = problem.node.clone() {
            self.viewer.close();
            self.canvas.show_node(&self.document.view().clone(), &node);
        }
        self.tour = ProblemTour { shown: Some(problem), at };
    }

    /// Closes the tour; returns whether it was open.
    pub(super) fn close_tour(&mut self) -> bool {
        self.tour.shown.take().is_some()
    }

    /// The problem that the tour shows.
    pub fn shown_problem(&self) -> Option<&Problem> {
        self.tour.shown.as_ref()
    }

    /// Draws the tour over the lower edge of the canvas.
    pub(super) fn show_tour(&mut self, ctx: &Context) {
        let Some(problem) = self.tour.shown.clone() else { return };
        let count = self.problems().len();
        let frame = Frame::popup(&ctx.global_style()).inner_margin(Margin::same(16));
        let (mut step, mut close) = (None, false);
        let at = vec2(self.canvas.rect.center().x - ctx.content_rect().center().x, -24.0);
        egui::Area::new("problem tour".into()).anchor(Align2::CENTER_BOTTOM, at).show(ctx, |ui| {
            frame.show(ui, |ui| {
                ui.set_width(WIDTH.min(self.canvas.rect.width() - 64.0).max(240.0));
                let color = if problem.is_error { theme::fault() } else { theme::warn() };
                let heading = text!(
                    "tour-heading",
                    at = self.tour.at + 1,
                    count = count.max(self.tour.at + 1),
                    place = &problem.place
                );
                let title = ui.label(RichText::new(&heading).size(15.0).color(color));
                title.widget_info(|| {
                    WidgetInfo::labeled(WidgetType::Label, true, text!("tour-name", heading = &heading))
                });
                ui.label(RichText::new(&problem.cause).size(13.0));
                ui.add_space(theme::STEP / 2.0);
                ui.label(
                    RichText::new(text!("tour-remedy", remedy = &problem.remedy)).size(13.0).color(theme::muted()),
                );
                ui.add_space(theme::STEP);
                ui.horizontal(|ui| {
                    if ui.button(text!("tour-previous")).on_hover_text(hint(Action::PreviousProblem)).clicked() {
                        step = Some(true);
                    }
                    if ui.button(text!("tour-next")).on_hover_text(hint(Action::NextProblem)).clicked() {
                        step = Some(false);
                    }
                    close = ui.button(text!("tour-end")).on_hover_text(text!("key-escape")).clicked();
                });
            });
        });
        if let Some(back) = step {
            self.step_problem(back);
        }
        if close {
            self.close_tour();
        }
    }
}
