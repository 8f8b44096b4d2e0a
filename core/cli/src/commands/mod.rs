//! One module per command.

pub mod audit;
pub mod check;
pub mod compare;
pub mod describe;
pub mod describe_model;
pub mod devices;
pub mod doctor;
pub mod dot;
pub mod edit;
pub mod keys;
pub mod list;
pub mod lock;
pub mod new;
pub mod record;
pub mod replay;
pub mod run;
pub mod schema;
mod schema_python;
pub mod serve;
pub mod windows;
