//! The theatre on a graph that runs on another machine. It shows what runs there, and changes only pinned settings, where that machine allows it.
//!
//! An attached theatre has no emergency stop: a stop that a cut cable silences would be worse than none. It records no clips and starts nothing.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use eframe::egui::Context;
use panoscope_editor_model::texts::{decimal, text, with_decimal_sign};
use panoscope_host::attach::message::Opened as Running;
use panoscope_host::attach::{Attachment, Clock, Contact, State};

use super::runner::{Local, Runner};
use super::{Layout, OpenError, Opened, Options, Plan, Theatre, Verified};
use panoscope_editor_model::session::Session;

/// The machine that runs the graph.
pub(super) struct Machine {
    attachment: Arc<Attachment>,
    /// The graph that is shown.
    revision: u64,
}

/// The machine, as notices and checklist show it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MachineFacts {
    /// Its name.
    pub name: String,
    /// Why it is not reached; `None` while it is.
    pub lost: Option<String>,
    /// Its clock beside this one's.
    pub clock: Option<Clock>,
    /// Whether this window may set what the preset pins.
    pub may_edit: bool,
}

impl MachineFacts {
    /// The clock, in words.
    pub fn clock_words(&self) -> String {
        let Some(Clock { offset_ns, error_ns, round_trip_ns }) = self.clock else {
            return text!("check-machine-no-clock").to_owned();
        };
        let ms = |ns: f64| ns / 1e6;
        text!(
            "check-machine-clock",
            reach = decimal(ms(round_trip_ns as f64), 1),
            error = decimal(ms(error_ns as f64), 1),
            offset = with_decimal_sign(&format!("{:+.1}", ms(offset_ns as f64)))
        )
    }
}

/// The plan for a graph of another machine.
fn plan_of(running: &Running) -> Plan {
    let mut plan = Plan::of(&running.graph, &running.catalog);
    // What listens there is not reached here, and an arm is stopped there.
    plan.listening.clear();
    plan.stops.clear();
    if !running.may_edit {
        plan.settings.clear();
    }
    plan
}

impl Theatre {
    /// Opens a window on the graph that runs on another machine, once it is known; waits for it for `patience`.
    ///
    /// # Errors
    /// The machine is not reached, its graph has no image, or a thread cannot be started.
    pub fn attached(
        ctx: &Context,
        attachment: Attachment,
        patience: Duration,
        options: Options,
    ) -> Result<Self, OpenError> {
        attachment.wait_opened(patience);
        let name = attachment.target().name.clone();
        let State { opened: running, revision, problem, .. } = attachment.state();
        let running = running.ok_or_else(|| OpenError::Machine { name: name.clone(), problem })?;
        let plan = plan_of(&running);
        if plan.views.is_empty() {
            return Err(OpenError::NoPicture);
        }
        let opened = Opened {
            plan,
            verified: Verified::Never,
            text: running.text.clone(),
            lock: None,
            overridden: None,
            sealed: false,
        };
        let path = PathBuf::from(format!("{name}.toml"));
        let session = Session::attached(&path, attachment)?;
        let machine = session.attachment().cloned().map(|attachment| Machine { attachment, revision });
        let for_wake = ctx.clone();
        session.set_wake(Arc::new(move || for_wake.request_repaint()));
        let local = Local::of(session)?;
        local.set_base(&running.text);
        let mut this = Self::show(ctx, &path, options, opened, Box::new(local))?;
        this.machine = machine;
        this.watch_sinks();
        Ok(this)
    }

    /// Takes over a graph that was changed on its machine.
    pub(super) fn follow_machine(&mut self) {
        let Some(machine) = &mut self.machine else { return };
        let State { opened, revision, .. } = machine.attachment.state();
        let Some(running) = opened.filter(|_| revision != machine.revision) else { return };
        machine.revision = revision;
        self.runner.set_base(&running.text);
        running.text.clone_into(&mut self.text);
        // Values that were set here are in the text, or were refused.
        self.chosen.clear();
        let plan = plan_of(&running);
        if plan.views != self.plan.views {
            self.layout = Layout::All;
        }
        self.plan = plan;
    }

    /// The machine, for notices.
    pub(super) fn machine_facts(&self) -> Option<MachineFacts> {
        let machine = self.machine.as_ref()?;
        let State { contact, problem, opened, clock, .. } = machine.attachment.state();
        let lost = match contact {
            Contact::Attached => None,
            Contact::None => Some(problem),
            // The newest reason says more than the first one.
            Contact::Lost(why) => Some(if problem.is_empty() { why } else { problem }),
            Contact::Ended(words) => Some(words),
        };
        let name = machine.attachment.target().name.clone();
        Some(MachineFacts { name, lost, clock, may_edit: opened.is_some_and(|opened| opened.may_edit) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_of_ages_is_said() {
        let clock = Clock { offset_ns: -3_200_000, error_ns: 410_000, round_trip_ns: 820_000 };
        let facts = MachineFacts { clock: Some(clock), ..MachineFacts::default() };
        assert_eq!(facts.clock_words(), "reached in 0.8 ms; ages are right to 0.4 ms (its clock is -3.2 ms)");
        assert_eq!(MachineFacts::default().clock_words(), "its clock is not known");
    }
}
