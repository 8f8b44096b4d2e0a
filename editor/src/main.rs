//! `panoscope-editor GRAPH`, started by `panoscope edit GRAPH`. Exit codes: 0 done, 1 no window or a failed run, 2 no such file.

use std::path::PathBuf;

use clap::Parser;
use eframe::egui::{ViewportBuilder, vec2};
use panoscope_editor::app::{App, Options, close_on_signals};

/// Shows a graph while it runs, to change it and to set its parameters.
#[derive(Parser)]
#[command(name = "panoscope-editor", version)]
struct Arguments {
    /// Graph file.
    graph: PathBuf,
    /// Size of everything in the window; Ctrl and + or - change it.
    #[arg(long, default_value_t = 1.0, value_parser = scale)]
    scale: f32,
    /// Ticks that each source makes; without it, until the sources end or the window is closed.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Width and height of the window in points.
    #[arg(long, default_value = "1440x900", value_parser = size)]
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

fn scale(text: &str) -> Result<f32, String> {
    let scale = text.parse::<f32>().map_err(|e| e.to_string())?;
    if (0.5..=4.0).contains(&scale) { Ok(scale) } else { Err("from 0.5 to 4".to_owned()) }
}

fn size(text: &str) -> Result<(f32, f32), String> {
    let parts = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    parts.filter(|&(w, h)| w >= 480.0 && h >= 320.0).ok_or_else(|| "as in 1440x900, at least 480x320".to_owned())
}

fn main() {
    let arguments = Arguments::parse();
    let code = run(&arguments);
    // As the command does: destructors of foreign libraries are not to be trusted. Files are finished by now.
    use std::io::Write;
    let _ = std::io::stdout().flush();
    let _ = std::io::stderr().flush();
    // SAFETY: leaves the process; nothing of it is used afterwards.
    unsafe { libc::_exit(code) }
}

fn run(arguments: &Arguments) -> i32 {
    let text = match std::fs::read_to_string(&arguments.graph) {
        Ok(text) => text,
        Err(error) => {
            eprintln!("error: {} cannot be read: {error}", arguments.graph.display());
            return 2;
        }
    };
    let options = Options {
        frames: arguments.frames,
        scale: arguments.scale,
        screenshot: arguments.screenshot.clone().map(|file| (file, arguments.after)),
        measure: arguments.measure.clone().map(|file| (file, arguments.after)),
        script: arguments.actions.clone(),
    };
    let name = arguments.graph.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let native = eframe::NativeOptions {
        viewport: ViewportBuilder::default()
            .with_title(format!("{name} · Panoscope"))
            .with_app_id("panoscope-editor")
            .with_inner_size(vec2(arguments.size.0, arguments.size.1))
            .with_min_inner_size(vec2(480.0, 320.0)),
        renderer: eframe::Renderer::Glow,
        ..eframe::NativeOptions::default()
    };
    let path = arguments.graph.clone();
    let made = eframe::run_native(
        "panoscope-editor",
        native,
        Box::new(move |cc| {
            close_on_signals(&cc.egui_ctx);
            Ok(Box::new(App::open(&cc.egui_ctx, &path, &text, options)?))
        }),
    );
    match made {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: no window could be opened: {error}");
            1
        }
    }
}
