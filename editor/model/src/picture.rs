//! Renders packets for display: pixels for images and maps, a text for other packets. Runs on the observer's thread.

use std::fmt::Write as _;
use std::mem::offset_of;
use std::sync::Arc;

use panoscope_abi as abi;
use panoscope_base::format;
use panoscope_base::packet::{self, Detections, PacketError, Table, decode};
use panoscope_engine::memory::FrameRef;
use panoscope_imaging::draw::Colormap;

use crate::content::{self, Content};
use crate::pixels::Pixels;
use crate::surface::{Cloud, DepthBuffer};

/// A packet rendered for display.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RenderedPacket {
    /// The image, for packets that have one.
    pub pixels: Option<Pixels>,
    /// Width and height of the packet itself in px.
    pub size: (usize, usize),
    /// The range of the colours; for packets without an image, their contents.
    pub text: String,
    /// Number of the tick.
    pub seq: u64,
    /// Capture time in ms of media time.
    pub capture_ms: f64,
    /// The tick.
    pub tick: abi::Tick,
    /// When its light arrived, in ns of the host's clock; negative for light from before the clock began.
    pub arrived_ns: Option<i64>,
    /// The numbers of a packet without an image.
    pub content: Content,
    /// For a surface: finds the point under a click.
    pub depth_buffer: Option<Arc<DepthBuffer>>,
    /// For a cloud: its points, if requested.
    pub cloud: Option<Arc<Cloud>>,
}

impl RenderedPacket {
    /// The fields that every packet has; the others are empty.
    pub fn of_tick(f: &abi::Frame) -> Self {
        Self {
            size: (f.width as usize, f.height as usize),
            seq: f.tick.seq,
            capture_ms: f.tick.capture_ns as f64 / 1e6,
            tick: f.tick,
            ..Self::default()
        }
    }
}

/// Range of a map's colours. It follows the values slowly, so that the colours do not flicker.
pub type Range = Option<(f32, f32)>;

/// Renders a packet of type `packet`, at most `max_width` pixels wide.
pub fn render(frame: &FrameRef, packet: &str, max_width: usize, range: &mut Range) -> RenderedPacket {
    let f = frame.frame();
    let mut rendered = RenderedPacket::of_tick(f);
    let bytes = frame.bytes();
    let sampled = Samples::new(f, bytes.len(), max_width);
    match (f.format, sampled) {
        (abi::FORMAT_GRAY8, Some(s)) => rendered.pixels = Some(s.averaged(bytes, 1, |p| [p[0], p[0], p[0]])),
        (abi::FORMAT_BGR8, Some(s)) => rendered.pixels = Some(s.averaged(bytes, 3, |p| [p[2], p[1], p[0]])),
        (abi::FORMAT_RGBA8, Some(s)) => rendered.pixels = Some(s.averaged(bytes, 4, |p| [p[0], p[1], p[2]])),
        (abi::FORMAT_GRAY16, Some(s)) => rendered.pixels = Some(s.averaged(bytes, 2, |p| [p[1]; 3])),
        (abi::FORMAT_CLOUD, Some(s)) => {
            let at = offset_of!(abi::CloudPoint, bgr);
            rendered.pixels = Some(s.averaged(bytes, 16, |p| [p[at + 2], p[at + 1], p[at]]));
        }
        (abi::FORMAT_F32, Some(s)) => {
            let values = s.numbers(bytes);
            let (low, high) = follow(&values, packet, range);
            rendered.text = format!("{} to {} {}", short(low.into()), short(high.into()), unit_of(packet));
            rendered.pixels = Some(s.coloured(&values, low, high));
        }
        _ => {
            rendered.text = describe(bytes, packet);
            rendered.content = content::read(bytes, packet);
        }
    }
    rendered
}

fn unit_of(packet: &str) -> &'static str {
    match packet {
        "disparity" => "px",
        "depth" => "mm",
        _ => "",
    }
}

/// The pixels of a frame that are sampled.
struct Samples {
    width: usize,
    height: usize,
    /// Frame pixels per shown pixel.
    step: usize,
    stride: usize,
    columns: usize,
    rows: usize,
}

