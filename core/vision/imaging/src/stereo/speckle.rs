//! Removes speckles: small connected patches whose disparity differs from their surroundings. Wrong matches form such patches.
//!
//! Smooth paint and dark tissue match in many small pieces of one surface, with holes between them. So a patch goes on beyond a small hole.

use crate::{Rect, ViewMut};

/// Most unknown pixels of a row between two pixels of one patch. On the synthetic pairs for tuning, 6 keep little more.
const MAX_HOLE_PX: usize = 3;

/// Pixels of one row and one patch, and small holes between them. Not the runs of other filters, with which noisy maps took a tenth longer.
#[derive(Clone, Copy, Debug)]
struct Run {
    /// Columns.
    start: u32,
    end: u32,
    /// A run of the same patch, in the end its first one.
    parent: u32,
    /// Pixels of the patch, where this run is its first one.
    pixels: u32,
}

/// Finds and clears speckles. Reuses its memory.
#[derive(Debug, Default)]
pub struct SpeckleFilter {
    runs: Vec<Run>,
    /// First run of each row, and the end.
    rows: Vec<u32>,
}

impl SpeckleFilter {
    /// Sets every patch of at most `area_px` known pixels to NaN. Neighbours (left, right, above, below) belong to one patch
    /// when their disparities differ by at most `step_px`, also with up to 3 unknown pixels between left and right. Returns the number of cleared pixels. `area_px` 0 clears none.
    pub fn remove(&mut self, disparity: &mut ViewMut<'_, f32>, roi: Rect, area_px: usize, step_px: f32) -> usize {
        let roi = roi.clamped(disparity.width, disparity.height);
        if area_px == 0 || roi.is_empty() {
            return 0;
        }
        let columns = roi.x..roi.x + roi.width;
        self.runs.clear();
        self.rows.clear();
        for y in roi.y..roi.y + roi.height {
            let first = self.runs.len();
            self.rows.push(first as u32);
            let view = disparity.as_view();
            let row = &view.row(y)[columns.clone()];
            find_runs(row, step_px, &mut self.runs);
            if y > roi.y {
                let above = self.rows[self.rows.len() - 2] as usize..first;
                join(&mut self.runs, above, (&view.row(y - 1)[columns.clone()], row), step_px);
            }
        }
        self.rows.push(self.runs.len() as u32);
        let mut gone = 0;
        for (line, ends) in self.rows.windows(2).enumerate() {
            let row = &mut disparity.row_mut(roi.y + line)[columns.clone()];
            for index in ends[0] as usize..ends[1] as usize {
                let run = self.runs[index];
                let patch = first_of(&mut self.runs, index);
                if self.runs[patch].pixels as usize <= area_px {
                    let part = &mut row[run.start as usize..run.end as usize];
                    gone += part.iter().filter(|d| !d.is_nan()).count();
                    part.fill(f32::NAN);
                }
            }
        }
        gone
    }
}

/// Appends the runs of a row.
fn find_runs(row: &[f32], step_px: f32, runs: &mut Vec<Run>) {
    let mut start = 0;
    while start < row.len() {
        if row[start].is_nan() {
            start += 1;
            continue;
        }
        let (mut end, mut pixels) = (start + 1, 1);
        while let Some(next) = next_of_run(row, end, step_px) {
            end = next + 1;
            pixels += 1;
        }
        let parent = runs.len() as u32;
        runs.push(Run { start: start as u32, end: end as u32, parent, pixels });
        start = end;
    }
}

/// The next known pixel of a run that ends before `end`.
fn next_of_run(row: &[f32], end: usize, step_px: f32) -> Option<usize> {
    let next = (end..row.len().min(end + 1 + MAX_HOLE_PX)).find(|x| !row[*x].is_nan())?;
    ((row[next] - row[end - 1]).abs() <= step_px).then_some(next)
}

