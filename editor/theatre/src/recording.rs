//! Stills and clips of what is shown.

use std::time::Instant;

use super::keep::{self, Clip};
use super::notices::{FULL_BYTES, STOPPED};
use super::{Place, Theatre};
use panoscope_editor_model::disk::is_full;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::session::Status;

impl Theatre {
    pub(super) fn still(&mut self) {
        let pixels = if self.measure.is_on() {
            self.measure.pixels()
        } else {
            let main = self.plan.views.get(self.layout.main());
            let raw = self.plan.raw.as_ref().filter(|_| self.raw_only.is_some());
            match raw {
                Some(raw) => self.live.pixels(&raw.output).cloned(),
                None => main.and_then(|m| self.shown.pixels(&m.output).cloned()),
            }
        };
        let result = pixels.map(|pixels| self.keeper.still(pixels));
        match result {
            Some(Ok(())) => {}
            Some(Err(words)) => self.say(words, true),
            None => self.say("there is no picture yet", true),
        }
    }

    /// The output that a clip would hold: the main view if it is a picture, else the first picture.
    fn to_record(&self) -> Option<Place> {
        let raw = self.plan.raw.as_ref().filter(|_| self.raw_only.is_some());
        let main = self.plan.views.get(self.layout.main());
        let others = self.plan.views.iter().chain(&self.plan.raw);
        raw.into_iter().chain(main).chain(others).find(|p| p.packet == "image").cloned()
    }

    pub(super) fn record(&mut self) {
        if self.clip.is_some() {
            self.end_clip();
            return;
        }
        if self.raw_only.is_some() {
            self.say("clips need the whole graph; stills can be kept", true);
            return;
        }
        let Some(place) = self.to_record() else {
            let packets: Vec<&str> = self.plan.views.iter().map(|v| v.packet.as_str()).collect();
            let words = match packets.is_empty() {
                true => "this graph shows no picture: there is nothing to record".to_owned(),
                false => format!(
                    "a clip holds pictures, and this graph shows only {}: keep a still, or give the preset a picture",
                    packets.join(" and ")
                ),
            };
            return self.say(words, true);
        };
        let main = self.plan.views.get(self.layout.main()).filter(|_| self.raw_only.is_none());
        let instead = main
            .filter(|m| m.output != place.output)
            .map(|m| format!("{} is no picture: the clip holds {}", m.label, place.label));
        if self.keeper.free_bytes().is_some_and(|free| free < FULL_BYTES) {
            return self.say("the disk is full", true);
        }
        let begun = self.keeper.next_file("clip", "mkv").and_then(|file| {
            let (text, node) = keep::with_clip(&self.text, &place.output, &file).map_err(|e| e.to_string())?;
            Ok((text, Clip { node, file, since: Instant::now() }))
        });
        match begun {
            Ok((text, clip)) => {
                self.clip = Some(clip);
                self.run(text);
                if let Some(words) = instead {
                    self.say(words, false);
                }
            }
            Err(words) => self.say(words, true),
        }
    }

    /// Forgets the clip, in the text too; answers it.
    pub(super) fn clip_is_over(&mut self) -> Option<Clip> {
        let clip = self.clip.take()?;
        if let Ok(text) = keep::without_clip(&self.text, &clip.node) {
            self.text = text;
        }
        Some(clip)
    }

    fn end_clip(&mut self) {
        if let Some(clip) = self.clip_is_over() {
            self.run(self.text.clone());
            self.say(format!("{} is kept", clip.file.file_name().unwrap_or_default().to_string_lossy()), false);
        }
    }

    /// Stills that were written; a clip that cannot go on.
    pub(super) fn keep_up(&mut self, status: &Status, counters: &Counters) {
        for done in self.keeper.finished() {
            match done {
                Ok(name) => self.say(format!("{name} is kept"), false),
                Err(words) => self.say(words, true),
            }
        }
        let Some(clip) = &self.clip else { return };
        let name = clip.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let fault = counters.faults.get(&clip.node).map(|f| f.words.clone());
        let refused = status.trouble.as_ref().filter(|_| !status.busy && clip.since.elapsed() > STOPPED);
        let full = self.keeper.free_bytes().is_some_and(|free| free < FULL_BYTES);
        if let Some(trouble) = refused {
            let words = format!("the clip was not begun: {}", trouble.words);
            self.clip_is_over();
            self.run(self.text.clone());
            self.say(words, true);
        } else if full || fault.is_some() {
            self.end_clip();
            let full = full || fault.as_ref().is_some_and(|f| is_full(f));
            let why = if full { "the disk is full".to_owned() } else { fault.unwrap_or_default() };
            self.say(format!("{name} ended early: {why}; what was recorded is kept"), true);
        }
    }
}
