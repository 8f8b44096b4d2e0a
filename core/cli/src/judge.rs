//! Evaluates a run: its exit code, its errors and warnings, and its last line.
//!
//! The rule: a run is done (exit 0) when every node did its work on every tick that it was given, and every source made
//! the requested ticks. It failed (exit 1) when
//! - a node had faults and the graph does not say `on_fault = "bypass"` for it: each fault is a lost tick, even if the
//!   node was reopened,
//! - a node stopped working, lost what it was to write, or was left behind because it did not return,
//! - a source ended by an error, made no tick, or fewer ticks than `--frames` asks for,
//! - a node never ran because a source never made what it needs, or because its inputs never met,
//! - the engine says so (`on_fault = "stop"`), or the recording of the run has gaps.
//!
//! A run that its user stops is done, unless one of these holds. Ticks dropped in live mode are what live mode is for:
//! they are counted, no more. A node that never ran because another node (a gate, a detector) made nothing is a
//! warning.

use std::collections::BTreeSet;

use panoscope_engine::fault::{Action, Cause, Fault};
use panoscope_engine::{NodeReport, Outcome, Report};

use crate::End;

/// Facts of a finished run.
pub struct Facts<'a> {
    /// Counters of all nodes.
    pub report: &'a Report,
    /// The newest faults, oldest first.
    pub faults: &'a [Fault],
    /// Outcome reported by the engine.
    pub outcome: &'a Outcome,
    /// Nodes whose faults do not fail the run: those with `on_fault = "bypass"`, and those whose faults the command
    /// causes.
    pub bypassed: BTreeSet<&'a str>,
    /// Requested ticks of each source.
    pub frames: Option<u64>,
    /// Name of the signal that ended the run.
    pub stopped_by: Option<String>,
}

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weight {
    /// The run failed because of it.
    Error,
    /// Only reported.
    Warning,
}

/// A finding about a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Severity.
    pub weight: Weight,
    /// Message for the user.
    pub words: String,
}

/// Verdict on a run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// Errors first.
    pub findings: Vec<Finding>,
    frames: u64,
    wanted: Option<u64>,
    seconds: String,
    dropped: u64,
    faults: u64,
    stopped_by: Option<String>,
}

fn plural(count: u64, one: &str) -> String {
    if count == 1 { format!("1 {one}") } else { format!("{count} {one}s") }
}

impl Verdict {
    /// Adds a finding.
    pub fn add(&mut self, weight: Weight, words: String) {
        self.findings.push(Finding { weight, words });
        self.findings.sort_by_key(|f| f.weight != Weight::Error);
    }

    fn error(&mut self, words: String) {
        self.add(Weight::Error, words);
    }

    /// Exit of the command.
    pub fn end(&self) -> End {
        if self.findings.iter().any(|f| f.weight == Weight::Error) { End::Failed } else { End::Done }
    }

    /// The last line: how the run ended, with counts, and the first error.
    pub fn last_line(&self) -> String {
        let how = match (self.end(), &self.stopped_by) {
            (End::Done, None) => "done".to_owned(),
            (End::Done, Some(signal)) => format!("stopped by {signal}"),
            (_, None) => "failed".to_owned(),
            (_, Some(signal)) => format!("failed, stopped by {signal}"),
        };
        let frames = match self.wanted {
            Some(wanted) if wanted != self.frames => format!("{} of {wanted} frames", self.frames),
            _ => plural(self.frames, "frame"),
        };
        let mut line = format!(
            "{how}: {frames} in {} s, {} dropped, {}",
            self.seconds,
            self.dropped,
            plural(self.faults, "fault")
        );
        if let Some(first) = self.findings.iter().find(|f| f.weight == Weight::Error) {
            let others = self.findings.iter().filter(|f| f.weight == Weight::Error).count() as u64 - 1;
            line.push_str(&format!("; {}", first.words.lines().next().unwrap_or_default()));
            if others > 0 {
                line.push_str(&format!(" (and {} more)", plural(others, "error")));
            }
        }
        line
    }
}

/// Message of a node's newest fault.
fn last_words<'a>(faults: &'a [Fault], node: &str) -> &'a str {
    let notes = [Cause::Slow, Cause::Silent, Cause::Incomplete, Cause::TooOld];
    let of_node = |f: &&Fault| f.node == node && !notes.contains(&f.cause);
    faults.iter().rev().find(of_node).map_or("see the lines above", |f| f.words.as_str())
}

