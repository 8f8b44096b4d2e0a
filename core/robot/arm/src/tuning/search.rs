//! Gains by a pattern search (Hooke and Jeeves 1961, "Direct search") over the responses of the simulated arm.

use super::TuneError;
use super::course::{Channel, Course, Motion, Response, measure, ramp_error_mm, swing_error_mm};
use super::relay::{Parts, Rule, Tuned, Ultimate};
use crate::control::Goals;
use crate::dynamics::Quality;
use crate::pid::Gains;

/// Size of the steps with which gains are evaluated, mm.
pub const STEP_MM: f64 = 3.0;
/// Speed of the ramps with which gains are evaluated, mm/s.
pub const RAMP_MM_S: f64 = 12.0;
/// Amplitude of the swings, mm: 25 mm/s in the middle.
pub const SWING_MM: f64 = 8.0;
/// Cost of an error of 1 mm while the tip swings, mm s^2.
pub const SWING_COST: f64 = 2.0;
/// Extra latency of a second arm with the same weight: gains must be robust to errors of the model, ms.
pub const LATER_MS: f64 = 30.0;
/// Noise of the tips with which gains are evaluated, px.
pub const NOISE_PX: f64 = 0.5;
/// Cost of a camera acceleration of 100 mm/s^2, mm s^2.
pub const SHAKE_COST: f64 = 0.15;
/// Cost of each percent of overshoot beyond the limit, mm s^2.
pub const OVERSHOOT_COST: f64 = 1.0;
/// Smallest and largest gains that are tried: 1/s, 1/s^2, 1.
pub type Ranges = [(f64, f64); 3];
/// Largest proportional gain as a share of the loop's limit of stability: that of Ziegler and Nichols for a PID. The
/// controller's predictor compensates dead time only as far as its model of the arm is correct, and errors of a few mm
/// do not show where it is wrong.
pub const MAX_OF_ULTIMATE: f64 = 0.6;

/// Ranges of the gains that are tried on a loop.
pub fn ranges(ultimate: &Ultimate) -> Ranges {
    [(0.5, (MAX_OF_ULTIMATE * ultimate.gain).max(0.5)), (0.02, 10.0), (0.005, 1.0)]
}

/// Cost of gains, with its parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// The sum, mm s^2.
    pub total: f64,
    /// ITAE of a step and of a ramp, mean of both arms, mm s^2.
    pub itae: f64,
    /// Error while the tip swings, mean of both arms, mm.
    pub swing_mm: f64,
    /// Overshoot of the step, the larger of both arms, %.
    pub overshoot_pct: f64,
    /// Acceleration of the camera, mean of both arms, mm/s^2.
    pub shake_mm_s2: f64,
}

/// Goals with the gains of one channel replaced.
pub fn with(goals: &Goals, channel: Channel, tuned: Tuned) -> Goals {
    let mut goals = *goals;
    let gains: &mut Gains = match channel {
        Channel::Picture => &mut goals.picture,
        Channel::Distance => &mut goals.distance,
    };
    (gains.proportional, gains.integral, gains.derivative) = (tuned.proportional, tuned.integral, tuned.derivative);
    goals
}

/// Evaluates gains: `itae(step) + itae(ramp) + SWING_COST * error(swing) + SHAKE_COST * shake / 100 + OVERSHOOT_COST *
/// (overshoot - limit)`, averaged over the arm and one with [`LATER_MS`] more latency. Errors are computed with exact
/// tips, shaking with noisy ones.
///
/// # Errors
/// See [`Course::play`].
pub fn cost(
    course: &Course,
    goals: &Goals,
    channel: Channel,
    tuned: Tuned,
    overshoot_limit_pct: f64,
) -> Result<Cost, TuneError> {
    let goals = with(goals, channel, tuned);
    let (mut itae, mut swing_mm, mut overshoot_pct, mut shake) = (0.0, 0.0, 0.0_f64, 0.0);
    for later_ms in [0.0, LATER_MS] {
        let quality = Quality { latency_ms: course.quality.latency_ms + later_ms, ..course.quality };
        let exact = Course { quality, noise_px: 0.0, ..course.clone() };
        let noisy = Course { noise_px: NOISE_PX, ..exact.clone() };
        let (step_motion, ramp_motion) = (Motion::Step(STEP_MM), Motion::Ramp(RAMP_MM_S));
        let step = measure(&exact.play(&goals, channel, step_motion)?, step_motion);
        let ramp = measure(&exact.play(&goals, channel, ramp_motion)?, ramp_motion);
        itae += (step.itae + ramp.itae) / 2.0;
        swing_mm += swing_error_mm(&exact.play(&goals, channel, Motion::Swing(SWING_MM))?) / 2.0;
        overshoot_pct = overshoot_pct.max(step.overshoot_pct);
        for motion in [step_motion, ramp_motion] {
            shake += measure(&noisy.play(&goals, channel, motion)?, motion).shake_mm_s2 / 4.0;
        }
    }
    let beyond = (overshoot_pct - overshoot_limit_pct).max(0.0);
    let total = itae + SWING_COST * swing_mm + SHAKE_COST * shake / 100.0 + OVERSHOOT_COST * beyond;
    Ok(Cost { total, itae, swing_mm, overshoot_pct, shake_mm_s2: shake })
}

