//! Builds the program and its plugins with the layout of an installation: the binary next to `plugins/`.

use std::collections::{BTreeMap, BTreeSet};
use std::env::consts::{DLL_PREFIX, DLL_SUFFIX, EXE_SUFFIX};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::process;
use crate::time;
use crate::workspace::{Plugin, Workspace};

/// The package of the `panoscope` command.
const PROGRAM_PACKAGE: &str = "panoscope-cli";
const PROGRAM: &str = "panoscope";
/// Program that runs commands of `panoscope` such as `eval`; the demo does not need it. Package and program have the
/// same name.
const LAB: &str = "panoscope-lab";
/// Programs of the windows that `panoscope edit` and `panoscope theatre` start. Packages and programs have the same
/// names.
const EDITOR: &str = "panoscope-editor";
const THEATRE: &str = "panoscope-theatre";
/// Process that guards an arm, started by `arm_serial` and `arm_ur`; it is built next to the program.
const GUARD_PACKAGE: &str = "panoscope-arm-guard";
const GUARD: &str = "panoscope-arm";
/// Program that links machines, started by `panoscope serve` and graphs with `on`; it is built next to the program.
const MACHINE_PACKAGE: &str = "panoscope-remote";
const MACHINE: &str = "panoscope-machine";
/// The Python package: the folder of its crate, and the module name of its native part.
const PYTHON: &str = "core/python";
const PYTHON_PACKAGE: &str = "panoscope-python";
const NATIVE: &str = "_native.abi3.so";
/// Packages of a complete program, besides the plugins.
const PRODUCT: [&str; 5] = [PROGRAM_PACKAGE, LAB, GUARD_PACKAGE, MACHINE_PACKAGE, PYTHON_PACKAGE];
/// File extensions of the Python package: code, native part, types and the marker for types.
const PACKAGE_FILES: [&str; 4] = ["py", "so", "pyi", "typed"];
/// The subpackage of the Python package.
const INNER_PACKAGE: &str = "studies";
/// Arguments for cargo that unite the features of external packages, so that every build uses the same ones.
pub const FEATURES: [&str; 4] = ["--package", "panoscope-features", REST[0], REST[1]];
/// Additional arguments if the whole workspace is built.
pub const REST: [&str; 2] = ["--features", "panoscope-features/rest"];
/// Plugins that need no packages of [`REST`]: those of the demo.
const LIGHT: [&str; 3] = ["phantom", "sinks", "stitch"];
/// Folder next to the program for plugins that only tests use.
const TEST_PLUGIN_DIR: &str = "test_plugins";

/// Cargo profiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Profile {
    Dev,
    Release,
}

/// Results of a build.
#[derive(Debug)]
pub struct Built {
    pub program: PathBuf,
    /// Next to the program; has one shared library per shipped plugin, and a folder with its files.
    pub plugin_dir: PathBuf,
}

/// A build with the plugins that only tests use.
#[derive(Debug)]
pub struct BuiltForTests {
    pub built: Built,
    /// Next to the program; has one shared library per plugin of `tests/plugins`. The program does not search this
    /// folder by default.
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

/// Builds the windows, next to the program.
///
/// # Errors
/// The build fails; cargo prints why.
pub fn build_windows(workspace: &Workspace, profile: Profile) -> Result<Windows> {
    let artifacts = compile(workspace, profile, &[EDITOR, THEATRE])?;
    let editor = artifacts.editor.with_context(|| format!("{EDITOR} produced no program `{EDITOR}`"))?;
    let theatre = artifacts.theatre.with_context(|| format!("{THEATRE} produced no program `{THEATRE}`"))?;
    Ok(Windows { editor, theatre })
}

/// Builds the program, the programs it starts, the Python package and the shipped plugins, but not the windows, which
/// take longest to build; the benches do not need them.
///
/// # Errors
/// The build fails (cargo prints why), or a plugin's crate produces no shared library.
pub fn build(workspace: &Workspace, profile: Profile) -> Result<Built> {
    let plugins = workspace.plugins.iter().map(|plugin| plugin.package.as_str());
    let packages: Vec<&str> = PRODUCT.into_iter().chain(plugins).collect();
    compile(workspace, profile, &packages)?.lay_out_product(workspace)
}

/// Parts of a build that a graph needs.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// Names of plugins.
    pub plugins: BTreeSet<String>,
    /// Whether it has an arm with a guard.
    pub guard: bool,
    /// Whether it uses another machine.
    pub machine: bool,
    /// Whether it has nodes in Python.
    pub python: bool,
}

