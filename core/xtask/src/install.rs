//! Installs a build into a folder, to be run without cargo.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::build::{
    Built, Means, Profile, Windows, build, build_windows, helper_names, lay_out_models, library_name, place,
    place_files, place_python, program_name, python_package, window_names,
};
use crate::onnxruntime;
use crate::process;
use crate::workspace::Workspace;

/// Folder of the programs, the plugins and ONNX Runtime below the prefix of an installation.
pub const LIBRARY: &str = "lib/panoscope";
/// Folder of the graphs below the prefix.
pub const DATA: &str = "share/panoscope";
/// File in [`DATA`] that marks graphs as part of an installation.
const MARKER: &str = "installation.toml";

/// Whether installed programs keep line numbers and function names for back-traces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Symbols {
    Stripped,
    Kept,
}

/// Kind of installation, for the advice of `panoscope doctor`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// By a package manager, below `/usr`.
    Package,
    /// As a folder that can be moved.
    Folder,
    /// In a Python package.
    Wheel,
}

/// Builds everything and installs it into `dir`: `bin`, `lib/panoscope`, `share/panoscope`.
///
/// # Errors
/// The build fails, a file cannot be copied, or ONNX Runtime cannot be fetched; all but ONNX Runtime is then installed.
pub fn install(workspace: &Workspace, dir: &Path, profile: Profile, symbols: Symbols) -> Result<()> {
    let built = build(workspace, profile)?;
    let windows = build_windows(workspace, profile)?;
    let runtime = onnxruntime::fetch(workspace);
    let tree = Tree { built: &built, windows: Some(&windows), runtime: runtime.as_deref().ok() };
    tree.put_into(workspace, dir, Means::Copy)?;
    if symbols == Symbols::Stripped {
        binaries(workspace, dir).iter().try_for_each(|file| strip(file))?;
    }
    println!("{}", dir.join("bin").join(program_name()).display());
    runtime.map(drop).with_context(|| {
        format!(
            "everything is in {} but ONNX Runtime, so `yolo`, `mask_rcnn`, `onnx` and `stereo_net` do not open: run this again, or name its library in \
             ORT_DYLIB_PATH when you run graphs with them",
            dir.display()
        )
    })
}

/// Writes the file that marks the data folder of an installation in `prefix`.
pub fn mark(prefix: &Path, kind: Kind) -> Result<()> {
    let kind = match kind {
        Kind::Package => "package",
        Kind::Folder => "folder",
        Kind::Wheel => "wheel",
    };
    let text = format!(
        "# Graphs below this folder belong to an installation: they write their files into the current folder.\n\
         kind = \"{kind}\"\nversion = \"{}\"\n",
        env!("CARGO_PKG_VERSION")
    );
    let file = prefix.join(DATA).join(MARKER);
    fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))
}

/// Sources of an installed folder.
pub struct Tree<'a> {
    pub built: &'a Built,
    pub windows: Option<&'a Windows>,
    /// ONNX Runtime's shared library; its licence is next to it.
    pub runtime: Option<&'a Path>,
}

impl Tree<'_> {
    /// Installs the programs, the plugins with their models, ONNX Runtime and the graphs into `prefix`.
    ///
    /// # Errors
    /// A file cannot be copied.
    pub fn put_into(&self, workspace: &Workspace, prefix: &Path, means: Means) -> Result<()> {
        let library = prefix.join(LIBRARY);
        let plugin_dir = library.join("plugins");
        make_dir(&plugin_dir)?;
        for plugin in &workspace.plugins {
            let name = library_name(&plugin.name);
            place(&self.built.plugin_dir.join(&name), &plugin_dir.join(&name), means)?;
        }
        lay_out_models(workspace, &plugin_dir, means)?;
        let package = python_package(&self.built.program);
        place_python(&package, &python_package(&library.join(program_name())), means)?;
        if let Some(runtime) = self.runtime {
            // Beside the program, where the `tools` plugin looks for it.
            let folder = library.join("onnxruntime");
            make_dir(&folder)?;
            for file in onnxruntime::files(runtime) {
                place(&file, &folder.join(file.file_name().unwrap_or_default()), means)?;
            }
        }
        for folder in ["graphs", "graphs/parts", "graphs/sources", "graphs/machines"] {
            place_files(&workspace.root.join(folder), &prefix.join(DATA).join(folder), &["toml"], means)?;
        }
        mark(prefix, Kind::Folder)?;
        if let Some(Windows { editor, theatre }) = self.windows {
            for (program, name) in [editor, theatre].into_iter().zip(window_names()) {
                place(program, &library.join(name), means)?;
            }
        }
        for helper in helper_names() {
            place(&self.built.program.with_file_name(&helper), &library.join(&helper), means)?;
        }
        // Last, so that a program that starts finds everything it came with.
        place(&self.built.program, &library.join(program_name()), means)?;
        let bin = prefix.join("bin");
        make_dir(&bin)?;
        let windows = window_names().into_iter().filter(|_| self.windows.is_some());
        for program in windows.chain([program_name()]) {
            let link = bin.join(&program);
            let _ = fs::remove_file(&link);
            symlink(format!("../{LIBRARY}/{program}"), &link)
                .with_context(|| format!("cannot make {}", link.display()))?;
        }
        Ok(())
    }
}

/// Removes from a program or library debug information.
pub fn strip(file: &Path) -> Result<()> {
    process::run(Command::new("strip").args(["--strip-unneeded", "--remove-section=.comment"]).arg(file))
}

