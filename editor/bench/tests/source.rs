//! The source of a node in Python: opened beside the graph, edited, and swapped into the running graph.

use crate::common::{Folder, Window, has_plugin, input, nothing_lost};
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;

const NONE: Modifiers = Modifiers::NONE;

const SOURCE: &str = "import panoscope as ps\n\n\n@ps.node(family=\"filter\")\nclass Shade:\n    \"\"\"Measures the light.\"\"\"\n\n\
                      \x20   def process(self, image: ps.Gray8) -> ps.Gray8:\n        ps.metric(\"version\", 1)\n        return image\n";

const GRAPH: &str = r#"plugin_paths = ["."]
plugins = ["flow", "fixtures", "shade"]

[nodes.a]
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 50.0 }

[nodes.kept]
type = "ledger"
inputs = { images = [{ from = "a.image", queue = 64 }] }
params = { path = "kept.jsonl" }

[nodes.b]
type = "frames"
params = { width_px = 64, height_px = 48, format = "gray8", rate_hz = 20.0 }

[nodes.shade]
type = "shade"
inputs = { image = "b.image" }

[nodes.sink]
type = "drain"
inputs = { image = "shade.image" }
"#;

fn has_python() -> bool {
    let output = std::process::Command::new("python3").args(["-c", "import numpy"]).output();
    // The package of this build lies beside the programs, above the tests.
    let program = std::env::current_exe().expect("this program");
    let package = program.parent().map(|folder| folder.join("../python/panoscope/__init__.py"));
    let has = output.is_ok_and(|output| output.status.success()) && package.is_some_and(|file| file.is_file());
    if !has {
        panoscope_testing::skipped!("no python3 with NumPy, or no package of this build");
    }
    has
}

fn until_version(window: &mut Window, version: f64) {
    window.until(&format!("version {version} runs"), |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.report().nodes.get("shade").is_some_and(|node| node.metrics.get("version") == Some(&version))
    });
}

#[test]
fn a_saved_source_is_swapped_in_and_a_wrong_one_is_refused() {
    if !has_plugin("flow") || !has_python() {
        return;
    }
    let folder = Folder::new("source");
    let file = folder.write("shade.py", SOURCE);
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    until_version(&mut window, 1.0);
    window.select("shade");
    window.key(NONE, Key::X);
    window.until_shown("Close source");
    assert_eq!(window.app().source_file().map(|source| source.text.as_str()), Some(SOURCE));
    input::all_named(&window.harness, "source", 6);
    let replace = |window: &mut Window, text: &str| {
        window.harness.get_by_label("Source").focus();
        window.steps(2);
        window.key(Modifiers::COMMAND, Key::A);
        window.harness.get_by_label("Source").type_text(text);
        window.steps(2);
        assert!(window.app().source_file().is_some_and(|source| source.is_changed()));
        window.harness.get_by_label("Save and swap").click_accesskit();
        window.steps(3);
    };
    replace(&mut window, &SOURCE.replace("\"version\", 1", "\"version\", 2"));
    until_version(&mut window, 2.0);
    assert!(std::fs::read_to_string(&file).expect("saved").contains("\"version\", 2"));
    assert_eq!(std::fs::read_to_string(folder.0.join("shade.py.bak")).expect("the old text"), SOURCE);
    // A mistake is shown, and the old code runs on.
    replace(
        &mut window,
        "import panoscope as ps\n@ps.node()\nclass Shade:\n    def process(self, image) -> ps.Gray8: pass\n",
    );
    window.until("the mistake is known", |app| app.session().status().problem.is_some());
    window.until_shown("needs a packet type");
    until_version(&mut window, 2.0);
    replace(&mut window, &SOURCE.replace("\"version\", 1", "\"version\", 3"));
    until_version(&mut window, 3.0);
    window.harness.get_by_label("Close source").click_accesskit();
    window.steps(3);
    assert!(window.app().source_file().is_none());
    let report = window.close();
    nothing_lost(&folder, &report);
}
