//! The file of an arrangement: one for each graph, in the user's folder for settings. An arrangement is a matter of a person and a screen, so it
//! is not stored beside the graph.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use panoscope_base::files;
use serde::{Deserialize, Serialize};

use super::{Dock, Layout, LayoutError, Panel, Window};
use crate::arguments::key;
use crate::disk;

/// Folder in the folder for settings.
const FOLDER: &str = "layouts";
/// Maximum size of a file, bytes; one with all panels has about 2 KB.
const MAX_BYTES: u64 = 64 * 1024;

/// A file that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{path} is not used: {reason}", path = path.display())]
pub struct BrokenLayout {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}

/// What stands in a file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stored {
    /// The graph that it is for.
    graph: String,
    #[serde(default)]
    open: BTreeSet<Panel>,
    #[serde(default)]
    viewer_beside: bool,
    #[serde(default)]
    windows: Vec<Window>,
    root: Dock,
}

impl Stored {
    /// Reads the text of a file.
    ///
    /// # Errors
    /// Why it is not the file of an arrangement.
    pub fn parse(text: &str) -> Result<(String, Layout), LayoutError> {
        let text_error = |error: toml::de::Error| LayoutError::Text { message: error.message().to_owned() };
        let stored: Self = toml::from_str(text).map_err(text_error)?;
        let Self { graph, open, viewer_beside, windows, root } = stored;
        Ok((graph, Layout { root, open, windows, viewer_beside }.checked()?))
    }

    /// The text of a file.
    ///
    /// # Errors
    /// A value cannot be written as TOML.
    pub fn text(graph: &str, layout: &Layout) -> Result<String, toml::ser::Error> {
        let Layout { root, open, windows, viewer_beside } = layout.clone();
        let stored = Self { graph: graph.to_owned(), open, viewer_beside, windows, root };
        toml::to_string(&stored)
    }
}

/// The file for a graph: its name, and a number (FNV-1a) that depends on its whole path.
fn file_of(folder: &Path, graph: &Path) -> PathBuf {
    let hash = key(graph)
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3));
    let stem = graph.file_stem().unwrap_or_default().to_string_lossy();
    folder.join(FOLDER).join(format!("{stem}-{hash:016x}.toml"))
}

/// The arrangement that a graph had last; `None` if it had none.
///
/// # Errors
/// Its file cannot be read or is broken.
pub fn recall(folder: &Path, graph: &Path) -> Result<Option<Layout>, BrokenLayout> {
    let path = file_of(folder, graph);
    let fail = |reason: String| BrokenLayout { path: path.clone(), reason };
    let text = match disk::read_text(&path, MAX_BYTES) {
        Ok(Some(text)) => text,
        Ok(None) => return Err(fail(format!("it has more than {MAX_BYTES} bytes"))),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(fail(error.to_string())),
    };
    let (of, layout) = Stored::parse(&text).map_err(|error| fail(error.to_string()))?;
    // Another graph with the same number.
    Ok((of == key(graph)).then_some(layout))
}

/// Stores the arrangement of a graph, completely or not at all.
///
/// # Errors
/// The file cannot be written.
pub fn remember(folder: &Path, graph: &Path, layout: &Layout) -> std::io::Result<()> {
    std::fs::create_dir_all(folder.join(FOLDER))?;
    let text = Stored::text(&key(graph), layout).map_err(std::io::Error::other)?;
    files::replace(&file_of(folder, graph), text.as_bytes())
}
