//! Graph files with parts, overlays, arguments and settings.
//!
//! The text is divided by lines `#--- NAME`. The part before the first is the graph; the others are files with these names in the same folder. Names
//! that begin with `over` are overlays. `set` holds settings and `args` values of arguments, one per line.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use panoscope_graph::edit::GraphEdit;
use panoscope_graph::{Catalog, Checked, Diagnostics, GraphOptions, GraphText, check};

// The catalog that the tests of the checker use.
#[path = "../../../../core/runtime/graph/tests/common/mod.rs"]
mod common;

const FOLDER: &str = "/no_such_folder";

fn catalog() -> &'static Catalog {
    static CATALOG: OnceLock<Catalog> = OnceLock::new();
    CATALOG.get_or_init(common::catalog)
}

/// The main text, and the options from the other pieces.
fn pieces(text: &str) -> (&str, GraphOptions) {
    let mut options = GraphOptions::default();
    let mut pieces = text.split("#--- ");
    let main = pieces.next().unwrap_or("");
    for piece in pieces.take(20) {
        let (name, body) = piece.split_once('\n').unwrap_or((piece, ""));
        let name = name.trim();
        match name {
            "set" => options.set.extend(body.lines().take(20).map(str::to_owned)),
            "args" => {
                let pairs = body.lines().take(20).filter_map(|line| line.split_once('='));
                options.args.extend(pairs.map(|(name, value)| (name.to_owned(), value.to_owned())));
            }
            _ => {
                let path = GraphOptions::key(&Path::new(FOLDER).join(name));
                if name.starts_with("over") {
                    options.with.push(path.clone());
                }
                options.texts.insert(path, body.to_owned());
            }
        }
    }
    (main, options)
}

/// Positions are inside the file that they name, and everything can be rendered.
fn positions(text: &GraphText, diagnostics: &Diagnostics) {
    let files: BTreeMap<&str, &str> = text.files().into_iter().map(|file| (file.path, file.text)).collect();
    let inside = |file: &str, span: &std::ops::Range<usize>| match files.get(file) {
        Some(text) => assert!(text.get(span.clone()).is_some(), "{span:?} of {file}"),
        None => assert!(span.start <= span.end),
    };
    for diagnostic in diagnostics {
        inside(&diagnostic.file, &diagnostic.span);
        if let Some(text) = files.get(diagnostic.file.as_str()) {
            assert!((1..=text.matches('\n').count() + 1).contains(&diagnostic.line), "{diagnostic:?}");
        }
        for note in &diagnostic.notes {
            inside(note.file.as_deref().unwrap_or(&diagnostic.file), &note.span);
        }
        assert!(!diagnostic.message.is_empty() && !diagnostic.code.is_empty());
    }
    let rendered = diagnostics.render(true).len() + diagnostics.render(false).len();
    assert!(rendered >= diagnostics.iter().count());
}

pub fn run(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let (main, options) = pieces(text);
    let path = Path::new(FOLDER).join("main.toml");
    let read = GraphText::parse_with(&path, main, &options);
    let checked = check(&read, catalog());
    positions(&read, &checked.diagnostics);
    assert_eq!(checked.graph.is_some(), !checked.diagnostics.has_errors(), "{}", checked.diagnostics);
    if let Checked { graph: Some(graph), .. } = &checked {
        assert_eq!(graph.order.len(), graph.nodes.len());
        let _ = panoscope_graph::to_dot(graph, catalog());
        let json = serde_json::to_string(graph).expect("a graph is JSON");
        let back: panoscope_graph::Graph = serde_json::from_str(&json).expect("its own JSON");
        assert_eq!(serde_json::to_string(&back).expect("a graph is JSON"), json);
        same_when_flattened(&path, &read, graph);
    }
    edited(main);
}

/// The text in which parts are replaced by their nodes is the same graph.
fn same_when_flattened(path: &Path, read: &GraphText, graph: &panoscope_graph::Graph) {
    let flat = read.flattened(catalog());
    let options = GraphOptions { set: read.settings(), ..GraphOptions::default() };
    let again = check(&GraphText::parse_with(path, &flat, &options), catalog());
    let again = again.graph.unwrap_or_else(|| panic!("{}\n{flat}", again.diagnostics));
    let nodes = |graph: &panoscope_graph::Graph| -> Vec<String> {
        let mut all: Vec<String> =
            graph.nodes.iter().map(|n| format!("{} {} {} {:?}", n.id, n.plugin, n.type_name, n.params)).collect();
        all.sort();
        all
    };
    assert_eq!(nodes(&again), nodes(graph), "{flat}");
    assert_eq!(again.edges.len(), graph.edges.len(), "{flat}");
}

