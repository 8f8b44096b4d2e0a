//! Everything that is wrong with a graph and its run, each with its place, its cause and what to do: for a tour from one to the next.

use crate::texts::{decimal, text};
use panoscope_engine::fault::{Action, Cause, Fault};
use panoscope_graph::Severity;

use crate::document::Document;
use crate::graph_view::GraphView;
use crate::idle;
use crate::observe::Counters;
use crate::session::{Phase, Status};

/// One problem.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Whether it stops something, and is not only a warning.
    pub is_error: bool,
    /// Where it is, in words: a node, a line.
    pub place: String,
    /// The node to go to.
    pub node: Option<String>,
    /// Line of the graph file, from 1.
    pub line: Option<usize>,
    /// What is wrong.
    pub cause: String,
    /// What to do.
    pub remedy: String,
}

/// All problems: mistakes of the files first, then faults of the run, then nodes that do nothing and ticks that were lost.
pub fn problems(document: &Document, status: &Status, counters: &Counters) -> Vec<Problem> {
    let view = document.view();
    let mut all = Vec::new();
    if let Some(problem) = &status.problem {
        all.push(Problem {
            is_error: true,
            place: problem.node.clone().unwrap_or_else(|| text!("problem-last-change").to_owned()),
            node: problem.node.clone(),
            line: None,
            cause: text!("problem-last-change.cause", reason = &problem.message),
            remedy: text!("problem-last-change.remedy").to_owned(),
        });
    }
    for severity in [Severity::Error, Severity::Warning] {
        for d in view.diagnostics.iter().filter(|d| d.severity == severity) {
            let is_here = d.file == view.file;
            let label = if d.label.is_empty() { String::new() } else { format!(": {}", d.label) };
            let remedy = match (d.help.is_empty(), severity) {
                (false, _) => d.help.clone(),
                (true, Severity::Error) => text!("problem-mistake-remedy").to_owned(),
                (true, _) => text!("problem-warning-remedy").to_owned(),
            };
            all.push(Problem {
                is_error: severity == Severity::Error,
                place: match is_here {
                    true => text!("problem-line", line = d.line),
                    false => text!("problem-line-of", file = &d.file, line = d.line),
                },
                node: view.node_of(d, document.text()),
                line: is_here.then_some(d.line),
                cause: format!("{}{label}", d.message),
                remedy,
            });
        }
    }
    let mut faults: Vec<&Fault> = counters.faults.values().collect();
    faults.sort_by(|a, b| b.unix_ms.cmp(&a.unix_ms).then_with(|| a.node.cmp(&b.node)));
    all.extend(faults.into_iter().map(|fault| Problem {
        is_error: !matches!(fault.done, Action::Note),
        place: fault.node.clone(),
        node: Some(fault.node.clone()),
        line: None,
        cause: text!("problem-fault", reason = &fault.words, count = fault.count),
        remedy: remedy_of(fault).to_owned(),
    }));
    if status.phase == Phase::Running {
        all.extend(idle_nodes(view, counters, status));
        all.extend(losses(view, counters));
    }
    all
}

/// Nodes that do nothing, named where the cause is and not at every node behind it.
fn idle_nodes(view: &GraphView, counters: &Counters, status: &Status) -> Vec<Problem> {
    let nodes = view.flat().nodes.iter().map(|node| node.id());
    let is_known = |id: &&str| !counters.faults.contains_key(*id) && counters.nodes.contains_key(*id);
    let reasons = nodes.filter(is_known).filter_map(|id| Some((id, idle::reason(view, counters, status, id)?)));
    reasons
        .filter(|(_, reason)| reason.cause.is_none())
        .map(|(id, reason)| Problem {
            is_error: false,
            place: id.to_owned(),
            node: Some(id.to_owned()),
            line: None,
            cause: reason.words,
            remedy: text!("problem-idle-remedy").to_owned(),
        })
        .collect()
}

/// Sources whose ticks were dropped, with the node that takes longest.
fn losses(view: &GraphView, counters: &Counters) -> Vec<Problem> {
    let known = view.flat().nodes.iter().filter_map(|node| Some((node.id(), counters.nodes.get(node.id())?)));
    let slowest = known.clone().max_by(|a, b| a.1.p50_ms.total_cmp(&b.1.p50_ms));
    known
        .filter(|(_, counts)| counts.dropped > 0)
        .map(|(id, counts)| Problem {
            is_error: false,
            place: id.to_owned(),
            node: Some(id.to_owned()),
            line: None,
            cause: text!("problem-losses", count = counts.dropped),
            remedy: match slowest {
                Some((slow, times)) => text!("problem-losses-remedy", node = slow, ms = decimal(times.p50_ms, 1)),
                None => text!("problem-losses-remedy-source").to_owned(),
            },
        })
        .collect()
}

