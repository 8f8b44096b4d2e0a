//! Plugins and node types.

use super::Checker;
use crate::file::NodeText;
use crate::nearest::{list, nearest};
use crate::value::Spanned;
use std::collections::{HashMap, HashSet};

/// Help when no plugin is found at all, as after a plain `cargo build`, which leaves none in the search path.
const NO_PLUGIN_AT_ALL: &str = "no plugin was found at all
plugins are looked for in `plugins` beside the program, in the folders that PANOSCOPE_PLUGIN_PATH names and in the graph's `plugin_paths`
`cargo build` does not put them there: run `cargo xtask build`, or `cargo xtask install DIR` for a folder that works without cargo";

impl<'a> Checker<'a> {
    pub(super) fn plugins(&mut self) {
        for (file, plugins) in &self.text.flat.plugins {
            self.plugins_of(*file, plugins);
        }
    }

    /// The plugins that one file lists.
    fn plugins_of(&mut self, file: usize, plugins: &'a [Spanned<String>]) {
        let mut seen: HashMap<&str, &std::ops::Range<usize>> = HashMap::new();
        let known: Vec<&str> = self.known_plugins();
        for plugin in plugins {
            let name = plugin.value.as_str();
            if let Some(first) = seen.get(name) {
                let sources = &self.text.sources;
                self.warning("duplicate-plugin", &plugin.span, format!("plugin `{name}` is listed twice"))
                    .help("remove one of the two")
                    .note(sources, first, "first here");
                continue;
            }
            seen.insert(name, &plugin.span);
            let is_first = seen.len() == 1;
            let passed_over = self.catalog.passed_over.iter();
            for problem in passed_over.filter(|p| p.plugin == name || (p.plugin.is_empty() && is_first)) {
                self.warning("plugin-passed-over", &plugin.span, problem.message.clone()).help(problem.help.clone());
            }
            if let Some(problem) = self.catalog.problem(name) {
                let mut message = format!("plugin `{name}` cannot be used: {}", problem.message);
                if !problem.file.is_empty() {
                    message.push_str(&format!(" ({})", problem.file));
                }
                self.error("plugin-unusable", &plugin.span, message).help(problem.help.clone());
            } else if !self.catalog.has_plugin(name) {
                let catalog = self.catalog;
                let offers = catalog.node_types.iter().find(|t| t.name == name).map(|t| t.plugin.as_str());
                let near = nearest(name, known.iter().copied());
                let label = match (near, offers) {
                    (_, Some(plugin)) => format!("a node type of plugin `{plugin}`, not a plugin"),
                    (Some(near), None) => format!("did you mean \"{near}\"?"),
                    (None, None) => String::new(),
                };
                let mut help = match offers {
                    Some(plugin) => format!("write \"{plugin}\""),
                    // Said once: it holds for all of them.
                    None if known.is_empty() && seen.len() > 1 => String::new(),
                    None if known.is_empty() => NO_PLUGIN_AT_ALL.to_owned(),
                    None => format!("plugins found: {}", list(known.iter().copied(), 12, "and")),
                };
                if offers.is_none() && near.is_none() && !known.is_empty() {
                    help.push_str("\nplugins are looked for beside the program, in PANOSCOPE_PLUGIN_PATH and in the graph's `plugin_paths`");
                }
                // What was meant counts as listed, so that its node types are no mistakes as well.
                self.listed.entry(file).or_default().extend(offers.or(near));
                self.error("unknown-plugin", &plugin.span, format!("there is no plugin `{name}`"))
                    .label(label)
                    .help(help);
            }
        }
    }

    /// Whether a plugin is listed for the nodes of a file: by the file itself, for an overlay also by the graph.
    fn lists(&self, file: usize, plugin: &str) -> bool {
        let by = |file: usize| self.listed.get(&file).is_some_and(|listed| listed.contains(plugin));
        by(file) || self.text.overlays.contains(&file) && by(0)
    }

    /// The file that a node is in.
    fn file_of(&self, node: &NodeText) -> usize {
        self.text.sources.index(node.id.span.start)
    }

