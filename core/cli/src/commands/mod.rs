//! One module per command.

pub mod check;
pub mod describe;
pub mod devices;
pub mod dot;
pub mod list;
pub mod run;
pub mod schema;