/// Evaluates a run.
pub fn judge(facts: &Facts<'_>) -> Verdict {
    let report = facts.report;
    let sources = || report.nodes.iter().filter_map(|(id, node)| Some((id, node.made?)));
    let mut verdict = Verdict {
        findings: Vec::new(),
        frames: sources().map(|(_, made)| made).min().unwrap_or(report.frames),
        wanted: facts.frames,
        seconds: format!("{:.2}", report.seconds),
        dropped: report.nodes.values().map(|n| n.dropped).sum(),
        faults: report.nodes.values().map(|n| n.faults).sum(),
        stopped_by: facts.stopped_by.clone(),
    };
    if facts.frames.is_none() {
        verdict.frames = report.frames;
    }
    if let Outcome::Failed(reason) = facts.outcome {
        verdict.error(reason.clone());
    }
    for (id, node) in &report.nodes {
        faults_of(facts, id, node, &mut verdict);
    }
    for (id, made) in sources() {
        match facts.frames {
            Some(wanted) if made < wanted => {
                verdict.error(format!("source `{id}` made {made} of the {wanted} frames that --frames asks for"));
            }
            _ if made == 0 && facts.stopped_by.is_none() => verdict.error(format!("source `{id}` made no frame")),
            _ => {}
        }
    }
    if report.frames > 0 {
        for (id, node) in report.nodes.iter().filter(|(id, n)| never_ran(n) && !report.stopped.contains_key(*id)) {
            idle(facts, id, node, &mut verdict);
        }
    }
    verdict
}

fn faults_of(facts: &Facts<'_>, id: &str, node: &NodeReport, verdict: &mut Verdict) {
    // Data is lost, whatever the graph says about faults. The faults of the node are part of this finding.
    if let Some(reason) = facts.report.stopped.get(id) {
        verdict.error(format!("node `{id}` lost data: {reason}"));
        return;
    }
    let asked = facts.bypassed.contains(id);
    if node.faults > 0 {
        let times = if node.faults == 1 { "once".to_owned() } else { format!("{} times", node.faults) };
        // A node that never once did its work made the run useless, whatever the graph says about faults.
        let always = node.faults >= node.count;
        let how_often = if always { ", every time it was called" } else { "" };
        let weight = if asked && !always { Weight::Warning } else { Weight::Error };
        verdict.add(weight, format!("node `{id}` failed {times}{how_often}: {}", last_words(facts.faults, id)));
    }
    if node.lacking > 0 {
        let incomplete = facts.faults.iter().rev().find(|f| f.node == id && f.cause == Cause::Incomplete);
        let why = incomplete.and_then(|fault| fault.words.split_once(": "));
        let why = why.map_or_else(String::new, |(_, why)| format!(": {why}"));
        let frames = plural(node.lacking, "frame");
        verdict.add(Weight::Warning, format!("node `{id}` lacks {frames} of its source{why}"));
    }
    for wire in &node.too_old_on {
        let (input, ticks) = (&wire.input, plural(wire.ticks, "tick"));
        let message = format!("node `{id}` went on without input `{input}` at {ticks}: it was older than `max_age_ms`");
        verdict.add(Weight::Warning, message);
    }
    if let Some(fault) = facts.faults.iter().rev().find(|f| f.node == id && f.done == Action::Bypass) {
        verdict.add(Weight::Warning, format!("node `{id}` was bypassed: {}", fault.words));
    }
}

/// Whether a node never ran. Sources are evaluated by their ticks; failures and bypasses are reported elsewhere.
fn never_ran(node: &NodeReport) -> bool {
    node.count == 0 && node.made.is_none() && node.faults == 0 && !node.muted
}

