//! Compares two outputs of one tick in numbers, from the packets themselves: images by PSNR and SSIM, disparity and depth by their errors. The
//! measures are those of the evaluation nodes.

use panoscope_abi as abi;
use panoscope_imaging::View;
use panoscope_imaging::stereo::MapScorer;
use panoscope_imaging::stitch::evaluate::{Gray, likeness};

use crate::output::Output;
use crate::probe::Layout;

/// Two outputs with the type of their packets. The second one is taken for the truth.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ComparisonRequest {
    /// The compared output.
    pub output: Output,
    /// The output that it is compared with.
    pub other: Output,
    /// Type of the packets of the first one.
    pub packet: String,
}

impl ComparisonRequest {
    /// Whether an output is one of the two.
    pub fn is_of(&self, output: &Output) -> bool {
        [&self.output, &self.other].contains(&output)
    }
}

/// How two packets differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Number of the tick.
    pub seq: u64,
    /// In numbers; `None` for packets that cannot be compared: other types or sizes.
    pub measures: Option<Measures>,
}

/// Measures of two packets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Measures {
    /// Of two images, after one gain was removed.
    Images {
        /// Peak signal-to-noise ratio, dB.
        psnr_db: f64,
        /// Mean structural similarity, at most 1; NaN for images smaller than a window.
        ssim: f64,
    },
    /// Of two maps of disparity or depth, where both have a value.
    Maps {
        /// Mean absolute difference: the end-point error of a disparity, px, or of a depth, mm.
        mean_error: f64,
        /// What 95 % of the differences stay below, in the same unit.
        p95_error: f64,
        /// Share of the other one's known values that this one has too, 0..=1.
        density: f64,
        /// Unit of the errors.
        unit: &'static str,
    },
}

/// Compares two packets of a type; `None` where their types or sizes differ.
pub fn compare(a: (&abi::Frame, &[u8]), b: (&abi::Frame, &[u8]), packet: &str) -> Option<Measures> {
    let layouts = (Layout::of(a.0, a.1, packet)?, Layout::of(b.0, b.1, packet)?);
    if layouts.0.size() != layouts.1.size() {
        return None;
    }
    match packet {
        "disparity" | "depth" => maps(layouts, packet),
        "image" | "mask" => {
            let (width, height) = layouts.0.size();
            let gray = |layout: &Layout<'_>| Some(Gray { data: layout.luma()?, width, height });
            let found = likeness(&gray(&layouts.0)?, &gray(&layouts.1)?, &vec![true; width * height])?;
            Some(Measures::Images { psnr_db: found.psnr_db, ssim: found.ssim })
        }
        _ => None,
    }
}

fn maps((found, truth): (Layout<'_>, Layout<'_>), packet: &str) -> Option<Measures> {
    let (width, height) = found.size();
    let (found, truth) = (found.first_channel(), truth.first_channel());
    let (found, truth) = (View::new(&found, width, height, 1), View::new(&truth, width, height, 1));
    let mut scorer = MapScorer::default();
    let (mean_error, p95_error, density, unit) = match packet {
        "depth" => {
            let score = scorer.depth(found, truth, None).ok()?;
            (score.mean_error_mm, score.p95_error_mm, score.density, "mm")
        }
        _ => {
            let score = scorer.disparity(found, truth, None).ok()?;
            (score.mean_error_px, score.p95_error_px, score.density, "px")
        }
    };
    Some(Measures::Maps { mean_error, p95_error, density, unit })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A packet of a format with rows of `width` pixels.
    fn frame(format: u32, width: u32, bytes: &[u8]) -> abi::Frame {
        let pixel = panoscope_base::format::pixel_bytes(format) as u32;
        let height = bytes.len() as u32 / (width * pixel);
        abi::Frame { format, width, height, stride_bytes: width * pixel, ..abi::Frame::EMPTY }
    }

    fn measures(format: u32, packet: &str, a: (&[u8], u32), b: (&[u8], u32)) -> Option<Measures> {
        compare((&frame(format, a.1, a.0), a.0), (&frame(format, b.1, b.0), b.0), packet)
    }

    #[test]
    fn images_are_compared_by_psnr_and_ssim() {
        let image: Vec<u8> = (0..3 * 16 * 16u32).map(|at| (at * 37 % 251) as u8).collect();
        let mut other = image.clone();
        other.iter_mut().step_by(2).for_each(|value| *value = value.saturating_add(20));
        let of = |b: &[u8]| match measures(abi::FORMAT_BGR8, "image", (&image, 16), (b, 16)) {
            Some(Measures::Images { psnr_db, ssim }) => (psnr_db, ssim),
            other => panic!("{other:?}"),
        };
        let (same, differs) = (of(&image), of(&other));
        assert!(same.0 > 60.0 && same.1 > 0.999, "{same:?}");
        assert!((15.0..40.0).contains(&differs.0) && differs.1 < 0.9985, "{differs:?}");
        // Another shape has no measure.
        assert_eq!(measures(abi::FORMAT_BGR8, "image", (&image, 16), (&image, 8)), None);
    }

    #[test]
    fn maps_are_compared_by_their_end_point_error() {
        let bytes = |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|value| value.to_le_bytes()).collect() };
        let truth = bytes(&[10.0, 20.0, f32::NAN, 40.0]);
        let found = bytes(&[11.0, 17.0, 5.0, f32::NAN]);
        for (packet, expected) in [("disparity", "px"), ("depth", "mm")] {
            match measures(abi::FORMAT_F32, packet, (&found, 2), (&truth, 2)) {
                Some(Measures::Maps { mean_error, density, unit, .. }) => {
                    assert_eq!((mean_error, unit), (2.0, expected));
                    assert!((density - 2.0 / 3.0).abs() < 1e-9, "{density}");
                }
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(measures(abi::FORMAT_F32, "confidence", (&found, 2), (&truth, 2)), None);
    }
}