/// An edit results in TOML with the new value.
fn edited(text: &str) {
    let Ok(mut edit) = GraphEdit::parse(text) else { return };
    let ids: Vec<String> = toml::from_str::<toml::Table>(text)
        .ok()
        .and_then(|table| Some(table.get("nodes")?.as_table()?.keys().take(3).cloned().collect()))
        .unwrap_or_default();
    for id in &ids {
        if edit.set_param(id, "fuzzed", &toml::Value::Integer(7)).is_err() {
            continue;
        }
        let table: toml::Table = toml::from_str(&edit.text()).unwrap_or_else(|e| panic!("{e}\n{}", edit.text()));
        let value = table.get("nodes").and_then(|n| n.get(id)?.get("params")?.get("fuzzed")?.as_integer());
        assert_eq!(value, Some(7), "{}", edit.text());
        let _ = edit.remove_node(id);
    }
    toml::from_str::<toml::Table>(&edit.text()).unwrap_or_else(|e| panic!("{e}\n{}", edit.text()));
}

pub fn seeds() -> Vec<Vec<u8>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let mut texts = vec![common::graphs::PANORAMA.to_owned(), common::graphs::EVERY_KEY.to_owned()];
    texts.push(
        "plugins = [\"phantom\"]\n[args.n]\ntype = \"whole\"\ndefault = 3\n[nodes.scope]\ntype = \"phantom\"\nparams = { seed = { arg = \"n\" } }\n\
         [nodes.deep]\ngraph = \"a.toml\"\ninputs = { image = \"scope.left\" }\n\
         #--- a.toml\nplugins = [\"overlay\"]\n[part]\ninputs = { image = \"show.image\" }\noutputs = { image = \"show.image\" }\n[nodes.show]\ntype = \"overlay\"\n\
         #--- over.toml\n[nodes.scope]\ntype = \"phantom\"\n#--- args\nn=4\n#--- set\nscope.seed=5\n"
            .to_owned(),
    );
    // Parts of parts and names of names that multiply.
    let files = |level: &dyn Fn(usize) -> String, leaf: &str| -> String {
        let parts: String = (0..12).map(|k| format!("#--- p{k}.toml\n[part]\n{}", level(k + 1))).collect();
        format!("[nodes.top]\ngraph = \"p0.toml\"\n{parts}#--- p12.toml\n{leaf}#--- set\ntop.a=4\n")
    };
    let node = |name: &str, k: usize| format!("[nodes.{name}]\ngraph = \"p{k}.toml\"\n");
    texts.push(files(&|k| ["a", "b", "c", "d"].map(|name| node(name, k)).concat(), "[part]\n"));
    texts.push(files(
        &|k| {
            format!(
                "params = {{ a = [\"i.a\", \"i.b\"], b = [\"i.a\", \"i.b\"] }}\n{}params = {{ a = 1 }}\n",
                node("i", k)
            )
        },
        "plugins = [\"phantom\"]\n[part]\nparams = { a = \"s.seed\", b = \"s.seed\" }\n[nodes.s]\ntype = \"phantom\"\n",
    ));
    let mut files: Vec<PathBuf> = ["graphs", "graphs/parts", "tests/bad_graphs"]
        .iter()
        .filter_map(|folder| std::fs::read_dir(root.join(folder)).ok())
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect();
    files.sort();
    texts.extend(files.iter().filter_map(|path| std::fs::read_to_string(path).ok()));
    texts.into_iter().map(String::into_bytes).collect()
}

/// A valid graph: its text, and the checked graph.
pub fn example() -> (&'static str, panoscope_graph::Graph) {
    let text = common::graphs::PANORAMA;
    let checked = check(&GraphText::parse(Path::new("/panorama.toml"), text), catalog());
    (text, checked.graph.unwrap_or_else(|| panic!("{}", checked.diagnostics)))
}
