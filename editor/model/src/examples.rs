//! Graphs and parts beside the edited graph, of an installation or of the source tree: how node types are used, and parts to add.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use panoscope_graph::GraphText;
use panoscope_graph::edit::{GraphEdit, PartPortKind};

use crate::folding::opening;

/// Maximum size of a graph file that is looked at, bytes.
const MAX_BYTES: u64 = 256 << 10;
/// Maximum number of files in a folder that are looked at.
const MAX_FILES: usize = 200;
/// Folders between the program and the folder that holds the graphs of an installation or of the source tree.
const DEPTH: usize = 5;

/// Folders with graphs: that of the graph file itself, then those of the installation or of the source tree.
pub fn folders(graph: &Path) -> Vec<PathBuf> {
    let own = graph.parent().map(|folder| if folder.as_os_str().is_empty() { Path::new(".") } else { folder });
    let program = std::env::current_exe().ok();
    let above = program.iter().flat_map(|program| program.ancestors().skip(1).take(DEPTH));
    let installed = above.flat_map(|folder| [folder.join("graphs"), folder.join("share/panoscope/graphs")]);
    let mut all: Vec<PathBuf> = own.map(Path::to_owned).into_iter().chain(installed).filter(|f| f.is_dir()).collect();
    let mut known = Vec::new();
    all.retain(|folder| {
        let whole = folder.canonicalize().unwrap_or_else(|_| folder.clone());
        let is_new = !known.contains(&whole);
        known.push(whole);
        is_new
    });
    all
}

/// The graph files in folders, in order.
fn graphs(folders: &[PathBuf]) -> impl Iterator<Item = PathBuf> + '_ {
    let files = folders.iter().flat_map(|folder| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).take(MAX_FILES).collect();
        files.sort();
        files
    });
    files.filter(|file| {
        let small = std::fs::metadata(file).is_ok_and(|meta| meta.is_file() && meta.len() <= MAX_BYTES);
        small && file.extension().is_some_and(|e| e == "toml")
    })
}

/// Graphs in folders that have a node of a type, also inside a part; those with fewest nodes first. `but` is left out.
pub fn of_type(node_type: &str, folders: &[PathBuf], but: &Path) -> Vec<PathBuf> {
    let but = but.canonicalize().unwrap_or_else(|_| but.to_owned());
    let others = graphs(folders).filter(|file| file.canonicalize().map_or(true, |whole| whole != but));
    let mut found: Vec<(usize, PathBuf)> = others
        .filter_map(|file| {
            let text = GraphText::load(&file).ok()?;
            let outline = text.outline();
            outline.iter().any(|node| node.type_name == node_type).then_some((outline.len(), file))
        })
        .collect();
    found.sort();
    found.into_iter().map(|(_, file)| file).collect()
}

/// How often the graphs in folders use each node type and each part, by type name and by the part's file name without its extension.
pub fn uses(folders: &[PathBuf]) -> HashMap<String, usize> {
    let mut uses = HashMap::new();
    for text in graphs(folders).filter_map(|file| std::fs::read_to_string(file).ok()) {
        let table: toml::Table = text.parse().unwrap_or_default();
        let nodes = table.get("nodes").and_then(toml::Value::as_table).into_iter().flatten();
        for (_, node) in nodes {
            let named = |key: &str| node.get(key).and_then(toml::Value::as_str);
            let node_type = named("type").map(|name| name.rsplit('/').next().unwrap_or(name).to_owned());
            let part =
                named("graph").and_then(|file| Some(Path::new(file).file_stem()?.to_string_lossy().into_owned()));
            if let Some(name) = node_type.or(part) {
                *uses.entry(name).or_default() += 1;
            }
        }
    }
    uses
}

/// A part that can be added to a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartFile {
    /// Its file.
    pub path: PathBuf,
    /// Name of the file without its extension.
    pub name: String,
    /// The comment at its beginning.
    pub doc: String,
    /// Names of its inputs and outputs.
    pub ports: Vec<String>,
}

/// A path as a graph in `folder` writes it: relative if it is inside that folder, else absolute.
pub fn written(path: &Path, folder: &Path) -> PathBuf {
    let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let path = whole(path);
    path.strip_prefix(whole(folder)).map(Path::to_owned).unwrap_or(path)
}

/// The parts in the folders `parts` of folders of graphs.
pub fn parts(folders: &[PathBuf]) -> Vec<PartFile> {
    let folders: Vec<PathBuf> = folders.iter().map(|folder| folder.join("parts")).collect();
    let part = |path: PathBuf| {
        let text = std::fs::read_to_string(&path).ok()?;
        let edit = GraphEdit::parse(&text).ok()?;
        let ports = [PartPortKind::Input, PartPortKind::Output].into_iter().flat_map(|kind| edit.part_port_names(kind));
        let ports: Vec<String> = ports.collect();
        let name = path.file_stem()?.to_string_lossy().into_owned();
        (!ports.is_empty()).then(|| PartFile { name, doc: opening(&text), ports, path })
    };
    graphs(&folders).filter_map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_graph_with_the_type_comes_first() {
        let folder = std::env::temp_dir().join(format!("panoscope_examples_{}", std::process::id()));
        std::fs::create_dir_all(folder.join("parts")).expect("a folder");
        let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("written");
        write("parts/calm.toml", "[part]\n[nodes.m]\ntype = \"smooth\"\n");
        write("large.toml", "[nodes.a]\ntype = \"smooth\"\n[nodes.b]\ntype = \"pass\"\n");
        write("small.toml", "[nodes.p]\ngraph = \"parts/calm.toml\"\n");
        write("other.toml", "[nodes.a]\ntype = \"pass\"\n");
        write("broken.toml", "[nodes.a\ntype = \"smooth\"");
        write("me.toml", "[nodes.a]\ntype = \"smooth\"\n");
        let folders = folders(&folder.join("me.toml"));
        assert_eq!(folders.first(), Some(&folder));
        let found = of_type("smooth", &folders[..1], &folder.join("me.toml"));
        assert_eq!(found, [folder.join("small.toml"), folder.join("large.toml")]);
        let uses = uses(&folders[..1]);
        assert_eq!((uses["smooth"], uses["pass"], uses["calm"]), (2, 2, 1));
        write(
            "parts/wide.toml",
            "# Makes it wide.\n[part]\ninputs = { left = \"m.image\" }\n[nodes.m]\ntype = \"smooth\"\n",
        );
        let parts = parts(&folders[..1]);
        assert_eq!(parts.len(), 1, "a part without ports cannot be wired: {parts:?}");
        assert_eq!(
            (parts[0].name.as_str(), parts[0].doc.as_str(), &parts[0].ports[..]),
            ("wide", "Makes it wide.", &["left".to_owned()][..])
        );
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}