fn idle(facts: &Facts<'_>, id: &str, node: &NodeReport, verdict: &mut Verdict) {
    // The reason why a waiting node never ran is reported at the first node that made nothing.
    let maker = |output: &String| facts.report.nodes.get(output.split('.').next().unwrap_or_default());
    let from_source: Vec<&str> =
        node.never_got.iter().filter(|o| maker(o).is_some_and(|m| m.made.is_some())).map(String::as_str).collect();
    let from_idle = node.never_got.iter().any(|o| maker(o).is_none_or(|m| m.made.is_none() && m.count == 0));
    if !from_source.is_empty() {
        let outputs = from_source.iter().map(|o| format!("`{o}`")).collect::<Vec<_>>().join(", ");
        verdict.error(format!("node `{id}` never ran: {outputs} returned no packet"));
        return;
    }
    if from_idle {
        return;
    }
    match node.never_got.first() {
        Some(output) => verdict.add(Weight::Warning, format!("node `{id}` never ran: `{output}` made nothing")),
        None => {
            // A run that was stopped early may not have come so far.
            let weight = if facts.stopped_by.is_some() { Weight::Warning } else { Weight::Error };
            verdict.add(weight, format!("node `{id}` never ran: its inputs never came together"));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use panoscope_engine::{Machine, WireTooOld};

    use super::*;

    fn node(count: u64, made: Option<u64>) -> NodeReport {
        NodeReport {
            count,
            p50_ms: 0.0,
            p99_ms: 0.0,
            max_ms: 0.0,
            dropped: 0,
            lacking: 0,
            dropped_on: Vec::new(),
            too_old_on: Vec::new(),
            skipped: 0,
            faults: 0,
            restarts: 0,
            over_budget: 0,
            recovery_max_ms: 0.0,
            copies: 0,
            copied_mb: 0.0,
            conversions: 0,
            allocations: None,
            made,
            never_got: Vec::new(),
            muted: false,
            metrics: BTreeMap::new(),
        }
    }

    /// `camera` (60 frames) and `sink`.
    fn report(change: impl FnOnce(&mut BTreeMap<String, NodeReport>)) -> Report {
        let mut nodes = BTreeMap::new();
        nodes.insert("camera".to_owned(), node(61, Some(60)));
        nodes.insert("sink".to_owned(), node(60, None));
        change(&mut nodes);
        Report {
            graph: "g".to_owned(),
            frames: nodes.values().filter_map(|n| n.made).max().unwrap_or(0),
            seconds: 2.0,
            fps: 30.0,
            nodes,
            paths: BTreeMap::new(),
            groups: BTreeMap::new(),
            stopped: BTreeMap::new(),
            allocations_per_frame: None,
            machine: Machine { cpu: String::new(), cores: 1, threads: 1, os: String::new() },
        }
    }

    fn facts(report: &Report) -> Facts<'_> {
        Facts {
            report,
            faults: &[],
            outcome: &Outcome::Done,
            bypassed: BTreeSet::new(),
            frames: None,
            stopped_by: None,
        }
    }

    #[test]
    fn a_whole_run_is_done_and_a_stopped_one_says_by_what() {
        let report = report(|nodes| nodes.get_mut("camera").expect("there").dropped = 3);
        let verdict = judge(&facts(&report));
        assert_eq!((verdict.end(), verdict.findings.len()), (End::Done, 0), "drops of a live run are no failure");
        assert_eq!(verdict.last_line(), "done: 60 frames in 2.00 s, 3 dropped, 0 faults");
        let stopped = judge(&Facts { stopped_by: Some("SIGTERM".to_owned()), ..facts(&report) });
        assert_eq!(stopped.end(), End::Done);
        assert_eq!(stopped.last_line(), "stopped by SIGTERM: 60 frames in 2.00 s, 3 dropped, 0 faults");
    }

    #[test]
    fn a_recorder_that_lacks_frames_is_named_with_the_reason() {
        let report = report(|nodes| nodes.get_mut("sink").expect("there").lacking = 58);
        let words =
            "it lacks 32 frames of `camera` so far: `slow` takes 200.0 ms; let `slow` read with align = \"latest\"";
        let fault = Fault {
            unix_ms: 0,
            run_ms: 0.0,
            node: "sink".to_owned(),
            cause: Cause::Incomplete,
            words: words.to_owned(),
            done: Action::Note,
            seq: Some(1),
            late_ms: None,
            count: 32,
        };
        let verdict = judge(&Facts { faults: &[fault], ..facts(&report) });
        assert_eq!((verdict.end(), verdict.findings[0].weight), (End::Done, Weight::Warning));
        assert_eq!(
            verdict.findings[0].words,
            "node `sink` lacks 58 frames of its source: `slow` takes 200.0 ms; let `slow` read with align = \"latest\""
        );
    }

    #[test]
    fn an_input_that_was_too_old_is_a_warning() {
        let wire = WireTooOld { input: "depth".to_owned(), index: 0, ticks: 7 };
        let report = report(|nodes| nodes.get_mut("sink").expect("there").too_old_on.push(wire));
        let verdict = judge(&facts(&report));
        assert_eq!((verdict.end(), verdict.findings[0].weight), (End::Done, Weight::Warning));
        let message = "node `sink` went on without input `depth` at 7 ticks: it was older than `max_age_ms`";
        assert_eq!(verdict.findings[0].words, message);
    }

    #[test]
    fn faults_fail_a_run_unless_they_were_to_be_bypassed() {
        let report = report(|nodes| nodes.get_mut("sink").expect("there").faults = 59);
        let fault = Fault {
            unix_ms: 0,
            run_ms: 0.0,
            node: "sink".to_owned(),
            cause: Cause::Error,
            words: "no memory".to_owned(),
            done: Action::Restart,
            seq: Some(1),
            late_ms: None,
            count: 1,
        };
        let faults = [fault];
        let verdict = judge(&Facts { faults: &faults, ..facts(&report) });
        assert_eq!(verdict.end(), End::Failed);
        assert_eq!(
            verdict.last_line(),
            "failed: 60 frames in 2.00 s, 0 dropped, 59 faults; node `sink` failed 59 times: no memory"
        );
        let asked = judge(&Facts { faults: &faults, bypassed: BTreeSet::from(["sink"]), ..facts(&report) });
        assert_eq!((asked.end(), asked.findings[0].weight), (End::Done, Weight::Warning));
        let report = self::report(|nodes| nodes.get_mut("sink").expect("there").faults = 60);
        let asked = judge(&Facts { bypassed: BTreeSet::from(["sink"]), ..facts(&report) });
        assert_eq!(asked.end(), End::Failed, "it never once did its work");
    }

    #[test]
    fn fewer_frames_than_asked_for_are_a_failure_also_when_stopped() {
        let report = report(|_| ());
        assert_eq!(judge(&Facts { frames: Some(60), ..facts(&report) }).end(), End::Done);
        let verdict = judge(&Facts { frames: Some(100), ..facts(&report) });
        assert_eq!(verdict.end(), End::Failed);
        assert!(verdict.last_line().starts_with("failed: 60 of 100 frames in"), "{}", verdict.last_line());
        let stopped = judge(&Facts { frames: Some(100), stopped_by: Some("SIGINT".to_owned()), ..facts(&report) });
        assert!(stopped.last_line().starts_with("failed, stopped by SIGINT: 60 of 100"), "{}", stopped.last_line());
        // The slower of two sources counts.
        let report = self::report(|nodes| drop(nodes.insert("other".to_owned(), node(11, Some(10)))));
        let verdict = judge(&Facts { frames: Some(60), ..facts(&report) });
        assert!(verdict.last_line().contains("10 of 60") && verdict.last_line().contains("`other`"));
        let nothing = self::report(|nodes| nodes.get_mut("camera").expect("there").made = Some(0));
        assert_eq!(judge(&facts(&nothing)).end(), End::Failed);
    }

    #[test]
    fn a_node_that_stopped_or_never_ran_is_named_where_it_began() {
        let mut stopped = report(|_| ());
        stopped.stopped.insert("sink".to_owned(), "the disk is full".to_owned());
        let verdict = judge(&facts(&stopped));
        assert_eq!((verdict.end(), verdict.findings.len()), (End::Failed, 1));
        assert_eq!(verdict.findings[0].words, "node `sink` lost data: the disk is full");
        // Also where the graph allows a bypass, and only once.
        stopped.nodes.get_mut("sink").expect("there").faults = 1;
        let verdict = judge(&Facts { bypassed: BTreeSet::from(["sink"]), ..facts(&stopped) });
        assert_eq!((verdict.end(), verdict.findings.len()), (End::Failed, 1));

        let idle = report(|nodes| {
            let waiting = |output: &str| NodeReport { never_got: vec![output.to_owned()], ..node(0, None) };
            nodes.insert("wide".to_owned(), waiting("camera.right"));
            nodes.insert("file".to_owned(), waiting("wide.panorama"));
        });
        let verdict = judge(&facts(&idle));
        assert_eq!((verdict.end(), verdict.findings.len()), (End::Failed, 1), "{:?}", verdict.findings);
        assert!(verdict.findings[0].words.contains("`wide` never ran: `camera.right`"), "{:?}", verdict.findings);

        // What a gate keeps back is kept back on purpose.
        let shut = report(|nodes| {
            nodes.insert("gate".to_owned(), node(60, None));
            nodes.insert("file".to_owned(), NodeReport { never_got: vec!["gate.image".to_owned()], ..node(0, None) });
        });
        let verdict = judge(&facts(&shut));
        assert_eq!((verdict.end(), verdict.findings[0].weight), (End::Done, Weight::Warning));
        let apart = report(|nodes| drop(nodes.insert("join".to_owned(), node(0, None))));
        assert_eq!(judge(&facts(&apart)).end(), End::Failed, "its inputs never met");
        let muted = report(|nodes| drop(nodes.insert("file".to_owned(), NodeReport { muted: true, ..node(0, None) })));
        assert_eq!(judge(&facts(&muted)).end(), End::Done);
    }

    #[test]
    fn what_the_engine_says_comes_first() {
        let report = report(|nodes| nodes.get_mut("sink").expect("there").faults = 1);
        let outcome = Outcome::Failed("node `sink` failed and the graph says on_fault = \"stop\"".to_owned());
        let verdict = judge(&Facts { outcome: &outcome, ..facts(&report) });
        assert!(verdict.last_line().ends_with("on_fault = \"stop\" (and 1 error more)"), "{}", verdict.last_line());
    }
}
