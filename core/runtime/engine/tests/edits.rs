//! A running graph is changed: whole changes or none, and nobody else notices.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::{PATIENCE, flow_plugin, loader, scratch};
use panoscope_base::random::SplitMix64;
use panoscope_engine::Options;
use panoscope_graph::{Graph, GraphText};
use panoscope_host::loader::graph_file::{Ready, ready_with};
use panoscope_host::loader::live::{FileWatch, LiveError};
use panoscope_host::loader::{Live, Loader};

const HEAD: &str = "mode = \"live\"\nplugins = [\"flow\", \"fixtures\"]\n";

fn source(id: &str, rate_hz: f64) -> String {
    format!(
        "[nodes.{id}]\ntype = \"frames\"\nparams = {{ width_px = 16, height_px = 8, format = \"gray8\", rate_hz = {rate_hz:?} }}\n"
    )
}

fn node(id: &str, kind: &str, from: &str) -> String {
    // Room enough that a busy machine drops nothing.
    format!("[nodes.{id}]\ntype = \"{kind}\"\ninputs = {{ image = {{ from = \"{from}\", queue = 200 }} }}\n")
}

fn checked(text: &str, loader: impl Into<Arc<Loader>>) -> Ready {
    let ready = ready_with(&GraphText::parse("test.toml".as_ref(), text), loader);
    ready.unwrap_or_else(|d| panic!("{}", d.render(false)))
}

fn live(text: &str, loader: Loader) -> Live {
    checked(text, loader).start(Options { threads: 2, ..Options::default() }).expect("it starts")
}

fn until(what: &str, mut done: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < end, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Names, types, values and connections: what a graph file describes.
fn described(graph: &Graph) -> Vec<String> {
    let name = |node: usize| graph.nodes[node].id.as_str();
    let nodes = graph.nodes.iter().map(|n| format!("{} {} {:?} {:?}", n.id, n.type_name, n.params, n.on_fault));
    let edges = graph.edges.iter().map(|e| {
        format!("{}.{} -> {}.{}[{}]", name(e.from_node), e.from_port, name(e.to_node), e.to_port, e.list_index)
    });
    let mut all: Vec<String> = nodes.chain(edges).collect();
    all.sort();
    all
}

#[test]
fn a_change_loses_no_frame_on_the_paths_it_does_not_touch_nor_on_those_it_does() {
    let text = [
        HEAD,
        &source("a", 200.0),
        &node("a_sink", "drain", "a.image"),
        &source("b", 200.0),
        &node("b_pass", "pass", "b.image"),
        &node("b_slow", "pass_blocking", "b.image"),
        &node("b_sink", "drain", "b_pass.image"),
        &node("b_slow_sink", "drain", "b_slow.image"),
    ]
    .concat();
    let mut live = live(&text, loader());
    until("frames flow", || live.engine().report().nodes["b_sink"].count > 5);
    let mut pauses = Vec::new();
    for round in 0..40 {
        let (id, sink) = (format!("n{round}"), format!("s{round}"));
        let added = live
            .edit(|document| {
                document.add_node(&id, "pass")?;
                document.set_input(&id, "image", &["b_pass.image"])?;
                document.add_node(&sink, "drain")?;
                document.set_input(&sink, "image", &[&format!("{id}.image")])
            })
            .expect("a good change");
        assert_eq!(added.added, [id.clone(), sink.clone()]);
        pauses.push(added.pause);
        until("the new branch works", || live.engine().report().nodes[&sink].count > 1);
        if round % 2 == 0 {
            let removed = live.edit(|d| d.remove_node(&sink).and_then(|()| d.remove_node(&id))).expect("a good change");
            assert_eq!(removed.removed.len(), 2);
            pauses.push(removed.pause);
        }
    }
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)));
    let report = live.engine().report();
    live.engine().close(PATIENCE);
    let nodes = &report.nodes;
    for (source, sinks) in [("a", &["a_sink"][..]), ("b", &["b_sink", "b_slow_sink"])] {
        assert_eq!(nodes[source].dropped, 0);
        for &sink in sinks {
            assert_eq!(nodes[sink].count, nodes[source].count, "{sink} saw every frame of {source}");
        }
    }
    pauses.sort();
    println!(
        "{} switches, pause p50 {:?}, longest {:?}",
        pauses.len(),
        pauses[pauses.len() / 2],
        pauses[pauses.len() - 1]
    );
}

