//! Images that carry their number, and a reader by GStreamer.

use std::fs;
use std::path::{Path, PathBuf};

use gstreamer::prelude::*;
use gstreamer::{ClockTime, Pipeline, State};
use gstreamer_app::AppSink;
use panoscope_node::Node;
use panoscope_node::harness::{Harness, Setup};

/// Number of bits that are drawn into an image.
const BITS: usize = 12;

/// A separate folder, removed at the end.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("panoscope_sinks_{name}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn open<N: Node>(&self, params: &str) -> Harness<N> {
        Harness::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&self.0)).unwrap()
    }

    /// Sorted names of its files.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(&self.0).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A BGR image with `number` as black and white columns in the upper half, and a pattern below that moves with it.
pub fn numbered((width, height): (usize, usize), number: u64) -> Vec<u8> {
    (0..width * height)
        .flat_map(|i| {
            let (x, y) = (i % width, i / width);
            if y < height / 2 {
                let bit = x * BITS / width;
                return [if number >> bit & 1 == 1 { 235 } else { 20 }; 3];
            }
            let shift = number as usize * 5;
            [(x * 200 / width) as u8, (y * 200 / height) as u8, ((x + y + shift) % 200) as u8]
        })
        .collect()
}

/// The number in an image, if every column is clearly black or white.
pub fn number_in(bgr: &[u8], (width, height): (usize, usize)) -> Option<u64> {
    let mut number = 0;
    for bit in 0..BITS {
        let (x, y) = ((2 * bit + 1) * width / (2 * BITS), height / 4);
        match bgr[(y * width + x) * 3 + 1] {
            0..=80 => {}
            175..=255 => number |= 1 << bit,
            _ => return None,
        }
    }
    Some(number)
}

/// A decoded frame.
pub struct Decoded {
    pub bgr: Vec<u8>,
    pub size_px: (usize, usize),
    pub time_ns: Option<u64>,
}

impl Decoded {
    pub fn of(sample: &gstreamer::Sample) -> Self {
        let info = gstreamer_video::VideoInfo::from_caps(sample.caps().unwrap()).unwrap();
        let (width, height) = (info.width() as usize, info.height() as usize);
        let buffer = sample.buffer().unwrap();
        let map = buffer.map_readable().unwrap();
        let stride = info.stride()[0] as usize;
        let bgr = (0..height).flat_map(|y| map[y * stride..][..width * 3].to_vec()).collect();
        Self { bgr, size_px: (width, height), time_ns: buffer.pts().map(ClockTime::nseconds) }
    }

    pub fn number(&self) -> Option<u64> {
        number_in(&self.bgr, self.size_px)
    }
}

/// Every frame of a file, decoded by GStreamer.
pub fn decode(path: &Path) -> Vec<Decoded> {
    gstreamer::init().unwrap();
    let text = "filesrc name=file ! decodebin ! videoconvert ! video/x-raw,format=BGR ! appsink name=sink sync=false";
    let pipeline = gstreamer::parse::launch(text).unwrap().downcast::<Pipeline>().unwrap();
    pipeline.by_name("file").unwrap().set_property("location", path);
    let sink = pipeline.by_name("sink").unwrap().downcast::<AppSink>().unwrap();
    pipeline.set_state(State::Playing).unwrap();
    let pictures = std::iter::from_fn(|| sink.pull_sample().ok()).map(|sample| Decoded::of(&sample)).collect();
    pipeline.set_state(State::Null).unwrap();
    pictures
}
