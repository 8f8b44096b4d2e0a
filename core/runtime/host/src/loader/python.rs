//! Plugins that are Python files: finds them, reads their node types from the text and chooses the interpreter.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::isolate::Launch;
use panoscope_abi as abi;
use sha2::{Digest, Sha256};
use toml::Table;

use crate::loader::elf::Note;
use crate::loader::error::{LoadError, NoPython};
use crate::loader::stamp::Stamp;

/// Environment variable with the interpreter of plugins that name none.
const PYTHON_VARIABLE: &str = "PANOSCOPE_PYTHON";
/// Maximum length of a file that is read, bytes.
const MAX_BYTES: u64 = 4 << 20;
/// Module that runs the nodes.
const MODULE: &str = "panoscope.child";

/// The interpreter of a plugin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Python {
    /// Its file.
    pub interpreter: PathBuf,
}

impl Python {
    /// Program and arguments to start it for a group of nodes.
    pub(crate) fn launch(&self) -> Result<Launch, NoPython> {
        if !self.interpreter.is_file() {
            return Err(NoPython::Interpreter { interpreter: self.interpreter.clone() });
        }
        let arguments = ["-m", MODULE].map(OsString::from).to_vec();
        // The process may not write files, and its output is read line by line.
        let more = [("PYTHONDONTWRITEBYTECODE", "1"), ("PYTHONUNBUFFERED", "1")];
        let more = more.map(|(name, value)| (name.into(), value.into()));
        let environment = [("PYTHONPATH".into(), python_path()?)].into_iter().chain(more).collect();
        Ok(Launch { program: self.interpreter.clone(), arguments, environment })
    }

    /// Cache file for the description of a plugin. Its name depends on everything that the description may depend on:
    /// the file's bytes in `image`, its neighbours, which it may import, the interpreter and the package; other
    /// packages of the interpreter are ignored. `None` without a home folder.
    pub(crate) fn kept_description(&self, file: &Path, image: &Path) -> Option<PathBuf> {
        let mut hash = Sha256::new();
        hash.update(concat!(env!("CARGO_PKG_VERSION"), "\0"));
        hash.update(std::fs::read(image).ok()?);
        let interpreter = self.interpreter.canonicalize().ok()?;
        let package = package().ok()?.join("panoscope");
        let neighbours = file.parent().into_iter().chain([package.as_path()]).flat_map(code_in);
        for file in [self.interpreter.clone(), interpreter, file.to_owned()].into_iter().chain(neighbours) {
            hash.update(format!("{}\0{:?}\0", file.display(), Stamp::of(&file)));
        }
        let name = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        Some(cache_folder()?.join("panoscope/descriptions").join(name))
    }
}

/// Folders where an interpreter finds modules: the Python package, then those of the user.
fn python_path() -> Result<OsString, NoPython> {
    let mut path = package()?.into_os_string();
    if let Some(more) = std::env::var_os("PYTHONPATH").filter(|more| !more.is_empty()) {
        path.push(":");
        path.push(more);
    }
    Ok(path)
}

/// A command that runs a module of the Python package in the user's interpreter.
///
/// # Errors
/// There is no interpreter, or the installation has no Python package.
pub fn module(name: &str) -> Result<Command, NoPython> {
    let interpreter = user_interpreter();
    if !interpreter.is_file() {
        return Err(NoPython::Interpreter { interpreter });
    }
    let mut command = Command::new(interpreter);
    command.args(["-m", name]).env("PYTHONPATH", python_path()?);
    Ok(command)
}

/// The user's cache folder: `XDG_CACHE_HOME`, or `.cache` in the home folder. `None` without either.
pub fn cache_folder() -> Option<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|folder| folder.is_absolute());
    variable("XDG_CACHE_HOME").or_else(|| Some(variable("HOME")?.join(".cache")))
}

/// The folder with the Python package, for `PYTHONPATH`: next to the program, above it for tests, or in the `lib` of an
/// installation.
///
/// # Errors
/// The installation has none.
pub fn package() -> Result<PathBuf, NoPython> {
    let folder = panoscope_base::program::folder().unwrap_or_default();
    let places = [folder.join("python"), folder.join("../python"), folder.join("../lib/panoscope/python")];
    let is_package = |place: &&PathBuf| place.join("panoscope/__init__.py").is_file();
    match places.iter().find(is_package) {
        Some(place) => Ok(place.clone()),
        None => Err(NoPython::Package { folder: places[0].clone() }),
    }
}

/// Files of a folder that a Python plugin can import, in order.
fn code_in(folder: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> =
        files.filter(|file| file.extension().is_some_and(|ending| ending == "py" || ending == "so")).collect();
    files.sort();
    files
}

