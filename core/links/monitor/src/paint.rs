//! Images of other packets: maps of numbers in colours, clouds from the camera's view.

use std::mem::offset_of;

use panoscope_abi::{CloudPoint, FORMAT_CLOUD, FORMAT_F32, FORMAT_GRAY16, Frame};
use panoscope_imaging::draw::{Colormap, filled_color};

/// Lowest and highest value of a map's colours. It follows the values slowly, so that the colours do not flicker.
pub type Range = Option<(f32, f32)>;

/// Share of the values below and above the colours.
const TAIL: f32 = 0.02;
/// Share of a change of the range that one image applies.
const PACE: f32 = 0.2;
/// Every n-th value is used for the range.
const LOOK: usize = 7;

/// A map or a cloud as rows of blue, green, red without padding; `None` for other formats. `bytes` holds all rows of
/// `frame`. Confidences keep their range of 0 to 1.
pub fn painted(frame: &Frame, bytes: &[u8], packet: &str, range: &mut Range) -> Option<Vec<u8>> {
    let (width, height, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
    let rows = |pixel: usize| bytes.chunks(stride.max(1)).take(height).map(move |row| &row[..width * pixel]);
    let unknown = Colormap::Viridian.at(f32::NAN);
    let f32_at = |bytes: &[u8], at: usize| {
        bytes.get(at..at + 4).and_then(|four| four.first_chunk()).map_or(f32::NAN, |four| f32::from_le_bytes(*four))
    };
    match frame.format {
        FORMAT_F32 => {
            let values: Vec<f32> = rows(4).flat_map(|row| row.chunks_exact(4).map(|four| f32_at(four, 0))).collect();
            let (low, high) = if packet == "confidence" { (0.0, 1.0) } else { follow(&values, range) };
            let table: Vec<[u8; 3]> = (0..=255).map(|i| Colormap::Viridian.at(i as f32 / 255.0)).collect();
            let scale = 255.0 / (high - low).max(1e-6);
            // Clamped to the table; NaN was sorted out.
            let colour = |value: f32| match value.is_finite() {
                true => table[((value - low) * scale).clamp(0.0, 255.0) as usize],
                false => unknown,
            };
            Some(values.into_iter().flat_map(colour).collect())
        }
        FORMAT_CLOUD => {
            let (z, bgr) = (offset_of!(CloudPoint, z_mm), offset_of!(CloudPoint, bgr));
            let point = |point: &[u8]| {
                let color = [point[bgr], point[bgr + 1], point[bgr + 2]];
                match (f32_at(point, z).is_finite(), point[offset_of!(CloudPoint, filled)]) {
                    (true, 0) => color,
                    (true, _) => filled_color(color),
                    (false, _) => unknown,
                }
            };
            Some(
                rows(size_of::<CloudPoint>())
                    .flat_map(|row| row.chunks_exact(size_of::<CloudPoint>()).flat_map(point))
                    .collect(),
            )
        }
        FORMAT_GRAY16 => Some(rows(2).flat_map(|row| row.chunks_exact(2).flat_map(|two| [two[1]; 3])).collect()),
        _ => None,
    }
}

/// Moves the range towards that of nearly all values.
fn follow(values: &[f32], range: &mut Range) -> (f32, f32) {
    let mut known: Vec<f32> = values.iter().step_by(LOOK).copied().filter(|value| value.is_finite()).collect();
    if known.is_empty() {
        return range.unwrap_or((0.0, 1.0));
    }
    known.sort_by(f32::total_cmp);
    let at = |share: f32| known[((known.len() - 1) as f32 * share) as usize];
    let (low, high) = (at(TAIL), at(1.0 - TAIL));
    let new = match *range {
        // Another scene begins anew.
        Some((l, h)) if (l - low).abs() < (h - l) && (h - high).abs() < (h - l) => {
            (l + PACE * (low - l), h + PACE * (high - h))
        }
        _ => (low, high),
    };
    *range = Some(new);
    new
}

#[cfg(test)]
mod tests {
    use super::*;

    fn described(format: u32, width: u32, height: u32, stride_bytes: u32) -> Frame {
        Frame { format, width, height, stride_bytes, ..Frame::EMPTY }
    }

    #[test]
    fn maps_have_the_colours_of_their_range_and_gray_holes() {
        let values: Vec<u8> =
            (0..70 * 7).flat_map(|at| if at % 70 == 3 { f32::NAN } else { (at % 70) as f32 }.to_le_bytes()).collect();
        let mut range = None;
        let picture = painted(&described(FORMAT_F32, 70, 7, 280), &values, "depth", &mut range).expect("a map");
        assert_eq!(picture.len(), 70 * 7 * 3);
        assert_eq!(picture[..3], Colormap::Viridian.at(0.0));
        assert_eq!(picture[69 * 3..70 * 3], Colormap::Viridian.at(1.0));
        assert_eq!(picture[9..12], Colormap::Viridian.at(f32::NAN));
        let (low, high) = range.expect("a range");
        assert!(low < 5.0 && high > 60.0, "{low} to {high}");
        let sure =
            painted(&described(FORMAT_F32, 1, 1, 4), &1f32.to_le_bytes(), "confidence", &mut None).expect("a map");
        assert_eq!(sure, Colormap::Viridian.at(1.0));
    }

    #[test]
    fn points_have_their_colours_where_they_are_known() {
        let mut bytes = vec![0; 3 * size_of::<CloudPoint>() + 8];
        bytes[12..15].copy_from_slice(&[1, 2, 3]);
        bytes[24..28].copy_from_slice(&f32::NAN.to_le_bytes());
        bytes[28..31].copy_from_slice(&[4, 5, 6]);
        bytes[44..48].copy_from_slice(&[100, 50, 200, 1]);
        let frame = described(FORMAT_CLOUD, 3, 1, 56);
        let picture = painted(&frame, &bytes, "cloud", &mut None).expect("a cloud");
        assert_eq!(picture, [[1, 2, 3], Colormap::Viridian.at(f32::NAN), [80, 40, 160]].concat());
        assert_eq!(painted(&described(panoscope_abi::FORMAT_BGR8, 1, 1, 3), &[0; 3], "image", &mut None), None);
    }
}
