//! What the editor and the theatre share: colours, previews of outputs, keys, and opening a window.

pub mod arguments_form;
pub mod crosshair;
mod film;
#[cfg(feature = "golden")]
pub mod golden;
mod keys;
pub mod numbers;
mod output_cache;
mod shot;
mod signals;
mod speech;
pub mod surface;
pub mod theme;
pub mod window;

pub use keys::ARROWS;
pub use output_cache::{OutputCache, format_time, image_of, unit_suffix};
pub use shot::{Costs, Shot};
pub use signals::close_on_signals;
