//! The renderer: a height field of tissue, exact rays, a light at the scope's tip, a sensor.
//!
//! [`Phantom`] is built once (shape and surface are baked into maps) and then draws frames in any order. It uses only `+ - * /`, square roots and
//! integer hashes, in a fixed order: the same parameters and frame number give the same bytes with AVX2 or without, on any number of threads and on
//! any machine.

mod boards;
mod camera_buffers;
pub(crate) mod canvas;
mod cast;
mod clearance;
mod effects;
mod fit;
mod footprint;
mod kinds;
mod lanes;
pub(crate) mod lens;
mod marks;
mod material;
mod math;
mod motion;
mod noise;
mod params;
mod phantom;
mod relief;
mod scenario;
mod scratch;
mod shade;
mod solid;
mod table;
#[cfg(test)]
mod tests;
mod tools;
mod truth;
mod vessels;

pub use canvas::Canvas;
pub use fit::PlaneFit;
pub use kinds::{BoardPrint, SceneKind, ToolKind};
pub use marks::{BLOCKS_MM, BOARD_CENTRE_MM, LENGTHS_MM, RULERS_Y_MM, SQUARE_MM};
pub use math::{Pose, chance};
pub use params::{BlackOut, CameraModel, CameraPath, Incident, IncidentKind, PhantomError, Rig, SceneParams};
pub use phantom::Phantom;
pub use scenario::ToolMotion;
pub use tools::ToolTruth;
pub use truth::TruthMut;
