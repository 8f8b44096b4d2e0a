//! The report of a run in the text format of Prometheus.

use std::collections::BTreeMap;

use panoscope_engine::Report;
use panoscope_engine::isolation::LinkReport;
use prometheus::proto::{Counter, Gauge, LabelPair, Metric, MetricFamily, MetricType};
use prometheus::{Encoder, TextEncoder};

/// Content type of [`text`].
pub const CONTENT_TYPE: &str = prometheus::TEXT_FORMAT;

/// Metrics by name.
#[derive(Default)]
struct Families(BTreeMap<&'static str, MetricFamily>);

impl Families {
    fn add(&mut self, kind: MetricType, name: &'static str, help: &str, labels: &[(&str, &str)], value: f64) {
        let family = self.0.entry(name).or_insert_with(|| {
            let mut family = MetricFamily::default();
            family.set_name(name.to_owned());
            family.set_help(help.to_owned());
            family.set_field_type(kind);
            family
        });
        let pair = |(name, value): &(&str, &str)| {
            let mut pair = LabelPair::default();
            pair.set_name((*name).to_owned());
            pair.set_value((*value).to_owned());
            pair
        };
        let mut metric = Metric::from_label(labels.iter().map(pair).collect());
        if kind == MetricType::COUNTER {
            let mut counter = Counter::default();
            counter.set_value(value);
            metric.set_counter(counter);
        } else {
            let mut gauge = Gauge::default();
            gauge.set_value(value);
            metric.set_gauge(gauge);
        }
        family.mut_metric().push(metric);
    }

    fn count(&mut self, name: &'static str, help: &str, labels: &[(&str, &str)], value: u64) {
        self.add(MetricType::COUNTER, name, help, labels, value as f64);
    }

    fn gauge(&mut self, name: &'static str, help: &str, labels: &[(&str, &str)], value: f64) {
        self.add(MetricType::GAUGE, name, help, labels, value);
    }
}

/// All counters and times of a report. Times are in seconds, as Prometheus requires.
pub fn text(report: &Report) -> String {
    let mut all = Families::default();
    let seconds = |ms: f64| ms / 1e3;
    all.gauge("panoscope_graph_info", "The graph that runs.", &[("graph", &report.graph)], 1.0);
    all.gauge("panoscope_run_seconds", "Time since the run began.", &[], report.seconds);
    all.count("panoscope_ticks_total", "Ticks with a frame that the busiest source made.", &[], report.frames);
    for (node, n) in &report.nodes {
        let label = [("node", node.as_str())];
        all.count("panoscope_node_calls_total", "Calls of the node.", &label, n.count);
        all.count("panoscope_node_dropped_total", "Ticks and packets dropped at the node.", &label, n.dropped);
        let help = "Ticks not processed because a required input was empty.";
        all.count("panoscope_node_skipped_total", help, &label, n.skipped);
        all.count("panoscope_node_faults_total", "Errors, panics and crashes of the node.", &label, n.faults);
        all.count("panoscope_node_restarts_total", "Restarts of the node.", &label, n.restarts);
        all.count("panoscope_node_over_budget_total", "Calls over the node's budget.", &label, n.over_budget);
        all.count("panoscope_node_copies_total", "Frames copied for the node.", &label, n.copies);
        let times = [
            ("panoscope_node_call_p50_seconds", "Median time of a call.", n.p50_ms),
            ("panoscope_node_call_p99_seconds", "99th percentile of the time of a call.", n.p99_ms),
            ("panoscope_node_call_max_seconds", "The longest call.", n.max_ms),
        ];
        for (name, help, ms) in times {
            all.gauge(name, help, &label, seconds(ms));
        }
        for wire in &n.too_old_on {
            let index = wire.index.to_string();
            let label = [("node", node.as_str()), ("input", &wire.input), ("index", &index)];
            let help = "Ticks at which an input was older than `max_age_ms` and counted as absent.";
            all.count("panoscope_input_too_old_total", help, &label, wire.ticks);
        }
        for (metric, value) in &n.metrics {
            let help = "The last value of a metric that the node reports.";
            all.gauge("panoscope_node_metric", help, &[("node", node), ("metric", metric)], *value);
        }
    }
    for (sink, path) in &report.paths {
        let label = [("sink", sink.as_str())];
        let ages = [
            (
                "panoscope_age_p50_seconds",
                "Median age of the oldest light of what a sink has finished.",
                path.age_p50_ms,
            ),
            ("panoscope_age_p99_seconds", "99th percentile of that age.", path.age_p99_ms),
            ("panoscope_age_max_seconds", "The highest such age.", path.age_max_ms),
            ("panoscope_newest_age_p50_seconds", "Median age of the newest light of it.", path.newest_age_p50_ms),
            ("panoscope_newest_age_p99_seconds", "99th percentile of that age.", path.newest_age_p99_ms),
            ("panoscope_newest_age_max_seconds", "The highest such age.", path.newest_age_max_ms),
        ];
        for (name, help, ms) in ages {
            all.gauge(name, help, &label, seconds(ms));
        }
    }
    for (group, counts) in &report.groups {
        let label = [("group", group.as_str())];
        let help = "Processes started for a group of isolated nodes: one, and another after each that died.";
        all.count("panoscope_group_processes_total", help, &label, counts.processes);
        all.count("panoscope_group_calls_total", "Ticks that the nodes of a group processed.", &label, counts.calls);
        if let Some(link) = &counts.link {
            link_metrics(&mut all, group, link);
        }
    }
    let stopped = report.stopped.len() as f64;
    all.gauge("panoscope_stopped_nodes", "Nodes that lost data for good and were stopped.", &[], stopped);
    let families: Vec<MetricFamily> = all.0.into_values().collect();
    let mut bytes = Vec::new();
    // Every family has a name and a metric, so that the encoder has nothing to refuse.
    match TextEncoder::new().encode(&families, &mut bytes) {
        Ok(()) => String::from_utf8_lossy(&bytes).into_owned(),
        Err(error) => format!("# these metrics cannot be written: {error}\n"),
    }
}

/// Metrics of the connection to another machine.
fn link_metrics(all: &mut Families, group: &str, link: &LinkReport) {
    let label = [("group", group), ("address", link.address.as_str())];
    let seconds = |ns: f64| ns / 1e9;
    if let Some(offset_ns) = link.clock_offset_ns {
        let help = "The other machine's clock minus this one's.";
        all.gauge("panoscope_link_clock_offset_seconds", help, &label, seconds(offset_ns as f64));
        let (help, error_s) = ("Largest error of the offset.", seconds(link.clock_uncertainty_ns as f64));
        all.gauge("panoscope_link_clock_error_seconds", help, &label, error_s);
    }
    let help = "Time there and back of the last probe.";
    all.gauge("panoscope_link_round_trip_seconds", help, &label, seconds(link.round_trip_ns as f64));
    all.count("panoscope_link_sent_bytes_total", "Bytes sent to the other machine.", &label, link.sent_bytes);
    all.count("panoscope_link_received_bytes_total", "Bytes received from it.", &label, link.received_bytes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_engine::isolation::GroupReport;
    use panoscope_engine::{Machine, PathReport};

    #[test]
    fn a_report_becomes_counters_and_seconds() {
        let path = PathReport {
            age_p50_ms: 12.0,
            age_p99_ms: 30.5,
            age_max_ms: 40.0,
            newest_age_p50_ms: 5.0,
            ..PathReport::default()
        };
        let link = LinkReport {
            address: "tls/rack:7447".to_owned(),
            clock_offset_ns: Some(-2_500_000),
            clock_uncertainty_ns: 250_000,
            round_trip_ns: 500_000,
            ..LinkReport::default()
        };
        let report = Report {
            graph: "a \"b\"\n".to_owned(),
            frames: 7,
            seconds: 2.0,
            fps: 3.5,
            nodes: BTreeMap::new(),
            paths: [("out".to_owned(), path)].into(),
            groups: [("rack".to_owned(), GroupReport { link: Some(link), ..GroupReport::default() })].into(),
            stopped: BTreeMap::new(),
            allocations_per_frame: None,
            machine: Machine::here(1),
        };
        let text = text(&report);
        for line in [
            "# TYPE panoscope_ticks_total counter",
            "panoscope_ticks_total 7",
            "panoscope_age_p99_seconds{sink=\"out\"} 0.0305",
            "panoscope_newest_age_p50_seconds{sink=\"out\"} 0.005",
            "panoscope_link_clock_offset_seconds{group=\"rack\",address=\"tls/rack:7447\"} -0.0025",
            "panoscope_link_clock_error_seconds{group=\"rack\",address=\"tls/rack:7447\"} 0.00025",
            "panoscope_link_round_trip_seconds{group=\"rack\",address=\"tls/rack:7447\"} 0.0005",
            "panoscope_graph_info{graph=\"a \\\"b\\\"\\n\"} 1",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} is missing in {text}");
        }
    }
}
