//! A point of the measured surface, with its uncertainty.
//!
//! The inverse depth of a plane is linear in the pixel's column and row, so a plane is fitted to the inverse depths
//! around the point, without pixels of another surface. The residual of the fit is the scatter of the match.
//!
//! A filter that smooths makes the errors of neighbours alike: inside a small window nothing is seen of them. So the surface further around is
//! looked at too, where it is matched as surely as the point: what it deviates from a plane is the scatter, without what single pixels deviate alone, which
//! the plane averages out. Relief of the tissue counts, too: the error is stated too large rather than too small there.

use crate::Rect;

/// A surface point: `(ray[0], ray[1], 1) / inverse_depth` in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// x / z and y / z.
    pub ray: [f64; 2],
    /// 1 / z in 1/mm.
    pub inverse_depth: f64,
    /// Standard deviation of the inverse depths that pixels around share, in 1/mm.
    pub scatter: f64,
    /// How far its match is to be trusted, 0 to 1: the confidence that a filter gives; `None` where it is not known.
    pub confidence: Option<f64>,
}

impl SurfacePoint {
    /// x, y, z in mm, with the inverse depth changed by `change`.
    pub fn xyz_mm(&self, change: f64) -> [f64; 3] {
        let z = 1.0 / (self.inverse_depth + change);
        [self.ray[0] * z, self.ray[1] * z, z]
    }

    /// The pixels of a picture of `size` that [`Self::at`] reads for a point: all in an area, and rows and columns further around; `None` where it reads
    /// none.
    pub fn pixels(
        (width, height): (usize, usize),
        [u, v]: [f64; 2],
        radius_px: usize,
    ) -> Option<(Rect, [Vec<usize>; 2])> {
        let (x, y) = pixel_of((width, height), [u, v])?;
        let around = |at: usize, size: usize| spaced(at, radius_px, size).map(|(_, place)| place).collect();
        Some((Rect::new(x, y, 1, 1).grown(radius_px, width, height), [around(x, width), around(y, height)]))
    }

    /// The surface at column `u`, row `v` of a picture of `size` (columns, rows), from the pixels up to `radius_px` away; `None` where too
    /// few are known. `sample` gives x / z, y / z and 1 / z of a pixel, where known, `trust` its confidence, not finite where unknown. `work` is reused.
    pub fn at(
        size: (usize, usize),
        [u, v]: [f64; 2],
        radius_px: usize,
        work: &mut Vec<Sample>,
        sample: impl Fn(usize, usize) -> Option<[f64; 3]>,
        trust: impl Fn(usize, usize) -> f32,
    ) -> Option<Self> {
        let (width, height) = size;
        let (x, y) = pixel_of(size, [u, v])?;
        work.clear();
        for y in y.saturating_sub(radius_px)..=(y + radius_px).min(height - 1) {
            for x in x.saturating_sub(radius_px)..=(x + radius_px).min(width - 1) {
                let place = |[a, b, inverse]: [f64; 3]| [x as f64 - u, y as f64 - v, a, b, inverse];
                work.extend(sample(x, y).map(place));
            }
        }
        let side = 2 * radius_px + 1;
        let least = ((side * side) as f64 * MIN_SHARE).ceil().max(3.0) as usize;
        if work.len() < least.min(side * side) {
            return None;
        }
        // The surface that most of the window shows, then its plane, then its plane without what lies off it.
        let middle = work.len() / 2;
        let median = work.select_nth_unstable_by(middle, |a, b| a[4].total_cmp(&b[4])).1[4];
        work.sort_unstable_by(|a, b| (a[4] - median).abs().total_cmp(&(b[4] - median).abs()));
        let spread = (work[work.len() / 2][4] - median).abs();
        let reach = 5.0 * spread + median * 2e-3;
        work.retain(|sample| (sample[4] - median).abs() <= reach);
        for _ in 0..2 {
            let plane = fit(work, 4)?;
            let scatter = deviation(work, &plane);
            work.retain(|sample| (sample[4] - value(&plane, sample)).abs() <= 3.0 * scatter + median * 1e-6);
        }
        if work.len() < least {
            return None;
        }
        let plane = fit(work, 4)?;
        let ray = [fit(work, 2)?[0], fit(work, 3)?[0]];
        let alone = deviation(work, &plane);
        let confidence = Some(trust(x, y)).filter(|own| own.is_finite()).map(|own| own.clamp(0.0, 1.0));
        let is_sure = |x, y| confidence.is_none_or(|own| trust(x, y) >= AS_SURE * own);
        for all in [false, true] {
            work.clear();
            for (row, y) in spaced(y, radius_px, height) {
                for (column, x) in spaced(x, radius_px, width).filter(|(_, x)| all || is_sure(*x, y)) {
                    let place = |[a, b, inverse]: [f64; 3]| [column, row, a, b, inverse];
                    work.extend(sample(x, y).map(place).filter(|s| (s[4] - median).abs() <= SAME_SURFACE * median));
                }
            }
            if work.len() >= MIN_AROUND {
                break;
            }
        }
        let around = if work.len() < MIN_AROUND { 0.0 } else { spread_around(work)? };
        let scatter = ((around * around - alone * alone).max(0.0) + LEFT_ALONE * alone * alone).sqrt();
        let place = Self { ray, inverse_depth: plane[0], scatter, confidence: confidence.map(f64::from) };
        (place.inverse_depth > 0.0).then_some(place)
    }
}

