//! `panoscope-editor GRAPH`, started by `panoscope edit GRAPH`. Exit codes: 0 success, 1 the window could not be opened, 2 the file cannot be
//! read.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Parser;
use eframe::egui::vec2;
use panoscope_editor::app::{App, Options};
use panoscope_editor::arrangement::Arrangement;
use panoscope_editor_model::attaching;
use panoscope_editor_widgets::{theme, window};
use panoscope_graph::GraphText;
use panoscope_host::loader::Loader;

/// Shows a running graph and edits it.
#[derive(Parser)]
#[command(name = "panoscope-editor", version)]
struct Arguments {
    /// Graph file; with --attach, where a copy of the graph is saved.
    #[arg(required_unless_present = "attach")]
    graph: Option<PathBuf>,
    /// Edits the graph that runs on another machine, see `panoscope run --attachable`: NAME@ADDRESS, or a NAME of machines.toml in the folder
    /// panoscope of the user's configuration.
    #[arg(long, value_name = "NAME[@ADDRESS]", conflicts_with = "arrangement")]
    attach: Option<String>,
    /// Folder with the keys of this machine for --attach, made by `panoscope keys`; PANOSCOPE_KEYS where it is not given.
    #[arg(long, value_name = "DIR", requires = "attach")]
    keys: Option<PathBuf>,
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
    panoscope_engine::heap::keep_free(16 << 20);
    window::listen_to_signals();
    let arguments: Arguments = window::parse();
    arguments.window.apply_language();
    let code = run(&arguments);
    window::leave(code)
}

/// Whether a graph file can be created at this path.
fn in_a_folder(file: &Path) -> bool {
    let folder = file.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    folder.is_dir() && file.extension().is_some_and(|e| e == "toml")
}

/// Writes how the graph is arranged; returns the exit code.
fn write_arrangement(arguments: &Arguments, text: &str, file: &Path) -> i32 {
    let graph = arguments.graph.as_deref().unwrap_or(Path::new(""));
    let paths = GraphText::parse_with(graph, text, &arguments.given.options()).plugin_paths();
    let loader = Arc::new(Loader::search(&panoscope_host::loader::search_path(&paths)));
    let (width, height) = arguments.window.size;
    let seen = Arrangement::of(graph, text, loader, vec2(width, height));
    match std::fs::write(file, format!("{:#}\n", seen.json())) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: {} was not written: {error}", file.display());
            1
        }
    }
}

/// Opens the window on the graph of another machine.
fn attach(arguments: &Arguments, name: &str) -> i32 {
    let attachment = match attaching::open(name, arguments.keys.clone()) {
        Ok(attachment) => attachment,
        Err(error) => {
            eprintln!("error: {error}");
            return 2;
        }
    };
    if let Err(error) = attaching::wait(&attachment) {
        eprintln!("error: {error}");
        return 1;
    }
    let path = arguments.graph.clone().unwrap_or_else(|| format!("{}.toml", attachment.target().name).into());
    let viewport = window::viewport(&path, "panoscope-editor", arguments.window.size);
    let options = options(arguments);
    window::open(viewport, move |cc| Ok(Box::new(App::attached(&cc.egui_ctx, &path, attachment, options)?)))
}

fn options(arguments: &Arguments) -> Options {
    Options {
        frames: arguments.window.frames,
        scale: arguments.window.scale,
        opener: None,
        theme: arguments.theme,
        shot: arguments.window.shot(),
        given: arguments.given.options(),
        config: panoscope_editor_model::arguments::config_folder(),
    }
}

fn run(arguments: &Arguments) -> i32 {
    if let Some(name) = &arguments.attach {
        return attach(arguments, name);
    }
    let path = arguments.graph.clone().unwrap_or_default();
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        // A new file: the window offers templates.
        Err(error) if error.kind() == std::io::ErrorKind::NotFound && in_a_folder(&path) => String::new(),
        Err(error) => {
            eprintln!("error: {} cannot be read: {error}", path.display());
            return 2;
        }
    };
    if let Some(file) = &arguments.arrangement {
        return write_arrangement(arguments, &text, file);
    }
    let viewport = window::viewport(&path, "panoscope-editor", arguments.window.size);
    let options = options(arguments);
    window::open(viewport, move |cc| Ok(Box::new(App::open(&cc.egui_ctx, &path, &text, options)?)))
}
