//! The `panoscope` command. Exit codes: 0 done, 1 the run failed (`judge` has the rule), 2 the arguments or the graph are wrong; 128 and the
//! signal's number where a signal ended the command before there was a run, or at once; the signal itself where a plugin crashed.

mod allocations;
mod commands;
mod installation;
mod interrupt;
mod judge;
mod log_lines;
mod numbers;
mod probe;
mod progress;
mod session;
mod summary;
mod terminal;

use clap::{CommandFactory, Parser, Subcommand};
use panoscope_engine::ending::signals;

panoscope_engine::guard_exits!();

/// Runs graphs of image-processing nodes on the live picture of two-camera endoscopes.
#[derive(Parser)]
#[command(name = "panoscope", version, disable_help_subcommand = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Runs a graph.
    Run(commands::run::Arguments),
    /// Opens a window over a graph while it runs: pictures, times, faults, sliders, wires.
    Edit(commands::edit::Arguments),
    /// Opens the surgeon's window: pictures full screen, and only the settings that the preset offers.
    Theatre(commands::edit::Arguments),
    /// Writes fingerprints of a graph, its plugins, models and calibration, for the theatre to compare.
    Lock(commands::lock::Arguments),
    /// Runs a graph and writes the run down, so that it can be repeated to the byte.
    Record(commands::record::Arguments),
    /// Plays a recording again, or runs another graph on its pictures.
    Replay(commands::replay::Arguments),
    /// Says where two recorded runs differ first, and by how much.
    Compare(commands::compare::Arguments),
    /// Runs a graph once for each value of a parameter and shows what becomes of a measure.
    Sweep(commands::sweep::Arguments),
    /// Finds gains of the arm's PID on the simulated arm: relay feedback, rules, a search; responses of P, PI and PID.
    Tune(commands::tune::Arguments),
    /// Runs a graph for minutes and says whether its memory grows.
    Soak(commands::soak::Arguments),
    /// Checks graph files and shows every mistake.
    Check(commands::check::Arguments),
    /// Lists plugins and their node types.
    List(commands::list::Arguments),
    /// Shows inputs, outputs and parameters of a node type.
    Describe(commands::describe::Arguments),
    /// Writes a graph as Graphviz text.
    Dot(commands::dot::Arguments),
    /// Writes a JSON Schema of graph files, for editors.
    Schema,
    /// Writes the beginnings of a plugin.
    New(commands::new::Arguments),
    /// Measures the runtime itself, beside its peers where they are installed.
    #[command(subcommand)]
    Bench(commands::bench::Bench),
    /// Judges results beside truth and peers.
    #[command(subcommand)]
    Eval(commands::eval::Eval),
    /// Calibrates two cameras from views of a printed board.
    Calibrate(commands::calibrate::Arguments),
    /// Lists cameras.
    Devices(commands::devices::Arguments),
    /// Shows what is installed, what is missing and how to get it.
    Doctor,
    /// Writes manual pages and shell completions, for packages.
    #[command(hide = true)]
    Generate(commands::generate::Arguments),
    /// Opens one node of a graph, for `check`.
    #[command(name = probe::COMMAND, hide = true)]
    ProbeNode(probe::Arguments),
}

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Done.
    Done,
    /// The run failed; what was wrong has been said.
    Failed,
    /// The arguments or the graph are wrong; what was wrong has been said.
    Wrong,
}

fn main() {
    if let Err(error) = signals::install() {
        terminal::log!("warning: signals end the program without finishing files: {error}");
    }
    let arguments = Arguments::parse();
    let end = match arguments.command {
        Command::Run(arguments) => commands::run::run(&arguments),
        Command::Edit(arguments) => commands::edit::run(&arguments, false),
        Command::Theatre(arguments) => commands::edit::run(&arguments, true),
        Command::Lock(arguments) => commands::lock::run(&arguments),
        Command::Record(arguments) => commands::record::run(&arguments),
        Command::Replay(arguments) => commands::replay::run(&arguments),
        Command::Compare(arguments) => commands::compare::run(&arguments),
        Command::Sweep(arguments) => commands::sweep::run(&arguments),
        Command::Tune(arguments) => commands::tune::run(&arguments),
        Command::Soak(arguments) => commands::soak::run(&arguments),
        Command::Check(arguments) => commands::check::run(&arguments),
        Command::List(arguments) => commands::list::run(&arguments),
        Command::Describe(arguments) => commands::describe::run(&arguments),
        Command::Dot(arguments) => commands::dot::run(&arguments),
        Command::Schema => commands::schema::run(),
        Command::New(arguments) => commands::new::run(&arguments),
        Command::Doctor => commands::doctor::run(),
        Command::Bench(bench) => commands::bench::run(&bench),
        Command::Eval(eval) => commands::eval::run(&eval),
        Command::Calibrate(arguments) => commands::calibrate::run(&arguments),
        Command::ProbeNode(arguments) => probe::run(&arguments),
        Command::Generate(arguments) => commands::generate::run(&arguments, Arguments::command()),
        Command::Devices(arguments) => commands::devices::run(&arguments),
    };
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
