//! The campaign of edits: seeded changes of nodes that read by every kind of edge from slow and fast producers, in
//! regions of their own, in processes of their own. The engine never panics, and every packet is used or counted as
//! dropped by its edge.
//!
//! `PANOSCOPE_EDIT_CASES` sets how many cases are run (12 without it), `PANOSCOPE_EDIT_SEED` which.

use std::fmt::Write as _;
use std::path::PathBuf;

use crate::common::{PATIENCE, ledger, loader, number, scratch};
use panoscope_base::random::SplitMix64;
use panoscope_engine::fault::Cause;
use panoscope_engine::{Options, Outcome, Report};
use panoscope_graph::GraphText;
use panoscope_host::loader::graph_file::ready_with;

/// Changes of a case.
const EDITS: usize = 16;

/// A node that reads one packet by a `latest` input and passes it on.
#[derive(Clone)]
struct Reader {
    kind: &'static str,
    /// `cpu` or `isolate` of the node.
    policy: &'static str,
    queue: usize,
}

impl Reader {
    fn text(&self, id: &str, from: &str) -> String {
        let Self { kind, policy, queue } = self;
        format!(
            "[nodes.{id}]\ntype = \"{kind}\"\n{policy}\n\
             inputs = {{ image = {{ from = \"{from}\", align = \"latest\", queue = {queue} }} }}\n\
             [nodes.{id}_end]\ntype = \"drain\"\ninputs = {{ image = {{ from = \"{id}.image\", queue = 200 }} }}\n"
        )
    }

    fn change(&mut self, dice: &mut SplitMix64, policies: &[&'static str]) {
        match dice.below(3) {
            0 => self.kind = ["pass", "gate", "pass_blocking"][dice.below(3)],
            1 => self.policy = policies[dice.below(policies.len())],
            _ => self.queue = 1 + dice.below(8),
        }
    }
}

/// The graph of a case. Sources `a` and `b` run at rates of their own; `slow` and `quick` read `b` and `a` by exact
/// edges.
struct Case {
    rates_hz: [f64; 2],
    /// Time of a call of `slow` in ms.
    slow_ms: f64,
    /// Read from `slow`, from `quick`, and from a source.
    readers: [Reader; 3],
    /// How the ledger, which is fired by each tick of `a`, reads `slow`.
    align: &'static str,
    ledger_cpu: &'static str,
    /// Each ledger writes a file of its own.
    ledgers: Vec<PathBuf>,
    name: String,
}

const ALIGNS: [&str; 3] =
    ["align = \"latest\"", "align = \"nearest\", tolerance_ms = 40", "align = \"latest\", delay = 1"];
const CPUS: [&str; 3] = ["", "cpu = 0", "cpu = 1"];

impl Case {
    fn new(number: usize, dice: &mut SplitMix64) -> Self {
        let reader = Reader { kind: "pass", policy: "", queue: 1 };
        let mut case = Self {
            rates_hz: [[60.0, 200.0, 500.0][dice.below(3)], [30.0, 60.0][dice.below(2)]],
            slow_ms: [0.0, 8.0, 30.0, 80.0][dice.below(4)],
            readers: [reader.clone(), reader.clone(), reader],
            align: ALIGNS[dice.below(3)],
            ledger_cpu: "",
            ledgers: Vec::new(),
            name: format!("edits-{number}"),
        };
        case.replace_ledger(dice);
        case
    }

    fn replace_ledger(&mut self, dice: &mut SplitMix64) {
        let before = self.ledger_cpu;
        while self.ledger_cpu == before {
            self.ledger_cpu = CPUS[dice.below(CPUS.len())];
        }
        self.ledgers.push(scratch(&format!("{}-{}.jsonl", self.name, self.ledgers.len())));
    }

