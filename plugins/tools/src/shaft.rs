//! Where an instrument ends: from its mask along the shaft's axis, or from its box alone.

/// A tip in px of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipPixel {
    /// Horizontal.
    pub u_px: f64,
    /// Vertical.
    pub v_px: f64,
    /// Unit vector from the entry towards the tip.
    pub direction: [f64; 2],
}

/// How far along the axis the end is averaged, in px: the outermost pixel alone is noise.
const END_PX: f64 = 2.0;
/// Last part of the length over which the middle between both sides is taken: the tip of open jaws lies between them.
const END_SHARE: f64 = 0.08;
/// From this ratio of variances on a mask has a direction of its own, if that agrees with where it enters; a wide one points away from its entry.
const LONG: f64 = 6.0;
/// From this one on it has one whatever it touches: a shaft that runs along the border.
const VERY_LONG: f64 = 20.0;

/// The tip of a mask given as bits (most significant first, rows padded to whole bytes).
///
/// The instrument enters where the mask touches the picture's border; where it does not, on the side nearer to it. The shaft's axis is the
/// mask's main direction, or for a wide mask (a bag, open jaws) the line from the entry through the mask's middle. The tip is where the mask ends
/// on the other side, in the middle of its end. `None` for an empty mask.
pub fn tip_of_mask(bits: &[u8], width: usize, height: usize) -> Option<TipPixel> {
    let row_bytes = width.div_ceil(8);
    let each = |visit: &mut dyn FnMut(f64, f64)| {
        for (y, row) in bits.chunks_exact(row_bytes.max(1)).take(height).enumerate() {
            for (b, &byte) in row.iter().enumerate().filter(|(_, byte)| **byte != 0) {
                for k in (0..8).filter(|k| byte & (0x80 >> k) != 0) {
                    visit((b * 8 + k) as f64, y as f64);
                }
            }
        }
    };
    let (mut n, mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let (mut touching, mut entry_x, mut entry_y) = (0.0, 0.0, 0.0);
    each(&mut |x, y| {
        n += 1.0;
        sx += x;
        sy += y;
        sxx += x * x;
        sxy += x * y;
        syy += y * y;
        if x < 1.0 || y < 1.0 || x >= width as f64 - 1.0 || y >= height as f64 - 1.0 {
            touching += 1.0;
            entry_x += x;
            entry_y += y;
        }
    });
    if n == 0.0 {
        return None;
    }
    let (cx, cy) = (sx / n, sy / n);
    let (a, b, c) = (sxx / n - cx * cx, sxy / n - cx * cy, syy / n - cy * cy);
    let angle = 0.5 * (2.0 * b).atan2(a - c);
    let spread = ((a - c).powi(2) + 4.0 * b * b).sqrt();
    let is_longer = |ratio: f64| a + c + spread >= ratio * (a + c - spread).max(0.0);
    let main = [angle.cos(), angle.sin()];
    let from_entry = (touching > 0.0).then(|| [cx - entry_x / touching, cy - entry_y / touching]);
    let from_entry = from_entry.filter(|v| v[0].hypot(v[1]) > 1.0);
    let axis = match from_entry {
        Some([x, y]) => {
            let away = [x / x.hypot(y), y / x.hypot(y)];
            let agrees = (away[0] * main[0] + away[1] * main[1]).abs() > 0.7;
            if is_longer(VERY_LONG) || (is_longer(LONG) && agrees) { main } else { away }
        }
        None => main,
    };
    let along = |x: f64, y: f64| (x - cx) * axis[0] + (y - cy) * axis[1];
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    each(&mut |x, y| {
        let t = along(x, y);
        (low, high) = (low.min(t), high.max(t));
    });
    let from_border = |t: f64| {
        let (x, y) = (cx + t * axis[0], cy + t * axis[1]);
        x.min(y).min(width as f64 - 1.0 - x).min(height as f64 - 1.0 - y)
    };
    let enters_low = match from_entry {
        Some(v) => v[0] * axis[0] + v[1] * axis[1] >= 0.0,
        None => from_border(low) <= from_border(high),
    };
    let (end, sign) = if enters_low { (high, 1.0) } else { (low, -1.0) };
    let part = (END_SHARE * (high - low)).max(END_PX);
    let (mut ends, mut reach, mut beside, mut offset) = (0.0, 0.0, 0.0, 0.0);
    each(&mut |x, y| {
        let t = along(x, y);
        let before_end = (t - end) * -sign;
        if before_end <= END_PX {
            ends += 1.0;
            reach += t;
        }
        if before_end <= part {
            beside += 1.0;
            offset += (y - cy) * axis[0] - (x - cx) * axis[1];
        }
    });
    // The pixel at the very end counts for both.
    let (reach, offset) = (reach / ends, offset / beside);
    Some(TipPixel {
        u_px: cx + reach * axis[0] - offset * axis[1],
        v_px: cy + reach * axis[1] + offset * axis[0],
        direction: [axis[0] * sign, axis[1] * sign],
    })
}

/// The tip of a box (left, top, right, bottom). Detectors box the working end; its shaft comes from the border that the box is nearest to, and
/// the tip is where the line from there through the box's centre leaves the box. Rough: half the box's width is its error.
pub fn tip_of_box(corners: [f32; 4], width: usize, height: usize) -> TipPixel {
    let [x0, y0, x1, y1] = corners.map(f64::from);
    let (cx, cy) = ((x0 + x1) / 2.0, (y0 + y1) / 2.0);
    let gaps =
        [(x0, [-1.0, 0.0]), (width as f64 - x1, [1.0, 0.0]), (y0, [0.0, -1.0]), (height as f64 - y1, [0.0, 1.0])];
    let touching = gaps.iter().filter(|(gap, _)| *gap <= 2.0).fold([0.0, 0.0], |s, (_, d)| [s[0] + d[0], s[1] + d[1]]);
    let mut towards = touching;
    if towards == [0.0, 0.0] {
        // Towards the nearer vertical and the nearer horizontal border, the nearer one weighing more.
        let weigh = |near: f64, far: f64| if near < far { -1.0 / (near + 1.0) } else { 1.0 / (far + 1.0) };
        towards = [weigh(gaps[0].0, gaps[1].0), weigh(gaps[2].0, gaps[3].0)];
    }
    let norm = towards[0].hypot(towards[1]).max(1e-12);
    let direction = [-towards[0] / norm, -towards[1] / norm];
    let reach = |d: f64, half: f64| if d.abs() > 1e-9 { half / d.abs() } else { f64::INFINITY };
    let t = reach(direction[0], (x1 - x0) / 2.0).min(reach(direction[1], (y1 - y0) / 2.0));
    let t = if t.is_finite() { t } else { 0.0 };
    TipPixel { u_px: cx + t * direction[0], v_px: cy + t * direction[1], direction }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(width: usize, height: usize, inside: impl Fn(f64, f64) -> bool) -> Vec<u8> {
        let row = width.div_ceil(8);
        let mut bits = vec![0; row * height];
        for y in 0..height {
            for x in (0..width).filter(|&x| inside(x as f64, y as f64)) {
                bits[y * row + x / 8] |= 0x80 >> (x % 8);
            }
        }
        bits
    }

    #[test]
    fn a_shaft_from_the_right_ends_on_the_left() {
        // A bar of 8 px from the right border at (100, 40) to a tip at (30, 60).
        let (tip, tail) = ([30.0f64, 60.0], [110.0f64, 37.0]);
        let length = (tail[0] - tip[0]).hypot(tail[1] - tip[1]);
        let axis = [(tail[0] - tip[0]) / length, (tail[1] - tip[1]) / length];
        let bits = mask(101, 80, |x, y| {
            let (dx, dy) = (x - tip[0], y - tip[1]);
            let (t, s) = (dx * axis[0] + dy * axis[1], dy * axis[0] - dx * axis[1]);
            t >= 0.0 && s.abs() <= 4.0
        });
        let found = tip_of_mask(&bits, 101, 80).expect("the mask is not empty");
        assert!((found.u_px - 31.0).abs() < 1.5 && (found.v_px - 60.0).abs() < 1.5, "{found:?}");
        assert!(found.direction[0] < -0.9);
    }

    #[test]
    fn a_wide_bag_ends_opposite_to_its_entry() {
        // Half an ellipse at the right border, taller than wide.
        let bits = mask(100, 120, |x, y| ((x - 100.0) / 30.0).powi(2) + ((y - 60.0) / 45.0).powi(2) <= 1.0);
        let found = tip_of_mask(&bits, 100, 120).expect("the mask is not empty");
        assert!((found.u_px - 71.0).abs() < 2.0 && (found.v_px - 60.0).abs() < 1.0, "{found:?}");
    }

    #[test]
    fn the_tip_of_open_jaws_lies_between_them() {
        // Two jaws from the joint at (60, 50), 15 px to either side at x = 10, on a shaft from the right border.
        let bits = mask(101, 100, |x, y| {
            let jaw = (x - 60.0).abs() <= 50.0 && x <= 60.0 && ((y - 50.0).abs() - 0.3 * (60.0 - x)).abs() <= 3.0;
            jaw || (x > 60.0 && (y - 50.0).abs() <= 5.0)
        });
        let found = tip_of_mask(&bits, 101, 100).expect("the mask is not empty");
        assert!((found.u_px - 11.0).abs() < 2.0 && (found.v_px - 50.0).abs() < 1.5, "{found:?}");
    }

    #[test]
    fn an_empty_mask_has_no_tip() {
        assert_eq!(tip_of_mask(&[0; 20], 16, 10), None);
        assert_eq!(tip_of_mask(&[], 0, 0), None);
    }

    #[test]
    fn a_box_at_the_right_border_ends_on_its_left_side() {
        let tip = tip_of_box([80.0, 30.0, 100.0, 40.0], 100, 80);
        assert!((tip.u_px - 80.0).abs() < 1e-6 && (tip.v_px - 35.0).abs() < 1e-6, "{tip:?}");
    }
}