    fn known_plugins(&self) -> Vec<&'a str> {
        let mut known: Vec<&str> = self.catalog.plugins.iter().map(String::as_str).collect();
        known.extend(self.catalog.node_types.iter().map(|t| t.plugin.as_str()));
        known.sort_unstable();
        known.dedup();
        known
    }

    /// Whether a listed plugin is missing or unusable, so that its node types are not known.
    fn blind(&self) -> bool {
        let usable = |p: &str| self.catalog.has_plugin(p) && self.catalog.problem(p).is_none();
        self.text.flat.plugins.iter().flat_map(|(_, plugins)| plugins).any(|p| !usable(&p.value))
    }

    /// Position of a node's type in the catalog. Where a mistake has only one plausible correction, the
    /// checks go on with that.
    pub(super) fn node_type(&mut self, node: &'a NodeText) -> Option<usize> {
        let name = node.type_name.as_ref()?;
        let (catalog, file) = (self.catalog, self.file_of(node));
        let plugin_of = |i: &usize| catalog.node_types[*i].plugin.as_str();
        let all = catalog.find(&name.value);
        let listed: Vec<usize> = all.iter().copied().filter(|i| self.lists(file, plugin_of(i))).collect();
        match (listed.as_slice(), all.as_slice()) {
            (&[only], _) => Some(only),
            ([_, _, ..], _) => {
                let plugins = list(listed.iter().map(plugin_of), 6, "and");
                let names: Vec<String> =
                    listed.iter().map(|i| format!("type = \"{}/{}\"", plugin_of(i), name.value)).collect();
                self.error(
                    "ambiguous-type",
                    &name.span,
                    format!("node type `{}` is offered by several plugins: {plugins}", name.value),
                )
                .label("which one?")
                .help(format!("write {}", names.join(" or ")));
                None
            }
            ([], []) => {
                self.unloaded_type(node, name);
                None
            }
            // The list of plugins could not be read.
            ([], some) if self.text.incomplete && self.listed.get(&file).is_none_or(HashSet::is_empty) => {
                (some.len() == 1).then(|| some[0])
            }
            ([], some) => {
                let plugins: Vec<&str> = some.iter().map(plugin_of).collect();
                self.not_listed(file, name, &plugins);
                if some.len() == 1 { Some(some[0]) } else { None }
            }
        }
    }

    /// Reports a type that no loaded plugin has, with the unloaded plugins that offer it.
    fn unloaded_type(&mut self, node: &'a NodeText, name: &Spanned<String>) {
        let (plugins, file) = (self.catalog.offering(&name.value), self.file_of(node));
        // Listed, found and yet not loaded: that is reported at `plugins`.
        if plugins.iter().any(|p| self.lists(file, p)) || !plugins.is_empty() && self.text.incomplete {
            return;
        }
        match plugins.is_empty() {
            true => self.unknown_type(node, &name.value),
            false => self.not_listed(file, name, &plugins),
        }
    }

    fn not_listed(&mut self, file: usize, name: &Spanned<String>, plugins: &[&str]) {
        let (verb, not) = if plugins.len() == 1 { ("which", "does not list") } else { ("none of which", "lists") };
        let belongs = list(plugins.iter().copied(), 6, "or");
        let message = format!("node type `{}` belongs to plugin {belongs}, {verb} `plugins` {not}", name.value);
        let help = self.plugins_help(file, plugins);
        self.error("plugin-not-listed", &name.span, message).help(help);
    }

    /// The line that lists what this graph needs: one of `plugins`, and all others that are unambiguous.
    fn plugins_help(&self, file: usize, plugins: &[&str]) -> String {
        let own = self.text.flat.plugins.iter().filter(|(index, _)| *index == file).flat_map(|(_, plugins)| plugins);
        let mut wanted: Vec<&str> = own.map(|p| p.value.as_str()).collect();
        let verb = if wanted.is_empty() { "begin the file with" } else { "write" };
        let mut add = |plugin: &'a str| {
            if !wanted.contains(&plugin) {
                wanted.push(plugin);
            }
        };
        let nodes = self.text.flat.nodes.iter().filter(|n| self.file_of(n) == file);
        for name in nodes.filter_map(|n| n.type_name.as_ref()) {
            let loaded = self.catalog.find(&name.value).into_iter().map(|i| self.catalog.node_types[i].plugin.as_str());
            let offering: Vec<&'a str> = loaded.chain(self.catalog.offering(&name.value)).collect();
            if let [only] = offering[..] {
                add(only);
            }
        }
        let first = plugins.first().copied().unwrap_or_default();
        if !wanted.contains(&first) {
            wanted.push(first);
        }
        let quoted: Vec<String> = wanted.iter().map(|plugin| format!("\"{plugin}\"")).collect();
        format!("{verb} plugins = [{}]", quoted.join(", "))
    }

    fn unknown_type(&mut self, node: &'a NodeText, name: &str) {
        let Some(span) = node.type_name.as_ref().map(|t| &t.span) else { return };
        let (bare, file) = (name.rsplit('/').next().unwrap_or(name), self.file_of(node));
        // Plugin and type.
        let catalog = self.catalog;
        let loaded = catalog.node_types.iter().map(|t| (t.plugin.as_str(), t.name.as_str()));
        let offered = catalog.offers.iter().flat_map(|o| o.node_types.iter().map(|t| (o.plugin.as_str(), t.as_str())));
        let (here, elsewhere): (Vec<_>, Vec<_>) = loaded.chain(offered).partition(|(p, _)| self.lists(file, p));
        let near = nearest(bare, here.iter().map(|(_, name)| *name));
        let far = nearest(bare, elsewhere.iter().map(|(_, name)| *name));
        // Its plugin may be the one that is missing, and that is reported already.
        if (self.blind() || self.text.incomplete) && near.is_none() && far.is_none() {
            return;
        }
        let right_elsewhere = self.catalog.find(bare).first().map(|&i| &self.catalog.node_types[i]);
        let (label, help) = match (right_elsewhere, near, far) {
            (Some(right), _, _) if name.contains('/') => (
                format!("did you mean \"{}/{bare}\"?", right.plugin),
                format!("node type `{bare}` belongs to plugin `{}`", right.plugin),
            ),
            (_, Some(near), _) => (format!("did you mean \"{near}\"?"), String::new()),
            (_, None, Some(far)) => {
                let plugin = elsewhere.iter().find(|(_, name)| *name == far).map_or("", |(plugin, _)| *plugin);
                let help = format!("`{far}` belongs to plugin `{plugin}`; {}", self.plugins_help(file, &[plugin]));
                (format!("did you mean \"{far}\"?"), help)
            }
            _ => (String::new(), self.type_help(file)),
        };
        self.error("unknown-type", span, format!("there is no node type `{name}`")).label(label).help(help);
    }

    fn type_help(&self, file: usize) -> String {
        let names: Vec<&str> =
            self.catalog.node_types.iter().filter(|t| self.lists(file, &t.plugin)).map(|t| t.name.as_str()).collect();
        if names.is_empty() {
            "`plugins` lists no plugin that offers node types; `panoscope list` shows all".to_owned()
        } else {
            format!("the listed plugins offer {}; `panoscope list` shows all", list(names, 10, "and"))
        }
    }
}
