//! Files that nodes of one run claim.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::abi;

/// The files of one run. Harnesses that are opened with the same value act as nodes of one graph.
#[derive(Clone, Debug, Default)]
pub struct Files(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    /// How often a path was begun.
    begun: HashMap<String, u32>,
    /// Path and the open node that holds it.
    held: Vec<(String, String)>,
}

impl Files {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// As the host's `claim_file`: the path to write, or the node that holds it.
    pub(super) fn claim(&self, node: &str, path: &str, action: u32) -> Result<String, String> {
        let mut state = self.state();
        if let Some((_, other)) = state.held.iter().find(|(held, by)| held == path && by != node) {
            return Err(other.clone());
        }
        if !state.held.iter().any(|(held, by)| held == path && by == node) {
            state.held.push((path.to_owned(), node.to_owned()));
        }
        if action == abi::CLAIM_HOLD {
            return Ok(path.to_owned());
        }
        let begun = state.begun.entry(path.to_owned()).or_default();
        loop {
            *begun += 1;
            let file = part_name(path, *begun);
            if action == abi::CLAIM_BEGIN || !Path::new(&file).exists() {
                return Ok(file);
            }
        }
    }

    /// Gives back what a node held.
    pub(super) fn release(&self, node: &str) {
        self.state().held.retain(|(_, by)| by != node);
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
