//! JSON Schema, Graphviz text, and the JSON of catalog and diagnostics.

use crate::common;
use panoscope_graph::{Catalog, GraphText, check, json_schema, to_dot};
use std::path::Path;

const GRAPH: &str = r#"
plugins = ["phantom", "arm", "overlay", "sinks", "stereo"]
[nodes.scope]
type = "phantom"
inputs.camera_pose = { from = "arm.camera_pose", delay = 1 }
[nodes.pid]
type = "arm_pid"
inputs.tip = "scope.tip"
[nodes.arm]
type = "arm_sim"
inputs.joints = "pid.joints"
[nodes.bm]
type = "stereo_bm"
inputs = { left = "scope.left", right = "scope.right" }
[nodes.out]
type = "write_images"
inputs.images = ["scope.wide"]
[nodes.see]
type = "preview"
inputs.packet = { from = "bm.disparity", align = "latest" }
"#;

#[test]
fn the_catalog_survives_json() {
    let mut catalog = common::catalog();
    // Code is not written.
    catalog.node_types.iter_mut().for_each(|node_type| node_type.validator = None);
    let text = serde_json::to_string(&catalog).expect("JSON");
    assert_eq!(serde_json::from_str::<Catalog>(&text).expect("a catalog"), catalog);
}

#[test]
fn the_schema_knows_every_type_port_and_limit() {
    let catalog = common::catalog();
    let schema = json_schema(&catalog);
    assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
    let nodes = schema["$defs"]["node"]["oneOf"].as_array().expect("a list");
    assert_eq!(nodes.len(), catalog.node_types.len() + 1);
    assert_eq!(nodes.last().map(|n| &n["title"]), Some(&"part".into()));
    for (node, node_type) in nodes.iter().zip(&catalog.node_types) {
        let properties = &node["properties"];
        for port in &node_type.inputs {
            assert!(
                properties["inputs"]["properties"][&port.name]["$ref"].is_string(),
                "{}.{}",
                node_type.name,
                port.name
            );
        }
        for param in &node_type.params {
            let described = &properties["params"]["properties"][&param.name];
            assert!(described["description"].as_str().is_some_and(|d| d.starts_with(&param.doc)));
            assert!(!described["default"].is_null());
        }
    }
    let find = |name: &str| nodes.iter().find(|n| n["title"] == name).expect("a node type");
    let search = &find("stereo_bm")["properties"]["params"]["properties"]["search_px"]["anyOf"][0];
    assert_eq!(
        (search["minimum"].as_i64(), search["maximum"].as_i64(), search["multipleOf"].as_i64()),
        (Some(16), Some(256), Some(16))
    );
    // Odd numbers from 5 are no multiples of anything.
    assert!(find("stereo_bm")["properties"]["params"]["properties"]["block_px"]["anyOf"][0]["multipleOf"].is_null());
    assert_eq!(find("register_surf")["properties"]["inputs"]["required"], serde_json::json!(["left", "right"]));
    // Offered by two plugins: only the full names are right, else `oneOf` would match both.
    let edges: Vec<_> =
        nodes.iter().filter(|n| n["title"] == "edges").map(|n| n["properties"]["type"]["enum"].to_string()).collect();
    assert_eq!(edges, ["[\"filters_c/edges\"]", "[\"filters_cpp/edges\"]"]);
    // Every reference leads somewhere.
    let text = schema.to_string();
    for part in text.split("\"$ref\":\"").skip(1) {
        let target = part.split('"').next().expect("a reference");
        assert!(schema.pointer(&target[1..]).is_some(), "{target}");
    }
}

