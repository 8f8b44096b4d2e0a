//! Puts a release build into a folder, to be run without cargo.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};

use crate::build::{
    Means, Profile, build, build_editor, editor_name, lay_out_models, library_name, place, place_files, program_name,
};
use crate::workspace::Workspace;

/// Builds in release and copies the program, the editor, `plugins/` with their models, and `graphs/` into `dir`.
pub fn install(workspace: &Workspace, dir: &Path) -> Result<()> {
    let built = build(workspace, Profile::Release)?;
    let plugin_dir = dir.join("plugins");
    fs::create_dir_all(&plugin_dir).with_context(|| format!("cannot make {}", plugin_dir.display()))?;
    for plugin in &workspace.plugins {
        let name = library_name(&plugin.name);
        place(&built.plugin_dir.join(&name), &plugin_dir.join(&name), Means::Copy)?;
    }
    lay_out_models(workspace, &plugin_dir, Means::Copy)?;
    place_files(&workspace.root.join("graphs"), &dir.join("graphs"), &["toml"], Means::Copy)?;
    place(&build_editor(workspace, Profile::Release)?, &dir.join(editor_name()), Means::Copy)?;
    // Last, so that a program that starts finds everything it came with.
    let program = dir.join(program_name());
    place(&built.program, &program, Means::Copy)?;
    println!("{}", program.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

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
