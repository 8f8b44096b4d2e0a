//! Graphs that show how a node type is used.

use std::path::{Path, PathBuf};

use panoscope_graph::GraphText;

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

/// Graphs in folders that have a node of a type, also inside a part; those with fewest nodes first. `but` is left out.
pub fn of_type(node_type: &str, folders: &[PathBuf], but: &Path) -> Vec<PathBuf> {
    let but = but.canonicalize().unwrap_or_else(|_| but.to_owned());
    let files = folders.iter().flat_map(|folder| {
        let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path())
            .take(MAX_FILES)
            .collect();
        files.sort();
        files
    });
    let is_graph = |file: &PathBuf| {
        let small = std::fs::metadata(file).is_ok_and(|meta| meta.is_file() && meta.len() <= MAX_BYTES);
        small && file.extension().is_some_and(|e| e == "toml") && file.canonicalize().map_or(true, |whole| whole != but)
    };
    let mut found: Vec<(usize, PathBuf)> = files
        .filter(is_graph)
        .filter_map(|file| {
            let text = GraphText::load(&file).ok()?;
            let outline = text.outline();
            outline.iter().any(|node| node.type_name == node_type).then_some((outline.len(), file))
        })
        .collect();
    found.sort();
    found.into_iter().map(|(_, file)| file).collect()
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
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}
