//! Every shipped graph is valid with each source that suits it, describes what it shows, and reads the phantom's ground truth only if its name says
//! so.

use std::path::{Path, PathBuf};

use panoscope_graph::{Catalog, Graph, GraphOptions, GraphText, check};
use panoscope_host::loader::{self as loader, Loader};
use panoscope_testing::Folder;
use panoscope_tests::CALIBRATION;

fn graphs() -> PathBuf {
    panoscope_tests::root().join("graphs")
}

/// Names of the graph files of a folder below `graphs`, without their extension.
fn files(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(graphs().join(folder)).expect("graphs").flatten();
    let mut names: Vec<String> =
        entries.filter_map(|e| e.file_name().to_string_lossy().strip_suffix(".toml").map(str::to_owned)).collect();
    names.sort();
    names
}

/// Catalog of all plugins of this machine.
fn catalog() -> (Loader, Catalog) {
    let loader = Loader::search(&loader::search_path(&[]));
    let names: Vec<String> = loader.found().map(|f| f.note.name.clone()).collect();
    let catalog = loader.catalog(&names);
    (loader, catalog)
}

fn checked(path: &Path, options: &GraphOptions, catalog: &Catalog) -> Result<(GraphText, Graph, String), String> {
    let text = GraphText::load_with(path, options).map_err(|mistakes| mistakes.render(false))?;
    let (graph, warnings) = check(&text, catalog).into_result().map_err(|mistakes| mistakes.render(false))?;
    Ok((text, graph, warnings.render(false)))
}

#[test]
fn every_shipped_graph_checks() {
    let (_loader, catalog) = catalog();
    let mut count = 0;
    for folder in ["", "parts"] {
        for name in files(folder) {
            // Graphs on files or cameras of the user's have arguments without values.
            let options = GraphOptions { allow_missing_args: true, ..GraphOptions::default() };
            let path = graphs().join(folder).join(format!("{name}.toml"));
            let (text, _, warnings) =
                checked(&path, &options, &catalog).unwrap_or_else(|mistakes| panic!("{mistakes}"));
            assert!(warnings.is_empty(), "{name}: {warnings}");
            assert!(text.text().starts_with("# "), "{} does not open with what it shows", path.display());
            assert_eq!(text.is_part(), folder == "parts", "{}", path.display());
            count += 1;
        }
    }
    assert!(count >= 35, "only {count} graphs were found");
}

/// Outputs of the phantom that a camera has too.
fn is_view(port: &str) -> bool {
    matches!(port, "left" | "right" | "view0" | "view1" | "view2" | "view3" | "calibration")
}

#[test]
fn truth_feeds_only_graphs_whose_names_say_so() {
    let (_loader, catalog) = catalog();
    let mut judged = 0;
    for name in files("") {
        let options = GraphOptions { allow_missing_args: true, ..GraphOptions::default() };
        let (text, graph, _) = checked(&graphs().join(format!("{name}.toml")), &options, &catalog)
            .unwrap_or_else(|mistakes| panic!("{mistakes}"));
        let truth = graph.edges.iter().filter_map(|edge| {
            let from = graph.nodes[edge.from_node].node_type(&catalog);
            let port = &from.outputs[edge.from_port].name;
            (from.name == "phantom" && !is_view(port)).then(|| format!("{}.{port}", graph.nodes[edge.from_node].id))
        });
        let truth: Vec<String> = truth.collect();
        if name.ends_with("_judged") {
            judged += 1;
            assert!(!truth.is_empty(), "{name} reads no truth of the phantom: rename it");
            let first = text.text().lines().next().unwrap_or_default();
            assert!(text.text().contains("phantom's ground truth"), "{name} does not say so: {first}");
            let preset = &graph.preset;
            assert!(preset.pinned.is_empty() && preset.views.is_empty(), "{name} is no preset for a surgeon");
        } else {
            assert!(
                truth.is_empty(),
                "{name} reads {truth:?}, the phantom's truth: name it {name}_judged, or find it in the pictures"
            );
        }
    }
    assert!(judged >= 3, "{judged} graphs are judged by the truth");
}

