//! The window of a program: its size, how it is opened, how the program ends.

use std::path::{Path, PathBuf};

use eframe::egui::{ViewportBuilder, vec2};

use crate::{Shot, close_on_signals};

/// Makes what is drawn in a window.
pub type Made = Result<Box<dyn eframe::App>, Box<dyn std::error::Error + Send + Sync>>;

/// Arguments that every window takes.
#[derive(clap::Args)]
#[group(id = "window")]
pub struct Arguments {
    /// Size of everything in the window; Ctrl and + or - change it.
    #[arg(long, default_value_t = 1.0, value_parser = scale)]
    pub scale: f32,
    /// Ticks that each source makes; without it, until the sources end or the window is closed.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// Width and height of the window in points.
    #[arg(long, default_value = "1440x900", value_parser = size)]
    pub size: (f32, f32),
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

impl Arguments {
    /// The picture, costs and script that were asked for.
    pub fn shot(&self) -> Shot {
        let after = |file: &Option<PathBuf>| file.clone().map(|file| (file, self.after));
        Shot::new(after(&self.screenshot), after(&self.measure), &self.actions)
    }
}

/// The scale of everything in a window, from a text such as `1.5`.
///
/// # Errors
/// In words, what is accepted.
fn scale(text: &str) -> Result<f32, String> {
    let scale = text.parse::<f32>().map_err(|e| e.to_string())?;
    if (0.5..=4.0).contains(&scale) { Ok(scale) } else { Err("from 0.5 to 4".to_owned()) }
}

/// Width and height of a window in points, from a text such as `1440x900`.
///
/// # Errors
/// In words, what is accepted.
fn size(text: &str) -> Result<(f32, f32), String> {
    let parts = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    parts.filter(|&(w, h)| w >= 480.0 && h >= 320.0).ok_or_else(|| "as in 1440x900, at least 480x320".to_owned())
}

/// A window that is called after a graph file.
pub fn viewport(graph: &Path, app_id: &str, (width, height): (f32, f32)) -> ViewportBuilder {
    let name = graph.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    ViewportBuilder::default()
        .with_title(format!("{name} · Panoscope"))
        .with_app_id(app_id)
        .with_inner_size(vec2(width, height))
        .with_min_inner_size(vec2(480.0, 320.0))
}

/// Shows a window until it is closed; returns the program's exit code.
pub fn open(viewport: ViewportBuilder, make: impl FnOnce(&eframe::CreationContext<'_>) -> Made) -> i32 {
    match show(viewport, make) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: no window could be opened: {error}");
            1
        }
    }
}

/// Shows a window until it is closed.
///
/// # Errors
/// There is no screen, or no graphics.
pub fn show(viewport: ViewportBuilder, make: impl FnOnce(&eframe::CreationContext<'_>) -> Made) -> eframe::Result {
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

/// Has signals close the window with all files finished.
pub fn listen_to_signals() {
    if let Err(error) = panoscope_engine::ending::signals::install() {
        eprintln!("warning: signals end the program without finishing files: {error}");
    }
}

/// Ends the program. Destructors of foreign libraries are not to be trusted; files are finished by now.
pub fn leave(code: i32) -> ! {
    use std::io::Write;
    let _ = std::io::stdout().flush();
    let _ = std::io::stderr().flush();
    panoscope_engine::ending::leave(code)
}
