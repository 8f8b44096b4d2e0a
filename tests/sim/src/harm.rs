//! What simulated nodes do wrong.

use panoscope_node::Choice;

/// What goes wrong.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Harm {
    /// Nothing.
    Never,
    /// The call returns an error.
    Error,
    /// The call panics.
    Panic,
    /// The call does not return for `hang_ms`.
    Hang,
    /// A chunk of a parallel loop does not return for `hang_ms`.
    HangInLoop,
    /// A chunk of a loop inside a chunk of a loop does not return for `hang_ms`.
    HangInNestedLoop,
    /// A picture of NaN.
    Nan,
    /// A picture of another size.
    WrongSize,
    /// A picture of a format that the reader does not take.
    WrongFormat,
    /// A description that claims more bytes than the buffer has.
    WrongLength,
    /// No picture.
    Nothing,
    /// A picture larger than any may be.
    TooMuch,
    /// The call takes longer than its budget.
    Slow,
    /// Every picture is retained for ever.
    Leak,
    /// A picture that is retained once is released twice.
    ReleaseTwice,
    /// The capture time of the tick before. Sources only.
    Repeat,
    /// A capture time a little before that of the tick before. Sources only.
    Reorder,
    /// Capture times at the ends of what the number holds. Sources only.
    Extreme,
    /// Capture times jump back by 10 s once. Sources only.
    Rewind,
    /// Opening again fails a few times.
    RefuseOpen,
    /// Opening again does not return for `hang_ms`.
    HangInOpen,
    /// Closing does not return for `hang_ms`.
    HangInClose,
    /// Saving the state does not return for `hang_ms`.
    HangInSave,
    /// Loading a state does not return for `hang_ms`.
    HangInLoad,
}
