//! Stitching: warp, exposure, seam, blend, canvas.
//!
//! [`Compositor`] joins two or more views whose homographies are known (thesis chapter 2.2 and 2.3.2): the reference
//! view is copied, the others are warped, exposure is evened out in the overlap, a seam is found on the shrunken
//! overlap and held from frame to frame, and the images are blended in a zone around the seam only.

mod blend;
mod blend_rows;
mod border;
mod canvas;
mod coarse;
mod compositor;
pub mod correspond;
mod crop;
pub mod cut;
pub mod disparity_plane;
mod drawing;
pub mod evaluate;
mod exposure;
mod graph_cut;
pub mod grid;
mod grid_cells;
pub mod judge;
mod lit_spans;
mod mark;
pub mod mesh;
mod paint;
mod painted;
mod params;
pub mod placement;
mod projective;
mod pyramid;
mod rectified_view;
mod seam;
mod segments;
mod taps;
#[cfg(test)]
mod tests;
pub mod warp;

pub use coarse::map_factor;
pub use compositor::Compositor;
pub use drawing::{Drawing, DrawnMesh, DrawnView, LazyView, PaintError, Painter, Patch, Runs, Samples};
pub use graph_cut::GridCut;
pub use grid::{CellPoint, GridParams, GridRegistration, RegisterGrid};
pub use mesh::{InstrumentHints, Keep, Kept, Lattice, Mesh, MeshFollower, MeshParams, MeshReport};
pub use params::{
    BlendMethod, BorderMethod, Canvas, CompositeError, CompositeParams, CompositeReport, CropMethod, ExposureMethod,
    GeometryFault, GeometryState, MAX_VIEWS, SeamCost, SeamMethod,
};
pub use projective::{IDENTITY, warped_corners};
pub use rectified_view::RectifiedView;
