//! What the editor and the theatre draw alike.

pub mod crosshair;
mod keys;
mod shot;
mod shown;
mod signals;
pub mod surface;
pub mod theme;
pub mod window;

pub use keys::ARROWS;
pub use shot::{Costs, Shot};
pub use shown::{Shown, image_of, time_words, unit_words};
pub use signals::close_on_signals;
