//! Values of a picture: at a point, along a line, and how often each occurs. Read on the observer's thread from the packet itself, so that they
//! are not those of a smaller preview or of its colours.

use std::mem::offset_of;

use panoscope_abi as abi;
use panoscope_base::format;

/// Number of bars of a histogram.
pub const BARS: usize = 48;
/// Maximum number of pixels that a histogram counts; of a larger picture it counts a regular part.
const MAX_COUNTED: usize = 100_000;
/// Maximum number of samples of a profile.
const MAX_SAMPLES: usize = 1024;

/// What is asked about a picture. Points are fractions of its width and height.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProbeRequest {
    /// A point.
    pub at: Option<[f32; 2]>,
    /// Ends of a line.
    pub line: Option<[[f32; 2]; 2]>,
}

/// The values of a picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Probe {
    /// Number of the tick.
    pub seq: u64,
    /// Width and height, px.
    pub size: (usize, usize),
    /// Names of the channels.
    pub channels: &'static [&'static str],
    /// Unit of the values; empty for counts of light.
    pub unit: &'static str,
    /// The requested point.
    pub at: Option<Sample>,
    /// Histograms of the channels that have one.
    pub histograms: Vec<Histogram>,
    /// The values along the requested line.
    pub profile: Option<Profile>,
    /// Whether the picture came from another machine with fewer pixels than it has there, each a mean or one of several.
    pub is_thinned: bool,
}

/// The values of one pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Column and row.
    pub px: (usize, usize),
    /// Value of each channel; NaN where unknown.
    pub values: Vec<f32>,
}

/// How often values occur.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    /// Lowest and highest known value: the ends of the bars.
    pub range: (f32, f32),
    /// Number of counted pixels in each of [`BARS`] equal parts of the range.
    pub bars: Vec<u32>,
    /// Mean of the known values.
    pub mean: f32,
    /// Share of pixels whose value is not known, 0..=1.
    pub unknown: f32,
}

/// Values along a line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    /// Length of the line, px.
    pub length_px: f32,
    /// Values of each channel at equal distances from one end to the other; NaN where unknown.
    pub values: Vec<Vec<f32>>,
}

/// How the values of a picture are stored.
#[derive(Clone, Copy)]
pub(crate) struct Layout<'f> {
    bytes: &'f [u8],
    width: usize,
    height: usize,
    stride: usize,
    pixel: usize,
    format: u32,
    channels: &'static [&'static str],
    unit: &'static str,
}

impl<'f> Layout<'f> {
    /// `None` for what is not a picture, and where the description does not fit the bytes.
    pub(crate) fn of(frame: &abi::Frame, bytes: &'f [u8], packet: &str) -> Option<Self> {
        let (channels, unit): (&'static [&'static str], _) = match (frame.format, packet) {
            (abi::FORMAT_GRAY8 | abi::FORMAT_GRAY16, _) => (&["value"], ""),
            (abi::FORMAT_BGR8 | abi::FORMAT_RGBA8, _) => (&["red", "green", "blue"], ""),
            (abi::FORMAT_CLOUD, _) => (&["x", "y", "z"], "mm"),
            (abi::FORMAT_F32, "disparity") => (&["disparity"], "px"),
            (abi::FORMAT_F32, "depth") => (&["depth"], "mm"),
            (abi::FORMAT_F32, _) => (&["value"], ""),
            _ => return None,
        };
        let (width, height, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
        let pixel = format::pixel_bytes(frame.format);
        let need = format::image_bytes(width, height, stride, pixel);
        let fits = pixel > 0 && width > 0 && height > 0 && need.is_some_and(|need| need <= bytes.len());
        fits.then_some(Self { bytes, width, height, stride, pixel, format: frame.format, channels, unit })
    }

    /// Width and height, px.
    pub(crate) fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// All values of the first channel, row after row.
    pub(crate) fn first_channel(&self) -> Vec<f32> {
        self.each(|x, y| self.value(x, y, 0))
    }

    /// Luma of all pixels, 0..=255, row after row; `None` for what is no image of light.
    pub(crate) fn luma(&self) -> Option<Vec<f32>> {
        match self.format {
            abi::FORMAT_GRAY8 => Some(self.first_channel()),
            abi::FORMAT_GRAY16 => Some(self.each(|x, y| self.value(x, y, 0) / 257.0)),
            abi::FORMAT_BGR8 | abi::FORMAT_RGBA8 => {
                let weights = [0.299, 0.587, 0.114];
                Some(self.each(|x, y| (0..3).map(|channel| weights[channel] * self.value(x, y, channel)).sum()))
            }
            _ => None,
        }
    }

