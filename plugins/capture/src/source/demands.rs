//! Requests to a source, and the result of a grab.

use std::time::Duration;

/// Reads the host's monotonic clock, ns.
pub type Clock<'c> = &'c dyn Fn() -> i64;

/// Requested mode of a device (0 keeps its own), time limits, and whether frames may be dropped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demands {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// Frames per second.
    pub fps: f64,
    /// Time limit for opening.
    pub open_limit: Duration,
    /// A live source without data for this long is lost.
    pub silence_limit: Duration,
    /// Whether no frame may be dropped, not even of a live source.
    pub is_lossless: bool,
}

/// Values at which a device's automatics are locked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lock {
    /// Exposure and gain in the driver's units.
    pub exposure: Option<(f64, f64)>,
    /// Colour temperature in K.
    pub white_balance_k: Option<f64>,
}

/// Result of a grab.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Grab {
    /// A frame is ready. Its arrival, ns of `CLOCK_MONOTONIC`, if the source is live.
    Ready(Option<i64>),
    /// The source has ended.
    End,
    /// The source has ended before the announced number of frames; says what is missing.
    Failed(String),
    /// The device or stream is gone; says why. It is reopened with growing pauses.
    Lost(String),
}
