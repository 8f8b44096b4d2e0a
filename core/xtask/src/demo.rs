//! `cargo xtask demo`: builds, runs a graph and prints the path of the panorama.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, Result, bail, ensure};

use crate::build::{Needs, Profile, build_for_graph, build_windows};
use crate::lint;
use crate::onnxruntime;
use crate::packages::Purpose;
use crate::process;
use crate::report::Summary;
use crate::setup;
use crate::workspace::Workspace;

/// Ten seconds of the phantom's 30 fps.
const FRAMES: &str = "300";

/// Parameters of sinks that are output paths.
const PATH_PARAMS: [&str; 3] = ["path", "folder", "pattern"];

/// Builds, runs the graph for a bounded number of frames, and prints what it wrote. With a screen the editor then shows
/// the graph running.
///
/// # Errors
/// The build or the run fails, a node had a fault, or an output is missing, empty or older than this run.
pub fn demo(workspace: &Workspace, args: &[String]) -> Result<()> {
    let (graph, args) = match args.split_first() {
        Some((first, rest)) if first.ends_with(".toml") => (PathBuf::from(first), rest),
        _ => (workspace.root.join("graphs/panorama.toml"), args),
    };
    let text = fs::read_to_string(&graph).with_context(|| format!("cannot read the graph {}", graph.display()))?;
    let outputs = outputs(&text, &graph, args)?;

    setup::ensure(&[Purpose::Build])?;
    lint::require_clippy(workspace)?;
    let (mut needs, runs_network) = needs(&text, graph.parent().unwrap_or(Path::new("")));
    // Graphs laid over this one may bring sources of their own.
    for file in values_of(args, "--with") {
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {file}"))?;
        add_needs(&text, Path::new(file).parent().unwrap_or(Path::new("")), 16, &mut needs);
    }
    // For graphs that run networks: this one, or those that are tried next.
    match onnxruntime::fetch(workspace) {
        Ok(_) => {}
        Err(error) if runs_network => {
            return Err(error.context("this graph needs ONNX Runtime"));
        }
        Err(error) => println!("ONNX Runtime was not fetched, so graphs that run networks do not run: {error:#}"),
    }
    let built = build_for_graph(workspace, &needs)?;
    let plugins: Vec<&str> = needs.plugins.iter().map(String::as_str).collect();
    println!(
        "Built for this graph: the program and the plugins {}; `cargo xtask build` builds the rest.",
        plugins.join(", ")
    );
    let mut run = built.panoscope();
    run.arg("run").arg(&graph);
    if value_of(args, "--frames").is_none() {
        run.args(["--frames", FRAMES]);
    }
    let asked_headless = args.iter().any(|arg| arg == "--headless");
    let has_screen = std::env::var_os("DISPLAY").is_some_and(|v| !v.is_empty()) && !asked_headless;
    if !has_screen && !asked_headless {
        run.arg("--headless");
    }
    let report = match value_of(args, "--report") {
        Some(path) => PathBuf::from(path),
        None => {
            let folder = workspace.target.join("demo");
            fs::create_dir_all(&folder)?;
            let path = folder.join("report.json");
            run.arg("--report").arg(&path);
            path
        }
    };
    let start = SystemTime::now();
    process::run(run.args(args))?;

    ensure!(!fresh_files(&report, start).is_empty(), "the run wrote no report to {}", report.display());
    let summary = Summary::from_json(&fs::read_to_string(&report)?)?;
    print!("\n{}", summary.text);
    let absent = print_outputs(&outputs, start);
    println!("{:10} {}", "report", display(&report));
    ensure!(absent.is_empty(), "{}", absent.join("; "));
    ensure!(summary.frames > 0, "no frame came through");
    ensure!(summary.faults == 0, "{} faults of nodes, see above", summary.faults);
    if has_screen {
        println!("\nThe editor opens with the running graph; close its window to end the demo.");
        build_windows(workspace, Profile::Dev)?;
        process::run(built.panoscope().arg("edit").arg(&graph))?;
    }
    Ok(())
}

/// Prints the files of each output that were written since `start`; returns the missing and empty ones.
fn print_outputs(outputs: &[Output], start: SystemTime) -> Vec<String> {
    let mut absent = Vec::new();
    for output in outputs {
        let files = fresh_files(&output.path, start);
        match files.as_slice() {
            [] => absent.push(format!("`{}` wrote nothing to {}", output.node, display(&output.path))),
            [file] => println!("{:10} {} ({})", output.what, display(&file.path), size(file.bytes)),
            [first, .., last] => {
                let bytes = files.iter().map(|file| file.bytes).sum();
                let (first, last) = (display(&first.path), display(&last.path));
                println!("{:10} {first} .. {last} ({} files, {})", output.what, files.len(), size(bytes));
            }
        }
        absent.extend(
            files.iter().filter(|file| file.bytes == 0).map(|file| format!("{} is empty", display(&file.path))),
        );
    }
    absent
}