/// Joins the runs of two rows that touch: those `above`, and those behind them.
fn join(runs: &mut [Run], above: std::ops::Range<usize>, (upper, lower): (&[f32], &[f32]), step_px: f32) {
    let (mut a, mut b) = (above.start, above.end);
    while a < above.end && b < runs.len() {
        let (over, under) = (runs[a], runs[b]);
        let shared = over.start.max(under.start) as usize..over.end.min(under.end) as usize;
        let touches = !shared.is_empty()
            && upper[shared.clone()].iter().zip(&lower[shared]).any(|(a, b)| (a - b).abs() <= step_px);
        if touches {
            let (a, b) = (first_of(runs, a), first_of(runs, b));
            let (first, other) = (a.min(b), a.max(b));
            if first != other {
                runs[other].parent = first as u32;
                runs[first].pixels += runs[other].pixels;
            }
        }
        if over.end <= under.end {
            a += 1;
        } else {
            b += 1;
        }
    }
}

/// The first run of the patch that a run belongs to. Shortens the way there.
fn first_of(runs: &mut [Run], mut index: usize) -> usize {
    while runs[index].parent as usize != index {
        let next = runs[runs[index].parent as usize].parent;
        runs[index].parent = next;
        index = next as usize;
    }
    index
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_one_surface_stay() {
        let (width, height) = (40, 6);
        // Columns of known pixels with a hole after each.
        let cleared = |hole: usize, step_px: f32| {
            let known = |x: usize| x.is_multiple_of(hole + 1);
            let mut map: Vec<f32> = (0..width * height)
                .map(|i| if known(i % width) { 30.0 + step_px * (i % width / (hole + 1)) as f32 } else { f32::NAN })
                .collect();
            let all = map.iter().filter(|d| !d.is_nan()).count();
            let view = &mut ViewMut::new(&mut map, width, height, 1);
            let gone = SpeckleFilter::default().remove(view, Rect::whole(width, height), 2 * height, 1.0);
            assert_eq!(gone + map.iter().filter(|d| !d.is_nan()).count(), all, "what goes is counted");
            gone == all
        };
        assert!(!cleared(1, 0.0) && !cleared(MAX_HOLE_PX, 0.5), "one surface");
        assert!(cleared(MAX_HOLE_PX + 1, 0.0), "large holes");
        assert!(cleared(1, 2.0), "disparities unlike each other");
    }

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

    /// The patch of each known pixel by following its neighbours, as the definition has it.
    fn cleared_by_definition(map: &[f32], (width, height): (usize, usize), area: usize, step: f32) -> Vec<bool> {
        let mut label = vec![usize::MAX; map.len()];
        let mut sizes = Vec::new();
        for start in 0..map.len() {
            if label[start] != usize::MAX || map[start].is_nan() {
                continue;
            }
            label[start] = sizes.len();
            let mut patch = vec![start];
            let mut done = 0;
            while let Some(&at) = patch.get(done) {
                done += 1;
                let (x, y) = (at % width, at / width);
                let is_known = |other: &usize| !map[*other].is_nan();
                let sides = [
                    (x.saturating_sub(1 + MAX_HOLE_PX)..x).rev().map(|x| y * width + x).find(is_known),
                    (x + 1..width.min(x + 2 + MAX_HOLE_PX)).map(|x| y * width + x).find(is_known),
                    (y > 0).then(|| at - width),
                    (y + 1 < height).then_some(at + width),
                ];
                for other in sides.into_iter().flatten() {
                    if label[other] == usize::MAX && (map[other] - map[at]).abs() <= step {
                        label[other] = sizes.len();
                        patch.push(other);
                    }
                }
            }
            sizes.push(patch.len());
        }
        label.iter().map(|label| *label != usize::MAX && sizes[*label] <= area).collect()
    }

    #[test]
    fn patches_are_those_of_the_definition() {
        let (width, height) = (57, 41);
        let mut random = panoscope_base::random::SplitMix64(11);
        for round in 0..200 {
            let levels = 1 + round % 5;
            let map: Vec<f32> = (0..width * height)
                .map(|_| if random.below(4) == 0 { f32::NAN } else { 1.5 * random.below(1 + levels) as f32 })
                .collect();
            let mut found = map.clone();
            let gone = SpeckleFilter::default().remove(
                &mut ViewMut::new(&mut found, width, height, 1),
                Rect::whole(width, height),
                6,
                1.0,
            );
            let wanted = cleared_by_definition(&map, (width, height), 6, 1.0);
            assert_eq!(gone, wanted.iter().filter(|cleared| **cleared).count());
            for (index, cleared) in wanted.iter().enumerate() {
                assert_eq!(found[index].is_nan(), *cleared || map[index].is_nan(), "round {round}, pixel {index}");
            }
        }
    }
}
