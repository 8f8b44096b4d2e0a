//! `panoscope soak`: runs a graph for minutes and says whether its memory grows.

use std::path::PathBuf;

use anyhow::{Context, Result};
use panoscope_eval::soak::Soak;

use super::run::{self, RunEnd};
use crate::End;
use crate::judge::Weight;
use crate::numbers::{NumberError, number_in};
use crate::terminal::raw;

/// Arguments of `soak`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Arguments {
    #[command(flatten)]
    run: run::Arguments,
    /// How long.
    #[arg(long, default_value_t = 10.0, value_parser = minutes)]
    minutes: f64,
    /// Writes every sample: seconds, memory, frames, frame memory, drops, faults.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
}

fn minutes(text: &str) -> Result<f64, NumberError> {
    number_in(text, 0.05..=100_000.0, "number of minutes", "0.05 to 100000 minutes")
}

/// Runs a graph and watches its memory.
pub fn run(arguments: &Arguments) -> Result<End> {
    let mut soak = Soak::default();
    let ran = run::run_with(&arguments.run, None, |engine| {
        if soak.observe(engine) >= arguments.minutes * 60.0 {
            engine.stop();
        }
    })?;
    let mut verdict = match ran {
        RunEnd::Not(end) => return Ok(end),
        RunEnd::Over { verdict, .. } => verdict,
    };
    if soak.samples().is_empty() {
        return Ok(run::conclude(&verdict));
    }
    if let Some(path) = &arguments.csv {
        std::fs::write(path, soak.csv()).with_context(|| format!("cannot write {}", path.display()))?;
    }
    raw(&soak.curve());
    let growth = soak.growth();
    raw(&format!(
        "after warm-up ({:.0} s on): {:+.1} MB per hour, standard error {:.1}, at {:.1} MB resident\n",
        growth.from_seconds, growth.mb_per_hour, growth.error_mb_per_hour, growth.resident_mb
    ));
    if growth.is_leak() {
        let tolerated = growth.tolerated_mb_per_hour;
        verdict.add(Weight::Error, format!("memory grows: more than {tolerated:.1} MB per hour"));
    } else {
        raw("memory does not grow\n");
    }
    Ok(run::conclude(&verdict))
}
