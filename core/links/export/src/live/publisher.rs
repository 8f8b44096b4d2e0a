//! The thread that turns previews into messages.

use std::io;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::foxglove::{Message, Messages, Origin, Pictures, encode};
use crate::{Kind, Value};
use foxglove::PartialMetadata;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::sync::lock;

use crate::live::outputs::Output;

/// Time between two polls of previews; short enough for 200 frames per second.
const STEP: Duration = Duration::from_millis(5);
/// Time between two polls without a subscriber.
const IDLE: Duration = Duration::from_millis(50);

/// Sends the messages of a packet to the channels of its output.
struct ToChannels<'o>(&'o Output);

impl Messages for ToChannels<'_> {
    fn put(&mut self, message: &Message<'_>) -> io::Result<()> {
        if let Some(channel) = self.0.channels.get(message.topic) {
            let metadata = PartialMetadata { log_time: Some(message.nanoseconds()) };
            channel.log_with_meta(message.data, metadata);
        }
        Ok(())
    }

    fn wants(&self, topic: &str) -> bool {
        self.0.channels.get(topic).is_some_and(|channel| channel.has_sinks())
    }

    fn pictures(&self) -> Pictures {
        Pictures::RawAndJpeg
    }
}

/// Publishes until `ends` is set.
pub fn run(outputs: &Mutex<Vec<Output>>, ends: &AtomicBool) {
    while !ends.load(Ordering::Relaxed) {
        let mut is_idle = true;
        let outputs = lock(outputs);
        for output in outputs.iter() {
            let Some(preview) = &output.preview else { continue };
            is_idle = false;
            if let Some(frame) = preview.take() {
                publish(output, &frame);
            }
        }
        drop(outputs);
        std::thread::sleep(if is_idle { IDLE } else { STEP });
    }
}

/// Publishes a packet. Damaged packets are skipped; the nodes that read them report them.
fn publish(output: &Output, frame: &FrameRef) {
    let head = frame.frame();
    // A port of images may change its format from packet to packet.
    let kind = match output.kind {
        Kind::Picture | Kind::Cloud => Kind::of(head.format, None),
        plain => Some(plain),
    };
    let Some(value) = kind.and_then(|kind| Value::read(kind, head, frame.bytes()).ok()) else { return };
    let (port, tick) = (output.name(), frame.tick());
    let origin = Origin { port: &port, packet: &output.packet, tick: &tick };
    // Channels refuse nothing; an encoder that fails leaves its message out.
    let _ = encode(&origin, value, &mut ToChannels(output));
}
