//! `cargo xtask fuzz --coverage`: which lines of the parsers the corpora of the fuzz targets reach.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::process;
use crate::workspace::Workspace;

/// The test that replays the corpora, and its package.
const PACKAGE: &str = "panoscope-fuzz-targets";
const TEST: &str = "corpora";
/// Least share of the lines of a parser, percent.
const LEAST_PERCENT: f64 = 85.0;

/// Parsers of foreign bytes, and their sources: files, or folders that end with a slash.
const PARSERS: &[(&str, &[&str])] = &[
    (
        "graph",
        &[
            "core/graph/src/parse.rs",
            "core/graph/src/text.rs",
            "core/graph/src/parts.rs",
            "core/graph/src/args.rs",
            "core/graph/src/shape.rs",
            "core/graph/src/file.rs",
            "core/graph/src/check/",
        ],
    ),
    ("descriptor", &["core/graph/src/from_abi.rs", "core/graph/src/from_abi/node_type.rs"]),
    ("plugin_note", &["core/loader/src/elf.rs"]),
    ("lock", &["core/loader/src/lock.rs"]),
    ("keys", &["core/loader/src/keys.rs"]),
    (
        "audit",
        &["core/audit/src/chain.rs", "core/audit/src/event.rs", "core/audit/src/log.rs", "core/audit/src/read.rs"],
    ),
    (
        "calibration",
        &[
            "core/calibration/src/document.rs",
            "core/calibration/src/kalibr.rs",
            "core/calibration/src/opencv.rs",
            "core/calibration/src/ros.rs",
        ],
    ),
    ("board", &["core/calibration/src/board.rs"]),
    (
        "recording, event, digests",
        &[
            "core/record/src/recording.rs",
            "core/record/src/format.rs",
            "core/record/src/digest.rs",
            "core/record/src/mcap_texts.rs",
        ],
    ),
    ("packet", &["core/base/src/packet/"]),
    ("onnx", &["core/base/src/onnx.rs", "plugins/tools/src/onnx_file.rs"]),
    ("picture", &["plugins/capture/src/source/picture.rs", "core/media/src/input/jpeg.rs"]),
    ("float_image, truth_file", &["core/imaging/src/stereo/formats.rs", "core/eval/src/eval/disparity/truth_files.rs"]),
    ("coco, labelme, via, voc, yolo_labels", &["core/eval/src/eval/detect/truth/"]),
    ("arm_line", &["core/arm/src/line.rs"]),
    ("guard_message", &["core/arm_guard/src/message.rs"]),
    ("latch", &["core/arm_guard/src/latch.rs"]),
    ("rtde", &["core/arm_guard/src/rtde.rs"]),
    ("urdf", &["core/arm/src/chain.rs"]),
];

/// Covered and existing lines.
type Lines = (u64, u64);

/// Cargo and the other tools of the nightly toolchain, without what `cargo run` set for this program.
pub fn nightly(program: &str) -> Command {
    let mut command = Command::new(program);
    for name in ["CARGO", "RUSTC", "RUSTUP_TOOLCHAIN", "RUSTDOC"] {
        command.env_remove(name);
    }
    command.arg("+nightly");
    command
}

/// Replays the corpora and prints the lines of each parser that they reach. `work` is a folder for what is built. Returns whether all parsers have
/// [`LEAST_PERCENT`].
pub fn coverage(workspace: &Workspace, work: &Path) -> Result<bool> {
    let tools = llvm_tools()?;
    let (build, profiles) = (work.join("coverage"), work.join("profiles"));
    let _ = std::fs::remove_dir_all(&profiles);
    std::fs::create_dir_all(&profiles).with_context(|| format!("cannot make {}", profiles.display()))?;
    let mut cargo = nightly("cargo");
    cargo.current_dir(&workspace.root).env("CARGO_TARGET_DIR", &build).env("RUSTFLAGS", "-Cinstrument-coverage");
    // Build scripts are instrumented too.
    cargo.env("LLVM_PROFILE_FILE", build.join("build-%p.profraw"));
    cargo.args([
        "test",
        "--package",
        PACKAGE,
        "--test",
        TEST,
        "--no-run",
        "--message-format",
        "json-render-diagnostics",
    ]);
    let program = test_program(&process::capture(&mut cargo)?).context("the test was not built")?;
    let mut test = Command::new(&program);
    test.env("LLVM_PROFILE_FILE", profiles.join("%p.profraw")).current_dir(workspace.root.join("tests/fuzz/targets"));
    process::capture(&mut test)?;
    let merged = profiles.join("merged.profdata");
    let mut merge = Command::new(tools.join("llvm-profdata"));
    merge.args(["merge", "--sparse", "--output"]).arg(&merged).args(profiles_in(&profiles)?);
    process::capture(&mut merge)?;
    let mut export = Command::new(tools.join("llvm-cov"));
    export.args(["export", "--summary-only", "--instr-profile"]).arg(&merged).arg(&program);
    let files = lines_of(&process::capture(&mut export)?, &workspace.root)?;
    println!("{:<38} {:>6} {:>6} {:>7}", "parser", "lines", "reached", "share");
    let mut complete = true;
    for (name, sources) in PARSERS {
        let (covered, count) = sum(&files, sources).with_context(|| format!("no lines of `{name}` were built"))?;
        let percent = 100.0 * covered as f64 / count as f64;
        let mark = if percent < LEAST_PERCENT { " < 85 %" } else { "" };
        complete &= percent >= LEAST_PERCENT;
        println!("{name:<38} {count:>6} {covered:>7} {percent:>5.1} %{mark}");
        for (file, (covered, count)) in files.iter().filter(|(file, _)| sources.iter().any(|s| belongs(file, s))) {
            println!("  {file:<60} {covered:>5} of {count}");
        }
    }
    Ok(complete)
}

