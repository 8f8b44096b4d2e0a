//! Gains of the arm's PID, tuned on the simulated arm: relay feedback, rules, a search.

mod params;
mod report;
mod search;

pub use params::Plant;
pub use search::{Candidate, Method, Options, Tuning, Tunings, tune};
