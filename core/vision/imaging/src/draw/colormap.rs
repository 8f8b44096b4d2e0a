//! Numbers as colours.

use super::Color;
use crate::{View, ViewMut};

/// Colour of values that are not known.
pub const UNKNOWN: Color = [48, 48, 48];

/// A scale of colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Colormap {
    /// Dark blue over green and yellow to dark red: many steps can be distinguished.
    #[default]
    Rainbow,
    /// Dark violet over teal to yellow: brightness grows evenly, safe for colour-blind eyes.
    Viridian,
    /// Black to white.
    Gray,
}

/// Red, green, blue at evenly spaced places.
const RAINBOW: [[f32; 3]; 9] = [
    [45.0, 20.0, 65.0],
    [68.0, 100.0, 222.0],
    [38.0, 185.0, 236.0],
    [48.0, 240.0, 152.0],
    [160.0, 252.0, 62.0],
    [236.0, 208.0, 56.0],
    [250.0, 126.0, 34.0],
    [208.0, 48.0, 8.0],
    [120.0, 6.0, 4.0],
];
const VIRIDIAN: [[f32; 3]; 9] = [
    [67.0, 2.0, 85.0],
    [72.0, 43.0, 121.0],
    [59.0, 82.0, 139.0],
    [44.0, 114.0, 143.0],
    [33.0, 145.0, 140.0],
    [40.0, 174.0, 128.0],
    [94.0, 201.0, 97.0],
    [171.0, 220.0, 49.0],
    [252.0, 231.0, 36.0],
];

impl Colormap {
    /// Colour at `place`, clamped to 0..=1; dark gray for NaN.
    pub fn at(self, place: f32) -> Color {
        if place.is_nan() {
            return UNKNOWN;
        }
        let place = place.clamp(0.0, 1.0);
        let table = match self {
            Self::Rainbow => &RAINBOW,
            Self::Viridian => &VIRIDIAN,
            Self::Gray => return [(place * 255.0 + 0.5) as u8; 3],
        };
        // Catmull-Rom through the table: no visible kinks between its positions.
        let x = place * (table.len() - 1) as f32;
        let i = (x as usize).min(table.len() - 2);
        let t = x - i as f32;
        let (a, b) = (table[i.saturating_sub(1)], table[i]);
        let (c, d) = (table[i + 1], table[(i + 2).min(table.len() - 1)]);
        let channel = |k: usize| {
            let (a, b, c, d) = (a[k], b[k], c[k], d[k]);
            let v = b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)));
            (v + 0.5).clamp(0.0, 255.0) as u8
        };
        [channel(2), channel(1), channel(0)]
    }

    /// Colours of numbers below and above the scale, which differ from all its colours.
    pub fn beyond(self) -> [Color; 2] {
        match self {
            Self::Rainbow | Self::Viridian => [[0; 3], [255; 3]],
            Self::Gray => [[220, 60, 0], [0, 0, 220]],
        }
    }
}

/// Paints a plane of numbers (disparity, depth): `low` and `high` are the ends of the scale (they may be swapped),
/// numbers outside get the colours of [`Colormap::beyond`], NaN is dark gray. Only the area that both images share is
/// painted.
pub fn colorize(plane: &View<f32>, low: f32, high: f32, map: Colormap, out: &mut ViewMut<u8>) {
    if plane.channels != 1 || out.channels != 3 {
        return;
    }
    let table: [Color; 256] = std::array::from_fn(|i| map.at(i as f32 / 255.0));
    let [below, above] = map.beyond();
    let scale = if high == low || !(high - low).is_finite() { 0.0 } else { 255.0 / (high - low) };
    let width = plane.width.min(out.width);
    for y in 0..plane.height.min(out.height) {
        let source = &plane.row(y)[..width];
        for (v, o) in source.iter().zip(out.row_mut(y).as_chunks_mut::<3>().0) {
            let place = (v - low) * scale;
            // A hair of room: ends of the scale belong to it.
            *o = match place {
                _ if v.is_nan() => UNKNOWN,
                _ if place < -0.5 => below,
                _ if place > 255.5 => above,
                _ => table[((place + 0.5) as usize).min(255)],
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_unknown_and_order() {
        let values = [0.0, 10.0, f32::NAN, -5.0, f32::INFINITY, 5.0];
        let mut data = [0u8; 18];
        colorize(&View::new(&values, 6, 1, 1), 0.0, 10.0, Colormap::Viridian, &mut ViewMut::new(&mut data, 6, 1, 3));
        let p = data.as_chunks::<3>().0;
        assert_eq!(p[0], [85, 2, 67]);
        assert_eq!(p[1], [36, 231, 252]);
        assert_eq!(p[2], UNKNOWN);
        assert_eq!([p[3], p[4]], Colormap::Viridian.beyond());
        assert!(p[5] != p[0] && p[5] != p[1]);
        assert_eq!(Colormap::Rainbow.at(f32::NAN), UNKNOWN);
    }

    #[test]
    fn viridian_grows_brighter_throughout() {
        let luma = |i: i32| {
            let [b, g, r] = Colormap::Viridian.at(i as f32 / 64.0).map(f32::from);
            0.114 * b + 0.587 * g + 0.299 * r
        };
        assert!((0..64).all(|i| luma(i + 1) > luma(i)));
    }
}
