//! What the window does when the process that runs the graph has ended: the camera's own image until the views are there again.

use std::time::{Duration, Instant};

use panoscope_editor_model::session::Phase;
use panoscope_editor_model::texts::{Phrase, text};
use panoscope_graph::edit::GraphEdit;
use panoscope_host::audit::{ClipState, Event};

use super::runner::OutageStage;
use super::{Measure, Theatre, plan, time};

/// How long a view may take for its first image before it counts as stopped.
pub(super) const FIRST: Duration = Duration::from_secs(5);

/// How far this window has followed an outage.
#[derive(Default)]
pub(super) struct Resuming {
    /// Number of the last crash that was seen.
    number: u64,
    /// Since when the whole graph runs again; its views may not have an image yet.
    since: Option<Instant>,
}

/// An outage as the notices show it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutageFacts {
    /// What happened: continues a sentence about the image processing.
    pub why: Phrase,
    /// How far the recovery is.
    pub stage: OutageStage,
    /// Time since the last image of the camera; `None` when there never was one.
    pub without_image: Option<Duration>,
}

impl OutageFacts {
    /// The notice, one sentence.
    pub fn message(&self) -> String {
        let event = &self.why;
        match self.stage {
            OutageStage::Dark => match self.without_image.map_or(0, |time| time.as_secs()) {
                0 => text!("alarm-restarting", event = event),
                seconds => text!("notice-restarting-long", seconds = seconds, event = event),
            },
            OutageStage::Cameras(Some(after)) => {
                text!("notice-cameras-until", seconds = after.as_secs() + 1, event = event)
            }
            OutageStage::Cameras(None) => text!("notice-cameras-on-request", event = event),
            OutageStage::Starting | OutageStage::Running => text!("notice-cameras-starting", event = event),
        }
    }
}

impl Theatre {
    /// Follows crashes of the process that runs the graph.
    pub(super) fn follow_outage(&mut self) {
        let Some(outage) = self.runner.outage() else { return };
        if outage.number != self.resuming.number {
            self.resuming = Resuming { number: outage.number, since: None };
            // What follows a colon may name files.
            let cause = outage.why.english().split(": ").next().unwrap_or_default().to_owned();
            self.audit.log(Event::ProcessEnded { cause });
            if let Some(clip) = self.take_clip(ClipState::Failed) {
                let name = clip.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                self.notify(text!("clip-process-ended", file = name, event = &outage.why), true);
            }
            self.hold_arm();
            self.keep();
            // No view of before may be taken for a present one.
            self.forget_shown_images();
            (self.frozen, self.measure) = (None, Measure::default());
            self.running_since = None;
        }
        if outage.stage != OutageStage::Running {
            self.resuming.since = None;
            return;
        }
        let since = *self.resuming.since.get_or_insert_with(time::now);
        let main = self.plan.views.get(self.layout.main());
        let packet = main.and_then(|main| self.last_packets.get(&main.output));
        // A view that stays without an image has its own notice.
        if packet.is_some_and(|packet| packet.at >= since) || time::since(since) > FIRST {
            self.runner.end_outage();
            self.running_since = None;
        }
    }

    /// Starts the whole graph again, after it has stopped.
    pub(super) fn again(&mut self) {
        let ended = matches!(self.runner.status().phase, Phase::Ended | Phase::Failed(_));
        let has_fallen_back = self.raw_only.take().is_some();
        let is_out = self.runner.outage().is_some();
        if is_out || has_fallen_back || ended {
            self.hold_arm();
            self.audit.log(Event::Restarted);
        }
        self.keep();
        if is_out {
            self.runner.resume();
        } else if has_fallen_back || ended {
            self.forget_images();
            self.runner.restart(&self.text);
        }
    }

    /// Gives the runner what to start after a crash: the graph with its arm stopped, also where this window does not run then.
    pub(super) fn keep(&self) {
        let cameras = self.plan.raw_only(&self.text).unwrap_or_else(|_| self.text.clone());
        // What did not run before the crash is not started after it, unless the user asks for it.
        let whole = if self.raw_only.is_some() { cameras.clone() } else { self.with_stops(&self.text) };
        self.runner.keep(&whole, &cameras);
    }

    /// Stops the arm in what runs from the next start on: after a restart it follows only once it is released.
    fn hold_arm(&mut self) {
        if !self.plan.stops.is_empty() && !self.emergency {
            self.emergency = true;
            self.text = self.with_stops(&self.text);
            self.audit.log(Event::EmergencyStop { stopped: true });
        }
    }

    /// A text of the graph with its arm stopped.
    fn with_stops(&self, text: &str) -> String {
        let edited = GraphEdit::parse(text).and_then(|mut edit| {
            let mut stops = self.plan.stops.iter();
            stops.try_for_each(|stop| edit.set_param(&stop.node, plan::EMERGENCY_STOP, &true.into()))?;
            Ok(edit.text())
        });
        edited.unwrap_or_else(|_| text.to_owned())
    }

    /// Whether the camera's own image is shown in place of all views.
    pub(super) fn shows_raw(&self) -> bool {
        self.raw_only.is_some() || self.runner.outage().is_some()
    }

    /// The outage, for notices.
    pub(super) fn outage_facts(&self) -> Option<OutageFacts> {
        let outage = self.runner.outage()?;
        let raw = self.raw();
        let last = raw.and_then(|raw| self.last_packets.get(&raw.output));
        Some(OutageFacts { why: outage.why, stage: outage.stage, without_image: last.map(|last| time::since(last.at)) })
    }

    /// Reports stops that did not reach their node.
    pub(super) fn see_refused_stops(&mut self) {
        let failed = self.runner.take_refusals();
        if !failed.is_empty() && self.raw_only.is_none() {
            self.notify(text!("arm-refused", nodes = failed.join(", ")), true);
        }
    }
}

#[cfg(test)]
mod tests {
    use panoscope_editor_model::texts::phrase;

    use super::*;

    #[test]
    fn the_notice_says_what_happened_and_what_comes() {
        let facts = |stage, ms| OutageFacts {
            why: phrase!("worker-crashed-in", node = "wide", signal = "SIGSEGV"),
            stage,
            without_image: Some(Duration::from_millis(ms)),
        };
        let crashed = "the image processing crashed in node `wide` (SIGSEGV)";
        assert_eq!(facts(OutageStage::Dark, 300).message(), format!("No image, restarting: {crashed}"));
        assert_eq!(facts(OutageStage::Dark, 2300).message(), format!("No image for 2 s, restarting: {crashed}"));
        let soon = OutageStage::Cameras(Some(Duration::from_millis(1500)));
        assert_eq!(facts(soon, 0).message(), format!("Camera image only, all views in 2 s: {crashed}"));
        assert!(
            facts(OutageStage::Cameras(None), 0)
                .message()
                .starts_with("Camera image only, press Enter for all views: ")
        );
    }
}
