//! `panoscope describe`.

use std::path::Path;

use anyhow::Result;
use panoscope_graph::{NodeKind, NodeType, Param, ParamKind, Port};
use panoscope_host::loader::{Loader, graph_file};

use crate::End;
use crate::commands::describe_model;
use crate::terminal::{log, out};

/// Arguments of `describe`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Node type, or `plugin/type` if two plugins offer the name; or an ONNX file, to show its inputs and outputs and a
    /// graph that runs it.
    #[arg(value_name = "NODE_TYPE")]
    node_type: String,
    /// As JSON: a list with one entry per plugin that offers it; of an ONNX file one object.
    #[arg(long)]
    json: bool,
}

/// Shows a node type, or a model. Loads only the plugins that offer the type.
pub fn run(arguments: &Arguments) -> Result<End> {
    if describe_model::is_model(&arguments.node_type) {
        return describe_model::run(Path::new(&arguments.node_type), arguments.json);
    }
    let loader = graph_file::all_plugins();
    let (plugin, name) = match arguments.node_type.split_once('/') {
        Some((plugin, name)) => (Some(plugin), name),
        None => (None, arguments.node_type.as_str()),
    };
    let offering = loader.offering(name);
    let plugins: Vec<&str> =
        offering.iter().map(|f| f.note.name.as_str()).filter(|p| plugin.is_none_or(|only| only == *p)).collect();
    if plugins.is_empty() {
        return Ok(unknown(&loader, plugin, name));
    }
    let mut types = Vec::new();
    for plugin in plugins {
        match loader.load(plugin) {
            Ok(loaded) => types.extend(loaded.node_types.into_iter().filter(|t| t.name == name)),
            Err(problem) => {
                log!("error: {}", problem.message);
                if !problem.help.is_empty() {
                    log!("    help: {}", problem.help);
                }
                return Ok(End::Wrong);
            }
        }
    }
    if arguments.json {
        out!("{}", serde_json::to_string_pretty(&types)?);
    } else {
        types.iter().for_each(show);
    }
    Ok(End::Done)
}

fn unknown(loader: &Loader, plugin: Option<&str>, name: &str) -> End {
    match plugin {
        Some(plugin) => log!("error: no plugin `{plugin}` with a node type `{name}` was found"),
        None => log!("error: no plugin offers a node type `{name}`"),
    }
    let types: Vec<&str> = loader.found().flat_map(|f| f.note.node_types.iter().map(String::as_str)).collect();
    // As far from the name as the graph checker allows: a third of the letters.
    let distance = |other: &str| strsim::damerau_levenshtein(name, other);
    let close = |other: &&str| distance(other) <= (name.chars().count() / 3).max(1) || other.contains(name);
    match types.iter().copied().filter(close).min_by_key(|other| distance(other)) {
        Some(nearest) => log!("    help: did you mean `{nearest}`?"),
        None => log!("    help: `panoscope list` shows what there is"),
    }
    End::Wrong
}

fn show(node_type: &NodeType) {
    let kind = match node_type.kind {
        NodeKind::Compute => "compute",
        NodeKind::Blocking => "blocking",
        NodeKind::Realtime => "realtime",
    };
    let mut traits = vec![kind];
    for (is, word) in [
        (node_type.source, "source"),
        (node_type.exclusive, "exclusive"),
        (node_type.side_effects, "acts outside the graph"),
    ] {
        if is {
            traits.push(word);
        }
    }
    out!("{} (plugin {}, {}; {})", node_type.name, node_type.plugin, node_type.family, traits.join(", "));
    paragraph(2, &node_type.doc);
    ports("inputs", &node_type.inputs);
    ports("outputs", &node_type.outputs);
    if !node_type.params.is_empty() {
        out!("");
        out!("params");
    }
    for param in &node_type.params {
        show_param(param);
    }
}

fn paragraph(indent: usize, text: &str) {
    for line in text.lines() {
        out!("{:indent$}{}", "", line.trim_end());
    }
}

fn ports(title: &str, ports: &[Port]) {
    if ports.is_empty() {
        return;
    }
    out!("");
    out!("{title}");
    for port in ports {
        let mut about = port.packet.name.clone();
        if !port.packet.formats.is_empty() {
            about.push_str(&format!(" ({})", port.packet.formats.join(", ")));
        }
        if port.list {
            about.push_str(", a list");
        }
        if port.optional {
            about.push_str(", optional");
        }
        out!("  {}: {about}", port.name);
        paragraph(6, &port.doc);
    }
}

fn range(min: Option<String>, max: Option<String>) -> Option<String> {
    match (min, max) {
        (Some(min), Some(max)) => Some(format!("{min} to {max}")),
        (Some(min), None) => Some(format!("at least {min}")),
        (None, Some(max)) => Some(format!("at most {max}")),
        (None, None) => None,
    }
}

fn show_param(param: &Param) {
    let text = |n: &dyn std::fmt::Display| n.to_string();
    let (default, limits) = match &param.kind {
        ParamKind::Bool { default } => (default.to_string(), None),
        ParamKind::Int { default, min, max, step } => {
            let mut limits = range(min.as_ref().map(|n| text(n)), max.as_ref().map(|n| text(n)));
            if let (Some(limits), Some(step)) = (&mut limits, step.filter(|&s| s > 1)) {
                limits.push_str(&format!(" in steps of {step}"));
            }
            (default.to_string(), limits)
        }
        ParamKind::Float { default, min, max, .. } => {
            (default.to_string(), range(min.as_ref().map(|n| text(n)), max.as_ref().map(|n| text(n))))
        }
        ParamKind::Choice { default, choices } => (format!("{default:?}"), Some(choices.join(", "))),
        ParamKind::Text { default } => (format!("{default:?}"), None),
        ParamKind::Path { default, must_exist } => {
            let about = [
                (*must_exist, "must exist"),
                (param.writes, "is written"),
                (param.shipped, "the default comes with the plugin"),
            ];
            let words: Vec<&str> = about.iter().filter(|(is, _)| *is).map(|(_, words)| *words).collect();
            (format!("{default:?}"), (!words.is_empty()).then(|| words.join("; ")))
        }
        ParamKind::Floats { default, min_len, max_len } => {
            let count = range(Some(min_len.to_string()), max_len.map(|n| n.to_string()));
            (format!("{default:?}"), count.map(|c| format!("{c} numbers")))
        }
    };
    let unit = if param.unit.is_empty() { String::new() } else { format!(" {}", param.unit) };
    let limits = limits.map_or_else(String::new, |l| format!(" ({l})"));
    let reopen = if param.reopen { "; a change opens the node again" } else { "" };
    let pick = match param.pick.words() {
        words if words.is_empty() || matches!(param.kind, ParamKind::Path { .. }) => String::new(),
        words => format!("; {words}"),
    };
    out!("  {} = {default}{unit}{limits}: {}{pick}{reopen}", param.name, param.kind.expected());
    paragraph(6, &param.doc);
}
