//! As `std::collections`, with maps whose order does not depend on random numbers of the process.

pub use std::collections::BTreeMap as HashMap;
pub use std::collections::BTreeSet as HashSet;
pub use std::collections::*;
