//! Builds the program and its plugins and lays them out as they are installed: the binary beside `plugins/`.

use std::collections::BTreeMap;
use std::env::consts::{DLL_PREFIX, DLL_SUFFIX, EXE_SUFFIX};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::process;
use crate::workspace::{Plugin, Workspace};

/// The package of the `panoscope` command.
const PROGRAM_PACKAGE: &str = "panoscope-cli";
const PROGRAM: &str = "panoscope";
/// The windows that `panoscope edit` and `panoscope theatre` start; packages and programs have one name.
const EDITOR: &str = "panoscope-editor";
const THEATRE: &str = "panoscope-theatre";
/// The process that guards an arm, which `arm_serial` and `arm_ur` start; it is built beside the program.
const GUARD_PACKAGE: &str = "panoscope-arm-guard";
const GUARD: &str = "panoscope-arm";
/// The program that links machines, which `panoscope serve` and graphs with `on` start; it is built beside the program.
const MACHINE_PACKAGE: &str = "panoscope-remote";
const MACHINE: &str = "panoscope-machine";
/// The Python package: the folder of its crate, and what Python calls its native part.
const PYTHON: &str = "core/python";
const PYTHON_PACKAGE: &str = "panoscope-python";
const NATIVE: &str = "_native.abi3.so";
/// Endings of the files of the Python package: code, the native part, types and the mark that there are types.
pub const PACKAGE_FILES: [&str; 4] = ["py", "so", "pyi", "typed"];
/// A test of the workspace that is built fast.
const SMALL_TEST: &str = "header";
/// Folder beside the program for plugins that only tests use.
const TEST_PLUGIN_DIR: &str = "test_plugins";

/// Cargo's profiles as far as they are used here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Profile {
    Dev,
    Release,
}

/// What a build made.
#[derive(Debug)]
pub struct Built {
    pub program: PathBuf,
    /// Beside the program; holds one shared library per plugin that ships, and a folder with the files that come with it.
    pub plugin_dir: PathBuf,
}

/// A build with the plugins that only tests use.
#[derive(Debug)]
pub struct BuiltForTests {
    pub built: Built,
    /// Beside the program; one shared library per plugin of `tests/plugins`. The program does not search this folder by itself.
    pub test_plugin_dir: PathBuf,
}

impl Built {
    /// The program, with this build's plugins on its search path.
    pub fn panoscope(&self) -> Command {
        let mut command = Command::new(&self.program);
        command.env("PANOSCOPE_PLUGIN_PATH", &self.plugin_dir);
        command
    }
}

/// Name of a plugin's shared library, from the name of its folder.
pub fn library_name(plugin: &str) -> String {
    format!("{DLL_PREFIX}{plugin}{DLL_SUFFIX}")
}

/// The programs of the windows.
#[derive(Debug)]
pub struct Windows {
    pub editor: PathBuf,
    pub theatre: PathBuf,
}

/// Builds the windows, beside the program.
///
/// # Errors
/// The build fails; cargo prints why.
pub fn build_windows(workspace: &Workspace, profile: Profile) -> Result<Windows> {
    let mut cargo = workspace.cargo();
    cargo.args(["build", "--message-format=json-render-diagnostics", "--package", EDITOR, "--package", THEATRE]);
    if profile == Profile::Release {
        cargo.arg("--release");
    }
    let mut artifacts = Artifacts::default();
    let status = process::filter(&mut cargo, |line| !artifacts.read(line))?;
    process::check(&cargo, status)?;
    let editor = artifacts.editor.with_context(|| format!("{EDITOR} makes no program `{EDITOR}`"))?;
    let theatre = artifacts.theatre.with_context(|| format!("{THEATRE} makes no program `{THEATRE}`"))?;
    Ok(Windows { editor, theatre })
}

/// Builds the program and the plugins that ship. Leaves out the windows, which take longest to build; a demo without a
/// screen and the benches do not need them.
///
/// # Errors
/// The build fails (cargo prints why), or a plugin's crate makes no shared library.
pub fn build(workspace: &Workspace, profile: Profile) -> Result<Built> {
    let plugins: Vec<&Plugin> = workspace.plugins.iter().collect();
    let artifacts = compile(workspace, profile, &plugins)?;
    artifacts.lay_out_product(workspace)
}

