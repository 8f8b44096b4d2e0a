//! Invariants that must hold after a run.

use std::collections::{BTreeMap, BTreeSet};

use crate::engine::Outcome;
use crate::engine::fault::Cause;

use crate::content::{Content, name_hash};
use crate::drive::{Done, Ran, Version};
use crate::graphs::{Kind, Node};
use crate::harm::Harm;
use crate::observe::Seen;

/// Maximum number of failures reported per run.
const MAX_FAILURES: usize = 8;

/// A call of a node.
struct Call<'a> {
    node: &'a str,
    seq: u64,
    inputs: &'a [Content],
}

/// Checks a run. Returns the violated invariants.
pub fn check(done: &Done) -> Vec<String> {
    let mut failures = Vec::new();
    let ran = match &done.ended.result {
        Ok(ran) => ran,
        Err(trouble) => {
            let left: Vec<_> =
                done.ended.left.iter().map(|left| format!("`{}` waits for {}", left.name, left.waits_for)).collect();
            return vec![format!("{trouble:?} after {} decisions; {}", done.ended.decisions, left.join(", "))];
        }
    };
    failures.extend(ran.failures.iter().cloned());
    for seen in &done.seen {
        if let Seen::Wrong { node, words } = seen {
            failures.push(format!("`{node}`: {words}"));
        }
    }
    if !ran.versions.is_empty() {
        let checks = Checks { done, ran };
        checks.order(&mut failures);
        checks.ways(&mut failures);
        checks.values(&mut failures);
        checks.losses(&mut failures);
        checks.faults(&mut failures);
        checks.files(&mut failures);
        checks.end(&mut failures);
    }
    if done.kept_bytes != 0 {
        failures.push(format!("{} bytes of frame memory were not given back", done.kept_bytes));
    }
    if let [first, ..] = &done.ended.left[..] {
        failures.push(format!(
            "{} threads never end: `{}` waits for {}",
            done.ended.left.len(),
            first.name,
            first.waits_for
        ));
    }
    failures.truncate(MAX_FAILURES);
    failures
}

struct Checks<'a> {
    done: &'a Done,
    ran: &'a Ran,
}