    fn each(&self, value: impl Fn(usize, usize) -> f32) -> Vec<f32> {
        (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect()
    }

    /// The value of a channel. A coordinate outside is that of the nearest edge.
    fn value(&self, x: usize, y: usize, channel: usize) -> f32 {
        let (x, y) = (x.min(self.width - 1), y.min(self.height - 1));
        let pixel = &self.bytes[y * self.stride + x * self.pixel..][..self.pixel];
        let float = |at: usize| f32::from_le_bytes([pixel[at], pixel[at + 1], pixel[at + 2], pixel[at + 3]]);
        match self.format {
            abi::FORMAT_GRAY8 => f32::from(pixel[0]),
            abi::FORMAT_GRAY16 => f32::from(u16::from_le_bytes([pixel[0], pixel[1]])),
            abi::FORMAT_BGR8 => f32::from(pixel[2 - channel]),
            abi::FORMAT_RGBA8 => f32::from(pixel[channel]),
            // A guess is no value.
            abi::FORMAT_CLOUD if pixel[offset_of!(abi::CloudPoint, filled)] != 0 => f32::NAN,
            abi::FORMAT_CLOUD => float(
                [
                    offset_of!(abi::CloudPoint, x_mm),
                    offset_of!(abi::CloudPoint, y_mm),
                    offset_of!(abi::CloudPoint, z_mm),
                ][channel],
            ),
            _ => float(0),
        }
    }

    fn sample(&self, [u, v]: [f32; 2]) -> Option<Sample> {
        let inside = (0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v);
        let px = (
            ((u * self.width as f32) as usize).min(self.width - 1),
            ((v * self.height as f32) as usize).min(self.height - 1),
        );
        let values = || (0..self.channels.len()).map(|channel| self.value(px.0, px.1, channel)).collect();
        inside.then(|| Sample { px, values: values() })
    }

    fn profile(&self, line: [[f32; 2]; 2]) -> Option<Profile> {
        if line.iter().flatten().any(|share| !(0.0..=1.0).contains(share)) {
            return None;
        }
        let [a, b] = line.map(|[u, v]| [u * self.width as f32, v * self.height as f32]);
        let length_px = (b[0] - a[0]).hypot(b[1] - a[1]);
        let count = (length_px.ceil() as usize + 1).clamp(2, MAX_SAMPLES);
        let value = |k: usize, channel: usize| {
            let share = k as f32 / (count - 1) as f32;
            let at = [0, 1].map(|axis| (a[axis] + (b[axis] - a[axis]) * share) as usize);
            self.value(at[0], at[1], channel)
        };
        let values = (0..self.channels.len()).map(|channel| (0..count).map(|k| value(k, channel)).collect());
        Some(Profile { length_px, values: values.collect() })
    }

    fn histogram(&self, channel: usize) -> Histogram {
        let step = ((self.width * self.height).div_ceil(MAX_COUNTED) as f64).sqrt().ceil().max(1.0) as usize;
        let rows = (0..self.height).step_by(step);
        let all = rows.flat_map(|y| (0..self.width).step_by(step).map(move |x| self.value(x, y, channel)));
        let (mut known, mut unknown) = (Vec::new(), 0usize);
        for value in all {
            if value.is_finite() { known.push(value) } else { unknown += 1 }
        }
        let mut histogram = Histogram { bars: vec![0; BARS], ..Histogram::default() };
        histogram.unknown = unknown as f32 / (known.len() + unknown).max(1) as f32;
        let low = known.iter().copied().fold(f32::INFINITY, f32::min);
        let high = known.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        if known.is_empty() {
            return Histogram { range: (0.0, 0.0), ..histogram };
        }
        histogram.range = (low, high);
        histogram.mean = (known.iter().map(|value| f64::from(*value)).sum::<f64>() / known.len() as f64) as f32;
        let scale = BARS as f64 / f64::from(high - low).max(f64::MIN_POSITIVE);
        for value in known {
            let bar = (f64::from(value - low) * scale) as usize;
            histogram.bars[bar.min(BARS - 1)] += 1;
        }
        histogram
    }
}

/// Reads the values of a packet; `None` for what is not a picture. The histogram of a cloud is that of its depths.
pub fn read(frame: &abi::Frame, bytes: &[u8], packet: &str, request: &ProbeRequest) -> Option<Probe> {
    let layout = Layout::of(frame, bytes, packet)?;
    let counted = if frame.format == abi::FORMAT_CLOUD { 2..3 } else { 0..layout.channels.len() };
    Some(Probe {
        seq: frame.tick.seq,
        size: (layout.width, layout.height),
        channels: layout.channels,
        unit: layout.unit,
        at: request.at.and_then(|at| layout.sample(at)),
        histograms: counted.map(|channel| layout.histogram(channel)).collect(),
        profile: request.line.and_then(|line| layout.profile(line)),
        is_thinned: false,
    })
}

impl Probe {
    /// The same with positions and lengths in px of the picture before it was thinned.
    pub fn of_thinned(mut self, size: (usize, usize)) -> Self {
        let (width, height) = self.size;
        if size == self.size || width == 0 || height == 0 {
            return self;
        }
        let scale = [size.0 as f32 / width as f32, size.1 as f32 / height as f32];
        if let Some(sample) = &mut self.at {
            let place = |px: usize, scale: f32| ((px as f32 + 0.5) * scale) as usize;
            sample.px = (place(sample.px.0, scale[0]), place(sample.px.1, scale[1]));
        }
        if let Some(profile) = &mut self.profile {
            // Both sides are thinned alike.
            profile.length_px *= scale[0];
        }
        (self.size, self.is_thinned) = (size, true);
        self
    }

