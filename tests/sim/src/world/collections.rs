//! As `std::collections`, with maps whose order does not depend on the process's random numbers.

pub use std::collections::BTreeMap as HashMap;
pub use std::collections::BTreeSet as HashSet;
pub use std::collections::*;
