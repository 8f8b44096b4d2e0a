//! Outputs whose packets Python receives.

/// Source, number and capture time in ns.
pub type TickParts = (u32, u64, i64);

/// An output whose packets Python receives.
pub struct Watched {
    /// The node's name in the flattened graph.
    pub node: String,
    pub output: String,
    /// Name of its packet type.
    pub packet: String,
}

impl Watched {
    /// Node and output of each.
    pub fn outputs(all: &[Self]) -> Vec<(String, String)> {
        all.iter().map(|watched| (watched.node.clone(), watched.output.clone())).collect()
    }
}
