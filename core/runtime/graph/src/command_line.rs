//! Arguments of a graph on a command line. The options that a graph declares (`--left X`) are rewritten to one option
//! that every program knows (`--graph-arg=left=X`) before the program parses its own.

use crate::args::{Arg, ArgKind};
use crate::options::GraphOptions;
use crate::text::GraphText;
use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::PathBuf;

/// The option that takes `NAME=VALUE`.
const OPTION: &str = "--graph-arg";

/// A command line whose options of graphs were rewritten.
#[derive(Clone, Debug, Default)]
pub struct CommandLine {
    /// Arguments for the program's own parser.
    pub words: Vec<OsString>,
    /// The arguments of the graph for the program's help; empty when it has none.
    pub help: String,
    /// Message about options that lack a value.
    pub problem: Option<String>,
}

/// Rewrites the arguments of a command line, of which the first is the program. Arguments that end in `.toml` are graph
/// files.
pub fn rewrite(words: Vec<OsString>) -> CommandLine {
    rewrite_except(words, &[])
}

/// The same, but options of these names (without `--`) stay: they are the command's own.
pub fn rewrite_except(words: Vec<OsString>, own: &[String]) -> CommandLine {
    let mut options = GraphOptions { allow_missing_args: true, ..GraphOptions::default() };
    let mut graphs = Vec::new();
    let mut before: Option<&str> = None;
    for word in words.iter().skip(1) {
        let Some(text) = word.to_str() else { continue };
        if let Some(file) = text.strip_prefix("--with=") {
            options.with.push(PathBuf::from(file));
        } else if before == Some("--with") {
            options.with.push(PathBuf::from(word));
        } else if text.ends_with(".toml") && !text.starts_with('-') {
            graphs.push(PathBuf::from(word));
        }
        before = Some(text);
    }
    let mut args: Vec<Arg> = Vec::new();
    let mut help = String::new();
    for graph in graphs {
        // A graph that cannot be read is reported by the command itself.
        let Ok(text) = GraphText::load_with(&graph, &options) else { continue };
        if !text.args().is_empty() {
            let _ = write!(help, "Arguments of {}:\n{}", graph.display(), table(text.args()));
        }
        let is_own = |arg: &Arg| own.iter().any(|name| *name == arg.option()[2..]);
        let new = text.args().iter().filter(|a| !is_own(a) && !args.iter().any(|known| known.name == a.name));
        args.extend(new.cloned().collect::<Vec<_>>());
    }
    let (words, problem) = replace(&args, words);
    CommandLine { words, help, problem }
}

fn replace(args: &[Arg], words: Vec<OsString>) -> (Vec<OsString>, Option<String>) {
    let mut out = Vec::with_capacity(words.len());
    let mut problem = None;
    let mut words = words.into_iter();
    while let Some(word) = words.next() {
        if word == "--" {
            out.push(word);
            out.extend(words.by_ref());
            break;
        }
        let text = word.to_str().and_then(|w| w.strip_prefix("--")).map(str::to_owned);
        let Some(text) = text else {
            out.push(word);
            continue;
        };
        let (name, value) = text.split_once('=').map_or((text.as_str(), None), |(name, value)| (name, Some(value)));
        let Some(arg) = args.iter().find(|a| a.option()[2..] == name.replace('_', "-")) else {
            out.push(word);
            continue;
        };
        let value = match (value, arg.kind) {
            (Some(value), _) => Some(OsString::from(value)),
            (None, ArgKind::Flag) => Some(OsString::from("true")),
            (None, _) => words.next(),
        };
        let Some(value) = value else {
            problem = Some(format!("{} needs a value: {} {}", arg.option(), arg.option(), arg.value_name()));
            break;
        };
        let mut whole = OsString::from(format!("{OPTION}={}=", arg.name));
        whole.push(value);
        out.push(whole);
    }
    (out, problem)
}

/// Options with their help, a line each.
fn table(args: &[Arg]) -> String {
    let left = |arg: &Arg| match arg.kind {
        ArgKind::Flag => arg.option(),
        _ => format!("{} <{}>", arg.option(), arg.value_name()),
    };
    let width = args.iter().map(|a| left(a).len()).max().unwrap_or(0);
    args.iter().map(|arg| format!("      {:<width$}  {}\n", left(arg), arg.help())).collect()
}

/// Graph options of a command line: the files of `--with`, the values of `--graph-arg`, and `node.param=value`
/// settings.
pub fn options(with: &[PathBuf], graph_args: &[String], settings: &[String]) -> GraphOptions {
    let args = graph_args.iter().map(|text| split(text)).collect();
    GraphOptions { with: with.to_vec(), args, set: settings.to_vec(), ..GraphOptions::default() }
}

/// `NAME=VALUE` of the option as a value of an argument.
fn split(text: &str) -> (String, String) {
    let (name, value) = text.split_once('=').unwrap_or((text, ""));
    (name.to_owned(), value.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_the_graph_are_rewritten_wherever_they_stand() {
        let arg = |name: &str, kind| Arg {
            name: name.to_owned(),
            kind,
            doc: String::new(),
            unit: String::new(),
            range: None,
            choices: Vec::new(),
            default: None,
        };
        let args = [arg("left", ArgKind::Source), arg("left_again", ArgKind::Flag)];
        let rewritten = |words: &str| {
            let (words, problem) = replace(&args, words.split(' ').map(OsString::from).collect());
            let words: Vec<String> = words.into_iter().map(|w| w.into_string().expect("UTF-8")).collect();
            (words.join(" "), problem)
        };
        let plain = |words: &str| rewritten(words).0;
        assert_eq!(plain("p run --left -1 g --frames 3"), "p run --graph-arg=left=-1 g --frames 3");
        assert_eq!(
            plain("p run g --left=a=b --left-again"),
            "p run g --graph-arg=left=a=b --graph-arg=left_again=true"
        );
        assert_eq!(plain("p run g --left_again=false --lefft x"), "p run g --graph-arg=left_again=false --lefft x");
        assert_eq!(plain("p run g -- --left x"), "p run g -- --left x");
        let problem = rewritten("p run g --left").1;
        assert_eq!(problem.as_deref(), Some("--left needs a value: --left SOURCE"));
    }
}
