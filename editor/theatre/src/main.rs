//! `panoscope-theatre GRAPH`, started by `panoscope theatre GRAPH`. Exit codes: 0 done, 1 no window or a failed run, 2 no such file, or one that
//! is not taken.

use std::path::PathBuf;

use clap::Parser;
use panoscope_editor_widgets::{Shot, window};
use panoscope_theatre::{Options, Ready, Refused, Theatre};

/// The surgeon's window: pictures full screen, and only the settings that the preset offers.
#[derive(Parser)]
#[command(name = "panoscope-theatre", version)]
struct Arguments {
    /// Graph file.
    graph: PathBuf,
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
    /// Does something before that: a step of the window's script. May be given again.
    #[arg(long = "do", value_name = "ACTION")]
    actions: Vec<String>,
}

panoscope_engine::guard_exits!();

fn main() {
    window::listen_to_signals();
    let code = run(&Arguments::parse());
    window::leave(code)
}

fn run(arguments: &Arguments) -> i32 {
    let text = match std::fs::read_to_string(&arguments.graph) {
        Ok(text) => text,
        Err(error) => {
            eprintln!("error: {} cannot be read: {error}", arguments.graph.display());
            return 2;
        }
    };
    let after = |file: &Option<PathBuf>| file.clone().map(|file| (file, arguments.after));
    let shot = Shot::new(after(&arguments.screenshot), after(&arguments.measure), &arguments.actions);
    let viewport = window::viewport(&arguments.graph, "panoscope-theatre", arguments.size)
        .with_fullscreen(!arguments.windowed)
        .with_decorations(arguments.windowed);
    let path = arguments.graph.clone();
    let ready = match Ready::look(&path, &text, arguments.unlocked) {
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
        frames: arguments.frames,
        scale: arguments.scale,
        shot,
    };
    window::open(viewport, move |cc| Ok(Box::new(Theatre::of(&cc.egui_ctx, &path, &text, options, ready)?)))
}
