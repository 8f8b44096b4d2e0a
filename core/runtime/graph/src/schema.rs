//! JSON Schema of graph files, so that editors complete and check them while they are typed.

use crate::args::ArgKind;
use crate::catalog::{Catalog, NodeType, Port};
use crate::param::{Param, ParamKind, Pick};
use crate::shape::{HIGHEST_HZ, MAX_MS};
use serde_json::{Map, Value, json};

const NODE_ID: &str = "^[A-Za-z_][A-Za-z0-9_-]*(/[A-Za-z_][A-Za-z0-9_-]*)*$";
const REFERENCE: &str = "^[A-Za-z_][A-Za-z0-9_/-]*\\.[^.]+$";

/// Schema (draft 2020-12) of a graph made of the catalog's node types. Names of ports and parameters are closed lists;
/// what a schema cannot express (references, packets, cycles) is left to [`check`](crate::check).
pub fn json_schema(catalog: &Catalog) -> Value {
    let mut plugins: Vec<&str> = catalog.plugins.iter().map(String::as_str).collect();
    plugins.extend(catalog.node_types.iter().map(|t| t.plugin.as_str()));
    plugins.sort_unstable();
    plugins.dedup();
    let mut nodes: Vec<Value> = catalog.node_types.iter().map(|t| node_schema(catalog, t)).collect();
    nodes.push(part_schema());
    let node = if catalog.node_types.is_empty() { json!({ "type": "object" }) } else { json!({ "oneOf": nodes }) };
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Panoscope graph",
        "description": "Nodes of plugins and how they are wired.",
        "type": "object",
        "additionalProperties": false,
        "anyOf": [{ "required": ["nodes"] }, { "required": ["args"] }],
        // Inputs inside a part are connected by its users.
        "if": { "required": ["part"] },
        "then": { "properties": { "nodes": { "additionalProperties": { "type": "object" } } } },
        "else": { "properties": { "nodes": { "additionalProperties": { "$ref": "#/$defs/node" } } } },
        "properties": graph_properties(&plugins),
        "$defs": definitions(&node)
    })
}

/// Tables and keys of a graph file.
fn graph_properties(plugins: &[&str]) -> Value {
    json!({
        "name": { "type": "string", "description": "Name of the graph; the file's name when absent." },
        "mode": {
            "enum": ["live", "batch"],
            "default": "live",
            "description": "live: the newest frame wins; batch: no frame is lost."
        },
        "plugins": {
            "type": "array",
            "items": { "anyOf": [{ "enum": plugins }, { "type": "string" }] },
            "description": "Plugins whose node types this graph uses."
        },
        "plugin_paths": {
            "type": "array",
            "items": { "anyOf": [{ "type": "string" }, { "$ref": "#/$defs/argument" }] },
            "description": "Further folders to look for plugins, relative to this file."
        },
        "nodes": {
            "type": "object",
            "propertyNames": { "pattern": NODE_ID },
            "minProperties": 1
        },
        "args": {
            "type": "object",
            "additionalProperties": { "$ref": "#/$defs/arg" },
            "description": "Arguments: given on the command line (--left X), used as { arg = \"left\" }."
        },
        "part": {
            "type": "object",
            "additionalProperties": false,
            "description": "Makes the file a part: what a graph may connect and set, as node.port or node.param of the part.",
            "properties": {
                "inputs": { "type": "object", "additionalProperties": { "$ref": "#/$defs/targets" } },
                "outputs": { "type": "object", "additionalProperties": { "$ref": "#/$defs/reference" } },
                "params": { "type": "object", "additionalProperties": { "$ref": "#/$defs/targets" } }
            }
        },
        "isolate": {
            "type": "object",
            "additionalProperties": { "$ref": "#/$defs/group" },
            "description": "Plugins whose nodes run in processes of their own, each with the name of its group."
        },
        "deny": {
            "type": "object",
            "additionalProperties": { "type": "array", "items": { "enum": ["network", "new_files"] } },
            "description": "Groups of isolated nodes, each with what its process may not do: open network connections, make or write files."
        },
        "machines": {
            "type": "object",
            "additionalProperties": { "$ref": "#/$defs/machine" },
            "description": "Other machines that nodes run on with `on`, where `panoscope serve` runs."
        },
        "preset": {
            "type": "object",
            "additionalProperties": false,
            "description": "What a surgeon may touch, and how far.",
            "properties": {
                "pinned": { "type": "array", "items": { "$ref": "#/$defs/pin" } },
                "views": {
                    "type": "array",
                    "items": { "anyOf": [{ "$ref": "#/$defs/reference" }, { "$ref": "#/$defs/view" }] },
                    "description": "Outputs that the theatre shows, the most important one first."
                }
            }
        },
        "editor": { "type": "object", "description": "Positions of the editor; not read by anything else." }
    })
}

