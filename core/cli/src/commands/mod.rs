//! One module per command.

pub mod audit;
pub mod bench;
pub mod calibrate;
pub mod check;
pub mod compare;
pub mod describe;
pub mod devices;
pub mod dicom;
pub mod doctor;
pub mod dot;
pub mod edit;
pub mod eval;
pub mod export;
pub mod generate;
pub mod import;
pub mod list;
pub mod lock;
pub mod new;
pub mod record;
pub mod replay;
pub mod report;
pub mod run;
pub mod schema;
pub mod soak;
pub mod sweep;
pub mod tune;
