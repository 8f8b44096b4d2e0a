//! Checks of outputs where they are made, so that a bad frame is a fault of the node that made it.

use panoscope_abi::{self as abi, Frame};
use panoscope_base::format;

use crate::fault::Cause;

/// Maximum size of an output of a node, bytes.
pub(crate) const MAX_OUTPUT_BYTES: usize = 256 << 20;

/// Check of the content of an output after a call.
#[derive(Clone, Copy, Debug, PartialEq)]
enum ContentCheck {
    Nothing,
    /// Plain data of this size whose first `finite` f64 must be finite.
    Plain {
        size: usize,
        finite: usize,
    },
    /// A homography, finite unless it is marked as lost.
    Homography,
    /// A plane of f32 without NaN.
    Plane,
}

/// The declaration of one output as the checks need it.
pub(crate) struct OutputRule {
    pub name: String,
    formats: u32,
    check: ContentCheck,
}

impl OutputRule {
    /// The rules of a node type's outputs.
    pub fn of(node_type: &abi::NodeType) -> Box<[Self]> {
        (0..node_type.outputs_len)
            .map(|index| {
                // SAFETY: a validated descriptor of a plugin that stays mapped.
                let (port, name, packet) = unsafe {
                    let port = &*node_type.outputs.add(index);
                    (port, port.name.text().unwrap_or("?"), port.packet.text().unwrap_or(""))
                };
                let plain = |size, finite| ContentCheck::Plain { size, finite };
                let check = match packet {
                    "homography" => ContentCheck::Homography,
                    "roi" => plain(size_of::<abi::Roi>(), 0),
                    "calibration" => plain(size_of::<abi::Calibration>(), 0),
                    "tip" => plain(size_of::<abi::Tip>(), 2),
                    "pose" => plain(size_of::<abi::Pose>(), 7),
                    "joints" => plain(size_of::<abi::Joints>(), 2 * abi::MAX_JOINTS),
                    "scalar" => plain(size_of::<abi::Scalar>(), 0),
                    "image" | "confidence" if port.formats & abi::format_bit(abi::FORMAT_F32) != 0 => {
                        ContentCheck::Plane
                    }
                    _ => ContentCheck::Nothing,
                };
                Self { name: name.to_owned(), formats: port.formats, check }
            })
            .collect()
    }

    /// Formats that the output may have; 0 for any.
    pub fn formats(&self) -> u32 {
        self.formats
    }

    /// Formats whose contents [`Self::inspect`] checks, one bit each.
    pub fn inspected(&self) -> u32 {
        match self.check {
            ContentCheck::Nothing => 0,
            ContentCheck::Plane => abi::format_bit(abi::FORMAT_F32),
            ContentCheck::Plain { .. } | ContentCheck::Homography => u32::MAX,
        }
    }

    /// The reason why a description does not [`fit`].
    #[cold]
    pub fn objection(&self, frame: &Frame) -> (Cause, String) {
        let allowed = is_allowed(self.formats, frame.format);
        let Frame { width, height, stride_bytes, len, .. } = *frame;
        let name = &self.name;
        if !allowed {
            let (found, wanted) = (format::name(frame.format), format::names(self.formats));
            return (Cause::Format, format!("output `{name}` is {found}, declared are {wanted}"));
        }
        if len > MAX_OUTPUT_BYTES {
            let words = format!(
                "output `{name}` of {width}x{height} wants {} MB; no frame may be larger than {} MB",
                len >> 20,
                MAX_OUTPUT_BYTES >> 20
            );
            return (Cause::TooMuch, words);
        }
        let words =
            format!("output `{name}`: {width}x{height} with {stride_bytes} bytes per row does not match {len} bytes");
        (Cause::BadOutput, words)
    }

    /// Checks a packet that comes from a recording in place of a call.
    pub fn admit(&self, frame: &Frame) -> Result<(), (Cause, String)> {
        if fits(self.formats, frame) { self.inspect(frame, frame) } else { Err(self.objection(frame)) }
    }

    /// Checks an output after a call. `shown` is the copy that the node could change.
    pub fn inspect(&self, frame: &Frame, shown: &Frame) -> Result<(), (Cause, String)> {
        if !is_same(frame, shown) {
            let words = format!("the node changed the description of output `{}`, which only the host may", self.name);
            return Err((Cause::BadOutput, words));
        }
        // What is on the GPU alone is not fetched for a look.
        if self.check == ContentCheck::Nothing || frame.buffer.home != abi::HOME_HOST {
            Ok(())
        } else {
            self.look_inside(frame)
        }
    }

