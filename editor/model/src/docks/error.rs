//! Errors of arrangements.

use super::{MAX_DEPTH, Panel, SIZES};

/// Why an arrangement of a file cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LayoutError {
    /// The text is not one of an arrangement.
    #[error("{message}")]
    Text {
        /// The parser's message.
        message: String,
    },
    /// More parts inside each other than are read.
    #[error("it is more than {MAX_DEPTH} levels deep")]
    TooDeep,
    /// A panel is in several places.
    #[error("the panel `{panel:?}` has several places")]
    Twice {
        /// The panel.
        panel: Panel,
    },
    /// The graph is missing.
    #[error("the graph has no place")]
    NoGraph,
    /// A part is too small or too large.
    #[error("a size is {size}, allowed are {} to {}", SIZES.start(), SIZES.end())]
    Size {
        /// Its share.
        size: f32,
    },
    /// A part is empty.
    #[error("a part has no panel")]
    NoPanel,
    /// A window is out of reach.
    #[error("the window of `{panel:?}` has no usable place")]
    WindowPlace {
        /// Its panel.
        panel: Panel,
    },
    /// The graph is in a window, or a panel in two.
    #[error("the panel `{panel:?}` cannot have this window")]
    Window {
        /// The panel.
        panel: Panel,
    },
}
