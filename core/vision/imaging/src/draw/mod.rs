//! Drawing: lines, boxes, text, colour maps.
//!
//! Everything draws on BGR views of bytes, clips to the image, ignores coordinates that are not finite and gives the
//! same bytes on every machine.

mod colormap;
mod contour;
mod corner;
mod font;
mod labels;
mod light;
mod overlay;
mod rims;
mod shapes;
mod surface;
mod text;

pub use colormap::{Colormap, colorize};
pub use font::is_drawable;
pub use labels::{Area, Labels};
pub use overlay::{ScaleBar, blend_mask, scale_bar};
pub use rims::{GradientLimit, Rims};
pub use shapes::{
    arrow, circle, corners, cross, fill_circle, fill_polygon, fill_rectangle, line, polygon, polyline, rectangle, sides,
};
pub use surface::{DrawnPoint, Orbit, Projection, SurfacePainter, SurfacePoints, filled_color, middle_steps};
pub use text::{text, text_size};

/// Blue, green, red.
pub type Color = [u8; 3];
