//! `webrtc`: shows its input as live video in web browsers.

mod host;
mod room;
mod server;
mod viewer;

use std::net::IpAddr;

use panoscope_media::{RateControl, VideoCodec};
use panoscope_node::{
    AnyImage, Context, Finish, NoPorts, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Validation,
};

use crate::picture::pixels_of;
use crate::serving::path_problem;
use crate::stream::worker::Worker;
use room::Room;
use server::Mount;

/// Input ports of `webrtc`.
#[derive(Ports)]
pub struct In<'f> {
    /// Frames to send: bgr8, gray8 or rgba8.
    pub image: AnyImage<'f>,
}

/// Parameters of `webrtc`.
#[derive(Params)]
pub struct Settings {
    /// Address of this machine to listen on. 127.0.0.1 serves only programs on this machine. 0.0.0.0 listens on all networks. There is no password:
    /// anybody who reaches the port sees the video.
    #[param(default = "127.0.0.1", reopen)]
    pub address: String,
    /// TCP port of the page, http://ADDRESS:PORT/PATH. 0 takes a free port, which the log names. The video itself uses a free UDP port for each
    /// viewer. Several `webrtc` nodes share a port with different paths.
    #[param(default = 8889, range = 0..=65535, reopen)]
    pub port: u16,
    /// Path of the page, which is also the WHEP endpoint for players.
    #[param(default = "/live", reopen)]
    pub path: String,
    /// Bit rate at 30 frames per second.
    #[param(default = 4000, range = 50..=100000, unit = "kbit/s", reopen)]
    pub bitrate: u32,
    /// Distance of keyframes. A viewer that joins or has lost a packet gets one at once.
    #[param(default = 300, range = 1..=1000, unit = "frames", reopen)]
    pub key_interval: u32,
}

impl Settings {
    fn codec(&self) -> VideoCodec {
        VideoCodec::H264Baseline { rate: RateControl::Kbits(self.bitrate) }
    }

    fn address(&self) -> Option<IpAddr> {
        self.address.parse().ok()
    }

    /// Each wrong parameter, with what is wrong and what to write.
    fn mistakes(&self) -> Vec<(&'static str, String, &'static str)> {
        let mut mistakes = Vec::new();
        if self.address().is_none() {
            let help = "write 127.0.0.1, 0.0.0.0 or the address of a network card";
            mistakes.push(("address", format!("`{}` is not an IP address", self.address), help));
        }
        if let Some(problem) = path_problem(&self.path) {
            let help = "write letters, digits, `-`, `_`, `.` and `/`, such as `/wide`";
            mistakes.push(("path", format!("`{}` is not a valid path of a stream: {problem}", self.path), help));
        }
        mistakes
    }
}

/// Sends the newest frame to browsers. The graph never waits for the network or the encoder: a frame that arrives while the previous one is still
/// being encoded replaces any waiting frame. Viewers can only watch.
pub struct WebRtc {
    /// Dropped before the worker, so that no viewer joins a stream that ends.
    mount: Option<Mount>,
    worker: Worker,
    bgr: Vec<u8>,
}

impl Node for WebRtc {
    const INFO: NodeInfo =
        NodeInfo::compute("webrtc", "sink", "Serves its input as live video to web browsers (WebRTC).")
            .side_effects()
            .exclusive();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        for (param, message, help) in params.mistakes() {
            check.error(param, message, help);
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        if let Some((param, message, help)) = params.mistakes().into_iter().next() {
            return Err(NodeError::new(format!("`{param}`: {message}; {help}")));
        }
        let address = params.address().ok_or_else(|| NodeError::new("`address` is not an IP address"))?;
        params.codec().check()?;
        viewer::check()?;
        let worker = Worker::start(params.codec(), params.key_interval)?;
        let room = Room::new(open.node_id(), worker.fanout());
        let mount = Mount::new(address, params.port, &params.path, room)?;
        open.info(&format!("serves {}", mount.url()));
        Ok(Self { mount: Some(mount), worker, bgr: Vec::new() })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, _: &Settings) -> Result<()> {
        if let Some(error) = self.worker.error() {
            return Err(error.into());
        }
        let fanout = self.worker.fanout();
        if fanout.has_consumers() {
            let Some(pixels) = pixels_of(&input.image) else {
                return Err(NodeError::new("the image has an unknown pixel format"));
            };
            if !pixels.to_bgr(&mut self.bgr) {
                let name = pixels.name();
                return Err(NodeError::new(format!(
                    "a stream needs 8-bit images, but {name} arrived: put a `colorize` node in front"
                )));
            }
            self.bgr = self.worker.offer(std::mem::take(&mut self.bgr), pixels.size());
        }
        if let Some(mount) = &self.mount {
            cx.metric("port", f64::from(mount.port()));
        }
        let counts = fanout.counts();
        cx.metric("viewers", counts.consumers as f64);
        cx.metric("frames", counts.encoded as f64);
        cx.metric("replaced", counts.replaced as f64);
        cx.metric("held_back", counts.held_back as f64);
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        self.mount = None;
        self.worker.stop();
        match self.worker.error() {
            Some(error) => Err(error.into()),
            None => Ok(()),
        }
    }
}
