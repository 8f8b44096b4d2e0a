//! When what is started again after a crash. Decides only; [`super::Guard`] acts.

use std::time::{Duration, Instant};

use panoscope_editor_model::texts::{Phrase, phrase};

use crate::runner::{Outage, OutageStage};

/// Time from the first picture of the cameras to the start of the whole graph, by the number of crashes in a row. After the last one the user
/// starts it.
const RESUME_AFTER: [Duration; 5] = [
    Duration::from_millis(500),
    Duration::from_secs(2),
    Duration::from_secs(5),
    Duration::from_secs(15),
    Duration::from_secs(30),
];
/// A process that lived so long is not in a row of crashes.
const ROW: Duration = Duration::from_secs(60);
/// Longest time between the start of two processes that show the cameras.
const MAX_PAUSE: Duration = Duration::from_secs(5);
/// Time without a picture of the cameras after which they are started again.
const CAMERAS_AGAIN: Duration = Duration::from_secs(5);

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Nothing yet.
    Wait,
    /// Start a process that shows the cameras.
    Cameras,
    /// Start the cameras of the running process again.
    CamerasAgain,
    /// Start the whole graph.
    Whole,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Steady,
    /// No process: the next one starts then.
    Down(Instant),
    /// A process was started, and there is no picture yet.
    Opening(Instant),
    /// The cameras are shown; the whole graph starts then.
    Cameras(Option<Instant>),
    Starting,
    Restored,
}

/// Follows crashes and what became of them.
pub(crate) struct Recovery {
    stage: Stage,
    number: u64,
    in_a_row: usize,
    why: Phrase,
    /// Start of the present stage.
    since: Instant,
}

impl Recovery {
    pub fn new(now: Instant) -> Self {
        Self { stage: Stage::Steady, number: 0, in_a_row: 0, why: phrase!("worker-not-needed"), since: now }
    }

    fn set(&mut self, stage: Stage, now: Instant) {
        (self.stage, self.since) = (stage, now);
    }

    /// The process has ended.
    pub fn crashed(&mut self, why: Phrase, now: Instant) {
        let lived = now.duration_since(self.since);
        if matches!(self.stage, Stage::Steady | Stage::Restored | Stage::Cameras(_)) && lived >= ROW {
            self.in_a_row = 0;
        }
        self.in_a_row += 1;
        self.number += 1;
        self.why = why;
        // The first process at once; later ones only if the last one got somewhere.
        let tries = match self.stage {
            Stage::Down(_) | Stage::Opening(_) => self.in_a_row.min(6) as u32,
            _ => 0,
        };
        let pause = (Duration::from_millis(125) * 2_u32.pow(tries)).min(MAX_PAUSE);
        let pause = if tries == 0 { Duration::ZERO } else { pause };
        self.set(Stage::Down(now + pause), now);
    }

    /// A process that shows the cameras was started.
    pub fn opening(&mut self, now: Instant) {
        self.set(Stage::Opening(now + CAMERAS_AGAIN), now);
    }

    /// A picture has come.
    pub fn picture(&mut self, now: Instant) {
        if matches!(self.stage, Stage::Opening(_)) {
            let after = RESUME_AFTER.get(self.in_a_row.saturating_sub(1));
            self.set(Stage::Cameras(after.map(|after| now + *after)), now);
        }
    }

    /// What is to be done now.
    pub fn step(&mut self, now: Instant) -> Step {
        match self.stage {
            Stage::Down(at) if now >= at => Step::Cameras,
            Stage::Opening(until) if now >= until => {
                self.set(Stage::Opening(now + CAMERAS_AGAIN), now);
                Step::CamerasAgain
            }
            Stage::Cameras(Some(at)) if now >= at => {
                self.set(Stage::Starting, now);
                Step::Whole
            }
            _ => Step::Wait,
        }
    }

    /// The whole graph runs.
    pub fn runs(&mut self, now: Instant) {
        if self.stage == Stage::Starting {
            self.set(Stage::Restored, now);
        }
    }

    /// The whole graph was not started: `why` continues a sentence about the image processing.
    pub fn refused(&mut self, why: Phrase, now: Instant) {
        if self.stage == Stage::Starting {
            self.why = why;
            self.in_a_row += 1;
            let after = RESUME_AFTER.get(self.in_a_row.saturating_sub(1));
            self.set(Stage::Cameras(after.map(|after| now + *after)), now);
        }
    }

    /// The user wants the whole graph now.
    pub fn ask(&mut self, now: Instant) {
        if let Stage::Cameras(_) = self.stage {
            self.stage = Stage::Cameras(Some(now));
        }
    }

    /// The views of the whole graph are shown.
    pub fn done(&mut self) {
        if self.stage == Stage::Restored {
            // `since` stays: a crash soon after is one in a row.
            self.stage = Stage::Steady;
        }
    }

    pub fn is_starting(&self) -> bool {
        self.stage == Stage::Starting
    }

    /// Whether changes of the whole graph go to the process; otherwise they wait for its start.
    pub fn takes_changes(&self) -> bool {
        matches!(self.stage, Stage::Steady | Stage::Starting | Stage::Restored)
    }

