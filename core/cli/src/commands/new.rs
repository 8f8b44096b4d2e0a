//! `panoscope new`.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::End;
use crate::terminal::{log, out};
use panoscope_host::loader::{graph_file, python_package};

/// Arguments of `new`.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Writes a plugin with one node that builds, passes its own test and runs.
    Plugin(Plugin),
}

#[derive(clap::Args)]
struct Plugin {
    /// Name of the plugin and of its node: lower-case letters, digits, `-` and `_`.
    name: String,
    /// In C instead of Rust.
    #[arg(long, conflicts_with = "python")]
    c: bool,
    /// In Python instead of Rust.
    #[arg(long)]
    python: bool,
    /// Folder to make; default: the plugin's name.
    #[arg(long, value_name = "FOLDER")]
    dir: Option<PathBuf>,
    /// Folder of Panoscope's own source, for `panoscope-node`; default: where this program was built, and without a
    /// source there the packaged crates.
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["c", "python"])]
    source: Option<PathBuf>,
}

const RUST: &[(&str, &str)] = &[
    ("Cargo.toml", include_str!("../../templates/rust/Cargo.toml")),
    ("README.md", include_str!("../../templates/rust/README.md")),
    (".gitignore", include_str!("../../templates/rust/gitignore")),
    ("{{name}}.toml", include_str!("../../templates/rust/NAME.toml")),
    ("src/lib.rs", include_str!("../../templates/rust/src/lib.rs")),
];

const C: &[(&str, &str)] = &[
    ("Makefile", include_str!("../../templates/c/Makefile")),
    ("README.md", include_str!("../../templates/c/README.md")),
    (".gitignore", include_str!("../../templates/c/gitignore")),
    ("{{name}}.c", include_str!("../../templates/c/NAME.c")),
    ("{{name}}.toml", include_str!("../../templates/c/NAME.toml")),
    ("test.c", include_str!("../../templates/c/test.c")),
    ("panoscope.h", include_str!("../../../contract/abi/panoscope.h")),
];

const PYTHON: &[(&str, &str)] = &[
    ("README.md", include_str!("../../templates/python/README.md")),
    (".gitignore", include_str!("../../templates/python/gitignore")),
    ("{{lib}}.py", include_str!("../../templates/python/NAME.py")),
    ("{{name}}.toml", include_str!("../../templates/python/NAME.toml")),
    ("test_{{lib}}.py", include_str!("../../templates/python/test_NAME.py")),
];

/// Names that are reserved by Rust or cargo.
const TAKEN: &[&str] = &[
    "abstract",
    "as",
    "async",
    "await",
    "become",
    "box",
    "break",
    "build",
    "const",
    "continue",
    "core",
    "crate",
    "deps",
    "do",
    "dyn",
    "else",
    "enum",
    "examples",
    "extern",
    "false",
    "final",
    "fn",
    "for",
    "gen",
    "if",
    "impl",
    "in",
    "incremental",
    "let",
    "loop",
    "macro",
    "match",
    "mod",
    "move",
    "mut",
    "override",
    "panoscope",
    "priv",
    "proc_macro",
    "pub",
    "ref",
    "return",
    "self",
    "static",
    "std",
    "alloc",
    "struct",
    "super",
    "test",
    "trait",
    "true",
    "try",
    "type",
    "typeof",
    "unsafe",
    "unsized",
    "use",
    "virtual",
    "where",
    "while",
    "yield",
];

/// Writes a new plugin.
pub fn run(arguments: &Arguments) -> Result<End> {
    let What::Plugin(plugin) = &arguments.what;
    match write(plugin) {
        Ok(folder) => {
            let build = match plugin.language() {
                Language::Rust => "cargo test && cargo build".to_owned(),
                Language::C => "make test && make".to_owned(),
                Language::Python => format!("PYTHONPATH={} python3 -m unittest", package()),
            };
            out!("made {}; next:", folder.display());
            out!("    cd {} && {build} && panoscope run {}.toml --frames 10", folder.display(), plugin.name);
            Ok(End::Done)
        }
        Err(error) => {
            log!("error: {error:#}");
            Ok(End::Wrong)
        }
    }
}

/// Language of a plugin.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Language {
    Rust,
    C,
    Python,
}

impl Language {
    /// Its files: names and texts, with placeholders in both.
    fn files(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Rust => RUST,
            Self::C => C,
            Self::Python => PYTHON,
        }
    }
}

impl Plugin {
    fn language(&self) -> Language {
        match (self.c, self.python) {
            (true, _) => Language::C,
            (false, true) => Language::Python,
            (false, false) => Language::Rust,
        }
    }
}

