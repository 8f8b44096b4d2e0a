//! DICOM: stills, clips and measurements of a procedure as objects of a patient's study.
//!
//! | module | what it does |
//! |---|---|
//! | [`entry`] | entries of a modality worklist, the only source of identity |
//! | [`export`] | files of a procedure as objects in a folder |
//! | [`object`] | the objects: Secondary Capture, Video Endoscopic, Comprehensive SR |
//! | [`net`] | echo, worklist query and storage over the network |
//! | [`outbox`] | a folder of objects that wait to be sent |
//!
//! This module does not know graphs. File names are UIDs; identities are written only into objects. Bytes from the
//! network and from files are checked before use: lengths lie inside what has come, and are capped.

mod element;
pub mod entry;
mod error;
pub mod export;
pub mod lengths;
pub mod net;
pub mod object;
pub mod outbox;
pub mod part10;
mod time;
pub mod uid;

pub use entry::{Entry, Query};
pub use error::{DicomError, Result};

/// Today's local date, `YYYYMMDD`.
pub fn today() -> String {
    time::Moment::now().date
}