    /// Whether the graph runs as if nothing had happened, or the cameras at least are shown.
    pub fn shows_pictures(&self) -> bool {
        matches!(self.stage, Stage::Steady | Stage::Restored | Stage::Cameras(_))
    }

    pub fn outage(&self, now: Instant) -> Option<Outage> {
        let stage = match self.stage {
            Stage::Steady => return None,
            Stage::Down(_) | Stage::Opening(_) => OutageStage::Dark,
            Stage::Cameras(at) => OutageStage::Cameras(at.map(|at| at.saturating_duration_since(now))),
            Stage::Starting => OutageStage::Starting,
            Stage::Restored => OutageStage::Running,
        };
        Some(Outage { number: self.number, why: self.why.clone(), stage })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crash_phrase() -> Phrase {
        phrase!("worker-crashed", signal = "SIGSEGV")
    }

    fn seconds(s: f64) -> Duration {
        Duration::from_secs_f64(s)
    }

    #[test]
    fn cameras_come_at_once_and_the_whole_graph_a_moment_later() {
        let start = Instant::now();
        let mut recovery = Recovery::new(start);
        assert_eq!((recovery.step(start), recovery.outage(start)), (Step::Wait, None));
        let crash = start + seconds(100.0);
        recovery.crashed(crash_phrase(), crash);
        assert_eq!(recovery.step(crash), Step::Cameras);
        recovery.opening(crash);
        assert_eq!(recovery.step(crash + seconds(0.1)), Step::Wait);
        assert_eq!(recovery.outage(crash).map(|o| o.stage), Some(OutageStage::Dark));
        recovery.picture(crash + seconds(0.2));
        assert_eq!(recovery.step(crash + seconds(0.6)), Step::Wait);
        assert_eq!(recovery.step(crash + seconds(0.8)), Step::Whole);
        assert!(recovery.is_starting());
        recovery.runs(crash + seconds(1.0));
        assert_eq!(recovery.outage(crash).map(|o| o.stage), Some(OutageStage::Running));
        recovery.done();
        assert_eq!(recovery.outage(crash), None);
    }

    #[test]
    fn crashes_in_a_row_take_longer_and_in_the_end_the_user_decides() {
        let mut now = Instant::now();
        let mut recovery = Recovery::new(now);
        let mut waits = Vec::new();
        for _ in 0..7 {
            recovery.crashed(crash_phrase(), now);
            assert_eq!(recovery.step(now), Step::Cameras, "the cameras come at once after a process that showed them");
            recovery.opening(now);
            recovery.picture(now);
            let Some(OutageStage::Cameras(after)) = recovery.outage(now).map(|o| o.stage) else { panic!("cameras") };
            waits.push(after);
            match after {
                Some(after) => {
                    assert_eq!(recovery.step(now + after / 2), Step::Wait);
                    now += after;
                    assert_eq!(recovery.step(now), Step::Whole);
                }
                None => assert_eq!(recovery.step(now + seconds(1000.0)), Step::Wait),
            }
        }
        assert!(waits.is_sorted_by_key(|after| after.unwrap_or(Duration::MAX)), "{waits:?}");
        assert_eq!(waits[5..], [None, None]);
        recovery.ask(now);
        assert_eq!(recovery.step(now), Step::Whole);
        // One that lived for long is not in a row.
        recovery.runs(now);
        recovery.done();
        now += seconds(61.0);
        recovery.crashed(crash_phrase(), now);
        recovery.opening(now);
        recovery.picture(now);
        assert_eq!(recovery.outage(now).map(|o| o.stage), Some(OutageStage::Cameras(Some(RESUME_AFTER[0]))));
    }

    #[test]
    fn cameras_that_crash_are_tried_again_with_pauses_for_ever() {
        let mut now = Instant::now();
        let mut recovery = Recovery::new(now);
        let mut pauses = Vec::new();
        for _ in 0..12 {
            recovery.crashed(crash_phrase(), now);
            let begin = now;
            while recovery.step(now) == Step::Wait {
                now += seconds(0.025);
                assert!(now - begin < seconds(10.0));
            }
            pauses.push(now - begin);
            recovery.opening(now);
        }
        assert_eq!(pauses[0], Duration::ZERO);
        assert!(pauses.is_sorted() && pauses[11] <= MAX_PAUSE + seconds(0.05), "{pauses:?}");
    }

    #[test]
    fn a_whole_graph_that_does_not_start_leaves_the_cameras() {
        let now = Instant::now();
        let mut recovery = Recovery::new(now);
        recovery.crashed(crash_phrase(), now);
        recovery.opening(now);
        assert_eq!(recovery.step(now + seconds(6.0)), Step::CamerasAgain);
        recovery.picture(now);
        recovery.ask(now);
        assert_eq!(recovery.step(now), Step::Whole);
        recovery.refused(phrase!("worker-not-started", reason = "no camera"), now);
        let outage = recovery.outage(now).expect("it goes on");
        assert_eq!(
            (outage.stage, outage.why.english().as_str()),
            (OutageStage::Cameras(Some(RESUME_AFTER[1])), "could not be started: no camera")
        );
        assert_eq!(recovery.step(now + RESUME_AFTER[1]), Step::Whole);
    }
}