/// A source overlay with the arguments that it needs.
struct Source {
    name: &'static str,
    args: &'static [(&'static str, &'static str)],
}

/// Sources in a folder with images of two and four views, a calibration and a data set.
const SOURCES: [Source; 8] = [
    Source { name: "phantom", args: &[("seed", "3"), ("tools", "1")] },
    Source { name: "files", args: &[("left", "left.png"), ("right", "right.png"), ("calibration", "scope.yml")] },
    Source { name: "cameras", args: &[("left", "0"), ("right", "1"), ("calibration", "scope.yml")] },
    Source { name: "side_by_side", args: &[("video", "both.png"), ("calibration", "scope.yml")] },
    Source { name: "data_set", args: &[("folder", "pairs")] },
    Source { name: "rtsp", args: &[("calibration", "scope.yml")] },
    Source { name: "cameras_on_arm", args: &[("calibration", "scope.yml")] },
    Source { name: "four_files", args: &[("views", "left.png; right.png; left.png; right.png")] },
];

/// Why a graph does not accept a source, and the text of the error; `None` if it does.
fn refusal(graph: &str, source: &str) -> Option<(&'static str, &'static str)> {
    const NO_SCOPE: &str = "replaces nothing: the graph has no node of that name";
    let has_tip = matches!(graph, "surgeon" | "navigation" | "thesis_chapter6" | "arm_closed_loop");
    match (graph, source) {
        ("four_cameras" | "four_cameras_mesh", "four_files") => None,
        ("four_cameras" | "four_cameras_mesh", _) => Some(("it looks at four views, the source has two", NO_SCOPE)),
        (_, "four_files") => Some(("it looks at two views", NO_SCOPE)),
        (_, "cameras_on_arm") if has_tip => None,
        (_, "cameras_on_arm") => Some(("it follows no tip that an arm could follow", "there is no node `follow`")),
        ("stereo_network_judged", _) => Some(("it asks for a network", "argument `model` is not given")),
        ("arm_closed_loop", _) => Some(("without an arm there is no loop", "has no output `")),
        // panorama.toml takes them.
        ("panorama_files", "phantom" | "side_by_side" | "data_set") => {
            Some(("it asks for its own files", "argument `left` is not given"))
        }
        (_, "phantom") => None,
        ("stereo_judged" | "tools_judged", "data_set") => None,
        (name, _) if name.ends_with("_judged") => Some(("cameras know no truth", "has no output `")),
        _ => None,
    }
}

