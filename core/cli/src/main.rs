//! The `panoscope` command. Exit codes: 0 done, 1 the run failed (`judge` has the rule), 2 the arguments or the graph are wrong; 128 and the
//! signal's number where a signal ended the command before there was a run, or at once; the signal itself where a plugin crashed.

mod allocations;
mod commands;
mod given;
mod installation;
mod interrupt;
mod judge;
mod log_lines;
mod models;
mod numbers;
mod progress;
mod session;
mod summary;
mod terminal;
mod trust;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use panoscope_engine::ending::signals;
use panoscope_engine::heap;
use panoscope_graph::command_line::{self, CommandLine};
use panoscope_loader::isolated;

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
    /// Writes fingerprints of a graph and of all that its run depends on, signed where wanted, for the theatre to compare.
    Lock(commands::lock::Arguments),
    /// Shows the audit log of the theatre, and whether it is whole.
    Audit(commands::audit::Arguments),
    /// Stills, clips and measurements as DICOM: worklist, objects, storage at a PACS.
    #[command(subcommand)]
    Dicom(commands::dicom::Dicom),
    /// Runs a graph and writes the run down, so that it can be repeated to the byte.
    Record(commands::record::Arguments),
    /// Plays a recording again, or runs another graph on its pictures.
    Replay(commands::replay::Arguments),
    /// Says where two recorded runs differ first, and by how much.
    Compare(commands::compare::Arguments),
    /// Writes what a recording holds as files of other programs: a folder of pictures and tables, Foxglove, rerun.
    Export(commands::export::Arguments),
    /// Lists the sequences of public data sets in a folder, with their calibration, truth and labels.
    Import(commands::import::Arguments),
    /// Runs a graph once for each value of parameters and shows what becomes of measures.
    Sweep(commands::sweep::Arguments),
    /// Compares runs of sweeps on one HTML page.
    Report(commands::report::Arguments),
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
    /// Runs nodes of graphs of other machines, those with `on` and this machine's name.
    Serve(commands::serve::Arguments),
    /// Makes certificates by which machines know each other.
    Keys(commands::keys::Arguments),
    /// Lists cameras.
    Devices(commands::devices::Arguments),
    /// Shows what is installed, what is missing and how to get it.
    Doctor,
    /// Writes manual pages and shell completions, for packages.
    #[command(hide = true)]
    Generate(commands::generate::Arguments),
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

/// Long options of the command that the words name, those of the command itself where it has commands of its own.
fn own_options(program: &clap::Command, words: &[std::ffi::OsString]) -> Vec<String> {
    let mut command = program;
    for word in words.iter().skip(1) {
        match word.to_str().and_then(|word| command.find_subcommand(word)) {
            Some(inner) => command = inner,
            None => break,
        }
    }
    command.get_arguments().filter_map(clap::Arg::get_long).map(str::to_owned).collect()
}

/// Parses the command line. Options that the graph declares are known to it, and its help shows them.
fn parse(words: Vec<std::ffi::OsString>) -> Arguments {
    let own = own_options(&Arguments::command(), &words);
    let CommandLine { words, help, problem } = command_line::rewrite_except(words, &own);
    if let Some(problem) = problem {
        terminal::log!("error: {problem}");
        terminal::leave(2);
    }
    let mut command = Arguments::command();
    if !help.is_empty() {
        let names: Vec<String> = command.get_subcommands().map(|c| c.get_name().to_owned()).collect();
        for name in names {
            command = command.mut_subcommand(name, |c| c.after_help(help.clone()));
        }
    }
    let parsed = command.try_get_matches_from(words).and_then(|matches| Arguments::from_arg_matches(&matches));
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

fn main() {
    heap::keep_large_blocks_apart();
    if std::env::args_os().nth(1).is_some_and(|word| word == isolated::COMMAND) {
        isolated::serve();
    }
    if let Err(error) = signals::install() {
        terminal::log!("warning: signals end the program without finishing files: {error}");
    }
    let arguments = parse(std::env::args_os().collect());
    let end = match arguments.command {
        Command::Run(arguments) => commands::run::run(&arguments),
        Command::Edit(arguments) => commands::edit::run(&arguments, false),
        Command::Theatre(arguments) => commands::edit::run(&arguments, true),
        Command::Lock(arguments) => commands::lock::run(&arguments),
        Command::Audit(arguments) => commands::audit::run(&arguments),
        Command::Dicom(command) => commands::dicom::run(&command),
        Command::Record(arguments) => commands::record::run(&arguments),
        Command::Replay(arguments) => commands::replay::run(&arguments),
        Command::Compare(arguments) => commands::compare::run(&arguments),
        Command::Export(arguments) => commands::export::run(&arguments),
        Command::Import(arguments) => commands::import::run(&arguments),
        Command::Sweep(arguments) => commands::sweep::run(&arguments),
        Command::Report(arguments) => commands::report::run(&arguments),
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
        Command::Generate(arguments) => commands::generate::run(&arguments, Arguments::command()),
        Command::Serve(arguments) => commands::serve::run(&arguments),
        Command::Keys(arguments) => commands::keys::run(&arguments),
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

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_graph::args::RESERVED_ARGS;

    #[test]
    fn no_argument_of_a_graph_can_hide_an_option() {
        let command = Arguments::command();
        let opens_graphs = |c: &&clap::Command| c.get_arguments().any(|a| a.get_long() == Some("graph-arg"));
        // Options of commands that measure win over arguments, see the next test.
        let measures = |c: &&clap::Command| ["tune", "sweep"].contains(&c.get_name());
        let commands: Vec<_> = command.get_subcommands().filter(opens_graphs).filter(|c| !measures(c)).collect();
        assert!(commands.len() >= 6, "only {} commands open graphs", commands.len());
        for command in commands {
            for long in command.get_arguments().filter_map(clap::Arg::get_long) {
                let name = long.replace('-', "_");
                assert!(RESERVED_ARGS.contains(&name.as_str()), "--{long} of {} is not reserved", command.get_name());
            }
        }
    }

    #[test]
    fn options_of_a_command_are_its_own() {
        let own = |words: &str| {
            let words: Vec<std::ffi::OsString> = words.split(' ').map(Into::into).collect();
            own_options(&Arguments::command(), &words)
        };
        let has = |words: &str, name: &str| own(words).iter().any(|own| own == name);
        assert!(has("panoscope tune g.toml --method relay", "method") && !has("panoscope run g.toml", "method"));
        assert!(has("panoscope eval stitch g.toml", "speeds") && has("panoscope calibrate --left x", "left"));
    }
}
