//! Records stills and clips of the views.

use super::notices::{FULL_BYTES, STOPPED, gravest, is_harmless};
use super::storage::{self, Clip};
use super::{Pane, Theatre, time};
use panoscope_editor_model::disk::is_full;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::session::Status;
use panoscope_editor_model::texts::text;
use panoscope_host::audit::{ClipState, Event};

impl Theatre {
    /// Saves a still of the main view, or of the image being measured.
    pub(super) fn still(&mut self) {
        let pixels = if self.measure.is_on() {
            self.measure.pixels()
        } else {
            let main = self.plan.views.get(self.layout.main());
            // What is shown: the camera's own image in place of a view that is too old.
            let raw = self.raw().filter(|_| self.shows_raw() || main.is_some_and(|main| self.is_withdrawn(main)));
            match raw {
                Some(raw) => self.live.pixels(&raw.output).cloned(),
                None => main.and_then(|m| self.shown.pixels(&m.output).cloned()),
            }
        };
        let row = self.measure.row();
        let result = pixels.map(|pixels| self.storage.still(pixels, row));
        match result {
            Some(Ok(number)) => self.audit.log(Event::Still { number }),
            Some(Err(error)) => self.notify(error.words(), true),
            None => self.notify(text!("view-no-image-yet"), true),
        }
    }

    /// Measures the files that the graph writes on this machine.
    pub(super) fn watch_sinks(&mut self) {
        let paths = self.plan.written.iter().filter(|_| self.machine.is_none()).map(|written| written.path.clone());
        let paths = paths.collect();
        if let Err(error) = self.sink_files.watch(paths) {
            self.notify(error.to_string(), true);
        }
    }

    /// The view to record: the main view if it is an image, else the first image.
    fn clip_view(&self) -> Option<Pane> {
        let raw = self.raw().filter(|_| self.shows_raw());
        let main = self.plan.views.get(self.layout.main());
        let others = self.plan.views.iter().chain(&self.plan.raw);
        raw.into_iter().chain(main).chain(others).find(|p| p.packet == "image").cloned()
    }

    /// Starts or ends a clip.
    pub(super) fn record(&mut self) {
        if self.clip.is_some() {
            self.end_clip(ClipState::Ended);
            return;
        }
        if self.shows_raw() {
            self.notify(text!("clip-needs-graph"), true);
            return;
        }
        let Some(pane) = self.clip_view() else {
            let packets: Vec<&str> = self.plan.views.iter().map(|v| v.packet.as_str()).collect();
            let message = match packets.is_empty() {
                true => text!("clip-nothing").to_owned(),
                false => {
                    let join = |all: String, next: &&str| match all.is_empty() {
                        true => (*next).to_owned(),
                        false => text!("clip-and", first = all, second = *next),
                    };
                    text!("clip-needs-image", packets = packets.iter().fold(String::new(), join))
                }
            };
            return self.notify(message, true);
        };
        let main = self.plan.views.get(self.layout.main()).filter(|_| !self.shows_raw());
        let instead = main
            .filter(|m| m.output != pane.output)
            .map(|m| text!("clip-instead", view = m.title(), shown = pane.title()));
        if self.storage.free_bytes().is_some_and(|free| free < FULL_BYTES) {
            return self.notify(text!("disk-is-full"), true);
        }
        match self.storage.start_clip(&self.text, &pane.output) {
            Ok((text, clip)) => {
                self.audit.log(Event::Clip { number: clip.number, state: ClipState::Started });
                self.clip = Some(clip);
                self.run(text);
                if let Some(message) = instead {
                    self.notify(message, false);
                }
            }
            Err(error) => self.notify(error.to_string(), true),
        }
    }

    /// Removes the clip from the graph's text and returns it.
    pub(super) fn take_clip(&mut self, state: ClipState) -> Option<Clip> {
        let clip = self.clip.take()?;
        self.audit.log(Event::Clip { number: clip.number, state });
        if let Ok(text) = storage::without_clip(&self.text, &clip.node) {
            self.set_text(text);
        }
        Some(clip)
    }

    fn end_clip(&mut self, state: ClipState) {
        if let Some(clip) = self.take_clip(state) {
            self.run(self.text.clone());
            self.notify(text!("saved", file = clip.file.file_name().unwrap_or_default().to_string_lossy()), false);
        }
    }

    /// Reports written stills, and ends a clip that cannot continue.
    pub(super) fn update_recordings(&mut self, status: &Status, counters: &Counters) {
        for done in self.storage.finished() {
            match done {
                Ok(name) => self.notify(text!("saved", file = name), false),
                Err(error) => self.notify(error.words(), true),
            }
        }
        let Some(clip) = &self.clip else { return };
        let name = clip.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // A clip that lacks frames goes on.
        let fault = gravest(counters, &clip.node).filter(|fault| !is_harmless(fault)).map(|fault| fault.words.clone());
        let refused = status.problem.as_ref().filter(|_| !status.busy && time::since(clip.since) > STOPPED);
        let full = self.storage.free_bytes().is_some_and(|free| free < FULL_BYTES);
        if let Some(problem) = refused {
            let message = text!("clip-not-started", reason = &problem.message);
            self.take_clip(ClipState::Failed);
            self.run(self.text.clone());
            self.notify(message, true);
        } else if full || fault.is_some() {
            self.end_clip(ClipState::Failed);
            let full = full || fault.as_ref().is_some_and(|f| is_full(f));
            let why = if full { text!("disk-is-full").to_owned() } else { fault.unwrap_or_default() };
            self.notify(text!("clip-ended-early", file = name, reason = why), true);
        }
    }
}
