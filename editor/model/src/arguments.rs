//! Arguments and overlays of a graph as a form asks for them, and the values that were given last.

use std::collections::BTreeMap;
use std::fs::Permissions;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use panoscope_base::files;
use panoscope_graph::{Arg, ArgKind, GraphOptions, GraphText, check};
use panoscope_host::loader::Loader;
use serde::{Deserialize, Serialize};

use crate::folding::opening;

/// The file with remembered values.
const FILE: &str = "arguments.toml";

/// An overlay that fits a graph.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Overlay {
    /// Its file.
    pub path: PathBuf,
    /// Name of the file without its ending.
    pub name: String,
    /// The comment at its beginning.
    pub doc: String,
}

/// A form for the arguments and overlays of a graph.
#[derive(Clone, Debug)]
pub struct Form {
    graph: PathBuf,
    text: String,
    texts: BTreeMap<PathBuf, String>,
    /// Arguments of the graph with the chosen overlays.
    pub args: Vec<Arg>,
    /// Arguments that need a value: those without a default that the graph uses.
    pub required: Vec<String>,
    /// Values by argument, as on a command line; the default holds where there is none.
    pub values: BTreeMap<String, String>,
    /// Chosen overlays.
    pub with: Vec<PathBuf>,
    /// Overlays that can be chosen.
    pub overlays: Vec<Overlay>,
    /// Cameras of this machine: device and name.
    pub devices: Vec<(String, String)>,
    /// What is wrong with the values, after they were applied without success.
    pub problems: Vec<String>,
}

impl Form {
    /// A form for the graph `text`, which lies at `graph`, with the values of `given`. The loader's plugins tell which overlays fit.
    pub fn new(graph: &Path, text: &str, given: &GraphOptions, loader: &Loader) -> Self {
        let mut form = Self::with_overlays(graph, text, given, Vec::new());
        form.overlays = form.find_overlays(loader);
        form
    }

    /// As [`Self::new`], with overlays that are known to fit: it loads no plugin.
    pub fn with_overlays(graph: &Path, text: &str, given: &GraphOptions, overlays: Vec<Overlay>) -> Self {
        let values = given.args.iter().cloned().collect();
        let mut form = Self {
            graph: graph.to_owned(),
            text: text.to_owned(),
            texts: given.texts.clone(),
            args: Vec::new(),
            required: Vec::new(),
            values,
            with: given.with.clone(),
            overlays,
            devices: devices(Path::new("/sys/class/video4linux")),
            problems: Vec::new(),
        };
        form.refresh();
        form
    }

    /// Takes values that were remembered where nothing else is given.
    pub fn recall(&mut self, remembered: GraphOptions) {
        if self.with.is_empty() {
            self.with = remembered.with;
        }
        for (name, value) in remembered.args {
            self.values.entry(name).or_insert(value);
        }
        self.refresh();
    }

    fn options(&self, with: &[PathBuf], allow_missing_args: bool) -> GraphOptions {
        let known = |name: &str| self.args.iter().any(|arg| arg.name == name);
        let args = self.values.iter().filter(|(name, value)| known(name) && !value.is_empty());
        let args = args.map(|(name, value)| (name.clone(), value.clone())).collect();
        let (with, texts) = (with.to_vec(), self.texts.clone());
        GraphOptions { with, args, texts, allow_missing_args, ..GraphOptions::default() }
    }

    /// Arguments follow the chosen overlays.
    pub fn refresh(&mut self) {
        let options = GraphOptions { args: Vec::new(), ..self.options(&self.with, true) };
        let parsed = GraphText::parse_with(&self.graph, &self.text, &options);
        self.args = parsed.args().to_vec();
        self.required = parsed.missing_args().into_iter().map(str::to_owned).collect();
        self.problems.clear();
    }

