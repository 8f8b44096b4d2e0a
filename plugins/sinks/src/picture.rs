//! Pixels of an input whose format is known only when a frame arrives.

use panoscope_data::formats::Pixels;
use panoscope_node::{AnyImage, Bgr8, Gray8, Gray16, GrayF32, Rgba8};

/// The pixels of an image; `None` for other packets.
pub fn pixels_of<'a>(image: &AnyImage<'a>) -> Option<Pixels<'a>> {
    if let Some(plane) = image.as_plane::<Bgr8>() {
        return Some(Pixels::Bgr8(plane.view()));
    }
    if let Some(plane) = image.as_plane::<Gray8>() {
        return Some(Pixels::Gray8(plane.view()));
    }
    if let Some(plane) = image.as_plane::<Rgba8>() {
        return Some(Pixels::Rgba8(plane.view()));
    }
    if let Some(plane) = image.as_plane::<Gray16>() {
        return Some(Pixels::Gray16(plane.view()));
    }
    image.as_plane::<GrayF32>().map(|plane| Pixels::F32(plane.view()))
}
