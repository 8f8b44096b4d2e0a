//! Errors at the edges of surfaces, such as those of instruments.

/// True disparities of neighbours that differ by more are of two surfaces, px.
const STEP_PX: f32 = 1.5;
/// Pixels count up to this far from an edge, along rows and columns.
const REACH_PX: usize = 5;

/// Whether each pixel lies near an edge of the true disparity. Pixels without truth have no edge.
fn near_edges(truth: &[f32], width: usize) -> Vec<bool> {
    let apart = |a: usize, b: usize| (truth[a] - truth[b]).abs() > STEP_PX;
    let height = truth.len() / width.max(1);
    let mut edge = vec![false; truth.len()];
    for index in 0..truth.len() {
        let (x, y) = (index % width, index / width);
        for other in [(x + 1 < width).then_some(index + 1), (y + 1 < height).then_some(index + width)] {
            if let Some(other) = other.filter(|other| apart(index, *other)) {
                (edge[index], edge[other]) = (true, true);
            }
        }
    }
    let mut near = vec![false; truth.len()];
    for index in (0..truth.len()).filter(|index| edge[*index]) {
        let (x, y) = (index % width, index / width);
        let columns = x.saturating_sub(REACH_PX)..=(x + REACH_PX).min(width - 1);
        for y in y.saturating_sub(REACH_PX)..=(y + REACH_PX).min(height - 1) {
            near[y * width..][columns.clone()].fill(true);
        }
    }
    near
}

/// Sum of the absolute errors near edges, px, and number of their pixels: those that `counts`, with a truth and a disparity.
pub fn edge_errors(found: &[f32], truth: &[f32], width: usize, counts: impl Fn(usize) -> bool) -> (f64, usize) {
    let near = near_edges(truth, width);
    let judged = (0..truth.len()).filter(|index| near[*index] && counts(*index));
    let errors = judged.map(|index| f64::from((found[index] - truth[index]).abs())).filter(|error| error.is_finite());
    errors.fold((0.0, 0), |(sum, count), error| (sum + error, count + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_near_the_step_of_the_truth_count_and_unknown_ones_do_not() {
        // One row: 12 px at 3, then 12 at 20; the map is off by 2 everywhere and unknown at one pixel near the edge.
        let truth: Vec<f32> = (0..24).map(|x| if x < 12 { 3.0 } else { 20.0 }).collect();
        let mut found: Vec<f32> = truth.iter().map(|value| value + 2.0).collect();
        found[10] = f32::NAN;
        // Columns 6 to 17 are near.
        assert_eq!(edge_errors(&found, &truth, 24, |_| true), (22.0, 11));
        assert_eq!(edge_errors(&found, &truth, 24, |index| index != 12), (20.0, 10));
        assert_eq!(edge_errors(&found, &[3.0; 24], 24, |_| true), (0.0, 0), "no edge");
        assert_eq!(edge_errors(&found, &[f32::NAN; 24], 24, |_| true), (0.0, 0), "no truth");
    }
}
