//! A parameter swept over a range: one run of the same pictures for each value, and the statistics of a measure.
//!
//! Each value has an engine of its own, in batch, so that no frame is lost and the result does not depend on the machine's speed. Only the
//! nodes that the measure needs are run, and none with side effects: nothing is written, nothing moves. A graph that runs meanwhile
//! is not affected.

mod error;
mod measure;
mod part;
mod report;
mod run;
mod values;

pub use error::{MOST_STEPS, PointError, SweepError};
pub use measure::{COUNTERS, Measure, Rows, Summary};
pub use report::{chart, csv, json, line, table};
pub use run::{Point, Request, Sweep, can_sweep};
pub use values::shown;