    /// The value of the requested point, such as `320, 240 px: depth 83.2 mm`.
    pub fn words(&self) -> Option<String> {
        let sample = self.at.as_ref()?;
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        let one = |(name, value): (&&str, &f32)| match value.is_finite() {
            true => format!("{name} {}{unit}", exact(*value)),
            false => format!("{name} unknown"),
        };
        let values: Vec<String> = self.channels.iter().zip(&sample.values).map(one).collect();
        let thinned = if self.is_thinned { ", thinned on the way" } else { "" };
        Some(format!("{}, {} px: {}{thinned}", sample.px.0, sample.px.1, values.join(", ")))
    }
}

/// A value: whole where it is, else with at most three digits behind the point.
fn exact(value: f32) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(format: u32, width: u32, height: u32, stride_bytes: u32) -> abi::Frame {
        abi::Frame { format, width, height, stride_bytes, ..abi::Frame::EMPTY }
    }

    #[test]
    fn a_depth_has_values_with_their_unit_and_unknown_pixels() {
        let bytes: Vec<u8> =
            (0..8 * 4).flat_map(|i| if i == 9 { f32::NAN } else { i as f32 * 0.5 }.to_le_bytes()).collect();
        let at = |u: f32, v: f32| {
            let request = ProbeRequest { at: Some([u, v]), line: None };
            read(&frame(abi::FORMAT_F32, 8, 4, 32), &bytes, "depth", &request).expect("a picture")
        };
        assert_eq!(at(0.3, 0.3).words().as_deref(), Some("2, 1 px: depth 5 mm"));
        assert_eq!(at(1.5 / 8.0, 1.5 / 4.0).words().as_deref(), Some("1, 1 px: depth unknown"));
        assert_eq!(at(1.0, 1.0).words().as_deref(), Some("7, 3 px: depth 15.5 mm"), "the last pixel");
        assert_eq!(at(1.2, 0.5).at, None, "outside");
        let histogram = &at(0.0, 0.0).histograms[0];
        assert_eq!(histogram.range, (0.0, 15.5));
        assert_eq!(histogram.bars.iter().sum::<u32>(), 31);
        assert!((histogram.unknown - 1.0 / 32.0).abs() < 1e-6);
        assert!((histogram.mean - (31.0 * 32.0 / 2.0 - 9.0) * 0.5 / 31.0).abs() < 1e-4, "{}", histogram.mean);
    }

    #[test]
    fn a_line_has_the_values_along_it() {
        let bytes: Vec<u8> = (0..10u8).flat_map(|x| [x, 0, 2 * x]).collect();
        let request = ProbeRequest { at: None, line: Some([[0.0, 0.5], [1.0, 0.5]]) };
        let probe = read(&frame(abi::FORMAT_BGR8, 10, 1, 30), &bytes, "image", &request).expect("a picture");
        let profile = probe.profile.expect("a line");
        assert_eq!(profile.length_px, 10.0);
        assert_eq!(profile.values[0], [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 18.0], "red");
        assert_eq!(profile.values[2][9], 9.0, "blue");
        assert_eq!((probe.channels.len(), probe.histograms.len()), (3, 3));
    }

    #[test]
    fn positions_on_a_thinned_picture_are_those_of_the_whole_one() {
        let bytes: Vec<u8> = (0..8 * 4).collect();
        let request = ProbeRequest { at: Some([0.3, 0.3]), line: Some([[0.0, 0.5], [0.5, 0.5]]) };
        let probe = read(&frame(abi::FORMAT_GRAY8, 8, 4, 8), &bytes, "image", &request).expect("a picture");
        assert_eq!(probe.clone().of_thinned((8, 4)), probe, "all of it came");
        let probe = probe.of_thinned((32, 16));
        assert_eq!(probe.words().as_deref(), Some("10, 6 px: value 10, thinned on the way"));
        assert_eq!(probe.profile.expect("a line").length_px, 16.0);
    }

    #[test]
    fn wrong_descriptions_have_no_values() {
        let request = ProbeRequest { at: Some([0.5, 0.5]), line: Some([[0.0, 0.0], [1.0, f32::NAN]]) };
        assert_eq!(read(&frame(abi::FORMAT_BGR8, 10, 100, 30), &[0; 30], "image", &request), None);
        assert_eq!(read(&frame(abi::FORMAT_BYTES, 1, 1, 1), &[0; 30], "table", &request), None);
        let probe = read(&frame(abi::FORMAT_GRAY16, 5, 1, 10), &[1; 10], "image", &request).expect("a picture");
        assert_eq!(probe.at.expect("a point").values, [257.0]);
        assert_eq!(probe.profile, None, "an end that is not a number");
    }
}