    fn look_inside(&self, frame: &Frame) -> Result<(), (Cause, String)> {
        let name = &self.name;
        let (size, finite) = match self.check {
            ContentCheck::Nothing => return Ok(()),
            ContentCheck::Plane => return self.look_at_plane(frame),
            ContentCheck::Plain { size, finite } => (size, finite),
            ContentCheck::Homography => (size_of::<abi::Homography>(), 9),
        };
        if frame.len != size {
            let words = format!("output `{name}` has {} bytes, its type has {size}", frame.len);
            return Err((Cause::BadOutput, words));
        }
        // SAFETY: the frame's buffer holds `size` bytes and is aligned to 64; no other thread writes it.
        let numbers = unsafe { std::slice::from_raw_parts(frame.data.cast::<f64>(), finite) };
        if let ContentCheck::Homography = self.check {
            // SAFETY: `len == size` was checked and buffers are aligned to 64 bytes; any bytes are valid plain data.
            let lost = unsafe { (*frame.data.cast::<abi::Homography>()).state } == abi::STATE_LOST;
            if lost {
                return Ok(());
            }
        }
        match numbers.iter().position(|n| !n.is_finite()) {
            Some(at) => Err((Cause::NotANumber, format!("output `{name}` has {} at index {at}", numbers[at]))),
            None => Ok(()),
        }
    }

    /// Samples a few dozen pixels of the plane, because a full scan would cost more than many nodes.
    fn look_at_plane(&self, frame: &Frame) -> Result<(), (Cause, String)> {
        const LOOKS: usize = 32;
        if frame.format != abi::FORMAT_F32 {
            return Ok(());
        }
        let (width, height, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
        for check in 0..LOOKS {
            let (y, x) = (check * height / LOOKS, (check * 7919 + 13) % width);
            // SAFETY: row and column lie inside the geometry checked above; the read is unaligned.
            let value = unsafe { frame.data.add(y * stride + x * 4).cast::<f32>().read_unaligned() };
            if value.is_nan() {
                let words = format!("output `{}` holds NaN at column {x}, row {y}", self.name);
                return Err((Cause::NotANumber, words));
            }
        }
        Ok(())
    }
}

/// Whether an output of these formats may have this description.
#[inline]
pub fn fits(formats: u32, frame: &Frame) -> bool {
    is_allowed(formats, frame.format) && frame.len <= MAX_OUTPUT_BYTES && geometry_fits(frame)
}

#[inline]
fn is_allowed(formats: u32, format: u32) -> bool {
    if formats == 0 { format <= abi::FORMAT_CLOUD } else { format < 32 && formats >> format & 1 == 1 }
}

/// Whether the node's copy of the description still equals the host's.
#[inline]
pub(crate) fn is_same(frame: &Frame, shown: &Frame) -> bool {
    frame.buffer == shown.buffer
        && frame.len == shown.len
        && frame.format == shown.format
        && frame.width == shown.width
        && frame.height == shown.height
        && frame.stride_bytes == shown.stride_bytes
}

/// Whether the rows lie inside the buffer. An image without pixels does not fit.
#[inline]
fn geometry_fits(frame: &Frame) -> bool {
    if frame.format == abi::FORMAT_BYTES {
        return true;
    }
    let (width, height, stride) = (frame.width as usize, frame.height as usize, frame.stride_bytes as usize);
    let need = format::image_bytes(width, height, stride, format::pixel_bytes(frame.format));
    width > 0 && height > 0 && need.is_some_and(|need| need <= frame.len)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule(formats: u32) -> OutputRule {
        OutputRule { name: "image".to_owned(), formats, check: ContentCheck::Nothing }
    }

    #[test]
    fn descriptions_that_lie_are_refused() {
        let gray = rule(abi::format_bit(abi::FORMAT_GRAY8));
        let good =
            Frame { len: 64 * 48, format: abi::FORMAT_GRAY8, width: 64, height: 48, stride_bytes: 64, ..Frame::EMPTY };
        let cause = |frame: &Frame| if fits(gray.formats, frame) { Ok(()) } else { Err(gray.objection(frame).0) };
        assert!(cause(&good).is_ok());
        assert_eq!(cause(&Frame { len: 64 * 48 - 1, ..good }), Err(Cause::BadOutput));
        assert_eq!(cause(&Frame { width: 65, ..good }), Err(Cause::BadOutput));
        assert_eq!(cause(&Frame { height: 0, ..good }), Err(Cause::BadOutput));
        assert_eq!(cause(&Frame { height: u32::MAX, stride_bytes: u32::MAX, ..good }), Err(Cause::BadOutput));
        assert_eq!(cause(&Frame { format: abi::FORMAT_F32, ..good }), Err(Cause::Format));
        assert_eq!(cause(&Frame { format: 4_000_000, ..good }), Err(Cause::Format));
        assert_eq!(cause(&Frame { len: MAX_OUTPUT_BYTES + 1, ..good }), Err(Cause::TooMuch));
    }

    #[test]
    fn tampering_shows() {
        let good = Frame { len: 64, format: abi::FORMAT_GRAY8, width: 8, height: 8, stride_bytes: 8, ..Frame::EMPTY };
        let gray = rule(abi::format_bit(abi::FORMAT_GRAY8));
        assert!(gray.inspect(&good, &good).is_ok());
        assert!(gray.inspect(&good, &Frame { len: 65, ..good }).is_err());
        let other = abi::BufferId { pool: 1, home: 0, offset: 256 };
        assert!(gray.inspect(&good, &Frame { buffer: other, ..good }).is_err());
    }
}
