//! A parameter swept over a range: one run on the same images for each value, and the statistics of a measure. A
//! [`Study`] varies several parameters and node types, takes several measures, and writes a folder for each run.
//!
//! Each value has a separate engine, in batch, so that no frame is lost and the result does not depend on the machine's
//! speed. Only the nodes that the measure needs are run, and none with side effects: nothing is written, nothing moves.
//! A graph that runs meanwhile is not affected.

mod axis;
mod error;
mod measure;
mod part;
mod report;
mod run;
mod run_measure;
mod search;
mod study;
mod study_files;
mod trial;
mod values;

pub use axis::{Axis, AxisRequest, AxisValue, AxisValues};
pub use error::{MAX_STEPS, PointError, SweepError};
pub use measure::{COUNTERS, Measure, Rows, Summary};
pub use report::{chart, csv, json, line, table};
pub use run::{Point, Request, Sweep, can_sweep};
pub use run_measure::{RunMeasure, Statistic};
pub use study::{MAX_RUNS, Plan, RunResult, Study, StudyRequest};
pub use study_files::{RESULTS, RunFile, RunParam, StudyFolder, study_csv, study_line, study_table};
pub use values::shown;