/// Builds the program and the parts that a graph needs, in the development profile. Earlier builds for other graphs
/// stay.
///
/// # Errors
/// See [`build`].
pub fn build_for_graph(workspace: &Workspace, needs: &Needs) -> Result<Built> {
    let plugins: Vec<Plugin> =
        workspace.plugins.iter().filter(|plugin| needs.plugins.contains(&plugin.name)).cloned().collect();
    let optional = [(needs.guard, GUARD_PACKAGE), (needs.machine, MACHINE_PACKAGE), (needs.python, PYTHON_PACKAGE)];
    let optional = optional.into_iter().filter(|(needed, _)| *needed).map(|(_, package)| package);
    let named = plugins.iter().map(|plugin| plugin.package.as_str());
    let packages: Vec<&str> = [PROGRAM_PACKAGE].into_iter().chain(optional).chain(named).collect();
    let is_light = packages.len() == 1 + plugins.len() && plugins.iter().all(|p| LIGHT.contains(&p.name.as_str()));
    let artifacts = compile_with(workspace, Profile::Dev, &FEATURES[..if is_light { 2 } else { 4 }], &packages)?;
    let built = artifacts.built()?;
    for plugin in &plugins {
        place_plugin(plugin, &artifacts.libraries, &built.plugin_dir)?;
    }
    lay_out_models(workspace, &built.plugin_dir, Means::Link)?;
    if needs.python {
        artifacts.lay_out_python(workspace, &python_package(&built.program))?;
    }
    Ok(built)
}

/// Extent of [`build_for_tests`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// For tests of packages that do not start the program: plugins.
    Plugins,
    /// For tests of single packages: the product.
    Product,
    /// Everything: libraries, programs, tests and benches of all packages, with lints as errors.
    Workspace,
}

/// Builds for tests in the development profile, with the plugins that only tests use in a separate folder.
///
/// # Errors
/// See [`build`].
pub fn build_for_tests(workspace: &Workspace, extent: Extent) -> Result<BuiltForTests> {
    let plugins = workspace.plugins.iter().chain(&workspace.test_plugins).map(|plugin| plugin.package.as_str());
    let artifacts = match extent {
        Extent::Plugins => compile(workspace, Profile::Dev, &plugins.collect::<Vec<_>>())?,
        Extent::Product => compile(workspace, Profile::Dev, &PRODUCT.into_iter().chain(plugins).collect::<Vec<_>>())?,
        Extent::Workspace => {
            time::forget_builds(workspace);
            let mut cargo = workspace.cargo_dev();
            let json = "--message-format=json-render-diagnostics";
            finish(cargo.args(["build", json, "--timings", "--workspace", "--all-targets"]).args(REST), Profile::Dev)?
        }
    };
    let built = if extent == Extent::Plugins {
        let program = workspace.target.join("debug").join(program_name());
        let built = Built { plugin_dir: program.with_file_name("plugins"), program };
        lay_out(&workspace.plugins, &artifacts.libraries, &built.plugin_dir)?;
        lay_out_models(workspace, &built.plugin_dir, Means::Link)?;
        built
    } else {
        artifacts.lay_out_product(workspace)?
    };
    let test_plugin_dir = built.program.with_file_name(TEST_PLUGIN_DIR);
    lay_out(&workspace.test_plugins, &artifacts.libraries, &test_plugin_dir)?;
    Ok(BuiltForTests { built, test_plugin_dir })
}

/// Compiles everything with lints as errors, without linking anything that a later build cannot use.
///
/// # Errors
/// A lint or the compiler found something; cargo prints what.
pub fn check_all(workspace: &Workspace) -> Result<()> {
    process::run(workspace.cargo_dev().args(["build", "--workspace", "--all-targets"]).args(REST))
}

/// Compiles packages.
fn compile(workspace: &Workspace, profile: Profile, packages: &[&str]) -> Result<Artifacts> {
    compile_with(workspace, profile, &FEATURES, packages)
}

