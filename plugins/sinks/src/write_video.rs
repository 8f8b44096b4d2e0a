//! `write_video`: frames as a video file.

mod codec;
mod timeline;
mod writer;

use std::path::PathBuf;
use std::thread::JoinHandle;

use panoscope_media::{MediaError, VideoCodec};
use panoscope_node::{
    AnyImage, Choice, Context, Finish, NoPorts, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Validation,
};

use crate::picture::pixels_of;
use crate::target::{check_name, check_path, claim};
pub use codec::Codec;
use codec::{ENDINGS, FileKind};
use writer::{Picture, VideoSettings, VideoWriter};

const EXAMPLE: &str = "video.mkv";

/// Timestamps of the frames of a video.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Time {
    /// Capture time of the frames. A replayed recording, or a slow machine, gives the same video.
    Capture,
    /// Time at which the node received them: the video plays at the speed of the live run.
    Passed,
}

/// Lag of an .avi video behind its input that gives a warning, ms.
const WARN_BEHIND_MS: f64 = 500.0;

/// Minimum width and height in .mp4, .mov and .avi, px: GStreamer's muxers refuse smaller frames.
const MIN_INDEXED_PX: usize = 16;

/// Input ports of `write_video`.
#[derive(Ports)]
pub struct In<'f> {
    /// Frames to write: bgr8, gray8 or rgba8.
    pub image: AnyImage<'f>,
}

/// Parameters of `write_video`.
#[derive(Params)]
pub struct Settings {
    /// File to write: .mkv, .webm, .mp4, .mov or .avi. .mkv and .webm survive a crash and play to the last frame; the others do not. A node that is
    /// reopened in the same run continues in .part2.mkv and so on.
    #[param(default = "out/video.mkv", reopen, writes)]
    pub path: PathBuf,
    /// Compression of the video. .mkv holds every codec.
    #[param(default = "mjpg", reopen)]
    pub codec: Codec,
    /// Constant frame rate, whatever the times of the frames. 0 gives each frame its own time, to the ms; in .avi the first two frames set the rate,
    /// and later ones are repeated if they are further apart.
    #[param(default = 0.0, range = 0.0..=1000.0, unit = "Hz", reopen)]
    pub fps: f64,
    /// Timestamps of the frames.
    #[param(default = "capture", reopen)]
    pub time: Time,
    /// Replaces the file of an earlier run; otherwise the video is written to the next .part file that does not exist.
    #[param(default = true, reopen)]
    pub replace: bool,
    /// Quality of `mjpg`, `mpeg4` and `vp8`. `mpeg4` and `vp8` use a new value from the next file on.
    #[param(default = 90, range = 1..=100, unit = "%")]
    pub quality: u8,
    /// Constant quality of `h264` and `hevc`, as the encoder's constant rate factor: 18 looks like the original, 23 is usual, 28 gives small files.
    #[param(default = 20, range = 1..=50, unit = "CRF", reopen)]
    pub crf: u8,
}

/// Loads GStreamer and the encoder. For `mjpg`, whose encoder comes with GStreamer, this happens in parallel with the start of the graph, which it
/// would delay. A missing encoder of another codec is reported when the node opens.
struct Preparation(Option<JoinHandle<Result<(), MediaError>>>);

impl Preparation {
    fn start(codec: VideoCodec) -> Result<Self> {
        if !matches!(codec, VideoCodec::Mjpeg { .. }) {
            codec.check()?;
            return Ok(Self(None));
        }
        let thread = std::thread::Builder::new().name("write_video-start".to_owned()).spawn(move || codec.check())?;
        Ok(Self(Some(thread)))
    }

    fn wait(self) -> Result<()> {
        match self.0.map(JoinHandle::join) {
            None | Some(Ok(Ok(()))) => Ok(()),
            Some(Ok(Err(error))) => Err(error.into()),
            Some(Err(_)) => Err(NodeError::new("the thread that loads the encoder panicked")),
        }
    }
}

