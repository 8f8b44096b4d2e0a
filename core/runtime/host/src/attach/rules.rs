//! Parts of a graph that an edit from a window must not change, whatever its rights.

use std::collections::BTreeMap;

/// Parameters that stop an arm and release it: both are set only where the graph runs.
pub const STOPS: [&str; 2] = ["emergency_stop", "reset"];
/// Keys of a graph file that name code or machines, or permissions of code.
const CODE: [&str; 4] = ["plugin_paths", "isolate", "deny", "machines"];

/// A refused edit.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RuleError {
    /// It is not TOML.
    #[error("the text is not TOML: {0}")]
    Toml(String),
    /// It sets or releases an emergency stop.
    #[error(
        "`{node}.{param}` can be set only at the machine that runs the graph: other windows cannot stop or release an arm"
    )]
    Stop {
        /// The node.
        node: String,
        /// Its parameter.
        param: String,
    },
    /// It names code to load, or machines.
    #[error("`{0}` can be changed only at the machine that runs the graph")]
    Code(&'static str),
    /// It refers to other files, whose values are not checked by these rules.
    #[error("an edit by a window has no parts and arguments: write their nodes and values into the graph")]
    OtherFiles,
}

fn table(text: &str) -> Result<toml::Table, RuleError> {
    text.parse::<toml::Table>().map_err(|error| RuleError::Toml(error.message().to_owned()))
}

/// The stop parameters of each node and their values in the text.
fn stops(graph: &toml::Table) -> BTreeMap<String, [Option<toml::Value>; 2]> {
    let nodes = graph.get("nodes").and_then(toml::Value::as_table);
    let of = |node: &toml::Value| STOPS.map(|param| node.get("params").and_then(|params| params.get(param)).cloned());
    nodes.into_iter().flatten().map(|(id, node)| (id.clone(), of(node))).collect()
}

/// Checks what an edit changes in the running graph: `old` is its text, `new` the edited one.
///
/// # Errors
/// It changes something that no window may change.
pub fn check(old: &str, new: &str) -> Result<(), RuleError> {
    let (old, new) = (table(old)?, table(new)?);
    let mut nodes = new.get("nodes").and_then(toml::Value::as_table).into_iter().flat_map(toml::Table::values);
    if new.contains_key("args") || nodes.any(|node| node.get("graph").is_some()) {
        return Err(RuleError::OtherFiles);
    }
    if let Some(key) = CODE.into_iter().find(|key| old.get(*key) != new.get(*key)) {
        return Err(RuleError::Code(key));
    }
    let (before, after) = (stops(&old), stops(&new));
    // A stopped node stays: another one in its place would not be stopped.
    let is_stopped = |known: &[Option<toml::Value>; 2]| known[0] == Some(toml::Value::Boolean(true));
    if let Some((node, _)) = before.iter().find(|(node, known)| is_stopped(known) && !after.contains_key(*node)) {
        return Err(RuleError::Stop { node: node.clone(), param: STOPS[0].to_owned() });
    }
    for (node, now) in after {
        let known = before.get(&node);
        // A new node may begin stopped, as its text says.
        let Some(known) = known else { continue };
        if let Some(at) = (0..STOPS.len()).find(|at| known[*at] != now[*at]) {
            return Err(RuleError::Stop { node, param: STOPS[at].to_owned() });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const RUNS: &str =
        "plugin_paths = [\"a\"]\n[nodes.arm]\ntype = \"arm_sim\"\nparams = { emergency_stop = true, gain = 1 }\n";

    #[test]
    fn an_edit_neither_stops_nor_releases_an_arm() {
        assert_eq!(check(RUNS, &RUNS.replace("gain = 1", "gain = 2")), Ok(()));
        for edit in [RUNS.replace("true", "false"), RUNS.replace("emergency_stop = true, ", "")] {
            let refused = check(RUNS, &edit).expect_err("it releases");
            assert!(refused.to_string().contains("`arm.emergency_stop`"), "{refused}");
        }
        assert!(check(RUNS, &RUNS.replace("nodes.arm", "nodes.second")).is_err(), "another one is not stopped");
        let reset = RUNS.replace("gain = 1", "gain = 1, reset = 3");
        assert_eq!(check(RUNS, &reset), Err(RuleError::Stop { node: "arm".to_owned(), param: "reset".to_owned() }));
        let other = format!("{RUNS}[nodes.second]\ntype = \"arm_sim\"\nparams = {{ emergency_stop = true }}\n");
        assert_eq!(check(RUNS, &other), Ok(()));
    }

    #[test]
    fn an_edit_names_no_new_code() {
        assert_eq!(check(RUNS, &RUNS.replace("[\"a\"]", "[\"b\"]")), Err(RuleError::Code("plugin_paths")));
        assert_eq!(check(RUNS, &format!("{RUNS}[deny]\n")), Err(RuleError::Code("deny")));
        assert!(matches!(check(RUNS, "[nodes"), Err(RuleError::Toml(_))));
    }

    #[test]
    fn an_edit_takes_no_values_from_elsewhere() {
        let args = format!("{RUNS}[args.stop]\ntype = \"bool\"\n");
        let part = format!("{RUNS}[nodes.more]\ngraph = \"parts/arm.toml\"\n");
        assert_eq!([args, part].map(|edit| check(RUNS, &edit)), [const { Err(RuleError::OtherFiles) }; 2]);
    }
}
