//! Scripted movements of the leading instrument, for evaluating trackers of its tip.
//!
//! All start at the tip's home position and are defined for any time. They use only `+ - * /`, square roots and integer hashes, like the rest of the
//! renderer.

use super::math::{Stream, cos_turns, sin_turns};

/// Movement of the first instrument.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ToolMotion {
    /// Like all other instruments: slow swings about a seeded home position.
    #[default]
    Sway,
    /// At rest.
    Still,
    /// Steps of 12 mm: 10 mm to the side and 6 mm down, and back, at a surgeon's speed, every 4 s.
    Step,
    /// To and fro over 36 mm at a steady 12 mm/s.
    Ramp,
    /// A circle of 12 mm radius in 5 s, with depth.
    Circle,
    /// Strokes like a surgeon's: from point to point (seeded), with bell-shaped speeds up to 25 mm/s and rests between.
    Strokes,
    /// Leaves the image along its shaft, faster than any arm may follow, and returns slowly, every 12 s.
    Leave,
    /// Rests while the second instrument passes in front of it, to and fro.
    Cross,
}

/// Time before anything moves, s.
pub const START_S: f64 = 2.0;
/// Number of points of a script of strokes; the script then repeats.
const POINTS: usize = 64;
/// Maximum offset of strokes from home to either side, mm.
const REACH_MM: [f32; 3] = [20.0, 13.0, 8.0];
/// Range of maximum speeds of strokes, mm/s.
const STROKE_MM_S: (f32, f32) = (12.0, 25.0);
/// Maximum speed of steps, mm/s.
const FAST_MM_S: f64 = 25.0;
/// Distance by which an instrument is retracted, mm, and its speeds out and back, mm/s.
const LEAVE_MM: f64 = 80.0;
const LEAVE_MM_S: (f64, f64) = (150.0, 40.0);

/// A stroke and the rest after it.
#[derive(Clone, Copy, Debug)]
struct Stroke {
    from: [f64; 3],
    to: [f64; 3],
    start_s: f64,
    /// Duration of the movement, s.
    length_s: f64,
}

/// Script of one instrument: offsets from its home position.
#[derive(Clone, Debug)]
pub struct Script {
    motion: ToolMotion,
    strokes: Vec<Stroke>,
    period_s: f64,
}

/// Rises from 0 to 1 without jerk at its ends; its maximum speed is 15/8.
fn bell(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 - t * (15.0 - 6.0 * t))
}

/// Duration of a bell-shaped movement, s.
fn bell_s(way_mm: f64, top_mm_s: f64) -> f64 {
    1.875 * way_mm / top_mm_s
}

impl Script {
    /// The script for a movement and a seed.
    pub fn new(motion: ToolMotion, seed: u64) -> Self {
        let mut stream = Stream::new(seed, 420);
        let mut strokes = Vec::new();
        let (mut at, mut clock) = ([0.0; 3], 0.0);
        if motion == ToolMotion::Strokes {
            for k in 0..POINTS {
                // The last one leads home, so that the script closes.
                let to = if k + 1 == POINTS { [0.0; 3] } else { REACH_MM.map(|r| f64::from(stream.range(-r, r))) };
                let distance_mm = (0..3).map(|k| (to[k] - at[k]) * (to[k] - at[k])).sum::<f64>().sqrt();
                let length_s = bell_s(distance_mm, f64::from(stream.range(STROKE_MM_S.0, STROKE_MM_S.1))).max(0.1);
                strokes.push(Stroke { from: at, to, start_s: clock, length_s });
                clock += length_s + f64::from(stream.range(0.1, 0.6));
                at = to;
            }
        }
        Self { motion, strokes, period_s: clock.max(1.0) }
    }

    /// Whether the instrument only swings.
    pub fn is_sway(&self) -> bool {
        self.motion == ToolMotion::Sway
    }