/// Programs and libraries of an installed tree.
pub fn binaries(workspace: &Workspace, prefix: &Path) -> Vec<PathBuf> {
    let library = prefix.join(LIBRARY);
    let programs = [program_name()].into_iter().chain(helper_names()).chain(window_names());
    let programs = programs.map(|name| library.join(name));
    let plugins = workspace.plugins.iter().map(|plugin| library.join("plugins").join(library_name(&plugin.name)));
    let runtime = library.join("onnxruntime").join(onnxruntime::LIBRARY);
    programs.chain(plugins).chain([runtime]).filter(|path| path.is_file()).collect()
}

fn make_dir(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    /// The build that the tests run with, from the environment of `cargo xtask test`.
    fn built() -> Option<Built> {
        let program = PathBuf::from(std::env::var_os("PANOSCOPE_BIN")?);
        let plugin_dir = program.with_file_name("plugins");
        Some(Built { program, plugin_dir })
    }

    #[test]
    fn an_installed_tree_finds_instruments_without_any_environment() {
        let workspace = Workspace::locate().unwrap();
        let Some(built) = built() else {
            return panoscope_testing::skipped!("PANOSCOPE_BIN names no program; `cargo xtask test` sets it");
        };
        let runtime = match onnxruntime::fetch(&workspace) {
            Ok(library) => library,
            Err(error) => return panoscope_testing::skipped!("no ONNX Runtime: {error:#}"),
        };
        // Not below the build's folder, where ONNX Runtime would be found anyway.
        let dir = std::env::temp_dir().join(format!("xtask_installed_{}", std::process::id()));
        let _ = fs::remove_dir_all(&dir);
        let tree = Tree { built: &built, windows: None, runtime: Some(&runtime) };
        tree.put_into(&workspace, &dir, Means::Link).unwrap();
        // Moved as a whole, so that nothing in it remembers where it was made.
        let moved = dir.with_extension("moved");
        let _ = fs::remove_dir_all(&moved);
        fs::rename(&dir, &moved).unwrap();
        let dir = moved;
        let work = dir.with_extension("work");
        fs::create_dir_all(&work).unwrap();
        let program = dir.join("bin").join(program_name());
        let mut list = std::process::Command::new(&program);
        let listed = list.env_clear().arg("list").output().unwrap();
        let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
        let names_plugin = |plugin: &crate::workspace::Plugin| listed.contains(&plugin.name);
        assert!(workspace.plugins.iter().all(names_plugin), "{listed}");
        assert!(!workspace.test_plugins.iter().any(names_plugin), "plugins of tests were installed: {listed}");
        let run = |dir: &Path| {
            let graph = dir.join(DATA).join("graphs/tools.toml");
            let mut command = std::process::Command::new(&program);
            command.env_clear().current_dir(&work).arg("run").arg(graph).args(["--headless", "--frames", "5"]);
            let output = command.output().unwrap();
            let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
            (output.status.code(), said)
        };
        let (code, said) = run(&dir);
        assert_eq!(code, Some(0), "{said}");
        // An installed graph leaves the installation as it is.
        assert!(said.contains(&format!("the files it writes go to {}", work.display())), "{said}");
        assert!(!dir.join(DATA).join("out").exists());
        for file in ["out/tools.mkv", "out/tools.png"] {
            assert!(work.join(file).metadata().is_ok_and(|f| f.len() > 0), "no {file}: {said}");
        }
        // It is this library that made it run, where the system has none of its own.
        let system = ["/usr/lib", "/usr/local/lib", "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu"];
        if system.iter().all(|folder| !Path::new(folder).join("libonnxruntime.so").exists()) {
            fs::remove_dir_all(dir.join(LIBRARY).join("onnxruntime")).unwrap();
            let (code, said) = run(&dir);
            assert!(code == Some(1) && said.contains("ONNX Runtime's shared library was not found"), "{code:?} {said}");
        }
        fs::remove_dir_all(&dir).unwrap();
        fs::remove_dir_all(&work).unwrap();
    }

    #[test]
    fn shipped_graphs_name_no_file_of_a_plugin_by_its_path() {
        // Models come with their plugin: a node finds its own wherever it is installed.
        let root = Workspace::locate().unwrap().root.join("graphs");
        let mut graphs = 0;
        for folder in [root.clone(), root.join("parts"), root.join("sources")] {
            for file in fs::read_dir(folder).unwrap().flatten().map(|entry| entry.path()) {
                if file.extension().is_none_or(|extension| extension != "toml") {
                    continue;
                }
                graphs += 1;
                let text = fs::read_to_string(&file).unwrap();
                let named = text.lines().find(|line| !line.starts_with('#') && line.contains("../plugins/"));
                assert_eq!(named, None, "{}", file.display());
            }
        }
        assert!(graphs > 20, "{graphs} graphs");
    }

    #[test]
    fn only_wanted_files_are_copied() {
        let folder = std::env::temp_dir().join(format!("xtask_install_{}", std::process::id()));
        let (from, to) = (folder.join("from"), folder.join("to"));
        fs::create_dir_all(from.join("out")).unwrap();
        fs::write(from.join("a.toml"), "name = \"a\"").unwrap();
        fs::write(from.join("a.mkv"), "video").unwrap();
        place_files(&from, &to, &["toml"], Means::Copy).unwrap();
        let names: Vec<_> = fs::read_dir(&to).unwrap().flatten().map(|file| file.file_name()).collect();
        assert_eq!(names, ["a.toml"]);
        fs::remove_dir_all(&folder).unwrap();
    }
}
