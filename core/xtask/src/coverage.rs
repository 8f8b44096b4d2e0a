//! `cargo xtask fuzz --coverage`: which lines of the parsers the corpora of the fuzz targets reach.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::process;
use crate::workspace::Workspace;

/// The test that replays the corpora, and its package.
const PACKAGE: &str = "panoscope-fuzz-targets";
const TEST: &str = "corpora";
/// Minimum line coverage of a parser, percent.
const MIN_PERCENT: f64 = 85.0;

/// Lines that belong to a parser.
struct Source {
    /// A file, or a folder that ends with a slash.
    path: &'static str,
    /// Names of the functions that parse; empty if the whole file does. Code for writing, or code that needs a loaded
    /// plugin, an open device or a person, receives no bytes from outside, so its coverage does not show how well the
    /// parser is tested.
    only: &'static [&'static str],
}

/// All lines of a file or folder.
const fn all(path: &'static str) -> Source {
    Source { path, only: &[] }
}

/// The lines of some functions of a file; of all functions with these names.
const fn functions(path: &'static str, only: &'static [&'static str]) -> Source {
    Source { path, only }
}

/// Parsers of untrusted bytes, and their sources.
const PARSERS: &[(&str, &[Source])] = &[
    (
        "graph",
        &[
            all("core/runtime/graph/src/parse.rs"),
            all("core/runtime/graph/src/text.rs"),
            all("core/runtime/graph/src/parts.rs"),
            all("core/runtime/graph/src/args.rs"),
            all("core/runtime/graph/src/shape.rs"),
            all("core/runtime/graph/src/file.rs"),
            all("core/runtime/graph/src/check/"),
        ],
    ),
    ("descriptor", &[all("core/runtime/graph/src/from_abi.rs"), all("core/runtime/graph/src/from_abi/node_type.rs")]),
    ("plugin_note", &[all("core/runtime/host/src/loader/elf.rs")]),
    (
        "lock",
        &[
            functions(
                "core/runtime/host/src/loader/lock.rs",
                &["read", "parse", "message", "check_signature", "digest", "differences", "differences_among"],
            ),
            functions("core/runtime/host/src/loader/locked_file.rs", &["word"]),
        ],
    ),
    (
        "machine_message",
        &[functions("core/runtime/host/src/isolate/relay/messages.rs", &["read", "is_sound", "take", "fits"])],
    ),
    (
        "attach_message",
        &[
            functions("core/runtime/host/src/attach/tunnel.rs", &["of", "receive"]),
            functions("core/runtime/host/src/attach/message.rs", &["read_command", "read_incoming", "checked"]),
            functions("core/runtime/host/src/attach/packet.rs", &["read", "frame_of"]),
            functions("core/runtime/host/src/attach/rules.rs", &["table", "stops", "check"]),
        ],
    ),
    ("pedal", &[functions("editor/model/src/pedal.rs", &["parse", "binding"])]),
    ("presets", &[functions("editor/model/src/presets.rs", &["parse", "changes_to", "change_to", "between", "mixed"])]),
    ("snapshot", &[functions("editor/model/src/snapshots.rs", &["parse", "restore"])]),
    (
        "layout",
        &[
            functions("editor/model/src/docks/mod.rs", &["checked"]),
            functions("editor/model/src/docks/file.rs", &["parse"]),
        ],
    ),
    (
        "keys",
        &[functions(
            "core/runtime/host/src/loader/keys.rs",
            &["digits", "read", "name_of", "verifies", "in_folders", "find"],
        )],
    ),
    (
        "audit",
        &[
            functions("core/runtime/host/src/audit/chain.rs", &["parse", "follows"]),
            functions("core/runtime/host/src/audit/log.rs", &["tail"]),
            all("core/runtime/host/src/audit/files.rs"),
            all("core/runtime/host/src/audit/read.rs"),
        ],
    ),
    (
        "dicom_entry",
        &[
            all("core/links/export/src/dicom/lengths.rs"),
            functions("core/links/export/src/dicom/entry.rs", &["decode", "of", "check"]),
            functions("core/links/export/src/dicom/part10.rs", &["parse"]),
        ],
    ),
    (
        "dicom_film",
        &[all("core/links/export/src/dicom/object/mp4.rs"), all("core/links/export/src/dicom/object/jpeg.rs")],
    ),
    ("dicom_lengths", &[functions("core/links/export/src/dicom/object/report.rs", &["read", "length"])]),
    (
        "calibration",
        &[
            all("core/vision/data/src/calibration/document.rs"),
            all("core/vision/data/src/calibration/kalibr.rs"),
            all("core/vision/data/src/calibration/opencv.rs"),
            all("core/vision/data/src/calibration/ros.rs"),
        ],
    ),
    ("board", &[all("core/vision/data/src/calibration/board.rs")]),
    (
        "recording, event, digests",
        &[
            functions(
                "core/runtime/record/src/recording.rs",
                &[
                    "open",
                    "verify",
                    "bytes",
                    "read",
                    "digests",
                    "ends_with_magic",
                    "is_ours",
                    "skip",
                    "body",
                    "record",
                    "message",
                    "index",
                    "foreign_head",
                    "event",
                    "drop_unadmitted",
                ],
            ),
            functions("core/runtime/record/src/digest.rs", &["packet_hash", "deserialize", "packets", "read"]),
            all("core/runtime/record/src/mcap_texts.rs"),
        ],
    ),
    ("packet", &[all("core/contract/base/src/packet/")]),
    (
        "ros_message, ros_bag",
        &[
            functions("core/links/ros/src/cdr.rs", &["decode", "decode_body"]),
            functions(
                "core/links/ros/src/convert/from_ros.rs",
                &[
                    "checked",
                    "picture",
                    "compressed",
                    "depth_mm",
                    "disparity",
                    "of",
                    "bytes",
                    "number",
                    "cloud",
                    "boxes",
                    "joints",
                    "pose",
                ],
            ),
            functions(
                "core/links/ros/src/bag/reader.rs",
                &["next", "damaged", "read_bytes", "unpack", "records", "open_part"],
            ),
            all("core/links/ros/src/bag/scan.rs"),
            all("core/links/ros/src/bag/fields.rs"),
        ],
    ),
    ("gate", &[functions("core/links/export/src/live/gate.rs", &["check_head", "is_own_origin"])]),
    ("webrtc_offer", &[all("core/links/media/src/offer.rs")]),
    (
        "onnx",
        &[
            functions(
                "core/contract/base/src/onnx.rs",
                &["child", "new", "varint", "field", "message", "weight_files", "unbundle"],
            ),
            all("core/contract/base/src/onnx/work.rs"),
            functions("plugins/tools/src/onnx_file.rs", &["read"]),
        ],
    ),
    (
        "picture",
        &[
            functions("plugins/capture/src/source/decode.rs", &["decode_picture", "decode_tiff"]),
            all("plugins/capture/src/source/compressed.rs"),
            all("plugins/capture/src/source/plain.rs"),
            all("core/links/media/src/input/jpeg.rs"),
            all("core/links/media/src/input/jpeg_scan.rs"),
        ],
    ),
    (
        "float_image, truth_file",
        &[
            functions("core/vision/imaging/src/stereo/formats.rs", &["area", "read_pfm", "read_npy"]),
            all("core/eval/src/eval/disparity/truth_files.rs"),
            all("core/vision/data/src/truth/maps.rs"),
        ],
    ),
    (
        "coco, labelme, via, voc, yolo_labels",
        &[
            functions(
                "core/eval/src/eval/detect/truth/mod.rs",
                &["class", "size_of", "picture_called", "files", "one_file", "read", "outlined"],
            ),
            all("core/eval/src/eval/detect/truth/coco.rs"),
            all("core/eval/src/eval/detect/truth/labelme.rs"),
            all("core/eval/src/eval/detect/truth/via.rs"),
            all("core/eval/src/eval/detect/truth/voc.rs"),
            all("core/eval/src/eval/detect/truth/yolo_text.rs"),
            all("core/vision/data/src/truth/labels/voc.rs"),
            all("core/vision/data/src/truth/labels/yolo.rs"),
        ],
    ),
    ("arm_line", &[all("core/robot/arm/src/line.rs")]),
    ("guard_message", &[all("core/robot/arm_guard/src/message.rs")]),
    ("latch", &[functions("core/robot/arm_guard/src/latch.rs", &["open", "decode"])]),
    (
        "rtde",
        &[functions(
            "core/robot/arm_guard/src/rtde.rs",
            &["bytes", "u8", "u32", "i32", "f64", "flag", "vector", "counted", "end", "read", "take", "size"],
        )],
    ),
    (
        "igtl",
        &[
            functions("core/links/igtl/src/header.rs", &["decode"]),
            all("core/links/igtl/src/reader.rs"),
            functions("core/links/igtl/src/metadata.rs", &["split", "entries"]),
            functions(
                "core/links/igtl/src/fields.rs",
                &["take", "items", "array", "floats", "text", "end", "padded", "floats3"],
            ),
            functions("core/links/igtl/src/message/mod.rs", &["decode", "from_parts", "content"]),
            functions("core/links/igtl/src/message/image.rs", &["decode", "part_bytes"]),
            functions("core/links/igtl/src/message/poly_data.rs", &["decode", "decode_attributes", "iter"]),
            functions("core/links/igtl/src/message/query.rs", &["decode"]),
            functions("core/links/igtl/src/message/small.rs", &["read", "decode", "decode_all", "each", "of"]),
        ],
    ),
    ("urdf", &[functions("core/robot/arm/src/chain.rs", &["from_urdf", "path", "finite", "origin", "turning"])]),
    (
        "described_plugin, isolated_call",
        &[
            functions(
                "core/runtime/host/src/isolate/description.rs",
                &["read", "text", "list", "read_type", "read_port", "read_param"],
            ),
            functions("core/runtime/host/src/isolate/host/describer.rs", &["report"]),
            functions(
                "core/runtime/host/src/isolate/host/answer.rs",
                &["refuse", "run_deferred", "run", "answer", "made", "output"],
            ),
            functions("core/runtime/host/src/isolate/host/remote.rs", &["request", "exchange", "read_tick", "process"]),
            functions(
                "core/runtime/host/src/isolate/wire/mod.rs",
                &[
                    "take",
                    "refill",
                    "take_all",
                    "array",
                    "count",
                    "head",
                    "bytes",
                    "whole",
                    "plain_status",
                    "plain_words",
                ],
            ),
            functions("core/runtime/host/src/isolate/wire/lane.rs", &["of", "is_deferred", "after_deferred"]),
            functions("core/runtime/host/src/isolate/lane.rs", &["receive", "receive_until"]),
        ],
    ),
];

/// Number of executions of each line with code, by line number.
type Counts = BTreeMap<u32, u64>;

/// Cargo and the other tools of the nightly toolchain, without the environment that `cargo run` set for this program.
pub fn nightly(program: &str) -> Command {
    let mut command = Command::new(program);
    for name in ["CARGO", "RUSTC", "RUSTUP_TOOLCHAIN", "RUSTDOC"] {
        command.env_remove(name);
    }
    command.arg("+nightly");
    command
}

/// Replays the corpora and prints the share of the lines of each parser that they reach; with `lists_missed` also the
/// lines that they do not reach. `work` is a folder for builds. Returns whether all parsers have [`MIN_PERCENT`].
///
/// Only the lines of [`PARSERS`] count, without lines of tests.
pub fn coverage(workspace: &Workspace, work: &Path, lists_missed: bool) -> Result<bool> {
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
    export.args(["export", "--format=lcov", "--instr-profile"]).arg(&merged).arg(&program);
    let files = counts_of(&process::capture(&mut export)?, &workspace.root);
    println!("{:<38} {:>6} {:>7} {:>7}", "parser", "lines", "reached", "share");
    let mut complete = true;
    for (name, sources) in PARSERS {
        let mut parts: Vec<(String, Counts)> = Vec::new();
        for source in *sources {
            let before = parts.len();
            for (file, counts) in files.iter().filter(|(file, _)| belongs(file, source.path)) {
                let text = std::fs::read_to_string(workspace.root.join(file)).with_context(|| file.clone())?;
                parts.push((file.clone(), chosen(counts, &text, source.only).with_context(|| file.clone())?));
            }
            if parts.len() == before {
                bail!("no lines of {} were built", source.path);
            }
        }
        let (covered, count) =
            parts.iter().map(|(_, counts)| share(counts)).fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        let percent = 100.0 * covered as f64 / count.max(1) as f64;
        let mark = if percent < MIN_PERCENT { " < 85 %" } else { "" };
        complete &= percent >= MIN_PERCENT;
        println!("{name:<38} {count:>6} {covered:>7} {percent:>5.1} %{mark}");
        for (file, counts) in &parts {
            let (covered, count) = share(counts);
            println!("  {file:<60} {covered:>5} of {count}");
            if lists_missed && covered < count {
                println!("    not reached: {}", missed(counts));
            }
        }
    }
    Ok(complete)
}

/// Folder of `llvm-profdata` and `llvm-cov`, of the nightly toolchain.
fn llvm_tools() -> Result<PathBuf> {
    let sysroot = process::capture(nightly("rustc").args(["--print", "sysroot"])).context(
        "coverage needs the nightly toolchain: run `rustup toolchain install nightly --component llvm-tools`",
    )?;
    let machines = Path::new(sysroot.trim()).join("lib/rustlib");
    let folders = std::fs::read_dir(&machines).with_context(|| format!("cannot read {}", machines.display()))?;
    let mut folders = folders.flatten().map(|entry| entry.path().join("bin"));
    folders
        .find(|folder| folder.join("llvm-cov").is_file() && folder.join("llvm-profdata").is_file())
        .context("coverage needs LLVM's tools: run `rustup component add llvm-tools --toolchain nightly`")
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

/// Counts of the lines of each file of the repository, from the report of `llvm-cov export --format=lcov`.
fn counts_of(report: &str, root: &Path) -> BTreeMap<String, Counts> {
    let mut files: BTreeMap<String, Counts> = BTreeMap::new();
    let mut current: Option<String> = None;
    for line in report.lines() {
        if let Some(path) = line.strip_prefix("SF:") {
            let path = normal(Path::new(path));
            current = path.strip_prefix(root).ok().and_then(Path::to_str).map(str::to_owned);
        } else if let (Some(file), Some(data)) = (&current, line.strip_prefix("DA:")) {
            let mut numbers = data.split(',').map(str::parse::<u64>);
            if let (Some(Ok(line)), Some(Ok(count))) = (numbers.next(), numbers.next()) {
                // A source that is compiled twice is listed twice.
                *files.entry(file.clone()).or_default().entry(line as u32).or_default() += count;
            }
        }
    }
    files
}

/// The counts of the lines of functions with these names; of all lines if there are no names.
fn chosen(counts: &Counts, text: &str, only: &[&str]) -> Result<Counts> {
    if only.is_empty() {
        return Ok(counts.clone());
    }
    let mut lines = Vec::new();
    for name in only {
        let found = functions_named(text, name);
        if found.is_empty() {
            bail!("there is no function `{name}`");
        }
        lines.extend(found);
    }
    let is_inside = |line: &u32| lines.iter().any(|function| function.contains(line));
    Ok(counts.iter().filter(|(line, _)| is_inside(line)).map(|(line, count)| (*line, *count)).collect())
}

/// Line numbers of all functions of a name, in source text as rustfmt lays it out: a function ends with a brace at its
/// own indentation.
fn functions_named(text: &str, name: &str) -> Vec<RangeInclusive<u32>> {
    let lines: Vec<&str> = text.lines().take_while(|line| *line != "mod tests {").collect();
    let begins = |line: &str| {
        let after = line.split_once(&format!("fn {name}")).map(|(before, after)| (before.trim(), after));
        after.is_some_and(|(before, after)| {
            let is_head = before
                .split_whitespace()
                .all(|word| ["const", "unsafe", "extern", "\"C\"", "pub"].contains(&word) || word.starts_with("pub("));
            is_head && after.starts_with(['(', '<'])
        })
    };
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate().filter(|(_, line)| begins(line)) {
        let indent = &line[..line.len() - line.trim_start().len()];
        let end = if line.ends_with('}') {
            at
        } else {
            let closes = |line: &&str| line.strip_prefix(indent) == Some("}");
            at + lines[at..].iter().position(closes).unwrap_or(0)
        };
        found.push(at as u32 + 1..=end as u32 + 1);
    }
    found
}

/// Number of reached lines, and of all lines.
fn share(counts: &Counts) -> (usize, usize) {
    (counts.values().filter(|count| **count > 0).count(), counts.len())
}

/// Numbers of the lines that were not reached, as ranges.
fn missed(counts: &Counts) -> String {
    let mut ranges: Vec<(u32, u32)> = Vec::new();
    let mut reaches_on = false;
    for (line, count) in counts {
        match ranges.last_mut() {
            Some((_, last)) if *count == 0 && reaches_on => *last = *line,
            _ if *count == 0 => ranges.push((*line, *line)),
            _ => {}
        }
        reaches_on = *count == 0;
    }
    let words = ranges.into_iter().map(|(a, b)| if a == b { a.to_string() } else { format!("{a}-{b}") });
    words.collect::<Vec<_>>().join(", ")
}

/// A path without `..`: sources included from other folders have some.
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

#[cfg(test)]
mod tests {
    use super::*;

    const REPORT: &str = "SF:/r/core/a/src/one.rs\nDA:1,4\nDA:2,0\nDA:3,0\nDA:5,1\nDA:6,0\nend_of_record\n\
        SF:/r/tests/x/../../core/a/src/one.rs\nDA:2,3\nend_of_record\nSF:/elsewhere/core/a/src/one.rs\nDA:3,1\nend_of_record\n";

    #[test]
    fn lines_are_counted_for_each_file() {
        let files = counts_of(REPORT, Path::new("/r"));
        let counts = &files["core/a/src/one.rs"];
        assert_eq!((files.len(), share(counts)), (1, (3, 5)), "a source that was compiled twice is counted once");
        assert_eq!(missed(counts), "3, 6");
        assert_eq!(missed(&Counts::from([(1, 0), (2, 0), (4, 0), (5, 1), (9, 0)])), "1-4, 9");
        assert!(belongs("core/a/src/one.rs", "core/a/") && !belongs("core/a/src/one.rs", "core/a/src/one"));
    }

    #[test]
    fn functions_are_found_by_their_names() {
        let text = "fn read(a: u8) -> u8 {\n    if a {\n    }\n}\n\nimpl A {\n    pub(crate) unsafe fn read<'a>(\n        x: u8,\n    ) {\n        1\n    }\n    \
            fn short() {}\n    fn reads() {\n    }\n}\nmod tests {\n    fn read() {\n    }\n}\n";
        assert_eq!(functions_named(text, "read"), [1..=4, 7..=11]);
        assert_eq!(functions_named(text, "short"), [12..=12]);
        assert_eq!(functions_named(text, "rea"), []);
        let counts = Counts::from([(1, 1), (2, 0), (5, 1), (10, 7), (12, 1)]);
        assert_eq!(share(&chosen(&counts, text, &["read"]).unwrap()), (2, 3));
        assert_eq!(chosen(&counts, text, &[]).unwrap(), counts);
        assert!(
            chosen(&counts, text, &["gone"]).unwrap_err().to_string().contains("`gone`"),
            "a moved function is noticed"
        );
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
            let path = root.join(source.path);
            assert!(path.exists(), "{}", source.path);
            for name in source.only {
                let text = std::fs::read_to_string(&path).unwrap();
                assert!(!functions_named(&text, name).is_empty(), "{}: {name}", source.path);
            }
        }
    }
}