    /// Chooses one of [`Self::overlays`], or with `None` the sources that the graph has. They stand for each other, so any other of them is taken
    /// back; overlays that are not among them stay.
    pub fn choose(&mut self, overlay: Option<&Path>) {
        let offered: Vec<PathBuf> = self.overlays.iter().map(|overlay| whole(&overlay.path)).collect();
        self.with.retain(|path| !offered.contains(&whole(path)));
        self.with.extend(overlay.map(Path::to_owned));
        self.refresh();
    }

    /// The offered overlay that is chosen.
    pub fn chosen(&self) -> Option<&Overlay> {
        let with: Vec<PathBuf> = self.with.iter().map(|path| whole(path)).collect();
        self.overlays.iter().find(|overlay| with.contains(&whole(&overlay.path)))
    }

    /// Whether there is nothing to ask for.
    pub fn is_empty(&self) -> bool {
        self.args.is_empty() && self.overlays.is_empty()
    }

    /// Puts files into the arguments that take files and have no value yet; returns those that found none.
    pub fn drop_files(&mut self, files: Vec<PathBuf>) -> Vec<PathBuf> {
        let mut left = Vec::new();
        for file in files {
            let calibration = file.extension().is_some_and(|e| ["yml", "yaml", "xml", "json"].iter().any(|k| e == *k));
            let takes = |arg: &&Arg| match arg.kind {
                ArgKind::Source => !calibration,
                ArgKind::File => calibration,
                ArgKind::Path => true,
                _ => false,
            };
            let free = |arg: &&Arg| self.values.get(&arg.name).is_none_or(String::is_empty);
            match self.args.iter().filter(takes).find(free) {
                Some(arg) => _ = self.values.insert(arg.name.clone(), file.display().to_string()),
                None => left.push(file),
            }
        }
        left
    }

    /// The overlays and values, once they are right.
    ///
    /// # Errors
    /// What is wrong with them, also in [`Self::problems`].
    pub fn finish(&mut self) -> Result<GraphOptions, Vec<String>> {
        let options = self.options(&self.with, false);
        let parsed = GraphText::parse_with(&self.graph, &self.text, &options);
        let is_arg = |code: &str| code.starts_with("arg-") || code.starts_with("overlay-") || code == "missing-file";
        let wrong = parsed.diagnostics().iter().filter(|d| is_arg(d.code));
        let mut problems: Vec<String> = wrong.map(|d| sentence(&d.message, &d.help)).collect();
        let missing = parsed.missing_args();
        problems.extend(missing.iter().map(|name| format!("`{name}` needs a value")));
        self.problems.clone_from(&problems);
        match problems.is_empty() {
            true => Ok(GraphOptions { texts: BTreeMap::new(), ..options }),
            false => Err(problems),
        }
    }

    /// The overlays in `sources/` beside the graph with which it has no mistakes.
    fn find_overlays(&self, loader: &Loader) -> Vec<Overlay> {
        let folder = self.graph.parent().unwrap_or(Path::new("")).join("sources");
        let files = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let mut files: Vec<PathBuf> = files.filter(|path| path.extension().is_some_and(|e| e == "toml")).collect();
        files.sort();
        let fits = |path: &PathBuf| {
            let options = GraphOptions { args: Vec::new(), ..self.options(std::slice::from_ref(path), true) };
            let parsed = GraphText::parse_with(&self.graph, &self.text, &options);
            !check(&parsed, &loader.catalog_of(&parsed)).diagnostics.has_errors()
        };
        let overlay = |path: PathBuf| {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let doc = opening(&std::fs::read_to_string(&path).unwrap_or_default());
            Overlay { path, name, doc }
        };
        files.into_iter().filter(fits).map(overlay).collect()
    }
}

fn whole(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

fn sentence(message: &str, help: &str) -> String {
    if help.is_empty() { message.to_owned() } else { format!("{message}: {help}") }
}

/// Cameras in a folder such as `/sys/class/video4linux`: device and name, by number.
fn devices(folder: &Path) -> Vec<(String, String)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<(u32, String)> = entries
        .filter_map(|entry| {
            let number = entry.file_name().to_str()?.strip_prefix("video")?.parse().ok()?;
            let name = std::fs::read_to_string(entry.path().join("name")).unwrap_or_default();
            Some((number, name.trim().to_owned()))
        })
        .collect();
    found.sort();
    found.into_iter().map(|(number, name)| (format!("/dev/video{number}"), name)).collect()
}

