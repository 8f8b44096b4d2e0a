//! Time of a tick through a saturated chain, by its length: `frames` -> `pass` ... -> `drain`, and what each node adds.
//! `cargo bench -p panoscope-engine --bench tick`; arguments: rounds, ticks per run, lengths. `PANOSCOPE_PLUGIN_PATH`
//! names a folder with the plugin `flow`.
//!
//! The least of many short runs is the one that nothing else disturbed.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use panoscope_engine::{Engine, Options};
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::Loader;

const LENGTHS: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];

fn chain(length: usize, node_type: &str) -> String {
    let mut text =
        "mode = \"batch\"\nplugins = [\"flow\"]\n[nodes.source]\ntype = \"frames\"\nparams = { pattern = \"none\" }\n"
            .to_owned();
    let mut last = "source".to_owned();
    let mut node = |id: String, node_type: &str| {
        let input = format!("{{ from = \"{last}.image\", queue = 64 }}");
        let _ = write!(text, "[nodes.{id}]\ntype = \"{node_type}\"\ninputs = {{ image = {input} }}\n");
        last = id;
    };
    (0..length).for_each(|index| node(format!("n{index}"), node_type));
    node("sink".to_owned(), "drain");
    text
}

fn ns_per_tick(loader: &Loader, text: &str, ticks: u64) -> f64 {
    let text = GraphText::parse(Path::new("tick.toml"), text);
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    let options = Options { frames: Some(ticks), ..Options::default() };
    let engine = Engine::start(graph, &catalog, loader, options).expect("the graph starts");
    assert!(engine.wait(Some(Duration::from_secs(60))), "the graph did not end");
    engine.close(Duration::from_secs(5));
    let report = engine.report();
    assert_eq!(report.nodes["sink"].count, ticks);
    report.seconds * 1e9 / ticks as f64
}

fn main() {
    let mut numbers = std::env::args().filter_map(|word| word.parse::<u64>().ok());
    let (rounds, ticks) = (numbers.next().unwrap_or(8), numbers.next().unwrap_or(8_000));
    let mut given: Vec<usize> = numbers.map(|number| number as usize).collect();
    given.sort_unstable();
    let path = std::env::var_os("PANOSCOPE_PLUGIN_PATH").expect("PANOSCOPE_PLUGIN_PATH is set");
    let loader = Loader::search(&std::env::split_paths(&path).collect::<Vec<PathBuf>>());
    let cases = match &given[..] {
        [] => [("pass", &LENGTHS[..]), ("pass_blocking", &LENGTHS[..4])],
        given => [("pass", given), ("pass_blocking", &[])],
    };
    for (node_type, lengths) in cases.into_iter().filter(|(_, lengths)| !lengths.is_empty()) {
        let mut least = vec![f64::INFINITY; lengths.len()];
        for _ in 0..rounds {
            for (least, &length) in least.iter_mut().zip(lengths) {
                *least = least.min(ns_per_tick(&loader, &chain(length, node_type), ticks));
            }
        }
        let longest = lengths.len() - 1;
        let per_node = (least[longest] - least[0]) / (lengths[longest] - lengths[0]).max(1) as f64;
        let texts: Vec<String> = lengths.iter().zip(&least).map(|(length, ns)| format!("{length}: {ns:.0}")).collect();
        println!("{node_type:<14} {per_node:6.1} ns per node; ns per tick by length: {}", texts.join(", "));
    }
}
