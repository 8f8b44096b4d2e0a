//! The simulator's campaign, and checks of the simulator itself: runs repeat exactly, and defects in the engine are found.
//!
//! `PANOSCOPE_SIM_CASES` sets how many cases are run (200 without it), `PANOSCOPE_SIM_SEED` the first seed.

use std::ops::Range;
use std::process::{Command, Output};
use std::sync::Mutex;

use panoscope_sim::case::Case;
use panoscope_sim::check::check;
use panoscope_sim::drive::{Done, play};
use panoscope_sim::observe::Seen;

/// Number of seeds per process: threads of a failed run stay until its process ends.
const SEEDS_AT_ONCE: u64 = 50;
/// Maximum number of cases in which a defect in the engine must be found.
const CASES_FOR_A_MUTATION: u64 = 400;
/// First seed of the search for defects that few cases show; 1 for all others. A search from 1 takes half a minute.
const FIRST_SEEDS: [(&str, u64); 3] =
    [("go-on-after-abandon", 187), ("abandon-without-skip", 72), ("release-what-is-not-held", 105)];

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

fn simulate(seeds: Range<u64>, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope-sim"));
    command.arg(format!("{}..{}", seeds.start, seeds.end)).args(args);
    command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"))
}

fn text(output: &Output) -> String {
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    format!("{out}{err}")
}

/// Processes each item, as many at a time as there are processors.
fn in_parallel<T: Send, R: Send>(items: Vec<T>, work: impl Fn(T) -> R + Sync) -> Vec<R> {
    let jobs = std::thread::available_parallelism().map_or(1, usize::from);
    let (todo, done) = (Mutex::new(items.into_iter().enumerate()), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                loop {
                    let next = todo.lock().expect("no panic").next();
                    let Some((at, item)) = next else { return };
                    let result = work(item);
                    done.lock().expect("no panic").push((at, result));
                }
            });
        }
    });
    let mut done = done.into_inner().expect("no panic");
    done.sort_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}

