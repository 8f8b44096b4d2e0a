//! Graphs that come with an installation write their files outside of it.
//!
//! The data folder of an installation holds a file [`MARKER`]. A relative path that a node *writes*, in a graph file,
//! part or overlay below such a folder, starts from [`output_dir`] instead of the file's folder, and loses its leading
//! `..`: `../out/wide.mkv` is `out/wide.mkv` in the folder where the program was started. Paths that are read, and all
//! paths of graphs elsewhere, stay relative to their file.

use std::ffi::CString;
use std::os::unix::ffi::OsStrExt;
use std::path::{Component, Path, PathBuf};

/// Name of the file in the data folder of an installation.
pub const MARKER: &str = "installation.toml";

/// Environment variable that names the folder for the files of installed graphs.
pub const OUTPUT_VARIABLE: &str = "PANOSCOPE_OUTPUT";

/// Folders between an installation's data folder and the deepest of its graph files.
const DEPTH: usize = 4;

/// The data folder of the installation that a folder of graph files belongs to. Follows links.
pub fn data_dir(folder: &Path) -> Option<PathBuf> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let whole = folder.canonicalize().ok()?;
    whole.ancestors().take(DEPTH).find(|dir| dir.join(MARKER).is_file()).map(Path::to_owned)
}

/// The folder that installed graphs write into: `PANOSCOPE_OUTPUT`; else the current folder; else, where that cannot be
/// written or belongs to an installation itself, `panoscope` in the user's data folder (`XDG_DATA_HOME`,
/// `~/.local/share`). Absolute.
pub fn output_dir() -> PathBuf {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let current = std::env::current_dir().unwrap_or_default();
    if let Some(chosen) = variable(OUTPUT_VARIABLE) {
        return current.join(chosen);
    }
    let data_home = variable("XDG_DATA_HOME").filter(|dir| dir.is_absolute());
    let data_home = data_home.or_else(|| Some(variable("HOME")?.join(".local/share")));
    choose(current, data_home)
}

fn choose(current: PathBuf, data_home: Option<PathBuf>) -> PathBuf {
    match data_home {
        Some(home) if !is_writable(&current) || data_dir(&current).is_some() => home.join("panoscope"),
        _ => current,
    }
}

/// Notice for a user who opens an installed graph file.
pub fn notice(graph: &Path) -> Option<String> {
    let root = data_dir(graph.parent().unwrap_or(Path::new("")))?;
    let (root, output) = (root.display(), output_dir());
    Some(format!("this graph belongs to the installation in {root}; the files it writes go to {}", output.display()))
}

/// Absolute path of a relative path that an installed graph writes.
pub(crate) fn output(written: &str) -> PathBuf {
    output_dir().join(inside(Path::new(written)))
}

/// A relative path without the leading `..` components.
fn inside(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::Normal(name) => out.push(name),
            Component::ParentDir => _ = out.pop(),
            _ => {}
        }
    }
    out
}

/// Whether this process may create files in a folder.
fn is_writable(folder: &Path) -> bool {
    let Ok(path) = CString::new(folder.as_os_str().as_bytes()) else { return false };
    // SAFETY: `path` is a zero-terminated text that lives until the call returns; the call only reads it.
    unsafe { libc::access(path.as_ptr(), libc::W_OK | libc::X_OK) == 0 }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_path_stays_inside() {
        let cases = [
            ("../out/wide.mkv", "out/wide.mkv"),
            ("../../out/wide.mkv", "out/wide.mkv"),
            ("wide.mkv", "wide.mkv"),
            ("./a/../../../b/{seq}.png", "b/{seq}.png"),
        ];
        for (written, expected) in cases {
            assert_eq!(inside(Path::new(written)), Path::new(expected), "{written}");
        }
    }

    #[test]
    fn folders_that_cannot_be_written_are_not_chosen() {
        let home = Some(PathBuf::from("/home/me/.local/share"));
        let own = PathBuf::from("/home/me/.local/share/panoscope");
        let dir = std::env::temp_dir().join(format!("panoscope_installed_{}", std::process::id()));
        std::fs::create_dir_all(dir.join("graphs/parts")).expect("a folder");
        assert_eq!(choose(dir.clone(), home.clone()), dir);
        let fixed = dir.join("fixed");
        std::fs::create_dir(&fixed).expect("a folder");
        std::fs::set_permissions(&fixed, std::fs::Permissions::from_mode(0o555)).expect("permissions");
        // An administrator may write everywhere.
        let is_fixed = std::fs::write(fixed.join("file"), "").is_err();
        assert_eq!(choose(fixed.clone(), home.clone()), if is_fixed { own.clone() } else { fixed });
        assert_eq!(choose("/no/such/folder".into(), home.clone()), own);
        assert_eq!(choose("/no/such/folder".into(), None), Path::new("/no/such/folder"));
        assert_eq!(data_dir(&dir.join("graphs")), None);
        std::fs::write(dir.join(MARKER), "").expect("a file");
        let root = dir.canonicalize().expect("a folder");
        assert_eq!(data_dir(&dir.join("graphs")), Some(root.clone()));
        assert_eq!(data_dir(&dir.join("graphs/parts")), Some(root));
        assert_eq!(choose(dir.join("graphs"), home), own);
        std::fs::remove_dir_all(dir).expect("removed");
    }
}
