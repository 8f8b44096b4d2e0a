//! One encoder, many receivers: each gets packets from a keyframe on, and none waits for another.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use gstreamer::prelude::*;
use gstreamer::{Caps, State};
use gstreamer_app::AppSrc;
use panoscope_media::{MediaError, Packet, make};

use super::codec::StreamCodec;

/// Maximum number of packets that wait for a receiver. A receiver that is further behind gets no more until it has caught up, and then starts at a
/// keyframe.
const MAX_WAITING: u64 = 8;

/// How packets are carried in RTP.
#[derive(Clone, Copy, Debug)]
pub struct Payload {
    element: &'static str,
    options: &'static str,
}

impl Payload {
    /// The payload of a codec.
    pub fn of(codec: StreamCodec) -> Self {
        match codec {
            StreamCodec::H264 => {
                Self { element: "rtph264pay", options: "pt=96 config-interval=-1 aggregate-mode=zero-latency" }
            }
            StreamCodec::Hevc => {
                Self { element: "rtph265pay", options: "pt=96 config-interval=-1 aggregate-mode=zero-latency" }
            }
            StreamCodec::Mjpg => Self { element: "rtpjpegpay", options: "pt=26" },
        }
    }

    /// Creates the element once.
    ///
    /// # Errors
    /// The element is missing; the error names the package to install.
    pub fn check(self) -> Result<(), MediaError> {
        make(self.element).map(drop)
    }

    /// The element as part of a pipeline's text, with the name `name`.
    pub fn text(self, name: &str) -> String {
        format!("{} name={name} {}", self.element, self.options)
    }
}

/// Text of the element through which packets enter a pipeline.
pub const SOURCE: &str =
    "appsrc name=source is-live=true format=time do-timestamp=true max-buffers=0 max-bytes=0 max-time=0";

struct Consumer {
    id: u64,
    source: AppSrc,
    caps: Option<Caps>,
    /// Whether the receiver has no packet yet, or lost some: it can continue only at a keyframe.
    needs_key: bool,
}

impl Consumer {
    /// Whether it plays and is not too far behind. A pipeline that does not play yet stamps packets with a time that has no meaning: its sink would
    /// wait for hours before it sends the first one.
    fn can_take(&self) -> bool {
        self.source.current_state() == State::Playing && self.source.current_level_buffers() < MAX_WAITING
    }
}

/// The receivers of a stream's packets.
#[derive(Default)]
pub struct Fanout {
    consumers: Mutex<Vec<Consumer>>,
    count: AtomicUsize,
    next_id: AtomicU64,
    encoded: AtomicU64,
    replaced: AtomicU64,
    held_back: AtomicU64,
}

/// Counts since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of receivers now.
    pub consumers: usize,
    /// Number of frames that were encoded.
    pub encoded: u64,
    /// Number of frames that a newer one replaced before they were encoded.
    pub replaced: u64,
    /// Number of packets that a receiver did not get because it did not play yet or was too far behind.
    pub held_back: u64,
}

impl Fanout {
    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Consumer>> {
        self.consumers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a receiver, which starts at the next keyframe.
    pub fn add(&self, source: AppSrc) -> u64 {
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let mut consumers = self.lock();
        consumers.push(Consumer { id, source, caps: None, needs_key: true });
        self.count.store(consumers.len(), Ordering::Release);
        id
    }

    /// Removes a receiver.
    pub fn remove(&self, id: u64) {
        let mut consumers = self.lock();
        consumers.retain(|consumer| consumer.id != id);
        self.count.store(consumers.len(), Ordering::Release);
    }

    /// Makes a receiver restart at a keyframe, which it requested after a loss.
    pub fn ask_key(&self, id: u64) {
        for consumer in self.lock().iter_mut().filter(|consumer| consumer.id == id) {
            consumer.needs_key = true;
        }
    }

    /// Whether there is any receiver.
    pub fn has_consumers(&self) -> bool {
        self.count.load(Ordering::Acquire) > 0
    }

    /// Whether a receiver waits for a keyframe and could take it.
    pub fn wants_key(&self) -> bool {
        self.lock().iter().any(|consumer| consumer.needs_key && consumer.can_take())
    }

    /// Sends a packet to all receivers that can take it.
    pub fn send(&self, caps: &Caps, packet: &Packet) {
        for consumer in self.lock().iter_mut() {
            if !consumer.can_take() || consumer.needs_key && !packet.is_key() {
                consumer.needs_key = true;
                self.held_back.fetch_add(1, Ordering::Relaxed);
                continue;
            }
            if consumer.caps.as_ref() != Some(caps) {
                consumer.source.set_caps(Some(caps));
                consumer.caps = Some(caps.clone());
            }
            let mut buffer = packet.buffer.copy();
            // The pipeline of the receiver stamps it with its own time.
            let writable = buffer.make_mut();
            writable.set_pts(None);
            writable.set_dts(None);
            // Refused when the receiver is leaving: it is removed by its server.
            consumer.needs_key = consumer.source.push_buffer(buffer).is_err();
        }
    }

    /// Signals the end of the stream to all receivers.
    pub fn end(&self) {
        for consumer in self.lock().drain(..) {
            // A receiver that is leaving needs no end.
            let _ = consumer.source.end_of_stream();
        }
        self.count.store(0, Ordering::Release);
    }

    /// Counts an encoded frame.
    pub fn count_encoded(&self) {
        self.encoded.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts a frame that was replaced by a newer one.
    pub fn count_replaced(&self) {
        self.replaced.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts since the start.
    pub fn counts(&self) -> Counts {
        Counts {
            consumers: self.count.load(Ordering::Acquire),
            encoded: self.encoded.load(Ordering::Relaxed),
            replaced: self.replaced.load(Ordering::Relaxed),
            held_back: self.held_back.load(Ordering::Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use gstreamer::{Buffer, ClockTime, Pipeline, SystemClock};
    use gstreamer_app::AppSink;

    use super::*;

    /// The server of a stream gives a pipeline its clock a moment before it lets it play.
    #[test]
    fn a_receiver_with_a_clock_gets_nothing_until_it_plays() {
        gstreamer::init().unwrap();
        let pipeline = gstreamer::parse::launch(&format!("{SOURCE} ! appsink name=sink sync=false")).unwrap();
        let pipeline = pipeline.downcast::<Pipeline>().unwrap();
        let source = pipeline.by_name("source").unwrap().downcast::<AppSrc>().unwrap();
        let sink = pipeline.by_name("sink").unwrap().downcast::<AppSink>().unwrap();
        source.set_clock(Some(&SystemClock::obtain())).unwrap();
        pipeline.set_state(State::Paused).unwrap();
        let fanout = Fanout::default();
        fanout.add(source.clone());
        let caps = Caps::new_empty_simple("image/jpeg");
        let packet = Packet { buffer: Buffer::with_size(4).unwrap() };
        fanout.send(&caps, &packet);
        assert!(fanout.counts().held_back == 1 && !fanout.wants_key(), "{:?}", fanout.counts());
        pipeline.set_state(State::Playing).unwrap();
        assert_eq!(source.state(ClockTime::from_seconds(10)).1, State::Playing);
        assert!(fanout.wants_key());
        fanout.send(&caps, &packet);
        let sample = sink.try_pull_sample(ClockTime::from_seconds(10)).unwrap();
        let time = sample.buffer().unwrap().pts().unwrap();
        // The clock counts from the start of the machine, a receiver from its own.
        assert!(time < ClockTime::from_seconds(15), "{time}");
        pipeline.set_state(State::Null).unwrap();
    }
}
