//! A lock has every file that a parameter is declared to name, and nodes of a verified graph read copies that nobody
//! can change.

use std::path::{Path, PathBuf};

use panoscope_graph::{Catalog, Graph, GraphText, NodeType, Param, ParamKind, ParamValue, Pick, check};
use panoscope_host::loader::Kind;
use panoscope_host::loader::lock::Lock;
use panoscope_host::loader::verify::Seal;
use panoscope_host::loader::{Loader, depends};

struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("panoscope_seal_{name}_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        Self(folder)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.0.join(name), bytes).expect("written");
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn param(name: &str, kind: ParamKind) -> Param {
    Param {
        name: name.to_owned(),
        doc: String::new(),
        unit: String::new(),
        kind,
        reopen: true,
        pick: Pick::None,
        writes: false,
        shipped: false,
    }
}

fn path(must_exist: bool) -> ParamKind {
    ParamKind::Path { default: String::new(), must_exist }
}

fn text() -> ParamKind {
    ParamKind::Text { default: String::new() }
}

/// One node type with a parameter of every kind that can name a file.
fn catalog() -> Catalog {
    let params = vec![
        param("model", path(true)),
        param("labels", path(false)),
        param("arm", path(false)),
        param("scope_calibration", path(false)),
        Param { writes: true, ..param("out", path(false)) },
        Param { pick: Pick::File, ..param("left", text()) },
        Param { pick: Pick::File, ..param("calibration", text()) },
        param("title", text()),
    ];
    let node_type = NodeType {
        name: "all".to_owned(),
        plugin: "files".to_owned(),
        source: true,
        side_effects: true,
        params,
        ..NodeType::default()
    };
    Catalog { plugins: vec!["files".to_owned()], node_types: vec![node_type], ..Catalog::default() }
}

const GRAPH: &str = r#"plugins = ["files"]
[nodes.n]
type = "all"
params = { model = "net.onnx", labels = "names.txt", arm = "arm.urdf", scope_calibration = "scope.yml", out = "out.txt", left = "left.png", calibration = "l.yml; r.yml", title = "names.txt" }
"#;

/// Bytes of a length-delimited field; the numbers are small enough for one byte.
fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
    [&[number << 3 | 2, bytes.len() as u8], bytes].concat()
}

/// A model whose weights are in `w.bin`.
fn model() -> Vec<u8> {
    let entry = [field(1, b"location"), field(2, b"w.bin")].concat();
    field(7, &field(5, &field(13, &entry)))
}

fn write_all(folder: &Folder) {
    folder.write("net.onnx", &model());
    for name in ["w.bin", "names.txt", "arm.urdf", "scope.yml", "out.txt", "left.png", "l.yml", "r.yml"] {
        folder.write(name, format!("contents of {name}").as_bytes());
    }
}

fn parsed(folder: &Folder, text: &str) -> (GraphText, Graph) {
    let text = GraphText::parse(&folder.0.join("g.toml"), text);
    let (graph, _) = check(&text, &catalog()).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    (text, graph)
}

#[test]
fn every_parameter_that_is_declared_as_a_file_is_locked() {
    let folder = Folder::new("declared");
    write_all(&folder);
    let (text, graph) = parsed(&folder, GRAPH);
    let lock = Lock::of(&graph, &catalog(), &Loader::default(), &text, &[]);
    let data: Vec<(Kind, &str)> = lock
        .files
        .iter()
        .filter(|file| !file.kind.is_code() && file.kind != Kind::Runtime)
        .map(|file| (file.kind, file.name.as_str()))
        .collect();
    let expected = [
        (Kind::Model, "n.model"),
        (Kind::Weights, "n.model/w.bin"),
        (Kind::File, "n.labels"),
        (Kind::File, "n.arm"),
        (Kind::Calibration, "n.scope_calibration"),
        (Kind::Input, "n.left"),
        (Kind::Calibration, "n.calibration"),
        (Kind::Calibration, "n.calibration;2"),
    ];
    assert_eq!(data, expected);
    assert!(lock.files.iter().all(|file| file.sha256.len() == 64), "{lock:?}");
    assert!(lock.differences(&Lock::of(&graph, &catalog(), &Loader::default(), &text, &[])).is_empty());
    // Each one counts.
    for (_, name) in expected {
        let (_, param) = name.split_once('.').expect("node.param");
        let file = match param {
            "model" => "net.onnx",
            "model/w.bin" => "w.bin",
            "labels" => "names.txt",
            "arm" => "arm.urdf",
            "scope_calibration" => "scope.yml",
            "left" => "left.png",
            "calibration" => "l.yml",
            _ => "r.yml",
        };
        let before = std::fs::read(folder.0.join(file)).expect("it is there");
        let other = if file == "net.onnx" { [model(), field(2, b"x")].concat() } else { b"other".to_vec() };
        folder.write(file, &other);
        let now = Lock::of(&graph, &catalog(), &Loader::default(), &text, &[]);
        let differences: Vec<String> = lock.differences(&now).iter().map(ToString::to_string).collect();
        assert_eq!(differences.len(), 1, "{file}: {differences:?}");
        assert!(differences[0].contains(&format!("`{name}` has changed")), "{differences:?}");
        folder.write(file, &before);
    }
}

