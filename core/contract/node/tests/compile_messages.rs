//! Mistakes of a node's author, and what the compiler says about them. `PANOSCOPE_RENEW=1` renews the expected
//! messages.
//!
//! `compile_fail` holds messages that the derives word themselves. Those in `compile_fail_rustc` come through rustc,
//! whose frame around our words changes from version to version: they are compared on the version that they were
//! recorded with.
//!
//! Each case is given to rustc with the library that the tests link, so that nothing is built for them.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const RECORDED_WITH: &str = "rustc 1.95.";
/// Folder of this package in the workspace.
const HERE: &str = "core/contract/node/";

fn rustc() -> Command {
    let mut rustc = Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()));
    // The library names its own sources from here.
    rustc.current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.."));
    rustc
}

/// Builds of this package next to this program, newest first: one of them has the dependencies that are there.
fn libraries() -> Vec<PathBuf> {
    let program = std::env::current_exe().expect("a program");
    let folder = program.parent().expect("a folder").read_dir().expect("a folder").flatten();
    let mut found: Vec<_> = folder
        .filter(|entry| {
            let name = entry.file_name().to_string_lossy().into_owned();
            name.starts_with("libpanoscope_node-") && name.ends_with(".rlib")
        })
        .map(|entry| (entry.metadata().and_then(|about| about.modified()).expect("a time"), entry.path()))
        .collect();
    found.sort();
    found.into_iter().rev().map(|(_, path)| path).collect()
}

fn out_folder() -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_messages_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

fn compile(case: &Path, library: &Path, emit: &str) -> Output {
    let dependencies = format!("dependency={}", library.parent().expect("a folder").display());
    let mut rustc = rustc();
    rustc.args(["--edition=2024", emit, "--error-format=human", "-L", &dependencies, "--extern"]);
    rustc.arg(format!("panoscope_node={}", library.display())).arg("--out-dir").arg(out_folder());
    rustc.arg(Path::new(HERE).join(case));
    // `export_plugin!` reads them.
    let about = [("CARGO_PKG_NAME", "case"), ("CARGO_PKG_VERSION", "1.0.0"), ("CARGO_PKG_DESCRIPTION", "A case.")];
    rustc.envs(about).output().expect("rustc starts")
}

/// What rustc says, without what depends on where the files are and on lines of other files than the case.
fn words(output: &Output) -> String {
    const CLOSING: [&str; 3] = ["error: aborting due to", "For more information about", "Some errors have detailed"];
    let text = String::from_utf8_lossy(&output.stderr).replace(HERE, "");
    let (mut lines, mut is_elsewhere) = (Vec::new(), false);
    for line in text.lines().filter(|line| !CLOSING.iter().any(|start| line.starts_with(start))) {
        let inner = line.trim_start();
        if let Some(place) = inner.strip_prefix("--> ").or_else(|| inner.strip_prefix("::: ")) {
            is_elsewhere = !place.starts_with("tests/");
            let place = if is_elsewhere { place.split(':').next().unwrap_or(place) } else { place };
            lines.push(format!(" {} {place}", &inner[..3]));
            continue;
        }
        // The margin is as wide as the largest number of a line, in whichever file.
        lines.push(match inner.split_once('|') {
            Some((number, code)) if number.trim_end().bytes().all(|byte| byte.is_ascii_digit()) => {
                let number = if is_elsewhere { "" } else { number.trim_end() };
                format!("{number:>2} |{code}")
            }
            _ if inner.starts_with("= ") => format!("   {inner}"),
            _ if inner.starts_with("and ") && inner.ends_with(" others") => "          and others".to_owned(),
            _ if line.starts_with(' ') => format!("          {inner}"),
            _ => line.to_owned(),
        });
    }
    lines.join("\n").trim().to_owned() + "\n"
}

fn cases(folder: &str) -> Vec<PathBuf> {
    let folder = PathBuf::from("tests").join(folder);
    let there = Path::new(env!("CARGO_MANIFEST_DIR")).join(&folder).read_dir().expect("a folder").flatten();
    let mut cases: Vec<PathBuf> = there.map(|entry| folder.join(entry.file_name())).collect();
    cases.retain(|path| path.extension().is_some_and(|extension| extension == "rs"));
    cases.sort();
    assert!(!cases.is_empty(), "{}", folder.display());
    cases
}

/// The mistake of a case that is not answered as it is written down.
fn difference(case: &Path, library: &Path) -> Option<String> {
    let output = compile(case, library, "--emit=metadata");
    let (file, said) = (Path::new(env!("CARGO_MANIFEST_DIR")).join(case).with_extension("stderr"), words(&output));
    if std::env::var_os("PANOSCOPE_RENEW").is_some() {
        std::fs::write(&file, &said).expect("written");
    }
    let expected = std::fs::read_to_string(&file).unwrap_or_default();
    let name = case.display();
    match output.status.success() {
        true => Some(format!("{name}: it compiles")),
        false if said != expected => Some(format!("{name}: expected\n{expected}\nthe compiler says\n{said}")),
        false => None,
    }
}

#[test]
fn mistakes_are_named() {
    let pass = cases("compile_pass");
    let runs = |case: &PathBuf, library: &Path| {
        let program = out_folder().join(case.file_stem().expect("a name"));
        compile(case, library, "--emit=link").status.success()
            && Command::new(program).status().is_ok_and(|s| s.success())
    };
    let fits = |library: &PathBuf| pass.iter().all(|case| runs(case, library));
    let libraries = libraries();
    let library = libraries.iter().find(|library| fits(library)).unwrap_or_else(|| {
        let said = libraries.first().map(|library| words(&compile(&pass[0], library, "--emit=link")));
        panic!("{} does not compile: {said:?}", pass[0].display())
    });
    let version = rustc().arg("--version").output().map(|o| String::from_utf8_lossy(&o.stdout).into_owned());
    let mut all = cases("compile_fail");
    match version {
        Ok(version) if version.starts_with(RECORDED_WITH) => all.extend(cases("compile_fail_rustc")),
        other => {
            panoscope_testing::skipped!("compile_fail_rustc was recorded with {RECORDED_WITH}x, this is {other:?}")
        }
    }
    let wrong: Vec<String> = all.iter().filter_map(|case| difference(case, library)).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
    let _ = std::fs::remove_dir_all(out_folder());
}
