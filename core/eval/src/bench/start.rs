//! Checking and starting a large graph.

use std::path::Path;
use std::time::{Duration, Instant};

use panoscope_engine::Options;
use panoscope_graph::GraphText;

use super::graph::{self, Pace};
use crate::embedded;
use crate::error::{Context, EvalError, Result};
use crate::figures::Figure;
use crate::run;

const NODES: usize = 1_000;

/// The graph of `cargo xtask demo`.
const DEMO: &str = "panorama.toml";

/// Time from text to first tick at the sink of one graph, and the share of checking; ms. `settings` are
/// `node.param=value`.
fn once(parse: &dyn Fn() -> Result<GraphText>, settings: &[String]) -> Result<(f64, f64)> {
    let begin = Instant::now();
    let mut text = parse()?;
    settings.iter().for_each(|setting| text.set(setting));
    let ready = run::ready(&text)?;
    let checked = begin.elapsed();
    let options = Options { frames: Some(1), paced: false, ..Options::default() };
    let live = ready.start(options)?;
    if !live.engine().wait(Some(Duration::from_secs(60))) {
        return Err(EvalError::Incomplete { what: "the first tick did not finish within a minute".to_owned() });
    }
    let through = begin.elapsed();
    live.engine().close(Duration::from_secs(10));
    Ok((through.as_secs_f64() * 1e3, checked.as_secs_f64() * 1e3))
}

/// Measures graphs of 1,000 nodes, from text to the first tick at the sink.
pub fn measure(quick: bool) -> Result<Vec<Figure>> {
    let rounds = if quick { 1 } else { 5 };
    let chain = graph::chain("pass", NODES - 2, None, Pace::Saturated);
    let wide = graph::fan_out(NODES - 2);
    let mut figures = Vec::new();
    for (name, text, input) in [
        ("graph_start_1000", &chain, "chain of 1,000 nodes, text to first tick through"),
        ("graph_start_1000/wide", &wide, "998 readers of one output, text to first tick through"),
    ] {
        let (mut all, mut check) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..rounds {
            let (through, checked) = once(&|| Ok(GraphText::parse(Path::new("bench.toml"), text)), &[])?;
            (all, check) = (all.min(through), check.min(checked));
        }
        figures.push(Figure::new(name, all, "ms", input));
        if name == "graph_start_1000" {
            figures.push(Figure::new(
                "graph_start_1000/check",
                check,
                "ms",
                "reading, loading plugins and checking alone",
            ));
        }
    }
    let folder = std::env::temp_dir().join(format!("panoscope-bench-start-{}", std::process::id()));
    let settings =
        [format!("video.path={:?}", folder.join("demo.mkv")), format!("still.path={:?}", folder.join("demo.png"))];
    let mut demo = f64::INFINITY;
    for _ in 0..rounds {
        demo = demo.min(once(&|| embedded::graph(DEMO).context(DEMO), &settings)?.0);
    }
    // What the graph wrote there served the measurement alone.
    let _ = std::fs::remove_dir_all(&folder);
    figures.push(Figure::new("graph_start/demo", demo, "ms", "graphs/panorama.toml, text to first picture written"));
    Ok(figures)
}
