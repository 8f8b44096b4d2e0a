//! The table at the end of a run.

use panoscope_engine::Report;
use panoscope_engine::isolation::LinkReport;
use panoscope_engine::text_table::table;
use panoscope_graph::Graph;

fn cells<const N: usize>(row: [&str; N]) -> Vec<String> {
    row.iter().map(|cell| (*cell).to_owned()).collect()
}

/// The run in one screen: nodes in the order of the ticks, then the ages at the sinks.
pub fn text(graph: &Graph, report: &Report) -> String {
    let mut out = format!(
        "{}: {} frames in {:.2} s, {:.1} fps ({} threads, {} cores)\n",
        report.graph, report.frames, report.seconds, report.fps, report.machine.threads, report.machine.cores
    );
    let skips = report.nodes.values().any(|n| n.skipped > 0);
    let copies = report.nodes.values().any(|n| n.copies > 0);
    let mut head = cells(["node", "count", "p50 ms", "p99 ms", "max ms", "dropped", "faults"]);
    if skips {
        head.push("skipped".to_owned());
    }
    if copies {
        head.extend(cells(["copies", "MB copied"]));
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
        if copies {
            row.extend([node.copies.to_string(), format!("{:.1}", node.copied_mb)]);
        }
        rows.push(row);
    }
    out.push_str(&table(&rows));
    if !report.paths.is_empty() {
        let mut rows = vec![cells(["sink", "age p50 ms", "p99 ms", "max ms", "newest light p50 ms", "p99 ms"])];
        for (sink, path) in &report.paths {
            let mut row = vec![sink.clone()];
            let ages =
                [path.age_p50_ms, path.age_p99_ms, path.age_max_ms, path.newest_age_p50_ms, path.newest_age_p99_ms];
            row.extend(ages.map(|ms| format!("{ms:.3}")));
            rows.push(row);
        }
        out.push_str(&table(&rows));
    }
    for (group, link) in report.groups.iter().filter_map(|(group, counts)| Some((group, counts.link.as_ref()?))) {
        out.push_str(&link_line(group, link));
    }
    if let Some(allocations) = report.allocations_per_frame {
        out.push_str(&format!("  heap allocations per frame in steady state: {allocations:.2}\n"));
    }
    out
}

/// The connection to another machine.
fn link_line(group: &str, link: &LinkReport) -> String {
    let ms = |ns: f64| ns / 1e6;
    let clock = match link.clock_offset_ns {
        Some(offset_ns) => {
            let error_ms = ms(link.clock_uncertainty_ns as f64);
            format!("its clock minus this one's {:+.3} ms, error at most {error_ms:.3} ms", ms(offset_ns as f64))
        }
        None => "its clock is unknown".to_owned(),
    };
    let (round_trip_ms, address) = (ms(link.round_trip_ns as f64), &link.address);
    format!("  machine `{group}` at {address}: {clock}; round trip {round_trip_ms:.3} ms\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_connection_is_shown_with_its_clock_and_round_trip() {
        let link = LinkReport { address: "tls/rack:7447".to_owned(), round_trip_ns: 420_000, ..LinkReport::default() };
        let line = link_line("rack", &link);
        assert_eq!(line, "  machine `rack` at tls/rack:7447: its clock is unknown; round trip 0.420 ms\n");
        let link = LinkReport { clock_offset_ns: Some(1_500_000), clock_uncertainty_ns: 210_000, ..link };
        let line = link_line("rack", &link);
        assert!(line.contains("its clock minus this one's +1.500 ms, error at most 0.210 ms; round trip"), "{line}");
    }
}
