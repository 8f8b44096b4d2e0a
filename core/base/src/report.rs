//! How algorithms say what they notice, without knowing to whom.

/// Takes what an algorithm notices besides its result.
pub trait Report {
    /// Something the user should know.
    fn warn(&self, message: &str);

    /// Progress, or the end of what was warned of.
    fn info(&self, message: &str);

    /// A named number.
    fn metric(&self, name: &str, value: f64);
}

/// Takes nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Report for Silent {
    fn warn(&self, _: &str) {}

    fn info(&self, _: &str) {}

    fn metric(&self, _: &str, _: f64) {}
}
