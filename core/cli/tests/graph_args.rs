//! Arguments, parts and overlays of graphs from outside: options, help, exit codes, recordings.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A fresh folder with files, and the program started in it.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str, files: &[(&str, &str)]) -> Self {
        let folder = std::env::temp_dir().join(format!("panoscope-args-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        for (file, text) in files {
            let path = folder.join(file);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            std::fs::write(path, text).expect("written");
        }
        Self(folder)
    }

    fn run(&self, arguments: &str) -> (i32, String, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope"));
        let Output { status, stdout, stderr } =
            command.current_dir(&self.0).args(arguments.split(' ')).output().expect("the program starts");
        let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
        (status.code().unwrap_or(-1), text(stdout), text(stderr))
    }

    fn json(&self, file: &str) -> serde_json::Value {
        serde_json::from_str(&std::fs::read_to_string(self.0.join(file)).expect("it was written")).expect("JSON")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Whether the plugin `flow` is in `PANOSCOPE_PLUGIN_PATH`, or beside the program.
fn has_flow() -> bool {
    let given = std::env::var_os("PANOSCOPE_PLUGIN_PATH").unwrap_or_default();
    let beside = Path::new(env!("CARGO_BIN_EXE_panoscope")).with_file_name("plugins");
    let there = std::env::split_paths(&given)
        .chain([beside])
        .any(|folder| ["libflow.so", "libpanoscope_flow.so"].iter().any(|name| folder.join(name).is_file()));
    if !there {
        panoscope_testing::skipped!("plugin `flow` is not built");
    }
    there
}

const GRAPH: &str = r#"mode = "batch"
plugins = ["flow"]

[args.width]
type = "whole"
doc = "Width of the pictures"
unit = "px"
range = [16, 640]

[args.rate]
type = "number"
doc = "Pictures per second"
unit = "Hz"
default = 200.0

[nodes.source]
type = "frames"
params = { width_px = { arg = "width" }, height_px = 48, rate_hz = { arg = "rate" } }

[nodes.chain]
graph = "parts/chain.toml"
inputs = { image = "source.image" }

[nodes.sink]
type = "drain"
inputs = { image = "chain.image" }
"#;

const CHAIN: &str = r#"plugins = ["flow"]

[part]
inputs = { image = "first.image" }
outputs = { image = "second.image" }

[nodes.first]
type = "pass"

[nodes.second]
type = "pass"
inputs = { image = "first.image" }
"#;

const FLAT: &str = r#"mode = "batch"
plugins = ["flow"]

[nodes.source]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 200.0 }

[nodes."chain/first"]
type = "pass"
inputs = { image = "source.image" }

[nodes."chain/second"]
type = "pass"
inputs = { image = "chain/first.image" }

[nodes.sink]
type = "drain"
inputs = { image = "chain/second.image" }
"#;

fn files(name: &str) -> Folder {
    let over = "plugins = [\"flow\"]\n[args.width]\ndefault = 128\n[nodes.source]\ntype = \"frames\"\n\
                params = { width_px = { arg = \"width\" }, height_px = 32, rate_hz = 100.0 }\n";
    let all = [("g.toml", GRAPH), ("parts/chain.toml", CHAIN), ("flat.toml", FLAT), ("sources/other.toml", over)];
    Folder::new(name, &all)
}

#[test]
fn a_graph_takes_its_arguments_as_options() {
    if !has_flow() {
        return;
    }
    let folder = files("options");
    let (code, out, err) = folder.run("run --frames 5 g.toml --width 64 --headless --report r.json");
    assert_eq!(code, 0, "{out}{err}");
    let report = folder.json("r.json");
    for node in ["source", "chain/first", "chain/second", "sink"] {
        assert_eq!(report["nodes"][node]["count"], 5, "{node}: {out}");
    }
    let (code, _, err) = folder.run("run g.toml --headless");
    assert_eq!(code, 2);
    for words in
        ["error[missing-arg]: argument `width` is not given", "g.toml:4:7", "Width of the pictures", "--width WHOLE"]
    {
        assert!(err.contains(words), "no {words} in {err}");
    }
    let (code, _, err) = folder.run("run g.toml --headless --width 1000");
    assert_eq!(code, 2);
    assert!(
        err.contains("argument `width` is 1000 px, allowed are 16 to 640 px") && err.contains("command line:1:9"),
        "{err}"
    );
    let (code, _, err) = folder.run("run g.toml --wdth 64");
    assert_eq!(code, 2);
    assert!(err.contains("--wdth") && err.contains("--width <WHOLE>"), "{err}");
    let (code, _, err) = folder.run("run g.toml --width");
    assert_eq!((code, err.trim()), (2, "error: --width needs a value: --width WHOLE"));
}

