//! Errors in the description of an arm.

use thiserror::Error;

/// An arm that cannot be used.
#[derive(Debug, Error)]
pub enum ArmError {
    /// The text is not a URDF.
    #[error("the arm's description is not a URDF: {reason}")]
    NoUrdf {
        /// The parser's message.
        reason: String,
    },
    /// A required link is missing.
    #[error("the arm's description has no link `{link}`: give {what} this name")]
    NoLink {
        /// Name of the link.
        link: &'static str,
        /// Meaning of the name.
        what: &'static str,
    },
    /// Links that form a cycle.
    #[error("the links of the arm's description have a cycle at `{link}`")]
    Circle {
        /// One of them.
        link: String,
    },
    /// Another number of axes.
    #[error("{count} joints move between the base and `left_camera`, but this software supports exactly 6")]
    WrongAxes {
        /// Axes found.
        count: usize,
    },
    /// A joint that is not revolute.
    #[error("joint `{joint}` is {kind}: between the base and `left_camera` all joints are `revolute` or `fixed`")]
    WrongKind {
        /// Name of the joint.
        joint: String,
        /// Its type.
        kind: String,
    },
    /// A link at the wrong position in the chain.
    #[error("link `{link}` has the wrong parent: {rule}")]
    Misplaced {
        /// Name of the link.
        link: &'static str,
        /// The rule for its position.
        rule: String,
    },
    /// An invalid number.
    #[error("joint `{joint}`: {what} is {value}; {rule}")]
    BadNumber {
        /// Name of the joint.
        joint: String,
        /// Meaning of the number.
        what: &'static str,
        /// The number.
        value: f64,
        /// The rule for it.
        rule: &'static str,
    },
}
