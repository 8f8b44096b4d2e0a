//! Shipped graphs that the program contains, with their parts, so that measurements do not depend on the working
//! folder.

use std::path::{Path, PathBuf};

use panoscope_graph::{GraphOptions, GraphText};

macro_rules! shipped {
    ($($file:literal)*) => { [$(($file, include_str!(concat!("../../../graphs/", $file)))),*] };
}

const FILES: [(&str, &str); 10] = shipped![
    "panorama.toml"
    "stitch_conventional.toml"
    "stitch_roi.toml"
    "stitch_grid.toml"
    "thesis_chapter2.toml"
    "thesis_chapter4.toml"
    "parts/panorama_surf.toml"
    "parts/panorama_disparity.toml"
    "parts/panorama_grid.toml"
    "parts/stereo_depth.toml"
];

/// Path by which graphs that are opened with [`options`] name an embedded file; no file is read from its folder.
pub fn path(file: &str) -> PathBuf {
    let folder = Path::new("embedded-graphs");
    std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned()).join(file)
}

/// Options with which graphs may have embedded files as parts.
pub fn options() -> GraphOptions {
    let texts = FILES.iter().map(|(name, text)| (path(name), (*text).to_owned())).collect();
    GraphOptions { texts, ..GraphOptions::default() }
}

/// A graph by its path in the folder of graphs; `None` if the program does not contain it.
pub fn graph(file: &str) -> Option<GraphText> {
    let (_, text) = FILES.iter().find(|(name, _)| *name == file)?;
    Some(GraphText::parse_with(&path(file), text, &options()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn embedded_graphs_find_their_parts() {
        for (file, _) in FILES.iter().filter(|(file, _)| !file.starts_with("parts/")) {
            let text = graph(file).unwrap();
            assert!(text.diagnostics().is_empty(), "{}", text.diagnostics().render(false));
            assert!(text.outline().iter().any(|node| node.id.starts_with("wide/")), "{file} has no part");
        }
    }
}