/// What [`build_for_tests`] builds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// What tests of single packages need.
    Product,
    /// All that `cargo test --workspace` will need too, with the same features, so that it compiles nothing a second time.
    Workspace,
}

/// The same with the plugins that only tests use, in a folder of their own.
///
/// # Errors
/// See [`build`].
pub fn build_for_tests(workspace: &Workspace, profile: Profile, extent: Extent) -> Result<BuiltForTests> {
    let artifacts = match extent {
        Extent::Product => {
            let plugins: Vec<&Plugin> = workspace.plugins.iter().chain(&workspace.test_plugins).collect();
            compile(workspace, profile, &plugins)?
        }
        Extent::Workspace => {
            let mut cargo = workspace.cargo();
            cargo.args(["build", "--message-format=json-render-diagnostics", "--workspace", "--lib", "--bins"]);
            // With a test among its targets, cargo unites the features of dependencies as it does for all tests.
            finish(cargo.args(["--test", SMALL_TEST]), profile)?
        }
    };
    let built = artifacts.lay_out_product(workspace)?;
    let test_plugin_dir = built.program.with_file_name(TEST_PLUGIN_DIR);
    lay_out(&workspace.test_plugins, &artifacts.libraries, &test_plugin_dir)?;
    Ok(BuiltForTests { built, test_plugin_dir })
}

/// Compiles the program and the given plugins.
fn compile(workspace: &Workspace, profile: Profile, plugins: &[&Plugin]) -> Result<Artifacts> {
    let mut cargo = workspace.cargo();
    cargo.args([
        "build",
        "--message-format=json-render-diagnostics",
        "--package",
        PROGRAM_PACKAGE,
        "--package",
        GUARD_PACKAGE,
        "--package",
        MACHINE_PACKAGE,
        "--package",
        PYTHON_PACKAGE,
    ]);
    for plugin in plugins {
        cargo.args(["--package", &plugin.package]);
    }
    finish(&mut cargo, profile)
}

/// Runs cargo and takes what it made.
fn finish(cargo: &mut Command, profile: Profile) -> Result<Artifacts> {
    if profile == Profile::Release {
        cargo.arg("--release");
    }
    let mut artifacts = Artifacts::default();
    let status = process::filter(cargo, |line| !artifacts.read(line))?;
    process::check(cargo, status)?;
    Ok(artifacts)
}

/// What cargo reported to have made (or found fresh).
#[derive(Debug, Default)]
struct Artifacts {
    program: Option<PathBuf>,
    editor: Option<PathBuf>,
    theatre: Option<PathBuf>,
    /// Shared libraries by the folder of their crate.
    libraries: BTreeMap<PathBuf, PathBuf>,
}

impl Artifacts {
    /// Puts the plugins that ship, and their models, beside the program.
    fn lay_out_product(&self, workspace: &Workspace) -> Result<Built> {
        let program =
            self.program.clone().with_context(|| format!("{PROGRAM_PACKAGE} makes no program `{PROGRAM}`"))?;
        let plugin_dir = program.with_file_name("plugins");
        lay_out(&workspace.plugins, &self.libraries, &plugin_dir)?;
        lay_out_models(workspace, &plugin_dir, Means::Link)?;
        self.lay_out_python(workspace, &python_package(&program))?;
        Ok(Built { program, plugin_dir })
    }

    /// Puts the Python package where the program looks for it.
    fn lay_out_python(&self, workspace: &Workspace, package: &Path) -> Result<()> {
        let folder = workspace.root.join(PYTHON);
        let native =
            self.libraries.get(&folder).with_context(|| format!("{PYTHON_PACKAGE} makes no shared library"))?;
        place_files(&folder.join("panoscope"), package, &PACKAGE_FILES, Means::Link)?;
        place(native, &package.join(NATIVE), Means::Link)
    }

