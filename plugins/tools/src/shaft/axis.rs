//! The axis of a shaft: a line through the centres of its cross sections.

use super::{LastMask, TipFinder};

/// Minimum number of lines across the shaft, and its minimum length as a share of the jaws' length.
const MIN_LINES: usize = 4;
const MIN_SHARE: f64 = 0.1;
/// Minimum width of a part of a mask that counts as shaft, px.
const THIN_PX: f64 = 3.0;
/// Share of the jaws' length that is left out beyond their joint.
const JOINT_SHARE: f64 = 0.03;
/// Distances from the shaft at which pixels are checked for another instrument, px.
const BESIDE_PX: [f64; 2] = [1.0, 2.5];
/// Centres farther from the line than this multiple of their median distance, and than this, px, are left out.
const OUTLIER: f64 = 3.0;
const OUTLIER_PX: f64 = 0.7;

/// A line in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShaftAxis {
    /// Column and row of a point of it, px.
    pub from_px: [f64; 2],
    /// Unit vector towards the tip.
    pub along: [f64; 2],
    /// Length of the shaft from which it was fitted; the direction of a short one is inaccurate.
    pub length_px: f64,
}

impl ShaftAxis {
    fn distance_px(&self, [x, y]: [f64; 2]) -> f64 {
        ((y - self.from_px[1]) * self.along[0] - (x - self.from_px[0]) * self.along[1]).abs()
    }

    /// Fits a line to points with weights of 0 or 1, oriented like `towards`.
    fn fit(points: &[([f64; 2], bool)], towards: [f64; 2]) -> Option<Self> {
        let used = || points.iter().filter(|(_, is_used)| *is_used).map(|(point, _)| *point);
        let n = used().count() as f64;
        let (sx, sy) = used().fold((0.0, 0.0), |(x, y), p| (x + p[0], y + p[1]));
        let from_px = [sx / n, sy / n];
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for [x, y] in used().map(|[x, y]| [x - from_px[0], y - from_px[1]]) {
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let (x, y) = (angle.cos(), angle.sin());
        let sign = if x * towards[0] + y * towards[1] < 0.0 { -1.0 } else { 1.0 };
        from_px.iter().all(|v| v.is_finite()).then_some(Self { from_px, along: [sign * x, sign * y], length_px: 0.0 })
    }
}

impl TipFinder {
    /// Length of the jaws that [`TipFinder::of_mask`] found last, from where they part to the farther end, px. `None` if it found no jaws.
    pub fn jaws_px(&self) -> Option<f64> {
        let LastMask { lines, end_line, fork_line } = self.last?;
        fork_line.map(|fork_line| f64::from(end_line.saturating_sub(fork_line)) * lines.pitch)
    }