/// One neighbour: offset in px, ray, inverse depth.
pub type Sample = [f64; 5];

/// Share of the window that must be known.
const MIN_SHARE: f64 = 0.25;

/// The surface further around is sampled in steps of the radius, so many each way.
const AROUND_STEPS: usize = 5;
/// Pixels further off the point's inverse depth than this, relative, are of another surface.
const SAME_SURFACE: f64 = 0.15;
/// Share of the point's confidence from which on a pixel further around is as sure.
const AS_SURE: f32 = 0.9;
/// Share of the variance of single pixels that the fitted plane keeps: their errors are not all independent.
const LEFT_ALONE: f64 = 0.3;
/// Fewer samples further around say nothing.
const MIN_AROUND: usize = 9;

/// The pixel of a point; `None` outside.
fn pixel_of((width, height): (usize, usize), [u, v]: [f64; 2]) -> Option<(usize, usize)> {
    // NaN fails.
    let is_inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
    is_inside.then(|| ((u.round() as usize).min(width - 1), (v.round() as usize).min(height - 1)))
}

/// Positions around `at` in steps of `step`, with their distances in px, inside `0..size`.
fn spaced(at: usize, step: usize, size: usize) -> impl Iterator<Item = (f64, usize)> {
    (0..=2 * AROUND_STEPS).filter_map(move |index| {
        let place = (at + index * step).checked_sub(AROUND_STEPS * step)?;
        (place < size).then_some((place as f64 - at as f64, place))
    })
}

/// Standard deviation of the samples from their plane, by its median.
fn spread_around(samples: &mut [Sample]) -> Option<f64> {
    let plane = fit(samples, 4)?;
    samples.iter_mut().for_each(|sample| sample[4] = (sample[4] - value(&plane, sample)).abs());
    let middle = samples.len() / 2;
    Some(NORMAL * samples.select_nth_unstable_by(middle, |a, b| a[4].total_cmp(&b[4])).1[4])
}

/// Standard deviation of a normal distribution for each unit of its median deviation.
const NORMAL: f64 = 1.4826;

fn value(plane: &[f64; 3], sample: &Sample) -> f64 {
    plane[0] + plane[1] * sample[0] + plane[2] * sample[1]
}

/// Standard deviation of the samples from the plane.
fn deviation(samples: &[Sample], plane: &[f64; 3]) -> f64 {
    let sum: f64 = samples.iter().map(|sample| (sample[4] - value(plane, sample)).powi(2)).sum();
    (sum / samples.len().saturating_sub(3).max(1) as f64).sqrt()
}

