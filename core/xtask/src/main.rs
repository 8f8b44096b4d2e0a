//! Development tasks of Panoscope: setup, demo, tests and generated files: `cargo xtask <command>`.

#![forbid(unsafe_code)]

mod build;
mod coverage;
mod data;
mod demo;
mod fuzz;
mod generated;
mod install;
mod interlock;
mod licences;
mod linked;
mod lint;
mod nextest;
mod onnxruntime;
mod package;
mod packages;
mod process;
mod python_packages;
mod report;
mod sanitizer;
mod screens;
mod setup;
mod site;
#[cfg(test)]
mod structure;
mod system;
mod tally;
mod test;
mod time;
mod tool;
mod wheel;
mod workspace;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};

use crate::build::Profile;
use crate::packages::Purpose;
use crate::workspace::Workspace;

const USAGE: &str = "\
cargo xtask COMMAND

  demo [GRAPH.toml] [--headless] [args of `panoscope run`]
                       installs what is missing, builds, runs graphs/panorama.toml and prints what it wrote
  test [SUITE] [-- args of `cargo nextest run`]
                       installs what is missing, builds, checks format and lints, runs all tests; suites: all, lint, code, asan, tsan;
                       with longer doses faults, hostile-models, disk, damaged-streams, losses, soak, leaks, network, kill, pictures, arm, sim;
                       campaign: all of these
  time                 prints where the time of the last `test` went: steps, and the slowest packages, test programs and tests
  interlock [--coverage | --mutants]
                       judges the tests of the arm's interlock: branch coverage (nightly compiler) and mutants; takes an hour
  fuzz [TARGET] [--seconds N] [--keep] | fuzz --coverage | fuzz --missed
                       feeds the parsers of foreign files with inputs that look for crashes, N seconds each (60); needs the nightly toolchain;
                       --keep puts a small selection of what it found into tests/fuzz/corpus; --coverage shows the share of the parsers' lines that
                       the corpora reach, --missed also which they do not
  setup                installs the system packages that are missing
  build [--release]    builds the program, the editor and the plugins, laid out so that they also run outside cargo
  bench [args]         builds in release and runs `panoscope bench args`
  install DIR [--symbols]
                       puts a release build into DIR/bin, DIR/lib and DIR/share: programs, plugins with models, ONNX Runtime, graphs;
                       --symbols keeps line numbers for back-traces
  package [DIR] [--check] [--dev]
                       makes a Debian package and a relocatable tar file of a release build in DIR (target/package); DEBEMAIL=\"Name
                       <address>\" names who made it, else git's user. --check installs it into a bare Debian and uses it there (root); --dev
                       packages a development build, which is made faster
  wheel [DIR] [--check] [--dev]
                       makes a Python package of a release build in DIR (target/wheel), for `pip install`. --check installs it into an empty
                       environment in a bare Debian and compares what graphs give there with the command (root); --dev packages a
                       development build
  site [DIR]           writes the documentation as a web site into DIR (target/site), and checks all links
  screens [DIR]        takes pictures of both windows on a virtual screen into DIR (target/screens)
  data                 fetches the test data that comes from Python wheels into target/data
  onnxruntime          fetches ONNX Runtime's shared library into target/onnxruntime
  header               updates core/contract/abi/panoscope.h from the sources of the ABI
  bless                updates all expected outputs of the tests";