/// The user's folder for settings: `$XDG_CONFIG_HOME/panoscope`, or `~/.config/panoscope`.
pub fn config_folder() -> Option<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let base = absolute("XDG_CONFIG_HOME").or_else(|| Some(absolute("HOME")?.join(".config")));
    base.map(|base| base.join("panoscope"))
}

pub(crate) fn key(graph: &Path) -> String {
    let whole = std::fs::canonicalize(graph).or_else(|_| std::path::absolute(graph));
    whole.unwrap_or_else(|_| graph.to_owned()).display().to_string()
}

fn read(folder: &Path) -> toml::Table {
    std::fs::read_to_string(folder.join(FILE)).ok().and_then(|text| text.parse().ok()).unwrap_or_default()
}

/// The overlays and values that a graph was given last.
pub fn recall(folder: &Path, graph: &Path) -> Option<GraphOptions> {
    let entry = read(folder).remove(&key(graph))?;
    let with = entry.get("with").and_then(toml::Value::as_array);
    let with = with.into_iter().flatten().filter_map(toml::Value::as_str).map(PathBuf::from).collect();
    let args = entry.get("args").and_then(toml::Value::as_table);
    let args =
        args.into_iter().flatten().filter_map(|(name, v)| Some((name.clone(), v.as_str()?.to_owned()))).collect();
    Some(GraphOptions { with, args, ..GraphOptions::default() })
}

