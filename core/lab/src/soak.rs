//! `panoscope soak`: runs a graph for minutes, optionally disturbed, and checks whether its memory, threads or open
//! files grow.

use std::path::PathBuf;

use anyhow::{Context, Result};
use panoscope_eval::soak::{Change, Disturbances, Disturber, Done, Soak};

use crate::foxglove;
use panoscope_cli::End;
use panoscope_cli::commands::run::{self, RunEnd, Running};
use panoscope_cli::judge::Weight;
use panoscope_cli::numbers::{NumberError, number_in};
use panoscope_cli::terminal::{log, raw};

/// Arguments of `soak`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Arguments {
    #[command(flatten)]
    run: run::Arguments,
    /// Duration, minutes.
    #[arg(long, default_value_t = 10.0, value_parser = minutes)]
    minutes: f64,
    /// Period of changes of the running graph, s: in turn a parameter changes and changes back, a sink is removed and
    /// added again.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    edit_every: Option<f64>,
    /// Period of kills of processes of isolated nodes, s, one group after the other. Faults of isolated nodes are then
    /// expected and do not fail the run.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    kill_every: Option<f64>,
    /// Writes every sample: seconds, memory, frames, frame memory, drops, faults, threads, open files, isolated
    /// processes.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
}

fn seconds(text: &str) -> Result<f64, NumberError> {
    number_in(text, 0.1..=100_000.0, "number of seconds", "0.1 to 100000 seconds")
}

fn minutes(text: &str) -> Result<f64, NumberError> {
    number_in(text, 0.05..=100_000.0, "number of minutes", "0.05 to 100000 minutes")
}

/// Runs a graph, disturbs it and monitors its resources.
pub fn run(arguments: &Arguments) -> Result<End> {
    let seconds = arguments.minutes * 60.0;
    let mut soak = Soak::new(seconds);
    let settings = Disturbances { edit_every_s: arguments.edit_every, kill_every_s: arguments.kill_every };
    let mut disturber = None;
    let ran =
        run::run_with(&arguments.run, None, foxglove::server(&arguments.run), |Running { live, expected_faults }| {
            let disturber = disturber.get_or_insert_with(|| {
                let graph = live.engine().graph();
                if arguments.kill_every.is_some() {
                    let isolated = graph.nodes.iter().filter(|node| node.isolate.is_some());
                    expected_faults.extend(isolated.map(|node| node.id.clone()));
                }
                Disturber::new(settings, live.text(), &graph, &live.loader().catalog_of_graph(&graph))
            });
            if soak.observe(live.engine()) >= seconds {
                // From here on a change would be refused.
                live.engine().stop();
            } else if let Some(reason) = disturber.disturb(live) {
                log!("warning: a change was refused: {reason}");
            }
        })?;
    let mut verdict = match ran {
        RunEnd::Not(end) => return Ok(end),
        RunEnd::Over { verdict, .. } => verdict,
    };
    let Some(last) = soak.samples().last() else { return Ok(run::conclude(&verdict)) };
    if let Some(path) = &arguments.csv {
        std::fs::write(path, soak.csv()).with_context(|| format!("cannot write {}", path.display()))?;
    }
    raw(&soak.curve());
    if arguments.edit_every.is_some() || arguments.kill_every.is_some() {
        let Done { edits, refused, kills } = disturber.map(|disturber| disturber.done()).unwrap_or_default();
        let processes = last.processes;
        raw(&format!("{edits} edits, {refused} refused; {kills} processes killed, {processes} started\n"));
    }
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
    for (what, change) in [("threads", soak.threads()), ("open files", soak.open_files())] {
        let Change { from, to } = change;
        raw(&format!("{what}: {from} after the warm-up, {to} at the end\n"));
        if change.is_leak() {
            verdict.add(Weight::Error, format!("{what} grow: {from} after the warm-up, {to} at the end"));
        }
    }
    Ok(run::conclude(&verdict))
}
