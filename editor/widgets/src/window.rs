//! Opens a program's window and ends the program: arguments, size, signals, exit code.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use eframe::egui::{ViewportBuilder, vec2};
use panoscope_graph::GraphOptions;
use panoscope_graph::command_line::{self, CommandLine};

use crate::{Shot, close_on_signals, speech};

/// The application to show in a window, or why it cannot be created.
pub type AppResult = Result<Box<dyn eframe::App>, Box<dyn std::error::Error + Send + Sync>>;

/// Command-line arguments of both windows.
#[derive(clap::Args)]
#[group(id = "window")]
pub struct Arguments {
    /// Size of everything in the window; Ctrl and + or - change it.
    #[arg(long, default_value_t = 1.0, value_parser = scale)]
    pub scale: f32,
    /// Number of ticks of each source. By default the graph runs until its sources end or the window is closed.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// Width and height of the window in points.
    #[arg(long, default_value = "1440x900", value_parser = size)]
    pub size: (f32, f32),
    /// Language of the window; `system` is that of LC_ALL, LC_MESSAGES and LANG.
    #[arg(long, default_value = "system", value_parser = speech::choices())]
    language: String,
    /// Writes a screenshot of the window (PNG or JPEG), or a film (GIF), and exits.
    #[arg(long, value_name = "FILE")]
    screenshot: Option<PathBuf>,
    /// Writes the costs of the window and the graph (JSON) and exits.
    #[arg(long, value_name = "FILE.json", conflicts_with = "screenshot")]
    measure: Option<PathBuf>,
    /// Seconds until the screenshot is taken or the costs are written.
    #[arg(long, default_value_t = 3.0)]
    after: f64,
    /// Action to perform before that, such as `heat`, `select:NODE` or `view:NODE.PORT`. Can be given several times.
    #[arg(long = "do", value_name = "ACTION")]
    actions: Vec<String>,
}

impl Arguments {
    /// Makes the windows of this thread speak the language that the arguments ask for.
    pub fn apply_language(&self) {
        speech::apply(&self.language);
    }

    /// The screenshot, costs and script that the arguments ask for.
    pub fn shot(&self) -> Shot {
        let after = |file: &Option<PathBuf>| file.clone().map(|file| (file, self.after));
        Shot::new(after(&self.screenshot), after(&self.measure), &self.actions)
    }
}

/// What a command line gives to a graph. Arguments that the graph declares are among them, see [`parse`].
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Given {
    /// Overlay file: replaces nodes of the same name and defaults of arguments. May be given again.
    #[arg(long, value_name = "OVERLAY")]
    with: Vec<PathBuf>,
    #[arg(long = "graph-arg", value_name = "NAME=VALUE", hide = true)]
    graph_args: Vec<String>,
}

impl Given {
    /// As options to open the graph.
    pub fn options(&self) -> GraphOptions {
        command_line::options(&self.with, &self.graph_args, &[])
    }
}

/// Parses the command line of a program that opens a graph. Options that the graph declares are known to it, and its help shows them.
pub fn parse<T: clap::Parser>() -> T {
    parse_words(std::env::args_os().collect())
}

/// As [`parse`], for words of which the first is the program.
pub fn parse_words<T: clap::Parser>(words: Vec<OsString>) -> T {
    let CommandLine { words, help, problem } = command_line::rewrite(words);
    if let Some(problem) = problem {
        eprintln!("error: {problem}");
        leave(2);
    }
    let command = if help.is_empty() { T::command() } else { T::command().after_help(help) };
    let parsed = command.try_get_matches_from(words).and_then(|matches| T::from_arg_matches(&matches));
    parsed.unwrap_or_else(|error| {
        let _ = error.print();
        leave(error.exit_code())
    })
}

/// Why an argument is not accepted.
#[derive(Debug, thiserror::Error)]
enum ArgumentError {
    #[error("the scale must be a number from 0.5 to 4")]
    Scale,
    #[error("the size must be as in 1440x900, at least 480x320")]
    Size,
}

/// Parses the scale of everything in a window, such as `1.5`.
fn scale(text: &str) -> Result<f32, ArgumentError> {
    let scale = text.parse::<f32>().ok();
    scale.filter(|scale| (0.5..=4.0).contains(scale)).ok_or(ArgumentError::Scale)
}

/// Parses the width and height of a window in points, such as `1440x900`.
fn size(text: &str) -> Result<(f32, f32), ArgumentError> {
    let parts = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    parts.filter(|&(w, h)| w >= 480.0 && h >= 320.0).ok_or(ArgumentError::Size)
}

/// The settings of a window whose title is the name of a graph file.
pub fn viewport(graph: &Path, app_id: &str, (width, height): (f32, f32)) -> ViewportBuilder {
    let name = graph.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    ViewportBuilder::default()
        .with_title(format!("{name} · Panoscope"))
        .with_app_id(app_id)
        .with_inner_size(vec2(width, height))
        .with_min_inner_size(vec2(480.0, 320.0))
}

/// Whether the environment names a screen.
fn has_screen() -> bool {
    let is_set = |name: &&str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"].iter().any(is_set)
}

/// Shows a window until it is closed; returns the program's exit code.
pub fn open(viewport: ViewportBuilder, make: impl FnOnce(&eframe::CreationContext<'_>) -> AppResult) -> i32 {
    if !has_screen() {
        eprintln!(
            "error: the window could not be opened: this session has no screen, neither DISPLAY nor WAYLAND_DISPLAY is set; start it on a desktop or by `ssh -X`, or run the graph without a window: `panoscope run GRAPH`"
        );
        return 1;
    }
    match show(viewport, make) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: the window could not be opened: {error}");
            1
        }
    }
}

/// Shows a window until it is closed.
///
/// # Errors
/// There is no screen, or no graphics driver.
pub fn show(viewport: ViewportBuilder, make: impl FnOnce(&eframe::CreationContext<'_>) -> AppResult) -> eframe::Result {
    let native = eframe::NativeOptions {
        viewport,
        renderer: eframe::Renderer::Glow,
        dithering: false,
        ..eframe::NativeOptions::default()
    };
    eframe::run_native(
        "panoscope",
        native,
        Box::new(|cc| {
            close_on_signals(&cc.egui_ctx);
            make(cc)
        }),
    )
}

/// Installs the signal handlers that close the window and finish all files.
pub fn listen_to_signals() {
    if let Err(error) = panoscope_engine::ending::signals::install() {
        eprintln!(
            "warning: the signal handlers could not be installed, so signals end the program without finishing files: {error}"
        );
    }
}

/// Ends the program without static destructors, because those of foreign libraries may crash. All files are finished before.
pub fn leave(code: i32) -> ! {
    use std::io::Write;
    let _ = std::io::stdout().flush();
    let _ = std::io::stderr().flush();
    panoscope_engine::ending::leave(code)
}
