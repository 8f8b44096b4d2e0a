//! `panoscope-editor GRAPH`, started by `panoscope edit GRAPH`. Exit codes: 0 done, 1 no window or a failed run, 2 no such file.

use std::path::{Path, PathBuf};

use clap::Parser;
use panoscope_editor::app::{App, Options};
use panoscope_editor_widgets::{Shot, window};

/// Shows a graph while it runs, to change it and to set its parameters.
#[derive(Parser)]
#[command(name = "panoscope-editor", version)]
struct Arguments {
    /// Graph file.
    graph: PathBuf,
    /// Size of everything in the window; Ctrl and + or - change it.
    #[arg(long, default_value_t = 1.0, value_parser = window::scale)]
    scale: f32,
    /// Ticks that each source makes; without it, until the sources end or the window is closed.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Width and height of the window in points.
    #[arg(long, default_value = "1440x900", value_parser = window::size)]
    size: (f32, f32),
    /// Writes a picture of the window (PNG or JPEG) and ends.
    #[arg(long, value_name = "FILE")]
    screenshot: Option<PathBuf>,
    /// Writes what the window and the graph cost (JSON) and ends.
    #[arg(long, value_name = "FILE.json", conflicts_with = "screenshot")]
    measure: Option<PathBuf>,
    /// Seconds until the screenshot is taken, or the costs are written.
    #[arg(long, default_value_t = 3.0)]
    after: f64,
    /// Does something before that: an action's name such as `heat`, `select:NODE`, `view:NODE.PORT`. May be given again.
    #[arg(long = "do", value_name = "ACTION")]
    actions: Vec<String>,
}

panoscope_engine::guard_exits!();

fn main() {
    window::listen_to_signals();
    let code = run(&Arguments::parse());
    window::leave(code)
}

/// Whether a file could be made there.
fn in_a_folder(file: &Path) -> bool {
    let folder = file.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    folder.is_dir() && file.extension().is_some_and(|e| e == "toml")
}

fn run(arguments: &Arguments) -> i32 {
    let text = match std::fs::read_to_string(&arguments.graph) {
        Ok(text) => text,
        // A file that is to be: templates are offered.
        Err(error) if error.kind() == std::io::ErrorKind::NotFound && in_a_folder(&arguments.graph) => String::new(),
        Err(error) => {
            eprintln!("error: {} cannot be read: {error}", arguments.graph.display());
            return 2;
        }
    };
    let after = |file: &Option<PathBuf>| file.clone().map(|file| (file, arguments.after));
    let shot = Shot::new(after(&arguments.screenshot), after(&arguments.measure), &arguments.actions);
    let viewport = window::viewport(&arguments.graph, "panoscope-editor", arguments.size);
    let path = arguments.graph.clone();
    let options = Options { frames: arguments.frames, scale: arguments.scale, shot };
    window::open(viewport, move |cc| Ok(Box::new(App::open(&cc.egui_ctx, &path, &text, options)?)))
}
