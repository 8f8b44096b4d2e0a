//! 200 kinds of broken and hostile ONNX files, each opened as a run opens a foreign model: in a separate process. Every one is refused or opened
//! within a second; none crashes the program, and every refusal names its file or how the process ended.

mod kinds;
mod onnx;

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use panoscope_graph::ParamValue;
use panoscope_host::loader::trial::try_node;
use panoscope_tests::{load, scratch};

use kinds::{FOLDER, Kind, LINK, PIPE};
use onnx::Parts;

/// Time limit of a file in addition to the time of a healthy one.
const PATIENCE: Duration = Duration::from_secs(1);
/// Kinds that keep ONNX Runtime busy for longer, quadratically or without end: each must be refused before, with the limit that it exceeds.
const TOO_MUCH: [(&str, &str); 7] = [
    ("20,000 nodes in a chain", "values from its constants"),
    ("20,000 nodes side by side", "values from its constants"),
    ("functions that double 40 times", "nodes"),
    ("graphs in graphs, 3 deep and 60 wide", "nodes"),
    ("graphs in graphs, 14 deep and 2 wide", "nodes"),
    ("a list doubled 40 times", "values from its constants"),
    ("a loop without end", "a loop of"),
];
/// Number of processes at a time.
const AT_ONCE: usize = 2;

fn write(folder: &Path, bytes: &[u8]) -> PathBuf {
    std::fs::create_dir_all(folder.join(FOLDER)).expect("a folder");
    std::fs::write(folder.join("weights.bin"), [0; 16]).expect("a file");
    std::os::unix::fs::symlink(folder.join("../secret.bin"), folder.join(LINK)).expect("a link");
    let pipe = std::ffi::CString::new(folder.join(PIPE).as_os_str().as_encoded_bytes()).expect("a path");
    // SAFETY: the path is a zero-terminated text that lives until the call returns.
    assert_eq!(unsafe { libc::mkfifo(pipe.as_ptr(), 0o600) }, 0, "a pipe");
    let file = folder.join("m.onnx");
    std::fs::write(&file, bytes).expect("a file");
    file
}

#[test]
fn every_kind_of_hostile_model_is_refused_or_opened_in_time() {
    let home = scratch("hostile-kinds");
    std::fs::write(home.join("secret.bin"), [0x7f; 84 * 84 * 4]).expect("a file");
    let healthy = write(&home.join("healthy"), &Parts::healthy().bytes());
    let text = format!(
        "plugins = [\"flow\", \"tools\"]\n[nodes.camera]\ntype = \"frames\"\n[nodes.net]\ntype = \"yolo\"\ninputs = {{ image = \"camera.image\" }}\nparams = {{ model = {healthy:?} }}\n"
    );
    let (graph, catalog, loader) =
        load(&home.join("graph.toml"), &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let node = graph.node("net").expect("a node");
    assert_eq!(graph.nodes[node].params[0], ParamValue::Path(healthy.clone()));
    let ask = |model: PathBuf| {
        let mut graph = graph.clone();
        graph.nodes[node].params[0] = ParamValue::Path(model);
        let begun = Instant::now();
        let opened = try_node(&graph, node, &catalog, &loader, &home).map_err(|error| error.to_string());
        (opened, begun.elapsed())
    };
    let mut base = Duration::ZERO;
    for _ in 0..2 {
        let (opened, took) = ask(healthy.clone());
        if let Err(reason) = &opened
            && reason.starts_with("ONNX Runtime's shared library")
        {
            panoscope_testing::skipped!("{reason}");
            return;
        }
        assert_eq!(opened, Ok(()), "a healthy model opens");
        base = base.max(took);
    }
    let all = kinds::all();
    let (next, results) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some((index, kind)) = take(&next, &all) {
                    let folder = home.join(format!("kind{index}"));
                    let result = ask(write(&folder, &kind.bytes));
                    let _ = std::fs::remove_dir_all(folder);
                    results.lock().expect("no test panics with it").push((index, result));
                }
            });
        }
    });
    let results = results.into_inner().expect("no test panicked with it");
    let mut faults = Vec::new();
    let (mut refused, mut slowest) = (0, (Duration::ZERO, 0));
    for (index, (opened, took)) in &results {
        let name = &all[*index].name;
        slowest = slowest.max((*took, *index));
        // Two processes share the machine, and other tests may run.
        if *took > PATIENCE + 4 * base {
            faults.push(format!("{name}: {:.2} s", took.as_secs_f64()));
        }
        match opened {
            Ok(()) if name.starts_with("weights outside") || name.starts_with("weights in \"/") => {
                faults.push(format!("{name}: opened"));
            }
            Ok(()) => {}
            Err(reason) => {
                refused += 1;
                if let Some((_, words)) = TOO_MUCH.iter().find(|(kind, _)| kind == name)
                    && !(reason.contains(words) && reason.contains("would keep ONNX Runtime busy"))
                {
                    faults.push(format!("{name}: {reason}"));
                }
                let ended = reason.starts_with("the process of group") || reason.starts_with("it did not return");
                if ended {
                    println!("{name}: {reason}");
                } else if !reason.contains("m.onnx") {
                    faults.push(format!("{name}: the refusal names no file: {reason}"));
                }
            }
        }
    }
    println!(
        "{} kinds: {refused} refused, {} opened; healthy {:.2} s, slowest {:.2} s: {}",
        results.len(),
        results.len() - refused,
        base.as_secs_f64(),
        slowest.0.as_secs_f64(),
        all[slowest.1].name
    );
    TOO_MUCH.iter().for_each(|(name, _)| {
        let is_refused = results.iter().any(|(index, (opened, _))| all[*index].name == *name && opened.is_err());
        assert!(is_refused, "`{name}` is no kind, or was opened");
    });
    assert!(results.len() >= 200, "{} kinds", results.len());
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    std::fs::remove_dir_all(home).expect("removed");
}

fn take<'k>(next: &AtomicUsize, all: &'k [Kind]) -> Option<(usize, &'k Kind)> {
    let index = next.fetch_add(1, Ordering::Relaxed);
    all.get(index).map(|kind| (index, kind))
}