impl Samples {
    /// `None` when the frame is not an image or its description does not fit its bytes.
    fn new(frame: &abi::Frame, len: usize, max_width: usize) -> Option<Self> {
        let (columns, rows, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
        let pixel = format::pixel_bytes(frame.format);
        let need = format::image_bytes(columns, rows, stride, pixel);
        let fits = pixel > 0 && columns > 0 && rows > 0 && need.is_some_and(|need| need <= len);
        let step = columns.div_ceil(max_width.max(1)).max(1);
        let (width, height) = (columns / step, (rows / step).max(1));
        (fits && width > 0).then_some(Self { width, height, step, stride, columns, rows })
    }

    /// Averages up to four pixels of each block.
    fn averaged(&self, bytes: &[u8], pixel: usize, rgb: impl Fn(&[u8]) -> [u8; 3]) -> Pixels {
        let mut rgba = vec![255; self.width * self.height * 4];
        let half = self.step / 2;
        for y in 0..self.height {
            for x in 0..self.width {
                let (left, top) = (x * self.step, y * self.step);
                let (right, bottom) = ((left + half).min(self.columns - 1), (top + half).min(self.rows - 1));
                let at = |x: usize, y: usize| rgb(&bytes[y * self.stride + x * pixel..][..pixel]);
                let out = &mut rgba[(y * self.width + x) * 4..][..3];
                if self.step == 1 {
                    out.copy_from_slice(&at(left, top));
                } else {
                    let four = [at(left, top), at(right, top), at(left, bottom), at(right, bottom)];
                    for k in 0..3 {
                        out[k] = (four.iter().map(|p| u32::from(p[k])).sum::<u32>() / 4) as u8;
                    }
                }
            }
        }
        Pixels { width: self.width, height: self.height, rgba }
    }

    fn numbers(&self, bytes: &[u8]) -> Vec<f32> {
        let mut values = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let at = y * self.step * self.stride + x * self.step * 4;
                values.push(f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]));
            }
        }
        values
    }

    fn coloured(&self, values: &[f32], low: f32, high: f32) -> Pixels {
        let table: Vec<[u8; 3]> = (0..=255).map(|i| Colormap::Viridian.at(i as f32 / 255.0)).collect();
        let unknown = Colormap::Viridian.at(f32::NAN);
        let scale = 255.0 / (high - low).max(1e-6);
        let mut rgba = Vec::with_capacity(values.len() * 4);
        for value in values {
            let [b, g, r] =
                if value.is_finite() { table[((value - low) * scale).clamp(0.0, 255.0) as usize] } else { unknown };
            rgba.extend_from_slice(&[r, g, b, 255]);
        }
        Pixels { width: self.width, height: self.height, rgba }
    }
}

/// Share of its width by which a range may miss the values and still follow them slowly; beyond that it is theirs at once.
const SLOW: f32 = 0.25;

/// The range between the 2nd and the 98th percentile, smoothed over frames.
fn follow(values: &[f32], packet: &str, range: &mut Range) -> (f32, f32) {
    if packet == "confidence" {
        return (0.0, 1.0);
    }
    let mut known: Vec<f32> = values.iter().step_by(7).copied().filter(|v| v.is_finite()).collect();
    if known.len() < 8 {
        return range.unwrap_or((0.0, 1.0));
    }
    known.sort_by(f32::total_cmp);
    let at = |share: f32| known[((known.len() - 1) as f32 * share) as usize];
    let (low, high) = (at(0.02), at(0.98));
    let new = match *range {
        Some((l, h)) if (l - low).abs().max((h - high).abs()) < SLOW * (h - l) => {
            (l + 0.1 * (low - l), h + 0.1 * (high - h))
        }
        _ => (low, high),
    };
    *range = Some(new);
    new
}

