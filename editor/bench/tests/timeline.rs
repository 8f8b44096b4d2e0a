//! A recording on the nodes of the graph: scrubbed, stepped, looped, and compared with a second run, while the graph keeps running.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::{Folder, GRAPH, PATIENCE, Window, has_plugin, input, nothing_lost};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::computing::Request;
use panoscope_editor_model::observe::{Output, PreviewRequest};
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::timeline::{Held, Timeline, second};
use panoscope_engine::Options;
use panoscope_graph::GraphText;
use panoscope_host::loader::graph_file;
use panoscope_record::{RecordOptions, Recorder, Recording, head};

const NONE: Modifiers = Modifiers::NONE;

/// Records a number of ticks of every source, and of all other nodes where `all_ports` says so.
fn record(path: &Path, text: &str, file: &Path, ticks: u64, all_ports: bool) {
    let ready = graph_file::ready(&GraphText::parse(path, text)).expect("it is right");
    let recorder = RecordOptions { file: Some(file.to_owned()), all_ports, ..RecordOptions::default() };
    let recorder = Recorder::start(recorder, head(&ready)).expect("the file can be written");
    let options =
        Options { observer: Some(Arc::clone(&recorder) as _), frames: Some(ticks), paced: false, ..Options::default() };
    let live = ready.start(options).expect("it starts");
    assert!(live.engine().wait(Some(PATIENCE)), "it does not end");
    live.engine().close(PATIENCE);
    assert!(recorder.finish().failed.is_none());
}

