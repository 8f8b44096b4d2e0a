//! Files that two nodes would write, and files that one node writes while another reads them.

use super::Checker;
use crate::diagnostic::{Diagnostic, Severity};
use crate::param::{Param, ParamValue, Pick};
use crate::source::tidy;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The place holder that becomes the name of an input.
const PORT: &str = "{port}";

/// A file that a parameter names.
struct File {
    node: usize,
    param: usize,
    /// Absolute, without `.` and `..`; place holders as written.
    path: PathBuf,
}

impl<'a> Checker<'a> {
    pub(super) fn files(&mut self, params: &[Vec<ParamValue>]) {
        if self.text.incomplete {
            return;
        }
        let (mut written, mut read) = (Vec::new(), Vec::new());
        for (node, values) in params.iter().enumerate() {
            let Some(node_type) = self.type_of(node).filter(|_| !self.doubled.contains(self.id(node))) else {
                continue;
            };
            for (param, (declared, value)) in node_type.params.iter().zip(values).enumerate() {
                match value {
                    ParamValue::Path(path) if path.as_os_str().is_empty() || is_device(path) => {}
                    ParamValue::Path(path) if declared.writes => {
                        written.extend(self.per_port(node, path).map(|path| File { node, param, path: tidy(&path) }));
                    }
                    value => read.extend(self.read_files(declared, value).map(|path| File { node, param, path })),
                }
            }
        }
        let mut first: HashMap<&Path, usize> = HashMap::new();
        let mut told: Vec<(usize, usize)> = Vec::new();
        for (index, file) in written.iter().enumerate() {
            let before = *first.entry(&file.path).or_insert(index);
            let pair = |file: &File| (file.node, file.param);
            if pair(&written[before]) == pair(file) || told.contains(&pair(file)) {
                continue;
            }
            told.push(pair(file));
            self.written_twice(&written[before], file);
        }
        for file in &read {
            if let Some(writer) = written.iter().find(|w| w.node != file.node && holds(&file.path, &w.path)) {
                self.read_while_written(writer, file);
            }
        }
    }

    /// The paths that a written path stands for: one per connected input where it names the input.
    fn per_port(&self, node: usize, path: &Path) -> impl Iterator<Item = PathBuf> + use<'a> {
        let text = path.to_string_lossy().into_owned();
        let ports: Vec<&str> = match text.contains(PORT) {
            true => self.text.flat.nodes[node].inputs.iter().map(|i| i.port.value.as_str()).collect(),
            false => vec![""],
        };
        ports.into_iter().map(move |port| PathBuf::from(text.replace(PORT, port)))
    }

    /// Files that a parameter without output may read: a path, or the texts of a list that may name files.
    fn read_files(&self, declared: &Param, value: &ParamValue) -> std::vec::IntoIter<PathBuf> {
        let paths: Vec<PathBuf> = match value {
            ParamValue::Path(path) => vec![tidy(path)],
            ParamValue::Text(text) if declared.pick == Pick::File => {
                let parts = text.split([';', '\n']).map(str::trim).filter(|part| !part.is_empty());
                parts.map(|part| tidy(&self.resolve(part))).collect()
            }
            _ => Vec::new(),
        };
        paths.into_iter()
    }

    /// `` `path` of `out` ``
    fn owner(&self, file: &File) -> String {
        let name = self.type_of(file.node).map_or("", |t| t.params[file.param].name.as_str());
        format!("`{name}` of `{}`", self.id(file.node))
    }

    /// A path as a graph file would write it, if it is in the folder of the graph.
    fn shown(&self, path: &Path) -> String {
        path.strip_prefix(tidy(&self.resolve("."))).unwrap_or(path).display().to_string()
    }

    /// A diagnostic at the value of the parameter, with a note at the other one.
    fn about_both(
        &self,
        severity: Severity,
        code: &'static str,
        main: &File,
        other: (&File, &str),
        message: String,
    ) -> Diagnostic {
        let location = |file: &File| {
            let name = self.type_of(file.node).map_or("", |t| t.params[file.param].name.as_str());
            self.given(file.node, name).unwrap_or(&self.text.flat.nodes[file.node].id.span)
        };
        let (span, other_span) = (location(main), location(other.0));
        let mut d = Diagnostic::new(severity, code, self.text.sources.of(span), span, message);
        d.note(&self.text.sources, other_span, other.1);
        d
    }

    fn written_twice(&mut self, first: &File, second: &File) {
        let message = format!(
            "{} and {} are one file, {}: what one of them writes would be lost",
            self.owner(first),
            self.owner(second),
            self.shown(&second.path)
        );
        let mut d = self.about_both(Severity::Error, "written-twice", second, (first, "written here too"), message);
        d.help("give each its own file");
        self.diagnostics.push(d);
    }

    fn read_while_written(&mut self, writer: &File, reader: &File) {
        let message = format!(
            "{} reads {}, which {} writes while the graph runs",
            self.owner(reader),
            self.shown(&reader.path),
            self.owner(writer)
        );
        let mut d = self.about_both(Severity::Warning, "read-while-written", reader, (writer, "written here"), message);
        d.help("read another file, or write to another");
        self.diagnostics.push(d);
    }
}

/// Whether reading `read` (a file, a folder of images, a pattern) can meet the file `written`.
fn holds(read: &Path, written: &Path) -> bool {
    if read == written || (written.parent() == Some(read) && read.is_dir()) {
        return true;
    }
    let name = read.file_name().map(|n| n.to_string_lossy()).unwrap_or_default();
    name.contains(['*', '%', '?']) && read.parent() == written.parent() && read.extension() == written.extension()
}

/// Whether the path is a device or a pipe, such as /dev/null, to which several nodes may write.
fn is_device(path: &Path) -> bool {
    path.metadata().is_ok_and(|found| !found.is_file() && !found.is_dir())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spellings_of_one_file_are_one_path() {
        assert_eq!(tidy(Path::new("/a/./b/../c.mkv")), Path::new("/a/c.mkv"));
        assert_eq!(tidy(Path::new("/../c.mkv")), Path::new("/c.mkv"));
        assert_eq!(tidy(Path::new("out/x.png")), tidy(&std::env::current_dir().unwrap().join("out/./x.png")));
    }

    #[test]
    fn devices_are_no_files() {
        assert!(is_device(Path::new("/dev/null")));
        assert!(!is_device(Path::new("/no/such/file")) && !is_device(Path::new("/")));
    }

    #[test]
    fn patterns_and_files_meet() {
        let holds = |read: &str, written: &str| holds(Path::new(read), Path::new(written));
        assert!(holds("/a/x.png", "/a/x.png"));
        assert!(holds("/a/*.png", "/a/{seq}.png"));
        assert!(!holds("/a/*.jpg", "/a/{seq}.png"));
        assert!(!holds("/a/x.png", "/a/y.png"));
        assert!(!holds("/b/*.png", "/a/{seq}.png"));
    }
}
