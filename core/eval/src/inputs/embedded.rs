//! Shipped graphs that the program contains, with their parts, so that measurements do not depend on the working
//! folder.

use std::path::Path;

use panoscope_graph::{GraphOptions, GraphText};

macro_rules! shipped {
    ($($file:literal)*) => { [$(($file, include_str!(concat!("../../../../graphs/", $file)))),*] };
}

const FILES: [(&str, &str); 9] = shipped![
    "panorama.toml"
    "stitch_conventional.toml"
    "stitch_roi.toml"
    "stitch_grid.toml"
    "thesis_chapter2.toml"
    "thesis_chapter4.toml"
    "parts/panorama_surf.toml"
    "parts/panorama_disparity.toml"
    "parts/panorama_grid.toml"
];

/// A graph by its path in the folder of graphs; `None` if the program does not contain it.
pub fn graph(file: &str) -> Option<GraphText> {
    // No file is read from this folder.
    let folder = std::path::absolute(Path::new("embedded-graphs")).ok()?;
    let (_, text) = FILES.iter().find(|(name, _)| *name == file)?;
    let texts = FILES.iter().map(|(name, text)| (folder.join(name), (*text).to_owned())).collect();
    Some(GraphText::parse_with(&folder.join(file), text, &GraphOptions { texts, ..GraphOptions::default() }))
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