    /// Axis of the shaft of the mask that [`TipFinder::of_mask`] was given last, in an image of `size`. `jaws_px` is the length of the jaws: what is
    /// nearer to the end is not shaft. Parts whose sides are the image border or another instrument are left out. `None` if too little of the shaft
    /// is in view.
    pub fn axis(
        &mut self,
        size: (usize, usize),
        jaws_px: f64,
        is_other: &dyn Fn(usize, usize) -> bool,
    ) -> Option<ShaftAxis> {
        let LastMask { lines, end_line, fork_line } = self.last?;
        let Self { runs, starts, middles: points, off_px: off, .. } = self;
        let jaws_lines = (jaws_px * (1.0 + JOINT_SHARE) / lines.pitch).ceil();
        let joint = (f64::from(end_line) - jaws_lines).max(0.0) as u32;
        let joint = fork_line.map_or(joint, |fork_line| joint.min(fork_line)) as usize;
        let is_free = |line: usize, step: f64| {
            let [x, y] = lines.place(line as f64, step);
            let (x, y) = (x.round(), y.round());
            let inside = x >= 0.0 && y >= 0.0 && x < size.0 as f64 && y < size.1 as f64;
            inside && !is_other(x as usize, y as usize)
        };
        points.clear();
        for line in 0..joint.min(starts.len().saturating_sub(1)) {
            let [run] = runs[starts[line] as usize..starts[line + 1] as usize] else { continue };
            let (from, to) = (f64::from(run.from), f64::from(run.to));
            let is_wide = (to - from + 1.0) * lines.pitch >= THIN_PX;
            let beside = |px: f64| is_free(line, from - px / lines.pitch) && is_free(line, to + px / lines.pitch);
            if is_wide && BESIDE_PX.into_iter().all(beside) {
                points.push((lines.place(line as f64, (from + to) / 2.0), true));
            }
        }
        let mut axis = None;
        for _ in 0..3 {
            if points.iter().filter(|(_, is_used)| *is_used).count() < MIN_LINES {
                return None;
            }
            let fitted = ShaftAxis::fit(points, lines.axis)?;
            off.clear();
            off.extend(points.iter().map(|(point, _)| fitted.distance_px(*point)));
            off.sort_unstable_by(f64::total_cmp);
            let most = (OUTLIER * off[off.len() / 2]).max(OUTLIER_PX);
            points.iter_mut().for_each(|(point, is_used)| *is_used = fitted.distance_px(*point) <= most);
            axis = Some(fitted);
        }
        let axis = axis?;
        let along =
            points.iter().filter(|(_, is_used)| *is_used).map(|([x, y], _)| x * axis.along[0] + y * axis.along[1]);
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
        let length_px = high - low;
        (length_px >= MIN_SHARE * jaws_px).then_some(ShaftAxis { length_px, ..axis })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{bits_of, on_bar};
    use super::super::{Mask, TipFinder};

    const SIZE: (usize, usize) = (320, 240);
    const JOINT: [f64; 2] = [200.0, 120.0];

    /// A shaft from the right border to a joint, and two jaws, with the pixels of `is_covered` hidden by a bar.
    fn jaws(is_covered: impl Fn(f64, f64) -> bool) -> Vec<u8> {
        bits_of(SIZE.0, SIZE.1, |x, y| {
            let shaft = on_bar([x, y], [330.0, 150.0], JOINT, 28.0);
            let jaw = |end| on_bar([x, y], JOINT, end, 12.0);
            (shaft || jaw([110.0, 60.0]) || jaw([100.0, 145.0])) && !is_covered(x, y)
        })
    }

    /// Distance of a point from the true axis, px, and sine of the angle to it.
    fn off(axis: &super::ShaftAxis) -> (f64, f64) {
        let (x, y) = (130.0_f64 / 130.0_f64.hypot(30.0), 30.0_f64 / 130.0_f64.hypot(30.0));
        let at = [axis.from_px[0] - JOINT[0], axis.from_px[1] - JOINT[1]];
        ((at[1] * x - at[0] * y).abs(), (axis.along[1] * x - axis.along[0] * y).abs())
    }

    #[test]
    fn the_axis_is_the_shafts_whatever_the_jaws_do() {
        let mut finder = TipFinder::default();
        let all = jaws(|_, _| false);
        let tip = finder.of_mask(Mask::new(&all, SIZE.0, SIZE.1)).expect("the mask is not empty");
        let length = finder.jaws_px().expect("two jaws");
        assert!(tip.jaws.is_some() && (70.0..110.0).contains(&length), "{length}");
        let axis = finder.axis(SIZE, length, &|_, _| false).expect("130 px of shaft");
        let (aside, turn) = off(&axis);
        assert!(aside < 0.7 && turn < 0.015 && axis.along[0] < -0.9, "{axis:?}");
        // One jaw and a part of the shaft's lower side are covered.
        let covers = |x: f64, y: f64| (x < 190.0 && y > 118.0) || (250.0..270.0).contains(&x) && y > 130.0;
        let one = jaws(covers);
        let tip = finder.of_mask(Mask::new(&one, SIZE.0, SIZE.1)).expect("the mask is not empty");
        assert!(tip.jaws.is_none() && finder.jaws_px().is_none());
        let axis = finder.axis(SIZE, length, &|x, y| covers(x as f64, y as f64)).expect("enough of the shaft");
        let (aside, turn) = off(&axis);
        assert!(aside < 1.0 && turn < 0.02, "{axis:?}");
    }

    #[test]
    fn a_shaft_that_is_hidden_or_too_short_has_no_axis() {
        let mut finder = TipFinder::default();
        assert_eq!(finder.axis(SIZE, 90.0, &|_, _| false), None, "no mask was given");
        let covers = |x: f64, _: f64| x > 196.0;
        let short = jaws(covers);
        finder.of_mask(Mask::new(&short, SIZE.0, SIZE.1)).expect("the mask is not empty");
        assert_eq!(finder.axis(SIZE, 95.0, &|x, y| covers(x as f64, y as f64)), None);
        finder.of_mask(Mask::new(&[0; 16], 16, 8));
        assert_eq!(finder.axis(SIZE, 10.0, &|_, _| false), None);
    }
}
