//! The `panoscope` command, and what its second program `panoscope-lab` shares with it. Exit codes: 0 done, 1 the run
//! failed (see `judge`), 2 the arguments or the graph are wrong; 128 plus the signal's number if a signal ended the
//! command before a run or immediately; the signal itself if a plugin crashed.

pub mod allocations;
pub mod beside;
pub mod commands;
pub mod given;
mod installation;
pub mod interrupt;
pub mod judge;
mod log_lines;
mod models;
pub mod numbers;
mod progress;
mod summary;
pub mod terminal;
pub mod tick_numbers;
pub mod trust;
mod version;

use std::ffi::OsString;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use panoscope_engine::ending::signals;
use panoscope_engine::heap;
use panoscope_graph::command_line::{self, CommandLine};
use panoscope_host::loader::isolated;

use beside::Words;
use installation::Installation;

/// Runs graphs of image-processing nodes on live video of two-camera endoscopes.
#[derive(Parser)]
#[command(name = "panoscope", version, long_version = version::long(), disable_help_subcommand = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Runs a graph.
    Run(commands::run::Arguments),
    /// Opens a window over a graph while it runs: images, times, faults, sliders, connections.
    Edit(commands::edit::Arguments),
    /// Opens the surgeon's window: full-screen images, and only the settings that the preset offers.
    Theatre(commands::edit::Arguments),
    /// Writes fingerprints of a graph and of all files that its run depends on, optionally signed, which the theatre
    /// compares.
    Lock(commands::lock::Arguments),
    /// Shows the audit log of the theatre, and checks that it is intact.
    Audit(commands::audit::Arguments),
    /// Stills, clips and measurements as DICOM: worklist, objects, storage at a PACS.
    Dicom(Words),
    /// Runs a graph and records the run so that it can be repeated to the byte.
    Record(commands::record::Arguments),
    /// Replays a recording, or runs another graph on its frames.
    Replay(commands::replay::Arguments),
    /// Shows the first difference of two recorded runs, and its amount.
    Compare(commands::compare::Arguments),
    /// Exports a recording to files of other programs: a folder of images and tables, Foxglove, rerun.
    Export(Words),
    /// Lists the sequences of public data sets in a folder, with their calibration, ground truth and labels.
    Import(Words),
    /// Runs a graph once for each value of parameters and shows the measures.
    Sweep(Words),
    /// Runs a graph once for each row of a table or each file of a pattern, on this machine or a cluster; resumes a
    /// stopped study.
    Batch(Words),
    /// Compares runs of sweeps and batches on one HTML page.
    Report(Words),
    /// Shows the worst runs of a batch, and records them again.
    Worst(Words),
    /// Finds gains of the arm's PID on the simulated arm: relay feedback, rules, a search; compares the responses of P,
    /// PI and PID.
    Tune(Words),
    /// Runs a graph for minutes and checks whether its memory grows.
    Soak(Words),
    /// Checks graph files and shows all mistakes.
    Check(commands::check::Arguments),
    /// Lists plugins and their node types.
    List(commands::list::Arguments),
    /// Shows inputs, outputs and parameters of a node type.
    Describe(commands::describe::Arguments),
    /// Writes a graph as Graphviz text.
    Dot(commands::dot::Arguments),
    /// Writes a JSON Schema of graph files, for editors; or the node types for Python.
    Schema(commands::schema::Arguments),
    /// Writes the skeleton of a plugin.
    New(commands::new::Arguments),
    /// Measures the runtime itself, compared with its peers where installed.
    Bench(Words),
    /// Evaluates results against ground truth and peers.
    Eval(Words),
    /// Calibrates two cameras from views of a printed board.
    Calibrate(Words),
    /// Runs nodes of graphs of other machines, those with `on` and this machine's name.
    Serve(commands::serve::Arguments),
    /// Makes certificates with which machines authenticate each other.
    Keys(commands::keys::Arguments),
    /// Lists cameras.
    Devices(commands::devices::Arguments),
    /// Shows what is installed, what is missing and how to get it.
    Doctor,
    /// Writes manual pages and shell completions, for packages.
    #[command(hide = true)]
    Generate(Words),
}

/// Result of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Done.
    Done,
    /// The run failed; the reason has been reported.
    Failed,
    /// The arguments or the graph are wrong; the reason has been reported.
    Wrong,
}

/// The command line of `panoscope`. For commands of [`beside::LAB`] it has names and descriptions only; that program
/// parses their arguments.
pub fn command() -> clap::Command {
    Arguments::command()
}

/// Long options of the named command; if it has subcommands, those of the command itself.
pub fn own_options(program: &clap::Command, words: &[OsString]) -> Vec<String> {
    let mut command = program;
    for word in words.iter().skip(1) {
        match word.to_str().and_then(|word| command.find_subcommand(word)) {
            Some(inner) => command = inner,
            None => break,
        }
    }
    command.get_arguments().filter_map(clap::Arg::get_long).map(str::to_owned).collect()
}