/// Compiles packages, with these arguments for external packages.
fn compile_with(workspace: &Workspace, profile: Profile, features: &[&str], packages: &[&str]) -> Result<Artifacts> {
    let mut cargo = match profile {
        Profile::Dev => workspace.cargo_dev(),
        Profile::Release => workspace.cargo_release(),
    };
    cargo.args(["build", "--message-format=json-render-diagnostics"]).args(features);
    cargo.args(packages.iter().flat_map(|package| ["--package", package]));
    finish(&mut cargo, profile)
}

/// Runs cargo and collects its artifacts.
fn finish(cargo: &mut Command, profile: Profile) -> Result<Artifacts> {
    if profile == Profile::Release {
        cargo.arg("--release");
    }
    let mut artifacts = Artifacts::default();
    let status = process::filter(cargo, |line| !artifacts.read(line))?;
    process::check(cargo, status)?;
    Ok(artifacts)
}

/// Artifacts that cargo reported as built or fresh.
#[derive(Debug, Default)]
struct Artifacts {
    program: Option<PathBuf>,
    editor: Option<PathBuf>,
    theatre: Option<PathBuf>,
    /// Shared libraries by the folder of their crate.
    libraries: BTreeMap<PathBuf, PathBuf>,
}

impl Artifacts {
    fn built(&self) -> Result<Built> {
        let program =
            self.program.clone().with_context(|| format!("{PROGRAM_PACKAGE} produced no program `{PROGRAM}`"))?;
        Ok(Built { plugin_dir: program.with_file_name("plugins"), program })
    }

    /// Copies the shipped plugins and their models next to the program.
    fn lay_out_product(&self, workspace: &Workspace) -> Result<Built> {
        let built = self.built()?;
        lay_out(&workspace.plugins, &self.libraries, &built.plugin_dir)?;
        lay_out_models(workspace, &built.plugin_dir, Means::Link)?;
        self.lay_out_python(workspace, &python_package(&built.program))?;
        Ok(built)
    }

    /// Copies the Python package to the folder that the program searches.
    fn lay_out_python(&self, workspace: &Workspace, package: &Path) -> Result<()> {
        let folder = workspace.root.join(PYTHON);
        let native =
            self.libraries.get(&folder).with_context(|| format!("{PYTHON_PACKAGE} produced no shared library"))?;
        place_python(&folder.join("panoscope"), package, Means::Link)?;
        place(native, &package.join(NATIVE), Means::Link)
    }

