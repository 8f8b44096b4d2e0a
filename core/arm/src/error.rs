//! What can be wrong with the description of an arm.

use thiserror::Error;

/// Why an arm cannot be used.
#[derive(Debug, Error)]
pub enum ArmError {
    /// The text is no URDF.
    #[error("the arm's description is no URDF: {reason}")]
    NoUrdf {
        /// What the reader said.
        reason: String,
    },
    /// A link that is needed.
    #[error("the arm's description has no link `{link}`: name {what} so")]
    NoLink {
        /// Its name.
        link: &'static str,
        /// What it stands for.
        what: &'static str,
    },
    /// Links that hang on themselves.
    #[error("the links of the arm's description go round in a circle at `{link}`")]
    Circle {
        /// One of them.
        link: String,
    },
    /// Another number of axes.
    #[error("{count} joints move between the base and `left_camera`, this software drives 6")]
    WrongAxes {
        /// Axes found.
        count: usize,
    },
    /// A joint that does not turn.
    #[error("joint `{joint}` is {kind}: between the base and `left_camera` all joints are `revolute` or `fixed`")]
    WrongKind {
        /// Its name.
        joint: String,
        /// Its type.
        kind: String,
    },
    /// A link that stands elsewhere than it has to.
    #[error("link `{link}` does not hang where it has to: {rule}")]
    Misplaced {
        /// Its name.
        link: &'static str,
        /// Where it has to be.
        rule: String,
    },
    /// A number that makes no sense.
    #[error("joint `{joint}`: {what} is {value}; {rule}")]
    BadNumber {
        /// Its name.
        joint: String,
        /// What the number is.
        what: &'static str,
        /// The number.
        value: f64,
        /// What it has to be.
        rule: &'static str,
    },
}
