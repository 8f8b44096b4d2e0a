//! Packets `detections` and `instances`: boxes with their label table, and bit masks.

use panoscope_abi::{Detection, DetectionsHeader};

use super::PacketError;
use super::fields::{Field, Fields};

/// Bytes of one instance's bit mask: a bit per pixel, rows padded to whole bytes.
pub fn mask_len(image_width: usize, image_height: usize) -> usize {
    image_width.div_ceil(8) * image_height
}

/// A list of boxes whose sizes have been checked against its bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detections<'b> {
    header: DetectionsHeader,
    entries: &'b [u8],
    labels: &'b str,
    masks: &'b [u8],
}

impl<'b> Detections<'b> {
    /// Reads a packet `detections`; bytes after the labels are ignored.
    ///
    /// # Errors
    /// When the bytes end before the last label, or the labels are not UTF-8.
    pub fn parse(bytes: &'b [u8]) -> Result<Self, PacketError> {
        Self::read("detections", bytes, false)
    }

    /// Reads a packet `instances`, which has a mask per box; bytes after the masks are ignored.
    ///
    /// # Errors
    /// When the bytes end before the last mask, or the labels are not UTF-8.
    pub fn parse_instances(bytes: &'b [u8]) -> Result<Self, PacketError> {
        Self::read("instances", bytes, true)
    }

    fn read(packet: &'static str, bytes: &'b [u8], has_masks: bool) -> Result<Self, PacketError> {
        let mut fields = Fields::new(packet, bytes);
        let header = DetectionsHeader::read(&mut fields, packet)?;
        let count = header.count as usize;
        let entries = fields.take("entries", count.checked_mul(size_of::<Detection>()))?;
        let labels = fields.text("labels", header.labels_len as usize)?;
        let one = if has_masks { Self::mask_len_of(&header) } else { 0 };
        let masks = fields.take("masks", one.checked_mul(count))?;
        Ok(Self { header, entries, labels, masks })
    }

    fn mask_len_of(header: &DetectionsHeader) -> usize {
        mask_len(header.image_width as usize, header.image_height as usize)
    }

    /// Number of boxes.
    pub fn len(&self) -> usize {
        self.header.count as usize
    }

    /// Whether nothing was detected.
    pub fn is_empty(&self) -> bool {
        self.header.count == 0
    }

    /// The boxes.
    pub fn items(&self) -> impl Iterator<Item = Detection> + use<'b> {
        let entries = self.entries.chunks_exact(size_of::<Detection>());
        entries.filter_map(|entry| super::decode(entry).ok())
    }

    /// The bytes of all boxes.
    pub fn entries(&self) -> &'b [u8] {
        self.entries
    }

    /// Names of classes, in the order of their indices.
    pub fn labels(&self) -> impl Iterator<Item = &'b str> + use<'b> {
        self.labels.lines()
    }

    /// Name of a class; `None` when the table has none.
    pub fn label(&self, class_index: u32) -> Option<&'b str> {
        self.labels().nth(class_index as usize)
    }

    /// Width and height in px of the image that was searched.
    pub fn image_size(&self) -> (usize, usize) {
        (self.header.image_width as usize, self.header.image_height as usize)
    }

    /// Bit mask of box `index`: whole image, rows padded to whole bytes, most significant bit first; empty without
    /// masks.
    pub fn mask(&self, index: usize) -> &'b [u8] {
        let len = Self::mask_len_of(&self.header);
        let start = index.checked_mul(len);
        start.and_then(|start| self.masks.get(start..start.checked_add(len)?)).unwrap_or_default()
    }
}
