//! How this Panoscope was installed, for advice that fits.

use std::path::{Path, PathBuf};

/// Folder of the program in a Debian package.
const PACKAGE_DIR: &str = "/usr/lib/panoscope";

/// Where the running program comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Installation {
    /// A Debian package.
    Package,
    /// A folder made by `cargo xtask install`, or an unpacked tar file.
    Folder(PathBuf),
    /// A build inside the source tree.
    Build(PathBuf),
}

impl Installation {
    /// That of the running program.
    pub fn current() -> Self {
        let program = std::env::current_exe().unwrap_or_default();
        Self::of(program.parent().unwrap_or(Path::new("")))
    }

    /// That of a program in `dir`.
    fn of(dir: &Path) -> Self {
        if dir == Path::new(PACKAGE_DIR) {
            Self::Package
        } else if dir.join("graphs").is_dir() && dir.join("plugins").is_dir() {
            Self::Folder(dir.to_owned())
        } else {
            Self::Build(dir.to_owned())
        }
    }

    /// What it is and where its graphs are.
    pub fn description(&self) -> String {
        match self {
            Self::Package => format!("Debian package in {PACKAGE_DIR}, graphs in /usr/share/panoscope/graphs"),
            Self::Folder(dir) => format!("folder {}, graphs in {}", dir.display(), dir.join("graphs").display()),
            Self::Build(dir) => format!("build in {}, graphs in the source tree", dir.display()),
        }
    }

    /// How to restore files that are missing or broken.
    pub fn repair(&self) -> &'static str {
        match self {
            Self::Package => "reinstall them with `apt install --reinstall panoscope`",
            Self::Folder(_) => "unpack the archive again, or run `cargo xtask install DIR` again",
            Self::Build(_) => "build them with `cargo xtask build`",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_of_installation_is_recognised() {
        assert_eq!(Installation::of(Path::new(PACKAGE_DIR)), Installation::Package);
        let dir = std::env::temp_dir().join(format!("panoscope_installation_{}", std::process::id()));
        std::fs::create_dir_all(dir.join("plugins")).unwrap();
        assert_eq!(Installation::of(&dir), Installation::Build(dir.clone()));
        std::fs::create_dir_all(dir.join("graphs")).unwrap();
        assert_eq!(Installation::of(&dir), Installation::Folder(dir.clone()));
        std::fs::remove_dir_all(&dir).unwrap();
    }
}