fn main() -> ExitCode {
    match arguments().and_then(|args| dispatch(&args)) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn arguments() -> Result<Vec<String>> {
    std::env::args_os()
        .skip(1)
        .map(|arg| arg.into_string().map_err(|arg| anyhow::anyhow!("the argument {arg:?} is not UTF-8")))
        .collect()
}

fn dispatch(args: &[String]) -> Result<ExitCode> {
    let Some((command, rest)) = args.split_first() else {
        println!("{USAGE}");
        return Ok(ExitCode::from(2));
    };
    match command.as_str() {
        "demo" => demo::demo(&Workspace::locate()?, rest)?,
        "test" => return test::test(&Workspace::locate()?, rest),
        "time" => {
            flag(rest, "")?;
            time::time(&Workspace::locate()?)?;
        }
        "interlock" => interlock::interlock(&Workspace::locate()?, rest)?,
        "fuzz" => {
            let clean = fuzz::fuzz(&Workspace::locate()?, rest)?;
            return Ok(if clean { ExitCode::SUCCESS } else { ExitCode::FAILURE });
        }
        "setup" => {
            if let Some(other) = rest.first() {
                bail!("unexpected argument `{other}`");
            }
            if setup::ensure(&[Purpose::Build, Purpose::Test])? == setup::Outcome::NothingMissing {
                println!("Nothing is missing.");
            }
        }
        "build" => {
            let profile = if flag(rest, "--release")? { Profile::Release } else { Profile::Dev };
            setup::ensure(&[Purpose::Build])?;
            let workspace = Workspace::locate()?;
            // Only a development build is tested.
            let (built, test_plugin_dir) = match profile {
                Profile::Release => (build::build(&workspace, profile)?, None),
                Profile::Dev => {
                    let tests = build::build_for_tests(&workspace, build::Extent::Product)?;
                    (tests.built, Some(tests.test_plugin_dir))
                }
            };
            let windows = build::build_windows(&workspace, profile)?;
            let made = [&built.program, &windows.editor, &windows.theatre, &built.plugin_dir];
            for path in made.into_iter().chain(&test_plugin_dir) {
                println!("{}", path.display());
            }
        }
        "bench" => {
            setup::ensure(&[Purpose::Build])?;
            let built = build::build(&Workspace::locate()?, Profile::Release)?;
            process::run(built.panoscope().arg("bench").args(rest))?;
        }
        "install" => {
            let (dir, symbols) = match rest {
                [dir] => (dir, install::Symbols::Stripped),
                [dir, flag] if flag == "--symbols" => (dir, install::Symbols::Kept),
                _ => bail!("usage: install FOLDER [--symbols]"),
            };
            setup::ensure(&[Purpose::Build])?;
            install::install(&Workspace::locate()?, dir.as_ref(), Profile::Release, symbols)?;
        }
        "package" => {
            let workspace = Workspace::locate()?;
            let Packaging { dir, profile, checks } = Packaging::read(&workspace, "package", rest)?;
            setup::ensure(if checks {
                &[Purpose::Build, Purpose::Package, Purpose::Check]
            } else {
                &[Purpose::Build, Purpose::Package]
            })?;
            let package = package::package(&workspace, &dir, profile)?;
            if checks {
                package::check(&workspace, &package, &dir)?;
            }
        }
        "wheel" => {
            let workspace = Workspace::locate()?;
            let Packaging { dir, profile, checks } = Packaging::read(&workspace, "wheel", rest)?;
            setup::ensure(if checks { &[Purpose::Build, Purpose::Check] } else { &[Purpose::Build] })?;
            let wheel = package::wheel(&workspace, &dir, profile)?;
            if checks {
                package::check_wheel(&workspace, &wheel, &dir)?;
            }
        }
        "site" => {
            let workspace = Workspace::locate()?;
            let dir = match rest {
                [] => workspace.target.join("site"),
                [dir] => dir.into(),
                _ => bail!("usage: site [FOLDER]"),
            };
            let count = site::site(&workspace, &dir)?;
            println!("{count} pages: {}", dir.join("index.html").display());
        }
        "screens" => screens::screens(&Workspace::locate()?, rest)?,
        "data" => {
            flag(rest, "")?;
            println!("{}", data::fetch(&Workspace::locate()?).context("test data was not fetched")?.display());
        }
        "onnxruntime" => {
            flag(rest, "")?;
            println!("{}", onnxruntime::fetch(&Workspace::locate()?)?.display());
        }
        "header" => generated::header(&Workspace::locate()?)?,
        "bless" => generated::bless(&Workspace::locate()?)?,
        "help" | "--help" | "-h" => println!("{USAGE}"),
        other => {
            eprintln!("error: there is no command `{other}`\n\n{USAGE}");
            return Ok(ExitCode::from(2));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Arguments of a packaging command.
struct Packaging {
    dir: PathBuf,
    profile: Profile,
    checks: bool,
}

impl Packaging {
    /// Reads `[DIR] [--check] [--dev]`; the default folder is `target/COMMAND`.
    fn read(workspace: &Workspace, command: &str, args: &[String]) -> Result<Self> {
        let (flags, folders): (Vec<&String>, Vec<&String>) = args.iter().partition(|arg| arg.starts_with("--"));
        if let Some(other) = flags.iter().find(|flag| !["--check", "--dev"].contains(&flag.as_str())) {
            bail!("unexpected argument `{other}`");
        }
        let has = |name: &str| flags.iter().any(|flag| *flag == name);
        let profile = if has("--dev") { Profile::Dev } else { Profile::Release };
        let dir = match folders[..] {
            [] => workspace.target.join(command),
            [dir] => dir.into(),
            _ => bail!("{command} needs exactly one folder"),
        };
        Ok(Self { dir, profile, checks: has("--check") })
    }
}

/// Whether `args` contains `name`; any other argument is an error.
fn flag(args: &[String], name: &str) -> Result<bool> {
    match args.iter().find(|arg| *arg != name) {
        Some(other) => bail!("unexpected argument `{other}`"),
        None => Ok(!args.is_empty()),
    }
}