/// Parts of a build that a graph and its parts need, and whether they run a network. Parts are relative
/// to `folder`.
fn needs(text: &str, folder: &Path) -> (Needs, bool) {
    let mut needs = Needs::default();
    let runs_network = add_needs(text, folder, 16, &mut needs);
    (needs, runs_network)
}

/// As [`needs`], up to this depth: the run reports a part that uses itself.
fn add_needs(text: &str, folder: &Path, depth: usize, needs: &mut Needs) -> bool {
    let table: Option<toml::Table> = text.parse().ok();
    let Some(table) = table else { return false };
    for plugin in table.get("plugins").and_then(toml::Value::as_array).into_iter().flatten() {
        let Some(name) = plugin.as_str() else { continue };
        needs.python |= name.ends_with(".py");
        needs.plugins.insert(name.to_owned());
    }
    let mut runs_network = false;
    let nodes = table.get("nodes").and_then(toml::Value::as_table);
    for (_, node) in nodes.into_iter().flatten() {
        let word = |key: &str| node.get(key).and_then(toml::Value::as_str);
        needs.machine |= word("on").is_some();
        if let Some(name) = word("type") {
            let name = name.rsplit('/').next().unwrap_or(name);
            runs_network |= matches!(name, "yolo" | "mask_rcnn" | "onnx" | "stereo_net");
            needs.guard |= matches!(name, "arm_serial" | "arm_ur");
        }
        let Some(part) = word("graph").map(|file| folder.join(file)) else { continue };
        if let Some(text) = fs::read_to_string(&part).ok().filter(|_| depth > 0) {
            runs_network |= add_needs(&text, part.parent().unwrap_or(folder), depth - 1, needs);
        }
    }
    runs_network
}

/// An output file of a sink.
#[derive(Debug, PartialEq)]
struct Output {
    node: String,
    /// `video`, `images`, ...: the node's type without `write_`.
    what: String,
    path: PathBuf,
}

/// The outputs of a graph file's `write_*` nodes, `--set node.path=...` of the command line included.
fn outputs(text: &str, graph: &Path, args: &[String]) -> Result<Vec<Output>> {
    let table: toml::Table = text.parse().with_context(|| format!("{} is not TOML", graph.display()))?;
    let folder = graph.parent().unwrap_or(Path::new(""));
    let nodes = table.get("nodes").and_then(toml::Value::as_table);
    let mut outputs = Vec::new();
    for (id, node) in nodes.into_iter().flatten() {
        let Some(what) = node.get("type").and_then(toml::Value::as_str).and_then(|name| name.strip_prefix("write_"))
        else {
            continue;
        };
        let in_file = |param: &str| node.get("params")?.get(param)?.as_str();
        let path = PATH_PARAMS.iter().find_map(|param| set_value(args, id, param).or_else(|| in_file(param)));
        let Some(path) = path else {
            bail!("{}: node `{id}` has no parameter that names a file", graph.display());
        };
        outputs.push(Output { node: id.clone(), what: what.to_owned(), path: folder.join(path) });
    }
    Ok(outputs)
}

/// The value of an option given as `--name value` or `--name=value`; the last one counts.
fn value_of<'a>(args: &'a [String], name: &str) -> Option<&'a str> {
    values_of(args, name).last()
}

fn values_of<'a>(args: &'a [String], name: &str) -> impl Iterator<Item = &'a str> {
    args.iter().enumerate().filter_map(move |(at, arg)| {
        let rest = arg.strip_prefix(name)?;
        if rest.is_empty() { args.get(at + 1).map(String::as_str) } else { rest.strip_prefix('=') }
    })
}

/// The value that `--set node.param=value` sets for a parameter.
fn set_value<'a>(args: &'a [String], node: &str, param: &str) -> Option<&'a str> {
    let value = values_of(args, "--set")
        .filter_map(|set| set.split_once('='))
        .filter(|(name, _)| name.split_once('.') == Some((node, param)))
        .last()?
        .1;
    Some(value.trim_matches('"'))
}

/// A file this run wrote.
struct Written {
    path: PathBuf,
    bytes: u64,
}

/// The files at `path` that were written since `start`: the file itself, those in it when it is a folder, or those that
/// match it as a pattern (`still_{}.png`, or `still.png` for `still_000042.png`).
fn fresh_files(path: &Path, start: SystemTime) -> Vec<Written> {
    let fresh = |path: PathBuf| {
        let file = path.metadata().ok().filter(fs::Metadata::is_file)?;
        // File systems keep times coarser than the clock does.
        let since = start.checked_sub(std::time::Duration::from_secs(2)).unwrap_or(start);
        (file.modified().ok()? >= since).then_some(Written { path, bytes: file.len() })
    };
    if path.is_file() {
        return fresh(path.to_owned()).into_iter().collect();
    }
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let (folder, prefix, extension) = if path.is_dir() {
        (path, "", None)
    } else {
        let stem = Path::new(&name).file_stem().and_then(|stem| stem.to_str()).unwrap_or(&name);
        let fixed = stem.split(['%', '{', '*', '#']).next().unwrap_or(stem);
        (path.parent().unwrap_or(Path::new(".")), fixed, path.extension())
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut files: Vec<Written> = entries
        .filter(|file| file.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix)))
        .filter(|file| extension.is_none() || file.extension() == extension)
        .filter_map(fresh)
        .collect();
    files.sort_by(|a, b| a.path.cmp(&b.path));
    files
}

