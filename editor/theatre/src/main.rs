//! `panoscope-theatre GRAPH`, started by `panoscope theatre GRAPH`; with `--attach` on the graph of another machine. Exit codes: 0 success, 1 the
//! window could not be opened, 2 the file cannot be read or was refused.
//!
//! The program runs twice: this process owns the window, and starts another one, with the first argument [`worker::COMMAND`], for the graph.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::Parser;
use panoscope_editor_model::attaching;
use panoscope_editor_widgets::window;
use panoscope_graph::{GraphText, installed};
use panoscope_host::loader::keys::{KeyError, PublicKey, Trust};
use panoscope_monitor::Address;
use panoscope_theatre::{Guard, OpenError, OpenFailed, Opening, Options, Program, Refusal, Theatre, worker};

/// The surgeon's window: full-screen images, and only the settings that the preset offers.
#[derive(Parser)]
#[command(name = "panoscope-theatre", version)]
struct Arguments {
    /// Graph file.
    #[arg(required_unless_present = "attach")]
    graph: Option<PathBuf>,
    /// Shows the graph that runs on another machine, see `panoscope run --attachable`: NAME@ADDRESS, or a NAME of machines.toml in the folder
    /// panoscope of the user's configuration. There is no emergency stop from here.
    #[arg(long, value_name = "NAME[@ADDRESS]", conflicts_with_all = ["graph", "unlocked", "web"])]
    attach: Option<String>,
    /// Folder with the keys of this machine for --attach, made by `panoscope keys`; PANOSCOPE_KEYS where it is not given.
    #[arg(long, value_name = "DIR", requires = "attach")]
    keys: Option<PathBuf>,
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
    /// Serves a page with pictures, ages and states, and metrics for Prometheus at /metrics, for reading only: a port of this machine such as 9464, or
    /// IP:PORT. Whoever reaches the address sees the pictures; there is no password.
    #[arg(long, value_name = "PORT|IP:PORT")]
    web: Option<Address>,
    /// Opens a window instead of the full screen.
    #[arg(long)]
    windowed: bool,
    #[command(flatten)]
    window: window::Arguments,
}

panoscope_engine::guard_exits!();

fn main() {
    panoscope_engine::heap::keep_large_blocks_apart();
    window::listen_to_signals();
    let mut words: Vec<OsString> = std::env::args_os().collect();
    let code = match words.get(1).is_some_and(|word| word == worker::COMMAND) {
        true => {
            let own: Vec<OsString> = words.drain(1..words.len().min(3)).collect();
            work(&own, &window::parse_words(words))
        }
        false => {
            let arguments: Arguments = window::parse();
            arguments.window.apply_language();
            run(&arguments)
        }
    };
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

/// What the arguments ask for.
fn options(arguments: &Arguments) -> Result<Options, KeyError> {
    let trust = trusted(&arguments.trust)?;
    let is_installed = arguments.graph.as_deref().is_some_and(|graph| installed::notice(graph).is_some());
    let folder = if is_installed { installed::output_dir().join("out") } else { PathBuf::from("out") };
    Ok(Options {
        folder: arguments.into.clone().unwrap_or(folder),
        label: arguments.label.clone(),
        unlocked: arguments.unlocked,
        trust,
        audit: Some(
            panoscope_host::audit::folder().unwrap_or_else(|| PathBuf::from(panoscope_host::audit::SYSTEM_FOLDER)),
        ),
        frames: arguments.window.frames,
        web: arguments.web,
        scale: arguments.window.scale,
        pedal: panoscope_editor_model::arguments::config_folder().map(|folder| folder.join("pedal.toml")),
        shot: arguments.window.shot(),
    })
}

/// Runs the graph for the window that started this process.
fn work(own: &[OsString], arguments: &Arguments) -> i32 {
    let options = match options(arguments) {
        Ok(options) => options,
        Err(error) => {
            eprintln!("error: {error}");
            return 2;
        }
    };
    let memory = own.get(1).map(OsString::as_os_str).unwrap_or_default();
    match worker::serve(memory, arguments.graph.clone().unwrap_or_default(), options) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: `{}` is started by the theatre only: {error}", worker::COMMAND);
            2
        }
    }
}

/// Opens the window on the graph of another machine.
fn attach(arguments: &Arguments, name: &str) -> i32 {
    let options = options(arguments).map_err(|error| error.to_string());
    let opened = attaching::open(name, arguments.keys.clone()).map_err(|error| error.to_string());
    let opened = opened.and_then(|attachment| Ok((attachment, options?)));
    let (attachment, options) = match opened {
        Ok(opened) => opened,
        Err(error) => {
            eprintln!("error: {error}");
            return 2;
        }
    };
    if let Err(error) = attaching::wait(&attachment) {
        eprintln!("error: {error}");
        return 1;
    }
    let path = PathBuf::from(&attachment.target().name);
    let viewport = window::viewport(&path, "panoscope-theatre", arguments.window.size)
        .with_fullscreen(!arguments.windowed)
        .with_decorations(arguments.windowed);
    window::open(viewport, move |cc| {
        Ok(Box::new(Theatre::attached(&cc.egui_ctx, attachment, attaching::REACH, options)?))
    })
}

fn run(arguments: &Arguments) -> i32 {
    if let Some(name) = &arguments.attach {
        return attach(arguments, name);
    }
    let graph = arguments.graph.clone().unwrap_or_default();
    let given = arguments.given.options();
    let text = match GraphText::load_with(&graph, &given) {
        Ok(text) => text,
        Err(diagnostics) => {
            eprintln!("{}", diagnostics.render(false).trim_end());
            return 2;
        }
    };
    let viewport = window::viewport(&graph, "panoscope-theatre", arguments.window.size)
        .with_fullscreen(!arguments.windowed)
        .with_decorations(arguments.windowed);
    let path = graph.clone();
    let options = match options(arguments) {
        Ok(options) => options,
        Err(error) => {
            eprintln!("error: {error}");
            return 2;
        }
    };
    if let Some(notice) = installed::notice(&graph) {
        eprintln!("note: {notice}");
    }
    // The running version, even if its file was replaced meanwhile.
    let program = Program { file: PathBuf::from("/proc/self/exe"), arguments: std::env::args_os().skip(1).collect() };
    let guard =
        Guard::new(program, path.clone()).map_err(|error| Box::new(Refusal::of(&path, &OpenError::Thread(error))));
    // A graph that lacks arguments asks for them in its window.
    let asks = !text.missing_args().is_empty();
    let opened = guard.and_then(|guard| match asks {
        true => Ok((guard, None)),
        false => {
            guard.prepare(text.text(), &given);
            let opened = guard.wait_prepared()?;
            Ok((guard, Some(opened)))
        }
    });
    let (guard, opened) = match opened {
        Ok(opened) => opened,
        Err(refusal) => {
            // Reported on the terminal, and in a window if there is a screen.
            eprintln!("{}", refusal.terminal_text());
            options.log_refusal(&path, &refusal);
            let shot = options.shot;
            let _ = window::show(viewport, move |cc| Ok(Box::new(OpenFailed::of(&cc.egui_ctx, *refusal, shot))));
            return 2;
        }
    };
    let config = panoscope_editor_model::arguments::config_folder();
    window::open(viewport, move |cc| {
        Ok(Box::new(Opening::guarded(&cc.egui_ctx, &text, given, opened, config, options, guard)?))
    })
}
