//! Branching vessels drawn into a plane.

use super::math::{Stream, cos_turns, sin_turns};

/// Growth parameters of a family of vessels.
#[derive(Clone, Copy, Debug)]
pub struct Growth {
    /// Trees in the whole map.
    pub trees: usize,
    /// Width of a trunk, mm.
    pub trunk_mm: f32,
    /// Width below which a twig ends, mm.
    pub twig_mm: f32,
    /// Probability of a branch per mm.
    pub branching_per_mm: f32,
    /// Wandering of the direction, turns per square root of a mm.
    pub tortuosity: f32,
}

/// Draws trees of vessels into `plane` (`size` x `size` bytes, periodic): 0 outside, up to 255 on the axis of a thick vessel; thin ones are fainter.
pub fn draw_vessels(stream: &mut Stream, growth: &Growth, plane: &mut [u8], size: usize, texel_mm: f32) {
    const STEP_MM: f32 = 0.12;
    let extent = size as f32 * texel_mm;
    let mut open: Vec<[f32; 4]> = Vec::new();
    for _ in 0..growth.trees {
        let start = [stream.range(0.0, extent), stream.range(0.0, extent)];
        let angle = stream.range(0.0, 1.0);
        let width = growth.trunk_mm * stream.range(0.6, 1.15);
        open.push([start[0], start[1], angle, width]);
        // A trunk runs both ways, or its cut end would show.
        open.push([start[0], start[1], angle + 0.5, width]);
        let mut segments = 0;
        while let Some([mut x, mut y, mut angle, mut width]) = open.pop() {
            let (mut curl, mut swing) = (0.0, 0.0);
            while width > growth.twig_mm && segments < 5000 {
                segments += 1;
                // The swing about the heading is pulled back, or vessels would curl into balls of wool.
                curl = curl * 0.93 + stream.range(-1.0, 1.0) * growth.tortuosity * STEP_MM - swing * 0.012;
                swing += curl;
                angle += stream.range(-1.0, 1.0) * 0.006;
                let turns = f64::from(angle + swing);
                let (dx, dy) = (cos_turns(turns) as f32, sin_turns(turns) as f32);
                // Discs a texel apart, or thin vessels would look like beads.
                let discs = (STEP_MM / texel_mm).ceil();
                for disc in 0..discs as u32 {
                    let part = disc as f32 * (STEP_MM / discs);
                    let place = [(x + dx * part) / texel_mm, (y + dy * part) / texel_mm];
                    stamp(plane, size, place, width / texel_mm, strength(width));
                }
                x += dx * STEP_MM;
                y += dy * STEP_MM;
                width *= 1.0 - 0.016 * STEP_MM / (0.2 + width);
                if stream.range(0.0, 1.0) < growth.branching_per_mm * STEP_MM {
                    let side = if stream.bits() & 1 == 0 { 1.0 } else { -1.0 };
                    let share = stream.range(0.45, 0.8);
                    open.push([x, y, angle + swing + side * stream.range(0.06, 0.15), width * share]);
                    angle -= side * 0.03 * share;
                    width *= 1.0 - 0.25 * share * share;
                }
            }
        }
    }
}

fn strength(width_mm: f32) -> f32 {
    0.35 + 0.65 * (width_mm / 0.6).min(1.0)
}

/// Draws a soft disc; each pixel keeps the larger value.
fn stamp(plane: &mut [u8], size: usize, [x, y]: [f32; 2], width: f32, strength: f32) {
    let radius = (width * 0.5).max(0.7);
    // A vessel thinner than a texel is drawn one texel wide but fainter.
    let strength = strength * (width / 1.4).min(1.0);
    let reach = radius + 1.0;
    let inv = 1.0 / reach;
    let (x0, x1) = ((x - reach).floor() as i32, (x + reach).floor() as i32 + 1);
    let (y0, y1) = ((y - reach).floor() as i32, (y + reach).floor() as i32 + 1);
    let mask = size - 1;
    for ty in y0..=y1 {
        let row = &mut plane[(ty as usize & mask) * size..][..size];
        for tx in x0..=x1 {
            let (dx, dy) = ((tx as f32 - x) * inv, (ty as f32 - y) * inv);
            let inside = 1.0 - (dx * dx + dy * dy);
            if inside > 0.0 {
                let value = (255.0 * strength * (inside * 1.7).min(1.0)) as u8;
                let texel = &mut row[tx as usize & mask];
                *texel = (*texel).max(value);
            }
        }
    }
}
