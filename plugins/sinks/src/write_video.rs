//! `write_video`: pictures as a video file.

mod codec;
mod encoder;
mod timeline;

use std::path::PathBuf;

use panoscope_node::{
    AnyImage, Choice, Context, Finish, NoPorts, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Validation,
};

use crate::picture::Pixels;
use crate::target::{check_name, check_path, claim};
pub use codec::Codec;
use encoder::{Encoder, Picture};

const EXAMPLE: &str = "video.mkv";
const ENDINGS: &str = "mkv, avi, mp4, mov, webm";

/// Which time the frames of a video have.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Time {
    /// Capture time of the pictures. A replayed recording, or a slow machine, gives the same video.
    Capture,
    /// Time at which the node received them: the video plays at the speed of the live run.
    Passed,
}

/// Lag of a video of constant rate behind its pictures that gives a warning, ms.
const WARN_BEHIND_MS: f64 = 500.0;

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Pictures to write: bgr8, gray8 or rgba8.
    pub image: AnyImage<'f>,
}

/// Parameters.
#[derive(Params)]
pub struct Settings {
    /// File to write. A .mkv file survives a crash; .avi and .mp4 do not. A node that is opened again in the same run continues in .part2.mkv and so
    /// on.
    #[param(default = "out/video.mkv", reopen, writes)]
    pub path: PathBuf,
    /// How the pictures are compressed.
    #[param(default = "mjpg", reopen)]
    pub codec: Codec,
    /// Frames per second, whatever the times of the pictures. 0 gives each picture its own time: exactly for `mjpg` in .mkv; for others the first two
    /// pictures set the rate, and later ones are repeated where they lie farther apart.
    #[param(default = 0.0, range = 0.0..=1000.0, unit = "Hz", reopen)]
    pub fps: f64,
    /// Time that the frames have.
    #[param(default = "capture", reopen)]
    pub time: Time,
    /// Replaces the file of an earlier run; otherwise the video is written to the next .part file that does not exist.
    #[param(default = true, reopen)]
    pub replace: bool,
    /// Quality of `mjpg` in .mkv.
    #[param(default = 90, range = 1..=100, unit = "%")]
    pub quality: i32,
}

/// Writes a video of the first picture's size; pictures of other sizes are fitted into it with black borders.
pub struct WriteVideo {
    encoder: Encoder,
    bgr: Vec<u8>,
    size: Option<(usize, usize)>,
    size_warned: bool,
    behind_warned: bool,
    frames: u64,
}

impl Node for WriteVideo {
    const INFO: NodeInfo = NodeInfo::blocking("write_video", "sink", "Writes pictures as a video file.").side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        let Some(ending) = check_path(check, &params.path, EXAMPLE, ENDINGS) else { return };
        let is_held = match ending.as_str() {
            "webm" => params.codec == Codec::Vp8,
            "mp4" => !matches!(params.codec, Codec::Vp8 | Codec::Ffv1),
            _ => true,
        };
        if !is_held {
            let message = format!("a .{ending} file cannot hold the chosen `codec`");
            check.error("codec", message, "write .mkv, which holds every codec");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let ending = check_name(&params.path, EXAMPLE, ENDINGS)?;
        if ending != "mkv" {
            open.warn(&format!("a crash leaves an unplayable .{ending} file: .mkv survives it"));
        }
        claim(open, &params.path)?;
        let encoder = Encoder::new(&params.path, &ending, params.codec, params.fps);
        Ok(Self { encoder, bgr: Vec::new(), size: None, size_warned: false, behind_warned: false, frames: 0 })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, params: &Settings) -> Result<()> {
        let Some(pixels) = Pixels::of(&input.image) else {
            return Err(NodeError::new("the image's format is unknown"));
        };
        if !pixels.to_bgr(&mut self.bgr) {
            let name = pixels.name();
            return Err(NodeError::new(format!(
                "a video holds 8-bit pictures, {name} arrived: put a `colorize` node in front"
            )));
        }
        let size = pixels.size();
        let first = *self.size.get_or_insert(size);
        if size != first {
            if !self.size_warned {
                self.size_warned = true;
                cx.warn(&format!(
                    "pictures changed from {}x{} to {}x{}: fitted onto the first size with black borders",
                    first.0, first.1, size.0, size.1
                ));
            }
            self.bgr = encoder::letterbox(&self.bgr, size, first)?;
        }
        let at_ns = match params.time {
            Time::Capture => cx.tick().capture_ns,
            Time::Passed => cx.clock_ns().unwrap_or(cx.tick().capture_ns),
        };
        let picture = Picture { bgr: &self.bgr, size: first, at_ns, quality: params.quality };
        self.encoder.push(&picture, |path| {
            let file = cx.begin_file(path, params.replace)?;
            if file != path {
                cx.info(&format!("continues in {}", file.display()));
            }
            Ok(file)
        })?;
        if !self.behind_warned && self.encoder.behind_ms() > WARN_BEHIND_MS {
            self.behind_warned = true;
            cx.warn(&format!(
                "pictures come faster than the first two: {} plays too slowly; give `fps`, or write mjpg into .mkv",
                self.encoder.path().display()
            ));
        }
        self.frames += 1;
        cx.metric("frames", self.frames as f64);
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        Ok(self.encoder.finish()?)
    }
}

impl Drop for WriteVideo {
    fn drop(&mut self) {
        if let Err(error) = self.encoder.finish() {
            // `finish` was not called, and no running call can report the error.
            eprintln!("panoscope: write_video: {error}");
        }
    }
}
