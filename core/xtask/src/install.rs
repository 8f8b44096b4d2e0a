//! Puts a release build into a folder, to be run without cargo.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};

use crate::build::{
    Built, Means, Profile, Windows, build, build_windows, lay_out_models, library_name, place, place_files,
    program_name, window_names,
};
use crate::onnxruntime;
use crate::workspace::Workspace;

/// Builds in release and puts all that runs without cargo into `dir`.
///
/// # Errors
/// The build fails, a file cannot be copied, or ONNX Runtime cannot be had; all but ONNX Runtime is in place then.
pub fn install(workspace: &Workspace, dir: &Path) -> Result<()> {
    let built = build(workspace, Profile::Release)?;
    let windows = build_windows(workspace, Profile::Release)?;
    let runtime = onnxruntime::fetch(workspace);
    let tree = Tree { built: &built, windows: Some(&windows), runtime: runtime.as_deref().ok() };
    tree.put_into(workspace, dir, Means::Copy)?;
    println!("{}", dir.join(program_name()).display());
    runtime.map(drop).with_context(|| {
        format!(
            "everything is in {} but ONNX Runtime, so `yolo` and `mask_rcnn` do not open: run this again, or name its library in \
             ORT_DYLIB_PATH when you run graphs with them",
            dir.display()
        )
    })
}

/// What an installed folder is made of.
struct Tree<'a> {
    built: &'a Built,
    windows: Option<&'a Windows>,
    /// ONNX Runtime's shared library; its licence is beside it.
    runtime: Option<&'a Path>,
}

impl Tree<'_> {
    /// Puts the program, the windows, `plugins/` with their models, `onnxruntime/` and `graphs/` into `dir`.
    fn put_into(&self, workspace: &Workspace, dir: &Path, means: Means) -> Result<()> {
        let plugin_dir = dir.join("plugins");
        fs::create_dir_all(&plugin_dir).with_context(|| format!("cannot make {}", plugin_dir.display()))?;
        for plugin in &workspace.plugins {
            let name = library_name(&plugin.name);
            place(&self.built.plugin_dir.join(&name), &plugin_dir.join(&name), means)?;
        }
        lay_out_models(workspace, &plugin_dir, means)?;
        if let Some(library) = self.runtime {
            // Beside the program, where the `tools` plugin looks for it.
            let folder = dir.join("onnxruntime");
            fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
            for file in onnxruntime::files(library) {
                place(&file, &folder.join(file.file_name().unwrap_or_default()), means)?;
            }
        }
        for folder in ["graphs", "graphs/parts", "graphs/sources"] {
            place_files(&workspace.root.join(folder), &dir.join(folder), &["toml"], means)?;
        }
        if let Some(Windows { editor, theatre }) = self.windows {
            for (program, name) in [editor, theatre].into_iter().zip(window_names()) {
                place(program, &dir.join(name), means)?;
            }
        }
        // Last, so that a program that starts finds everything it came with.
        place(&self.built.program, &dir.join(program_name()), means)
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    /// The build that the tests run with, as `cargo xtask test` names it.
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
        let mut list = std::process::Command::new(dir.join(program_name()));
        let listed = list.env_clear().arg("list").output().unwrap();
        let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
        let names_plugin = |plugin: &crate::workspace::Plugin| listed.contains(&plugin.name);
        assert!(workspace.plugins.iter().all(names_plugin), "{listed}");
        assert!(!workspace.test_plugins.iter().any(names_plugin), "plugins of tests were installed: {listed}");
        let run = |dir: &Path| {
            let graph = dir.join("graphs/tools.toml");
            let mut command = std::process::Command::new(dir.join(program_name()));
            command.env_clear().current_dir("/").arg("run").arg(graph).args(["--headless", "--frames", "5"]);
            let output = command.output().unwrap();
            let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
            (output.status.code(), said)
        };
        let (code, said) = run(&dir);
        assert_eq!(code, Some(0), "{said}");
        for file in ["out/tools.mkv", "out/tools.png"] {
            assert!(dir.join(file).metadata().is_ok_and(|f| f.len() > 0), "no {file}: {said}");
        }
        // It is this library that made it run, where the system has none of its own.
        let system = ["/usr/lib", "/usr/local/lib", "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu"];
        if system.iter().all(|folder| !Path::new(folder).join("libonnxruntime.so").exists()) {
            fs::remove_dir_all(dir.join("onnxruntime")).unwrap();
            let (code, said) = run(&dir);
            assert!(code == Some(1) && said.contains("ONNX Runtime's shared library is not there"), "{code:?} {said}");
        }
        fs::remove_dir_all(&dir).unwrap();
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
