//! Reports of warnings and metrics by algorithms, independent of the framework.

/// Receives what an algorithm reports besides its result.
pub trait Report {
    /// Warns the user.
    fn warn(&self, message: &str);

    /// Reports progress, or that the cause of a warning is gone.
    fn info(&self, message: &str);

    /// Reports a named number.
    fn metric(&self, name: &str, value: f64);
}

/// Drops all reports.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Report for Silent {
    fn warn(&self, _: &str) {}

    fn info(&self, _: &str) {}

    fn metric(&self, _: &str, _: f64) {}
}
