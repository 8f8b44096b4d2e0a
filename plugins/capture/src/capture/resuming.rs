//! The position of `capture` in its files, for the instance that replaces it.

use std::path::Path;
use std::sync::PoisonError;

use super::Capture;
use crate::position::{Position, ViewPosition};

impl Capture {
    /// The position after the newest tick.
    pub(super) fn position(&self) -> Position {
        let views = self.views.locked().iter().map(|view| {
            let view = view.lock().unwrap_or_else(PoisonError::into_inner);
            ViewPosition {
                text: view.text.clone(),
                grabbed: view.source.grabbed(),
                next_file: view.source.next_file().map(Path::to_owned),
            }
        });
        Position {
            frame: self.frame,
            capture_ns: self.timing.capture_ns,
            played: self.timing.played,
            round_s: self.views.round_s,
            views: views.collect(),
        }
    }

    /// Goes on at a position. Sources with other names start at their beginning.
    pub(super) fn resume(&mut self, position: &Position) {
        let texts: Vec<String> = self.views.iter().map(|view| view.text.clone()).collect();
        if !texts.iter().eq(position.views.iter().map(|view| &view.text)) {
            return;
        }
        (self.frame, self.views.round_s) = (position.frame, position.round_s);
        (self.timing.capture_ns, self.timing.played) = (position.capture_ns, position.played);
        for (view, position) in self.views.iter().zip(&position.views) {
            view.source.go_to(position.grabbed, position.next_file.as_deref());
        }
    }
}