/// Definitions that the schema refers to in several locations.
fn definitions(node: &Value) -> Value {
    json!({
        "node": node,
        "machine": machine_schema(),
        "arg": arg_schema(),
        "group": {
            "type": "string",
            "pattern": "^[A-Za-z_][A-Za-z0-9_-]*$",
            "description": "Group of nodes that share a process of their own; a crash there ends no other node."
        },
        "argument": {
            "type": "object",
            "additionalProperties": false,
            "required": ["arg"],
            "properties": { "arg": { "type": "string", "description": "Name of an argument of the graph." } }
        },
        "targets": {
            "anyOf": [
                { "$ref": "#/$defs/reference" },
                { "type": "array", "items": { "$ref": "#/$defs/reference" } }
            ]
        },
        "reference": { "type": "string", "pattern": REFERENCE, "description": "An output: node.port" },
        "connection": { "anyOf": [{ "$ref": "#/$defs/reference" }, { "$ref": "#/$defs/aligned" }] },
        "aligned": aligned_schema(),
        "connections": {
            "anyOf": [
                { "$ref": "#/$defs/connection" },
                { "type": "array", "items": { "$ref": "#/$defs/connection" } }
            ]
        },
        "view": {
            "type": "object",
            "additionalProperties": false,
            "required": ["from"],
            "properties": {
                "from": { "$ref": "#/$defs/reference" },
                "label": { "type": "string", "description": "Text shown beside it." },
                "optional": optional_schema()
            }
        },
        "pin": {
            "type": "object",
            "additionalProperties": false,
            "required": ["param"],
            "properties": {
                "param": { "type": "string", "pattern": REFERENCE, "description": "A parameter: node.param" },
                "range": {
                    "type": "array",
                    "items": { "type": "number" },
                    "minItems": 2,
                    "maxItems": 2,
                    "description": "Lowest and highest value offered."
                },
                "label": { "type": "string", "description": "Text shown beside it." },
                "optional": optional_schema()
            }
        }
    })
}

/// Schema of an entry of `[machines]`.
fn machine_schema() -> Value {
    json!({
        "type": "object",
        "additionalProperties": false,
        "required": ["address"],
        "properties": {
            "address": { "type": "string", "description": "Where `panoscope serve` listens there: tls/HOST:PORT, or tcp/HOST:PORT inside one machine." },
            "pixels": { "enum": ["raw", "lz4", "h264"], "default": "raw", "description": "How pixels travel; lz4 compresses without loss, h264 colour pictures with loss." },
            "timeout_ms": { "type": "integer", "minimum": 100, "maximum": 60000, "default": 1000, "description": "The machine counts as lost when it sent nothing for this long." },
            "plaintext": { "type": "boolean", "default": false, "description": "Allows tcp/ to another machine: without encryption and without a check of who answers." }
        }
    })
}

/// Schema of an argument of the graph.
fn arg_schema() -> Value {
    json!({
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "type": { "enum": ArgKind::WORDS.map(|(word, _)| word) },
            "doc": { "type": "string", "description": "Shown by --help." },
            "default": { "description": "Value when none is given; without it the argument is required." },
            "range": { "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2 },
            "unit": { "type": "string" },
            "choices": { "type": "array", "items": { "type": "string" } }
        }
    })
}

fn optional_schema() -> Value {
    json!({
        "type": "boolean",
        "default": false,
        "description": "Left out where an overlay replaced the node and the new one has nothing of that name."
    })
}

fn aligned_schema() -> Value {
    json!({
        "type": "object",
        "additionalProperties": false,
        "required": ["from"],
        "properties": {
            "from": { "$ref": "#/$defs/reference" },
            "align": {
                "enum": ["exact", "latest", "nearest"],
                "default": "exact",
                "description": "exact: same tick; latest: newest value, never waits; nearest: closest in time."
            },
            "tolerance_ms": { "type": "number", "exclusiveMinimum": 0, "maximum": MAX_MS, "description": "For nearest: how far apart." },
            "max_age_ms": { "type": "number", "exclusiveMinimum": 0, "maximum": MAX_MS, "description": "Not for exact: a packet whose oldest light is older counts as absent." },
            "queue": { "type": "integer", "minimum": 1, "maximum": 1024, "description": "Packets that may wait." },
            "delay": { "enum": [0, 1], "default": 0, "description": "1: the value of this node's previous tick." },
            "trigger": { "type": "boolean", "default": false, "description": "The node runs on this input only." },
            "guide": { "type": "boolean", "default": false, "description": "Only says where to look: its age does not count." },
            "optional": optional_schema()
        }
    })
}

/// Schema of a node that is a graph file.
fn part_schema() -> Value {
    json!({
        "type": "object",
        "title": "part",
        "description": "A graph file with [part] whose nodes stand here.",
        "additionalProperties": false,
        "required": ["graph"],
        "properties": {
            "graph": { "type": "string", "description": "The part's file, relative to this file." },
            "inputs": { "type": "object", "additionalProperties": { "$ref": "#/$defs/connections" } },
            "params": { "type": "object" },
            "isolate": { "$ref": "#/$defs/group" },
            "on": { "type": "string", "description": "The machine of [machines] that it runs on." }
        }
    })
}