/// Folder of `llvm-profdata` and `llvm-cov`, of the compiler that writes the profiles.
fn llvm_tools() -> Result<PathBuf> {
    let sysroot = process::capture(nightly("rustc").args(["--print", "sysroot"]))
        .context("coverage needs the nightly toolchain: `rustup toolchain install nightly --component llvm-tools`")?;
    let machines = Path::new(sysroot.trim()).join("lib/rustlib");
    let folders = std::fs::read_dir(&machines).with_context(|| format!("cannot read {}", machines.display()))?;
    let mut folders = folders.flatten().map(|entry| entry.path().join("bin"));
    folders
        .find(|folder| folder.join("llvm-cov").is_file() && folder.join("llvm-profdata").is_file())
        .context("coverage needs LLVM's tools: `rustup component add llvm-tools --toolchain nightly`")
}

/// The program in the messages of `cargo test --no-run`.
fn test_program(messages: &str) -> Option<PathBuf> {
    let messages = messages.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let mut programs = messages.filter(|message| message["target"]["name"] == TEST);
    programs.find_map(|message| message["executable"].as_str().map(PathBuf::from))
}

fn profiles_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    Ok(entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e == "profraw"))
        .collect())
}

/// Lines of each file of the repository in the report of `llvm-cov export`.
fn lines_of(report: &str, root: &Path) -> Result<BTreeMap<String, Lines>> {
    let report: Value = serde_json::from_str(report).context("llvm-cov wrote no JSON")?;
    let files = report["data"][0]["files"].as_array().context("llvm-cov lists no files")?;
    let lines = |file: &Value| {
        let path = Path::new(file["filename"].as_str()?);
        let name = normal(path).strip_prefix(root).ok()?.to_str()?.to_owned();
        let lines = &file["summary"]["lines"];
        Some((name, (lines["covered"].as_u64()?, lines["count"].as_u64()?)))
    };
    Ok(files.iter().filter_map(lines).collect())
}

/// A path without `..`: a source that is included from elsewhere has some.
fn normal(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            std::path::Component::ParentDir => _ = out.pop(),
            part => out.push(part),
        }
    }
    out
}

fn belongs(file: &str, source: &str) -> bool {
    file == source || (source.ends_with('/') && file.starts_with(source))
}

/// Lines of all files that belong to some sources; `None` without a line.
fn sum(files: &BTreeMap<String, Lines>, sources: &[&str]) -> Option<Lines> {
    let of = |source: &&str| files.iter().filter(|(file, _)| belongs(file, source)).map(|(_, lines)| *lines).collect();
    let all: Vec<Vec<Lines>> = sources.iter().map(of).collect();
    // A source that was moved would go unnoticed in a sum.
    if all.iter().any(Vec::is_empty) {
        return None;
    }
    let total = all.concat().into_iter().fold((0, 0), |(a, b), (covered, count)| (a + covered, b + count));
    (total.1 > 0).then_some(total)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_counted_for_each_parser() {
        let file = |name: &str, covered: u64| {
            format!(r#"{{"filename":"{name}","summary":{{"lines":{{"count":10,"covered":{covered}}}}}}}"#)
        };
        let files = [
            file("/r/core/a/src/one.rs", 9),
            file("/r/tests/x/../../core/a/src/check/two.rs", 5),
            file("/elsewhere/core/a/src/one.rs", 1),
        ];
        let report = format!(r#"{{"data":[{{"files":[{}]}}]}}"#, files.join(","));
        let files = lines_of(&report, Path::new("/r")).unwrap();
        assert_eq!(sum(&files, &["core/a/src/one.rs"]), Some((9, 10)));
        assert_eq!(sum(&files, &["core/a/src/one.rs", "core/a/src/check/"]), Some((14, 20)));
        assert_eq!(sum(&files, &["core/a/src/one.rs", "core/a/src/gone.rs"]), None, "a moved source is noticed");
        assert!(lines_of("{}", Path::new("/r")).is_err());
    }

    #[test]
    fn the_test_program_is_found() {
        let messages = "{\"target\":{\"name\":\"other\"},\"executable\":\"/a\"}\n{\"target\":{\"name\":\"corpora\"},\"executable\":null}\n{\"target\":{\"name\":\"corpora\"},\"executable\":\"/b\"}\nno JSON\n";
        assert_eq!(test_program(messages), Some(PathBuf::from("/b")));
        assert_eq!(test_program(""), None);
    }

    #[test]
    fn every_source_of_a_parser_exists() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        for source in PARSERS.iter().flat_map(|(_, sources)| *sources) {
            assert!(root.join(source).exists(), "{source}");
        }
    }
}
