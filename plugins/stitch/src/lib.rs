//! Registration and compositing of overlapping views (thesis, chapters 2 and 4).

#![forbid(unsafe_code)]

mod calibrated_views;
pub mod composite;
mod composite_mesh;
mod cut_views;
mod evaluate_mosaic;
mod evaluate_stitch;
mod features_surf;
pub mod gpu;
pub mod mosaic;
mod register_grid;
mod register_surf;
mod registration;
mod view_gain;

pub use composite::Composite;
pub use composite_mesh::CompositeMesh;
pub use cut_views::CutViews;
pub use evaluate_mosaic::EvaluateMosaic;
pub use evaluate_stitch::EvaluateStitch;
pub use features_surf::FeaturesSurf;
pub use mosaic::Mosaic;
pub use register_grid::RegisterGridNode;
pub use register_surf::RegisterSurf;

panoscope_node::export_plugin![
    RegisterSurf,
    RegisterGridNode,
    Composite,
    CompositeMesh,
    FeaturesSurf,
    EvaluateStitch,
    CutViews,
    Mosaic,
    EvaluateMosaic
];
