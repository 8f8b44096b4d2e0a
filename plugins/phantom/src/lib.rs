//! A rendered tissue scene seen by two or four cameras, with exact ground truth.

mod node;
pub mod render;

pub use node::PhantomNode;

panoscope_node::export_plugin![PhantomNode];
