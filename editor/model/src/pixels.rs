//! An image in the layout that windows and image files take.

/// An opaque RGBA image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pixels {
    /// Width in px.
    pub width: usize,
    /// Height in px.
    pub height: usize,
    /// Red, green, blue and 255 for each pixel, in row order.
    pub rgba: Vec<u8>,
}