fn node_schema(catalog: &Catalog, node_type: &NodeType) -> Value {
    // A name that two plugins offer is only right with the plugin's.
    let full = format!("{}/{}", node_type.plugin, node_type.name);
    let names = if catalog.find(&node_type.name).len() > 1 { vec![full] } else { vec![node_type.name.clone(), full] };
    let mut inputs = Map::new();
    let mut required_inputs = Vec::new();
    for port in &node_type.inputs {
        inputs.insert(port.name.clone(), input_schema(port));
        if !port.optional {
            required_inputs.push(port.name.as_str());
        }
    }
    let params: Map<String, Value> = node_type.params.iter().map(|p| (p.name.clone(), param_schema(p))).collect();
    let mut required = vec!["type"];
    if !required_inputs.is_empty() {
        required.push("inputs");
    }
    json!({
        "type": "object",
        "title": node_type.name,
        "description": node_type.doc,
        "additionalProperties": false,
        "required": required,
        "properties": {
            "type": { "enum": names, "description": node_type.doc },
            "inputs": {
                "type": "object",
                "additionalProperties": false,
                "required": required_inputs,
                "properties": inputs
            },
            "params": { "type": "object", "additionalProperties": false, "properties": params },
            "on_fault": {
                "enum": ["restart", "bypass", "stop"],
                "default": "restart",
                "description": "What the host does when the node faults."
            },
            "budget_ms": { "type": "number", "exclusiveMinimum": 0, "maximum": MAX_MS, "description": "Time it should not exceed per tick." },
            "max_rate_hz": { "type": "number", "exclusiveMinimum": 0, "maximum": HIGHEST_HZ, "description": "It runs at most this often, on average." },
            "cpu": { "type": "integer", "minimum": 0, "maximum": 4095, "description": "Core its thread is pinned to; a compute node gets a thread for it." },
            "isolate": { "$ref": "#/$defs/group" },
            "on": { "type": "string", "description": "The machine of [machines] that it runs on." }
        }
    })
}

fn input_schema(port: &Port) -> Value {
    let target = if port.list { "#/$defs/connections" } else { "#/$defs/connection" };
    let formats = match port.packet.formats.as_slice() {
        [] => String::new(),
        formats => format!(": {}", formats.join(" or ")),
    };
    json!({ "$ref": target, "description": format!("{} ({}{formats})", port.doc, port.packet.name) })
}

fn param_schema(param: &Param) -> Value {
    let mut schema = Map::new();
    let mut put = |key: &str, value: Value| {
        if !value.is_null() {
            schema.insert(key.to_owned(), value);
        }
    };
    match &param.kind {
        ParamKind::Bool { default } => {
            put("type", json!("boolean"));
            put("default", json!(default));
        }
        ParamKind::Int { default, min, max, step } => {
            put("type", json!("integer"));
            put("default", json!(default));
            put("minimum", json!(min));
            put("maximum", json!(max));
            // `multipleOf` counts from 0, steps from the minimum.
            let aligned = step.filter(|s| *s > 1 && min.unwrap_or(0) % s == 0);
            put("multipleOf", json!(aligned));
        }
        ParamKind::Float { default, min, max, .. } => {
            put("type", json!("number"));
            put("default", json!(default));
            put("minimum", json!(min));
            put("maximum", json!(max));
        }
        ParamKind::Choice { default, choices } => {
            put("enum", json!(choices));
            put("default", json!(default));
        }
        ParamKind::Text { default } | ParamKind::Path { default, .. } => {
            put("type", json!("string"));
            put("default", json!(default));
        }
        ParamKind::Floats { default, min_len, max_len } => {
            put("type", json!("array"));
            put("default", json!(default));
            // Numbers may also come in pairs, so the count is not the list's length.
            put(
                "items",
                json!({ "anyOf": [{ "type": "number" }, { "type": "array", "items": { "type": "number" } }] }),
            );
            put("maxItems", json!(max_len));
            put("minItems", if *min_len > 0 { json!(1) } else { Value::Null });
        }
    }
    let unit = if param.unit.is_empty() { String::new() } else { format!(" [{}]", param.unit) };
    let reopen = if param.reopen { " A change reopens the node." } else { "" };
    let pick = match param.pick {
        Pick::Points | Pick::Rectangles => format!(" As {}", param.pick.words()),
        Pick::None | Pick::File => String::new(),
    };
    let description = format!("{}{unit}{pick}{reopen}", param.doc);
    let default = schema.remove("default");
    json!({ "description": description, "default": default, "anyOf": [schema, { "$ref": "#/$defs/argument" }] })
}