/// Whether the arguments name a command of the program [`beside::LAB`].
fn is_of_the_lab(program: &clap::Command, words: &[OsString]) -> bool {
    let command = words.get(1).and_then(|word| program.find_subcommand(word));
    command.is_some_and(|command| command.get_arguments().any(|argument| argument.get_id() == beside::WORDS))
}

/// `help run` becomes `run --help`, which also knows the commands of other programs and the options of graphs.
fn help_last(mut words: Vec<OsString>) -> Vec<OsString> {
    if words.get(1).is_some_and(|word| word == "help") {
        words.remove(1);
        words.push("--help".into());
    }
    words
}

/// Parses the command line of this process. Options that the graph declares are included, also in its help. Exits if
/// the command line is wrong or requests help.
pub fn parse<T: FromArgMatches>(mut command: clap::Command) -> T {
    let words = Installation::current().with_its_graphs(help_last(std::env::args_os().collect()));
    let CommandLine { words, help, problem } = match is_of_the_lab(&command, &words) {
        true => CommandLine { words, ..CommandLine::default() },
        false => {
            let own = own_options(&command, &words);
            command_line::rewrite_except(words, &own)
        }
    };
    if let Some(problem) = problem {
        terminal::log!("error: {problem}");
        terminal::leave(2);
    }
    if !help.is_empty() {
        command = command.mut_subcommands(|c| c.after_help(help.clone()));
    }
    let parsed = command.try_get_matches_from(words).and_then(|matches| T::from_arg_matches(&matches));
    parsed.unwrap_or_else(|error| {
        let unknown = error.kind() == ErrorKind::UnknownArgument;
        // Not `exit`: the code of a help is 0, of an error 2.
        let _ = error.print();
        if unknown && !help.is_empty() {
            terminal::log!("\n{}", help.trim_end());
        }
        terminal::leave(error.exit_code())
    })
}

/// Prepares the process: its heap and its signals. Does not return in a process for isolated nodes.
pub fn prepare() {
    heap::keep_large_blocks_apart();
    if std::env::args_os().nth(1).is_some_and(|word| word == panoscope_host::isolate::COMMAND) {
        isolated::serve();
    }
    end_with_parent();
    if let Err(error) = signals::install() {
        terminal::log!("warning: signals end the program without finishing files: {error}");
    }
}

/// Environment variable with the process that a run of a batch belongs to.
const PARENT_VARIABLE: &str = "PANOSCOPE_PARENT";

/// Ends this process together with the one that [`PARENT_VARIABLE`] names, if that is its parent: nobody waits for the
/// run of a driver that was killed.
fn end_with_parent() {
    let parent = std::env::var(PARENT_VARIABLE).ok().and_then(|text| text.parse::<libc::pid_t>().ok());
    // SAFETY: neither call touches memory of this process.
    let is_parent = || parent == Some(unsafe { libc::getppid() });
    if !is_parent() {
        return;
    }
    // SAFETY: as for `getppid`; the option takes one integer.
    unsafe { libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) };
    if !is_parent() {
        terminal::leave(1);
    }
}

/// Exits the process with a command's result.
pub fn leave(end: anyhow::Result<End>) -> ! {
    terminal::leave(match end {
        Ok(End::Done) => 0,
        Ok(End::Failed) => 1,
        Ok(End::Wrong) => 2,
        Err(error) => {
            terminal::log!("error: {error:#}");
            1
        }
    })
}

/// The program `panoscope`.
pub fn main() -> ! {
    prepare();
    let arguments: Arguments = parse(command());
    leave(match arguments.command {
        Command::Run(arguments) => commands::run::run(&arguments, None),
        Command::Edit(arguments) => commands::edit::run(&arguments, false),
        Command::Theatre(arguments) => commands::edit::run(&arguments, true),
        Command::Lock(arguments) => commands::lock::run(&arguments),
        Command::Audit(arguments) => commands::audit::run(&arguments),
        Command::Record(arguments) => commands::record::run(&arguments, None),
        Command::Replay(arguments) => commands::replay::run(&arguments),
        Command::Compare(arguments) => commands::compare::run(&arguments),
        Command::Check(arguments) => commands::check::run(&arguments),
        Command::List(arguments) => commands::list::run(&arguments),
        Command::Describe(arguments) => commands::describe::run(&arguments),
        Command::Dot(arguments) => commands::dot::run(&arguments),
        Command::Schema(arguments) => commands::schema::run(&arguments),
        Command::New(arguments) => commands::new::run(&arguments),
        Command::Doctor => commands::doctor::run(),
        Command::Serve(arguments) => commands::serve::run(&arguments),
        Command::Keys(arguments) => commands::keys::run(&arguments),
        Command::Devices(arguments) => commands::devices::run(&arguments),
        Command::Dicom(_)
        | Command::Export(_)
        | Command::Import(_)
        | Command::Sweep(_)
        | Command::Batch(_)
        | Command::Worst(_)
        | Command::Report(_)
        | Command::Tune(_)
        | Command::Soak(_)
        | Command::Bench(_)
        | Command::Eval(_)
        | Command::Calibrate(_)
        | Command::Generate(_) => beside::lab(),
    })
}
