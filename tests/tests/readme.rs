//! The README's list of plugins is the plugins.

use panoscope_runtime::{Loader, loader};

#[test]
fn readme_lists_every_plugin_and_node() {
    let readme = std::fs::read_to_string(panoscope_tests::root().join("README.md")).expect("README.md");
    let loader = Loader::search(&loader::search_path(&[]));
    let mut count = 0;
    for found in loader.found() {
        let plugin = &found.note.name;
        let folder = panoscope_tests::root().join("plugins").join(plugin);
        if !folder.is_dir() {
            continue; // Somebody's own plugin lies in the same folder.
        }
        let row = readme.lines().find(|line| line.starts_with(&format!("| `{plugin}` |")));
        let row = row.unwrap_or_else(|| panic!("README.md has no row for the plugin `{plugin}`"));
        for node in &found.note.node_types {
            assert!(row.contains(&format!("`{node}`")), "the row of `{plugin}` does not name its node `{node}`");
        }
        count += 1;
    }
    let folders = std::fs::read_dir(panoscope_tests::root().join("plugins")).expect("plugins").flatten().count();
    assert_eq!(count, folders, "plugins built and folders in plugins/ differ");
}
