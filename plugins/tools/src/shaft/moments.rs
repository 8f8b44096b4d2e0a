//! Centre, direction and extent of a mask.

use super::{END_PX, END_SHARE, End, Mask, TipPixel};

/// Centre and main direction of a mask.
pub(crate) struct Moments {
    pub(crate) centre: [f64; 2],
    /// Unit vector along the largest variance.
    pub(super) main: [f64; 2],
    /// Sum of both variances, and their difference.
    sum: f64,
    spread: f64,
}

impl Moments {
    /// `None` for an empty mask.
    pub(crate) fn of(mask: &Mask<'_>) -> Option<Self> {
        let (mut n, mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        mask.each(&mut |x, y| {
            n += 1.0;
            sx += x;
            sy += y;
            sxx += x * x;
            sxy += x * y;
            syy += y * y;
        });
        if n == 0.0 {
            return None;
        }
        let (cx, cy) = (sx / n, sy / n);
        let (a, b, c) = (sxx / n - cx * cx, sxy / n - cx * cy, syy / n - cy * cy);
        let angle = 0.5 * (2.0 * b).atan2(a - c);
        let spread = ((a - c).powi(2) + 4.0 * b * b).sqrt();
        Some(Self { centre: [cx, cy], main: [angle.cos(), angle.sin()], sum: a + c, spread })
    }

    /// Whether the larger variance is at least `ratio` times the smaller one.
    pub(super) fn is_longer(&self, ratio: f64) -> bool {
        self.sum + self.spread >= ratio * (self.sum - self.spread).max(0.0)
    }

    /// Width of a bar with the mask's smaller variance, px.
    pub(crate) fn width(&self) -> f64 {
        (6.0 * (self.sum - self.spread).max(0.0)).sqrt()
    }

    /// Smallest and largest position of the mask along an axis through the centre, px.
    pub(super) fn reach(&self, mask: &Mask<'_>, axis: [f64; 2]) -> (f64, f64) {
        let [cx, cy] = self.centre;
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        mask.each(&mut |x, y| {
            let t = (x - cx) * axis[0] + (y - cy) * axis[1];
            (low, high) = (low.min(t), high.max(t));
        });
        (low, high)
    }

    /// The tip in the middle of the mask's last part before `end`; the mask begins at `low` on the axis.
    pub(super) fn middle_of_end(
        &self,
        mask: &Mask<'_>,
        axis: [f64; 2],
        (low, end): (f64, f64),
        pitch: f64,
    ) -> Option<TipPixel> {
        let [cx, cy] = self.centre;
        let part = (END_SHARE * (end - low)).max(END_PX);
        let (mut ends, mut reach, mut beside, mut offset) = (0.0, 0.0, 0.0, 0.0);
        mask.each(&mut |x, y| {
            let t = (x - cx) * axis[0] + (y - cy) * axis[1];
            let before_end = end - t;
            if (-pitch..=END_PX.max(pitch)).contains(&before_end) {
                ends += 1.0;
                reach += t;
            }
            if (-pitch..=part).contains(&before_end) {
                beside += 1.0;
                offset += (y - cy) * axis[0] - (x - cx) * axis[1];
            }
        });
        if ends == 0.0 || beside == 0.0 {
            return None;
        }
        let (reach, offset) = (reach / ends, offset / beside);
        let (u_px, v_px) = (cx + reach * axis[0] - offset * axis[1], cy + reach * axis[1] + offset * axis[0]);
        Some(TipPixel { tip: End { u_px, v_px, direction: axis }, jaws: None })
    }
}