/// The folder for `PYTHONPATH` with the Python package.
fn package() -> String {
    python_package().map_or_else(|_| "FOLDER-OF-PANOSCOPE/python".to_owned(), |folder| folder.display().to_string())
}

fn check_name(name: &str) -> Result<()> {
    let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '-' | '_');
    if !name.starts_with(|c: char| c.is_ascii_lowercase()) || !name.chars().all(fits) || name.len() > 40 {
        bail!(
            "`{name}` is not a valid plugin name: use up to 40 lower-case letters, digits, `-` and `_`, beginning with a letter"
        );
    }
    if TAKEN.contains(&name) {
        bail!("`{name}` has a meaning in Rust or cargo; choose another name");
    }
    let loader = graph_file::all_plugins();
    if let Some(found) = loader.found().find(|f| f.note.name == name) {
        bail!("a plugin `{name}` already exists: {}", found.file.display());
    }
    let node = name.replace('-', "_");
    if let Some(found) = loader.offering(&node).first() {
        bail!("plugin `{}` already has a node type `{node}`", found.note.name);
    }
    Ok(())
}

/// The requirement of `panoscope-node` in a manifest: this version, from Panoscope's source where it is there.
fn node_dependency(source: Option<&Path>) -> Result<String> {
    let version = concat!("version = \"", env!("CARGO_PKG_VERSION"), "\"");
    let built_in = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = source.unwrap_or(&built_in).join("core/contract/node");
    if folder.join("Cargo.toml").is_file() {
        let folder = fs::canonicalize(&folder).with_context(|| folder.display().to_string())?;
        return Ok(format!("{version}, path = {folder:?}"));
    }
    if let Some(source) = source {
        bail!(
            "Panoscope's source is not at {}; leave --source out to build against its packaged crates",
            source.display()
        );
    }
    Ok(version.to_owned())
}

fn write(plugin: &Plugin) -> Result<PathBuf> {
    let name = plugin.name.as_str();
    check_name(name)?;
    let folder = plugin.dir.clone().unwrap_or_else(|| PathBuf::from(name));
    if folder.exists() {
        bail!("{} already exists; remove it, or choose another folder with --dir", folder.display());
    }
    let language = plugin.language();
    let dependency = match language {
        Language::Rust => node_dependency(plugin.source.as_deref())?,
        Language::C | Language::Python => String::new(),
    };
    let node = name.replace('-', "_");
    let fill = |text: &str| {
        [
            ("name", name),
            ("node", &node),
            ("lib", &node),
            ("panoscope_include", "."),
            ("panoscope_node_dependency", &dependency),
            ("package", &package()),
        ]
        .iter()
        .fold(text.to_owned(), |text, (key, value)| text.replace(&format!("{{{{{key}}}}}"), value))
    };
    for (file, text) in language.files() {
        let path = folder.join(fill(file));
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
        }
        fs::write(&path, fill(text)).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_names_are_refused() {
        for name in ["", "Edge", "9lives", "-a", "a b", "../up", "fn", "core", &"x".repeat(41)] {
            assert!(check_name(name).is_err(), "{name}");
        }
        assert!(check_name("edge_filter_2").is_ok());
    }

    #[test]
    fn a_plugin_names_the_version_of_its_crate_and_the_source_if_it_is_there() {
        let version = format!("version = {:?}", env!("CARGO_PKG_VERSION"));
        let here = node_dependency(None).unwrap();
        assert!(here.starts_with(&version) && here.contains("core/contract/node"), "{here}");
        let error = node_dependency(Some(Path::new("/nowhere"))).unwrap_err().to_string();
        assert!(error.contains("source is not at /nowhere"), "{error}");
    }

    #[test]
    fn no_placeholder_is_left_and_nothing_is_overwritten() {
        let folder = std::env::temp_dir().join(format!("panoscope_new_{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        for (c, python) in [(false, false), (true, false), (false, true)] {
            let dir = folder.join(format!("{c}-{python}"));
            let plugin = Plugin { name: "fresh-node".to_owned(), c, python, dir: Some(dir.clone()), source: None };
            write(&plugin).unwrap();
            for (file, _) in plugin.language().files() {
                let path = dir.join(file.replace("{{name}}", "fresh-node").replace("{{lib}}", "fresh_node"));
                let text = fs::read_to_string(&path).unwrap();
                assert!(!text.contains("{{"), "{}", path.display());
            }
            let again = write(&plugin).unwrap_err().to_string();
            assert!(again.contains("already exists"), "{again}");
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
