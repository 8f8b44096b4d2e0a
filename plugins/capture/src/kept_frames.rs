//! Reuses the frames of images that are shown repeatedly: a still image, or files in a loop.

use std::sync::Arc;

use panoscope_node::{Bgr8, Rect, Result, Retained, Slot};

use crate::source::{Picture, Samples};

/// Memory limit for reused frames, bytes. Further images are copied each time.
const KEPT_BYTES: usize = 512 << 20;
/// Maximum number of reused frames. The host reports a node that retains 128 frames as leaking.
const KEPT_FRAMES: usize = 96;

/// A frame made from a region of an image.
struct Kept {
    /// Keeps the pixels' memory alive, so that no other image gets the same address.
    pixels: Arc<Vec<u8>>,
    rect: Rect,
    frame: Retained<Bgr8>,
}

/// Frames of images whose source keeps them decoded.
#[derive(Default)]
pub struct KeptFrames {
    kept: Vec<Kept>,
    bytes: usize,
}

impl KeptFrames {
    /// Forwards the frame of region `rect` of an image, if it exists. Returns whether it did.
    ///
    /// # Errors
    /// As [`Slot::forward_anew`].
    pub fn forward(&self, picture: &Picture, rect: Rect, slot: &mut Slot<'_, Bgr8>) -> Result<bool> {
        let Samples::Eight(pixels) = &picture.samples else { return Ok(false) };
        let found = self.kept.iter().find(|kept| Arc::ptr_eq(&kept.pixels, pixels) && kept.rect == rect);
        found.map_or(Ok(false), |kept| slot.forward_anew(&kept.frame).map(|()| true))
    }

    /// Keeps the frame that was made from region `rect` of an image, if the source keeps the image too.
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
