//! `webrtc`: shows its input as live video in web browsers.

mod host;
mod room;
mod server;
mod viewer;

use panoscope_media::{RateControl, VideoCodec};
use panoscope_node::{
    AnyImage, Context, Finish, NoPorts, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Validation,
};

use crate::serving::address_mistakes;
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
}

/// Sends the newest frame to browsers. The graph never waits for the network or the encoder: a frame that arrives while the previous one is still
/// being encoded replaces any waiting frame. Viewers can only watch.
pub struct WebRtc {
    /// Dropped before the worker, so that no viewer joins a stream that ends.
    mount: Option<Mount>,
    worker: Worker,
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
        for (param, message, help) in address_mistakes(&params.address, &params.path) {
            check.error(param, message, help);
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        if let Some((param, message, help)) = address_mistakes(&params.address, &params.path).into_iter().next() {
            return Err(NodeError::new(format!("`{param}`: {message}; {help}")));
        }
        let address = params.address.parse().map_err(|_| NodeError::new("`address` is not an IP address"))?;
        params.codec().check()?;
        viewer::check()?;
        let worker = Worker::start(params.codec(), params.key_interval)?;
        let room = Room::new(open.node_id(), worker.fanout());
        let mount = Mount::new(address, params.port, &params.path, room)?;
        open.info(&format!("serves {}", mount.url()));
        Ok(Self { mount: Some(mount), worker })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, _: &Settings) -> Result<()> {
        self.worker.show(&input.image)?;
        if let Some(mount) = &self.mount {
            cx.metric("port", f64::from(mount.port()));
        }
        self.worker.report(cx, "viewers");
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        self.mount = None;
        self.worker.stop();
        Ok(self.worker.check()?)
    }
}