    /// Takes one line of cargo's output; false when it is none of cargo's messages.
    fn read(&mut self, line: &str) -> bool {
        let Ok(message) = serde_json::from_str::<Value>(line) else { return false };
        if message["reason"] != "compiler-artifact" {
            return message["reason"].is_string();
        }
        let target = &message["target"];
        let has_kind = |kind: &str| target["kind"].as_array().is_some_and(|kinds| kinds.iter().any(|k| k == kind));
        if has_kind("bin") && target["name"] == PROGRAM {
            self.program = message["executable"].as_str().map(PathBuf::from);
        }
        if has_kind("bin") && target["name"] == EDITOR {
            self.editor = message["executable"].as_str().map(PathBuf::from);
        }
        if has_kind("bin") && target["name"] == THEATRE {
            self.theatre = message["executable"].as_str().map(PathBuf::from);
        }
        if has_kind("cdylib") {
            let folder = message["manifest_path"].as_str().and_then(|path| Path::new(path).parent());
            let files = message["filenames"].as_array().into_iter().flatten().filter_map(Value::as_str);
            if let (Some(folder), Some(file)) = (folder, files.into_iter().find(|file| file.ends_with(DLL_SUFFIX))) {
                self.libraries.insert(folder.to_owned(), file.into());
            }
        }
        true
    }
}

