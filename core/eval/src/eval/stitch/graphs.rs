//! Graph files, checked and made fit for judging.

use std::path::Path;

use toml::{Table, Value};

use crate::error::{EvalError, FileAction, OnFile, Result};
use crate::graph_file;
use crate::inputs::wiring::Wiring;

/// Splits `NODE.PARAM=VALUE`; a value that is no TOML is taken as text.
pub fn setting(text: &str) -> Option<(&str, &str, Value)> {
    let (target, value) = text.split_once('=')?;
    let (node, param) = target.split_once('.')?;
    let parsed = format!("v = {value}").parse::<Table>().ok().and_then(|mut t| t.remove("v"));
    Some((node.trim(), param.trim(), parsed.unwrap_or_else(|| value.trim().into())))
}

/// Reads a graph file, checks it with its settings (`NODE.PARAM=VALUE`) and takes it apart.
///
/// # Errors
/// The graph has mistakes, or nothing in it can be judged.
pub fn wiring(path: &Path, settings: &[String]) -> Result<Wiring> {
    // All mistakes of the file as it stands, with their lines.
    if let Err(diagnostics) = graph_file::load(path, settings) {
        return Err(EvalError::Check { diagnostics });
    }
    let text = std::fs::read_to_string(path).on_file(FileAction::Read, path)?;
    let stem = path.file_stem().map_or_else(|| "graph".into(), |s| s.to_string_lossy());
    let mut wiring = Wiring::of(&text, &stem)
        .map_err(|error| EvalError::Options { reason: format!("{}: {error}", path.display()) })?;
    for (node, param, value) in settings.iter().filter_map(|text| setting(text)) {
        wiring.set(node, param, value);
    }
    Ok(wiring)
}
