//! copper-rs as a peer of a hop: the same chains as tasks of a graph that is compiled into a program, without logs.
//!
//! The program is built when it is asked for, by cargo, in a folder of the user's cache, so that only the first run
//! compiles copper.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_host::loader::cache_folder;

use crate::error::{EvalError, FileAction, OnFile, Result};
use crate::session::{Session, check_cancelled, note};

/// Name of the peer in figures.
pub const NAME: &str = "copper-rs 1.3.1";

const MANIFEST: &str = r#"[package]
name = "copper_peer"
version = "0.0.0"
edition = "2024"

[dependencies]
bincode = { package = "cu-bincode", version = "2", features = ["derive"] }
cu29 = "=1.3.1"
serde = { version = "1", features = ["derive"] }

[workspace]
"#;
// copper's macros look for the texts of its log there.
const BUILD: &str = "fn main() {\n    println!(\"cargo:rustc-env=LOG_INDEX_DIR={}\", std::env::var(\"OUT_DIR\").unwrap_or_default());\n}\n";
const PROGRAM: &str = include_str!("copper_peer.rs");

/// The built program.
pub struct Copper {
    program: PathBuf,
}

impl Copper {
    /// Builds the program with a chain of each of the lengths.
    ///
    /// # Errors
    /// There is no cargo, a crate cannot be fetched, or a file cannot be written.
    pub fn build(session: &dyn Session, lengths: &[usize]) -> Result<Self> {
        let missing =
            || EvalError::Peer { reason: "copper is built in the cache folder: set HOME or XDG_CACHE_HOME".to_owned() };
        let folder = cache_folder().ok_or_else(missing)?.join("panoscope/copper_peer");
        write_project(&folder, lengths)?;
        check_cancelled(session)?;
        note!(session, "copper is built in {} (some minutes at first)", folder.display());
        let mut cargo = Command::new("cargo");
        // Settings of a surrounding build would compile it in another way.
        for variable in ["CARGO_TARGET_DIR", "RUSTFLAGS", "RUSTC_WORKSPACE_WRAPPER", "CARGO_ENCODED_RUSTFLAGS"] {
            cargo.env_remove(variable);
        }
        let built = cargo.args(["build", "--release", "--quiet"]).current_dir(&folder).output();
        let built = built.on_file(FileAction::Start, "cargo")?;
        if !built.status.success() {
            let text = String::from_utf8_lossy(&built.stderr);
            let reason = text.lines().find(|line| line.starts_with("error")).unwrap_or("cargo gave no reason");
            return Err(EvalError::Peer {
                reason: format!("copper was not built: {reason}; run `cargo build --release` in {}", folder.display()),
            });
        }
        Ok(Self { program: folder.join("target/release/copper_peer") })
    }

    /// Time of one tick through a source, `length` tasks and a sink, ns.
    ///
    /// # Errors
    /// The program failed, or has no such chain.
    pub fn ns_per_tick(&self, length: usize, ticks: u64) -> Result<f64> {
        let run = Command::new(&self.program).args([length.to_string(), ticks.to_string()]).output();
        let run = run.on_file(FileAction::Start, &self.program)?;
        let text = String::from_utf8_lossy(&run.stdout);
        text.trim().parse().map_err(|_| EvalError::Peer {
            reason: format!("copper did not run {length} tasks: {}", String::from_utf8_lossy(&run.stderr).trim()),
        })
    }
}

/// Writes the program's files, only those that changed, so that cargo compiles only these.
fn write_project(folder: &Path, lengths: &[usize]) -> Result<()> {
    let source = folder.join("src");
    std::fs::create_dir_all(&source).on_file(FileAction::Create, &source)?;
    let mut files = vec![
        ("Cargo.toml".to_owned(), MANIFEST.to_owned()),
        ("build.rs".to_owned(), BUILD.to_owned()),
        ("src/main.rs".to_owned(), program(lengths)),
    ];
    files.extend(lengths.iter().map(|&length| (format!("chain_{length}.ron"), graph(length))));
    for (name, text) in files {
        let path = folder.join(name);
        if std::fs::read_to_string(&path).is_ok_and(|old| old == text) {
            continue;
        }
        std::fs::write(&path, text).on_file(FileAction::Write, &path)?;
    }
    Ok(())
}

/// The program's text, with a module and a case for each length.
fn program(lengths: &[usize]) -> String {
    let (mut modules, mut cases) = (String::new(), String::new());
    for length in lengths {
        let _ = writeln!(modules, "chain!(chain_{length}, \"chain_{length}.ron\");");
        let _ = writeln!(cases, "        {length} => chain_{length}::ns_per_tick(&log, ticks),");
    }
    PROGRAM.replace("// CHAINS\n", &modules).replace("        // LENGTHS\n", &cases)
}

/// copper's graph: a source, `length` tasks in a row, a sink.
fn graph(length: usize) -> String {
    let tasks: Vec<String> = (0..length).map(|index| format!("pass_{index}")).collect();
    let all: Vec<&str> =
        std::iter::once("source").chain(tasks.iter().map(String::as_str)).chain(std::iter::once("sink")).collect();
    let mut text =
        "(\n    logging: (enable_task_logging: false, enable_keyframe_logging: false),\n    tasks: [\n".to_owned();
    for name in &all {
        let kind = match *name {
            "source" => "Source",
            "sink" => "Sink",
            _ => "Pass",
        };
        let _ = writeln!(text, "        (id: \"{name}\", type: \"{kind}\"),");
    }
    text.push_str("    ],\n    cnx: [\n");
    for pair in all.windows(2) {
        let _ = writeln!(text, "        (src: \"{}\", dst: \"{}\", msg: \"Packet\"),", pair[0], pair[1]);
    }
    text.push_str("    ],\n)\n");
    text
}

#[cfg(test)]
mod tests {
    use super::{graph, program};

    #[test]
    fn each_chain_has_its_graph_its_module_and_its_case() {
        let text = program(&[1, 64]);
        for part in
            ["chain!(chain_64, \"chain_64.ron\");", "1 => chain_1::ns_per_tick(&log, ticks),", "64 => chain_64::"]
        {
            assert!(text.contains(part), "{part}");
        }
        let text = graph(2);
        let count = |part: &str| text.matches(part).count();
        assert_eq!((count("type: \"Pass\""), count("src:"), count("type: \"Sink\"")), (2, 3, 1), "{text}");
        assert!(text.contains("(src: \"pass_0\", dst: \"pass_1\", msg: \"Packet\")"), "{text}");
    }
}