#[test]
fn every_graph_takes_every_source_that_makes_sense_and_refuses_the_others() {
    let (_loader, catalog) = catalog();
    let folder = Folder::new("sources", &[("scope.yml", CALIBRATION)]);
    for (name, width) in [("left", 640), ("right", 640), ("both", 1280)] {
        let picture = image::RgbImage::from_fn(width, 480, |x, y| image::Rgb([x as u8, y as u8, (x + y) as u8]));
        picture.save(folder.at(&format!("{name}.png"))).expect("a picture");
    }
    for side in ["left", "right"] {
        std::fs::create_dir_all(folder.at(&format!("pairs/{side}"))).expect("a folder");
        std::fs::copy(folder.at(&format!("{side}.png")), folder.at(&format!("pairs/{side}/0.png"))).expect("a copy");
    }
    std::fs::copy(folder.at("scope.yml"), folder.at("pairs/calibration.yml")).expect("a copy");
    assert_eq!(SOURCES.len(), files("sources").len(), "a source that ships is not in this test");
    let value = |text: &str| match text.split("; ").all(|file| folder.at(file).exists()) {
        true => text.split("; ").map(|file| folder.at(file).display().to_string()).collect::<Vec<_>>().join(";"),
        false => text.to_owned(),
    };
    let (mut taken, mut refused) = (0, 0);
    for graph in files("") {
        let path = graphs().join(format!("{graph}.toml"));
        for source in &SOURCES {
            let args = source.args.iter().map(|(name, text)| ((*name).to_owned(), value(text))).collect();
            let with = vec![graphs().join("sources").join(format!("{}.toml", source.name))];
            let outcome = checked(&path, &GraphOptions { with, args, ..GraphOptions::default() }, &catalog);
            match (outcome, refusal(&graph, source.name)) {
                (Ok((_, checked, _)), None) => {
                    taken += 1;
                    let arm = checked.nodes.iter().any(|n| n.type_name.starts_with("arm_"));
                    assert_eq!(
                        arm,
                        source.name == "cameras_on_arm",
                        "{graph}: an arm moves what it holds, and only that"
                    );
                }
                (Err(said), Some((_, words))) => {
                    refused += 1;
                    let overlay = format!("sources/{}.toml", source.name);
                    let is_clear = said.contains(words) && (said.contains(&overlay) || words.starts_with("argument"));
                    assert!(is_clear, "{graph} with {}: {said}", source.name);
                }
                (Ok(_), Some((reason, _))) => panic!("{graph} takes {}, though {reason}", source.name),
                (Err(said), None) => panic!("{graph} with {}: {said}", source.name),
            }
        }
    }
    assert!(taken > 120 && refused > 30, "{taken} taken, {refused} refused");
}

#[test]
fn a_source_has_views_and_calibration_and_says_how_it_is_used() {
    for source in &SOURCES {
        let path = graphs().join("sources").join(format!("{}.toml", source.name));
        let text = std::fs::read_to_string(&path).expect("a source");
        assert!(text.starts_with("# ") && text.contains("panoscope run graphs/"), "{} shows no command", source.name);
        let table: toml::Table = text.parse().expect("TOML");
        let nodes = table["nodes"].as_table().expect("nodes");
        let names: Vec<&String> = nodes.keys().collect();
        let expected = if source.name == "four_files" { "cameras" } else { "scope" };
        assert_eq!(names, [expected], "{}", source.name);
    }
}

#[test]
fn machines_change_where_nodes_run_and_nothing_else() {
    let (_loader, catalog) = catalog();
    let mut count = 0;
    for name in files("machines") {
        let path = graphs().join("machines").join(format!("{name}.toml"));
        let text = std::fs::read_to_string(&path).expect("an overlay");
        let command = text.lines().find_map(|line| line.strip_prefix("#   panoscope run graphs/")).expect("a command");
        let graph = graphs().join(command.split(' ').next().expect("a graph"));
        let args = vec![("rack".to_owned(), "tls/10.0.0.2:7447".to_owned())];
        let options = GraphOptions { with: vec![path], args, ..GraphOptions::default() };
        let (_, home, _) = checked(&graph, &GraphOptions::default(), &catalog).unwrap_or_else(|m| panic!("{m}"));
        let (_, away, _) = checked(&graph, &options, &catalog).unwrap_or_else(|m| panic!("{m}"));
        let nodes = |graph: &Graph| -> Vec<_> {
            let mut nodes: Vec<_> = graph.nodes.iter().map(|n| (n.id.clone(), format!("{:?}", n.params))).collect();
            nodes.sort();
            nodes
        };
        let edges = |graph: &Graph| -> Vec<_> {
            let of = |node: usize| graph.nodes[node].id.clone();
            let mut edges: Vec<_> =
                graph.edges.iter().map(|e| (of(e.from_node), e.from_port, of(e.to_node), e.to_port)).collect();
            edges.sort();
            edges
        };
        assert_eq!((nodes(&home), edges(&home)), (nodes(&away), edges(&away)), "{name}");
        assert!(away.nodes.iter().any(|node| node.machine.is_some()), "{name} moves nothing");
        count += 1;
    }
    assert!(count > 0);
}
