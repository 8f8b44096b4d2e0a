//! What a source is asked for, and what a grab returns.

use std::time::Duration;

/// Reads the host's monotonic clock, ns.
pub type Clock<'c> = &'c dyn Fn() -> i64;

/// Mode asked of a device, 0 leaves its own; time limits; and whether pictures may be dropped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demands {
    /// Columns in px.
    pub width: u32,
    /// Rows in px.
    pub height: u32,
    /// Frames per second.
    pub fps: f64,
    /// Longest time that opening may take.
    pub open_limit: Duration,
    /// A live source without data for this long is lost.
    pub silence_limit: Duration,
    /// No picture of a live source is dropped either.
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
    /// A picture waits to be taken. Its arrival, ns of `CLOCK_MONOTONIC`, where the source is live.
    Ready(Option<i64>),
    /// The source has ended.
    End,
    /// The source has ended before the announced number of pictures: what is missing, in words.
    Failed(String),
    /// The device or stream is gone, and why; it is opened again with growing pauses.
    Lost(String),
}
