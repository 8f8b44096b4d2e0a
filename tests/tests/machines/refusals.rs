//! Machines that a graph does not start with: the reason is named.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use panoscope_engine::{Engine, Options, StartError};
use panoscope_tests::machines::{Machine, free_port, program};
use panoscope_tests::{load, scratch};

use super::{ONE, PATIENT, machine};

/// Starts and closes a graph. Returns why it does not start.
fn refusal(folder: &Path, text: &str) -> String {
    let (graph, catalog, loader) =
        load(&folder.join("graph.toml"), text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let options = Options { frames: Some(1), graph_dir: folder.to_owned(), ..Options::default() };
    match Engine::start(graph, &catalog, &loader, options) {
        Ok(engine) => panic!("it starts: {:?}", engine.recent_log()),
        Err(StartError::Open { reason, .. }) => reason,
        Err(other) => other.to_string(),
    }
}

#[test]
fn a_machine_that_does_not_answer_is_named() {
    let folder = scratch("machines-silent");
    let address = format!("tcp/127.0.0.1:{}", free_port());
    let begin = Instant::now();
    let words = refusal(&folder, &(ONE.to_owned() + &machine(&address, "")));
    assert!(words.contains("machine `rack` is lost") && words.contains(&address), "{words}");
    assert!(words.contains("is `panoscope serve` running there?"), "{words}");
    assert!(begin.elapsed() < Duration::from_secs(20), "it fails soon");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_graph_with_a_model_on_a_machine_is_checked_without_that_machine() {
    let folder = scratch("machines-check");
    let Some(program) = program() else { return panoscope_testing::skipped!("there is no program `panoscope`") };
    let text = format!(
        "mode = \"live\"\nplugins = [\"phantom\", \"tools\", \"flow\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.find]\ntype = \"yolo\"\n\
         on = \"rack\"\ninputs = {{ image = {{ from = \"scope.left\", align = \"latest\" }} }}\n[nodes.end]\ntype = \"drain\"\n\
         inputs = {{ image = \"scope.left\" }}\n{}",
        machine(&format!("tcp/127.0.0.1:{}", free_port()), "")
    );
    let graph = folder.join("graph.toml");
    std::fs::write(&graph, text).expect("a file");
    let done = Command::new(program).arg("check").arg(&graph).output().expect("it runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn another_build_of_a_plugin_is_refused_with_both_hashes() {
    let folder = scratch("machines-plugin");
    let Some(program) = program() else { return panoscope_testing::skipped!("there is no program `panoscope`") };
    let plugins = std::env::var_os("PANOSCOPE_PLUGIN_PATH")
        .and_then(|list| std::env::split_paths(&list).next())
        .unwrap_or_else(|| program.with_file_name("plugins"));
    let other = folder.join("plugins");
    std::fs::create_dir_all(&other).expect("a folder");
    let Some(flow) = std::fs::read_dir(&plugins).ok().and_then(|entries| {
        entries.flatten().map(|entry| entry.path()).find(|path| path.to_string_lossy().ends_with("flow.so"))
    }) else {
        return panoscope_testing::skipped!("there is no plugin `flow` in {}", plugins.display());
    };
    let mut bytes = std::fs::read(&flow).expect("a plugin");
    bytes.push(0);
    std::fs::write(other.join(flow.file_name().expect("a name")), bytes).expect("a plugin");
    let port = free_port();
    let variable = format!("PANOSCOPE_PLUGIN_PATH={}", other.display());
    let _rack = Machine::start(&["env", &variable], "rack", &format!("tcp/127.0.0.1:{port}"), &[], &folder);
    let words = refusal(&folder, &(ONE.to_owned() + &machine(&format!("tcp/127.0.0.1:{port}"), PATIENT)));
    let hashes = words.split(|c: char| !c.is_ascii_hexdigit()).filter(|word| word.len() == 64).count();
    assert!(words.contains("differs") && words.contains("install the same build") && hashes == 2, "{words}");
    let _ = std::fs::remove_dir_all(&folder);
}
