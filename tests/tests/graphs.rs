//! Every graph that ships is right, and says what it shows.

use panoscope_graph::GraphText;
use panoscope_graph::check;
use panoscope_runtime::{Loader, loader};

#[test]
fn every_shipped_graph_checks() {
    let folder = panoscope_tests::root().join("graphs");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).expect("graphs").flatten() {
        let path = entry.path();
        if path.extension().is_none_or(|e| e != "toml") {
            continue;
        }
        let text = GraphText::load(&path).unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
        assert!(text.text().starts_with("# "), "{} does not open with what it shows", path.display());
        let loader = Loader::search(&loader::search_path(&text.plugin_paths()));
        let catalog = loader.catalog(&text.plugins());
        let checked = check(&text, &catalog);
        // A graph on files of the user's names none itself.
        let needs_files = path.file_name().is_some_and(|n| n.to_string_lossy().ends_with("_files.toml"));
        assert!(checked.graph.is_some() || needs_files, "{}", checked.diagnostics.render(false));
        count += 1;
    }
    assert!(count >= 2, "only {count} graphs were found");
}
