//! Tracks of tips written by `write_table`: CSV and JSON lines, read line by line.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use crate::error::{Context, Result, bail};
use panoscope_arm_core::tracking::skill::Sample;

/// A line of a track.
#[derive(Clone, Debug)]
pub struct Row {
    /// Capture time, s.
    pub at_s: f64,
    /// The current phase, if the file has it.
    pub phase: Option<String>,
    /// The tip, while it is visible.
    pub tip: Option<Tip>,
}

/// A tip of a track.
#[derive(Clone, Copy, Debug)]
pub struct Tip {
    /// Number of the tool; -1 if the file has none.
    pub track_id: i64,
    /// Class of the tool, if the file has it.
    pub class_index: Option<u32>,
    /// Sample for the session.
    pub sample: Sample,
}

/// Maximum prediction that still counts as visible, ms.
const MAX_GAP_MS: f64 = 150.0;

enum Form {
    Csv(Vec<String>),
    Lines,
}

/// A file that is read.
pub struct Track {
    path: PathBuf,
    lines: std::io::Lines<BufReader<File>>,
    form: Form,
    line: u64,
    last_s: f64,
    ready: std::collections::VecDeque<Row>,
}

/// Cells of a CSV line; none while a quoted cell continues in the next line.
fn cells(line: &str) -> Option<Vec<String>> {
    let (mut cells, mut cell, mut is_quoted) = (Vec::new(), String::new(), false);
    let mut chars = line.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '"' if is_quoted && chars.peek() == Some(&'"') => {
                chars.next();
                cell.push('"');
            }
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(std::mem::take(&mut cell)),
            c => cell.push(c),
        }
    }
    cells.push(cell);
    (!is_quoted).then_some(cells)
}

/// Makes a row from named numbers and texts.
fn row(at_s: f64, number: &dyn Fn(&str) -> f64, word: &dyn Fn(&str) -> Option<String>) -> Row {
    let place = |x: &str, y: &str, z: &str| -> Option<[f64; 3]> {
        let place = [x, y, z].map(number);
        place.iter().all(|v| v.is_finite()).then_some(place)
    };
    let camera = place("x_mm", "y_mm", "z_mm").or_else(|| place("tip.xyz_mm_0", "tip.xyz_mm_1", "tip.xyz_mm_2"));
    // Where the scope stood still or its pose is not known, the camera's frame has to do.
    let room = place("room_x_mm", "room_y_mm", "room_z_mm").or(camera);
    let either = |a: &str, b: &str| Some(number(a)).filter(|v| v.is_finite()).unwrap_or_else(|| number(b));
    let gap_ms = number("gap_ms");
    let tip = room.filter(|_| gap_ms.is_nan() || gap_ms <= MAX_GAP_MS).map(|place_mm| {
        let (id, class) = (either("track_id", "tip.track_id"), either("class_index", "tip.class_index"));
        Tip {
            track_id: if id.is_finite() { id as i64 } else { -1 },
            class_index: class.is_finite().then_some(class as u32),
            sample: Sample {
                at_s,
                place_mm,
                depth_mm: camera.map_or(place_mm[2], |camera| camera[2]),
                tissue_mm: number("tissue_mm"),
            },
        }
    });
    Row { at_s, phase: word("phase").or_else(|| word("text")), tip }
}

