//! `panoscope record`: runs a graph and records it completely.

use std::path::PathBuf;

use anyhow::Result;
use panoscope_record::{RecordOptions, Recorded};

use super::run::{self, RunEnd};
use crate::End;
use crate::judge::{Verdict, Weight};
use crate::terminal::log;

/// Arguments of `record`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Arguments {
    #[command(flatten)]
    run: run::Arguments,
    /// The recording, an MCAP file.
    #[arg(long, short, value_name = "FILE.mcap")]
    output: PathBuf,
    /// Makes and records only the source outputs that the graph reads: smaller and faster, but another graph finds only
    /// these.
    #[arg(long)]
    read_ports_only: bool,
    /// Stores packets uncompressed: less work, a larger file.
    #[arg(long)]
    uncompressed: bool,
    #[command(flatten)]
    ports: Ports,
}

impl Arguments {
    /// The arguments of `run`.
    pub fn run(&self) -> &run::Arguments {
        &self.run
    }
}

/// Data recorded of all nodes, not only of sources.
#[derive(clap::Args)]
pub struct Ports {
    /// Records every output of every node, to compare two recordings frame by frame.
    #[arg(long)]
    pub all_ports: bool,
    /// Writes a fingerprint of every packet of every port, to compare two runs.
    #[arg(long, value_name = "FILE.json")]
    pub digests: Option<PathBuf>,
}

/// Records a run, with a server for `--foxglove`.
pub fn run(arguments: &Arguments, server: Option<Box<dyn run::Server>>) -> Result<End> {
    let options = RecordOptions {
        file: Some(arguments.output.clone()),
        digests: arguments.ports.digests.is_some(),
        all_ports: arguments.ports.all_ports,
        all_source_ports: !arguments.read_ports_only,
        compresses: !arguments.uncompressed,
        ..RecordOptions::default()
    };
    Ok(match run::run_with(&arguments.run, Some(options), server, |_| {})? {
        RunEnd::Not(end) => end,
        RunEnd::Over { mut verdict, recorded } => {
            if let Some(recorded) = recorded {
                told(&recorded, &arguments.output, &arguments.ports, &mut verdict);
            }
            run::conclude(&verdict)
        }
    })
}

/// Reports the result of a recording and writes its fingerprints.
pub fn told(recorded: &Recorded, file: &std::path::Path, ports: &Ports, verdict: &mut Verdict) {
    let mb = recorded.bytes as f64 / 1e6;
    log!("recorded {} source ticks, {mb:.1} MB: {}", recorded.ticks, file.display());
    if recorded.gaps > 0 {
        let words = format!(
            "{} ticks are not in the recording because the disk was too slow; --read-ports-only records less",
            recorded.gaps
        );
        verdict.add(Weight::Error, words);
    }
    if let Some(reason) = &recorded.failed {
        verdict.add(Weight::Error, reason.clone());
    }
    write_digests(recorded, ports, verdict);
}

/// Writes fingerprints if requested.
pub fn write_digests(recorded: &Recorded, ports: &Ports, verdict: &mut Verdict) {
    let (Some(path), Some(digests)) = (&ports.digests, &recorded.digests) else { return };
    match digests.write(path) {
        Ok(()) => {
            log!("fingerprints of {} packets on {} ports: {}", digests.packets(), digests.ports.len(), path.display());
        }
        Err(cause) => verdict.add(Weight::Error, format!("cannot write {}: {cause}", path.display())),
    }
}
