//! Folders of images and videos, and the node that reads them.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app::AppSrc;
use panoscope_capture::capture::Capture;
use panoscope_node::Bgr8;
use panoscope_node::harness::{Harness, HarnessError, Level, Outputs, Setup};

pub const WIDTH: usize = 16;
pub const HEIGHT: usize = 8;
/// Time limit for anything a test waits for.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A separate folder, removed at the end.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("panoscope_capture_{name}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn image(&self, name: &str, value: u8, width: usize) {
        let rgb: Vec<u8> = (0..width * HEIGHT).flat_map(|i| [(i / width) as u8, (i % width) as u8, value]).collect();
        let picture = image::RgbImage::from_raw(width as u32, HEIGHT as u32, rgb).unwrap();
        let path = self.0.join(name);
        match path.extension().and_then(|ending| ending.to_str()) {
            Some("bmp") => fs::write(path, bmp(&picture)).unwrap(),
            Some("ppm") => {
                let head = format!("P6\n{width} {HEIGHT}\n255\n");
                fs::write(path, [head.as_bytes(), picture.as_raw()].concat()).unwrap();
            }
            _ => picture.save(path).unwrap(),
        }
    }

    pub fn try_open(&self, params: &str) -> Result<Harness<Capture>, HarnessError> {
        Harness::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&self.0).batch())
    }

    pub fn open(&self, params: &str) -> Harness<Capture> {
        self.try_open(params).unwrap()
    }

    pub fn refused(&self, params: &str) -> String {
        self.try_open(params).err().unwrap().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// First byte of an output's image.
pub fn value(out: &Outputs, port: &str) -> u8 {
    out.plane::<Bgr8>(port).unwrap().data[0]
}

pub fn drain(node: &mut Harness<Capture>) -> Vec<Outputs> {
    let mut all = Vec::new();
    loop {
        let out = node.process().unwrap();
        if out.ended() || all.len() > 1000 {
            return all;
        }
        all.push(out);
    }
}

/// Ticks up to and including the first failure.
pub fn drain_to_failure(node: &mut Harness<Capture>) -> (Vec<Outputs>, Option<String>) {
    let mut all = Vec::new();
    loop {
        match node.process() {
            Err(error) => return (all, Some(error.to_string())),
            Ok(out) if out.ended() || all.len() > 1000 => return (all, None),
            Ok(out) => all.push(out),
        }
    }
}

/// Calls the node until `wanted`; fails after [`PATIENCE`].
pub fn until(node: &mut Harness<Capture>, mut wanted: impl FnMut(&Outputs) -> bool) -> Result<Outputs, HarnessError> {
    let begin = Instant::now();
    loop {
        let out = node.process()?;
        if wanted(&out) {
            return Ok(out);
        }
        assert!(begin.elapsed() < PATIENCE, "{:?}", node.logs());
    }
}

/// Whether a warning contains `words`.
pub fn warned(node: &Harness<Capture>, words: &str) -> bool {
    node.logs().iter().any(|line| line.level == Level::Warn && line.message.contains(words))
}

/// Motion JPEG: frame `i` is gray `20 i`.
pub fn write_video(path: &Path, frames: u8) {
    write_video_at(path, 20.0, (0..frames).map(|index| index.wrapping_mul(20)));
}

/// Motion JPEG with frames of these grays.
pub fn write_video_at(path: &Path, fps: f64, grays: impl Iterator<Item = u8>) {
    let frames = grays.map(|gray| vec![gray; 64 * 48 * 3]);
    encode(path, fps, (64, 48), "jpegenc ! avimux", frames.enumerate());
}

/// A bitmap of 24 bits.
fn bmp(picture: &image::RgbImage) -> Vec<u8> {
    let (width, height) = picture.dimensions();
    let stride = (3 * width).next_multiple_of(4);
    let mut bytes = b"BM".to_vec();
    bytes.extend((54 + stride * height).to_le_bytes());
    for word in [0, 54, 40, width, height, 1 | 24 << 16, 0, stride * height, 0, 0, 0, 0] {
        bytes.extend(word.to_le_bytes());
    }
    for row in (0..height).rev() {
        let line = (0..width).flat_map(|x| {
            let [r, g, b] = picture.get_pixel(x, row).0;
            [b, g, r]
        });
        bytes.extend(line.chain(std::iter::repeat(0)).take(stride as usize));
    }
    bytes
}

/// Runs a pipeline to its end.
pub fn launch(text: &str) {
    panoscope_media::init().unwrap();
    finish(&gst::parse::launch(text).unwrap().downcast().unwrap(), || {});
}

fn finish(pipeline: &gst::Pipeline, feed: impl FnOnce()) {
    pipeline.set_state(gst::State::Playing).unwrap();
    feed();
    let kinds = [gst::MessageType::Eos, gst::MessageType::Error];
    let message = pipeline.bus().unwrap().timed_pop_filtered(gst::ClockTime::from_seconds(120), &kinds).unwrap();
    pipeline.set_state(gst::State::Null).unwrap();
    if let gst::MessageView::Error(error) = message.view() {
        panic!("{}: {:?}", error.error(), error.debug());
    }
}

/// A buffer of BGR pixels with its timestamp; `index` is the frame's position in the stream.
pub fn buffer(bgr: Vec<u8>, index: usize, fps: f64) -> gst::Buffer {
    let time = |index: usize| gst::ClockTime::from_nseconds((index as f64 * 1e9 / fps).round() as u64);
    let mut buffer = gst::Buffer::from_mut_slice(bgr);
    let fields = buffer.get_mut().unwrap();
    fields.set_pts(time(index));
    fields.set_duration(time(index + 1) - time(index));
    buffer
}

pub fn bgr_caps((width, height): (usize, usize), fps: f64) -> String {
    let rate = gst::Fraction::approximate_f64(fps).unwrap();
    format!("video/x-raw,format=BGR,width={width},height={height},framerate={}/{}", rate.numer(), rate.denom())
}

/// Writes BGR frames, each with its position in the stream, through the elements `encoder`.
pub fn encode(
    path: &Path,
    fps: f64,
    size: (usize, usize),
    encoder: &str,
    frames: impl Iterator<Item = (usize, Vec<u8>)>,
) {
    panoscope_media::init().unwrap();
    let caps = bgr_caps(size, fps);
    let text = format!(
        "appsrc name=frames format=time block=true max-buffers=4 caps={caps} ! videoconvert ! {encoder} ! filesink location={}",
        path.display()
    );
    let pipeline: gst::Pipeline = gst::parse::launch(&text).unwrap().downcast().unwrap();
    let source: AppSrc = pipeline.by_name("frames").unwrap().downcast().unwrap();
    finish(&pipeline, || {
        for (index, bgr) in frames {
            source.push_buffer(buffer(bgr, index, fps)).unwrap();
        }
        source.end_of_stream().unwrap();
    });
}

/// Rows of the number at the top of a [`scene`].
const NUMBER_ROWS: usize = 32;

/// BGR pixels of frame `number` of a stream: the number's 16 lower bits as black and white blocks, above a texture that moves with every frame.
pub fn scene(number: usize, (width, height): (usize, usize)) -> Vec<u8> {
    let mut bgr = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        for x in 0..width {
            let gray = if y < NUMBER_ROWS {
                if number >> (x * 16 / width) & 1 == 1 { 235 } else { 16 }
            } else {
                let cell = ((x + 5 * number) / 4).wrapping_mul(0x9E37) ^ ((y + 3 * number) / 4).wrapping_mul(0x85EB);
                60 + (cell.wrapping_mul(0x2545_F491) >> 12) % 120
            };
            bgr.extend([gray as u8; 3]);
        }
    }
    bgr
}

/// The number that is drawn into an image; `None` where a block is neither black nor white.
pub fn number(out: &Outputs, port: &str) -> Option<usize> {
    let plane = out.plane::<Bgr8>(port).unwrap();
    (0..16).try_fold(0, |sum, bit| {
        let x = (2 * bit + 1) * plane.width / 32;
        let rows = NUMBER_ROWS / 2 - 4..NUMBER_ROWS / 2 + 4;
        let values = rows.flat_map(|y| plane.row(y)[3 * (x - 2)..3 * (x + 3)].iter().map(|value| u32::from(*value)));
        match values.sum::<u32>() / (8 * 15) {
            0..=70 => Some(sum),
            180.. => Some(sum | 1 << bit),
            _ => None,
        }
    })
}