    /// Offset of the leading tip from its home position, mm; `away` is the direction in which its shaft leaves.
    pub fn at(&self, seconds: f64, away: [f64; 3]) -> [f64; 3] {
        let t = (seconds - START_S).max(0.0);
        match self.motion {
            ToolMotion::Sway | ToolMotion::Still | ToolMotion::Cross => [0.0; 3],
            ToolMotion::Step => {
                let length = bell_s(12.0, FAST_MM_S);
                let turn = (t / 4.0).floor();
                let rise = bell((t - 4.0 * turn) / length);
                let part = if (turn * 0.5).floor() * 2.0 == turn { rise } else { 1.0 - rise };
                [10.0 * part, 6.0 * part, 0.0]
            }
            ToolMotion::Ramp => {
                // 18 mm to the right, 36 mm to the left, and so on; the script begins in the middle.
                let turns = t * 12.0 / 72.0 + 0.25;
                let saw = turns - turns.floor();
                let triangle = if saw < 0.5 { 4.0 * saw - 1.0 } else { 3.0 - 4.0 * saw };
                [18.0 * triangle, 0.0, 0.0]
            }
            ToolMotion::Circle => {
                let turns = t / 5.0;
                // Spirals out in the first turn.
                let radius = 12.0 * bell(turns);
                [radius * cos_turns(turns), radius * sin_turns(turns), 0.3 * radius * sin_turns(2.0 * turns)]
            }
            ToolMotion::Strokes => {
                let t = t - (t / self.period_s).floor() * self.period_s;
                let index = self.strokes.partition_point(|stroke| stroke.start_s <= t).saturating_sub(1);
                let Some(stroke) = self.strokes.get(index) else { return [0.0; 3] };
                let part = bell((t - stroke.start_s) / stroke.length_s);
                [0, 1, 2].map(|k| stroke.from[k] + (stroke.to[k] - stroke.from[k]) * part)
            }
            ToolMotion::Leave => {
                let (out, back) = (bell_s(LEAVE_MM, LEAVE_MM_S.0), bell_s(LEAVE_MM, LEAVE_MM_S.1));
                let phase = t - (t / 12.0).floor() * 12.0;
                // Out from 0 s, back from 6 s.
                let part = bell(phase / out) - bell((phase - 6.0) / back);
                away.map(|a| LEAVE_MM * a * part)
            }
        }
    }

    /// Position of the second instrument's tip relative to the first one's home when it passes in front of it, mm; `None` if it does not.
    pub fn crossing(&self, seconds: f64) -> Option<[f64; 3]> {
        if self.motion != ToolMotion::Cross {
            return None;
        }
        let turns = seconds / 8.0;
        // From beside the picture's middle to beyond it, 8 mm before the leading tip.
        Some([-18.0 * cos_turns(turns), 2.0, -8.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scripts_start_at_home_and_keep_their_speeds() {
        let motions = [
            (ToolMotion::Still, 0.0),
            (ToolMotion::Step, 25.0),
            (ToolMotion::Ramp, 12.0),
            (ToolMotion::Circle, 19.0),
            (ToolMotion::Strokes, 25.0),
            (ToolMotion::Leave, 150.0),
        ];
        for (motion, limit) in motions {
            for seed in [1, 7] {
                let script = Script::new(motion, seed);
                let place = |k: u32| script.at(f64::from(k) * 0.005, [0.6, 0.0, -0.8]);
                assert_eq!(place(0), [0.0; 3], "{motion:?}");
                let mut top: f64 = 0.0;
                for k in 0..20_000 {
                    let (a, b) = (place(k), place(k + 1));
                    let speed = (0..3).map(|i| (b[i] - a[i]) * (b[i] - a[i])).sum::<f64>().sqrt() / 0.005;
                    top = top.max(speed);
                }
                assert!(top <= limit + 0.05 && top >= 0.8 * limit, "{motion:?}: {top} mm/s");
            }
        }
    }
}
