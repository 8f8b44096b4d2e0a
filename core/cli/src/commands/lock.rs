//! `panoscope lock`: fingerprints of a graph and of all that its run depends on, for the theatre to compare.

use std::path::{Path, PathBuf};

use anyhow::Result;
use panoscope_loader::lock::{ALWAYS_LOCKED, Lock, lock_path};

use crate::End;
use crate::given::Given;
use crate::terminal::{log, out, raw, stderr_color};
use panoscope_eval::graph_file;

/// Arguments of `lock`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    graph: PathBuf,
    #[command(flatten)]
    given: Given,
    /// Compares with the lock that is there, and writes nothing.
    #[arg(long)]
    verify: bool,
}

/// Writes or compares.
pub fn run(arguments: &Arguments) -> Result<End> {
    let path = &arguments.graph;
    let ready = match graph_file::open(path, &arguments.given.options(&[])) {
        Ok(ready) => ready,
        Err(diagnostics) => {
            log!("{}", diagnostics.render(stderr_color()).trim_end());
            return Ok(End::Wrong);
        }
    };
    let now = Lock::of(&ready.graph, &ready.catalog, &ready.loader, &ready.text, &ALWAYS_LOCKED);
    if arguments.verify {
        return verify(path, &now);
    }
    let missing: Vec<&str> = now.files.iter().filter(|f| f.sha256.is_empty()).map(|f| f.name.as_str()).collect();
    if !missing.is_empty() {
        log!("error: files that the graph names are not there: {}", missing.join(", "));
        return Ok(End::Wrong);
    }
    let was = Lock::read(path).ok().flatten();
    let file = now.write(path)?;
    let mut words = String::new();
    for file in &now.files {
        words += &format!("  {:<12} {:<28} {:>10} bytes  {}\n", file.kind, file.name, file.bytes, &file.sha256[..16]);
    }
    raw(&words);
    out!("{}: {} files locked", file.display(), now.files.len());
    for difference in was.iter().flat_map(|was| was.differences(&now)) {
        out!("  {difference}");
    }
    Ok(End::Done)
}

fn verify(path: &Path, now: &Lock) -> Result<End> {
    let Some(was) = Lock::read(path)? else {
        log!("error: {} was never locked: {} is not there", path.display(), lock_path(path).display());
        return Ok(End::Wrong);
    };
    let differences = was.differences(now);
    for difference in &differences {
        log!("error: {difference}");
    }
    if differences.is_empty() {
        out!("{}: as it was locked ({} files)", path.display(), now.files.len());
        return Ok(End::Done);
    }
    Ok(End::Failed)
}
