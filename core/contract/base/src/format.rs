//! The formats of frames: names in graph files, ids of the contract, sizes of a pixel.

use panoscope_abi as abi;

/// Layout of a frame's payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Format {
    /// One of the contract's `FORMAT_` constants.
    pub id: u32,
    /// Name in graph files and messages.
    pub name: &'static str,
    /// Elements per pixel; 0 for plain bytes.
    pub channels: usize,
    /// Bytes of one element, a power of two; 1 for plain bytes.
    pub element_bytes: usize,
    /// Whether ports of type `image` may have it.
    pub is_image: bool,
}

impl Format {
    /// Bytes of one pixel; 0 for plain bytes, which have no pixels.
    #[inline]
    pub const fn pixel_bytes(&self) -> usize {
        self.channels * self.element_bytes
    }
}

const fn image(id: u32, name: &'static str, channels: usize, element_bytes: usize) -> Format {
    Format { id, name, channels, element_bytes, is_image: true }
}

/// All formats of the contract; indexed by id.
pub const FORMATS: [Format; 7] = [
    Format { id: abi::FORMAT_BYTES, name: "bytes", channels: 0, element_bytes: 1, is_image: false },
    image(abi::FORMAT_GRAY8, "gray8", 1, 1),
    image(abi::FORMAT_BGR8, "bgr8", 3, 1),
    image(abi::FORMAT_RGBA8, "rgba8", 4, 1),
    image(abi::FORMAT_GRAY16, "gray16", 1, 2),
    image(abi::FORMAT_F32, "f32", 1, 4),
    Format { id: abi::FORMAT_CLOUD, name: "cloud", channels: 4, element_bytes: 4, is_image: false },
];

const _: () = {
    let mut id = 0;
    while id < FORMATS.len() {
        assert!(FORMATS[id].id as usize == id, "a format stands at the index of its id");
        id += 1;
    }
    assert!(FORMATS[abi::FORMAT_CLOUD as usize].pixel_bytes() == size_of::<abi::CloudPoint>());
};

/// The formats of `image`, as a bit set of ids.
pub const IMAGE_FORMATS: u32 = {
    let (mut bits, mut id) = (0, 0);
    while id < FORMATS.len() {
        if FORMATS[id].is_image {
            bits |= abi::format_bit(FORMATS[id].id);
        }
        id += 1;
    }
    bits
};

/// The format with that id; `None` for ids the contract does not have.
#[inline]
pub fn of(id: u32) -> Option<&'static Format> {
    FORMATS.get(id as usize)
}

/// The format of `image` that graph files call `name`.
pub fn image_named(name: &str) -> Option<&'static Format> {
    FORMATS.iter().find(|format| format.is_image && format.name == name)
}

/// Name of the format with that id, for messages.
pub fn name(id: u32) -> &'static str {
    of(id).map_or("an unknown format", |format| format.name)
}

/// Names of a bit set of formats, separated by commas.
pub fn names(bits: u32) -> String {
    let known = FORMATS.iter().filter(|format| bits & abi::format_bit(format.id) != 0);
    known.map(|format| format.name).collect::<Vec<_>>().join(", ")
}

/// Bytes of one pixel; 0 for plain bytes and unknown formats.
#[inline]
pub fn pixel_bytes(id: u32) -> usize {
    of(id).map_or(0, Format::pixel_bytes)
}

/// Bytes from the first pixel of an image to the end of its last one; 0 for an image without rows.
///
/// Sizes may come from another plugin: `None` when rows overlap (`stride_bytes` is shorter than a row) or the sum
/// overflows.
#[inline]
pub fn image_bytes(width: usize, height: usize, stride_bytes: usize, pixel_bytes: usize) -> Option<usize> {
    let row = width.checked_mul(pixel_bytes)?;
    if stride_bytes < row {
        return None;
    }
    match height.checked_sub(1) {
        None => Some(0),
        Some(full_rows) => full_rows.checked_mul(stride_bytes)?.checked_add(row),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_ids_and_sizes_agree_with_the_contract() {
        for format in &FORMATS {
            assert_eq!((of(format.id), name(format.id)), (Some(format), format.name));
            assert_eq!(image_named(format.name).is_some(), format.is_image, "{}", format.name);
        }
        let sizes: Vec<usize> = (0..8).map(pixel_bytes).collect();
        assert_eq!(sizes, [0, 1, 3, 4, 2, 4, 16, 0]);
        assert_eq!((name(7), name(u32::MAX)), ("an unknown format", "an unknown format"));
        assert_eq!(names(IMAGE_FORMATS), "gray8, bgr8, rgba8, gray16, f32");
        assert_eq!(names(u32::MAX), "bytes, gray8, bgr8, rgba8, gray16, f32, cloud");
        assert_eq!(image_named("cloud"), None);
    }

    #[test]
    fn the_last_row_needs_no_padding_and_sums_do_not_overflow() {
        assert_eq!(image_bytes(4, 3, 20, 3), Some(52));
        assert_eq!(image_bytes(4, 3, 11, 3), None, "rows overlap");
        assert_eq!(image_bytes(4, 0, 20, 3), Some(0));
        assert_eq!(image_bytes(0, 3, 20, 3), Some(40));
        assert_eq!(image_bytes(usize::MAX, 2, usize::MAX, 1), None);
        assert_eq!(image_bytes(usize::MAX, 1, usize::MAX, 3), None);
        assert_eq!(image_bytes(usize::MAX, 1, usize::MAX, 1), Some(usize::MAX));
    }
}