/// The kind of a fault.
pub fn cause_name(cause: Cause) -> &'static str {
    match cause {
        Cause::Error => text!("cause-error"),
        Cause::Panic => text!("cause-panic"),
        Cause::Hang => text!("cause-hang"),
        Cause::Open => text!("cause-open"),
        Cause::BadOutput => text!("cause-output"),
        Cause::Format => text!("cause-format"),
        Cause::Size => text!("cause-size"),
        Cause::NotANumber => text!("cause-number"),
        Cause::TooMuch => text!("cause-much"),
        Cause::Exhausted => text!("cause-exhausted"),
        Cause::CaptureTime => text!("cause-times"),
        Cause::Silent => text!("cause-silent"),
        Cause::Slow => text!("cause-slow"),
        Cause::Leak => text!("cause-leak"),
        Cause::Recording => text!("cause-recording"),
        Cause::Release => text!("cause-release"),
        Cause::Crash => text!("cause-crash"),
        Cause::Incomplete => text!("cause-incomplete"),
        Cause::TooOld => text!("cause-old"),
    }
}

/// What was done about a fault.
pub fn action_name(done: Action) -> &'static str {
    match done {
        Action::Restart => text!("after-restart"),
        Action::Abandon => text!("after-abandon"),
        Action::Bypass => text!("after-bypass"),
        Action::Stop => text!("after-stop"),
        Action::End => text!("after-end"),
        Action::Withhold => text!("after-withhold"),
        Action::Note => text!("after-note"),
    }
}

/// What to do about a fault.
fn remedy_of(fault: &Fault) -> &'static str {
    match (fault.cause, fault.done) {
        (_, Action::Stop) => text!("remedy-stop"),
        (_, Action::Bypass) => text!("remedy-bypass"),
        (Cause::Open, _) => text!("remedy-open"),
        (Cause::Panic | Cause::Crash, _) => {
            text!("remedy-panic")
        }
        (Cause::Hang, _) => text!("remedy-hang"),
        (Cause::Slow, _) => text!("remedy-slow"),
        (Cause::Incomplete, _) => text!("remedy-incomplete"),
        (Cause::TooOld, _) => text!("remedy-too-old"),
        (Cause::BadOutput | Cause::NotANumber | Cause::TooMuch | Cause::Format | Cause::Size, _) => {
            text!("remedy-output")
        }
        (Cause::Exhausted | Cause::Leak | Cause::Release, _) => {
            text!("remedy-frames")
        }
        (Cause::CaptureTime, _) => text!("remedy-times"),
        (Cause::Silent, _) => text!("remedy-silent"),
        (Cause::Recording, _) => text!("remedy-recording"),
        (Cause::Error, _) => text!("remedy-error"),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use panoscope_engine::NodeWindow;
    use panoscope_host::loader::Loader;

    use super::*;

    #[test]
    fn each_problem_has_its_place_and_what_to_do() {
        let text = "plugins = [\"nowhere\"]\n[nodes.a]\ntype = \"nothing\"\n";
        let document = Document::new("g.toml".as_ref(), text, Arc::new(Loader::search(&[])));
        let mut counters = Counters::default();
        let fault = Fault {
            unix_ms: 1,
            run_ms: 1.0,
            node: "a".to_owned(),
            cause: Cause::Slow,
            words: "took 9 ms of 5 ms".to_owned(),
            done: Action::Note,
            seq: None,
            late_ms: None,
            count: 4,
        };
        counters.faults.insert("a".to_owned(), fault);
        counters.nodes.insert("a".to_owned(), NodeWindow { dropped: 3, p50_ms: 7.0, ..NodeWindow::default() });
        let status = Status { phase: Phase::Running, ..Status::default() };
        let all = problems(&document, &status, &counters);
        assert!(all.iter().all(|p| !p.cause.is_empty() && !p.remedy.is_empty() && !p.place.is_empty()), "{all:#?}");
        assert!(all.iter().any(|p| p.line == Some(1) && p.is_error), "{all:#?}");
        assert!(all.iter().any(|p| p.cause.contains("took 9 ms") && p.remedy.contains("budget")), "{all:#?}");
        let drops = all.iter().find(|p| p.cause.contains("dropped")).expect("losses are problems");
        assert!(drops.remedy.contains("`a` takes longest (7.0 ms)"), "{}", drops.remedy);
        let errors = all.iter().position(|p| !p.is_error).unwrap_or(0);
        assert!(errors > 0, "mistakes come first");
    }
}
