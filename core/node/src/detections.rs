//! Packets `detections` and `instances`: boxes with their label table, and bit masks.

use crate::abi::{self, Detection, DetectionsHeader};
use crate::error::{NodeError, Result};
use crate::input::{FromFrame, bytes};
use crate::output::Slot;
use crate::packet::{Plain, bytes_of};
use crate::port::nameless;

/// Marks an output of type `detections`.
#[derive(Clone, Copy, Debug)]
pub enum LabeledDetections {}
/// Marks an output of type `instances`.
#[derive(Clone, Copy, Debug)]
pub enum LabeledInstances {}

// SAFETY: repr(C), fields ordered by size without padding (sizes asserted).
unsafe impl Plain for Detection {}
// SAFETY: as above.
unsafe impl Plain for DetectionsHeader {}
const _: () = assert!(size_of::<Detection>() == 32 && size_of::<DetectionsHeader>() == 24);

/// Boxes found in an image.
#[derive(Clone, Copy)]
pub struct Detections<'f> {
    header: &'f DetectionsHeader,
    items: &'f [Detection],
    labels: &'f str,
    masks: &'f [u8],
    tick: abi::Tick,
}

/// Bytes of one instance's bit mask.
pub fn mask_len(image_width: usize, image_height: usize) -> usize {
    image_width.div_ceil(8) * image_height
}

fn parse(frame: &abi::Frame, with_masks: bool) -> Result<Detections<'_>> {
    let all = bytes(frame);
    let short = || NodeError::new(format!("a list of detections is cut off after {} bytes", all.len()));
    if all.len() < size_of::<DetectionsHeader>() || !frame.data.addr().is_multiple_of(8) {
        return Err(short());
    }
    // SAFETY: length and alignment checked; plain data.
    let header = unsafe { &*all.as_ptr().cast::<DetectionsHeader>() };
    let items_at = size_of::<DetectionsHeader>();
    let labels_at = items_at + header.count as usize * size_of::<Detection>();
    let masks_at = labels_at + header.labels_len as usize;
    let one_mask = if with_masks { mask_len(header.image_width as usize, header.image_height as usize) } else { 0 };
    // Sizes come from another plugin: the products may overflow.
    let Some(masks_len) = one_mask.checked_mul(header.count as usize) else { return Err(short()) };
    if all.len() < masks_at || all.len() - masks_at < masks_len {
        return Err(short());
    }
    // SAFETY: inside the buffer (checked), aligned to 8 like the header.
    let items = unsafe { std::slice::from_raw_parts(all.as_ptr().add(items_at).cast(), header.count as usize) };
    let labels = std::str::from_utf8(&all[labels_at..masks_at])?;
    Ok(Detections { header, items, labels, masks: &all[masks_at..masks_at + masks_len], tick: frame.tick })
}

impl<'f> FromFrame<'f> for Detections<'f> {
    const PORT: abi::Port = nameless("detections", 0, 0, 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        parse(frame, false)
    }
}

impl<'f> Detections<'f> {
    /// The boxes.
    pub fn items(&self) -> &'f [Detection] {
        self.items
    }

    /// The tick of the picture that was searched.
    pub fn tick(&self) -> abi::Tick {
        self.tick
    }

    /// Name of a class; empty when the table has none.
    pub fn label(&self, class_index: u32) -> &'f str {
        self.labels.lines().nth(class_index as usize).unwrap_or("")
    }

    /// All names of classes.
    pub fn labels(&self) -> impl Iterator<Item = &'f str> + use<'f> {
        self.labels.lines()
    }

    /// Width and height in px of the image that was searched.
    pub fn image_size(&self) -> (usize, usize) {
        (self.header.image_width as usize, self.header.image_height as usize)
    }
}

/// Boxes with a bit mask each.
#[derive(Clone, Copy)]
pub struct Instances<'f> {
    detections: Detections<'f>,
}

impl<'f> FromFrame<'f> for Instances<'f> {
    const PORT: abi::Port = nameless("instances", 0, 0, 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        Ok(Self { detections: parse(frame, true)? })
    }
}

impl<'f> Instances<'f> {
    /// The boxes.
    pub fn detections(&self) -> Detections<'f> {
        self.detections
    }

    /// Bit mask of instance `index`: whole image, rows padded to whole bytes, most significant bit first.
    pub fn mask(&self, index: usize) -> &'f [u8] {
        let (width, height) = self.detections.image_size();
        let len = mask_len(width, height);
        self.detections.masks.get(index * len..(index + 1) * len).unwrap_or(&[])
    }
}

fn write<T>(
    slot: &mut Slot<'_, T>,
    items: &[Detection],
    labels: &str,
    image_size: (usize, usize),
    masks: &[u8],
) -> Result<()> {
    let header = DetectionsHeader {
        count: items.len() as u32,
        labels_len: labels.len() as u32,
        image_width: image_size.0 as u32,
        image_height: image_size.1 as u32,
        masks_len: masks.len() as u64,
    };
    let header = std::slice::from_ref(&header);
    let (a, b) = (bytes_of(header), bytes_of(items));
    let out = slot.allocate_bytes(a.len() + b.len() + labels.len() + masks.len())?;
    let (head, rest) = out.split_at_mut(a.len());
    head.copy_from_slice(a);
    let (entries, rest) = rest.split_at_mut(b.len());
    entries.copy_from_slice(b);
    let (names, bits) = rest.split_at_mut(labels.len());
    names.copy_from_slice(labels.as_bytes());
    bits.copy_from_slice(masks);
    Ok(())
}

impl Slot<'_, LabeledDetections> {
    /// Makes the output. `labels` are names separated by line feeds; `image_size` is width, height in px.
    pub fn set_detections(&mut self, items: &[Detection], labels: &str, image_size: (usize, usize)) -> Result<()> {
        write(self, items, labels, image_size, &[])
    }
}

impl Slot<'_, LabeledInstances> {
    /// Makes the output; `masks` holds [`mask_len`] bytes per item.
    pub fn set_instances(
        &mut self,
        items: &[Detection],
        labels: &str,
        image_size: (usize, usize),
        masks: &[u8],
    ) -> Result<()> {
        let expected = items.len() * mask_len(image_size.0, image_size.1);
        if masks.len() != expected {
            return Err(NodeError::new(format!("{} mask bytes were given, {expected} are needed", masks.len())));
        }
        write(self, items, labels, image_size, masks)
    }
}
