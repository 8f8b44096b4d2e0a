//! Registration and compositing of overlapping views (thesis, chapters 2 and 4).

mod composite;
mod features_surf;
mod register_surf;

pub use composite::Composite;
pub use features_surf::FeaturesSurf;
pub use register_surf::RegisterSurf;

panoscope_node::export_plugin![RegisterSurf, Composite, FeaturesSurf];
