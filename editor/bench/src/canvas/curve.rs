//! The curves that wires are drawn as.

use eframe::egui::{Pos2, vec2};

/// A point of a curve, `t` 0..=1.
pub(super) fn on_curve(p: &[Pos2; 4], t: f32) -> Pos2 {
    let s = 1.0 - t;
    let weights = [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t];
    let mut at = Pos2::ZERO;
    for (p, w) in p.iter().zip(weights) {
        at += p.to_vec2() * w;
    }
    at
}

/// Approximates a curve by few segments with this greatest distance from it; most wires of a large graph are one segment.
pub(super) fn flattened_to(p: &[Pos2; 4], tolerance: f32) -> Vec<Pos2> {
    let chord = (p[3] - p[0]).normalized();
    let aside = |q: Pos2| ((q - p[0]).x * chord.y - (q - p[0]).y * chord.x).abs();
    if aside(p[1]).max(aside(p[2])) < tolerance {
        return vec![p[0], p[3]];
    }
    // The error of n equal steps is at most max|second derivative| / (8 n^2).
    let bend = |a: Pos2, b: Pos2, c: Pos2| (a.to_vec2() - 2.0 * b.to_vec2() + c.to_vec2()).length();
    let most = 6.0 * bend(p[0], p[1], p[2]).max(bend(p[1], p[2], p[3]));
    let count = (most / (8.0 * tolerance)).sqrt().ceil().clamp(2.0, 64.0) as usize;
    (0..=count).map(|i| on_curve(p, i as f32 / count as f32)).collect()
}

/// The fewest of the points of a line such that none of the others is farther than `tolerance` from it (Douglas and Peucker).
pub(super) fn simplified(points: &[Pos2], tolerance: f32) -> Vec<Pos2> {
    let Some(last) = points.len().checked_sub(1).filter(|last| *last > 0) else { return points.to_vec() };
    let mut kept = vec![false; points.len()];
    (kept[0], kept[last]) = (true, true);
    let mut parts = vec![(0, last)];
    while let Some((from, to)) = parts.pop() {
        let apart = |n: usize| distance(points[n], points[from], points[to]);
        let farthest = (from + 1..to).max_by(|a, b| apart(*a).total_cmp(&apart(*b)));
        if let Some(n) = farthest.filter(|n| apart(*n) > tolerance) {
            kept[n] = true;
            parts.extend([(from, n), (n, to)]);
        }
    }
    points.iter().zip(kept).filter_map(|(at, is_kept)| is_kept.then_some(*at)).collect()
}

/// Distance of a point from a line between two others.
pub(super) fn distance(at: Pos2, from: Pos2, to: Pos2) -> f32 {
    let delta = to - from;
    let along = ((at - from).dot(delta) / delta.length_sq().max(1e-6)).clamp(0.0, 1.0);
    at.distance(from + delta * along)
}

/// The curve of a wire between two pins.
pub(super) fn bow(from: Pos2, to: Pos2, scale: f32) -> [Pos2; 4] {
    let reach = ((to.x - from.x).abs() * 0.5).max(40.0 * scale).min(220.0 * scale);
    [from, from + vec2(reach, 0.0), to - vec2(reach, 0.0), to]
}

/// Straight segments between corners, with rounded turns.
pub(super) fn rounded(corners: &[Pos2]) -> Vec<[Pos2; 4]> {
    const RADIUS: f32 = 14.0;
    let straight = |a: Pos2, b: Pos2| [a, a + (b - a) / 3.0, b - (b - a) / 3.0, b];
    let (mut at, mut curves) = (corners[0], Vec::with_capacity(2 * corners.len()));
    for three in corners.windows(3) {
        let [a, b, c] = [three[0], three[1], three[2]];
        let radius = RADIUS.min((b - a).length() / 2.0).min((c - b).length() / 2.0);
        let (before, after) = (b - (b - a).normalized() * radius, b + (c - b).normalized() * radius);
        curves.push(straight(at, before));
        curves.push([before, before + (b - before) * 0.55, after + (b - after) * 0.55, after]);
        at = after;
    }
    curves.push(straight(at, corners[corners.len() - 1]));
    curves
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::pos2;

    #[test]
    fn wires_are_few_pieces_and_keep_to_their_curve() {
        let straight = bow(pos2(0.0, 5.0), pos2(300.0, 5.0), 1.0);
        assert_eq!(flattened_to(&straight, 0.25).len(), 2);
        let curve = bow(pos2(0.0, 0.0), pos2(120.0, 400.0), 1.0);
        let points = flattened_to(&curve, 0.25);
        assert!((8..=64).contains(&points.len()), "{}", points.len());
        let apart = |at: Pos2| points.windows(2).map(|pair| distance(at, pair[0], pair[1])).fold(f32::MAX, f32::min);
        let worst = (0..=500).map(|i| apart(on_curve(&curve, i as f32 / 500.0))).fold(0.0, f32::max);
        assert!(worst < 0.3, "{worst}");
    }

    #[test]
    fn a_path_from_afar_has_only_its_corners() {
        let corners = [pos2(0.0, 0.0), pos2(300.0, 0.0), pos2(300.0, 400.0), pos2(700.0, 400.0)];
        let curves = rounded(&corners);
        let points: Vec<Pos2> = curves.iter().flat_map(|curve| flattened_to(curve, 0.5)).collect();
        let few = simplified(&points, 10.0);
        assert_eq!(few.len(), 4, "{few:?} of {} points", points.len());
        let apart = |at: Pos2| few.windows(2).map(|pair| distance(at, pair[0], pair[1])).fold(f32::MAX, f32::min);
        assert!(points.iter().all(|at| apart(*at) <= 10.0), "{few:?}");
        assert_eq!((few[0], few[3]), (corners[0], corners[3]));
        assert_eq!(simplified(&corners[..1], 1.0), corners[..1]);
        assert!(simplified(&[], 1.0).is_empty());
    }

    #[test]
    fn paths_around_nodes_have_rounded_turns_and_no_gaps() {
        let corners = [pos2(10.0, 0.0), pos2(40.0, 0.0), pos2(40.0, 90.0), pos2(-60.0, 90.0), pos2(-60.0, 20.0)];
        let curves = rounded(&corners);
        assert!(curves.windows(2).all(|pair| pair[0][3] == pair[1][0]), "{curves:?}");
        assert_eq!((curves[0][0], curves[curves.len() - 1][3]), (corners[0], corners[4]));
    }
}
