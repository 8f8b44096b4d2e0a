//! How algorithms report warnings and metrics without knowing the framework.

/// Receives what an algorithm reports besides its result.
pub trait Report {
    /// Something the user should know.
    fn warn(&self, message: &str);

    /// Progress, or that the cause of a warning is gone.
    fn info(&self, message: &str);

    /// A named number.
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