/// Remembers the overlays and values of a graph. Other graphs keep theirs.
///
/// # Errors
/// The file cannot be written.
pub fn remember(folder: &Path, graph: &Path, given: &GraphOptions) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let mut all = read(folder);
    let with: Vec<String> = given.with.iter().map(|path| key(path)).collect();
    let args: toml::Table = given.args.iter().map(|(name, value)| (name.clone(), value.as_str().into())).collect();
    let mut entry = toml::Table::new();
    entry.insert("with".to_owned(), with.into());
    entry.insert("args".to_owned(), args.into());
    all.insert(key(graph), entry.into());
    // An address may hold a password.
    let mode = Some(Permissions::from_mode(0o600));
    files::replace_with(&folder.join(FILE), mode, |file| file.write_all(all.to_string().as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("panoscope_arguments_{name}_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(folder.join("sources")).expect("a folder");
        folder
    }

    const GRAPH: &str = "[args.left]\ntype = \"source\"\n\n[args.rate]\ntype = \"number\"\nrange = [1, 60]\ndefault = 30\n\n\
                         [args.scope]\ntype = \"file\"\n\n\
                         [nodes.views]\ntype = \"capture\"\n\
                         params = { left = { arg = \"left\" }, calibration = { arg = \"scope\" }, rate_hz = { arg = \"rate\" } }\n";

    #[test]
    fn a_form_asks_for_what_is_missing_and_says_what_is_wrong() {
        let folder = folder("form");
        let mut form = Form::new(&folder.join("g.toml"), GRAPH, &GraphOptions::default(), &Loader::default());
        assert_eq!(form.args.len(), 3);
        assert_eq!(form.finish(), Err(vec!["`left` needs a value".to_owned(), "`scope` needs a value".to_owned()]));
        form.values.insert("rate".to_owned(), "99".to_owned());
        let calibration = folder.join("scope.yml");
        let left = form.drop_files(vec![calibration.clone(), folder.join("l.mp4"), folder.join("r.mp4")]);
        assert_eq!(left, [folder.join("r.mp4")]);
        let problems = form.finish().expect_err("no such file, and out of range");
        assert!(problems.iter().any(|p| p.contains("does not exist")), "{problems:?}");
        assert!(problems.iter().any(|p| p.contains("it must be 1 to 60")), "{problems:?}");
        std::fs::write(&calibration, "").expect("written");
        form.values.insert("rate".to_owned(), "25".to_owned());
        let given = form.finish().expect("right");
        assert_eq!(given.args.len(), 3);
        remember(&folder, &folder.join("g.toml"), &given).expect("written");
        remember(&folder, &folder.join("other.toml"), &GraphOptions::default()).expect("written");
        assert_eq!(recall(&folder, &folder.join("g.toml")), Some(given.clone()));
        assert_eq!(recall(&folder, &folder.join("third.toml")), None);
        let mode = std::fs::metadata(folder.join(FILE)).expect("written").permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "an address may hold a password");
        let mut again = Form::new(&folder.join("g.toml"), GRAPH, &GraphOptions::default(), &Loader::default());
        again.values.insert("rate".to_owned(), "12".to_owned());
        again.recall(given);
        assert_eq!(again.values["rate"], "12", "a given value wins over a remembered one");
        assert_eq!(again.values["left"], folder.join("l.mp4").display().to_string());
        std::fs::remove_dir_all(folder).expect("removed");
    }

    #[test]
    fn overlays_that_do_not_fit_are_not_offered() {
        let folder = folder("overlays");
        std::fs::write(folder.join("sources/good.toml"), "# Fine.\n[args.rate]\ndefault = 10\n").expect("written");
        std::fs::write(folder.join("sources/bad.toml"), "[args.speed]\ndefault = 10\n").expect("written");
        let text = "[args.rate]\ntype = \"number\"\ndefault = 30\n[nodes.p]\ngraph = \"p.toml\"\n";
        std::fs::write(folder.join("p.toml"), "[part]\n").expect("written");
        let mut form = Form::new(&folder.join("g.toml"), text, &GraphOptions::default(), &Loader::default());
        let names: Vec<(&str, &str)> = form.overlays.iter().map(|o| (o.name.as_str(), o.doc.as_str())).collect();
        assert_eq!(names, [("good", "Fine.")]);
        let overlay = form.overlays[0].path.clone();
        let own = folder.join("mine.toml");
        std::fs::write(&own, "[args.rate]\ndefault = 20\n").expect("written");
        form.with.push(own.clone());
        form.choose(Some(&overlay));
        assert_eq!(form.args[0].default.as_deref(), Some("10"));
        assert_eq!(form.finish().expect("right").with, [own.clone(), overlay.clone()]);
        assert_eq!(form.chosen().map(|overlay| overlay.name.as_str()), Some("good"));
        // One of those that are offered at a time.
        std::fs::write(folder.join("sources/better.toml"), "[args.rate]\ndefault = 12\n").expect("written");
        let mut form = Form::new(&folder.join("g.toml"), text, &GraphOptions::default(), &Loader::default());
        assert_eq!(form.overlays.len(), 2);
        form.choose(Some(&overlay));
        let other = form.overlays.iter().find(|o| o.name == "better").expect("offered").path.clone();
        form.choose(Some(&other));
        assert_eq!(form.with, [other]);
        form.choose(None);
        assert!(form.with.is_empty() && form.chosen().is_none());
        std::fs::remove_dir_all(folder).expect("removed");
    }

    #[test]
    fn cameras_are_listed_by_number() {
        let folder = folder("devices");
        for (device, name) in [("video10", "Scope right\n"), ("video2", "Scope left\n"), ("media0", "")] {
            std::fs::create_dir_all(folder.join(device)).expect("a folder");
            std::fs::write(folder.join(device).join("name"), name).expect("written");
        }
        let expected = [("/dev/video2", "Scope left"), ("/dev/video10", "Scope right")];
        assert_eq!(devices(&folder), expected.map(|(d, n)| (d.to_owned(), n.to_owned())));
        std::fs::remove_dir_all(folder).expect("removed");
    }
}