    fn change(&mut self, dice: &mut SplitMix64, policies: &[&'static str]) {
        for _ in 0..1 + dice.below(2) {
            match dice.below(6) {
                index @ 0..=2 => self.readers[index].change(dice, policies),
                3 => {
                    self.align = ALIGNS[dice.below(3)];
                    self.replace_ledger(dice);
                }
                4 => self.replace_ledger(dice),
                _ => self.slow_ms = [0.0, 8.0, 30.0, 80.0][dice.below(4)],
            }
        }
    }

    fn text(&self) -> String {
        let mut text = "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n".to_owned();
        for (id, rate_hz) in ["a", "b"].into_iter().zip(self.rates_hz) {
            let size = "width_px = 16, height_px = 8, format = \"gray8\"";
            let _ = write!(text, "[nodes.{id}]\ntype = \"frames\"\nparams = {{ {size}, rate_hz = {rate_hz:?} }}\n");
        }
        let _ = write!(
            text,
            "[nodes.slow]\ntype = \"pass_blocking\"\ninputs = {{ image = \"b.image\" }}\nparams = {{ wait_ms = {:?} }}\n\
             [nodes.quick]\ntype = \"pass\"\ninputs = {{ image = {{ from = \"a.image\", queue = 20 }} }}\n",
            self.slow_ms
        );
        let from = [("of_slow", "slow.image"), ("of_quick", "quick.image"), ("of_source", "a.image")];
        for (reader, (id, from)) in self.readers.iter().zip(from) {
            text += &reader.text(id, from);
        }
        let path = self.ledgers.last().expect("one ledger");
        let _ = write!(
            text,
            "[nodes.book]\ntype = \"ledger\"\n{}\nparams = {{ path = \"{}\" }}\n\
             inputs = {{ images = [{{ from = \"a.image\", queue = 20 }}, {{ from = \"slow.image\", {} }}] }}\n",
            self.ledger_cpu,
            path.display(),
            self.align
        );
        text
    }
}

/// What was made, used and dropped.
fn account(report: &Report, case: &Case) -> Result<(), String> {
    let node = |id: &str| &report.nodes[id];
    let made = |source: &str| node(source).count - node(source).dropped;
    for (id, made) in [("of_slow", made("b")), ("of_quick", made("a")), ("of_source", made("a"))] {
        let used = node(&format!("{id}_end")).count;
        let dropped: u64 = node(id).dropped_on.iter().map(|wire| wire.dropped).sum();
        if used + dropped != made {
            return Err(format!("`{id}`: of {made} packets {used} were used and {dropped} dropped"));
        }
    }
    let lines: Vec<_> = case.ledgers.iter().filter(|path| path.exists()).flat_map(|path| ledger(path)).collect();
    if lines.len() as u64 != made("a") {
        return Err(format!("of {} ticks the ledgers have {}", made("a"), lines.len()));
    }
    if !lines.is_sorted_by(|one, next| one.0 < next.0) {
        return Err(format!("a tick came twice or too late: {lines:?}"));
    }
    match lines.iter().find(|(seq, inputs)| inputs[0] != Some(*seq)) {
        Some(line) => Err(format!("an exact input of another tick: {line:?}")),
        None => Ok(()),
    }
}

fn run(number: usize, seed: u64, policies: &[&'static str]) -> Result<(), String> {
    let mut dice = SplitMix64(seed.wrapping_mul(1_000_003).wrapping_add(number as u64));
    let mut case = Case::new(number, &mut dice);
    let text = GraphText::parse("campaign.toml".as_ref(), &case.text());
    let ready = ready_with(&text, loader()).map_err(|d| d.render(false))?;
    let options = Options { threads: 2, hang: PATIENCE, ..Options::default() };
    let mut live = ready.start(options).map_err(|e| e.to_string())?;
    for edit in 0..EDITS {
        // At any time of a call of `slow`.
        std::thread::sleep(std::time::Duration::from_micros(dice.below(40_000) as u64));
        let before = case.text();
        case.change(&mut dice, policies);
        live.apply_text(&case.text())
            .map_err(|error| format!("edit {edit}: {error}\nfrom\n{before}to\n{}", case.text()))?;
    }
    live.engine().stop();
    if !live.engine().wait(Some(PATIENCE)) {
        return Err(format!("it does not end: {:#?}", live.engine().report()));
    }
    if let Outcome::Failed(reason) = live.engine().close(PATIENCE) {
        return Err(reason);
    }
    // A ledger that waits for `slow` by `delay` is too slow for `a`.
    let faults = live.engine().recent_faults();
    if let Some(fault) = faults.iter().find(|fault| fault.cause != Cause::Incomplete) {
        return Err(format!("{fault:?}"));
    }
    account(&live.engine().report(), &case)
}

/// Whether the program that runs isolated nodes is there.
fn has_program() -> bool {
    let test = std::env::current_exe().expect("a test has a file");
    test.parent().and_then(|folder| folder.parent()).is_some_and(|folder| folder.join("panoscope").is_file())
}

#[test]
fn edits_at_any_time_over_every_kind_of_edge_lose_nothing() {
    let (cases, seed) = (number("PANOSCOPE_EDIT_CASES", 12) as usize, number("PANOSCOPE_EDIT_SEED", 1));
    let policies: &[&str] = if has_program() {
        &["", "cpu = 0", "isolate = \"group\"", "isolate = \"other\""]
    } else {
        println!("without isolated nodes: the program `panoscope` is not built");
        &CPUS
    };
    let failures: Vec<String> = (0..cases)
        .filter_map(|case| run(case, seed, policies).err().map(|reason| format!("case {case}: {reason}")))
        .collect();
    assert!(failures.is_empty(), "{} of {cases}: {}", failures.len(), failures.join("\n"));
}
