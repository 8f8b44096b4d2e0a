//! What a run that has ended says of itself.

use crate::common;
use std::time::Duration;

use crate::common::{loader, options, run};
use panoscope_engine::{Engine, Options, Outcome};
use panoscope_graph::{Graph, GraphText, check};

#[test]
fn a_node_that_reads_nothing_is_finished_at_once_and_closing_waits_for_nobody() {
    // As `check` opens a single model: nothing gives it a tick, so nothing would ever end it.
    let file = common::scratch("alone.jsonl");
    let text = format!(
        "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n[nodes.source]\ntype = \"frames\"\n[nodes.alone]\ntype = \"ledger\"\n\
         inputs = {{ images = [\"source.image\"] }}\nparams = {{ path = \"{}\" }}\n",
        file.display()
    );
    let loader = loader();
    let text = GraphText::parse("alone.toml".as_ref(), &text);
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    let node = graph.nodes[graph.node("alone").expect("the node")].clone();
    let alone = Graph { nodes: vec![node], edges: Vec::new(), order: vec![0], ..graph };
    let engine = Engine::start(alone, &catalog, &loader, Options::default()).unwrap_or_else(|e| panic!("{e}"));
    // No time is given: it is finished before anybody asks.
    assert!(engine.is_finished());
    assert!(engine.wait(Some(Duration::ZERO)));
    assert_eq!(engine.close(Duration::ZERO), Outcome::Done);
    assert!(engine.report().stopped.is_empty(), "it was not left behind");
}

#[test]
fn a_report_names_outputs_that_never_came() {
    let nodes = "[nodes.source]\ntype = \"frames\"\nparams = { width_px = 16, height_px = 8, format = \"gray8\", count = 9 }\n\
                 [nodes.shut]\ntype = \"gate\"\ninputs = { image = \"source.image\" }\nparams = { open = false }\n\
                 [nodes.kept]\ntype = \"drain\"\ninputs = { image = \"shut.image\" }\n\
                 [nodes.end]\ntype = \"drain\"\ninputs = { image = \"source.image\" }\n";
    let (report, outcome) = run("batch", nodes, options(2, 20));
    assert_eq!(outcome, Outcome::Done);
    // The call in which it says that it has ended is none that made a frame.
    assert_eq!((report.nodes["source"].made, report.nodes["source"].count), (Some(9), 9));
    assert_eq!((report.nodes["kept"].count, &report.nodes["kept"].never_got[..]), (0, &["shut.image".to_owned()][..]));
    assert!(report.nodes["end"].never_got.is_empty() && report.nodes["end"].made.is_none());
}
