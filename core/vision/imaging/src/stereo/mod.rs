//! Stereo: rectification, matching, filtering, reprojection.
//!
//! Disparities are f32, in full-resolution pixels of the left rectified view, positive when
//! `x_right = x_left - disparity`, NaN where nothing is known. Every stage takes a [`Rect`] and
//! computes nothing outside it.

mod bilateral_grid;
pub mod bilateral_solver;
pub mod block_matching;
mod block_matching_finish;
mod block_matching_kernel;
mod border_strip;
pub mod calibration_error;
pub mod camera;
pub mod confidence;
mod epipolar;
mod error;
pub mod evaluate;
mod filter_input;
pub mod formats;
mod grid_solver;
mod guide_weights;
mod kept_regions;
pub mod length;
pub mod lens;
mod lit_pair;
mod matcher;
mod matching;
mod offset;
mod pair_matcher;
mod prefilter;
mod range_plan;
pub mod rectify;
pub mod remap;
pub mod reproject;
pub mod rotation;
mod runs;
mod scratch;
pub mod search;
pub mod semi_global;
mod semi_global_kernel;
pub mod shared_field;
mod small_holes;
pub mod speckle;
mod surface_point;
mod survey;
mod tile;
mod tridiagonal;
pub mod view_delay;
pub mod view_order;
mod watch;
pub mod wls;

pub use bilateral_solver::{BilateralSolver, BilateralSolverParams};
pub use block_matching::{BlockMatcher, BlockMatchingParams};
pub use calibration_error::{BoardView, CalibrationError};
pub use camera::{CameraModel, StereoCameras};
pub use confidence::{Confidence, ConfidenceParams};
pub use error::StereoError;
pub use evaluate::{BAD_PX, DepthScore, DisparityScore, MapScorer, SurfaceScore, score_disparity, score_surface};
pub use filter_input::FilterInput;
pub use formats::FloatImage;
pub use lens::{Equidistant, Lens};
pub use matcher::Matcher;
pub use matching::Span;
pub use pair_matcher::{PairMatcher, PairParams, StereoKernel};
pub use rectify::{Rectification, RectifiedCamera, RectifyParams};
pub use remap::RemapTable;
pub use reproject::{ReprojectInput, ReprojectParams, reproject};
pub use search::{Search, SearchParams};
pub use semi_global::{SemiGlobalMatcher, SemiGlobalParams};
pub use shared_field::SharedField;
pub use small_holes::SmallHoles;
pub use speckle::SpeckleFilter;
pub use surface_point::{Sample, SurfacePoint};
pub use tile::{Tile, project_right};
pub use view_delay::{Delay, RowSample, ViewDelay};
pub use view_order::{Order, OrderEvidence, ViewOrder};
pub use wls::{SolveError, WlsFilter, WlsParams, WlsSolver};
