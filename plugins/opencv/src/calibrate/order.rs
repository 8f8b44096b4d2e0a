//! How many coefficients of distortion the views determine, by cross-validation.
//!
//! More coefficients always fit the views better that they were solved from. They are worth it where they also explain views that were left out.

use opencv::calib3d;
use opencv::core::{Mat, Point2f, Vector};

use super::solution::Pair;
use super::solve::{Model, camera_of, criteria, object_of};

/// From the fewest coefficients on.
const MODELS: [Model; 3] = [Model::Standard, Model::Full, Model::Rational];
/// Fewest views that are divided.
pub const MIN_VIEWS: usize = 8;
/// Parts of the views, each of which is left out once.
const FOLDS: usize = 5;
/// Views that are looked at, spread over all: the time grows with their square.
const MAX_VIEWS: usize = 30;
/// More coefficients must lower the error of the views left out by more than this share of it, and by more than this many standard errors.
const MIN_GAIN: f64 = 0.01;
const MIN_DEVIATIONS: f64 = 1.0;

/// A model, and the root mean square error of the views left out, px.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    pub model: Model,
    pub error_px: f64,
    /// The same with the fewest coefficients.
    pub plain_px: f64,
}

/// The model with the fewest coefficients that no other one clearly betters on views left out; none for fewer than [`MIN_VIEWS`].
///
/// # Errors
/// OpenCV cannot solve for a camera.
pub fn choose(pairs: &[&Pair], size: (usize, usize)) -> opencv::Result<Option<Choice>> {
    if pairs.len() < MIN_VIEWS {
        return Ok(None);
    }
    let count = pairs.len().min(MAX_VIEWS);
    let views: Vec<&Pair> = (0..count).map(|index| pairs[index * pairs.len() / count]).collect();
    let mut best = (MODELS[0], held_out_px(&views, size, MODELS[0])?);
    let plain_px = mean(&best.1);
    for model in MODELS.into_iter().skip(1) {
        let errors = held_out_px(&views, size, model)?;
        if is_better(&errors, &best.1) {
            best = (model, errors);
        }
    }
    Ok(Some(Choice { model: best.0, error_px: mean(&best.1), plain_px }))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Whether the errors of the same views are lower by more than chance.
fn is_better(errors: &[f64], than: &[f64]) -> bool {
    let gains: Vec<f64> = errors.iter().zip(than).map(|(new, old)| old - new).collect();
    let gain = mean(&gains);
    let squares: Vec<f64> = gains.iter().map(|g| (g - gain).powi(2)).collect();
    let deviation = (mean(&squares) / (gains.len().max(2) - 1) as f64).sqrt();
    // NaN is no gain.
    gain > MIN_DEVIATIONS * deviation && gain > MIN_GAIN * mean(than)
}

/// Error of each view with cameras that were solved from other views, px.
fn held_out_px(views: &[&Pair], size: (usize, usize), model: Model) -> opencv::Result<Vec<f64>> {
    let mut squares = vec![0.0; views.len()];
    for fold in 0..FOLDS {
        let rest: Vec<&Pair> =
            (0..views.len()).filter(|index| index % FOLDS != fold).map(|index| views[index]).collect();
        for side in 0..2 {
            let (k, d) = camera_of(&rest, side, size, model, criteria(60, 1e-7)?)?;
            for index in (fold..views.len()).step_by(FOLDS) {
                squares[index] += 0.5 * misfit(views[index], side, &k, &d)?;
            }
        }
    }
    Ok(squares.into_iter().map(f64::sqrt).collect())
}

/// Mean squared distance of a board's points from where a known camera sees them, the board placed as well as possible, px².
fn misfit(view: &Pair, side: usize, k: &Mat, d: &Mat) -> opencv::Result<f64> {
    let object = object_of(view);
    let seen: Vector<Point2f> = view.px[side].iter().map(|p| Point2f::new(p[0], p[1])).collect();
    let (mut turn, mut shift) = (Mat::default(), Mat::default());
    calib3d::solve_pnp_def(&object, &seen, k, d, &mut turn, &mut shift)?;
    let mut placed = Vector::<Point2f>::new();
    calib3d::project_points_def(&object, &turn, &shift, k, d, &mut placed)?;
    let off = seen.iter().zip(placed.iter()).map(|(a, b)| f64::from(a.x - b.x).powi(2) + f64::from(a.y - b.y).powi(2));
    Ok(off.sum::<f64>() / seen.len().max(1) as f64)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A board of 9 x 6 points of 10 mm at a pose, seen by a camera of 800 px with k1 to k3, and noise.
    pub fn view(index: usize, k: [f64; 3], noise_px: f64) -> Pair {
        let random = |salt: i64| panoscope_node::random::lattice(index as i64, salt, 5);
        let angle = |salt: i64| 0.9 * (random(salt) - 0.5);
        let (a, b, c) = (angle(1), angle(2), angle(3));
        let place = [60.0 * (random(4) - 0.5), 50.0 * (random(5) - 0.5), 95.0 + 40.0 * random(6)];
        let mut pair = Pair { board_mm: Vec::new(), px: [Vec::new(), Vec::new()] };
        for point in 0..54i64 {
            let (u, v) = (10.0 * (point % 9) as f64, 10.0 * (point / 9) as f64);
            pair.board_mm.push([u, v]);
            let (u, v) = (u - 40.0, v - 25.0);
            // Turned about z, then x and y.
            let (x, y) = (u * c.cos() - v * c.sin(), u * c.sin() + v * c.cos());
            let (y, z) = (y * a.cos(), y * a.sin());
            let (x, z) = (x * b.cos() + z * b.sin(), z * b.cos() - x * b.sin());
            for side in 0..2 {
                let z = z + place[2];
                let (x, y) = ((x + place[0] - 5.0 * side as f64) / z, (y + place[1]) / z);
                let r = x * x + y * y;
                let factor = 1.0 + k[0] * r + k[1] * r * r + k[2] * r * r * r;
                let noise = |salt: i64| {
                    let random =
                        |part: i64| panoscope_node::random::lattice(point, salt + 10 * part + 100 * index as i64, 9);
                    noise_px * (random(0) + random(1) + random(2) - 1.5) * 2.0
                };
                let at = [400.0 + 800.0 * x * factor + noise(side), 300.0 + 800.0 * y * factor + noise(side + 5)];
                pair.px[side as usize].push(at.map(|v| v as f32));
            }
        }
        pair
    }

    fn chosen(k: [f64; 3]) -> Choice {
        let views: Vec<Pair> = (0..20).map(|index| view(index, k, 0.1)).collect();
        let views: Vec<&Pair> = views.iter().collect();
        choose(&views, (800, 600)).expect("OpenCV solves").expect("enough views")
    }

    #[test]
    fn coefficients_are_added_where_views_left_out_agree() {
        let plain = chosen([-0.3, 0.1, 0.0]);
        assert_eq!(plain.model, Model::Standard, "{plain:?}");
        let bent = chosen([-0.4, 0.5, -2.0]);
        assert!(bent.model != Model::Standard && bent.error_px < 0.7 * bent.plain_px, "{bent:?}");
        let views: Vec<Pair> = (0..MIN_VIEWS - 1).map(|index| view(index, [0.0; 3], 0.1)).collect();
        assert!(choose(&views.iter().collect::<Vec<_>>(), (800, 600)).expect("no error").is_none());
    }

    #[test]
    fn chance_is_no_gain() {
        let old = [1.0, 1.1, 0.9, 1.0];
        assert!(!is_better(&old, &old) && !is_better(&[0.9, 1.15, 1.0, 0.9], &old));
        assert!(is_better(&[0.9, 1.0, 0.8, 0.9], &old) && !is_better(&[f64::NAN; 4], &old));
    }
}
