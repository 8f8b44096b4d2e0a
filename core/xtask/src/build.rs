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
    /// Beside the program; holds one shared library per plugin, and a folder with the files that come with it.
    pub plugin_dir: PathBuf,
}

impl Built {
    /// The program, told where this build's plugins are.
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
/// The build fails; cargo has said why.
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

/// Builds the program and all plugins. Not the windows, which take longest and which a demo without a screen and benches do not need.
///
/// # Errors
/// The build fails (cargo has said why), or a plugin's crate makes no shared library.
pub fn build(workspace: &Workspace, profile: Profile) -> Result<Built> {
    let mut cargo = workspace.cargo();
    cargo.args(["build", "--message-format=json-render-diagnostics", "--package", PROGRAM_PACKAGE]);

    for plugin in &workspace.plugins {
        cargo.args(["--package", &plugin.package]);
    }
    if profile == Profile::Release {
        cargo.arg("--release");
    }
    let mut artifacts = Artifacts::default();
    let status = process::filter(&mut cargo, |line| !artifacts.read(line))?;
    process::check(&cargo, status)?;

    let program = artifacts.program.with_context(|| format!("{PROGRAM_PACKAGE} makes no program `{PROGRAM}`"))?;
    let plugin_dir = program.with_file_name("plugins");
    lay_out(&workspace.plugins, &artifacts.libraries, &plugin_dir)?;
    lay_out_models(workspace, &plugin_dir, Means::Link)?;
    Ok(Built { program, plugin_dir })
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
    let by_name = |plugin: &Plugin| {
        libraries.iter().find(|(folder, _)| folder.file_name().is_some_and(|name| name == plugin.name.as_str()))
    };
    let mut kept = Vec::new();
    for plugin in plugins {
        let Some((_, library)) = by_name(plugin) else {
            bail!(
                "plugins/{} makes no shared library: its Cargo.toml needs crate-type = [\"cdylib\", \"rlib\"]",
                plugin.name
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

/// Puts the models that come with plugins where the program looks for them: `NAME/models` beside the library of plugin NAME.
pub fn lay_out_models(workspace: &Workspace, plugin_dir: &Path, means: Means) -> Result<()> {
    for plugin in &workspace.plugins {
        let models = workspace.root.join("plugins").join(&plugin.name).join("models");
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

/// Puts `from` at `to` in one step, so that nobody ever opens half a file.
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

    #[test]
    fn cargo_messages_tell_the_program_and_the_libraries() {
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
        let plugins = [Plugin { name: "stitch".into(), package: "panoscope-stitch".into() }];
        let libraries = BTreeMap::from([(folder.join("stitch"), made.clone())]);
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
        let plugins = [Plugin { name: "stitch".into(), package: "panoscope-stitch".into() }];
        let error = lay_out(&plugins, &BTreeMap::new(), &folder).unwrap_err();
        assert!(error.to_string().contains("plugins/stitch makes no shared library"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
