//! Removes speckles: small connected patches whose disparity differs from their surroundings. Wrong matches form such patches.

use crate::{Rect, ViewMut};

/// Finds and clears speckles. Reuses its memory.
#[derive(Debug, Default)]
pub struct SpeckleFilter {
    /// 0 for unvisited pixels, else the patch's number.
    label: Vec<u32>,
    /// Pixels of the patch that is being followed.
    patch: Vec<u32>,
}

impl SpeckleFilter {
    /// Sets every patch of at most `area_px` pixels to NaN. Neighbours (left, right, above, below) belong to one patch
    /// when their disparities differ by at most `step_px`. Returns the number of cleared pixels. `area_px` 0 clears none.
    pub fn remove(&mut self, disparity: &mut ViewMut<'_, f32>, roi: Rect, area_px: usize, step_px: f32) -> usize {
        let roi = roi.clamped(disparity.width, disparity.height);
        if area_px == 0 || roi.is_empty() {
            return 0;
        }
        self.label.clear();
        self.label.resize(roi.width * roi.height, 0);
        let stride = disparity.stride;
        let place = |at: usize| (roi.y + at / roi.width) * stride + roi.x + at % roi.width;
        let data = &mut *disparity.data;
        let (mut next, mut gone) = (0, 0);
        for start in 0..roi.width * roi.height {
            if self.label[start] != 0 || data[place(start)].is_nan() {
                continue;
            }
            next += 1;
            self.patch.clear();
            self.patch.push(start as u32);
            self.label[start] = next;
            let mut done = 0;
            while let Some(&at) = self.patch.get(done) {
                done += 1;
                let at = at as usize;
                let (x, y, own) = (at % roi.width, at / roi.width, data[place(at)]);
                let around = [
                    (x > 0).then(|| at - 1),
                    (x + 1 < roi.width).then_some(at + 1),
                    (y > 0).then(|| at - roi.width),
                    (y + 1 < roi.height).then_some(at + roi.width),
                ];
                for other in around.into_iter().flatten() {
                    // NaN fails.
                    if self.label[other] == 0 && (data[place(other)] - own).abs() <= step_px {
                        self.label[other] = next;
                        self.patch.push(other as u32);
                    }
                }
            }
            if self.patch.len() <= area_px {
                gone += self.patch.len();
                self.patch.iter().for_each(|at| data[place(*at as usize)] = f32::NAN);
            }
        }
        gone
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_patches_go_and_slopes_stay() {
        let (width, height) = (24, 12);
        // A slope hangs together though its ends differ by much.
        let mut map: Vec<f32> = (0..width * height).map(|i| 10.0 + 0.5 * (i % width) as f32).collect();
        let slope = map.clone();
        for (x, y) in [(3, 3), (4, 3), (3, 4), (20, 10)] {
            map[y * width + x] = 40.0;
        }
        map[5 * width + 12] = f32::NAN;
        let mut filter = SpeckleFilter::default();
        let mut run = |map: &mut [f32], area| {
            filter.remove(&mut ViewMut::new(map, width, height, 1), Rect::whole(width, height), area, 1.0)
        };
        let mut kept = map.clone();
        assert_eq!(run(&mut kept, 0), 0);
        assert_eq!(run(&mut kept, 1), 1);
        assert!(kept[10 * width + 20].is_nan() && kept[3 * width + 3] == 40.0);
        assert_eq!(run(&mut map, 3), 4);
        for (index, (found, slope)) in map.iter().zip(&slope).enumerate() {
            let (x, y) = (index % width, index / width);
            let was_bad = [(3, 3), (4, 3), (3, 4), (20, 10), (12, 5)].contains(&(x, y));
            assert!(if was_bad { found.is_nan() } else { found == slope }, "{x} {y}");
        }
    }

    #[test]
    fn nothing_outside_the_roi_is_touched() {
        let mut map = vec![5.0f32; 100];
        let roi = Rect { x: 2, y: 2, width: 3, height: 2 };
        let mut view = ViewMut::new(&mut map, 10, 10, 1);
        assert_eq!(SpeckleFilter::default().remove(&mut view, roi, 6, 1.0), 6);
        assert_eq!(map.iter().filter(|v| v.is_nan()).count(), 6);
    }
}
