//! The commands that `panoscope` passes to this program, so that a build which only runs graphs needs none of their
//! crates.

mod batch;
mod bench;
mod calibrate;
mod dicom;
mod eval;
mod export;
mod foxglove;
mod generate;
mod import;
mod report;
mod session;
mod soak;
mod sweep;
mod tune;

use clap::Subcommand;
use panoscope_cli::commands::{record, run};

panoscope_engine::guard_exits!();

/// Names and descriptions are those of [`panoscope_cli::command()`].
#[derive(Subcommand)]
enum Command {
    Run(run::Arguments),
    Record(record::Arguments),
    #[command(subcommand)]
    Dicom(dicom::Dicom),
    Export(export::Arguments),
    Import(import::Arguments),
    Sweep(sweep::Arguments),
    Batch(batch::Arguments),
    Report(report::Arguments),
    Worst(batch::WorstArguments),
    Tune(tune::Arguments),
    Soak(soak::Arguments),
    #[command(subcommand)]
    Bench(bench::Bench),
    #[command(subcommand)]
    Eval(eval::Eval),
    Calibrate(calibrate::Arguments),
    Generate(generate::Arguments),
}

/// The whole command line of `panoscope`, with the arguments of the commands of this program.
fn command() -> clap::Command {
    let own = Command::augment_subcommands(clap::Command::new("panoscope"));
    panoscope_cli::command().mut_subcommands(|known| match own.find_subcommand(known.get_name()) {
        Some(own) => {
            let own = own.clone().about(known.get_about().cloned().unwrap_or_default()).hide(known.is_hide_set());
            own.display_order(known.get_display_order())
        }
        None => known,
    })
}

fn main() {
    panoscope_cli::prepare();
    panoscope_cli::leave(match panoscope_cli::parse(command()) {
        Command::Run(arguments) => run::run(&arguments, foxglove::server(&arguments)),
        Command::Record(arguments) => record::run(&arguments, foxglove::server(arguments.run())),
        Command::Dicom(command) => dicom::run(&command),
        Command::Export(arguments) => export::run(&arguments),
        Command::Import(arguments) => import::run(&arguments),
        Command::Sweep(arguments) => sweep::run(&arguments),
        Command::Batch(arguments) => batch::run(&batch::Request::Batch(&arguments)),
        Command::Worst(arguments) => batch::run(&batch::Request::Worst(&arguments)),
        Command::Report(arguments) => report::run(&arguments),
        Command::Tune(arguments) => tune::run(&arguments),
        Command::Soak(arguments) => soak::run(&arguments),
        Command::Bench(bench) => bench::run(&bench),
        Command::Eval(eval) => eval::run(&eval),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Generate(arguments) => generate::run(&arguments, command()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_graph::args::RESERVED_ARGS;

    #[test]
    fn each_command_that_is_handed_over_has_its_arguments_here() {
        let (handed, whole) = (panoscope_cli::command(), command());
        let own = Command::augment_subcommands(clap::Command::new("panoscope"));
        for own in own.get_subcommands() {
            let known = handed.find_subcommand(own.get_name());
            assert!(known.is_some_and(|known| known.get_about().is_some()), "{}", own.get_name());
        }
        let names =
            |command: &clap::Command| command.get_subcommands().map(|c| c.get_name().to_owned()).collect::<Vec<_>>();
        assert_eq!(names(&handed), names(&whole));
        for command in whole.get_subcommands() {
            assert!(
                command.get_arguments().all(|a| a.get_id() != panoscope_cli::beside::WORDS),
                "{}",
                command.get_name()
            );
        }
    }

    #[test]
    fn no_argument_of_a_graph_can_hide_an_option() {
        let command = command();
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
            panoscope_cli::own_options(&command(), &words)
        };
        let has = |words: &str, name: &str| own(words).iter().any(|own| own == name);
        assert!(has("panoscope tune g.toml --method relay", "method") && !has("panoscope run g.toml", "method"));
        assert!(has("panoscope eval stitch g.toml", "speeds") && has("panoscope calibrate --left x", "left"));
    }
}
