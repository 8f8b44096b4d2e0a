//! Frames and notes on the canvas, as the graph file keeps them.

/// A frame or a note. A note has no height: its text gives it.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Title of a frame, text of a note.
    pub text: String,
    /// Upper left corner, in points of the graph.
    pub at: (f32, f32),
    /// Width and height of a frame.
    pub size: Option<(f32, f32)>,
}