/// A path relative to the folder in which the command was called.
fn display(path: &Path) -> String {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let here = std::env::current_dir().ok().and_then(|here| full.strip_prefix(here).map(Path::to_owned).ok());
    here.unwrap_or(full).display().to_string()
}

fn size(bytes: u64) -> String {
    match bytes {
        0..1_000 => format!("{bytes} B"),
        1_000..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        _ => format!("{:.1} MB", bytes as f64 / 1e6),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAPH: &str = r#"
        name = "panorama"
        [nodes.scope]
        type = "phantom"
        params = { seed = 7 }
        [nodes.video]
        type = "write_video"
        inputs = { image = "wide.panorama" }
        params = { path = "out/panorama.mkv" }
        [nodes.still]
        type = "write_images"
        params = { path = "/data/still_{}.png" }
    "#;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    fn output(node: &str, what: &str, path: &str) -> Output {
        Output { node: node.into(), what: what.into(), path: path.into() }
    }

    #[test]
    fn sinks_are_found_with_their_paths() {
        let graph = Path::new("graphs/panorama.toml");
        let mut found = outputs(GRAPH, graph, &[]).unwrap();
        found.sort_by(|a, b| b.node.cmp(&a.node));
        let still = output("still", "images", "/data/still_{}.png");
        assert_eq!(found, [output("video", "video", "graphs/out/panorama.mkv"), still]);

        let args = words("--set video.path=a.mkv --frames 5 --set=video.path=\"b.mkv\" --set scope.seed=3");
        let found = outputs(GRAPH, graph, &args).unwrap();
        assert!(found.contains(&output("video", "video", "graphs/b.mkv")), "{found:?}");
        assert_eq!(value_of(&args, "--frames"), Some("5"));
        assert_eq!(value_of(&args, "--report"), None);
    }

    #[test]
    fn a_sink_without_a_path_and_broken_text_are_errors() {
        let text = "[nodes.out]\ntype = \"write_video\"\n";
        assert!(outputs(text, Path::new("g.toml"), &[]).unwrap_err().to_string().contains("`out`"));
        assert!(outputs("[nodes", Path::new("g.toml"), &[]).is_err());
    }

    #[test]
    fn only_files_of_this_run_count() {
        let folder = std::env::temp_dir().join(format!("xtask_demo_{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        for name in ["still_000.png", "still_001.png", "still_000.txt", "other.png"] {
            fs::write(folder.join(name), "x").unwrap();
        }
        let now = SystemTime::now();
        let names = |path: &str, start| {
            let files = fresh_files(&folder.join(path), start);
            files.iter().map(|file| file.path.file_name().unwrap().to_str().unwrap().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(names("still_{}.png", now), ["still_000.png", "still_001.png"]);
        assert_eq!(names("still.png", now), ["still_000.png", "still_001.png"]);
        assert_eq!(names("still_%03d.txt", now), ["still_000.txt"]);
        assert_eq!(names("other.png", now), ["other.png"]);
        assert_eq!(names("", now).len(), 4);
        assert!(names("none.png", now).is_empty());
        let later = now + std::time::Duration::from_secs(3600);
        assert!(names("other.png", later).is_empty(), "an old file is not this run's");
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_needs_of_a_graph_are_known() {
        let finds = |text: &str| needs(text, Path::new("")).1;
        assert!(!finds(GRAPH));
        assert!(finds("[nodes.find]\ntype = \"yolo\"\n"));
        assert!(finds("[nodes.find]\ntype = \"tools/mask_rcnn\"\n"));
        assert!(finds("[nodes.match]\ntype = \"stereo_net\"\n"));
        let graphs = Workspace::locate().unwrap().root.join("graphs");
        let of = |name: &str| needs(&fs::read_to_string(graphs.join(name)).unwrap(), &graphs);
        for (name, expected) in [("tools_masks.toml", true), ("surgeon.toml", true), ("panorama.toml", false)] {
            assert_eq!(of(name).1, expected, "{name}");
        }
        let (panorama, _) = of("panorama.toml");
        assert_eq!(panorama.plugins.iter().map(String::as_str).collect::<Vec<_>>(), ["phantom", "sinks", "stitch"]);
        assert!(!panorama.guard && !panorama.machine && !panorama.python);
        let (other, _) = needs("plugins = [\"shade.py\"]\n[nodes.a]\ntype = \"arm_ur\"\non = \"b\"\n", Path::new(""));
        assert!(other.guard && other.machine && other.python);
    }

    #[test]
    fn sizes_have_units() {
        assert_eq!((size(12), size(1_500), size(2_340_000)), ("12 B".into(), "1.5 kB".into(), "2.3 MB".into()));
    }
}
