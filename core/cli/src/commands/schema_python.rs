//! Node types as methods of a class in Python, for completion and type checkers.

use std::fmt::Write as _;

use panoscope_graph::{Catalog, NodeType, Param, ParamKind, Pick, Port};

/// Python keywords, which cannot be argument names.
const KEYWORDS: [&str; 35] = [
    "False", "None", "True", "and", "as", "assert", "async", "await", "break", "class", "continue", "def", "del",
    "elif", "else", "except", "finally", "for", "from", "global", "if", "import", "in", "is", "lambda", "nonlocal",
    "not", "or", "pass", "raise", "return", "try", "while", "with", "yield",
];
/// Arguments that every node type has.
const OPTIONS: [&str; 7] = ["id", "on_fault", "budget_ms", "max_rate_hz", "cpu", "isolate", "on"];

const HEAD: &str = "\
# Written by `panoscope schema --python`: the node types of the plugins of one machine.

from typing import Any, Literal, Union

from typing_extensions import Unpack

from .building import Arg, File, Flag, Input, Inputs, Node, NodeOptions, Number, Numbers, Output, Text, Whole

";

/// The stub `catalogue.pyi` of the Python package: a class with a method for each node type whose name no other plugin
/// has, and a class of the outputs of each.
pub fn stub(catalog: &Catalog) -> String {
    let mut types: Vec<&NodeType> = catalog.node_types.iter().filter(|t| catalog.find(&t.name).len() == 1).collect();
    types.sort_by(|a, b| a.name.cmp(&b.name));
    let mut out = HEAD.to_owned();
    for node_type in types.iter().filter(|t| !t.outputs.is_empty()) {
        let _ = writeln!(out, "class {}(Node):", class(node_type));
        for port in &node_type.outputs {
            let _ = writeln!(out, "    {}: Output[{}]\n    {}", named(&port.name), packet(port), doc(&port.doc, 4));
        }
        out.push('\n');
    }
    out.push_str("class NodeTypes:\n");
    for node_type in types {
        method(&mut out, node_type);
    }
    out
}

/// A name, with a trailing `_` if it is a Python keyword.
fn named(name: &str) -> String {
    if KEYWORDS.contains(&name) { format!("{name}_") } else { name.to_owned() }
}

/// `stereo_bm` as `StereoBm`.
fn class(node_type: &NodeType) -> String {
    let capitals = |word: &str| word[..1].to_uppercase() + &word[1..];
    node_type.name.split('_').filter(|word| !word.is_empty()).map(capitals).collect()
}

fn packet(port: &Port) -> String {
    if port.packet.name == "any" { "Any".to_owned() } else { format!("Literal[\"{}\"]", port.packet.name) }
}

/// A text of one or more lines as a documentation string.
fn doc(text: &str, indent: usize) -> String {
    let text = text.trim().replace('\\', "\\\\").replace("\"\"\"", "'''");
    let text = if text.ends_with('"') { format!("{text} ") } else { text };
    let lines: Vec<&str> = text.lines().map(str::trim_end).collect();
    let rest = lines[1.min(lines.len())..].iter().map(|line| match line.is_empty() {
        true => "\n".to_owned(),
        false => format!("\n{:indent$}{line}", ""),
    });
    format!("\"\"\"{}{}\"\"\"", lines.first().unwrap_or(&""), rest.collect::<String>())
}

fn method(out: &mut String, node_type: &NodeType) {
    let mut inputs: Vec<&Port> = node_type.inputs.iter().collect();
    // Those that may be left out stand behind the others, as in `NodeMaker`.
    inputs.sort_by_key(|port| port.optional);
    let _ = writeln!(out, "    def {}(\n        self,", named(&node_type.name));
    for port in &inputs {
        let kind = if port.list { "Inputs" } else { "Input" };
        let default = if port.optional { " | None = None" } else { "" };
        let _ = writeln!(out, "        {}: {kind}[{}]{default},", port.name, packet(port));
    }
    out.push_str("        *,\n");
    for param in &node_type.params {
        let _ = writeln!(out, "        {}: {} = ...,", argument(param, &inputs), value(param));
    }
    let returned = if node_type.outputs.is_empty() { "Node".to_owned() } else { class(node_type) };
    let _ =
        writeln!(out, "        id: str | None = None,\n        **options: Unpack[NodeOptions],\n    ) -> {returned}:");
    let mut about = node_type.doc.lines().next().unwrap_or("").to_owned();
    if !node_type.params.is_empty() || !inputs.is_empty() {
        about.push('\n');
    }
    for port in &inputs {
        let _ = write!(about, "\n{}: {}", port.name, words(&port.doc));
    }
    for param in &node_type.params {
        let _ = write!(about, "\n{}: {}{}", argument(param, &inputs), words(&param.doc), limits(param));
    }
    let _ = writeln!(out, "        {}\n", doc(&about, 8));
}

fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The argument for a parameter: its name, with a trailing `_` if Python, an input or an option uses that name.
fn argument(param: &Param, inputs: &[&Port]) -> String {
    let name = param.name.as_str();
    let is_taken = KEYWORDS.contains(&name) || OPTIONS.contains(&name) || inputs.iter().any(|port| port.name == name);
    if is_taken { format!("{name}_") } else { name.to_owned() }
}

fn value(param: &Param) -> String {
    match &param.kind {
        ParamKind::Bool { .. } => "Flag".to_owned(),
        ParamKind::Int { .. } => "Whole".to_owned(),
        ParamKind::Float { .. } => "Number".to_owned(),
        ParamKind::Choice { choices, .. } => {
            let choices: Vec<String> = choices.iter().map(|choice| format!("\"{choice}\"")).collect();
            format!("Union[Literal[{}], Arg]", choices.join(", "))
        }
        ParamKind::Text { .. } if param.pick == Pick::File => "File".to_owned(),
        ParamKind::Text { .. } => "Text".to_owned(),
        ParamKind::Path { .. } => "File".to_owned(),
        ParamKind::Floats { .. } => "Numbers".to_owned(),
    }
}

/// Range, unit and default, as ` (16 to 256 px; default 64)`.
fn limits(param: &Param) -> String {
    let range = |min: Option<String>, max: Option<String>| match (min, max) {
        (Some(min), Some(max)) => format!("{min} to {max}"),
        (Some(min), None) => format!("at least {min}"),
        (None, Some(max)) => format!("at most {max}"),
        (None, None) => String::new(),
    };
    let (limits, default) = match &param.kind {
        ParamKind::Bool { default } => (String::new(), if *default { "True" } else { "False" }.to_owned()),
        ParamKind::Int { default, min, max, .. } => {
            (range(min.map(|n| n.to_string()), max.map(|n| n.to_string())), default.to_string())
        }
        ParamKind::Float { default, min, max, .. } => {
            (range(min.map(|n| n.to_string()), max.map(|n| n.to_string())), default.to_string())
        }
        ParamKind::Choice { default, .. } => (String::new(), format!("\"{default}\"")),
        ParamKind::Text { default } | ParamKind::Path { default, .. } => (String::new(), format!("{default:?}")),
        ParamKind::Floats { default, .. } => (String::new(), format!("{default:?}")),
    };
    let facts = [format!("{limits} {}", param.unit).trim().to_owned(), format!("default {default}")];
    let facts: Vec<String> = facts.into_iter().filter(|fact| !fact.is_empty()).collect();
    format!(" ({})", facts.join("; "))
}
