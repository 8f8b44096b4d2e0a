//! Pause, step, loop and speed: of the recording that is shown, else of the files that the running graph reads.

use super::App;
use panoscope_editor_model::playing::{self, Change, Playing, next_speed};
use panoscope_editor_model::session::{Phase, Status};
use panoscope_editor_model::texts::text;

impl App {
    /// How the recording or the files are played; `None` where there are none.
    pub fn playing(&self) -> Option<Playing> {
        self.playing_now(&self.session.status())
    }

    pub(super) fn playing_now(&self, status: &Status) -> Option<Playing> {
        if let Some(timeline) = &self.timeline {
            let position = timeline.position();
            return Some(Playing { plays: position.plays, loops: position.range_s.is_some(), speed: position.speed });
        }
        let runs = status.phase == Phase::Running && !self.is_attached();
        runs.then(|| playing::of_files(&self.document, &self.observer.counters())).flatten()
    }

    /// Changes how the recording or the files are played.
    pub(super) fn change_playing(&mut self, change: Change) {
        let Some(now) = self.playing() else { return self.notify(text!("need-recording"), true) };
        match (&self.timeline, change) {
            (Some(timeline), Change::Toggle) => timeline.play(!now.plays),
            (Some(timeline), Change::Step) => timeline.step(1),
            (Some(timeline), Change::Speed) => timeline.set_speed(next_speed(now.speed)),
            (Some(timeline), Change::Loop) => timeline.set_range((!now.loops).then(|| (0.0, timeline.length_s()))),
            (None, change) => _ = playing::change(&mut self.document, &self.observer.counters(), change),
        }
    }
}