/// Least squares: `sample[of] = c0 + c1 * dx + c2 * dy`. A constant where the samples lie on a line.
fn fit(samples: &[Sample], of: usize) -> Option<[f64; 3]> {
    if samples.is_empty() {
        return None;
    }
    let n = samples.len() as f64;
    let mean = |index: usize| samples.iter().map(|sample| sample[index]).sum::<f64>() / n;
    let (mx, my, mz) = (mean(0), mean(1), mean(of));
    let [mut xx, mut xy, mut yy, mut xz, mut yz] = [0.0; 5];
    for sample in samples {
        let (x, y, z) = (sample[0] - mx, sample[1] - my, sample[of] - mz);
        xx += x * x;
        xy += x * y;
        yy += y * y;
        xz += x * z;
        yz += y * z;
    }
    let determinant = xx * yy - xy * xy;
    if determinant <= 1e-9 * (xx * yy).max(1e-9) {
        return Some([mz, 0.0, 0.0]);
    }
    let (b, c) = ((xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant);
    Some([mz - b * mx - c * my, b, c])
}

#[cfg(test)]
mod tests {
    use panoscope_base::random::SplitMix64;

    use super::*;

    const SIZE: (usize, usize) = (200, 160);
    /// Inverse depth of the plane, 1/mm.
    const MIDDLE: f64 = 0.02;

    /// The point in the middle of a slanted plane with `off` beside it, radius 4 px.
    fn middle_of(off: impl Fn(f64, f64) -> f64) -> SurfacePoint {
        trusted_middle(off, |_, _| f32::NAN)
    }

    fn trusted_middle(off: impl Fn(f64, f64) -> f64, trust: impl Fn(usize, usize) -> f32) -> SurfacePoint {
        let sample = |x: usize, y: usize| {
            let (x, y) = (x as f64, y as f64);
            Some([x / 700.0, y / 700.0, MIDDLE + 1e-5 * x + off(x, y)])
        };
        SurfacePoint::at(SIZE, [100.0, 80.0], 4, &mut Vec::new(), sample, trust).expect("a point")
    }

    #[test]
    fn an_exact_plane_has_no_scatter() {
        let point = middle_of(|_, _| 0.0);
        assert!(point.scatter < 1e-12, "{}", point.scatter);
        assert!((point.inverse_depth - MIDDLE - 1e-3).abs() < 1e-12);
    }

    #[test]
    fn pixels_that_are_not_announced_are_not_read() {
        let read = std::cell::RefCell::new(Vec::new());
        for at in [[100.0, 80.0], [0.0, 159.4], [199.9, 0.0], [3.0, 90.0], [-1.0, 5.0], [200.0, 5.0], [f64::NAN, 0.0]] {
            read.borrow_mut().clear();
            let sample = |x: usize, y: usize| {
                read.borrow_mut().push((x, y));
                Some([x as f64 / 700.0, y as f64 / 700.0, MIDDLE + 1e-5 * x as f64])
            };
            let trust = |x: usize, y: usize| {
                read.borrow_mut().push((x, y));
                0.5
            };
            let point = SurfacePoint::at(SIZE, at, 4, &mut Vec::new(), sample, trust);
            let announced = SurfacePoint::pixels(SIZE, at, 4);
            assert_eq!(point.is_some(), announced.is_some(), "{at:?}");
            let Some((area, [columns, rows])) = announced else { continue };
            let is_announced = |(x, y): &(usize, usize)| {
                let is_near = (area.x..area.x + area.width).contains(x) && (area.y..area.y + area.height).contains(y);
                is_near || columns.contains(x) && rows.contains(y)
            };
            assert!(read.borrow().iter().all(is_announced), "{at:?}");
            assert!(area.area() <= 81 && columns.len().max(rows.len()) <= 11);
        }
    }

    #[test]
    fn errors_that_neighbours_share_count() {
        // Waves of 40 px are almost a plane within 4 px of a zero.
        let height = 1e-4;
        let waves = |x: f64, y: f64| height * ((x / 40.0).sin() + (y / 6.4).sin());
        let point = middle_of(waves);
        assert!((0.5 * height..2.5 * height).contains(&point.scatter), "{}", point.scatter);
    }

    #[test]
    fn another_surface_around_does_not_count() {
        let point = middle_of(|x, _| if x > 110.0 { 0.5 * MIDDLE } else { 0.0 });
        assert!(point.scatter < 1e-12, "{}", point.scatter);
    }

    #[test]
    fn what_is_matched_less_surely_around_does_not_count() {
        // Waves beside the point, as in the blank squares of a printed board.
        let waves = |x: f64, y: f64| if (x - 100.0).hypot(y - 80.0) > 6.0 { 1e-3 * (x / 3.0).sin() } else { 0.0 };
        let stripes = |sure: f32, rest: f32| move |x: usize, _: usize| if x % 8 == 4 { sure } else { rest };
        let is_doubted = trusted_middle(|x, y| if x as usize % 8 == 4 { 0.0 } else { waves(x, y) }, stripes(0.9, 0.5));
        assert!(is_doubted.scatter < 1e-9 && is_doubted.confidence == Some(f64::from(0.9_f32)), "{is_doubted:?}");
        let is_sure = trusted_middle(waves, |_, _| 0.9);
        assert!(is_sure.scatter > 1e-4, "{is_sure:?}");
    }

    #[test]
    fn errors_of_single_pixels_are_averaged_out() {
        let height = 1e-4;
        let mut random = SplitMix64(3);
        // The sum of twelve even numbers is nearly normal.
        let mut normal = || (0..12).map(|_| random.below(1000) as f64 / 1000.0 - 0.4995).sum::<f64>();
        let noise: Vec<f64> = (0..SIZE.0 * SIZE.1).map(|_| height * normal()).collect();
        let point = middle_of(|x, y| noise[y as usize * SIZE.0 + x as usize]);
        assert!((0.4 * height..0.8 * height).contains(&point.scatter), "{}", point.scatter);
    }
}