/// Start points of a search: the gains of all rules, and those found for fewer parts, with a little of the missing
/// part.
pub fn starts(ultimate: &Ultimate, parts: Parts, fewer: Option<Tuned>) -> Vec<Tuned> {
    let mut out: Vec<Tuned> = Rule::ALL.iter().filter_map(|rule| rule.gains(ultimate, parts)).collect();
    if let Some(fewer) = fewer {
        out.push(fewer);
        let derivative = fewer.proportional * ultimate.period_s / 12.0;
        out.push(Tuned { integral: fewer.integral.max(0.1), derivative, ..fewer });
    }
    out
}

/// Searches from all `starts`; returns the best gains and their cost. Gains of unused parts are 0. Calls `tried` after
/// each trial, which ends the search by returning false.
///
/// # Errors
/// See [`Course::play`].
pub fn search(
    starts: &[Tuned],
    ranges: &Ranges,
    parts: Parts,
    judge: &mut dyn FnMut(Tuned) -> Result<Cost, TuneError>,
    tried: &mut dyn FnMut(Tuned, &Cost) -> bool,
) -> Result<(Tuned, Cost), TuneError> {
    let used = match parts {
        Parts::P => 1,
        Parts::Pi => 2,
        Parts::Pid => 3,
    };
    let clamp = |k: usize, gain: f64| gain.clamp(ranges[k].0, ranges[k].1);
    let tuned = |at: [f64; 3]| Tuned { proportional: at[0], integral: at[1], derivative: at[2] };
    let first = [Tuned { proportional: 1.0, integral: 0.0, derivative: 0.0 }];
    let mut cheapest: Option<([f64; 3], Cost)> = None;
    let mut goes_on = true;
    for start in if starts.is_empty() { &first } else { starts } {
        let all = [start.proportional, start.integral, start.derivative];
        let mut at: [f64; 3] = std::array::from_fn(|k| if k < used { clamp(k, all[k]) } else { 0.0 });
        let mut best = judge(tuned(at))?;
        goes_on = goes_on && tried(tuned(at), &best);
        // Steps of gains are factors.
        for factor in [2.0, 1.4, 1.15] {
            let mut moved = true;
            while moved && goes_on {
                moved = false;
                for (k, by) in (0..used).flat_map(|k| [(k, factor), (k, 1.0 / factor)]) {
                    let mut next = at;
                    next[k] = clamp(k, at[k] * by);
                    if next == at || !goes_on {
                        continue;
                    }
                    let cost = judge(tuned(next))?;
                    goes_on = tried(tuned(next), &cost);
                    if cost.total < best.total {
                        (at, best, moved) = (next, cost, true);
                    }
                }
            }
        }
        if cheapest.is_none_or(|(_, least)| best.total < least.total) {
            cheapest = Some((at, best));
        }
        if !goes_on {
            break;
        }
    }
    let (at, best) = cheapest.ok_or(TuneError::NotFinite { at_s: 0.0 })?;
    Ok((tuned(at), best))
}

/// Responses with some gains, with exact tips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Response to a step of [`STEP_MM`].
    pub step: Response,
    /// Error while a ramp of [`RAMP_MM_S`] is followed, mm.
    pub ramp_mm: f64,
    /// The same without feed-forward: the PID alone.
    pub ramp_alone_mm: f64,
}

/// Measures gains on exact tips.
///
/// # Errors
/// See [`Course::play`].
pub fn report(course: &Course, goals: &Goals, channel: Channel, tuned: Tuned) -> Result<Report, TuneError> {
    let goals = with(goals, channel, tuned);
    let alone = Goals { feed_forward: 0.0, ..goals };
    Ok(Report {
        step: measure(&course.play(&goals, channel, Motion::Step(STEP_MM))?, Motion::Step(STEP_MM)),
        ramp_mm: ramp_error_mm(&course.play(&goals, channel, Motion::Ramp(RAMP_MM_S))?),
        ramp_alone_mm: ramp_error_mm(&course.play(&alone, channel, Motion::Ramp(RAMP_MM_S))?),
    })
}
