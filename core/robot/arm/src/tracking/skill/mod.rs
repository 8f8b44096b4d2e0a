//! Measures of surgical skill from the tracks of instrument tips.
//!
//! A [`Session`] takes samples in the order of time, in bounded memory, and returns [`Measures`] per tool and per
//! phase, and [`Together`] per pair of tools. What each measure means, with its source, is documented where it is
//! computed:
//!
//! | measure | file | source |
//! |---|---|---|
//! | time, time out of view, path, speed, depth along the view | [`measures`] | Oropesa et al. 2013, "Relevance of motion-related assessment metrics in laparoscopic surgery"; Chmarra et al. 2007, "The influence of experience and camera holding on laparoscopic instrument movements" |
//! | economy of motion | [`movement`] | Oropesa et al. 2013 (straight distance over path) |
//! | idle share | [`measures`] | D'Angelo et al. 2015, "Idle time: an underdeveloped performance metric for assessing surgical skill" |
//! | jerk, log dimensionless jerk | [`smoothness`] | Hogan and Sternad 2009, "Sensitivity of smoothness measures to movement duration, amplitude, and arrests"; Balasubramanian et al. 2012 |
//! | spectral arc length | [`smoothness`] | Balasubramanian et al. 2012, "A robust and sensitive metric for quantifying movement smoothness"; 2015, "On the analysis of movement smoothness" |
//! | working volume | [`workspace`] | Oropesa et al. 2013 |
//! | bimanual dexterity | [`bimanual`] | Hofstad et al. 2013, "A study of psychomotor skills in minimally invasive surgery: what differentiates expert and nonexpert performance" |
//! | contacts, grasps | [`measures`] | ours: jaws are not observed |
//!
//! **From samples to movement.** Time is divided into cells of [`CELL_S`]. Place and velocity in the middle of a cell come from a cubic that is
//! fitted to the samples around it ([`local_fit`], after Savitzky and Golay 1964, for any spacing of samples). Samples
//! farther apart than [`Settings::max_gap_s`] leave a stretch out of view between them; nearer ones are bridged. A tool
//! is idle where it is slower than [`Settings::rest_mm_s`] for at least [`Settings::rest_s`]; a movement lies between
//! two stretches of idleness or absence. Smoothness is measured on each movement, from where its speed first passes a
//! tenth of its peak (or rest, where that is faster) to where it last does, on a quintic spline through its samples
//! ([`spline`]).

pub mod bimanual;
pub mod local_fit;
pub mod measures;
pub mod motions;
pub mod movement;
mod session;
pub mod smoothness;
pub mod spline;
mod tool;
pub mod workspace;

pub use bimanual::Together;
pub use measures::Measures;
pub use movement::Movement;
pub use session::{Cell, Session, ToolReport};

/// Length of a cell of time, s.
pub const CELL_S: f64 = 0.01;

/// A tip at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time, s.
    pub at_s: f64,
    /// Position in the scene, mm.
    pub place_mm: [f64; 3],
    /// Depth along the view: z in the camera's frame, mm.
    pub depth_mm: f64,
    /// Distance to the tissue, mm, below 0 inside; NaN if unknown.
    pub tissue_mm: f64,
}

/// Thresholds of the measures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Maximum time between samples, s; a longer gap counts as out of view.
    pub max_gap_s: f64,
    /// Half width of the window in which position and velocity are fitted, s. Fewer than [`local_fit::MIN_SAMPLES`]
    /// samples widen it.
    pub window_s: f64,
    /// Speed below which a tool rests, mm/s.
    pub rest_mm_s: f64,
    /// Minimum rest that counts as idle, s.
    pub rest_s: f64,
    /// Distance between knots of the spline from which jerk is computed, s: frequencies above about half its inverse
    /// are smoothed away.
    pub knot_s: f64,
    /// Distance to the tissue at which a tip touches it, mm.
    pub touch_mm: f64,
    /// Minimum touch that counts, s.
    pub touch_s: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { max_gap_s: 0.25, window_s: 0.08, rest_mm_s: 3.0, rest_s: 0.3, knot_s: 0.1, touch_mm: 1.5, touch_s: 0.2 }
    }
}

impl Settings {
    fn touch_rule(&self) -> crate::tracking::proximity::Rule {
        crate::tracking::proximity::Rule { on_mm: self.touch_mm, off_mm: 1.5 * self.touch_mm, min_s: self.touch_s }
    }
}