#[test]
fn dot_names_nodes_ports_and_special_edges() {
    let catalog = common::catalog();
    let text = GraphText::parse(Path::new("loop \"1\".toml"), GRAPH);
    let (graph, _) = check(&text, &catalog).into_result().unwrap_or_else(|d| panic!("{d}"));
    let dot = to_dot(&graph, &catalog);
    for part in [
        "digraph \"loop \\\"1\\\"\" {",
        "n0 [label = \"{<i0> camera_pose}|scope\\nphantom/phantom|{<o0> left|<o1> right|<o7> wide|<o10> tip}\"",
        "n2:o1 -> n0:i0 [label = \"delay 1\", style = dashed, constraint = false];",
        "n0:o0 -> n3:i0 [label = \"to gray8\"];",
        "n3:o0 -> n5:i0 [label = \"latest\", style = dotted];",
        "n1:o0 -> n2:i0;",
    ] {
        assert!(dot.contains(part), "no {part} in\n{dot}");
    }
    assert_eq!(dot.matches('{').count(), dot.matches('}').count());
    // Where Graphviz is installed, it must agree.
    let run = std::process::Command::new("dot").arg("-V").output();
    if run.is_err() {
        panoscope_testing::skipped!("Graphviz is not installed");
        return;
    }
    let path = std::env::temp_dir().join(format!("panoscope_graph_{}.dot", std::process::id()));
    std::fs::write(&path, &dot).expect("a file");
    let run = std::process::Command::new("dot").arg("-Tsvg").arg(&path).output().expect("Graphviz runs");
    std::fs::remove_file(&path).expect("a file to remove");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}

#[test]
fn dot_draws_parts_as_clusters() {
    let text = "plugins = [\"phantom\", \"stereo\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.\"depth/rectify\"]\n\
                type = \"rectify\"\ninputs = { left = \"scope.left\", right = \"scope.right\", calibration = \"scope.calibration\" }\n\
                [nodes.\"depth/in/match\"]\ntype = \"stereo_bm\"\ninputs = { left = \"depth/rectify.left\", right = \"depth/rectify.right\" }\n\
                [nodes.show]\ntype = \"preview\"\ninputs = { packet = \"depth/in/match.disparity\" }\n";
    let catalog = common::catalog();
    let (graph, _) =
        check(&GraphText::parse(Path::new("g.toml"), text), &catalog).into_result().unwrap_or_else(|d| panic!("{d}"));
    let dot = to_dot(&graph, &catalog);
    let at = |part: &str| dot.find(part).unwrap_or_else(|| panic!("no {part} in\n{dot}"));
    let order =
        ["subgraph \"cluster_depth\" {", "label = \"depth\";", "n1 [", "subgraph \"cluster_depth/in\" {", "n2 ["];
    assert!(order.windows(2).all(|w| at(w[0]) < at(w[1])), "{dot}");
    assert!(dot.contains("}|match\\nstereo/stereo_bm|"), "{dot}");
    assert_eq!(dot.matches('{').count(), dot.matches('}').count());
}

#[test]
fn diagnostics_come_as_json_and_in_colour() {
    let text = GraphText::parse(Path::new("bad.toml"), "plugins = [\"phantom\"]\n[nodes.a]\ntype = \"fantom\"\n");
    let diagnostics = check(&text, &common::catalog()).diagnostics;
    let json = serde_json::to_value(&diagnostics).expect("JSON");
    assert_eq!(json[0]["code"], "unknown-type");
    assert_eq!(
        (json[0]["severity"].as_str(), json[0]["line"].as_u64(), json[0]["column"].as_u64()),
        (Some("error"), Some(3), Some(8))
    );
    assert_eq!(json[0]["label"], "did you mean \"phantom\"?");
    let colored = diagnostics.render(true);
    assert!(colored.contains("\x1b[1;31merror[unknown-type]\x1b[0m"));
    // Taking the colours away gives the plain text.
    let mut plain = String::new();
    let mut rest = colored.as_str();
    while let Some(at) = rest.find('\x1b') {
        plain.push_str(&rest[..at]);
        rest = &rest[at + rest[at..].find('m').expect("the end of a colour") + 1..];
    }
    plain.push_str(rest);
    assert_eq!(plain, diagnostics.render(false));
}

#[test]
fn a_file_cannot_steer_the_terminal() {
    let text = GraphText::parse(Path::new("bad.toml"), "plugins = [\"\\u001b[31m\"]\n[nodes.a]\ntype = 'x\t\u{7f}'\n");
    let rendered = check(&text, &common::catalog()).diagnostics.render(false);
    assert!(!rendered.contains('\x1b') && !rendered.contains('\x7f'), "{rendered}");
}
