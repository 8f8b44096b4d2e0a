//! Gains that equalise exposure and white balance between views, stable over time.
//!
//! Views of a static scene differ by sensor noise from frame to frame. A gain that followed it would make the image
//! flicker, so the gain is constant until the measured one leaves a dead band. Gains of colour channels between a view
//! in colour and one in gray would tint one of them, so such a pair is matched in brightness only.

use super::params::{CompositeParams, ExposureMethod};

/// Luma weights of B, G, R in 1/256 (ITU-R BT.601).
const LUMA: [u64; 3] = [29, 150, 77];
/// Shares of samples without colour below which a view counts as one in colour, and above which as one in gray. Between
/// them both gains are mixed, so that the decision does not flicker.
const GRAY_SHARE: [f32; 2] = [0.8, 0.95];
/// Largest spread of the channels of a sample without colour: this many levels and this share of the brightest channel.
/// Covers what JPEG and video codecs do to gray.
const NEUTRAL_LEVELS: u8 = 4;
const NEUTRAL_PART: u8 = 32;
/// Fewest samples that a gain is measured on.
const MIN_SAMPLES: u64 = 16;
/// Relative error of a running gain at which it starts and stops following the measured one.
const DEAD_BAND: [f32; 2] = [0.008, 0.002];

/// Sums over samples of the overlap, of the images joined so far and of the new view.
#[derive(Clone, Copy, Debug, Default)]
pub struct OverlapLight {
    base: [u64; 3],
    new: [u64; 3],
    count: u64,
    neutral: [u64; 2],
}

fn is_usable(p: [u8; 4]) -> bool {
    p[..3].iter().all(|v| *v < 245) && p[..3].iter().any(|v| *v > 12)
}

fn is_neutral(p: [u8; 4]) -> bool {
    let (low, high) = (p[0].min(p[1]).min(p[2]), p[0].max(p[1]).max(p[2]));
    high - low <= NEUTRAL_LEVELS + high / NEUTRAL_PART
}

impl OverlapLight {
    /// Adds a sample that both show, B, G, R. Dark and saturated ones are ignored.
    pub fn add(&mut self, base: [u8; 4], new: [u8; 4]) {
        if !(is_usable(base) && is_usable(new)) {
            return;
        }
        self.count += 1;
        for c in 0..3 {
            self.base[c] += u64::from(base[c]);
            self.new[c] += u64::from(new[c]);
        }
        self.neutral[0] += u64::from(is_neutral(base));
        self.neutral[1] += u64::from(is_neutral(new));
    }

    /// Confidence that one of them is gray, 0..=1.
    fn grayness(&self) -> f32 {
        let share = self.neutral[0].max(self.neutral[1]) as f32 / self.count as f32;
        ((share - GRAY_SHARE[0]) / (GRAY_SHARE[1] - GRAY_SHARE[0])).clamp(0.0, 1.0)
    }

    /// Gain of the new view that brings its mean to that of the images joined so far, B, G, R; `None` when too few
    /// samples count.
    pub fn gain(&self, method: ExposureMethod) -> Option<[f32; 3]> {
        if self.count < MIN_SAMPLES {
            return None;
        }
        let ratio = |a: u64, b: u64| (a as f32 / (b as f32).max(1.0)).clamp(0.5, 1.99);
        let luma = |sums: &[u64; 3]| sums.iter().zip(LUMA).map(|(sum, weight)| sum * weight).sum();
        Some(match method {
            ExposureMethod::None => [1.0; 3],
            ExposureMethod::Gain => [ratio(self.base.iter().sum(), self.new.iter().sum()); 3],
            ExposureMethod::ChannelGain => {
                let (gray, light) = (self.grayness(), ratio(luma(&self.base), luma(&self.new)));
                std::array::from_fn(|c| {
                    let own = ratio(self.base[c], self.new[c]);
                    own + gray * (light - own)
                })
            }
        })
    }
}

/// The gain of a view over time.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunningGain {
    /// Whether a gain has been measured.
    is_known: bool,
    /// Whether the gain follows the measured one.
    follows: bool,
}

impl RunningGain {
    /// Moves `gain` towards the measured one, unless the difference is within noise.
    pub fn update(&mut self, gain: &mut [f32; 3], measured: [f32; 3], params: &CompositeParams) {
        let rate = params.exposure_rate.clamp(0.0, 1.0);
        if !self.is_known || rate >= 1.0 {
            (self.is_known, *gain) = (true, measured);
            return;
        }
        let error = gain.iter().zip(&measured).map(|(gain, to)| (to / gain - 1.0).abs()).fold(0.0, f32::max);
        self.follows = error > DEAD_BAND[usize::from(self.follows)];
        if self.follows {
            for (gain, to) in gain.iter_mut().zip(&measured) {
                *gain += rate * (to - *gain);
            }
        }
    }
}

