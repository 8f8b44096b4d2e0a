//! The editor on a graph that runs on another machine. What runs there stands in for the file: each change is made there at once, and a change that is
//! made there by others is shown here, or is a conflict that the user decides.

use std::path::Path;

use eframe::egui::{Context, Frame, Margin, Panel, RichText, Ui, WidgetInfo, WidgetType};
use panoscope_editor_model::disk;
use panoscope_editor_model::history::Origin;
use panoscope_editor_model::session::Session;
use panoscope_editor_model::texts::{decimal, text, with_decimal_sign};
use panoscope_editor_widgets::theme;
use panoscope_host::attach::{Attachment, Clock, Contact, State};

use super::{App, OpenError, Options};

impl App {
    /// Opens a window on the graph that runs on another machine and is known already. `path` is where a copy of it is saved.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn attached(ctx: &Context, path: &Path, attachment: Attachment, options: Options) -> Result<Self, OpenError> {
        let text = attachment.state().opened.map(|opened| opened.text.clone()).unwrap_or_default();
        let session = Session::attached(path, attachment)?;
        Self::with_session(ctx, path, &text, session, options)
    }

    pub(super) fn is_attached(&self) -> bool {
        self.session.attachment().is_some()
    }

    fn machine(&self) -> Option<(String, State)> {
        self.session.attachment().map(|machine| (machine.target().name.clone(), machine.state()))
    }

    /// Takes over the graph of the machine where it has changed.
    pub(super) fn follow_machine(&mut self) {
        let Some((_, State { opened, revision, .. })) = self.machine() else { return };
        let Some(opened) = opened.filter(|_| revision != self.machine_revision) else { return };
        self.machine_revision = revision;
        let text = opened.text.clone();
        if text == **self.document.text() || text == **self.document.runnable() {
            // A change of this window, which the machine has made.
            let path = self.document.path().to_owned();
            self.forget_conflict(&path);
            self.document.set_saved(&text);
            return;
        }
        self.changed_on_disk(text);
        self.requested_revision = self.document.revision();
    }

    /// Whether changes are made on the machine; where they are not, the text goes back to what runs there.
    pub(super) fn may_run(&mut self) -> bool {
        let Some((name, State { opened: Some(opened), .. })) = self.machine() else { return true };
        if opened.may_edit || opened.text == **self.document.text() {
            return true;
        }
        self.document.set_text_by(Origin::File, &opened.text, "not changed", None);
        self.requested_revision = self.document.revision();
        self.notify(text!("machine-read-only", machine = name), true);
        false
    }

    pub(super) fn notify_of_change(&mut self) {
        let Some((name, State { opened: Some(opened), .. })) = self.machine() else { return };
        let by = if opened.changed_by.is_empty() { text!("machine-changed.there") } else { &opened.changed_by };
        self.notify(text!("machine-changed", machine = name, who = by), false);
    }

    /// Applies the choice of a conflict with the machine.
    pub(super) fn after_conflict(&mut self, takes_theirs: bool) {
        match takes_theirs {
            true => self.requested_revision = self.document.revision(),
            false => self.session.run_from(self.document.saved(), self.document.runnable()),
        }
    }

    /// Saves a copy of the graph here.
    pub(super) fn save_machine_copy(&mut self) {
        let path = self.document.path().to_owned();
        let result = disk::save(&path, self.document.text());
        if self.try_edit(result).is_some() {
            self.notify(text!("machine-copy", file = path.display().to_string()), false);
        }
    }

    /// Shows the machine: whether it is reached, what this window may, and how exactly ages are known.
    pub(super) fn machine_bar(&self, ui: &mut Ui) {
        let Some((name, state)) = self.machine() else { return };
        let (words, is_lost) = words(&name, &state);
        let color = if is_lost { theme::fault() } else { theme::panel() };
        let frame = Frame::new().fill(color.gamma_multiply(if is_lost { 0.25 } else { 1.0 }));
        Panel::top("machine").frame(frame.inner_margin(Margin::symmetric(16, 4))).show(ui, |ui| {
            let label = ui.label(RichText::new(&words).size(12.0));
            label.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, words.clone()));
        });
    }
}

/// The machine in one line, and whether it is not reached.
fn words(name: &str, state: &State) -> (String, bool) {
    let problem = |why: &str| if state.problem.is_empty() { why.to_owned() } else { state.problem.clone() };
    match &state.contact {
        Contact::None => (text!("machine-unreached", machine = name, reason = &state.problem), true),
        Contact::Lost(why) => {
            let seconds = state.since.map_or(0, |since| since.elapsed().as_secs());
            (text!("machine-lost", machine = name, seconds = seconds, reason = problem(why)), true)
        }
        Contact::Ended(why) => (text!("machine-ended", machine = name, reason = why), true),
        Contact::Attached => {
            let may = state.opened.as_ref().is_some_and(|opened| opened.may_edit);
            let may = if may { text!("machine-edits") } else { text!("machine-reads") };
            let Some(Clock { offset_ns, error_ns, round_trip_ns }) = state.clock else {
                return (text!("machine-runs", machine = name, may = may), false);
            };
            let ms = |ns: f64| ns / 1e6;
            let words = text!(
                "machine-runs-clock",
                machine = name,
                may = may,
                error = decimal(ms(error_ns as f64), 1),
                offset = with_decimal_sign(&format!("{:+.1}", ms(offset_ns as f64))),
                reach = decimal(ms(round_trip_ns as f64), 1)
            );
            (words, false)
        }
    }
}
