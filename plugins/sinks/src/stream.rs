//! `stream`: sends its input as live video over the network.

mod clients;
mod codec;
pub(crate) mod fanout;
mod push;
mod server;
pub(crate) mod worker;

use panoscope_media::{RateControl, VideoCodec};
use panoscope_node::{
    AnyImage, Context, Finish, NoPorts, Node, NodeError, NodeInfo, Open, Params, Ports, Result, Validation,
};

use crate::serving::{Mistake, address_mistakes};
use codec::StreamCodec;
use push::{Push, Target};
use server::Mount;
use worker::Worker;

/// Input ports of `stream`.
#[derive(Ports)]
pub struct In<'f> {
    /// Frames to send: bgr8, gray8 or rgba8.
    pub image: AnyImage<'f>,
}

/// Parameters of `stream`.
#[derive(Params)]
pub struct Settings {
    /// Serves RTSP at rtsp://ADDRESS:PORT/PATH. Several `stream` nodes share a port with different paths.
    #[param(default = true, reopen)]
    pub serve: bool,
    /// Address of this machine to listen on. 127.0.0.1 serves only programs on this machine. 0.0.0.0 listens on all networks. There is no password:
    /// anybody who reaches the port sees the video.
    #[param(default = "127.0.0.1", reopen)]
    pub address: String,
    /// TCP port to listen on. 0 takes a free port, which the log names.
    #[param(default = 8554, range = 0..=65535, reopen)]
    pub port: u16,
    /// Path of the stream on its server.
    #[param(default = "/live", reopen)]
    pub path: String,
    /// Compression of the stream.
    #[param(default = "h264", reopen)]
    pub codec: StreamCodec,
    /// Bit rate of `h264` and `hevc` at 30 frames per second.
    #[param(default = 4000, range = 50..=100000, unit = "kbit/s", reopen)]
    pub bitrate: u32,
    /// Distance of keyframes of `h264` and `hevc`. A client that joins gets one at once; after a lost packet the image is complete again with the
    /// next one.
    #[param(default = 30, range = 1..=1000, unit = "frames", reopen)]
    pub key_interval: u32,
    /// Quality of `mjpg`.
    #[param(default = 80, range = 1..=100, unit = "%", reopen)]
    pub quality: u8,
    /// Additional address to send the stream to: rtsp://HOST:PORT/PATH, a server that accepts recordings, or udp://HOST:PORT, as RTP packets. Empty:
    /// none.
    #[param(default = "", reopen)]
    pub push: String,
}

impl Settings {
    fn codec(&self) -> VideoCodec {
        let rate = RateControl::Kbits(self.bitrate);
        match self.codec {
            StreamCodec::H264 => VideoCodec::H264 { rate },
            StreamCodec::Hevc => VideoCodec::Hevc { rate },
            StreamCodec::Mjpg => VideoCodec::Mjpeg { quality_pct: self.quality },
        }
    }

    /// Each wrong parameter, with what is wrong and what to write.
    fn mistakes(&self) -> Vec<Mistake> {
        let mut mistakes = if self.serve { address_mistakes(&self.address, &self.path) } else { Vec::new() };
        if !self.push.is_empty()
            && let Err(problem) = Target::parse(&self.push)
        {
            mistakes.push(("push", problem.to_string(), "write rtsp://HOST:PORT/PATH or udp://HOST:PORT"));
        }
        if !self.serve && self.push.is_empty() {
            let help = "set `serve = true`, or give an address in `push`";
            mistakes.push(("serve", "the stream has no destination".to_owned(), help));
        }
        mistakes
    }
}

/// Sends the newest frame. The graph never waits for the network or the encoder: a frame that arrives while the previous one is still being encoded
/// replaces any waiting frame.
pub struct Stream {
    /// Dropped before the worker, so that no client joins a stream that ends.
    mount: Option<Mount>,
    worker: Worker,
    push: Option<Push>,
    push_error: Option<String>,
}

impl Node for Stream {
    const INFO: NodeInfo =
        NodeInfo::compute("stream", "sink", "Serves its input as live video over RTSP, or sends it to a server.")
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
        let codec = params.codec();
        codec.check()?;
        let worker = Worker::start(codec, params.key_interval)?;
        let payload = fanout::Payload::of(params.codec);
        payload.check()?;
        let mut mount = None;
        if params.serve {
            let address = params.address.parse().map_err(|_| NodeError::new("`address` is not an IP address"))?;
            let served = Mount::new(address, params.port, &params.path, open.node_id(), payload, worker.fanout())?;
            open.info(&format!("serves {}", served.url()));
            mount = Some(served);
        }
        let mut push = None;
        if !params.push.is_empty() {
            let target = Target::parse(&params.push)?;
            push = Some(Push::start(target, payload, worker.fanout())?);
            open.info(&format!("sends to {}", params.push));
        }
        Ok(Self { worker, mount, push, push_error: None })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, _: &Settings) -> Result<()> {
        self.worker.check()?;
        if let Some(push) = &self.push {
            let error = push.error();
            if error != self.push_error {
                match &error {
                    Some(error) => cx.fault(error),
                    None => cx.info("the stream is being sent again"),
                }
                self.push_error = error;
            }
        }
        self.worker.show(&input.image)?;
        if let Some(mount) = &self.mount {
            cx.metric("port", f64::from(mount.port()));
        }
        self.worker.report(cx, "consumers");
        Ok(())
    }

    fn finish(&mut self, _: &Finish<'_>) -> Result<()> {
        self.mount = None;
        self.worker.stop();
        self.push = None;
        Ok(self.worker.check()?)
    }
}
