//! The simulated nodes as a plugin without a file.

use std::path::PathBuf;
use std::sync::OnceLock;

use crate::engine::{Plugins, loading};
use panoscope_abi as abi;
use panoscope_graph::{Catalog, Graph, GraphText, check};

use crate::graphs::Model;
use crate::nodes;

/// The plugin `sim`.
pub struct Simulated {
    entries: Vec<&'static abi::NodeType>,
    catalog: Catalog,
}

/// Identifies the calling plugin for the host's functions: an address in this program.
static IDENTITY: u64 = 0;

/// The plugin, attached to the simulated engine.
pub fn simulated() -> &'static Simulated {
    static PLUGIN: OnceLock<Simulated> = OnceLock::new();
    PLUGIN.get_or_init(|| {
        let entries = nodes::node_types();
        let pointers: &'static [*const abi::NodeType] =
            Vec::leak(entries.iter().map(|entry| std::ptr::from_ref(*entry)).collect());
        let plugin = abi::Plugin {
            magic: abi::MAGIC,
            abi_major: abi::ABI_MAJOR,
            abi_minor: abi::ABI_MINOR,
            struct_size: size_of::<abi::Plugin>() as u32,
            reserved: 0,
            name: abi::Str::new("sim"),
            version: abi::Str::new("1"),
            doc: abi::Str::new("Simulated nodes."),
            node_types: pointers.as_ptr(),
            node_types_len: pointers.len(),
            note: std::ptr::null(),
            attach: None,
        };
        // SAFETY: the descriptor refers to descriptors and texts that live until the process ends.
        let node_types = unsafe { panoscope_graph::from_abi::node_types(&raw const plugin) };
        let node_types = node_types.unwrap_or_else(|error| panic!("the simulated nodes: {error}"));
        // SAFETY: the table is never freed.
        let attached = unsafe { panoscope_node::export::attach(loading::plugin_table((&raw const IDENTITY).cast())) };
        assert_eq!(attached, abi::STATUS_OK, "the simulated nodes attach");
        let catalog = Catalog { plugins: vec!["sim".to_owned()], node_types, ..Catalog::default() };
        Simulated { entries, catalog }
    })
}

impl Simulated {
    /// Its catalog of node types.
    pub fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// The checked graph of a model.
    ///
    /// # Errors
    /// The diagnostics.
    pub fn graph(&self, model: &Model) -> Result<Graph, String> {
        let text = GraphText::parse("sim.toml".as_ref(), &model.text());
        let (graph, _) = check(&text, &self.catalog).into_result().map_err(|mistakes| mistakes.render(false))?;
        Ok(graph)
    }
}

impl Plugins for Simulated {
    fn entry(&self, _: &str, node_type: &str) -> Option<&'static abi::NodeType> {
        // SAFETY: the names are static texts.
        let is = |entry: &&&'static abi::NodeType| unsafe { entry.name.text() } == Some(node_type);
        self.entries.iter().find(is).copied()
    }

    fn files(&self, _: &[String]) -> Vec<(String, PathBuf)> {
        Vec::new()
    }
}
