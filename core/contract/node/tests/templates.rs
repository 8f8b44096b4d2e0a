//! The plugins that `panoscope new plugin` writes build and pass their own tests.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_graph::GraphText;

const NAME: &str = "my-filter";

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

/// Copies a template to a fresh folder with its placeholders replaced, as `panoscope new plugin` does.
fn fill(template: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("new_{template}"));
    let _ = std::fs::remove_dir_all(&folder);
    copy(&root().join("core/cli/templates").join(template), &folder);
    folder
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder for tests");
    for entry in std::fs::read_dir(from).expect("the template is there") {
        let path = entry.expect("an entry").path();
        let name = path
            .file_name()
            .expect("a name")
            .to_string_lossy()
            .replace("NAME", NAME)
            .replace("gitignore", ".gitignore");
        if path.is_dir() {
            copy(&path, &to.join(name));
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("a text");
        let text = text
            .replace("{{name}}", NAME)
            .replace("{{node}}", "my_filter")
            .replace("{{lib}}", "my_filter")
            .replace("{{panoscope_node_dependency}}", &format!("version = {:?}", env!("CARGO_PKG_VERSION")))
            .replace("{{panoscope_include}}", &root().join("core/contract/abi").display().to_string());
        assert!(!text.contains("{{"), "{}: a placeholder is left", path.display());
        std::fs::write(to.join(name), text).expect("a folder for tests");
    }
}

fn succeeds(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    let text = [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned()).concat();
    assert!(output.status.success(), "{command:?}:\n{text}");
    text
}

fn graph_parses(folder: &Path) {
    let graph = GraphText::load(&folder.join(format!("{NAME}.toml"))).expect("the graph is there");
    assert!(graph.diagnostics().is_empty(), "{}", graph.diagnostics());
    assert_eq!(graph.plugins(), ["phantom", NAME, "sinks"]);
    assert_eq!(graph.plugin_paths().len(), 1);
}

/// The crates that a plugin outside this repository needs.
const PUBLISHED: [&str; 5] =
    ["panoscope-abi", "panoscope-base", "panoscope-graph", "panoscope-node", "panoscope-node-derive"];

/// Packages the crates for authors of plugins, and unpacks them. Returns lines of a manifest that replace those of the
/// registry.
fn packaged(cargo: &OsStr) -> String {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("packaged");
    let mut command = Command::new(cargo);
    command.args(["package", "--allow-dirty", "--no-verify", "--offline"]).current_dir(root());
    command.args(PUBLISHED.iter().flat_map(|name| ["--package", name])).env("CARGO_TARGET_DIR", &target);
    succeeds(&mut command);
    let folder = target.join("package");
    let patch = PUBLISHED.iter().map(|name| {
        let crate_name = format!("{name}-{}", env!("CARGO_PKG_VERSION"));
        let mut tar = Command::new("tar");
        tar.args(["--extract", "--gzip", "--file", &format!("{crate_name}.crate")]).current_dir(&folder);
        succeeds(&mut tar);
        format!("{name} = {{ path = {:?} }}\n", folder.join(crate_name))
    });
    format!("\n[patch.crates-io]\n{}", patch.collect::<String>())
}

#[test]
fn the_rust_template() {
    let folder = fill("rust");
    graph_parses(&folder);
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let manifest = folder.join("Cargo.toml");
    let text = std::fs::read_to_string(&manifest).expect("it was written") + &packaged(&cargo);
    std::fs::write(manifest, text).expect("a folder for tests");
    // Uses the dependency versions of this workspace.
    std::fs::copy(root().join("Cargo.lock"), folder.join("Cargo.lock")).expect("a lock file");
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("new_target");
    let run = |arguments: &[&str]| {
        let mut command = Command::new(&cargo);
        command.args(arguments).current_dir(&folder).env("CARGO_TARGET_DIR", &target).env("RUSTFLAGS", "-Dwarnings");
        // Compiles once and runs one small test: a quarter of the time of the template's own profile.
        command.envs([
            ("CARGO_PROFILE_DEV_OPT_LEVEL", "0"),
            ("CARGO_PROFILE_DEV_DEBUG", "false"),
            ("CARGO_INCREMENTAL", "0"),
        ]);
        succeeds(&mut command)
    };
    assert!(run(&["test"]).contains("colours_are_multiplied_and_stay_in_range ... ok"));
    run(&["build"]);
    let library = std::fs::read(target.join("debug/libmy_filter.so")).expect("the plugin was built");
    for text in ["panoscope_plugin\0", ".note.panoscope\0", "my-filter\0"] {
        assert!(library.windows(text.len()).any(|bytes| bytes == text.as_bytes()), "{text:?} is not in the library");
    }
}

#[test]
fn the_c_template() {
    if Command::new("make").arg("--version").output().is_err() || Command::new("cc").arg("--version").output().is_err()
    {
        panoscope_testing::skipped!("make or cc cannot be run");
        return;
    }
    let folder = fill("c");
    graph_parses(&folder);
    let flags = "CFLAGS=-O2 -Wall -Wextra -Werror -pedantic";
    let make = |argument: &str| succeeds(Command::new("make").args([argument, flags]).current_dir(&folder));
    assert!(make("test").ends_with("ok\n"));
    assert!(folder.join("libmy_filter.so").exists());
    make("clean");
    assert!(!folder.join("libmy_filter.so").exists());
}
