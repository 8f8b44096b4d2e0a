//! The thread that encodes the newest frame.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use gstreamer::Fraction;
use panoscope_media::{Encoder, EncoderSettings, Framing, MediaError, VideoCodec};
use panoscope_node::{AnyImage, Context, NodeError, Result};

use super::fanout::Fanout;
use crate::picture::pixels_of;

/// Frame rate for which a bit rate is stated, Hz.
const NOMINAL_HZ: i32 = 30;

#[derive(Default)]
struct Mailbox {
    picture: Option<(Vec<u8>, (usize, usize))>,
    /// A buffer to fill with the next frame.
    spare: Vec<u8>,
    error: Option<String>,
    stop: bool,
}

#[derive(Default)]
struct Shared {
    mailbox: Mutex<Mailbox>,
    changed: Condvar,
    fanout: Arc<Fanout>,
}

impl Shared {
    fn lock(&self) -> std::sync::MutexGuard<'_, Mailbox> {
        self.mailbox.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Encodes frames on a separate thread.
pub struct Worker {
    shared: Arc<Shared>,
    /// The next frame, blue, green and red bytes.
    bgr: Vec<u8>,
    thread: Option<JoinHandle<()>>,
}

/// Why the encoder stopped.
#[derive(Debug, thiserror::Error)]
#[error("the stream's encoder failed: {0}")]
pub struct EncodeError(String);

impl Worker {
    /// Starts the thread.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn start(codec: VideoCodec, key_interval: u32) -> std::io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let own = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("stream-encode".to_owned()).spawn(move || {
            if let Err(error) = run(&own, codec, key_interval) {
                own.lock().error = Some(error.to_string());
            }
            own.fanout.end();
        })?;
        Ok(Self { shared, bgr: Vec::new(), thread: Some(thread) })
    }

    /// The receivers of the packets.
    pub fn fanout(&self) -> &Arc<Fanout> {
        &self.shared.fanout
    }

    /// Replaces the waiting frame while somebody receives the stream.
    ///
    /// # Errors
    /// Encoding has stopped, or the image is not one of 8 bits.
    pub fn show(&mut self, image: &AnyImage<'_>) -> Result<()> {
        self.check()?;
        if !self.fanout().has_consumers() {
            return Ok(());
        }
        let Some(pixels) = pixels_of(image) else {
            return Err(NodeError::new("the image has an unknown pixel format"));
        };
        if !pixels.to_bgr(&mut self.bgr) {
            let name = pixels.name();
            return Err(NodeError::new(format!(
                "a stream needs 8-bit images, but {name} arrived: put a `colorize` node in front"
            )));
        }
        let bgr = std::mem::take(&mut self.bgr);
        self.bgr = self.offer(bgr, pixels.size());
        Ok(())
    }

    /// Reports the counts of a stream; `audience` names the metric of those who receive it.
    pub fn report(&self, cx: &Context<'_>, audience: &str) {
        let counts = self.fanout().counts();
        cx.metric(audience, counts.consumers as f64);
        cx.metric("frames", counts.encoded as f64);
        cx.metric("replaced", counts.replaced as f64);
        cx.metric("held_back", counts.held_back as f64);
    }

    /// Replaces the waiting frame. Returns a buffer to fill with the next one. `bgr`: rows without padding.
    fn offer(&self, bgr: Vec<u8>, size_px: (usize, usize)) -> Vec<u8> {
        let mut mailbox = self.shared.lock();
        let waiting = mailbox.picture.replace((bgr, size_px));
        let spare = match waiting {
            Some((old, _)) => {
                self.shared.fanout.count_replaced();
                old
            }
            None => std::mem::take(&mut mailbox.spare),
        };
        drop(mailbox);
        self.shared.changed.notify_one();
        spare
    }

    /// # Errors
    /// Encoding has stopped.
    pub fn check(&self) -> Result<(), EncodeError> {
        self.shared.lock().error.clone().map_or(Ok(()), |error| Err(EncodeError(error)))
    }

    /// Encodes the waiting frame, ends the stream and joins the thread.
    pub fn stop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.changed.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic was printed when it happened.
            let _ = thread.join();
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.stop();
    }
}

fn run(shared: &Shared, codec: VideoCodec, key_interval: u32) -> Result<(), MediaError> {
    let begin = Instant::now();
    let mut current: Option<(Encoder, (usize, usize))> = None;
    loop {
        let mut mailbox = shared.lock();
        while mailbox.picture.is_none() && !mailbox.stop {
            mailbox = shared.changed.wait(mailbox).unwrap_or_else(PoisonError::into_inner);
        }
        let Some((bgr, size_px)) = mailbox.picture.take() else { return Ok(()) };
        drop(mailbox);
        let encoder = match &mut current {
            Some((encoder, encoded_px)) if *encoded_px == size_px => encoder,
            // Pictures of another size begin with a key frame, which says so.
            _ => {
                let settings = EncoderSettings {
                    codec,
                    framing: Framing::StartCodes,
                    size_px,
                    rate_hz: Fraction::new(NOMINAL_HZ, 1),
                    key_interval,
                };
                &mut current.insert((Encoder::new(settings)?, size_px)).0
            }
        };
        if shared.fanout.wants_key() {
            encoder.force_key();
        }
        let time_ns = u64::try_from(begin.elapsed().as_nanos()).unwrap_or(u64::MAX);
        let packets = encoder.encode(&bgr, size_px, time_ns)?;
        shared.fanout.count_encoded();
        if let Some(caps) = encoder.caps() {
            packets.iter().for_each(|packet| shared.fanout.send(&caps, packet));
        }
        shared.lock().spare = bgr;
    }
}
