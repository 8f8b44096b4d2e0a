//! How this Panoscope was installed, for matching advice.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use panoscope_graph::installed::MARKER;

/// Folder with the data folder of an installation, from the folder of its programs (`lib/panoscope`).
const DATA_FROM_PROGRAM: &str = "../../share/panoscope";

/// Installation of the running program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Installation {
    /// Kind of installation.
    pub kind: Kind,
    /// The program's folder: next to it are the plugins, ONNX Runtime and the windows.
    pub program_dir: PathBuf,
    /// The graphs; `None` for a build, whose graphs are in the source tree.
    pub graph_dir: Option<PathBuf>,
}

/// Where the running program comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A Debian package.
    Package,
    /// A folder made by `cargo xtask install`, or an unpacked tar file.
    Folder,
    /// The Python package.
    Wheel,
    /// A build inside the source tree.
    Build,
}

impl Installation {
    /// The installation of the running program.
    pub fn current() -> Self {
        let program = std::env::current_exe().unwrap_or_default();
        Self::of(program.parent().unwrap_or(Path::new("")))
    }

    /// The installation of a program in `program_dir`.
    fn of(program_dir: &Path) -> Self {
        let data = program_dir.join(DATA_FROM_PROGRAM);
        let marker = std::fs::read_to_string(data.join(MARKER)).ok();
        let kind = match marker.as_deref().map(|text| text.parse::<toml::Table>()) {
            None => Kind::Build,
            Some(Ok(table)) => match table.get("kind").and_then(toml::Value::as_str) {
                Some("package") => Kind::Package,
                Some("wheel") => Kind::Wheel,
                _ => Kind::Folder,
            },
            Some(Err(_)) => Kind::Folder,
        };
        let graphs = (kind != Kind::Build).then(|| data.join("graphs"));
        let graph_dir = graphs.map(|dir| dir.canonicalize().unwrap_or(dir));
        Self { kind, program_dir: program_dir.to_owned(), graph_dir }
    }

    /// Arguments of a command in which graphs and overlays that do not exist are those of this installation, as `ps.Graph` finds them. Values of options
    /// other than `--with` stay: they may name new files.
    pub fn with_its_graphs(&self, words: Vec<OsString>) -> Vec<OsString> {
        let Some(dir) = &self.graph_dir else { return words };
        let is_value = |at: usize| words[at - 1].to_str().is_some_and(|word| word.starts_with('-') && word != "--with");
        let shipped = |(at, word): (usize, &OsString)| {
            let (file, installed) = (Path::new(word), dir.join(word));
            let is_graph = at > 0 && !is_value(at) && file.extension().is_some_and(|ending| ending == "toml");
            (is_graph && !file.exists() && installed.is_file()).then(|| installed.into_os_string())
        };
        words.iter().enumerate().map(|(at, word)| shipped((at, word)).unwrap_or_else(|| word.clone())).collect()
    }

    /// Description with the kind and the folder of the programs.
    pub fn description(&self) -> String {
        let kind = match self.kind {
            Kind::Package => "Debian package",
            Kind::Folder => "folder",
            Kind::Wheel => "Python package",
            Kind::Build => "build",
        };
        format!("{kind}, programs in {}", self.program_dir.display())
    }

    /// How to restore files that are missing or broken.
    pub fn repair(&self) -> &'static str {
        match self.kind {
            Kind::Package => "reinstall them with `apt install --reinstall panoscope`",
            Kind::Folder => "unpack the archive again, or run `cargo xtask install DIR` again",
            Kind::Wheel => "install them again with `pip install --force-reinstall panoscope`",
            Kind::Build => "build them with `cargo xtask build`",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn each_kind_of_installation_is_recognised() {
        let prefix = std::env::temp_dir().join(format!("panoscope_installation_{}", std::process::id()));
        let (library, data) = (prefix.join("lib/panoscope"), prefix.join("share/panoscope"));
        fs::create_dir_all(library.join("plugins")).unwrap();
        let kind = || Installation::of(&library).kind;
        assert_eq!(kind(), Kind::Build);
        fs::create_dir_all(data.join("graphs")).unwrap();
        assert_eq!(kind(), Kind::Build, "only the marker makes an installation");
        for (text, expected) in [
            ("kind = \"package\"", Kind::Package),
            ("kind = \"wheel\"", Kind::Wheel),
            ("kind = \"folder\"", Kind::Folder),
            ("not TOML", Kind::Folder),
        ] {
            fs::write(data.join(MARKER), text).unwrap();
            assert_eq!(kind(), expected, "{text}");
        }
        let graphs = Installation::of(&library).graph_dir.unwrap();
        assert_eq!(graphs, data.join("graphs").canonicalize().unwrap());
        // Its graphs are found by their names; files of the user, new files and other words stay.
        fs::write(graphs.join("shipped.toml"), "").unwrap();
        let words = [
            "panoscope",
            "run",
            "shipped.toml",
            "--with",
            "shipped.toml",
            "-o",
            "shipped.toml",
            "none.toml",
            "--x=shipped.toml",
        ];
        let shipped = graphs.join("shipped.toml").into_os_string();
        let found = Installation::of(&library).with_its_graphs(words.map(OsString::from).to_vec());
        let changed: Vec<usize> = (0..words.len()).filter(|at| found[*at] != words[*at]).collect();
        assert_eq!((changed, &found[2], &found[4]), (vec![2, 4], &shipped, &shipped));
        fs::remove_dir_all(prefix).unwrap();
    }
}