/// Pages that nobody may touch, as the system puts one below the stack of each thread.
#[cfg(target_os = "linux")]
fn guard_pages() -> usize {
    const PAGE_BYTES: u64 = 4096;
    let maps = std::fs::read_to_string("/proc/self/maps").expect("the system's list");
    let is_guard = |line: &str| {
        let (from, rest) = line.split_once('-')?;
        let (to, rest) = rest.split_once(' ')?;
        let bytes = u64::from_str_radix(to, 16).ok()?.checked_sub(u64::from_str_radix(from, 16).ok()?)?;
        (bytes == PAGE_BYTES && rest.starts_with("---p")).then_some(())
    };
    maps.lines().filter_map(is_guard).count()
}

#[test]
#[cfg(target_os = "linux")]
fn nodes_that_left_keep_no_memory_of_their_threads() {
    const ROUNDS: usize = 100;
    let text = [HEAD, &source("a", 200.0), &node("sink", "drain", "a.image")].concat();
    let mut live = live(&text, loader());
    let before = guard_pages();
    for _ in 0..ROUNDS {
        live.edit(|d| d.add_node("n", "pass_blocking").and_then(|()| d.set_input("n", "image", &["a.image"])))
            .expect("a good change");
        live.remove_node("n").expect("a good change");
    }
    // Other tests of this process start threads meanwhile.
    let after = guard_pages();
    assert!(after < before + ROUNDS / 2, "{before} threads' stacks before {ROUNDS} nodes came and went, {after} after");
}

#[test]
fn a_change_that_fails_changes_nothing() {
    let text = [HEAD, &source("a", 200.0), &node("p", "pass", "a.image"), &node("sink", "drain", "p.image")].concat();
    let mut live = live(&text, loader());
    until("frames flow", || live.engine().report().nodes["sink"].count > 5);
    let before = described(&live.engine().graph());
    let error = live
        .edit(|d| {
            d.remove_node("sink")?;
            d.add_node("bad", "failing")?;
            d.set_input("bad", "image", &["p.image"])?;
            d.set_param("bad", "how", &"open".into())
        })
        .expect_err("`bad` does not open");
    assert!(error.to_string().contains("told not to open"), "{error}");
    let error = live.connect("p", "image", &["nobody.image"]).expect_err("a mistake");
    assert!(matches!(error, LiveError::Check(_)), "{error}");
    assert_eq!(described(&live.engine().graph()), before);
    assert_eq!(live.text(), text);
    let seen = live.engine().report().nodes["sink"].count;
    until("the old graph runs on", || live.engine().report().nodes["sink"].count > seen + 5);
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)));
    let report = live.engine().report();
    assert_eq!(report.nodes["sink"].count, report.nodes["a"].count, "no frame was lost");
}

/// The change does not hold the region of a slow producer, whose call delivers to the successor.
#[test]
fn a_reader_is_replaced_while_its_slow_producer_is_in_a_call() {
    let reader = |kind: &str, policy: &str| {
        let input = "{ from = \"slow.image\", align = \"latest\" }";
        format!("[nodes.show]\ntype = \"{kind}\"\n{policy}\ninputs = {{ image = {input} }}\n")
    };
    let slow = node("slow", "pass_blocking", "a.image") + "params = { wait_ms = 100.0 }\n";
    let head = [HEAD, &source("a", 60.0), &slow, &node("end", "drain", "show.image")].concat();
    let mut live = live(&(head.clone() + &reader("pass", "")), loader());
    let count = |live: &Live| live.engine().report().nodes["end"].count;
    until("frames flow", || count(&live) > 0);
    for (kind, policy) in [("gate", ""), ("gate", "cpu = 0"), ("pass_blocking", "cpu = 0"), ("pass", "")] {
        let applied = live.apply_text(&(head.clone() + &reader(kind, policy))).expect("a good change");
        assert_eq!(applied.replaced, ["show"], "{kind} {policy}");
        let before = count(&live);
        until("frames flow on", || count(&live) > before + 1);
    }
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)));
    assert_eq!(live.engine().close(PATIENCE), panoscope_engine::Outcome::Done);
    let report = live.engine().report();
    assert_eq!(report.nodes["end"].count, report.nodes["slow"].count, "none was lost");
}