#[test]
fn whatever_happens_every_byte_is_right_and_nothing_is_lost() {
    let (cases, first) = (number("PANOSCOPE_SIM_CASES", 200), number("PANOSCOPE_SIM_SEED", 1));
    let begin = |n: u64| first + n * SEEDS_AT_ONCE;
    let parts = (0..cases.div_ceil(SEEDS_AT_ONCE)).map(|n| begin(n)..begin(n + 1).min(first + cases)).collect();
    let outputs = in_parallel(parts, |seeds| simulate(seeds, &[]));
    let failed: Vec<String> = outputs.iter().filter(|output| !output.status.success()).map(text).collect();
    println!("{cases} cases, {} of {} processes with failures", failed.len(), outputs.len());
    outputs.iter().for_each(|output| print!("{}", text(output)));
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

/// What must be equal in two runs of a seed, whatever its threads are called.
fn essence(done: &Done) -> (u64, u64, u64, usize, Vec<Seen>) {
    let ended = &done.ended;
    (ended.trace_hash, ended.decisions, ended.simulated_ns, ended.threads, done.seen.clone())
}

#[test]
fn a_seed_gives_the_same_run_again_and_in_another_process() {
    let seeds = 1..41u64;
    let first: Vec<_> = seeds.clone().map(|seed| play(Case::new(seed), false)).collect();
    for (seed, before) in seeds.clone().zip(&first).collect::<Vec<_>>().into_iter().rev() {
        let again = play(Case::new(seed), false);
        assert_eq!(essence(before), essence(&again), "seed {seed}");
    }
    let elsewhere = text(&simulate(seeds.clone(), &["--hash"]));
    for (seed, done) in seeds.zip(&first) {
        let line = format!("seed {seed} trace {:016x} decisions {}", done.ended.trace_hash, done.ended.decisions);
        assert!(elsewhere.contains(&line), "{line} is not in\n{elsewhere}");
    }
    let hashes: std::collections::BTreeSet<u64> = first.iter().map(|done| done.ended.trace_hash).collect();
    assert_eq!(hashes.len(), first.len(), "each seed is another run");
}

/// What sinks saw, node by node.
fn sinks(done: &Done) -> Vec<(String, Vec<String>)> {
    let sinks = done.case.model.nodes.iter().filter(|node| node.kind.is_sink());
    let seen_by = |id: &str| {
        let of = |seen: &&Seen| matches!(seen, Seen::Called { node, .. } if node == id);
        let said = |seen: &Seen| match seen {
            Seen::Called { seq, inputs, .. } => format!("{seq} {inputs:?}"),
            _ => String::new(),
        };
        done.seen.iter().filter(of).map(said).collect()
    };
    sinks.map(|node| (node.id.clone(), seen_by(&node.id))).collect()
}

#[test]
fn batch_runs_give_the_same_bytes_in_every_order_also_with_faults() {
    let quiet = |seed: u64| Case { edits: 0, pinch_bytes: None, ..Case::new(seed) };
    let is_batch = |case: &Case| case.model.batch && !case.disk_fails();
    let cases: Vec<Case> = (1..200).map(quiet).filter(is_batch).take(25).collect();
    assert_eq!(cases.len(), 25);
    assert!(cases.iter().any(|case| case.culprit().is_some()), "some have faults");
    for case in cases {
        let expected = play(case.clone(), false);
        assert_eq!(check(&expected), Vec::<String>::new(), "seed {}", case.seed);
        for round in 1..4u64 {
            let mut other = Case { threads: round as usize, observed: !case.observed, ..case.clone() };
            other.world.seed ^= round;
            other.world.switch_every = 1 + 7 * round as u32;
            other.world.priorities = round == 2;
            let done = play(other, false);
            assert_ne!(done.ended.trace_hash, expected.ended.trace_hash, "another order");
            for ((node, expected), (_, done)) in sinks(&expected).iter().zip(&sinks(&done)) {
                // A fault that stops the run ends the other branches wherever they are.
                let most = if case.stops() { expected.len().min(done.len()) } else { expected.len().max(done.len()) };
                let apart = (0..most).find(|&k| expected.get(k) != done.get(k));
                let said = |k: usize| format!("{:?} instead of {:?}", done.get(k), expected.get(k));
                assert_eq!(apart.map(said), None, "seed {}, order {round}, sink `{node}`", case.seed);
            }
        }
    }
}

/// Seeds that once failed, in addition to those of the suite.
#[test]
fn seeds_that_failed_once_pass() {
    let found = [
        // A source ended while another thread still delivered its last tick.
        5004, // A change named a tick too late: one was on its way to the region.
        7665, // A source without frame memory was called over and over.
        6481, 7465, // Checks that were wrong.
        5141, 6222, 7096,
    ];
    for seed in found {
        let output = simulate(seed..seed + 1, &[]);
        assert!(output.status.success(), "{}", text(&output));
    }
}

#[test]
fn mistakes_in_the_engine_are_found() {
    let find = |mutation: &'static str| {
        let first = FIRST_SEEDS.iter().find(|(name, _)| *name == mutation).map_or(1, |(_, seed)| *seed);
        let output = simulate(first..first + CASES_FOR_A_MUTATION, &["--until-found", "--mutation", mutation]);
        (mutation, output.status.code() == Some(1) && text(&output).contains("FAILED seed"), text(&output))
    };
    let results = in_parallel(panoscope_sim::engine::mutations(), find);
    let missed: Vec<_> = results.iter().filter(|(_, found, _)| !found).map(|(name, ..)| *name).collect();
    for (name, _, words) in &results {
        println!("{name}: {}", words.lines().take(2).collect::<Vec<_>>().join(" "));
    }
    assert!(missed.is_empty(), "nobody noticed {missed:?} in {CASES_FOR_A_MUTATION} cases");
}
