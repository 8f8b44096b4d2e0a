//! Frames of pictures that are shown again: a still picture, and files that are played round and round.

use std::sync::Arc;

use panoscope_node::{Bgr8, Rect, Result, Retained, Slot};

use crate::source::{Picture, Samples};

/// Most memory for frames that are shown again, in bytes; further pictures are copied each time.
const KEPT_BYTES: usize = 512 << 20;
/// Most of these frames; the host takes a node that retains 128 for one that leaks.
const KEPT_FRAMES: usize = 96;

/// A part of a picture as a frame.
struct Kept {
    /// Holds the pixels' memory, so that another picture has another address.
    pixels: Arc<Vec<u8>>,
    rect: Rect,
    frame: Retained<Bgr8>,
}

/// Frames of pictures whose source keeps them decoded.
#[derive(Default)]
pub struct KeptFrames {
    kept: Vec<Kept>,
    bytes: usize,
}

impl KeptFrames {
    /// Hands on the frame of `rect` of a picture, if there is one. Returns whether there was.
    ///
    /// # Errors
    /// Those of [`Slot::forward_anew`].
    pub fn forward(&self, picture: &Picture, rect: Rect, slot: &mut Slot<'_, Bgr8>) -> Result<bool> {
        let Samples::Eight(pixels) = &picture.samples else { return Ok(false) };
        let found = self.kept.iter().find(|kept| Arc::ptr_eq(&kept.pixels, pixels) && kept.rect == rect);
        found.map_or(Ok(false), |kept| slot.forward_anew(&kept.frame).map(|()| true))
    }

    /// Keeps the frame that was made of `rect` of a picture, where the source keeps the picture too.
    pub fn keep(&mut self, picture: &Picture, rect: Rect, slot: &Slot<'_, Bgr8>) {
        let bytes = 3 * rect.width * rect.height;
        if let Samples::Eight(pixels) = &picture.samples
            && Arc::strong_count(pixels) > 1
            && self.bytes + bytes <= KEPT_BYTES
            && self.kept.len() < KEPT_FRAMES
            && let Some(frame) = slot.retain()
        {
            self.bytes += bytes;
            self.kept.push(Kept { pixels: Arc::clone(pixels), rect, frame });
        }
    }
}
