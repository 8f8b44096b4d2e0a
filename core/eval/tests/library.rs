//! Evaluations and benches called as functions, without the command.

use std::sync::Mutex;

use panoscope_eval::figures::{self, Figure};
use panoscope_eval::{EvalError, Session, Silent, bench, chain, eval};
use panoscope_host::loader::{Loader, search_path};

/// Whether these plugins are built; reports a skip if not.
fn has_plugins(names: &[&str]) -> bool {
    let all: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
    let catalog = Loader::search(&search_path(&[])).catalog(&all);
    let has = names.iter().all(|name| catalog.has_plugin(name));
    if !has {
        panoscope_testing::skipped!(
            "the plugins {} are not built together; `cargo xtask test` builds them",
            names.join(", ")
        );
    }
    has
}

/// Keeps what is reported, and cancels at once if wanted.
#[derive(Default)]
struct Listening {
    lines: Mutex<Vec<String>>,
    is_cancelled: bool,
}

impl Session for Listening {
    fn note(&self, line: &str) {
        self.lines.lock().expect("no test panics with the lock").push(line.to_owned());
    }

    fn is_cancelled(&self) -> bool {
        self.is_cancelled
    }
}

fn value(figures: &[Figure], name: &str) -> f64 {
    let names = || figures.iter().map(|f| f.name.as_str()).collect::<Vec<_>>().join(", ");
    figures.iter().find(|f| f.name == name).unwrap_or_else(|| panic!("no {name} in {}", names())).value
}

#[test]
fn skill_is_judged_beside_closed_forms() {
    let found = eval::skill::judge(&eval::skill::Options::default()).unwrap_or_else(|e| panic!("{}", chain(&e)));
    assert!(found.len() > 10, "{found:?}");
    let worst = value(&found, "worst_error_pct");
    assert!(worst > 0.0 && worst < 10.0, "{worst}");
    assert!(found.iter().filter(|f| f.peer.as_deref() == Some("closed form")).count() == found.len() - 1);
    let json = figures::json(&found).expect("figures are JSON");
    let read: serde_json::Value = serde_json::from_str(&json).expect("and read back");
    assert_eq!(read.as_array().map(Vec::len), Some(found.len()));
    assert_eq!(read[0]["name"].as_str(), Some(found[0].name.as_str()));
    assert_eq!(figures::table(&found).lines().count(), found.len() + 1);
}

#[test]
fn proximity_is_judged_on_the_phantom_and_repeats() {
    if !has_plugins(&["phantom", "stereo", "tools"]) {
        return;
    }
    let options = eval::proximity::Options {
        chains: vec!["exact".to_owned()],
        scenes: vec!["bowel".to_owned()],
        seconds: 2,
        width: 160,
        ..eval::proximity::Options::default()
    };
    let judge = || eval::proximity::judge(&Silent, &options).unwrap_or_else(|e| panic!("{}", chain(&e)));
    let found = judge();
    let known_pct = value(&found, "tissue_known_pct/exact/bowel");
    assert!(known_pct > 50.0 && known_pct <= 100.0, "{known_pct}");
    assert!(value(&found, "margin_mm/exact/bowel") > 0.0);
    assert!(found.iter().all(|f| f.input.contains("160x120")), "{found:?}");
    let values = |all: &[Figure]| all.iter().map(|f| (f.name.clone(), f.value.to_bits())).collect::<Vec<_>>();
    assert_eq!(values(&found), values(&judge()), "the same options give the same figures");
}

#[test]
fn a_bench_measures_every_chain_and_reports_its_line() {
    if !has_plugins(&["flow"]) {
        return;
    }
    let session = Listening::default();
    let found = bench::scale::measure(&session, true).unwrap_or_else(|e| panic!("{}", chain(&e)));
    for nodes in [10, 20, 50, 100, 200, 500, 1_000] {
        let ns = value(&found, &format!("tick/{nodes}"));
        assert!(ns.is_finite() && ns > 0.0, "{nodes}: {ns}");
    }
    // A hundred times the nodes cost more, however slow the machine is.
    assert!(value(&found, "tick/1000") > value(&found, "tick/10"));
    assert!(found.iter().filter(|f| f.name.starts_with("tick/")).all(|f| f.unit == "ns"));
    let lines = session.lines.into_inner().expect("no test panics with the lock");
    assert!(lines.len() == 1 && lines[0].starts_with("time per tick = "), "{lines:?}");
}

#[test]
fn a_cancelled_session_ends_a_bench_and_an_evaluation() {
    if !has_plugins(&["flow", "phantom", "stereo", "tools"]) {
        return;
    }
    let session = Listening { is_cancelled: true, ..Listening::default() };
    assert!(matches!(bench::scale::measure(&session, true), Err(EvalError::Cancelled)));
    let options = eval::proximity::Options::default();
    assert!(matches!(eval::proximity::judge(&session, &options), Err(EvalError::Cancelled)));
}

#[test]
fn wrong_options_are_refused_with_a_reason_before_anything_runs() {
    let options = eval::mosaic::Options { speed_mm_s: 99.0, ..eval::mosaic::Options::default() };
    let error = eval::mosaic::judge(&Silent, &options).expect_err("it is too fast");
    assert!(matches!(&error, EvalError::Options { reason } if reason.contains("--speed-mm-s is 99")), "{error}");
    let options = eval::arm::Options { scenarios: vec!["nobody".to_owned()], ..eval::arm::Options::default() };
    let error = eval::arm::judge(&Silent, &options).expect_err("there is no such scenario");
    assert!(matches!(&error, EvalError::Options { reason } if reason.contains("`nobody`")), "{error}");
}
