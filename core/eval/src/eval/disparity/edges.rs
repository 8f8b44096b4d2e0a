//! Where depth changes in a true disparity map, so that errors there can be counted apart.

/// A disparity that is further off than this is of another surface, px.
pub const FAR_PX: f32 = 8.0;
/// Step of disparity between neighbours from which on it is an edge, px.
const STEP_PX: f32 = 2.0;
/// Distance from an edge, px.
const REACH_PX: usize = 5;
/// A pixel is of an object when it is nearer than anything around it by this, px, within so many columns and rows.
const OBJECT_PX: f32 = 8.0;
const OBJECT_REACH_PX: usize = 12;

/// Whether an edge of depth lies within 5 px of a pixel, along rows or columns.
pub fn near_edges(truth: &[f32], (width, height): (usize, usize)) -> Vec<bool> {
    let mut edges = vec![false; width * height];
    let mut mark = |a: usize, b: usize, step: usize, room: [usize; 2]| {
        if (truth[a] - truth[b]).abs() > STEP_PX {
            (0..REACH_PX.min(room[0])).for_each(|i| edges[a - i * step] = true);
            (0..REACH_PX.min(room[1])).for_each(|i| edges[b + i * step] = true);
        }
    };
    for y in 0..height {
        for x in 0..width {
            let at = y * width + x;
            if x + 1 < width {
                mark(at, at + 1, 1, [x + 1, width - 1 - x]);
            }
            if y + 1 < height {
                mark(at, at + width, width, [y + 1, height - 1 - y]);
            }
        }
    }
    edges
}

/// Whether a pixel is 8 px nearer than something within 12 px of it: all of a thin object, and the rim of a large one.
pub fn near_objects(truth: &[f32], (width, height): (usize, usize)) -> Vec<bool> {
    let around = |at: usize, count: usize| at.saturating_sub(OBJECT_REACH_PX)..(at + OBJECT_REACH_PX + 1).min(count);
    let least = |values: &mut dyn Iterator<Item = f32>| values.fold(f32::INFINITY, f32::min);
    let rows: Vec<f32> = (0..width * height)
        .map(|at| least(&mut around(at % width, width).map(|x| truth[at / width * width + x])))
        .collect();
    (0..width * height)
        .map(|at| truth[at] > OBJECT_PX + least(&mut around(at / width, height).map(|y| rows[y * width + at % width])))
        .collect()
}

/// Sum of the absolute errors where `near` marks an edge, px, and number of their pixels: those that `counts`, with ground truth and a disparity.
pub fn edge_errors(near: &[bool], found: &[f32], truth: &[f32], counts: impl Fn(usize) -> bool) -> (f64, usize) {
    let judged = (0..truth.len()).filter(|index| near[*index] && counts(*index));
    let errors = judged.map(|index| f64::from((found[index] - truth[index]).abs())).filter(|error| error.is_finite());
    errors.fold((0.0, 0), |(sum, count), error| (sum + error, count + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wire_is_an_object_and_its_sides_are_edges() {
        let size = (60, 40);
        let truth: Vec<f32> =
            (0..size.0 * size.1).map(|i| if (30..34).contains(&(i % 60)) { 50.0 } else { 30.0 }).collect();
        let (edges, objects) = (near_edges(&truth, size), near_objects(&truth, size));
        for i in 0..size.0 * size.1 {
            assert_eq!(objects[i], (30..34).contains(&(i % 60)), "{i}");
            assert_eq!(edges[i], (25..39).contains(&(i % 60)), "{i}");
        }
        let slope: Vec<f32> = (0..size.0 * size.1).map(|i| 0.3 * (i % 60) as f32).collect();
        assert!(near_edges(&slope, size).iter().all(|near| !near));
    }
    #[test]
    fn errors_near_edges_leave_out_what_is_unknown() {
        // One row: 12 px at 3, then 12 at 20; the map is off by 2 everywhere and unknown at one pixel near the edge.
        let truth: Vec<f32> = (0..24).map(|x| if x < 12 { 3.0 } else { 20.0 }).collect();
        let mut found: Vec<f32> = truth.iter().map(|value| value + 2.0).collect();
        found[10] = f32::NAN;
        // Columns 7 to 16 are near.
        let near = |truth: &[f32]| near_edges(truth, (24, 1));
        assert_eq!(edge_errors(&near(&truth), &found, &truth, |_| true), (18.0, 9));
        assert_eq!(edge_errors(&near(&truth), &found, &truth, |index| index != 12), (16.0, 8));
        assert_eq!(edge_errors(&near(&[3.0; 24]), &found, &[3.0; 24], |_| true), (0.0, 0), "no edge");
        assert_eq!(edge_errors(&near(&[f32::NAN; 24]), &found, &[f32::NAN; 24], |_| true), (0.0, 0), "no ground truth");
    }
}
