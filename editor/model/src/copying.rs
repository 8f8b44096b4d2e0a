//! Saves a graph that comes with an installation: as a copy with its parts and overlays, outside the installation.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use panoscope_base::files;
use panoscope_graph::{GraphOptions, installed};

use crate::disk::SaveError;
use crate::document::Document;

/// A name that no folder has: `name`, `name_2`, `name_3`...
fn free_folder(parent: &Path, name: &str) -> PathBuf {
    let numbered = (2..).map(|n| parent.join(format!("{name}_{n}")));
    let mut all = std::iter::once(parent.join(name)).chain(numbered);
    all.find(|folder| !folder.exists()).unwrap_or_else(|| parent.join(name))
}

/// Where a copy of the graph file goes, if the file belongs to an installation: a folder of its own in
/// [`installed::output_dir`], so that `../out/...` in the copy is where the original writes.
pub fn destination(graph: &Path) -> Option<PathBuf> {
    installed::data_dir(graph.parent().unwrap_or(Path::new("")))?;
    let name = graph.file_stem().unwrap_or_default().to_string_lossy();
    Some(free_folder(&installed::output_dir(), &name).join(graph.file_name()?))
}

/// Saves the document with its parts and overlays as `destination`; the document is the copy from then on. Files keep their positions relative
/// to the graph file; those outside its folder are not copied.
///
/// # Errors
/// A file or folder cannot be written; the document and the installation are unchanged.
pub fn save_as(document: &mut Document, destination: &Path) -> Result<(), SaveError> {
    let (from, to) = (GraphOptions::key(document.path()), folder(destination));
    let from = folder(&from);
    let moved = |path: &Path| Some(to.join(path.strip_prefix(from).ok()?));
    let files: Vec<(PathBuf, PathBuf, String)> =
        document.files().into_iter().filter_map(|(path, text)| Some((path.clone(), moved(&path)?, text))).collect();
    for (path, text) in
        files.iter().map(|(_, path, text)| (path.as_path(), text.as_str())).chain([(destination, &**document.text())])
    {
        let fail = |cause| SaveError { path: path.to_owned(), cause };
        std::fs::create_dir_all(folder(path)).map_err(fail)?;
        files::replace(path, text.as_bytes()).map_err(fail)?;
    }
    let moved: BTreeMap<PathBuf, PathBuf> = files.into_iter().map(|(from, to, _)| (from, to)).collect();
    document.move_to(destination, &moved);
    Ok(())
}

fn folder(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn no_folder_is_written_over() {
        let root = std::env::temp_dir().join(format!("panoscope_copying_free_{}", std::process::id()));
        fs::create_dir_all(root.join("wide")).expect("a folder");
        assert_eq!(free_folder(&root, "wide"), root.join("wide_2"));
        assert_eq!(free_folder(&root, "deep"), root.join("deep"));
        fs::remove_dir_all(root).expect("removed");
    }
}
