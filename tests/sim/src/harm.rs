//! Kinds of misbehaviour of simulated nodes.

use panoscope_node::Choice;

/// Kind of misbehaviour.
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
    /// A frame of NaN.
    Nan,
    /// A frame of another size.
    WrongSize,
    /// A frame of a format that the reader does not accept.
    WrongFormat,
    /// A description that claims more bytes than the buffer has.
    WrongLength,
    /// No frame.
    Nothing,
    /// A frame larger than the maximum.
    TooMuch,
    /// The call takes longer than its budget.
    Slow,
    /// Every frame is retained forever.
    Leak,
    /// A frame that is retained once is released twice.
    ReleaseTwice,
    /// The capture time of the previous tick. Sources only.
    Repeat,
    /// A capture time slightly before that of the previous tick. Sources only.
    Reorder,
    /// Capture times at the limits of the integer. Sources only.
    Extreme,
    /// Capture times jump back by 10 s once. Sources only.
    Rewind,
    /// Reopening fails a few times.
    RefuseOpen,
    /// Reopening does not return for `hang_ms`.
    HangInOpen,
    /// Closing does not return for `hang_ms`.
    HangInClose,
    /// Saving the state does not return for `hang_ms`.
    HangInSave,
    /// Loading a state does not return for `hang_ms`.
    HangInLoad,
}
