//! `panoscope-editor GRAPH`, started by `panoscope edit GRAPH`. Exit codes: 0 success, 1 the window could not be opened, 2 the file cannot be
//! read.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Parser;
use eframe::egui::vec2;
use panoscope_editor::app::{App, Options};
use panoscope_editor::arrangement::Arrangement;
use panoscope_editor_widgets::{theme, window};
use panoscope_graph::GraphText;
use panoscope_loader::Loader;

/// Shows a running graph and edits it.
#[derive(Parser)]
#[command(name = "panoscope-editor", version)]
struct Arguments {
    /// Graph file.
    graph: PathBuf,
    #[command(flatten)]
    given: window::Given,
    #[command(flatten)]
    window: window::Arguments,
    /// Dark or light; `system` is as the desktop.
    #[arg(long, default_value = "system")]
    theme: theme::Choice,
    /// Writes how the graph is arranged in a window of `--size` (JSON: scale, least text, shares of the window) and exits. Nothing runs.
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["screenshot", "measure"])]
    arrangement: Option<PathBuf>,
}

panoscope_engine::guard_exits!();

fn main() {
    panoscope_engine::heap::keep_large_blocks_apart();
    window::listen_to_signals();
    let code = run(&window::parse());
    window::leave(code)
}

/// Whether a graph file can be created at this path.
fn in_a_folder(file: &Path) -> bool {
    let folder = file.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    folder.is_dir() && file.extension().is_some_and(|e| e == "toml")
}

/// Writes how the graph is arranged; returns the exit code.
fn write_arrangement(arguments: &Arguments, text: &str, file: &Path) -> i32 {
    let paths = GraphText::parse_with(&arguments.graph, text, &arguments.given.options()).plugin_paths();
    let loader = Arc::new(Loader::search(&panoscope_loader::search_path(&paths)));
    let (width, height) = arguments.window.size;
    let seen = Arrangement::of(&arguments.graph, text, loader, vec2(width, height));
    match std::fs::write(file, format!("{:#}\n", seen.json())) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: {} was not written: {error}", file.display());
            1
        }
    }
}

fn run(arguments: &Arguments) -> i32 {
    let text = match std::fs::read_to_string(&arguments.graph) {
        Ok(text) => text,
        // A new file: the window offers templates.
        Err(error) if error.kind() == std::io::ErrorKind::NotFound && in_a_folder(&arguments.graph) => String::new(),
        Err(error) => {
            eprintln!("error: {} cannot be read: {error}", arguments.graph.display());
            return 2;
        }
    };
    if let Some(file) = &arguments.arrangement {
        return write_arrangement(arguments, &text, file);
    }
    let shot = arguments.window.shot();
    let viewport = window::viewport(&arguments.graph, "panoscope-editor", arguments.window.size);
    let path = arguments.graph.clone();
    let options = Options {
        frames: arguments.window.frames,
        scale: arguments.window.scale,
        opener: None,
        theme: arguments.theme,
        shot,
        given: arguments.given.options(),
        config: panoscope_editor_model::arguments::config_folder(),
    };
    window::open(viewport, move |cc| Ok(Box::new(App::open(&cc.egui_ctx, &path, &text, options)?)))
}