/// A number with three significant digits.
pub fn short(value: f64) -> String {
    let size = value.abs();
    match size {
        _ if !value.is_finite() => "unknown".to_owned(),
        _ if size >= 100.0 || size == 0.0 => format!("{value:.0}"),
        _ if size >= 10.0 => format!("{value:.1}"),
        _ if size >= 0.1 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

/// A description of a packet in a few short lines; the error's text when the packet does not fit its type.
fn describe(bytes: &[u8], packet: &str) -> String {
    try_describe(bytes, packet).unwrap_or_else(|error| error.to_string())
}

fn try_describe(bytes: &[u8], kind: &str) -> Result<String, PacketError> {
    let list = |values: &[f64]| values.iter().map(|value| short(*value)).collect::<Vec<_>>().join(", ");
    Ok(match kind {
        "homography" => {
            let homography: abi::Homography = decode(bytes)?;
            let state = match homography.state {
                abi::STATE_FRESH => "fresh",
                abi::STATE_HELD => "held",
                _ => "lost",
            };
            let [_, _, x, _, _, y, ..] = homography.left_from_right;
            let rms = short(homography.rms_px);
            format!("{state}, {} inliers\nrms {rms} px\nshift {}, {} px", homography.inliers, short(x), short(y))
        }
        "roi" => {
            let roi: abi::Roi = decode(bytes)?;
            format!("{} x {} px at {}, {}", roi.width, roi.height, roi.x, roi.y)
        }
        "calibration" => {
            let calibration: abi::Calibration = decode(bytes)?;
            format!("baseline {} mm\nleft fx {} px", short(calibration.baseline_mm), short(calibration.left.fx))
        }
        "detections" | "instances" => format!("{} found", Detections::parse(bytes)?.len()),
        "tip" => {
            let tip: abi::Tip = decode(bytes)?;
            format!("at {}, {} px\n{} mm", short(tip.u_px), short(tip.v_px), list(&tip.xyz_mm))
        }
        "pose" => {
            let pose: abi::Pose = decode(bytes)?;
            let (a, b) = (packet::name(&pose.a), packet::name(&pose.b));
            format!("{a} from {b}\n{} mm", list(&pose.a_from_b_mm))
        }
        "joints" => {
            let joints: abi::Joints = decode(bytes)?;
            let count = (joints.count as usize).min(abi::MAX_JOINTS);
            format!("{} rad", list(&joints.position_rad[..count]))
        }
        "scalar" => {
            let scalar: abi::Scalar = decode(bytes)?;
            let (name, unit) = (packet::name(&scalar.name), packet::name(&scalar.unit));
            format!("{name} {} {unit}", short(scalar.value))
        }
        "table" => table(&Table::parse(bytes)?),
        "text" => String::from_utf8_lossy(bytes).trim_end_matches('\0').chars().take(400).collect(),
        _ => format!("{} bytes", bytes.len()),
    })
}

/// The first rows of a table: of the first one each value behind the name of its column, so that values are seen in little space.
fn table(table: &Table<'_>) -> String {
    let (rows, columns) = (table.rows(), table.columns().min(12));
    let cells = |row: usize| (0..columns).filter_map(move |column| table.value(row, column)).map(short);
    let named: Vec<String> = table.names().zip(cells(0)).map(|(name, value)| format!("{name} {value}")).collect();
    let mut out = match rows {
        0 => format!("0 rows: {}", table.names().collect::<Vec<_>>().join(", ")),
        1 => String::new(),
        _ => format!("{rows} rows\n"),
    };
    out += &named.join(", ");
    for row in 1..rows.min(8) {
        let _ = write!(out, "\n{}", cells(row).collect::<Vec<_>>().join("  "));
    }
    out
}

/// Whether packets of this type can be shown as an image.
pub fn is_pictorial(packet: &str) -> bool {
    matches!(packet, "image" | "mask" | "disparity" | "confidence" | "depth" | "cloud")
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_engine::memory::memory;

    fn frame(format: u32, width: u32, height: u32, stride: u32, bytes: &[u8]) -> FrameRef {
        let (buffer, data) = memory().allocate(bytes.len()).unwrap();
        // SAFETY: `allocate` returned at least that many bytes, which nothing else refers to yet.
        unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), data, bytes.len()) };
        let (len, stride_bytes) = (bytes.len(), stride);
        let raw = abi::Frame { buffer, data, len, format, width, height, stride_bytes, ..abi::Frame::EMPTY };
        // SAFETY: `allocate` returned the buffer with one reference, which this frame takes over.
        unsafe { FrameRef::adopt(raw) }
    }

    #[test]
    fn blue_stays_blue_and_sizes_are_kept() {
        let bytes: Vec<u8> = [255, 10, 20].repeat(8 * 4);
        let rendered = render(&frame(abi::FORMAT_BGR8, 8, 4, 24, &bytes), "image", 4, &mut None);
        let pixels = rendered.pixels.unwrap();
        assert_eq!((pixels.width, pixels.height, rendered.size), (4, 2, (8, 4)));
        assert_eq!(&pixels.rgba[..4], [20, 10, 255, 255]);
    }

    #[test]
    fn the_colours_of_a_map_follow_slowly_and_jump_with_its_values() {
        let ramp =
            |low: f32, high: f32| -> Vec<f32> { (0..=700).map(|k| low + (high - low) * k as f32 / 700.0).collect() };
        let mut range = None;
        let (low, high) = follow(&ramp(28.0, 54.0), "disparity", &mut range);
        assert!((low - 28.5).abs() < 0.5 && (high - 53.5).abs() < 0.5, "{low} {high}");
        let (_, slow) = follow(&ramp(28.0, 56.0), "disparity", &mut range);
        assert!(slow > high && slow < high + 0.5, "it does not flicker: {slow}");
        let (low, high) = follow(&ramp(18.0, 42.0), "disparity", &mut range);
        assert!((low - 18.5).abs() < 0.5 && (high - 41.5).abs() < 0.5, "another scene has other colours: {low} {high}");
    }

    #[test]
    fn a_map_has_a_range_and_holes() {
        let values: Vec<u8> =
            (0..64 * 64).flat_map(|i| if i % 64 == 0 { f32::NAN } else { (i % 64) as f32 }.to_le_bytes()).collect();
        let rendered = render(&frame(abi::FORMAT_F32, 64, 64, 256, &values), "depth", 64, &mut None);
        assert!(rendered.text.ends_with(" mm"), "{}", rendered.text);
        let pixels = rendered.pixels.unwrap();
        assert_eq!(&pixels.rgba[..3], [48, 48, 48], "unknown");
        assert_ne!(&pixels.rgba[4..7], &pixels.rgba[4 * 63..4 * 63 + 3]);
    }

    #[test]
    fn wrong_descriptions_show_no_picture() {
        assert_eq!(render(&frame(abi::FORMAT_BGR8, 8, 400, 24, &[0; 64]), "image", 4, &mut None).pixels, None);
        assert_eq!(render(&frame(abi::FORMAT_BYTES, 0, 0, 0, &[0; 3]), "table", 4, &mut None).pixels, None);
    }

    #[test]
    fn descriptions_show_the_contents() {
        let mut bytes = vec![0; size_of::<abi::Roi>()];
        bytes[8..12].copy_from_slice(&120i32.to_le_bytes());
        assert_eq!(describe(&bytes, "roi"), "120 x 0 px at 0, 0");
        assert_eq!(describe(b"hello\0\0", "text"), "hello");
        // Values stand beside the names of their columns.
        let table = |rows: u32| {
            let mut bytes: Vec<u8> = [rows, 2, 8, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
            bytes.extend_from_slice(b"x mm\ny\0\0");
            bytes.extend((0..2 * rows).flat_map(|v| f64::from(v + 1).to_le_bytes()));
            describe(&bytes, "table")
        };
        assert_eq!(table(1), "x mm 1.00, y 2.00");
        assert_eq!(table(2), "2 rows\nx mm 1.00, y 2.00\n3.00  4.00");
        assert_eq!(table(0), "0 rows: x mm, y");
        assert_eq!(
            describe(&[0; 7], "roi"),
            "packet `roi` is truncated: field `y` ends at byte 8, but 7 bytes arrived"
        );
    }
}