#[test]
fn help_and_check_name_the_arguments() {
    if !has_flow() {
        return;
    }
    let folder = files("help");
    let (code, out, _) = folder.run("run g.toml --help");
    assert_eq!(code, 0);
    assert!(out.contains("Arguments of g.toml:"), "{out}");
    assert!(out.contains("--width <WHOLE>  Width of the pictures [16 to 640 px, required]"), "{out}");
    assert!(out.contains("--rate <NUMBER>  Pictures per second [in Hz, default: 200.0]"), "{out}");
    let (code, out, _) = folder.run("check g.toml parts/chain.toml");
    assert_eq!(code, 0, "{out}");
    assert!(out.contains("g.toml: ok (4 nodes, 3 connections; to run it needs --width)"), "{out}");
    let (code, out, _) = folder.run("check g.toml --width 7");
    assert_eq!(code, 2, "{out}");
    let (code, out, _) = folder.run("dot g.toml");
    assert!(code == 0 && out.contains("subgraph \"cluster_chain\""), "{out}");
}

#[test]
fn an_overlay_replaces_the_source() {
    if !has_flow() {
        return;
    }
    let folder = files("overlay");
    let (code, out, err) =
        folder.run("record g.toml --with sources/other.toml --frames 3 --headless -o r.mcap --digests d.json");
    assert_eq!(code, 0, "{out}{err}");
    let (code, _, err) = folder.run("run g.toml --with sources/othr.toml");
    assert_eq!(code, 2);
    assert!(err.contains("there is no such overlay") && err.contains("other.toml"), "{err}");
    // The overlay gives `width` a default.
    let (code, out, _) = folder.run("check g.toml --with sources/other.toml");
    assert!(code == 0 && out.contains("connections)"), "{out}");
}

#[test]
fn a_graph_with_parts_runs_to_the_same_bytes_as_a_flat_one_and_replays() {
    if !has_flow() {
        return;
    }
    let folder = files("same");
    let all = "--frames 6 --headless --all-ports";
    let (code, out, err) = folder.run(&format!("record g.toml --width 64 {all} -o parts.mcap --digests parts.json"));
    assert_eq!(code, 0, "{out}{err}");
    let (code, out, err) = folder.run(&format!("record flat.toml {all} -o flat.mcap --digests flat.json"));
    assert_eq!(code, 0, "{out}{err}");
    let (parts, flat) = (folder.json("parts.json"), folder.json("flat.json"));
    assert_eq!(parts["ports"], flat["ports"]);
    assert!(parts["ports"].to_string().contains("chain/second.image"), "{parts}");
    // A recording needs none of the files that it was made of.
    for file in ["g.toml", "parts/chain.toml"] {
        std::fs::remove_file(folder.0.join(file)).expect("it is there");
    }
    let (code, out, err) = folder.run("replay parts.mcap --headless --digests again.json");
    assert_eq!(code, 0, "{out}{err}");
    assert_eq!(folder.json("again.json")["ports"], parts["ports"]);
}

#[test]
fn a_lock_holds_parts_and_overlays() {
    if !has_flow() {
        return;
    }
    let folder = files("lock");
    let locked = "lock g.toml --with sources/other.toml";
    let (code, out, err) = folder.run(locked);
    assert_eq!(code, 0, "{out}{err}");
    for words in ["graph        g.toml", "part         parts/chain.toml", "overlay      sources/other.toml"] {
        assert!(out.contains(words), "no {words} in {out}");
    }
    assert_eq!(folder.run(&format!("{locked} --verify")).0, 0);
    std::fs::write(folder.0.join("parts/chain.toml"), CHAIN.replace("[nodes.first]", "# changed\n[nodes.first]"))
        .expect("written");
    let (code, _, err) = folder.run(&format!("{locked} --verify"));
    assert_eq!(code, 1);
    assert!(err.contains("part `parts/chain.toml` has changed since the graph was locked"), "{err}");
}

#[test]
fn mistakes_of_a_part_stand_in_its_file() {
    if !has_flow() {
        return;
    }
    let folder = files("mistakes");
    std::fs::write(
        folder.0.join("parts/chain.toml"),
        CHAIN.replace("first.image\" }\noutputs", "frist.image\" }\noutputs"),
    )
    .expect("written");
    let (code, _, err) = folder.run("run g.toml --width 64");
    assert_eq!(code, 2);
    assert!(err.contains("parts/chain.toml:4:") && err.contains("did you mean `first`?"), "{err}");
}