/// Waiting ticks must not take the frame memory from the rest of the graph.
#[test]
fn a_pause_ends_before_it_fills_the_frame_memory() {
    let memory = panoscope_engine::memory::memory();
    memory.set_limit_bytes(memory.in_use_bytes() + (100 << 20));
    // A picture takes 2 MB, so 0.5 s of them fit.
    let camera = source("a", 100.0).replace("width_px = 16, height_px = 8", "width_px = 1500, height_px = 1000");
    let slow =
        node("slow", "pass_blocking", "a.image").replace(", queue = 200", "") + "params = { wait_ms = 1500.0 }\n";
    let reader = |kind: &str| node("p", kind, "slow.image").replace(", queue = 200", "");
    let other = source("b", 100.0) + &node("other", "drain", "b.image");
    let end = node("end", "drain", "p.image").replace(", queue = 200", "");
    let head = [HEAD, &camera, &slow, &end, &other].concat();
    let mut live = live(&(head.clone() + &reader("pass")), loader());
    until("frames flow", || live.engine().report().nodes["slow"].count > 0);
    let error = live.apply_text(&(head.clone() + &reader("gate"))).expect_err("the region does not rest in time");
    assert!(matches!(&error, LiveError::Apply(panoscope_engine::ApplyError::Memory { .. })), "{error}");
    assert!(error.to_string().contains("`slow`"), "{error}");
    let before = live.engine().report().nodes["other"].count;
    until("the rest goes on", || live.engine().report().nodes["other"].count > before + 20);
    // The ticks that waited go on.
    live.set_param("slow", "wait_ms", &0.0.into()).expect("a good change");
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)));
    live.engine().close(PATIENCE);
    assert!(live.engine().recent_faults().is_empty(), "{:?}", live.engine().recent_faults());
}

fn random_edit(live: &mut Live, dice: &mut SplitMix64, serial: usize) -> Result<Duration, LiveError> {
    let graph = live.engine().graph();
    let ids: Vec<String> = graph.nodes.iter().map(|n| n.id.clone()).collect();
    let makers: Vec<&str> =
        graph.nodes.iter().filter(|n| !n.type_name.starts_with("drain")).map(|n| n.id.as_str()).collect();
    let readers: Vec<&str> = graph.nodes.iter().filter(|n| n.type_name != "frames").map(|n| n.id.as_str()).collect();
    let from = format!("{}.image", makers[dice.below(makers.len())]);
    let applied = match dice.below(10) {
        0..=3 if ids.len() < 30 => {
            let kinds = ["pass", "pass_blocking", "drain", "drain_blocking", "gate", "every_nth", "frames"];
            let kind = kinds[dice.below(kinds.len())];
            let inputs: &[(&str, &[&str])] = &[("image", &[&from])];
            live.add_node(&format!("x{serial}"), kind, if kind == "frames" { &[] } else { inputs })
        }
        0..=5 => live.remove_node(&ids[dice.below(ids.len())]),
        6 | 7 => live.connect(readers[dice.below(readers.len())], "image", &[&from]),
        8 => live.edit(|d| {
            let id = readers[dice.below(readers.len())];
            d.remove_node(id)?;
            d.add_node(id, "pass_blocking")?;
            d.set_input(id, "image", &[&from])
        }),
        _ => {
            let sources: Vec<&str> =
                graph.nodes.iter().filter(|n| n.type_name == "frames").map(|n| n.id.as_str()).collect();
            let width = toml::Value::Integer(8 + dice.below(64) as i64);
            live.set_param(sources[dice.below(sources.len())], "width_px", &width)
        }
    };
    applied.map(|a| a.pause)
}