/// Writes a video of the first frame's size; frames of other sizes are fitted into it with black borders.
pub struct WriteVideo {
    writer: VideoWriter,
    preparation: Option<Preparation>,
    bgr: Vec<u8>,
    /// Minimum width and height that the file can hold, px.
    min_px: usize,
    size_px: Option<(usize, usize)>,
    size_warned: bool,
    behind_warned: bool,
    frames: u64,
}

impl Node for WriteVideo {
    const INFO: NodeInfo = NodeInfo::blocking("write_video", "sink", "Writes frames as a video file.").side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        let Some(ending) = check_path(check, &params.path, EXAMPLE, ENDINGS) else { return };
        let is_held = FileKind::of(&ending).holds(params.codec);
        if !is_held {
            let message = format!("a .{ending} file cannot hold the chosen `codec`");
            check.error("codec", message, "write .mkv, which holds every codec");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let ending = check_name(&params.path, EXAMPLE, ENDINGS)?;
        let kind = FileKind::of(&ending);
        if matches!(kind, FileKind::Indexed(_)) {
            open.warn(&format!("a crash makes a .{ending} file unplayable: use .mkv, which survives it"));
        }
        claim(open, &params.path)?;
        let min_px = if matches!(kind, FileKind::Indexed(_)) { MIN_INDEXED_PX } else { 1 };
        let (path, codec) = (params.path.clone(), params.codec);
        let preparation = Preparation::start(codec.with(params.quality, params.crf))?;
        let settings = VideoSettings { path, kind, codec, fps: params.fps, crf: params.crf };
        Ok(Self {
            writer: VideoWriter::new(settings),
            preparation: Some(preparation),
            bgr: Vec::new(),
            min_px,
            size_px: None,
            size_warned: false,
            behind_warned: false,
            frames: 0,
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, params: &Settings) -> Result<()> {
        let Some(pixels) = pixels_of(&input.image) else {
            return Err(NodeError::new("the image has an unknown pixel format"));
        };
        let Some(bgr) = pixels.bgr(&mut self.bgr) else {
            let name = pixels.name();
            return Err(NodeError::new(format!(
                "a video needs 8-bit images, but {name} arrived: put a `colorize` node in front"
            )));
        };
        let size_px = pixels.size();
        let (width, height) = size_px;
        if self.size_px.is_none() && width.min(height) < self.min_px {
            let (min_px, path) = (self.min_px, params.path.display());
            return Err(NodeError::new(format!(
                "{path} cannot hold frames of {width}x{height} px, it needs at least {min_px}x{min_px}: write .mkv, or enlarge them"
            )));
        }
        let first = *self.size_px.get_or_insert(size_px);
        if size_px != first && !self.size_warned {
            self.size_warned = true;
            cx.warn(&format!(
                "frames changed from {}x{} to {}x{}: fitted into the first size with black borders",
                first.0, first.1, size_px.0, size_px.1
            ));
        }
        if let Some(preparation) = self.preparation.take() {
            preparation.wait()?;
        }
        let at_ns = match params.time {
            Time::Capture => cx.tick().capture_ns,
            Time::Passed => cx.clock_ns().unwrap_or(cx.tick().capture_ns),
        };
        let picture = Picture { bgr, size_px, at_ns, quality_pct: params.quality };
        self.writer.push(&picture, |path| {
            let file = cx.begin_file(path, params.replace)?;
            if file != path {
                cx.info(&format!("continues in {}", file.display()));
            }
            Ok(file)
        })?;
        if !self.behind_warned && self.writer.behind_ms() > WARN_BEHIND_MS {
            self.behind_warned = true;
            cx.warn(&format!(
                "frames arrive faster than the first two: {} plays too slowly; set `fps`, or write .mkv",
                self.writer.path().display()
            ));
        }
        self.frames += 1;
        cx.metric("frames", self.frames as f64);
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        Ok(self.writer.finish()?)
    }
}

impl Drop for WriteVideo {
    fn drop(&mut self) {
        if let Err(error) = self.writer.finish() {
            // `finish` was not called, and no running call can report the error.
            eprintln!("panoscope: write_video: {error}");
        }
    }
}
