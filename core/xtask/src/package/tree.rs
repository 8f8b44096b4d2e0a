//! Copies and lists files of a package's tree.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;

pub fn make_parent(file: &Path) -> Result<()> {
    let Some(folder) = file.parent() else { return Ok(()) };
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))
}

pub fn write(file: &Path, bytes: impl AsRef<[u8]>) -> Result<()> {
    make_parent(file)?;
    fs::write(file, bytes).with_context(|| format!("cannot write {}", file.display()))
}

pub fn copy(from: &Path, to: &Path) -> Result<()> {
    make_parent(to)?;
    fs::copy(from, to).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    Ok(())
}

pub fn move_file(from: &Path, to: &Path) -> Result<()> {
    copy(from, to)?;
    fs::remove_file(from).with_context(|| format!("cannot remove {}", from.display()))
}

/// Copies a folder; keeps links.
pub fn copy_tree(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to).with_context(|| format!("cannot make {}", to.display()))?;
    for entry in fs::read_dir(from).with_context(|| format!("cannot read {}", from.display()))? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        let kind = entry.file_type()?;
        if kind.is_symlink() {
            symlink(fs::read_link(entry.path())?, &target)
                .with_context(|| format!("cannot make {}", target.display()))?;
        } else if kind.is_dir() {
            copy_tree(&entry.path(), &target)?;
        } else {
            copy(&entry.path(), &target)?;
        }
    }
    Ok(())
}

pub fn markdown_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let all = files(folder)?.into_iter().map(|file| folder.join(file));
    Ok(all.filter(|file| file.extension().is_some_and(|extension| extension == "md")).collect())
}

/// Files below a folder with relative paths, sorted by name. Does not follow links.
pub fn files(root: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).with_context(|| format!("cannot read {}", folder.display()))? {
            let entry = entry?;
            let kind = entry.file_type()?;
            if kind.is_dir() {
                folders.push(entry.path());
            } else if kind.is_file() {
                found.push(entry.path().strip_prefix(root)?.to_owned());
            }
        }
    }
    found.sort();
    Ok(found)
}

pub fn total_bytes(root: &Path) -> Result<u64> {
    files(root)?.iter().map(|file| Ok(fs::metadata(root.join(file))?.len())).sum()
}

pub fn md5sums(root: &Path) -> Result<String> {
    let mut command = Command::new("md5sum");
    command.current_dir(root).args(files(root)?.iter().filter(|file| !file.starts_with("DEBIAN")));
    capture(&mut command)
}

/// Folders and programs 755, other files 644, as Debian's policy requires. Programs are the files directly in
/// `program_dir`.
pub fn set_modes(root: &Path, program_dir: &str) -> Result<()> {
    for file in files(root)? {
        let path = root.join(&file);
        let is_program = file.parent().is_some_and(|folder| folder.ends_with(program_dir));
        fs::set_permissions(&path, fs::Permissions::from_mode(if is_program { 0o755 } else { 0o644 }))?;
        for folder in path.ancestors().skip(1).take_while(|folder| folder.starts_with(root)) {
            fs::set_permissions(folder, fs::Permissions::from_mode(0o755))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_copied_as_links_and_modes_follow_the_policy() {
        let dir = std::env::temp_dir().join(format!("xtask_tree_{}", std::process::id()));
        let _ = fs::remove_dir_all(&dir);
        let (from, to) = (dir.join("from"), dir.join("to"));
        write(&from.join("lib/p/program"), "#!/bin/sh\n").unwrap();
        write(&from.join("lib/p/plugins/a.so"), "code").unwrap();
        fs::create_dir_all(from.join("bin")).unwrap();
        symlink("../lib/p/program", from.join("bin/program")).unwrap();
        fs::set_permissions(from.join("lib/p/program"), fs::Permissions::from_mode(0o600)).unwrap();
        copy_tree(&from, &to).unwrap();
        set_modes(&to, "lib/p").unwrap();
        let mode = |file: &str| fs::metadata(to.join(file)).unwrap().permissions().mode() & 0o777;
        assert_eq!([mode("lib/p/program"), mode("lib/p/plugins/a.so"), mode("lib/p")], [0o755, 0o644, 0o755]);
        assert_eq!(fs::read_link(to.join("bin/program")).unwrap(), Path::new("../lib/p/program"));
        assert_eq!(files(&to).unwrap(), [Path::new("lib/p/plugins/a.so"), Path::new("lib/p/program")]);
        fs::remove_dir_all(dir).unwrap();
    }
}
