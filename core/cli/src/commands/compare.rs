//! `panoscope compare`: the first difference of two runs, and its amount.

use std::path::{Path, PathBuf};

use anyhow::Result;
use panoscope_engine::text_table::table;
use panoscope_record::compare::{Content, FirstCell, PortDifference, compare, compare_recordings};
use panoscope_record::{Digests, Recording, RecordingError};

use crate::End;
use crate::numbers::{NumberError, number_in};
use crate::terminal::{log, raw};

/// Arguments of `compare`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A recording, or fingerprints written by `--digests`.
    a: PathBuf,
    /// Another one.
    b: PathBuf,
    /// Tolerance: table values are equal if they differ by at most this share of the larger one (at least of 1), points
    /// of clouds if they are at most this many mm apart.
    #[arg(long, default_value_t = 0.0, value_parser = tolerance)]
    tolerance: f64,
}

fn tolerance(text: &str) -> Result<f64, NumberError> {
    number_in(text, 0.0..=f64::MAX, "number", "a number from 0 on")
}

/// A run that cannot be compared.
#[derive(Debug, thiserror::Error)]
enum OpenError {
    /// Fingerprints that cannot be read.
    #[error("{}: {cause}; give a recording (.mcap) or fingerprints written by --digests (.json)", path.display())]
    Digests { path: PathBuf, cause: std::io::Error },
    /// A recording that cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
}

enum Run {
    Recording(Box<Recording>),
    Digests(Digests),
}

impl Run {
    fn open(path: &Path) -> Result<Self, OpenError> {
        if path.extension().is_some_and(|e| e == "json") {
            let digests = Digests::read(path).map_err(|cause| OpenError::Digests { path: path.to_owned(), cause })?;
            return Ok(Self::Digests(digests));
        }
        Ok(Self::Recording(Box::new(Recording::open(path)?)))
    }

    fn digests(&self) -> Digests {
        match self {
            Self::Recording(recording) => recording.digests(),
            Self::Digests(digests) => digests.clone(),
        }
    }
}

/// Compares two runs. Succeeds if they are equal.
pub fn run(arguments: &Arguments) -> Result<End> {
    let (a, b) = match (Run::open(&arguments.a), Run::open(&arguments.b)) {
        (Ok(a), Ok(b)) => (a, b),
        (a, b) => {
            for error in [a.err(), b.err()].into_iter().flatten() {
                log!("error: {error}");
            }
            return Ok(End::Wrong);
        }
    };
    let differences = match (&a, &b) {
        (Run::Recording(a), Run::Recording(b)) => match compare_recordings(a, b, arguments.tolerance) {
            Ok(differences) => differences,
            Err(error) => {
                log!("error: {error}");
                return Ok(End::Failed);
            }
        },
        _ => compare(&a.digests(), &b.digests()),
    };
    if differences.iter().all(|d| d.packets.0 == 0 || d.packets.1 == 0) {
        log!(
            "error: {} and {} have no port in common; record both with --all-ports, or of one graph",
            arguments.a.display(),
            arguments.b.display()
        );
        return Ok(End::Wrong);
    }
    Ok(show(differences))
}

/// Name of the parts of a packet.
fn parts(content: &Content) -> &'static str {
    match content {
        Content::Pixels => "pixels",
        Content::Table(..) => "cells",
        Content::Cloud { .. } => "points",
    }
}

/// Description of the difference of a table or cloud.
fn content(content: &Content) -> Option<String> {
    match content {
        Content::Pixels => None,
        Content::Table(tick, first) => Some(match first {
            FirstCell::Value(row, column, a, b) => {
                let by =
                    if a.is_finite() && b.is_finite() { format!(", {} apart", (a - b).abs()) } else { String::new() };
                format!("differs first at tick {tick}, row {row}, column `{column}`: {a} and {b}{by}")
            }
            FirstCell::Column(column, first) => {
                format!("at tick {tick} only the {} has column `{column}`", if *first { "first" } else { "second" })
            }
            FirstCell::Rows(a, b) => format!("at tick {tick} the first has {a} rows, the second {b}"),
        }),
        Content::Cloud { farthest, only_in_one, recoloured } => {
            let mut words = Vec::new();
            if let Some((tick, x, y)) = farthest {
                words.push(format!("points lie farthest apart at tick {tick}, column {x}, row {y}"));
            }
            if *only_in_one > 0 {
                words.push(format!("{only_in_one} points are known to one only"));
            }
            if *recoloured > 0 {
                words.push(format!("{recoloured} points have another colour"));
            }
            Some(words.join(", "))
        }
    }
}

fn show(mut differences: Vec<PortDifference>) -> End {
    let same = differences.iter().filter(|d| d.is_nothing()).count();
    let packets: usize = differences.iter().filter(|d| d.is_nothing()).map(|d| d.packets.0).sum();
    differences.retain(|d| !d.is_nothing());
    differences.sort_by_key(|d| (d.first.map(|(source, seq)| (seq, source)), d.port.clone()));
    raw(&format!("{same} ports are the same, {packets} packets\n"));
    if differences.is_empty() {
        return End::Done;
    }
    let mut rows = vec![
        ["port that differs", "first tick", "packets", "differ", "only in one", "largest", "mean", "share"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for difference in &differences {
        let (a, b) = difference.packets;
        let amount = |number: fn(&panoscope_record::compare::Amount) -> String| {
            difference.amount.as_ref().map_or_else(|| "-".to_owned(), number)
        };
        rows.push(vec![
            difference.port.clone(),
            difference.first.map_or_else(|| "-".to_owned(), |(_, seq)| seq.to_string()),
            format!("{a}, {b}"),
            difference.differing.to_string(),
            difference.missing.to_string(),
            amount(|a| format!("{:.4}", a.largest)),
            amount(|a| format!("{:.6}", a.mean)),
            amount(|a| match a.other_shape {
                0 => format!("{:.4} % of {}", a.share * 100.0, parts(&a.content)),
                n => format!("{n} of another size"),
            }),
        ]);
    }
    raw(&table(&rows));
    for difference in &differences {
        if let Some(words) = difference.amount.as_ref().and_then(|a| content(&a.content)) {
            raw(&format!("  `{}`: {words}\n", difference.port));
        }
    }
    if let Some(first) = differences.first() {
        let tick = first.first.map_or(0, |(_, seq)| seq);
        raw(&format!("first to differ: `{}` at tick {tick}\n", first.port));
    }
    End::Failed
}