/// The sealed copies of all files, as nodes would read them.
fn sealed(folder: &Folder, graph: &Graph) -> Seal {
    let files = depends::data(graph, &catalog(), &folder.0);
    let files: Vec<_> = files.into_iter().filter(|file| file.kind != Kind::Runtime).collect();
    let (seal, locked, _) = Seal::of(&files, &folder.0);
    assert!(locked.iter().all(|file| !file.sha256.is_empty()), "{locked:?}");
    seal
}

fn value<'g>(graph: &'g Graph, name: &str) -> &'g ParamValue {
    &graph.nodes[0].params[catalog().node_types[0].param(name).expect("declared")]
}

fn read(path: &Path) -> String {
    String::from_utf8_lossy(&std::fs::read(path).expect("it can be read")).into_owned()
}

#[test]
fn nodes_read_copies_that_hold_what_was_compared() {
    let folder = Folder::new("copies");
    write_all(&folder);
    let (_, graph) = parsed(&folder, GRAPH);
    let seal = sealed(&folder, &graph);
    // Everything is replaced behind its back.
    for name in ["net.onnx", "w.bin", "names.txt", "arm.urdf", "scope.yml", "l.yml", "r.yml"] {
        folder.write(name, b"swapped");
    }
    let mut run = graph.clone();
    seal.apply(&mut run, &catalog()).expect("all were compared");
    for (name, file) in [("labels", "names.txt"), ("arm", "arm.urdf"), ("scope_calibration", "scope.yml")] {
        let ParamValue::Path(copy) = value(&run, name) else { panic!("a path") };
        assert_eq!(read(copy), format!("contents of {file}"));
        assert!(std::fs::write(copy, "x").is_err(), "nobody can change it");
    }
    let ParamValue::Text(list) = value(&run, "calibration") else { panic!("a text") };
    let parts: Vec<String> = list.split(';').map(|part| read(Path::new(part))).collect();
    assert_eq!(parts, ["contents of l.yml", "contents of r.yml"]);
    // The model carries its weights.
    let ParamValue::Path(copy) = value(&run, "model") else { panic!("a path") };
    let bytes = std::fs::read(copy).expect("the copy");
    let bundle = panoscope_base::onnx::unbundle(&bytes).expect("whole");
    assert_eq!(bytes[..bundle.model_len], model());
    let (name, range) = &bundle.weights[0];
    assert_eq!((name.as_str(), &bytes[range.clone()]), ("w.bin", &b"contents of w.bin"[..]));
    // What is written, what a source reads and plain texts stay as they are.
    for name in ["out", "left", "title"] {
        assert_eq!(value(&run, name), value(&graph, name), "{name}");
    }
    // Sealing twice changes nothing, and neither does a graph with other values: unchanged files keep their paths.
    let mut again = run.clone();
    seal.apply(&mut again, &catalog()).expect("sealed before");
    assert_eq!(again, run);
}

#[test]
fn a_file_that_was_removed_is_read_from_its_copy() {
    let folder = Folder::new("removed");
    write_all(&folder);
    let (_, mut graph) = parsed(&folder, GRAPH);
    let seal = sealed(&folder, &graph);
    for name in ["names.txt", "arm.urdf", "l.yml"] {
        std::fs::remove_file(folder.0.join(name)).expect("removed");
    }
    seal.apply(&mut graph, &catalog()).expect("all were compared");
    let ParamValue::Path(copy) = value(&graph, "labels") else { panic!("a path") };
    assert_eq!(read(copy), "contents of names.txt");
}

#[test]
fn a_change_that_names_another_file_is_refused() {
    let folder = Folder::new("another");
    write_all(&folder);
    folder.write("other.txt", b"other");
    let seal = sealed(&folder, &parsed(&folder, GRAPH).1);
    let changes = [
        ("names.txt\", arm", "other.txt\", arm", "labels"),
        ("l.yml; r.yml", "l.yml; other.txt", "calibration"),
        ("left.png", "other.txt", "left"),
    ];
    for (from, to, name) in changes {
        let (_, mut graph) = parsed(&folder, &GRAPH.replacen(from, to, 1));
        let error = seal.apply(&mut graph, &catalog()).expect_err("it was not compared");
        assert_eq!((error.node.as_str(), error.param.as_str()), ("n", name));
        assert!(error.to_string().contains("other.txt") && error.to_string().contains("lock the graph"), "{error}");
    }
    // The same file under another name is no other file.
    let spelled = GRAPH.replace("labels = \"names.txt\"", "labels = \"./x/../names.txt\"");
    let (_, mut graph) = parsed(&folder, &spelled);
    seal.apply(&mut graph, &catalog()).expect("it was compared");
}
