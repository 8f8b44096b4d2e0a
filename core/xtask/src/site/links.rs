//! Links between the pages of the site.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// Anchors of each page, by its path in the repository.
pub type Anchors = BTreeMap<PathBuf, Vec<String>>;

/// Where a link leads.
#[derive(Debug, PartialEq, Eq)]
pub enum Link {
    /// Another site.
    Outside,
    /// A page, by its address from the page with the link.
    Page {
        address: String,
    },
    /// Another file of the repository.
    File {
        file: PathBuf,
        address: String,
    },
    /// A folder of the repository without a page.
    Folder,
    Nowhere {
        why: &'static str,
    },
}

/// Resolves a link in the page `from`; both are paths in the repository at `root`.
pub fn resolve(root: &Path, from: &Path, address: &str, anchors: &Anchors) -> Link {
    if address.contains("://") || address.starts_with("mailto:") {
        return Link::Outside;
    }
    let (path, anchor) = address.split_once('#').unwrap_or((address, ""));
    let file = if path.is_empty() { Some(from.to_owned()) } else { joined(from, path) };
    let Some(file) = file else { return Link::Nowhere { why: "it is outside the repository" } };
    let is_folder = root.join(&file).is_dir();
    let file = if is_folder { file.join("README.md") } else { file };
    let up = "../".repeat(from.components().count() - 1);
    if let Some(known) = anchors.get(&file) {
        if !anchor.is_empty() && !known.iter().any(|one| one == anchor) {
            return Link::Nowhere { why: "the page has no such heading" };
        }
        let anchor = if anchor.is_empty() { String::new() } else { format!("#{anchor}") };
        return Link::Page { address: format!("{up}{}{anchor}", target(&file).display()) };
    }
    if is_folder {
        return Link::Folder;
    }
    if !root.join(&file).is_file() {
        return Link::Nowhere { why: "it is not there" };
    }
    Link::File { address: format!("{up}{}", file.display()), file }
}

/// A relative path from the folder of a file, without `..`. `None` above the repository.
fn joined(from: &Path, path: &str) -> Option<PathBuf> {
    let mut parts: Vec<_> = from.parent()?.components().collect();
    for part in Path::new(path).components() {
        match part {
            Component::ParentDir => {
                parts.pop()?;
            }
            Component::Normal(_) => parts.push(part),
            _ => {}
        }
    }
    Some(parts.iter().collect())
}

/// The path of a page on the site.
pub fn target(page: &Path) -> PathBuf {
    if page.ends_with("README.md") { page.with_file_name("index.html") } else { page.with_extension("html") }
}

/// The anchor of a heading.
pub fn anchor(heading: &str) -> String {
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_resolved_from_the_folder_of_their_page() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let anchors: Anchors = [("README.md", "a"), ("core/README.md", "b"), ("core/cli/README.md", "c")]
            .map(|(file, anchor)| (file.into(), vec![anchor.to_owned()]))
            .into();
        let follow = |from: &str, to: &str| resolve(&root, Path::new(from), to, &anchors);
        let page = |address: &str| Link::Page { address: address.to_owned() };
        assert_eq!(follow("README.md", "core/README.md#b"), page("core/index.html#b"));
        assert_eq!(follow("core/cli/README.md", "../../README.md"), page("../../index.html"));
        assert_eq!(follow("README.md", "core"), page("core/index.html"), "a folder is its page");
        assert_eq!(follow("core/README.md", "#b"), page("../core/index.html#b"));
        assert_eq!(follow("README.md", "core/xtask/src"), Link::Folder);
        let file = Link::File { file: "Cargo.toml".into(), address: "../Cargo.toml".to_owned() };
        assert_eq!(follow("core/README.md", "../Cargo.toml"), file);
        assert_eq!(follow("README.md", "https://a.org/x"), Link::Outside);
        for (to, why) in [
            ("core/README.md#c", "the page has no such heading"),
            ("core/nothing.md", "it is not there"),
            ("../README.md", "it is outside the repository"),
        ] {
            assert_eq!(follow("README.md", to), Link::Nowhere { why }, "{to}");
        }
    }
}