    /// Reads one line of cargo's output; false if it is not a message of cargo.
    fn read(&mut self, line: &str) -> bool {
        let Ok(message) = serde_json::from_str::<Value>(line) else { return false };
        if message["reason"] != "compiler-artifact" {
            return message["reason"].is_string();
        }
        // Tests of a program have its name too.
        if message["profile"]["test"] == true {
            return true;
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

/// Places a plugin's library in a folder and returns its file name.
fn place_plugin(plugin: &Plugin, libraries: &BTreeMap<PathBuf, PathBuf>, plugin_dir: &Path) -> Result<String> {
    let Some(library) = libraries.get(&plugin.folder) else {
        bail!(
            "{} produced no shared library: its Cargo.toml needs crate-type = [\"cdylib\", \"rlib\"]",
            plugin.folder.display()
        );
    };
    fs::create_dir_all(plugin_dir).with_context(|| format!("cannot make {}", plugin_dir.display()))?;
    let name = library_name(&plugin.name);
    place(library, &plugin_dir.join(&name), Means::Link)?;
    Ok(name)
}

/// Fills `plugin_dir` with the plugins' libraries and removes other files.
fn lay_out(plugins: &[Plugin], libraries: &BTreeMap<PathBuf, PathBuf>, plugin_dir: &Path) -> Result<()> {
    fs::create_dir_all(plugin_dir).with_context(|| format!("cannot make {}", plugin_dir.display()))?;
    let mut kept = Vec::new();
    for plugin in plugins {
        kept.push(place_plugin(plugin, libraries, plugin_dir)?);
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

/// The Python package of a build, next to its program.
pub fn python_package(program: &Path) -> PathBuf {
    program.with_file_name("python").join("panoscope")
}

/// Copies the models of plugins to the folders that the program searches: `NAME/models` next to the library of plugin
/// NAME.
pub fn lay_out_models(workspace: &Workspace, plugin_dir: &Path, means: Means) -> Result<()> {
    for plugin in &workspace.plugins {
        let models = plugin.folder.join("models");
        if models.is_dir() {
            place_files(&models, &plugin_dir.join(&plugin.name).join("models"), &["onnx", "md", "txt"], means)?;
        }
    }
    Ok(())
}

/// Copies the files with one of these extensions to another folder, without other files such as results of runs.
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

/// Places the files of the Python package in another folder.
pub fn place_python(from: &Path, to: &Path, means: Means) -> Result<()> {
    place_files(from, to, &PACKAGE_FILES, means)?;
    place_files(&from.join(INNER_PACKAGE), &to.join(INNER_PACKAGE), &PACKAGE_FILES, means)
}

/// Way of placing a file.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Means {
    /// A hard link if the file system allows it, else a copy.
    Link,
    Copy,
}

/// Places `from` at `to` atomically, so that no reader opens a partial file.
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

/// File name of the program.
pub fn program_name() -> String {
    format!("{PROGRAM}{EXE_SUFFIX}")
}

/// File names of the programs that other programs start: the commands of the lab, the arm's guard, and the program that
/// links machines.
pub fn helper_names() -> [String; 3] {
    [LAB, GUARD, MACHINE].map(|name| format!("{name}{EXE_SUFFIX}"))
}

/// File names of the editor and the theatre.
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
            // The program's own tests, which may be built last.
            r#"{"reason":"compiler-artifact","manifest_path":"/r/core/cli/Cargo.toml","target":{"kind":["bin"],"name":"panoscope"},"profile":{"test":true},"filenames":["/t/debug/deps/panoscope-1"],"executable":"/t/debug/deps/panoscope-1"}"#.to_owned(),
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
        assert!(error.to_string().contains("/r/plugins/stitch produced no shared library"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }

    /// External packages with their resolved features, for some packages of the workspace.
    fn features(workspace: &Workspace, packages: &[&str], edges: &str) -> BTreeSet<String> {
        let mut cargo = workspace.cargo();
        cargo.args(["tree", "--offline", "--prefix", "none", "--format", "{p} {f}", "--edges", edges]).args(packages);
        let text = process::capture(&mut cargo).unwrap();
        text.lines().filter(|line| !line.contains("(/")).map(|line| line.trim_end_matches(" (*)").to_owned()).collect()
    }

    /// Else external packages would be compiled twice: for the demo and for the tests.
    #[test]
    fn a_part_of_the_workspace_uses_external_packages_with_the_features_of_the_whole() {
        let workspace = Workspace::locate().unwrap();
        let whole = features(&workspace, &["--workspace", REST[0], REST[1]], "normal,build,dev");
        assert!(whole.len() > 400, "{}", whole.len());
        let package = |plugin: &Plugin| plugin.package.clone();
        let plugins = workspace.plugins.iter().chain(&workspace.test_plugins).map(package);
        let product: Vec<String> = PRODUCT.map(str::to_owned).into_iter().chain(plugins).collect();
        let light = workspace.plugins.iter().filter(|plugin| LIGHT.contains(&plugin.name.as_str()));
        let demo: Vec<String> = light.map(package).chain([PROGRAM_PACKAGE.to_owned()]).collect();
        assert_eq!(demo.len(), 1 + LIGHT.len());
        let engine = ["panoscope-engine".to_owned()];
        let remote = ["panoscope-remote".to_owned()];
        for (packages, shared, edges) in [
            (&demo[..], &FEATURES[..2], "normal,build"),
            (&product, &FEATURES, "normal,build"),
            (&engine, &FEATURES, "normal,build,dev"),
            (&remote, &FEATURES, "normal,build"),
        ] {
            let named = packages.iter().flat_map(|name| ["--package", name]).chain(shared.iter().copied());
            let part = features(&workspace, &named.collect::<Vec<_>>(), edges);
            let others: Vec<&String> = part.difference(&whole).collect();
            assert!(
                others.is_empty(),
                "core/features/Cargo.toml lacks the features that the workspace has of: {others:#?}"
            );
        }
    }
}