#[test]
fn a_recording_is_moved_through_and_compared_while_the_graph_runs() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("timeline");
    let text = GRAPH.replace("mode = \"live\"", "mode = \"batch\"");
    let files = ["first.mcap", "second.mcap"].map(|name| folder.0.join(name));
    let other = text.replace("past_weight = 100", "past_weight = 200");
    for (file, text) in files.iter().zip([&text, &other]) {
        record(&folder.0.join("recorded.toml"), text, file, 50, true);
    }
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    let output = Output::new("b", "image");
    window.key(NONE, Key::J);
    window.until_shown("Open recording");
    input::fill(&mut window.harness, "Recording", files[0].to_str().expect("a path"));
    window.until_shown("Pictures of the recording first.mcap");
    input::all_named(&window.harness, "timeline", 8);
    window.until("the first tick", |app| app.shown_tick(&output) == Some(0));
    assert_eq!(window.app().timeline().expect("open").tick(), (0, 50));
    // By step, by key, by the slider.
    window.harness.get_by_label("Step forward").click_accesskit();
    window.until("one tick on", |app| app.shown_tick(&output) == Some(1));
    window.key(NONE, Key::Period);
    window.until("two ticks on", |app| app.shown_tick(&output) == Some(2));
    window.key(NONE, Key::Comma);
    window.until("one tick back", |app| app.shown_tick(&output) == Some(1));
    window.harness.get_by_role_and_label(Role::Slider, "Moment of the recording").focus();
    window.steps(2);
    (0..10).for_each(|_| window.key(NONE, Key::ArrowRight));
    window.until("the slider moves it by ticks", |app| app.shown_tick(&output) == Some(11));
    // Values are those of the recording, not of the running graph.
    window.select("b");
    let shown = window.app().shown_tick(&output);
    window.until("values of the recorded picture", |app| app.probe(&output).is_some_and(|p| Some(p.seq) == shown));
    // A part of it, again and again: the ticks come at 50 per second.
    let seek = |window: &Window, at_s: f64| window.app().timeline().expect("open").seek(at_s);
    seek(&window, 0.2);
    window.until("it is there", |app| app.shown_tick(&output) == Some(10));
    window.harness.get_by_label("Loop from here").click_accesskit();
    window.steps(2);
    seek(&window, 0.4);
    window.steps(2);
    window.harness.get_by_label("Loop to here").click_accesskit();
    window.steps(2);
    assert_eq!(window.app().timeline().expect("open").position().range_s, Some((0.2, 0.4)));
    let (until, mut wraps, mut last) = (Instant::now() + PATIENCE, 0, 0.0);
    while wraps < 2 {
        assert!(Instant::now() < until, "it does not go round");
        window.steps(1);
        let position = window.app().timeline().expect("open").position();
        assert!((0.19..0.41).contains(&position.at_s) && position.plays, "{position:?}");
        wraps += usize::from(position.at_s < last);
        last = position.at_s;
        std::thread::sleep(Duration::from_millis(5));
    }
    window.key(NONE, Key::Q);
    assert!(!window.app().timeline().expect("open").position().plays);
    // The second run beside it, of the same moment.
    input::fill(&mut window.harness, "Second recording", files[1].to_str().expect("a path"));
    window.until_shown("Beside it: second.mcap");
    seek(&window, 0.6);
    let mean = Output::new("mean", "image");
    window.select("mean");
    window.key(NONE, Key::V);
    window.key(NONE, Key::C);
    window.until("both runs at one tick", |app| {
        app.shown_tick(&mean) == Some(30) && app.shown_tick(&second(&mean)) == Some(30)
    });
    assert!(window.app().wipe().is_some());
    window.until_shown("PSNR ");
    window.key(NONE, Key::Escape);
    window.harness.get_by_label("Close recording").click_accesskit();
    window.until("the running graph again", |app| app.timeline().is_none() && app.shown_tick(&output).is_some());
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn nodes_that_a_recording_lacks_are_computed_and_no_time_is_that_of_the_running_graph() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("lacking");
    let file = folder.0.join("sources.mcap");
    let text = GRAPH.replace("mode = \"live\"", "mode = \"batch\"");
    record(&folder.0.join("recorded.toml"), &text, &file, 20, false);
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.until_painted(" fps");
    window.key(NONE, Key::J);
    window.until_shown("Open recording");
    input::fill(&mut window.harness, "Recording", file.to_str().expect("a path"));
    window.until_shown("State: shows the recording sources.mcap; the graph runs on");
    window.steps(3);
    let has = |node: &str, port: &str| window.app().timeline().expect("open").has(&Output::new(node, port));
    assert!(has("b", "image") && !has("mean", "image"));
    // `mean` is computed from the recorded source, at the tick that is shown.
    let mean = Output::new("mean", "image");
    window.until("it is computed", |app| app.timeline().expect("open").held(&mean) == Held::Computed);
    window.app().timeline().expect("open").seek(0.2);
    window.until("its picture", |app| app.shown_tick(&mean) == Some(10));
    window.until_painted("computed from the recording");
    let painted = window.painted();
    assert!(painted.iter().any(|text| text == "recorded"), "{painted:#?}");
    assert!(!painted.iter().any(|text| text.contains(" · p99")), "times of the running graph: {painted:#?}");
    assert!(
        !painted.iter().any(|text| text.ends_with(" s old")),
        "a recording that stands still is not old: {painted:#?}"
    );
    window.harness.get_by_label("Close recording").click();
    window.until_painted(" · p99");
}

#[test]
fn a_key_records_every_output_and_shows_the_recording() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("records");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.key(Modifiers::SHIFT, Key::J);
    window.until("it is recorded", |app| {
        let status = app.session().status();
        status.recording.is_some() && status.phase == panoscope_editor_model::session::Phase::Running
    });
    window.until("some ticks", |app| {
        app.session().handle().engine().is_some_and(|engine| engine.report().nodes["mean"].count > 10)
    });
    window.key(Modifiers::SHIFT, Key::J);
    window.until("the recording is shown", |app| app.timeline().is_some());
    let timeline = window.app().timeline().expect("it is shown");
    assert_eq!(timeline.path(), folder.0.join("g.recordings/g_0001.mcap"));
    // In a replay the nodes make outputs without a reader again.
    assert!(Recording::open(timeline.path()).expect("a recording").head.all_ports);
    let mean = Output::new("mean", "image");
    assert!(timeline.has(&mean), "{:?}", timeline.ports());
    window.until("a picture of a node that is no source", |app| app.shown_tick(&mean).is_some());
    window.until("the graph runs on, without a recording", |app| {
        let status = app.session().status();
        status.recording.is_none() && status.phase == panoscope_editor_model::session::Phase::Running
    });
    // Found again in the list of files.
    window.click_until_shown("Close recording", "Open recording");
    window.harness.get_by_label("List the recordings").click();
    window.until_painted("g_0001.mcap");
    window.key(NONE, Key::Enter);
    window.until("it is open again", |app| app.timeline().is_some());
}