impl<'a> Checks<'a> {
    fn calls(&self) -> impl Iterator<Item = Call<'a>> {
        self.done.seen.iter().filter_map(|seen| match seen {
            Seen::Called { node, seq, inputs, .. } => Some(Call { node, seq: *seq, inputs }),
            _ => None,
        })
    }

    /// A node by name in any version of the graph.
    fn node(&self, id: &str) -> Option<&'a Node> {
        self.ran.versions.iter().find_map(|version| version.model.node(id))
    }

    fn culprit(&self) -> Option<&'a Node> {
        self.done.case.culprit()
    }

    /// Whether nodes may miss ticks because memory is short.
    fn is_short_of_memory(&self) -> bool {
        self.done.case.pinch_bytes.is_some() && self.done.case.edits > 0
    }

    /// Whether no node upstream misbehaves, in any version.
    fn is_healthy(&self, id: &str) -> bool {
        let versions = self.ran.versions.iter().filter(|v| v.model.node(id).is_some());
        versions.clone().all(|v| v.model.is_healthy(id))
            && !(self.done.case.disk_fails() && self.node(id).is_some_and(|n| n.kind == Kind::Write))
    }

    /// The version of the graph that a tick of a source met.
    fn version_at(&self, source: &str, seq: u64) -> &'a Version {
        let mut current = &self.ran.versions[0];
        let mut structural = true;
        for version in &self.ran.versions {
            let first = version.switched_at.iter().find(|(id, _)| id == source);
            match first {
                Some((_, first)) if *first > seq => structural = false,
                Some(_) => structural = true,
                // The change did not touch the ticks of this source.
                None => {}
            }
            if structural {
                current = version;
            }
        }
        current
    }

    /// Each node sees each tick once, in order.
    fn order(&self, failures: &mut Vec<String>) {
        let mut last: BTreeMap<&str, u64> = BTreeMap::new();
        for call in self.calls() {
            if self.node(call.node).is_none_or(|node| node.latest) {
                continue;
            }
            if let Some(before) = last.insert(call.node, call.seq)
                && before >= call.seq
            {
                failures.push(format!("`{}` saw tick {} after tick {before}", call.node, call.seq));
            }
        }
    }

    /// Each frame came by the edges of the graph that its tick met, and by no others.
    fn ways(&self, failures: &mut Vec<String>) {
        for call in self.calls() {
            for (at, content) in call.inputs.iter().enumerate() {
                let fits = |version: &Version| {
                    version
                        .model
                        .node(call.node)
                        .and_then(|node| node.inputs.get(at))
                        .is_some_and(|from| version.model.fits(from, &content.steps))
                };
                let source = self.ran.versions.iter().find_map(|v| v.model.source_of(call.node));
                let right = match source {
                    Some(source) => fits(self.version_at(source, call.seq)),
                    // A reader that takes the newest has ticks of its own.
                    None => self.ran.versions.iter().any(fits),
                };
                if !right {
                    let way: Vec<String> = content.steps.iter().map(|step| self.name(step.node)).collect();
                    failures.push(format!("tick {} came to `{}` by the way {}", call.seq, call.node, way.join(" > ")));
                }
            }
        }
    }

    fn name(&self, hash: u32) -> String {
        let mut nodes = self.ran.versions.iter().flat_map(|v| &v.model.nodes);
        nodes.find(|node| name_hash(&node.id) == hash).map_or_else(|| format!("{hash:#x}"), |node| node.id.clone())
    }

    /// At each tick a node has the same values for all readers: only values that were set, never older ones than before, and the last ones at the
    /// end.
    fn values(&self, failures: &mut Vec<String>) {
        let mut found: BTreeMap<(u32, u64), u32> = BTreeMap::new();
        for call in self.calls() {
            for content in call.inputs {
                for step in &content.steps {
                    let first = *found.entry((step.node, content.seq)).or_insert(step.values);
                    if first != step.values {
                        let name = self.name(step.node);
                        failures.push(format!("`{name}` had two kinds of values at tick {}", content.seq));
                    }
                }
            }
        }
        let mut newest: BTreeMap<u32, (usize, u64)> = BTreeMap::new();
        for ((node, seq), values) in found {
            let name = self.name(node);
            let known = self.ran.values.get(&name).map_or(&[][..], Vec::as_slice);
            let Some(index) = known.iter().rposition(|known| *known == values) else {
                failures.push(format!("`{name}` had values {values:#x} at tick {seq}, which nobody set: {known:x?}"));
                continue;
            };
            if let Some((before, _)) = newest.insert(node, (index, seq))
                && before > index
            {
                failures.push(format!("`{name}` had old values again at tick {seq}"));
            }
        }
        let Some(last) = self.ran.versions.last() else { return };
        // Ticks of a batch run may be over before the change.
        if self.done.case.model.batch || self.is_short_of_memory() || !self.is_done() {
            return;
        }
        for node in last.model.nodes.iter().filter(|n| n.kind.adds_step() && self.is_healthy(&n.id)) {
            let known = self.ran.values.get(&node.id).map_or(0, Vec::len);
            let Some((index, seq)) = newest.get(&name_hash(&node.id)) else { continue };
            // Where its readers failed, nobody saw its last picture.
            let called = self.calls().filter(|call| call.node == node.id).map(|call| call.seq).max();
            if index + 1 != known && called == Some(*seq) {
                failures.push(format!("`{}` still had old values at its last tick, {seq}", node.id));
            }
        }
    }

    fn is_done(&self) -> bool {
        self.ran.outcome == Some(Outcome::Done)
    }

    /// Each tick of a source reaches all healthy nodes, or was dropped before the first one and counted.
    fn losses(&self, failures: &mut Vec<String>) {
        if self.is_short_of_memory() || !self.is_done() {
            return;
        }
        let mut seen: BTreeMap<&str, BTreeSet<u64>> = BTreeMap::new();
        for call in self.calls() {
            seen.entry(call.node).or_default().insert(call.seq);
        }
        let mut made: BTreeMap<&str, BTreeSet<u64>> = BTreeMap::new();
        for entry in &self.done.seen {
            if let Seen::Made { node, seq } = entry {
                made.entry(node).or_default().insert(*seq);
            }
        }
        let (none, report) = (BTreeSet::new(), self.ran.report.as_ref());
        let ids: BTreeSet<&str> =
            self.ran.versions.iter().flat_map(|v| &v.model.nodes).map(|node| node.id.as_str()).collect();
        for id in ids {
            let source = self.ran.versions.iter().find_map(|v| v.model.source_of(id));
            let Some(source) = source.filter(|source| *source != id) else { continue };
            if !self.is_healthy(id) {
                continue;
            }
            let (made, seen) = (made.get(source).unwrap_or(&none), seen.get(id).unwrap_or(&none));
            let there = |seq: &u64| self.version_at(source, *seq).model.node(id).is_some();
            if let Some(seq) = seen.iter().find(|seq| !there(seq)) {
                failures.push(format!("`{id}` saw tick {seq}, when it was not part of the graph"));
            }
            let dropped = report.and_then(|report| report.nodes.get(source)).map_or(0, |node| node.dropped);
            if self.done.case.observed {
                let dropped = |seq: &u64| self.ran.dropped.iter().any(|(node, n)| node == source && n == seq);
                let lost: Vec<u64> =
                    made.iter().copied().filter(|s| there(s) && !dropped(s) && !seen.contains(s)).collect();
                if let Some(first) = lost.first() {
                    failures.push(format!(
                        "{} ticks from {first} on never came to `{id}`, and nothing counted them",
                        lost.len()
                    ));
                }
                if let Some(seq) = seen.iter().find(|s| dropped(s)) {
                    failures.push(format!("tick {seq} came to `{id}` although it was dropped"));
                }
            } else if self.ran.versions.iter().all(|v| v.model.node(id).is_some())
                && (made.len() as u64) != dropped + seen.len() as u64
            {
                let (made, seen) = (made.len(), seen.len());
                failures.push(format!("`{source}` made {made} ticks, {dropped} were dropped, `{id}` saw {seen}"));
            }
            if self.done.case.model.batch && dropped > 0 {
                failures.push(format!("`{source}` dropped {dropped} ticks in batch mode"));
            }
        }
    }

    /// Only the misbehaving node is reported, or one that failed because of it.
    fn faults(&self, failures: &mut Vec<String>) {
        let culprit = self.culprit();
        for fault in &self.ran.faults {
            let node = self.node(&fault.node);
            let guilty = culprit.is_some_and(|culprit| culprit.id == fault.node);
            let starved = fault.cause == Cause::Exhausted && self.is_short_of_memory();
            let unwritten = self.done.case.disk_fails() && node.is_some_and(|node| node.kind == Kind::Write);
            let threadless = self.done.case.is_short_of_threads() && fault.words.contains("no thread");
            // Two pictures of one tick have two sizes.
            let sizes = culprit.and_then(|c| c.trouble.as_ref()).is_some_and(|t| t.harm == Harm::WrongSize)
                && node.is_some_and(|node| {
                    node.kind == Kind::Pair
                        || self
                            .ran
                            .versions
                            .iter()
                            .any(|v| v.model.node(&node.id).is_some_and(|n| n.kind == Kind::Pair))
                });
            if !(guilty || starved || threadless || unwritten || sizes || fault.cause == Cause::Size) {
                failures.push(format!("an innocent node was named: {fault:?}"));
            }
        }
    }

    /// What a sink has written and completed is on the disk.
    fn files(&self, failures: &mut Vec<String>) {
        let disk = &self.done.disk;
        let mut wrote: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
        let mut finished: BTreeSet<&str> = BTreeSet::new();
        for seen in &self.done.seen {
            match seen {
                Seen::Wrote { file, seq, .. } => wrote.entry(file).or_default().push(*seq),
                Seen::Finished { file, .. } => _ = finished.insert(file),
                _ => {}
            }
        }
        for (file, numbers) in &wrote {
            let bytes = disk.read(file).unwrap_or_default();
            let there: Vec<u64> =
                bytes.chunks(8).filter_map(|n| Some(u64::from_le_bytes(n.try_into().ok()?))).collect();
            if there != *numbers || !bytes.len().is_multiple_of(8) {
                failures.push(format!(
                    "file {file} has {} numbers in {} bytes, {} were written",
                    there.len(),
                    bytes.len(),
                    numbers.len()
                ));
            }
        }
        // Every tick that a healthy sink processed is in a completed file.
        for id in self.sinks() {
            let of = |file: &&str| file.rsplit_once('-').is_some_and(|(name, _)| name == id);
            let unfinished = wrote.keys().filter(|file| of(file) && !finished.contains(**file)).count();
            if unfinished > 0 {
                failures.push(format!("{unfinished} files of `{id}` were not completed"));
            }
            let numbers: BTreeSet<u64> =
                wrote.iter().filter(|(file, _)| of(file)).flat_map(|(_, n)| n.iter().copied()).collect();
            let missing = self.calls().find(|call| call.node == id && !numbers.contains(&call.seq));
            if let Some(call) = missing {
                failures.push(format!("tick {} of `{id}` was not written", call.seq));
            }
        }
    }

    /// Sinks that write and do not misbehave.
    fn sinks(&self) -> BTreeSet<&'a str> {
        let nodes = self.ran.versions.iter().flat_map(|v| &v.model.nodes);
        let writes = |node: &&Node| node.kind == Kind::Write && node.trouble.is_none();
        let ids = nodes.filter(writes).map(|node| node.id.as_str());
        if self.done.case.disk_fails() { BTreeSet::new() } else { ids.collect() }
    }

    /// The run ends as the graph states, and every loss of data is reported.
    fn end(&self, failures: &mut Vec<String>) {
        let stops = self.done.case.stops();
        match &self.ran.outcome {
            Some(Outcome::Failed(reason))
                if self.done.case.is_short_of_threads() && reason.contains("no thread could be started") => {}
            Some(Outcome::Failed(reason)) if !stops => failures.push(format!("the run failed: {reason}")),
            Some(Outcome::Failed(reason)) => {
                let culprit = self.culprit().map_or("", |node| &node.id);
                if !reason.contains(&format!("`{culprit}`")) {
                    failures.push(format!("the run failed without the name of `{culprit}`: {reason}"));
                }
            }
            Some(Outcome::Done) => {}
            None => failures.push("the run has no outcome".to_owned()),
        }
        if let Some(line) = self.ran.log.iter().find(|line| line.contains("panicked") && line.starts_with("engine")) {
            failures.push(line.clone());
        }
        let unwritten = self.ran.faults.iter().any(|f| self.node(&f.node).is_some_and(|n| n.kind == Kind::Write));
        if let Some(report) = &self.ran.report {
            let innocent = |id: &&String| self.culprit().is_none_or(|culprit| culprit.id != **id);
            let lost =
                report.stopped.keys().find(innocent).filter(|_| !self.ran.hung_edit && !self.done.case.disk_fails());
            if let Some(id) = lost {
                failures.push(format!("`{id}` lost data: {}", report.stopped[id]));
            }
            let full = self.done.case.disk.capacity_bytes.is_some() && unwritten;
            if full && report.stopped.is_empty() {
                failures.push("the disk became full, and the report does not say so".to_owned());
            }
        }
    }
}
