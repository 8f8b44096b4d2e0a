//! Packets `detections` and `instances`: boxes with their label table, and bit masks.

use panoscope_base::packet;
pub use panoscope_base::packet::mask_len;

use crate::abi::{self, Detection, DetectionsHeader};
use crate::error::{NodeError, Result};
use crate::input::{FromFrame, bytes};
use crate::output::Slot;
use crate::packet::{LabeledDetections, LabeledInstances, Plain, bytes_of};
use crate::port::nameless;

// SAFETY: repr(C), fields ordered by size without padding (sizes asserted).
unsafe impl Plain for Detection {}
// SAFETY: repr(C), four u32 and a u64, no padding (size asserted).
unsafe impl Plain for DetectionsHeader {}
const _: () = assert!(size_of::<Detection>() == 32 && size_of::<DetectionsHeader>() == 24);

/// Boxes found in an image.
#[derive(Clone, Copy)]
pub struct Detections<'f> {
    list: packet::Detections<'f>,
    items: &'f [Detection],
    frame: &'f abi::Frame,
}

fn typed<'f>(frame: &'f abi::Frame, list: packet::Detections<'f>) -> Result<Detections<'f>> {
    let entries = list.entries();
    if !entries.as_ptr().addr().is_multiple_of(align_of::<Detection>()) {
        return Err(NodeError::new("the entries of a list of detections are not aligned to 8 bytes"));
    }
    // SAFETY: the entries are inside the frame and, as just checked, aligned; plain data has no invalid bit pattern.
    let items = unsafe { std::slice::from_raw_parts(entries.as_ptr().cast(), list.len()) };
    Ok(Detections { list, items, frame })
}

impl<'f> FromFrame<'f> for Detections<'f> {
    const PORT: abi::Port = nameless("detections", 0, 0, 0);

    fn from_frame(frame: &'f abi::Frame) -> Result<Self> {
        typed(frame, packet::Detections::parse(bytes(frame))?)
    }
}

impl<'f> Detections<'f> {
    /// The boxes.
    pub fn items(&self) -> &'f [Detection] {
        self.items
    }

    /// The tick of the searched image.
    pub fn tick(&self) -> abi::Tick {
        self.frame.tick
    }

    pub(crate) fn raw_frame(&self) -> &abi::Frame {
        self.frame
    }

    /// Name of a class; empty when the table has none.
    pub fn label(&self, class_index: u32) -> &'f str {
        self.list.label(class_index).unwrap_or("")
    }

    /// The names of all classes, in the order of their indices.
    pub fn labels(&self) -> impl Iterator<Item = &'f str> + use<'f> {
        self.list.labels()
    }

    /// Width and height of the searched image in px.
    pub fn image_size(&self) -> (usize, usize) {
        self.list.image_size()
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
        let list = packet::Detections::parse_instances(bytes(frame))?;
        Ok(Self { detections: typed(frame, list)? })
    }
}

impl<'f> Instances<'f> {
    pub(crate) fn list(&self) -> &Detections<'f> {
        &self.detections
    }

    /// The boxes without their masks.
    pub fn detections(&self) -> Detections<'f> {
        self.detections
    }

    /// Bit mask of instance `index`: whole image, rows padded to whole bytes, most significant bit first.
    pub fn mask(&self, index: usize) -> &'f [u8] {
        self.detections.list.mask(index)
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
            return Err(NodeError::new(format!("{} mask bytes were given, expected {expected}", masks.len())));
        }
        write(self, items, labels, image_size, masks)
    }
}
