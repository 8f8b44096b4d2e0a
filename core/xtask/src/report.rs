//! Summary of a report of `panoscope run --report`.

use std::fmt::Write;

use anyhow::{Context, Result};
use serde_json::Value;

/// A report as text, with its failures.
pub struct Summary {
    pub text: String,
    pub frames: u64,
    pub faults: u64,
}

impl Summary {
    /// Reads the report's JSON.
    ///
    /// # Errors
    /// A field of the contract (`frames`, `seconds`, `fps`, `nodes`) is missing.
    pub fn from_json(text: &str) -> Result<Self> {
        let report: Value = serde_json::from_str(text).context("the report is not JSON")?;
        let number =
            |value: &Value, key: &str| value[key].as_f64().with_context(|| format!("the report has no `{key}`"));
        let frames = report["frames"].as_u64().context("the report has no `frames`")?;
        let nodes = report["nodes"].as_object().context("the report has no `nodes`")?;
        let (seconds, fps) = (number(&report, "seconds")?, number(&report, "fps")?);

        let mut text = String::new();
        let mut faults = 0;
        let width = nodes.keys().map(|id| id.len()).max().unwrap_or(0).max("node".len());
        let name = report["graph"].as_str().unwrap_or("graph");
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{name}: {frames} frames in {seconds:.1} s, {fps:.1} fps");
        let _ = writeln!(
            text,
            "{:width$} {:>8} {:>9} {:>9} {:>9} {:>8} {:>7} {:>7}",
            "node", "count", "p50 ms", "p99 ms", "max ms", "dropped", "faults", "copies"
        );
        for (id, node) in nodes {
            let ms = |key: &str| node[key].as_f64().map_or("-".to_owned(), |ms| format!("{ms:.2}"));
            let count = |key: &str| node[key].as_u64().map_or("-".to_owned(), |count| count.to_string());
            faults += node["faults"].as_u64().unwrap_or(0);
            let _ = writeln!(
                text,
                "{id:width$} {:>8} {:>9} {:>9} {:>9} {:>8} {:>7} {:>7}",
                count("count"),
                ms("p50_ms"),
                ms("p99_ms"),
                ms("max_ms"),
                count("dropped"),
                count("faults"),
                count("copies")
            );
        }
        for (sink, path) in report["paths"].as_object().into_iter().flatten() {
            let ms = |key: &str| path[key].as_f64().map_or("-".to_owned(), |ms| format!("{ms:.1}"));
            let (p50, p99, max) = (ms("age_p50_ms"), ms("age_p99_ms"), ms("age_max_ms"));
            let _ = writeln!(text, "age at {sink}: p50 {p50} ms, p99 {p99} ms, max {max} ms");
        }
        Ok(Self { text, frames, faults })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REPORT: &str = r#"{"graph": "panorama", "frames": 300, "seconds": 6.0, "fps": 50.0,
        "nodes": {"register": {"count": 300, "p50_ms": 9.5, "p99_ms": 14.25, "max_ms": 20.0, "dropped": 3, "faults": 0, "copies": 0},
                  "out": {"count": 297, "p50_ms": 1.0, "p99_ms": 2.0, "max_ms": 3.0, "dropped": 0, "faults": 2, "copies": 0}},
        "paths": {"out": {"age_p50_ms": 20.0, "age_p99_ms": 31.5, "age_max_ms": 40.0}},
        "allocations_per_frame": null, "machine": "two cores"}"#;

    #[test]
    fn every_node_and_path_is_told() {
        let summary = Summary::from_json(REPORT).unwrap();
        assert_eq!((summary.frames, summary.faults), (300, 2));
        let lines: Vec<&str> = summary.text.lines().collect();
        assert_eq!(lines[0], "panorama: 300 frames in 6.0 s, 50.0 fps");
        let register = lines.iter().find(|line| line.starts_with("register")).unwrap();
        assert_eq!(
            register.split_whitespace().collect::<Vec<_>>(),
            ["register", "300", "9.50", "14.25", "20.00", "3", "0", "0"]
        );
        assert_eq!(*lines.last().unwrap(), "age at out: p50 20.0 ms, p99 31.5 ms, max 40.0 ms");
    }

    #[test]
    fn a_report_without_its_figures_is_an_error() {
        for (text, missing) in [("{}", "frames"), (r#"{"frames": 1, "nodes": {}}"#, "seconds"), ("no", "JSON")] {
            let error = Summary::from_json(text).err().unwrap();
            assert!(error.to_string().contains(missing), "{error}");
        }
    }
}