/// The pictures of an output at a moment of a recording, once they are there.
fn pixels_at(timeline: &Timeline, output: &Output, at_s: f64) -> Vec<u8> {
    timeline.seek(at_s);
    let packet = PreviewRequest { packet: "image".to_owned(), max_width: 64, ..PreviewRequest::default() };
    timeline.set_requests(HashMap::from([(output.clone(), packet)]));
    let until = Instant::now() + PATIENCE;
    loop {
        timeline.follow_computation();
        // 50 ticks a second.
        let is_of = |packet: &RenderedPacket| packet.seq == (at_s * 50.0).round() as u64;
        let rendered = timeline.take().remove(output).filter(is_of);
        if let Some(pixels) = rendered.and_then(|packet| packet.pixels) {
            return pixels.rgba;
        }
        assert!(Instant::now() < until, "no picture at {at_s} s: {:?}", timeline.problem());
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn what_is_computed_from_the_sources_is_what_was_computed_when_they_were_recorded() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("computed");
    // With the past, pictures depend on all ticks before.
    let past = "image = \"b.image\", past = { from = \"mean.image\", delay = 1 }";
    let text = GRAPH.replace("mode = \"live\"", "mode = \"batch\"").replacen("image = \"b.image\"", past, 1);
    let files = ["all.mcap", "sources.mcap"].map(|name| folder.0.join(name));
    for (file, all_ports) in files.iter().zip([true, false]) {
        record(&folder.0.join("recorded.toml"), &text, file, 20, all_ports);
    }
    let mean = Output::new("mean", "image");
    let [all, mut sources] = files.each_ref().map(|file| Timeline::open(file, Arc::new(|| ())).expect("a recording"));
    assert_eq!((all.held(&mean), sources.held(&mean)), (Held::Recorded, Held::Lacking));
    let loader = || Arc::new(graph_file::all_plugins());
    let compute = |timeline: &mut Timeline, text: &str| {
        let graph = (folder.0.join("g.toml"), text.to_owned());
        timeline.compute(Request { graph, loader: loader() }).expect("it starts");
        let until = Instant::now() + PATIENCE;
        while timeline.computation().is_some_and(|computation| computation.percent().is_some()) {
            assert!(Instant::now() < until, "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
        timeline.follow_computation();
    };
    compute(&mut sources, &text);
    assert_eq!(sources.held(&mean), Held::Computed, "{:?}", sources.computation().and_then(|c| c.problem()));
    for at_s in [0.3, 0.06] {
        assert!(pixels_at(&sources, &mean, at_s) == pixels_at(&all, &mean, at_s), "{at_s} s");
    }
    // Another value gives other pictures.
    compute(&mut sources, &text.replace("past_weight = 100", "past_weight = 250"));
    assert!(pixels_at(&sources, &mean, 0.3) != pixels_at(&all, &mean, 0.3));
    // A graph of other sources cannot be computed, and its nodes say so.
    compute(&mut sources, &text.replace("nodes.b]", "nodes.c]").replace("b.image", "c.image"));
    let problem = sources.computation().and_then(|computation| computation.problem());
    assert!(problem.as_ref().is_some_and(|problem| problem.contains("`c`")), "{problem:?}");
    assert_eq!(sources.held(&mean), Held::Lacking);
    // What was computed leaves no file behind.
    drop((all, sources));
    let left = std::fs::read_dir(&folder.0).expect("a folder").flatten().map(|entry| entry.file_name());
    let left: Vec<_> = left.filter(|name| name.to_string_lossy().contains("computed")).collect();
    assert!(left.is_empty(), "{left:?}");
}
