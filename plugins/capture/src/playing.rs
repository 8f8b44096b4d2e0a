//! Pause, single steps and speed of files that are shown live.

use panoscope_node::{Context, Params};

/// Period at which a held frame is repeated, s.
pub const HELD_PERIOD_S: f64 = 0.1;

/// How files are played in live mode. Batch mode and cameras ignore it.
#[derive(Params, Clone, Copy, Debug)]
pub struct Playing {
    /// Holds files at their frame, which is repeated ten times a second, so that changes of other nodes show on it. Live mode only; cameras go on.
    /// Each repetition is a tick: `read_maps` and `read_labels`, which count ticks, no longer fit afterwards; `data_set` does.
    #[param(default = false)]
    pub paused: bool,
    /// Shows one more frame whenever this number changes, while `paused`.
    #[param(default = 0, range = 0..=1000000000)]
    pub step: u64,
    /// How fast files are played in live mode: 2 is twice their rate. Capture times pass as the frames are shown.
    #[param(default = 1.0, range = 0.25..=4.0, unit = "ratio")]
    pub speed: f64,
}

impl Default for Playing {
    fn default() -> Self {
        Self { paused: false, step: 0, speed: 1.0 }
    }
}

/// Follows the number of steps asked for.
#[derive(Debug, Default)]
pub struct Steps {
    known: Option<u64>,
}

impl Steps {
    /// Whether the frame is held in this tick.
    pub fn holds(&mut self, cx: &Context<'_>, playing: &Playing) -> bool {
        let goes_on = self.known.replace(playing.step).is_some_and(|known| known != playing.step);
        playing.paused && !goes_on && !cx.is_batch()
    }
}
