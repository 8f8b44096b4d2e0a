//! Figures of benches and evaluations; their JSON is a contract, see the README.

use std::path::Path;

use panoscope_engine::text_table;
use serde::Serialize;

use crate::error::{FileAction, OnFile, Result};

/// One figure.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// Name, `<measure>` or `<measure>/<case>`.
    pub name: String,
    /// Measured value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Peer that it is compared with, if there is one.
    pub peer: Option<String>,
    /// Value of the peer in the same run.
    pub peer_value: Option<f64>,
    /// Comparison with the peer; above 1: better than the peer.
    pub ratio: Option<f64>,
    /// Cores this process may use.
    pub cores: usize,
    /// Description of the input.
    pub input: String,
}

impl Figure {
    /// A figure without a peer.
    pub fn new(name: &str, value: f64, unit: &'static str, input: &str) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            name: name.to_owned(),
            value,
            unit,
            peer: None,
            peer_value: None,
            ratio: None,
            cores,
            input: input.to_owned(),
        }
    }

    /// Adds a peer to a figure for which smaller is better.
    pub fn beside(mut self, peer: &str, peer_value: Option<f64>) -> Self {
        if let Some(peer_value) = peer_value {
            self.peer = Some(peer.to_owned());
            self.peer_value = Some(peer_value);
            self.ratio = (self.value > 0.0 && peer_value.is_finite()).then(|| peer_value / self.value);
        }
        self
    }
}

/// Figures as a table for a terminal.
pub fn table(figures: &[Figure]) -> String {
    let text = |n: f64| if n.abs() >= 1000.0 { format!("{n:.0}") } else { format!("{n:.3}") };
    let mut rows = vec![["measure", "value", "unit", "peer", "ratio"].map(str::to_owned).to_vec()];
    for f in figures {
        let peer = match (&f.peer, f.peer_value) {
            (Some(peer), Some(value)) => format!("{} ({peer})", text(value)),
            _ => String::new(),
        };
        let ratio = f.ratio.map_or_else(String::new, |r| format!("{r:.2}"));
        rows.push(vec![f.name.clone(), text(f.value), f.unit.to_owned(), peer, ratio]);
    }
    text_table::table(&rows)
}

/// Figures as JSON, a list of objects.
///
/// # Errors
/// A value cannot be written as JSON.
pub fn json(figures: &[Figure]) -> Result<String> {
    Ok(serde_json::to_string_pretty(figures)? + "\n")
}

/// Writes figures as JSON into a file.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, figures: &[Figure]) -> Result<()> {
    std::fs::write(path, json(figures)?).on_file(FileAction::Write, path)
}

#[cfg(test)]
mod tests {
    use super::Figure;

    #[test]
    fn figures_have_the_fields_of_the_contract() {
        let figure = Figure::new("hop_inline", 50.0, "ns", "640x480 bgr8").beside("GStreamer identity", Some(100.0));
        let json = serde_json::to_value(&figure).unwrap();
        let mut keys: Vec<&str> = json.as_object().unwrap().keys().map(String::as_str).collect();
        keys.sort_unstable();
        assert_eq!(keys, ["cores", "input", "name", "peer", "peer_value", "ratio", "unit", "value"]);
        assert_eq!(json["ratio"], 2.0);
    }
}
