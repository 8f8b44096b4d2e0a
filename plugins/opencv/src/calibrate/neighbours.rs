//! Points that do not fit their neighbours: a ChArUco corner whose place was guessed from its markers may have been drawn to
//! something else nearby.

use super::grid::Points;

/// Distance of neighbours, squares.
const REACH_SQUARES: f64 = 2.9;
/// Fewest neighbours that can confirm a point.
const MIN_NEIGHBOURS: usize = 4;
/// Largest distance of a point from its neighbours' prediction, squares.
const TOLERANCE_SQUARES: f64 = 0.15;

/// Removes points that are far from the prediction by an affine map through their neighbours, the worst first.
pub fn keep_fitting(points: &mut Points, places_mm: &[[f64; 2]], square_mm: f64) {
    while let Some(worst) = worst(points, places_mm, square_mm) {
        points.remove(worst);
    }
}

/// Index of the point that fits worst, if it fits badly.
fn worst(points: &Points, places_mm: &[[f64; 2]], square_mm: f64) -> Option<usize> {
    let errors = (0..points.len()).map(|index| (index, misfit(points, index, places_mm, square_mm)));
    let (index, error) = errors.max_by(|a, b| a.1.total_cmp(&b.1))?;
    (error > TOLERANCE_SQUARES).then_some(index)
}

/// Distance of the point from its neighbours' prediction, squares; infinite without one.
fn misfit(points: &Points, index: usize, places_mm: &[[f64; 2]], square_mm: f64) -> f64 {
    let place = |id: usize| places_mm.get(id).copied().unwrap_or([f64::NAN; 2]);
    let own = place(points[index].0);
    // Normal equations of u and v = a + b x + c y, with the point itself at the origin: `a` is where it should lie.
    let (mut m, mut sides) = ([[0.0; 3]; 3], [[0.0; 3]; 2]);
    let mut count = 0;
    for (other, (id, px)) in points.iter().enumerate() {
        let at = place(*id);
        let row = [1.0, (at[0] - own[0]) / square_mm, (at[1] - own[1]) / square_mm];
        let is_near = row[1].hypot(row[2]) <= REACH_SQUARES;
        if other == index || !is_near {
            continue;
        }
        count += 1;
        for i in 0..3 {
            for j in 0..3 {
                m[i][j] += row[i] * row[j];
            }
            sides[0][i] += row[i] * f64::from(px[0]);
            sides[1][i] += row[i] * f64::from(px[1]);
        }
    }
    if count < MIN_NEIGHBOURS {
        return f64::INFINITY;
    }
    let (Some(u), Some(v)) = (solve3(m, sides[0]), solve3(m, sides[1])) else { return f64::INFINITY };
    let px = points[index].1;
    let square_px = (u[1] * v[2] - u[2] * v[1]).abs().sqrt();
    (u[0] - f64::from(px[0])).hypot(v[0] - f64::from(px[1])) / square_px.max(1e-9)
}

/// Cramer's rule; none where the neighbours are collinear.
fn solve3(m: [[f64; 3]; 3], side: [f64; 3]) -> Option<[f64; 3]> {
    let det = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = det(m);
    if whole.abs() < 1e-6 {
        return None;
    }
    Some(std::array::from_fn(|column| {
        let mut changed = m;
        (0..3).for_each(|row| changed[row][column] = side[row]);
        det(changed) / whole
    }))
}

#[cfg(test)]
mod tests {
    use super::keep_fitting;

    #[test]
    fn a_corner_drawn_away_goes_and_the_others_stay() {
        let places: Vec<[f64; 2]> =
            (0..5).flat_map(|y| (0..6).map(move |x| [5.0 * f64::from(x), 5.0 * f64::from(y)])).collect();
        // Seen obliquely, with some perspective.
        let see = |p: &[f64; 2]| {
            let w = 1.0 + 0.004 * p[0] + 0.002 * p[1];
            [(100.0 + 8.0 * p[0] + 2.0 * p[1]) as f32 / w as f32, (80.0 - 1.0 * p[0] + 9.0 * p[1]) as f32 / w as f32]
        };
        let mut points: Vec<(usize, [f32; 2])> = places.iter().map(see).enumerate().collect();
        let good = points.clone();
        keep_fitting(&mut points, &places, 5.0);
        assert_eq!(points, good);
        points[14].1[0] += 12.0;
        keep_fitting(&mut points, &places, 5.0);
        assert_eq!(points.len(), 29);
        assert!(points.iter().all(|(id, _)| *id != 14));
        // Points on one line have no neighbours that could vouch for them.
        let mut line = good[..6].to_vec();
        keep_fitting(&mut line, &places, 5.0);
        assert!(line.is_empty());
    }
}