impl Track {
    /// Opens a file and reads its columns.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display();
        let file = File::open(path).with_context(|| format!("cannot read {name}"))?;
        let mut lines = BufReader::new(file).lines();
        let is_csv = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
        let mut line = 0;
        let form = if is_csv {
            let head = lines.next().with_context(|| format!("{name} is empty: no tip was written"))?;
            let head = head.with_context(|| format!("{name}, line 1"))?;
            line = 1;
            let columns =
                cells(head.trim_end()).with_context(|| format!("{name}: the first line ends inside a quoted name"))?;
            let has = |names: &[&str]| names.iter().all(|n| columns.iter().any(|c| c == n));
            if !has(&["capture_ms"]) && !has(&["time_s"]) {
                bail!(
                    "{name} has no column `capture_ms` or `time_s`: give a table of `tip_track` or `proximity`, or a tip, as `write_table` writes it"
                );
            }
            let is_track = has(&["x_mm", "y_mm", "z_mm"])
                || has(&["room_x_mm", "room_y_mm", "room_z_mm"])
                || has(&["tip.xyz_mm_0", "tip.xyz_mm_1", "tip.xyz_mm_2"]);
            if !is_track {
                bail!(
                    "{name} has no columns of positions (`x_mm`, `y_mm`, `z_mm`): give a table of `tip_track` or `proximity`, or a tip"
                );
            }
            Form::Csv(columns)
        } else {
            Form::Lines
        };
        let path = path.to_owned();
        Ok(Self { path, lines, form, line, last_s: f64::NEG_INFINITY, ready: Default::default() })
    }

    /// Time of the next row; none at the end.
    pub fn next_s(&mut self) -> Result<Option<f64>> {
        self.fill()?;
        Ok(self.ready.front().map(|row| row.at_s))
    }

    /// Takes the next row.
    pub fn take(&mut self) -> Option<Row> {
        self.ready.pop_front()
    }

    fn fill(&mut self) -> Result<()> {
        while self.ready.is_empty() {
            let Some(line) = self.lines.next() else { return Ok(()) };
            let place = |line: u64| format!("{}, line {line}", self.path.display());
            let mut text = line.with_context(|| place(self.line + 1))?;
            self.line += 1;
            if text.trim().is_empty() {
                continue;
            }
            let rows = match &self.form {
                Form::Csv(columns) => {
                    let found = loop {
                        if let Some(cells) = cells(&text) {
                            break Some(cells);
                        }
                        let Some(more) = self.lines.next() else { break None };
                        self.line += 1;
                        text.push('\n');
                        text.push_str(&more.with_context(|| place(self.line))?);
                    };
                    // A crash can cut the last line off: what is missing is lost, not wrong.
                    let Some(cells) = found.filter(|cells| cells.len() == columns.len()) else {
                        if self.lines.next().is_none() {
                            return Ok(());
                        }
                        bail!(
                            "{} has another number of cells than the first line: was the file written by two runs?",
                            place(self.line)
                        );
                    };
                    let cell = |name: &str| columns.iter().position(|c| c == name).map(|at| cells[at].as_str());
                    let number = |name: &str| cell(name).and_then(|c| c.trim().parse().ok()).unwrap_or(f64::NAN);
                    let word = |name: &str| cell(name).filter(|c| !c.is_empty()).map(str::to_owned);
                    let at_s =
                        if cell("capture_ms").is_some() { number("capture_ms") * 1e-3 } else { number("time_s") };
                    vec![row(at_s, &number, &word)]
                }
                Form::Lines => {
                    let Ok(value) = serde_json::from_str::<serde_json::Value>(&text) else {
                        if self.lines.next().is_none() {
                            return Ok(());
                        }
                        bail!("{} is not JSON: give a .csv or .jsonl file of `write_table`", place(self.line));
                    };
                    let at_s = value["capture_ms"].as_f64().map_or(f64::NAN, |ms| ms * 1e-3);
                    let word = |name: &str| value[name].as_str().map(str::to_owned);
                    let none = serde_json::Value::Null;
                    let of = |part: &serde_json::Value| {
                        let number = |name: &str| {
                            let name = name.strip_prefix("tip.").unwrap_or(name);
                            let axis = name.strip_prefix("xyz_mm_").and_then(|k| k.parse::<usize>().ok());
                            axis.map_or(&part[name], |k| &part["xyz_mm"][k]).as_f64().unwrap_or(f64::NAN)
                        };
                        row(at_s, &number, &word)
                    };
                    match (value["table"].as_array(), &value["tip"]) {
                        (Some(rows), _) if !rows.is_empty() => rows.iter().map(of).collect(),
                        (_, tip) if tip.is_object() => vec![of(tip)],
                        _ => vec![of(&none)],
                    }
                }
            };
            for row in rows {
                if !row.at_s.is_finite() {
                    bail!("{} has no time: `capture_ms` is missing or not a number", place(self.line));
                }
                if row.at_s < self.last_s {
                    bail!(
                        "{}: time goes back, from {:.3} to {:.3} s: was the file written by two runs?",
                        place(self.line),
                        self.last_s,
                        row.at_s
                    );
                }
                self.last_s = row.at_s;
                self.ready.push_back(row);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::cells;

    #[test]
    fn quoted_cells_keep_commas_quotes_and_ends_of_lines() {
        assert_eq!(cells("1,\"a, \"\"b\"\"\",,x").unwrap(), ["1", "a, \"b\"", "", "x"]);
        assert_eq!(cells("1,\"a"), None);
        assert_eq!(cells("1,\"a\nb\"").unwrap(), ["1", "a\nb"]);
    }
}
