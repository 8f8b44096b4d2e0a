//! Lighting of a surface by the normal around each corner.

use super::corner::{Corner, is_known};

/// Radius in corners over which a normal is measured.
const REACH: usize = 2;

/// Lights each corner by the normal around it: `shading` darkens surfaces that face away from a viewer along `view` (a
/// unit vector).
pub fn light(corners: &mut [Corner], width: usize, view: [f32; 3], shading: f32) {
    let height = corners.len() / width;
    for at in 0..corners.len() {
        if !is_known(&corners[at]) {
            continue;
        }
        let (x, y) = (at % width, at / width);
        // From the farthest known corner on one side to that on the other.
        let span = |step: usize, before: usize, after: usize| {
            let known = |side: &dyn Fn(usize) -> usize, most: usize| {
                let reach = (1..=most).take_while(|k| is_known(&corners[side(*k)])).last();
                reach.map_or(at, side)
            };
            let a = corners[known(&|k| at - k * step, before.min(REACH))].world;
            let b = corners[known(&|k| at + k * step, after.min(REACH))].world;
            [b[0] - a[0], b[1] - a[1], b[2] - a[2]]
        };
        let (across, down) = (span(1, x, width - 1 - x), span(width, y, height - 1 - y));
        let normal = [
            across[1] * down[2] - across[2] * down[1],
            across[2] * down[0] - across[0] * down[2],
            across[0] * down[1] - across[1] * down[0],
        ];
        let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
        let facing = normal.iter().zip(view).map(|(n, v)| n * v).sum::<f32>().abs() / length;
        corners[at].light = if length > 1e-12 { 1.0 - shading + shading * facing } else { 1.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::super::corner::NOWHERE;
    use super::*;

    const SIDE: usize = 40;

    #[test]
    fn what_turns_away_is_darker_and_terraces_are_not_seen() {
        let lit = |slope: f32| {
            // Depths in terraces of two corners.
            let corner = |at: usize| {
                let (x, y) = (at % SIDE, at / SIDE);
                let world = [x as f32 * 0.5, y as f32 * 0.5, 50.0 + slope * (x / 2) as f32];
                Corner { place: world, world, color: [9; 3], ..NOWHERE }
            };
            let mut corners: Vec<Corner> = (0..SIDE * SIDE).map(corner).collect();
            light(&mut corners, SIDE, [0.0, 0.0, 1.0], 0.6);
            corners.iter().skip(20 * SIDE + 4).take(SIDE - 8).map(|c| c.light).collect::<Vec<f32>>()
        };
        assert!(lit(0.0).iter().all(|l| (l - 1.0).abs() < 1e-3));
        let slanted = lit(1.0);
        assert!(slanted.iter().all(|l| (0.75..0.9).contains(l)), "{slanted:?}");
        assert!(slanted.iter().all(|l| (l - slanted[0]).abs() < 0.01), "{slanted:?}");
    }
}
