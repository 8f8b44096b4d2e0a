//! Recordings as files of other programs, a running graph for Foxglove ([`live`]), and a procedure as DICOM objects ([`dicom`]).
//!
//! [`Export`] selects ports and ticks of a recording and determines the content of each port. [`folder::write`] makes a
//! folder of PNG, NPY, PLY, CSV and YAML files, [`foxglove::write`] an MCAP file with the schemas of Foxglove;
//! [`foxglove::encode`] gives the same messages of one packet. The Python package writes files of rerun, from the same
//! packets.
//!
//! Both give a [`PortReport`] per port: it names everything that a target cannot represent.

pub mod dicom;
mod error;
pub mod folder;
pub mod foxglove;
pub mod live;
pub mod ros2;
mod selection;
mod table_file;
mod value;

pub use error::{ExportError, ValueError};
pub use selection::{Export, Form, Port, PortReport, Selection};
pub use value::{Kind, Layout, Picture, Value};