/// Gain as Q14 lanes.
pub fn fixed_gain(gain: &[f32; 3]) -> [i16; 4] {
    let q = |g: f32| (g * 16384.0 + 0.5).clamp(0.0, 32767.0) as i16;
    [q(gain[0]), q(gain[1]), q(gain[2]), 0]
}

#[cfg(test)]
mod tests {
    use super::super::tests::{SIZE, compose, shoot, tilted};
    use super::super::{Compositor, GeometryState, IDENTITY};
    use super::*;
    use crate::Serial;

    fn pair() -> [Vec<u8>; 2] {
        [shoot(&IDENTITY, SIZE.0, SIZE.1, 1.0), shoot(&tilted(), SIZE.0, SIZE.1, 1.0)]
    }

    /// The view of a camera without colour, `noise` levels wrong in each channel.
    fn gray(view: &[u8], gain: f64, noise: u8) -> Vec<u8> {
        let levels = view
            .as_chunks::<3>()
            .0
            .iter()
            .map(|[b, g, r]| (0.114 * f64::from(*b) + 0.587 * f64::from(*g) + 0.299 * f64::from(*r)) * gain);
        let wrong = |i: usize, c: usize| (i * 7 + c * 5) as u8 % (noise + 1);
        levels.enumerate().flat_map(|(i, v)| [0, 1, 2].map(|c| v as u8 + wrong(i, c))).collect()
    }

    fn balanced(view: &[u8], gains: [f64; 3]) -> Vec<u8> {
        view.iter().enumerate().map(|(i, v)| (f64::from(*v) * gains[i % 3] + 0.5).min(255.0) as u8).collect()
    }

    fn gain_of(left: &[u8], right: &[u8]) -> [f32; 3] {
        let params = CompositeParams { exposure: ExposureMethod::ChannelGain, ..CompositeParams::default() };
        let h = [IDENTITY, tilted()];
        let panorama = compose(&mut Compositor::new(params), &[left, right], &h, GeometryState::Fresh, &Serial);
        panorama.report.gains[1]
    }

    #[test]
    fn a_gray_view_beside_one_in_colour_is_matched_in_light_only() {
        let [left, right] = pair();
        for noise in [0, 3] {
            for (a, b, light) in [
                (left.clone(), gray(&right, 0.8, noise), 1.25),
                (gray(&left, 1.0, noise), balanced(&right, [0.8; 3]), 1.25),
            ] {
                let gains = gain_of(&a, &b);
                assert!(gains.iter().all(|gain| *gain == gains[0]), "a tint: {gains:?}");
                assert!((gains[0] / light - 1.0).abs() < 0.03, "noise {noise}: {gains:?}");
            }
        }
    }

    #[test]
    fn exposure_and_white_balance_are_matched_within_two_percent() {
        let [left, right] = pair();
        for factors in [[0.6; 3], [1.3; 3], [0.75, 1.0, 1.2], [1.2, 0.9, 0.7]] {
            let gains = gain_of(&left, &balanced(&right, factors));
            for (gain, factor) in gains.iter().zip(factors) {
                assert!((f64::from(*gain) * factor - 1.0).abs() < 0.02, "{factors:?}: {gains:?}");
            }
        }
    }

    #[test]
    fn the_gain_of_a_resting_pair_is_constant_and_a_change_is_followed() {
        let [left, right] = pair();
        let mut random = 1u32;
        let mut noisy = |view: &[u8]| -> Vec<u8> {
            let mut next = || {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (random >> 24) as i16 % 13 - 6
            };
            view.iter().map(|v| (i16::from(*v) + next()).clamp(0, 255) as u8).collect()
        };
        let params = CompositeParams { exposure: ExposureMethod::ChannelGain, ..CompositeParams::default() };
        let mut compositor = Compositor::new(params);
        let mut next = |right: &[u8]| {
            let (a, b) = (noisy(&left), noisy(right));
            let h = [IDENTITY, tilted()];
            compose(&mut compositor, &[&a, &b], &h, GeometryState::Fresh, &Serial).report.gains[1]
        };
        let first = next(&right);
        for frame in 0..30 {
            assert_eq!(next(&right), first, "frame {frame}");
        }
        // An exposure that jumps is followed without a jump, and within two percent.
        let darker = balanced(&right, [0.8; 3]);
        let mut gain = first;
        for _ in 0..60 {
            let now = next(&darker);
            assert!((0..3).all(|c| (now[c] / gain[c] - 1.0).abs() < 0.04), "{gain:?} to {now:?}");
            gain = now;
        }
        assert!(gain.iter().all(|gain| (gain * 0.8 - 1.0).abs() < 0.02), "{gain:?}");
        let rests = next(&darker);
        assert!((0..20).all(|_| next(&darker) == rests));
    }
}
