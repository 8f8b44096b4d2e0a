//! `panoscope-editor GRAPH`, started by `panoscope edit GRAPH`, and with `--theatre` by `panoscope theatre GRAPH`. Exit codes: 0 done, 1 no window
//! or a failed run, 2 no such file, or one that the theatre does not take.

use std::path::{Path, PathBuf};

use clap::Parser;
use eframe::egui::{ViewportBuilder, vec2};
use panoscope_editor::app::{App, Options, Shot, close_on_signals};
use panoscope_editor::theatre::{self, Ready, Refused, Theatre};

/// Shows a graph while it runs, to change it and to set its parameters.
#[derive(Parser)]
#[command(name = "panoscope-editor", version)]
struct Arguments {
    /// Graph file.
    graph: PathBuf,
    /// The surgeon's window: pictures full screen, and only the settings that the preset offers.
    #[arg(long)]
    theatre: bool,
    /// Theatre: opens although the graph, a plugin, a model or the calibration differs from its lock.
    #[arg(long, requires = "theatre")]
    unlocked: bool,
    /// Theatre: folder for stills and clips.
    #[arg(long, value_name = "DIR", default_value = "out", requires = "theatre")]
    into: PathBuf,
    /// Theatre: begins the names of stills and clips, which are numbers only otherwise.
    #[arg(long, value_name = "TEXT", requires = "theatre")]
    label: Option<String>,
    /// Theatre: in a window instead of the whole screen.
    #[arg(long, requires = "theatre")]
    windowed: bool,
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

panoscope_engine::guard_exits!();

fn main() {
    if let Err(error) = panoscope_engine::ending::signals::install() {
        eprintln!("warning: signals end the program without finishing files: {error}");
    }
    let arguments = Arguments::parse();
    let code = run(&arguments);
    // As the command does: destructors of foreign libraries are not to be trusted. Files are finished by now.
    use std::io::Write;
    let _ = std::io::stdout().flush();
    let _ = std::io::stderr().flush();
    panoscope_engine::ending::leave(code)
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
        Err(error)
            if error.kind() == std::io::ErrorKind::NotFound && !arguments.theatre && in_a_folder(&arguments.graph) =>
        {
            String::new()
        }
        Err(error) => {
            eprintln!("error: {} cannot be read: {error}", arguments.graph.display());
            return 2;
        }
    };
    let after = |file: &Option<PathBuf>| file.clone().map(|file| (file, arguments.after));
    let shot = Shot::new(after(&arguments.screenshot), after(&arguments.measure), &arguments.actions);
    let name = arguments.graph.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let viewport = ViewportBuilder::default()
        .with_title(format!("{name} · Panoscope"))
        .with_app_id("panoscope-editor")
        .with_inner_size(vec2(arguments.size.0, arguments.size.1))
        .with_min_inner_size(vec2(480.0, 320.0));
    let (path, frames, scale) = (arguments.graph.clone(), arguments.frames, arguments.scale);
    if arguments.theatre {
        let viewport = viewport.with_fullscreen(!arguments.windowed).with_decorations(arguments.windowed);
        let ready = match Ready::look(&path, &text, arguments.unlocked) {
            Ok(ready) => ready,
            Err(error) => {
                // On the terminal, and in a window where there is a screen.
                eprintln!("{}", error.told());
                let _ = show(viewport, move |cc| Ok(Box::new(Refused::new(&cc.egui_ctx, &path, &error, shot))));
                return 2;
            }
        };
        let options = theatre::Options {
            folder: arguments.into.clone(),
            label: arguments.label.clone(),
            unlocked: arguments.unlocked,
            frames,
            scale,
            shot,
        };
        return open(viewport, move |cc| Ok(Box::new(Theatre::of(&cc.egui_ctx, &path, &text, options, ready)?)));
    }
    let options = Options { frames, scale, shot };
    open(viewport, move |cc| Ok(Box::new(App::open(&cc.egui_ctx, &path, &text, options)?)))
}

type Made = Result<Box<dyn eframe::App>, Box<dyn std::error::Error + Send + Sync>>;

fn open(viewport: ViewportBuilder, make: impl FnOnce(&eframe::CreationContext<'_>) -> Made) -> i32 {
    match show(viewport, make) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: no window could be opened: {error}");
            1
        }
    }
}

/// Shows a window until it is closed.
fn show(viewport: ViewportBuilder, make: impl FnOnce(&eframe::CreationContext<'_>) -> Made) -> eframe::Result {
    let native = eframe::NativeOptions {
        viewport,
        renderer: eframe::Renderer::Glow,
        dithering: false,
        ..eframe::NativeOptions::default()
    };
    eframe::run_native(
        "panoscope-editor",
        native,
        Box::new(|cc| {
            close_on_signals(&cc.egui_ctx);
            make(cc)
        }),
    )
}
