//! The views and the depth of a tick: of frames on the GPU a node reads parts.

use panoscope_node::pick::{Grid, Parts};
use panoscope_node::{Bgr8, Depth, Disparity, Image, Plane, View};

use crate::tip_position::Space;

/// Memory for the parts of frames on the GPU that are read.
#[derive(Default)]
pub struct ViewMemory {
    left: Parts<u8>,
    right: Parts<u8>,
    depth: Parts<f32>,
    disparity: Parts<f32>,
}

/// The views and the depth of a tick. Of frames on the GPU only parts are read, unless masks show where tools are.
pub struct Views<'a, 'f> {
    /// Columns and rows of the views.
    pub size: (usize, usize),
    /// The view in which tools were found.
    pub left: Option<Image<'f, Bgr8>>,
    /// The other view.
    pub right: Option<Image<'f, Bgr8>>,
    /// Depth, mm.
    pub depth: Option<Image<'f, Depth>>,
    /// Disparity, px.
    pub disparity: Option<Image<'f, Disparity>>,
    /// Disparity times depth, px mm; NaN without calibration.
    pub focal_baseline: f64,
    /// Whether frames are read whole.
    pub is_whole: bool,
    /// Memory for parts.
    pub memory: &'a mut ViewMemory,
}

/// Parts of the views and of the depth; the rest is unspecified.
pub struct ViewParts<'a> {
    /// Of the left view.
    pub left: Option<View<'a, u8>>,
    /// Of the right view.
    pub right: Option<View<'a, u8>>,
    /// Of the depth.
    pub space: Space<'a>,
}

impl<'f> Views<'_, 'f> {
    /// Columns and rows of the depth.
    pub fn depth_size(&self) -> Option<(usize, usize)> {
        let of_depth = self.depth.map(|depth| (depth.width(), depth.height()));
        of_depth.or(self.disparity.map(|map| (map.width(), map.height())))
    }

    /// Whether parts of a frame on the GPU are read: only then it matters which.
    pub fn are_parts(&self) -> bool {
        let there = [self.left.map(|image| image.is_from_device()), self.right.map(|image| image.is_from_device())];
        let map = [self.depth.map(|map| map.is_from_device()), self.disparity.map(|map| map.is_from_device())];
        !self.is_whole && there.into_iter().chain(map).flatten().any(|is_there| is_there)
    }

    /// Reads parts of the left view, the right view, and the depth. `None` leaves an input out.
    pub fn parts(&mut self, [left, right, depth]: [Option<&[Grid]>; 3]) -> ViewParts<'_> {
        fn part<'a, 'f: 'a, P: Plane>(
            is_whole: bool,
            image: Option<Image<'f, P>>,
            parts: Option<&[Grid]>,
            memory: &'a mut Parts<P::Element>,
        ) -> Option<View<'a, P::Element>> {
            let (image, parts) = image.zip(parts)?;
            Some(if is_whole { image.view() } else { memory.view(image, parts) })
        }
        let size = self.depth_size();
        let (is_whole, memory) = (self.is_whole, &mut *self.memory);
        let map = self.disparity.filter(|map| Some((map.width(), map.height())) == size);
        let space = Space {
            depth: part(is_whole, self.depth, depth, &mut memory.depth),
            disparity: part(is_whole, map, depth, &mut memory.disparity),
            focal_baseline: self.focal_baseline,
        };
        let left = part(is_whole, self.left, left, &mut memory.left);
        ViewParts { left, right: part(is_whole, self.right, right, &mut memory.right), space }
    }
}
