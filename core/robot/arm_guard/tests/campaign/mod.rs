//! A seeded campaign against the real process on a pseudo-terminal: harm of every kind at a random moment of a
//! movement. Checked on the arm's true angles: it stays within its limits, it brakes, and no stop is forgotten.
//!
//! PANOSCOPE_ARM_CASES sets the number of cases (default 300), PANOSCOPE_ARM_SEED the first seed, PANOSCOPE_ARM_BESIDE
//! how many run beside each other (default 12; few of them measure `hold_ms` best). A failure names its seed and the
//! command that repeats it.

mod case;
mod harm;
mod host;
mod judge;

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use panoscope_arm_core::Chain;

use case::Case;
use harm::{HARMS, Harm};

#[derive(Default)]
struct Outcome {
    cases: u64,
    limit_escapes: u64,
    forgotten_latches: u64,
    not_moving: u64,
    /// Time from each harm until set-points, or the arm's own watchdog, brake, ms.
    hold_ms: BTreeMap<Harm, Vec<f64>>,
    failures: Vec<String>,
}

fn run(seed: u64, chain: &Chain, outcome: &Mutex<Outcome>) {
    let result = Case::new(seed).and_then(|mut case| case.run(chain));
    let mut all = outcome.lock().expect("no thread panicked with it");
    let mut fail = |words: &str| {
        let harm = HARMS[(seed % HARMS.len() as u64) as usize];
        all.failures.push(format!(
            "{harm:?}: {words}; repeat: PANOSCOPE_ARM_SEED={seed} PANOSCOPE_ARM_CASES=1 cargo nextest run -p panoscope-arm-guard campaign:: --no-capture"
        ));
    };
    match result {
        Err(words) => fail(&words),
        Ok(None) => all.not_moving += 1,
        Ok(Some(found)) => {
            if let Some(words) = &found.escape {
                fail(words);
            }
            if found.is_forgotten {
                fail("the stop was forgotten");
            }
            if let Some(words) = &found.wrong {
                fail(words);
            }
            all.cases += 1;
            all.limit_escapes += u64::from(found.escape.is_some());
            all.forgotten_latches += u64::from(found.is_forgotten);
            if let Some(ms) = found.hold_ms {
                all.hold_ms.entry(found.harm).or_default().push(ms);
            }
        }
    }
}

/// Median, 99th percentile and maximum of sorted numbers, in words.
fn percentiles(sorted: &[f64]) -> String {
    let at = |share: f64| {
        let index = ((sorted.len() as f64 - 1.0) * share).ceil() as usize;
        sorted.get(index).copied().unwrap_or(f64::NAN)
    };
    format!("p50 {:.1} p99 {:.1} max {:.1} ({} cases)", at(0.5), at(0.99), at(1.0), sorted.len())
}

#[test]
fn no_harm_moves_the_arm_out_of_its_limits_and_no_stop_is_forgotten() {
    let number =
        |name: &str, default: u64| std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default);
    let (cases, first) = (number("PANOSCOPE_ARM_CASES", 300), number("PANOSCOPE_ARM_SEED", 0));
    let chain = Chain::shipped().expect("the shipped arm");
    let (next, outcome) = (AtomicU64::new(first), Mutex::new(Outcome::default()));
    // Most of a case is waiting.
    std::thread::scope(|scope| {
        for _ in 0..number("PANOSCOPE_ARM_BESIDE", 12) {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first.saturating_add(cases) {
                        return;
                    }
                    run(seed, &chain, &outcome);
                }
            });
        }
    });
    let mut all = outcome.into_inner().expect("no thread panicked with it");
    let mut every = Vec::new();
    for (harm, hold_ms) in &mut all.hold_ms {
        hold_ms.sort_by(f64::total_cmp);
        every.extend_from_slice(hold_ms);
        println!("hold_ms after {harm:?}: {}", percentiles(hold_ms));
    }
    every.sort_by(f64::total_cmp);
    println!("hold_ms: {}", percentiles(&every));
    println!(
        "cases {}, did not move {}, limit_escapes {}, forgotten_latches {}, failures {}",
        all.cases,
        all.not_moving,
        all.limit_escapes,
        all.forgotten_latches,
        all.failures.len()
    );
    assert!(all.failures.is_empty(), "{:#?}", all.failures);
    assert!(all.cases * 10 >= cases * 8, "only {} of {cases} cases moved the arm", all.cases);
}
