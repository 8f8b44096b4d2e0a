//! Defects that the campaign has found, each as the shortest run that reproduces it.

use std::time::Duration;

use panoscope_graph::ParamValue;
use panoscope_sim::engine::{Engine, Options, Outcome};
use panoscope_sim::graphs::{Kind, Model, Node, Trouble};
use panoscope_sim::harm::Harm;
use panoscope_sim::observe::{self, Seen};
use panoscope_sim::plugins::simulated;
use panoscope_sim::world::disk::Disk;
use panoscope_sim::world::time::Instant;
use panoscope_sim::world::{Settings, run, thread};

fn sleep_ms(ms: u64) {
    thread::sleep(Duration::from_millis(ms));
}

fn camera(period_ms: f64) -> Node {
    let mut camera = Node::new("camera0", Kind::Camera, &[]);
    camera.more = format!(", period_ms = {period_ms:?}, width_px = 20, height_px = 16, begin = \"zero\"");
    camera
}

/// Runs a graph while `script` acts on it; returns what the nodes saw.
fn play(model: Model, seed: u64, script: impl FnOnce(&Engine) + Send + 'static) -> Vec<Seen> {
    let _alone = observe::alone();
    let ended = run(Settings { seed, ..Settings::default() }, move || {
        observe::begin(Disk::default());
        let plugins = simulated();
        let graph = plugins.graph(&model).expect("a graph without mistakes");
        let options = Options { threads: 2, close_limit: Duration::from_secs(2), ..Options::default() };
        let engine = Engine::start(graph, plugins.catalog(), plugins, options).expect("it starts");
        script(&engine);
        engine.stop();
        assert!(engine.wait(Some(Duration::from_secs(60))), "it ends");
        assert_eq!(engine.close(Duration::from_secs(2)), Outcome::Done);
    });
    assert_eq!(ended.result, Ok(()));
    assert_eq!(ended.left, []);
    observe::seen()
}

/// Values of node `of` that `by` saw, in the order of the ticks.
fn values_seen(seen: &[Seen], by: &str, of: &str) -> Vec<u32> {
    let hash = panoscope_sim::content::name_hash(of);
    let mut values: Vec<u32> = seen
        .iter()
        .filter_map(|seen| match seen {
            Seen::Called { node, inputs, .. } if node == by => Some(inputs),
            _ => None,
        })
        .flatten()
        .flat_map(|content| content.steps.iter().filter(|step| step.node == hash).map(|step| step.values))
        .collect();
    values.dedup();
    values
}

fn marked(trouble: Option<Trouble>) -> Model {
    let mut mark = Node::new("mark", Kind::Mark, &["camera0"]);
    mark.trouble = trouble;
    Model { batch: false, nodes: vec![camera(20.0), mark, Node::new("sink", Kind::Look, &["mark"])] }
}

/// Defect: both parameters were set, and the second change was computed from the values before the first.
#[test]
fn a_value_that_is_set_while_a_new_instance_waits_is_not_lost() {
    for seed in 0..20 {
        let seen = play(marked(None), seed, |engine| {
            sleep_ms(110);
            // No tick lies between the two.
            engine.set_param("mark", "reopened", ParamValue::Int(1)).expect("a good value");
            engine.set_param("mark", "live", ParamValue::Int(2)).expect("a good value");
            sleep_ms(200);
        });
        let values = values_seen(&seen, "sink", "mark");
        assert_eq!(values.last(), Some(&0x1_0002), "seed {seed}: {values:x?}");
    }
}