/// Makes `plugin_dir` hold the plugins' libraries and nothing else.
fn lay_out(plugins: &[Plugin], libraries: &BTreeMap<PathBuf, PathBuf>, plugin_dir: &Path) -> Result<()> {
    fs::create_dir_all(plugin_dir).with_context(|| format!("cannot make {}", plugin_dir.display()))?;
    let mut kept = Vec::new();
    for plugin in plugins {
        let Some(library) = libraries.get(&plugin.folder) else {
            bail!(
                "{} makes no shared library: its Cargo.toml needs crate-type = [\"cdylib\", \"rlib\"]",
                plugin.folder.display()
            );
        };
        let name = library_name(&plugin.name);
        place(library, &plugin_dir.join(&name), Means::Link)?;
        kept.push(name);
    }
    for entry in fs::read_dir(plugin_dir)?.flatten() {
        let name = entry.file_name();
        let is_library = name.to_string_lossy().ends_with(DLL_SUFFIX);
        if is_library && !kept.iter().any(|kept| name == kept.as_str()) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// The Python package of a build, beside its program.
pub fn python_package(program: &Path) -> PathBuf {
    program.with_file_name("python").join("panoscope")
}

/// Puts the models that come with plugins where the program looks for them: `NAME/models` beside the library of plugin NAME.
pub fn lay_out_models(workspace: &Workspace, plugin_dir: &Path, means: Means) -> Result<()> {
    for plugin in &workspace.plugins {
        let models = plugin.folder.join("models");
        if models.is_dir() {
            place_files(&models, &plugin_dir.join(&plugin.name).join("models"), &["onnx", "md", "txt"], means)?;
        }
    }
    Ok(())
}

/// Puts the files of a folder that have one of these endings into another; what runs have written beside them stays behind.
pub fn place_files(from: &Path, to: &Path, endings: &[&str], means: Means) -> Result<()> {
    fs::create_dir_all(to).with_context(|| format!("cannot make {}", to.display()))?;
    for entry in fs::read_dir(from).with_context(|| format!("cannot read {}", from.display()))?.flatten() {
        let path = entry.path();
        if path.extension().is_some_and(|extension| endings.iter().any(|wanted| extension == *wanted)) {
            place(&path, &to.join(entry.file_name()), means)?;
        }
    }
    Ok(())
}

/// How a file gets to its place.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Means {
    /// A hard link where the file system allows, else a copy.
    Link,
    Copy,
}

/// Puts `from` at `to` in one step, so that no reader ever opens half a file.
pub fn place(from: &Path, to: &Path, means: Means) -> Result<()> {
    let mut part = to.as_os_str().to_owned();
    part.push(format!(".{}.part", std::process::id()));
    let part = PathBuf::from(part);
    let linked = means == Means::Link && fs::hard_link(from, &part).is_ok();
    if !linked {
        fs::copy(from, &part).with_context(|| format!("cannot copy {} to {}", from.display(), part.display()))?;
    }
    fs::rename(&part, to).with_context(|| format!("cannot put {} in place", to.display()))?;
    // Renaming one hard link onto another of the same file leaves both.
    let _ = fs::remove_file(&part);
    Ok(())
}

/// Name of the program's file.
pub fn program_name() -> String {
    format!("{PROGRAM}{EXE_SUFFIX}")
}

/// Names of the files of the programs that other programs start: the arm's guard, and what links machines.
pub fn helper_names() -> [String; 2] {
    [GUARD, MACHINE].map(|name| format!("{name}{EXE_SUFFIX}"))
}

/// Names of the files of the editor and the theatre.
pub fn window_names() -> [String; 2] {
    [EDITOR, THEATRE].map(|name| format!("{name}{EXE_SUFFIX}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("xtask_{name}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn stitch() -> Plugin {
        Plugin { name: "stitch".into(), folder: "/r/plugins/stitch".into(), package: "panoscope-stitch".into() }
    }

    #[test]
    fn cargo_messages_name_the_program_and_the_libraries() {
        let mut artifacts = Artifacts::default();
        let library = format!("/t/debug/libpanoscope_stitch{DLL_SUFFIX}");
        let lines = [
            r#"{"reason":"compiler-artifact","manifest_path":"/r/core/cli/Cargo.toml","target":{"kind":["lib"],"name":"panoscope_cli"},"filenames":["/t/debug/libpanoscope_cli.rlib"],"executable":null}"#.to_owned(),
            r#"{"reason":"compiler-artifact","manifest_path":"/r/core/cli/Cargo.toml","target":{"kind":["bin"],"name":"panoscope"},"filenames":["/t/debug/panoscope"],"executable":"/t/debug/panoscope"}"#.to_owned(),
            format!(r#"{{"reason":"compiler-artifact","manifest_path":"/r/plugins/stitch/Cargo.toml","target":{{"kind":["cdylib","rlib"],"name":"panoscope_stitch"}},"filenames":["/t/debug/libpanoscope_stitch.rlib","{library}"],"executable":null}}"#),
            r#"{"reason":"build-finished","success":true}"#.to_owned(),
        ];
        for line in &lines {
            assert!(artifacts.read(line), "{line}");
        }
        assert!(!artifacts.read("a build script's own line"));
        assert!(!artifacts.read("{\"unrelated\": 1}"));
        assert_eq!(artifacts.program.as_deref(), Some(Path::new("/t/debug/panoscope")));
        assert_eq!(artifacts.libraries[Path::new("/r/plugins/stitch")], Path::new(&library));
    }

    #[test]
    fn the_folder_holds_the_plugins_and_no_old_ones() {
        let folder = scratch("lay_out");
        let made = folder.join("libpanoscope_stitch.so");
        fs::write(&made, "new").unwrap();
        let plugin_dir = folder.join("plugins");
        fs::create_dir_all(&plugin_dir).unwrap();
        fs::write(plugin_dir.join(library_name("gone")), "old").unwrap();
        let plugins = [stitch()];
        let libraries = BTreeMap::from([(stitch().folder, made.clone())]);
        for content in ["new", "newer"] {
            fs::remove_file(&made).unwrap();
            fs::write(&made, content).unwrap();
            // Twice: the second time the link is there already.
            lay_out(&plugins, &libraries, &plugin_dir).unwrap();
            lay_out(&plugins, &libraries, &plugin_dir).unwrap();
            let files: Vec<_> = fs::read_dir(&plugin_dir).unwrap().flatten().map(|file| file.file_name()).collect();
            assert_eq!(files, [library_name("stitch").as_str()]);
            assert_eq!(fs::read_to_string(plugin_dir.join(library_name("stitch"))).unwrap(), content);
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_plugin_without_a_library_is_named() {
        let folder = scratch("no_library");
        // Another folder of the same name is not its crate.
        let libraries = BTreeMap::from([(PathBuf::from("/r/tests/plugins/stitch"), PathBuf::from("/t/other.so"))]);
        let error = lay_out(&[stitch()], &libraries, &folder).unwrap_err();
        assert!(error.to_string().contains("/r/plugins/stitch makes no shared library"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
