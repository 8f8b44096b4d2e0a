//! A left view that gives colours or edges, in one of the formats that are taken.

use panoscope_node::device::DeviceImage;
use panoscope_node::{AnyImage, Bgr8, Gray8, Image, Result, View, error};

/// A left view, gray or BGR.
pub enum Colours<'f> {
    Bgr(Image<'f, Bgr8>),
    Gray(Image<'f, Gray8>),
}

impl<'f> Colours<'f> {
    /// # Errors
    /// The image has another format.
    pub fn of(image: &AnyImage<'f>) -> Result<Self> {
        let gray = || Some(Self::Gray(image.as_plane()?));
        let known = image.as_plane().map(Self::Bgr).or_else(gray);
        known.ok_or_else(|| error!("input `image` must be gray8 or bgr8"))
    }

    /// The pixels in the host's memory.
    pub fn view(&self) -> View<'f, u8> {
        match self {
            Self::Bgr(image) => image.view(),
            Self::Gray(image) => image.view(),
        }
    }

    /// The image on the GPU, and the bytes of its pixels.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn on_device(&self) -> Result<(DeviceImage, usize)> {
        match self {
            Self::Bgr(image) => Ok((image.on_device()?, 3)),
            Self::Gray(image) => Ok((image.on_device()?, 1)),
        }
    }
}
