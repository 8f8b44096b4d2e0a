//! Graphs that come with an installation write into the folder where the program was started.

use crate::common;
use std::fs;
use std::path::{Path, PathBuf};

use panoscope_graph::installed::{MARKER, notice};
use panoscope_graph::{GraphText, ParamValue, check};

const GRAPH: &str = "plugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n\
                     [nodes.video]\ntype = \"write_video\"\ninputs = { image = \"scope.left\" }\nparams = { path = \"../out/video.mkv\" }\n\
                     [nodes.still]\ngraph = \"parts/still.toml\"\ninputs = { image = \"scope.left\" }\n\
                     [nodes.elsewhere]\ntype = \"write_video\"\ninputs = { image = \"scope.right\" }\nparams = { path = \"/data/right.mkv\" }\n";

const PART: &str = "plugins = [\"sinks\"]\n[part]\ninputs = { image = \"file.image\" }\n[nodes.file]\ntype = \"write_video\"\n\
                    params = { path = \"../../out/still.mkv\" }\n";

/// Paths that the graph's nodes write, by node.
fn written(graph: &Path, settings: &[&str]) -> Vec<(String, PathBuf)> {
    let mut text = GraphText::load(graph).unwrap_or_else(|d| panic!("{}", d.render(false)));
    settings.iter().for_each(|set| text.set(set));
    let checked = check(&text, &common::catalog());
    let graph = checked.graph.unwrap_or_else(|| panic!("{}", checked.diagnostics.render(false)));
    let path = |values: &[ParamValue]| {
        values.iter().find_map(|v| if let ParamValue::Path(p) = v { Some(p.clone()) } else { None })
    };
    let nodes = graph.nodes.iter().filter(|n| n.type_name == "write_video");
    let mut all: Vec<_> = nodes.filter_map(|n| Some((n.id.clone(), path(&n.params)?))).collect();
    all.sort();
    all
}

#[test]
fn written_files_of_an_installed_graph_leave_the_installation() {
    let root = std::env::temp_dir().join(format!("panoscope_installed_graphs_{}", std::process::id()));
    let graphs = root.join("graphs");
    fs::create_dir_all(graphs.join("parts")).expect("a folder");
    fs::write(graphs.join("wide.toml"), GRAPH).expect("a file");
    fs::write(graphs.join("parts/still.toml"), PART).expect("a file");
    let graph = graphs.join("wide.toml");
    let named = |elsewhere: &str, still: PathBuf, video: PathBuf| {
        vec![
            ("elsewhere".to_owned(), PathBuf::from(elsewhere)),
            ("still/file".to_owned(), still),
            ("video".to_owned(), video),
        ]
    };

    // Not installed: relative to each file.
    let beside = named("/data/right.mkv", graphs.join("parts/../../out/still.mkv"), graphs.join("../out/video.mkv"));
    assert_eq!(written(&graph, &[]), beside);
    assert_eq!(notice(&graph), None);

    // Installed: below the current folder, also through a link.
    fs::write(root.join(MARKER), "kind = \"folder\"\n").expect("a file");
    let here = std::env::current_dir().expect("a folder");
    let installed = named("/data/right.mkv", here.join("out/still.mkv"), here.join("out/video.mkv"));
    assert_eq!(written(&graph, &[]), installed);
    let told = notice(&graph).expect("a notice");
    assert!(told.contains(&format!("go to {}", here.display())), "{told}");
    let link = root.with_extension("link");
    std::os::unix::fs::symlink(&graphs, &link).expect("a link");
    assert_eq!(written(&link.join("wide.toml"), &[]), installed);

    // What the command line sets follows the same rule.
    assert_eq!(written(&graph, &["video.path=mine.mkv"])[2].1, here.join("mine.mkv"));
    assert_eq!(written(&graph, &["video.path=/tmp/mine.mkv"])[2].1, Path::new("/tmp/mine.mkv"));

    // A copy outside is nobody's installation.
    let copy = root.with_extension("copy");
    fs::create_dir_all(copy.join("parts")).expect("a folder");
    fs::copy(&graph, copy.join("wide.toml")).expect("a file");
    fs::copy(graphs.join("parts/still.toml"), copy.join("parts/still.toml")).expect("a file");
    assert_eq!(written(&copy.join("wide.toml"), &[])[2].1, copy.join("../out/video.mkv"));

    fs::remove_file(link).expect("removed");
    for folder in [root, copy] {
        fs::remove_dir_all(folder).expect("removed");
    }
}
