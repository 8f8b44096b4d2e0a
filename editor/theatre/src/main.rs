//! `panoscope-theatre GRAPH`, started by `panoscope theatre GRAPH`. Exit codes: 0 success, 1 the window could not be opened, 2 the file cannot
//! be read or was refused.

use std::path::PathBuf;

use clap::Parser;
use panoscope_editor_widgets::window;
use panoscope_graph::{GraphText, installed};
use panoscope_loader::keys::{KeyError, PublicKey, Trust};
use panoscope_theatre::{OpenFailed, Opening, Options, Ready};

/// The surgeon's window: full-screen images, and only the settings that the preset offers.
#[derive(Parser)]
#[command(name = "panoscope-theatre", version)]
struct Arguments {
    /// Graph file.
    graph: PathBuf,
    #[command(flatten)]
    given: window::Given,
    /// Opens the graph even if it, a plugin, a model or the calibration differs from its lock.
    #[arg(long)]
    unlocked: bool,
    /// Accepts locks signed by this public key, besides those in the folders of trusted keys. May be given again.
    #[arg(long, value_name = "FILE")]
    trust: Vec<PathBuf>,
    /// Folder for stills and clips; without it `out` in the current folder, or where an installed graph writes its files.
    #[arg(long, value_name = "DIR")]
    into: Option<PathBuf>,
    /// Prefix for the names of stills and clips, which otherwise have numbers only.
    #[arg(long, value_name = "TEXT")]
    label: Option<String>,
    /// Opens a window instead of the full screen.
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

/// The keys of the installation, and those of the command line.
fn trusted(files: &[PathBuf]) -> Result<Trust, KeyError> {
    let mut trust = Trust::installed()?;
    for file in files {
        trust.add(PublicKey::read(file)?);
    }
    Ok(trust)
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
    let given = arguments.given.options();
    let trust = match trusted(&arguments.trust) {
        Ok(trust) => trust,
        Err(error) => {
            eprintln!("error: {error}");
            return 2;
        }
    };
    let notice = installed::notice(&arguments.graph);
    if let Some(notice) = &notice {
        eprintln!("note: {notice}");
    }
    let folder = if notice.is_some() { installed::output_dir().join("out") } else { PathBuf::from("out") };
    let options = Options {
        folder: arguments.into.clone().unwrap_or(folder),
        label: arguments.label.clone(),
        unlocked: arguments.unlocked,
        trust,
        audit: Some(panoscope_audit::folder().unwrap_or_else(|| PathBuf::from(panoscope_audit::SYSTEM_FOLDER))),
        frames: arguments.window.frames,
        scale: arguments.window.scale,
        shot,
    };
    // A graph that lacks arguments asks for them in its window.
    let ready = match Ready::of(&text, &options) {
        Ok(ready) => Some(ready),
        Err(_) if !text.missing_args().is_empty() => None,
        Err(error) => {
            // Reported on the terminal, and in a window if there is a screen.
            eprintln!("{}", error.terminal_text());
            options.log_refusal(&path, &error);
            let shot = options.shot;
            let _ = window::show(viewport, move |cc| Ok(Box::new(OpenFailed::new(&cc.egui_ctx, &path, &error, shot))));
            return 2;
        }
    };
    let config = panoscope_editor_model::arguments::config_folder();
    window::open(viewport, move |cc| Ok(Box::new(Opening::new(&cc.egui_ctx, &text, given, ready, config, options)?)))
}