#[test]
fn a_thousand_random_edits_end_with_the_graph_the_file_describes() {
    let text = [HEAD, &source("a", 500.0), &node("p", "pass", "a.image"), &node("sink", "drain", "p.image")].concat();
    let mut live = live(&text, loader());
    let mut dice = SplitMix64(7);
    let (mut good, mut pauses, mut serial) = (0, Vec::new(), 0);
    while good < 1000 {
        serial += 1;
        let before = (described(&live.engine().graph()), live.text().to_owned());
        match random_edit(&mut live, &mut dice, serial) {
            Ok(pause) => {
                good += 1;
                pauses.push(pause);
            }
            Err(LiveError::Apply(error)) => panic!("edit {serial}: {error}"),
            Err(_) => assert_eq!((described(&live.engine().graph()), live.text().to_owned()), before),
        }
    }
    let expected = checked(live.text(), Arc::clone(live.loader())).graph;
    assert_eq!(described(&live.engine().graph()), described(&expected));
    // It is not only described: every node that can get frames gets them.
    let before = live.engine().report();
    let mut fed: Vec<bool> = expected.nodes.iter().map(|n| n.type_name == "frames").collect();
    for &node in &expected.order {
        let silent = |n: usize| matches!(expected.nodes[n].type_name.as_str(), "gate" | "every_nth");
        let inputs = expected.inputs_of(node);
        fed[node] |= !inputs.is_empty() && inputs.iter().all(|e| fed[e.from_node] && !silent(e.from_node));
    }
    assert_eq!(before.nodes.len(), expected.nodes.len());
    for (node, _) in expected.nodes.iter().zip(&fed).filter(|(_, fed)| **fed) {
        let was = before.nodes[&node.id].count;
        until(&format!("{} works", node.id), || live.engine().report().nodes[&node.id].count > was);
    }
    assert!(live.engine().recent_faults().is_empty(), "{:?}", live.engine().recent_faults());
    pauses.retain(|p| !p.is_zero());
    pauses.sort();
    let at = |q: usize| pauses[pauses.len() * q / 100];
    println!("{serial} edits, {good} valid, {} with a pause: p50 {:?}, p99 {:?}", pauses.len(), at(50), at(99));
}

#[test]
fn state_and_previews_survive_a_rebuilt_plugin_and_broken_ones_are_refused() {
    let folder = scratch("plugins");
    std::fs::create_dir_all(&folder).expect("a folder");
    let file = folder.join("libflow.so");
    let whole = std::fs::read(flow_plugin()).expect("the plugin");
    std::fs::write(&file, &whole).expect("written");
    // Only this plugin is in the folder.
    let head = HEAD.replace(", \"fixtures\"", "");
    let text =
        [head.as_str(), &source("a", 200.0), &node("p", "pass", "a.image"), &node("sink", "drain", "p.image")].concat();
    let mut live = live(&text, Loader::search(std::slice::from_ref(&folder)));
    let preview = live.engine().preview("p", "image").expect("a preview");
    until("frames flow", || live.engine().report().nodes["sink"].count > 5);
    assert_eq!(live.reload_plugins().expect("nothing to do"), Default::default());

    // Cut off at every twentieth of its length, another ABI, no plugin at all.
    for twentieth in 0..20 {
        std::fs::write(&file, &whole[..whole.len() * twentieth / 20]).expect("written");
        let error = live.reload_plugins().expect_err("a part of a plugin");
        assert!(matches!(error, LiveError::Check(_)), "{twentieth}: {error}");
    }
    std::fs::write(&file, b"no plugin").expect("written");
    live.reload_plugins().expect_err("no plugin");
    let seen = live.engine().report().nodes["sink"].count;
    until("the old one runs on", || live.engine().report().nodes["sink"].count > seen + 5);

    // A rebuild: the same but for a text.
    let (old, new) = (b"Forwards frames without a copy.", b"Forwards frames, newly compiled");
    let mut rebuilt = whole.clone();
    let at = rebuilt.windows(old.len()).position(|w| w == old).expect("the text of `pass`");
    rebuilt[at..at + new.len()].copy_from_slice(new);
    let mut watch = FileWatch::new("test.toml".as_ref(), live.loader());
    std::fs::write(&file, &rebuilt).expect("written");
    until("the change is seen", || watch.poll().plugins);
    let applied = live.reload_plugins().expect("a good plugin");
    assert_eq!(applied.replaced.len(), 3, "{applied:?}");
    let catalog = live.loader().catalog(&["flow"]);
    let pass = &catalog.node_types[catalog.find("pass")[0]];
    assert!(pass.doc.contains("newly compiled"), "{}", pass.doc);
    preview.take();
    until("the preview goes on", || preview.take().is_some());
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)));
    assert!(live.engine().recent_faults().is_empty(), "{:?}", live.engine().recent_faults());
    println!("hot swap of three nodes: pause {:?}", applied.pause);
}
