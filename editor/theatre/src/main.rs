//! `panoscope-theatre GRAPH`, started by `panoscope theatre GRAPH`. Exit codes: 0 done, 1 no window or a failed run, 2 no such file, or one that
//! is not taken.

use std::path::PathBuf;

use clap::Parser;
use panoscope_editor_widgets::window;
use panoscope_graph::GraphText;
use panoscope_theatre::{Options, Ready, Refused, Theatre};

/// The surgeon's window: pictures full screen, and only the settings that the preset offers.
#[derive(Parser)]
#[command(name = "panoscope-theatre", version)]
struct Arguments {
    /// Graph file.
    graph: PathBuf,
    #[command(flatten)]
    given: window::Given,
    /// Opens although the graph, a plugin, a model or the calibration differs from its lock.
    #[arg(long)]
    unlocked: bool,
    /// Folder for stills and clips.
    #[arg(long, value_name = "DIR", default_value = "out")]
    into: PathBuf,
    /// Begins the names of stills and clips, which are numbers only otherwise.
    #[arg(long, value_name = "TEXT")]
    label: Option<String>,
    /// In a window instead of the whole screen.
    #[arg(long)]
    windowed: bool,
    #[command(flatten)]
    window: window::Arguments,
}

panoscope_engine::guard_exits!();

fn main() {
    window::listen_to_signals();
    let code = run(&window::parse());
    window::leave(code)
}

fn run(arguments: &Arguments) -> i32 {
    let text = match GraphText::load_with(&arguments.graph, &arguments.given.options()) {
        Ok(text) => text,
        Err(diagnostics) => {
            eprintln!("{}", diagnostics.render(false).trim_end());
            return 2;
        }
    };
    let shot = arguments.window.shot();
    let viewport = window::viewport(&arguments.graph, "panoscope-theatre", arguments.window.size)
        .with_fullscreen(!arguments.windowed)
        .with_decorations(arguments.windowed);
    let path = arguments.graph.clone();
    let ready = match Ready::of(&text, arguments.unlocked) {
        Ok(ready) => ready,
        Err(error) => {
            // On the terminal, and in a window where there is a screen.
            eprintln!("{}", error.told());
            let _ = window::show(viewport, move |cc| Ok(Box::new(Refused::new(&cc.egui_ctx, &path, &error, shot))));
            return 2;
        }
    };
    let options = Options {
        folder: arguments.into.clone(),
        label: arguments.label.clone(),
        unlocked: arguments.unlocked,
        frames: arguments.window.frames,
        scale: arguments.window.scale,
        shot,
    };
    window::open(viewport, move |cc| Ok(Box::new(Theatre::of(&cc.egui_ctx, &path, options, ready)?)))
}
