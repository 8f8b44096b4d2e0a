//! Writes packets to containers through GStreamer.

use std::path::Path;

use gstreamer::prelude::*;
use gstreamer::{Bus, Caps, ClockTime, Format, MessageType, MessageView, Pipeline, State};
use gstreamer_app::AppSrc;

use crate::elements::make;
use crate::{MediaError, Packet};

/// Maximum number of compressed bytes that wait for the disk; then a push waits.
const WAITING_BYTES: u64 = 8 << 20;

/// Duration of the only image of a file.
const FIRST_DURATION: ClockTime = ClockTime::from_mseconds(33);

/// Maximum wait for the end of a file, s; a slower disk counts as failed.
const END_WAIT_S: u64 = 120;

/// Containers with an index that is written at the end: a crash leaves them unplayable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// AVI: a constant frame rate.
    Avi,
    /// MP4.
    Mp4,
    /// QuickTime.
    Mov,
}

/// A file that is being written, in separate threads.
pub struct ContainerFile {
    pipeline: Pipeline,
    source: AppSrc,
    bus: Bus,
    /// The newest packet, whose duration follows from the next one.
    held: Option<Packet>,
    duration: ClockTime,
    has_failed: bool,
}

impl Container {
    /// Element that writes packets of `caps` into it.
    fn muxer(self, caps: &Caps) -> &'static str {
        let is_jpeg = caps.structure(0).is_some_and(|packets| packets.name() == "image/jpeg");
        match self {
            Self::Avi => "avimux",
            // MP4 itself has no JPEG; QuickTime files of that name are widely read.
            Self::Mp4 if !is_jpeg => "mp4mux",
            Self::Mp4 | Self::Mov => "qtmux",
        }
    }
}

impl ContainerFile {
    /// Creates the file for packets of `caps`.
    ///
    /// # Errors
    /// An element is missing or the file cannot be created.
    pub fn create(path: &Path, container: Container, caps: &Caps) -> Result<Self, MediaError> {
        let name = container.muxer(caps);
        let (muxer, file) = (make(name)?, make("filesink")?);
        file.set_property("location", path);
        // Written as it comes, not when it is due.
        file.set_property("sync", false);
        file.set_property("async", false);
        // A write that fails is reported with the picture that it belongs to. (And the element repeats its first buffer where the system writes only
        // a part of several.)
        file.set_property_from_str("buffer-mode", "unbuffered");
        let source = AppSrc::builder().caps(caps).format(Format::Time).max_bytes(WAITING_BYTES).block(true).build();
        let pipeline = Pipeline::new();
        let failed =
            |error: &dyn std::fmt::Display| MediaError::Encoder { encoder: name.to_owned(), reason: error.to_string() };
        pipeline.add_many([source.upcast_ref(), &muxer, &file]).map_err(|error| failed(&error))?;
        // Any other pad, for sound, would be linked as well.
        source.link_pads(None, &muxer, Some("video_%u")).map_err(|_| failed(&format!("it does not take {caps}")))?;
        muxer.link(&file).map_err(|error| failed(&error))?;
        let bus = pipeline.bus().ok_or_else(|| failed(&"the pipeline has no bus"))?;
        let file = Self { pipeline, source, bus, held: None, duration: FIRST_DURATION, has_failed: false };
        if file.pipeline.set_state(State::Playing).is_err() {
            return Err(file.bus_error().unwrap_or_else(|| failed(&"it does not start")));
        }
        Ok(file)
    }

    /// Appends a packet; times must increase. It is written when the next one arrives.
    ///
    /// # Errors
    /// The file could not be written, also of earlier packets.
    pub fn push(&mut self, packet: Packet) -> Result<(), MediaError> {
        let result = self.release(packet.buffer.pts());
        self.held = Some(packet);
        self.has_failed |= result.is_err();
        result
    }

    /// Passes the held packet to the muxer, with a duration until `next` or as long as the previous one.
    fn release(&mut self, next: Option<ClockTime>) -> Result<(), MediaError> {
        let Some(Packet { mut buffer }) = self.held.take() else { return Ok(()) };
        let time = buffer.pts();
        let until_next = next.zip(time).and_then(|(next, time)| next.checked_sub(time));
        self.duration = until_next.unwrap_or(self.duration);
        let writable = buffer.make_mut();
        writable.set_duration(self.duration);
        // Pictures are encoded in the order in which they are shown.
        writable.set_dts(time);
        let pushed = self.source.push_buffer(buffer);
        match (self.bus_error(), pushed) {
            (Some(error), _) => Err(error),
            (None, Err(error)) => Err(self.failure(&error.to_string())),
            (None, Ok(_)) => Ok(()),
        }
    }

    /// Writes the index. On return the file is written to the system, which may not have stored it on the disk yet.
    /// After an error of `push` no index is written.
    ///
    /// # Errors
    /// The file could not be written.
    pub fn finish(&mut self) -> Result<(), MediaError> {
        if self.has_failed {
            return Ok(());
        }
        self.release(None)?;
        // Refused only after an error, which is on the bus.
        let _ = self.source.end_of_stream();
        let ends = [MessageType::Eos, MessageType::Error];
        let end = self.bus.timed_pop_filtered(ClockTime::from_seconds(END_WAIT_S), &ends);
        let ended = match end.as_ref().map(|message| message.view()) {
            Some(MessageView::Eos(_)) => Ok(()),
            Some(MessageView::Error(error)) => Err(MediaError::from(error)),
            _ => Err(self.failure(&format!("the file was not completed within {END_WAIT_S} s"))),
        };
        // Closes the file, which may report a last error.
        let closed = self.pipeline.set_state(State::Null);
        ended?;
        closed.map(drop).map_err(|_| self.bus_error().unwrap_or_else(|| self.failure("the file could not be closed")))
    }

    fn failure(&self, reason: &str) -> MediaError {
        MediaError::Encoder { encoder: "filesink".to_owned(), reason: reason.to_owned() }
    }

    fn bus_error(&self) -> Option<MediaError> {
        self.bus.iter_filtered(&[MessageType::Error]).find_map(|message| match message.view() {
            MessageView::Error(error) => Some(MediaError::from(error)),
            _ => None,
        })
    }
}

impl Drop for ContainerFile {
    fn drop(&mut self) {
        // A file that was not finished stays without its index.
        let _ = self.pipeline.set_state(State::Null);
    }
}
