//! Holds the frame that `capture` shows while its files are paused.

use panoscope_node::{Context, Result};

use super::{Capture, Part};
use crate::playing::HELD_PERIOD_S;
use crate::settings::Settings;
use crate::source::Clock;

impl Capture {
    /// Repeats the frame that is shown; an empty tick where there is none.
    ///
    /// # Errors
    /// A crop does not fit a frame.
    pub(super) fn hold(&mut self, cx: &Context<'_>, clock: Clock<'_>, params: &Settings) -> Result<Option<Vec<Part>>> {
        cx.set_capture_ns(self.timing.hold((HELD_PERIOD_S * 1e9) as i64));
        self.wait(cx, clock, params.pace, HELD_PERIOD_S);
        // A damaged frame has left no picture.
        self.views.iter().for_each(|view| view.is_there = view.picture.width > 0);
        let parts = self.parts(cx, clock, params)?;
        Ok((!parts.is_empty()).then_some(parts))
    }
}
