//! Claims of nodes on the files that they write.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::abi;

/// The file claims of one run. Harnesses that are opened with the same value act as nodes of one graph.
#[derive(Clone, Debug, Default)]
pub struct Files(Arc<Mutex<Claims>>);

#[derive(Debug, Default)]
struct Claims {
    /// How often a path was begun.
    begun: HashMap<String, u32>,
    /// Path, and the open node that claims it.
    held: Vec<(String, String)>,
}

/// A claim on a file that another node writes.
#[derive(Debug, thiserror::Error)]
#[error("node `{holder}` already writes {path}")]
pub(super) struct FileTaken {
    /// The node that writes the file.
    pub(super) holder: String,
    path: String,
}

impl Files {
    fn claims(&self) -> MutexGuard<'_, Claims> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// As the host's `claim_file`: returns the path to write.
    ///
    /// # Errors
    /// Another open node claims the file.
    pub(super) fn claim(&self, node: &str, path: &str, action: u32) -> Result<String, FileTaken> {
        let mut claims = self.claims();
        if let Some((_, other)) = claims.held.iter().find(|(held, by)| held == path && by != node) {
            return Err(FileTaken { holder: other.clone(), path: path.to_owned() });
        }
        if !claims.held.iter().any(|(held, by)| held == path && by == node) {
            claims.held.push((path.to_owned(), node.to_owned()));
        }
        if action == abi::CLAIM_HOLD {
            return Ok(path.to_owned());
        }
        let begun = claims.begun.entry(path.to_owned()).or_default();
        loop {
            *begun += 1;
            let file = part_name(path, *begun);
            if action == abi::CLAIM_BEGIN || !Path::new(&file).exists() {
                return Ok(file);
            }
        }
    }

    /// Drops the claims of a node.
    pub(super) fn release(&self, node: &str) {
        self.claims().held.retain(|(_, by)| by != node);
    }
}

fn part_name(path: &str, part: u32) -> String {
    let whole = Path::new(path);
    match (part, whole.extension().and_then(|e| e.to_str())) {
        (1, _) => path.to_owned(),
        (_, Some(ending)) => whole.with_extension(format!("part{part}.{ending}")).to_string_lossy().into_owned(),
        (_, None) => format!("{path}.part{part}"),
    }
}