/// Defect: the predecessor did not return from closing, and the node was reopened with the values before the change.
#[test]
fn values_stay_when_the_predecessor_does_not_close() {
    let trouble = Trouble {
        harm: Harm::HangInClose,
        first: 1_000_000,
        ticks: 0,
        hang_ms: 30_000.0,
        on_fault: "restart",
        budget_ms: None,
    };
    for seed in 0..10 {
        let seen = play(marked(Some(trouble.clone())), seed, |engine| {
            sleep_ms(110);
            engine.set_param("mark", "reopened", ParamValue::Int(1)).expect("a good value");
            sleep_ms(6_000);
        });
        let values = values_seen(&seen, "sink", "mark");
        assert_eq!(values, [0, 0x1_0000], "seed {seed}");
    }
}

/// Defect: a tick that waited before the named one met the new graph.
#[test]
fn a_change_before_a_tick_is_met_by_no_earlier_one() {
    for seed in 0..20 {
        let mut slow = Node::new("slow", Kind::Mark, &["camera0"]);
        // Ticks wait before the region all the time.
        slow.cost_ms = 45.0;
        let old = Model { batch: false, nodes: vec![camera(20.0), slow, Node::new("sink", Kind::Look, &["slow"])] };
        let mut new = old.clone();
        new.nodes.push(Node::new("late", Kind::Look, &["slow"]));
        let seen = play(old, seed, move |engine| {
            sleep_ms(200);
            let graph = simulated().graph(&new).expect("a graph without mistakes");
            let at = [("camera0".to_owned(), engine.ticks() + 2)];
            let applied = engine.apply_at(graph, simulated().catalog(), simulated(), &at).expect("a good change");
            assert!(applied.switched_at[0].1 >= at[0].1, "{applied:?} for {at:?}");
            sleep_ms(300);
        });
        assert!(seen.iter().any(|seen| matches!(seen, Seen::Called { node, .. } if node == "late")));
    }
}

/// Defect: if the system had no thread for a node, the threads that had been started waited forever.
#[test]
fn a_start_without_enough_threads_leaves_none_behind() {
    let mut refused = 0;
    for most in 3..12 {
        let mut model = marked(None);
        model.nodes.push(Node::new("file", Kind::Write, &["mark"]));
        let _alone = observe::alone();
        let ended = run(Settings { most_threads: Some(most), ..Settings::default() }, move || {
            observe::begin(Disk::default());
            let graph = simulated().graph(&model).expect("a graph without mistakes");
            let options = Options { threads: 2, ..Options::default() };
            let start = Instant::now();
            let engine = Engine::start(graph, simulated().catalog(), simulated(), options);
            let refused = engine.is_err();
            assert!(!refused || start.elapsed() < Duration::from_secs(3), "it does not wait for nodes that never run");
            refused
        });
        refused += u32::from(ended.result.expect("no panic"));
        assert_eq!(ended.left, [], "{most} threads");
    }
    assert!((3..9).contains(&refused), "{refused} of 9 limits are too low");
}

/// Defect: a source hung, there was no replacement thread, and the run never ended.
#[test]
fn a_run_ends_when_there_is_no_thread_in_place_of_one_that_hangs() {
    let trouble =
        Trouble { harm: Harm::Hang, first: 5, ticks: 1, hang_ms: 30_000.0, on_fault: "restart", budget_ms: Some(8.0) };
    let mut model = marked(None);
    model.nodes[0].trouble = Some(trouble);
    let _alone = observe::alone();
    // The first thread, two workers, the watchdog and the source.
    let ended = run(Settings { most_threads: Some(5), ..Settings::default() }, move || {
        observe::begin(Disk::default());
        let graph = simulated().graph(&model).expect("a graph without mistakes");
        let options = Options { threads: 2, ..Options::default() };
        let engine = Engine::start(graph, simulated().catalog(), simulated(), options).expect("it starts");
        assert!(engine.wait(Some(Duration::from_secs(10))), "it ends");
        engine.close(Duration::from_secs(1))
    });
    let outcome = ended.result.expect("no panic");
    assert!(
        matches!(&outcome, Outcome::Failed(reason) if reason.contains("no thread could be started")),
        "{outcome:?}"
    );
    assert_eq!(ended.left, []);
}
