//! The table at the end of a run.

use panoscope_engine::Report;
use panoscope_engine::text_table::table;
use panoscope_graph::Graph;

fn cells<const N: usize>(row: [&str; N]) -> Vec<String> {
    row.iter().map(|cell| (*cell).to_owned()).collect()
}

/// The run in one screen: nodes in the order ticks pass them, then the ages at the sinks.
pub fn text(graph: &Graph, report: &Report) -> String {
    let mut out = format!(
        "{}: {} frames in {:.2} s, {:.1} fps ({} threads, {} cores)\n",
        report.graph, report.frames, report.seconds, report.fps, report.machine.threads, report.machine.cores
    );
    let skips = report.nodes.values().any(|n| n.skipped > 0);
    let mut head = cells(["node", "count", "p50 ms", "p99 ms", "max ms", "dropped", "faults"]);
    if skips {
        head.push("skipped".to_owned());
    }
    let mut rows = vec![head];
    for &index in &graph.order {
        let id = &graph.nodes[index].id;
        let Some(node) = report.nodes.get(id) else { continue };
        let mut row = vec![id.clone(), node.count.to_string()];
        row.extend([node.p50_ms, node.p99_ms, node.max_ms].map(|ms| format!("{ms:.3}")));
        row.extend([node.dropped.to_string(), node.faults.to_string()]);
        if skips {
            row.push(node.skipped.to_string());
        }
        rows.push(row);
    }
    out.push_str(&table(&rows));
    if !report.paths.is_empty() {
        let mut rows = vec![cells(["sink", "age p50 ms", "p99 ms", "max ms"])];
        for (sink, path) in &report.paths {
            let mut row = vec![sink.clone()];
            row.extend([path.age_p50_ms, path.age_p99_ms, path.age_max_ms].map(|ms| format!("{ms:.3}")));
            rows.push(row);
        }
        out.push_str(&table(&rows));
    }
    if let Some(allocations) = report.allocations_per_frame {
        out.push_str(&format!("  heap allocations per frame in steady state: {allocations:.2}\n"));
    }
    out
}
