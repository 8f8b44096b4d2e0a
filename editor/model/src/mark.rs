//! Frames and notes on the canvas, as stored in the graph file.

/// A frame or a note. The height of a note follows from its text.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Title of a frame, text of a note.
    pub text: String,
    /// Upper left corner, in points of the graph.
    pub at: (f32, f32),
    /// Width and height of a frame; `None` for a note.
    pub size: Option<(f32, f32)>,
}