/// Reads the node types of a Python file without running it.
pub(crate) fn inspect(file: &Path) -> Result<(Note, Python), LoadError> {
    let unreadable = |cause| LoadError::Unreadable { file: file.to_owned(), cause };
    let nothing = || LoadError::NoNodes { file: file.to_owned() };
    if std::fs::metadata(file).map_err(unreadable)?.len() > MAX_BYTES {
        return Err(nothing());
    }
    let bytes = std::fs::read(file).map_err(unreadable)?;
    let text = String::from_utf8(bytes).map_err(|_| nothing())?;
    let node_types = node_types(&text);
    if node_types.is_empty() || !text.contains("panoscope") {
        return Err(nothing());
    }
    let declared = declared(&text).map_err(|cause| LoadError::NoPython { file: file.to_owned(), cause })?;
    let folder = file.parent().unwrap_or(Path::new(""));
    let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let (abi_major, abi_minor) = (abi::ABI_MAJOR, abi::ABI_MINOR);
    let note = Note { abi_major, abi_minor, name, version: String::new(), node_types };
    Ok((note, Python { interpreter: interpreter(folder, declared) }))
}

/// The interpreter that the file names, else that of an environment next to it, else the user's, else the system's.
fn interpreter(folder: &Path, declared: Option<String>) -> PathBuf {
    let beside = folder.join(".venv/bin/python");
    match declared {
        Some(declared) => folder.join(declared),
        None if beside.is_file() => beside,
        None => user_interpreter(),
    }
}

/// The interpreter that `PANOSCOPE_PYTHON` names, else the system's.
fn user_interpreter() -> PathBuf {
    match std::env::var_os(PYTHON_VARIABLE).filter(|program| !program.is_empty()) {
        Some(program) => program.into(),
        None => on_path("python3"),
    }
}

fn on_path(program: &str) -> PathBuf {
    let list = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&list).map(|folder| folder.join(program)).find(|file| file.is_file());
    found.unwrap_or_else(|| PathBuf::from("/usr/bin").join(program))
}

/// `python` of the table `[tool.panoscope]` in the script's metadata (PEP 723).
fn declared(text: &str) -> Result<Option<String>, NoPython> {
    let Some((_, rest)) = text.split_once("# /// script\n") else { return Ok(None) };
    let lines = rest.lines().take_while(|line| line.starts_with('#') && *line != "# ///");
    let block: String = lines.map(|line| format!("{}\n", line[1..].strip_prefix(' ').unwrap_or(&line[1..]))).collect();
    let metadata: Table =
        block.parse().map_err(|error: toml::de::Error| NoPython::Metadata { reason: error.message().to_owned() })?;
    let python = || metadata.get("tool")?.get("panoscope")?.get("python")?.as_str();
    Ok(python().map(str::to_owned))
}

/// Names of the node types of a file: of each class behind a decorator `@panoscope.node(...)`, under whatever name the
/// package was imported.
fn node_types(text: &str) -> Vec<String> {
    let mut names = Vec::new();
    let mut decorator: Option<String> = None;
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix('@') {
            let called = rest.split('(').next().unwrap_or("").trim_end();
            if called == "node" || called.ends_with(".node") {
                decorator = Some(String::new());
            }
        }
        let Some(collected) = &mut decorator else { continue };
        if let Some(rest) = line.strip_prefix("class ") {
            let class = rest.split(|c: char| !(c.is_alphanumeric() || c == '_')).next().unwrap_or("");
            names.push(name_in(collected).unwrap_or_else(|| snake_case(class)));
            decorator = None;
        } else {
            collected.push_str(line);
        }
    }
    names
}

/// The text of `name="..."` in the arguments of a decorator.
fn name_in(arguments: &str) -> Option<String> {
    let (before, rest) = arguments.split_once("name=")?;
    let is_word = before.ends_with(|c: char| c.is_alphanumeric() || c == '_');
    let quote = rest.chars().next().filter(|c| !is_word && matches!(c, '"' | '\''))?;
    rest[1..].split_once(quote).map(|(name, _)| name.to_owned())
}

/// Converts a class name as the package does: an underscore between a lower-case letter or digit and an upper-case
/// letter.
fn snake_case(class: &str) -> String {
    let mut name = String::new();
    let mut last = '_';
    for c in class.chars() {
        if c.is_ascii_uppercase() && (last.is_ascii_lowercase() || last.is_ascii_digit()) {
            name.push('_');
        }
        name.extend(c.to_lowercase());
        last = c;
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    const EDGES: &str = r#"# /// script
# requires-python = ">=3.9"
# [tool.panoscope]
# python = "env/bin/python"
# ///
import panoscope as ps
@ps.node(family="filter")
class EdgeMap2D:
    pass
@functools.cache
class Other:
    pass
@ps.node(
    family="sink",
    name="show_it",
)
class Shown:
    pass
"#;

    #[test]
    fn node_types_are_named_without_running_the_file() {
        assert_eq!(node_types(EDGES), ["edge_map2_d", "show_it"]);
        assert_eq!(node_types("@node()\nclass A: pass\n"), ["a"]);
        assert!(node_types("class A: pass\n# @ps.node()\n").is_empty());
    }

    #[test]
    fn the_interpreter_is_that_of_the_metadata() {
        assert_eq!(declared(EDGES), Ok(Some("env/bin/python".to_owned())));
        assert_eq!(declared("import panoscope\n"), Ok(None));
        assert!(matches!(declared("# /// script\n# a =\n# ///\n"), Err(NoPython::Metadata { .. })));
        assert_eq!(
            interpreter(Path::new("/plugins"), Some("env/bin/python".to_owned())),
            Path::new("/plugins/env/bin/python")
        );
    }
}
