//! The graph runs in a process of its own: whatever becomes of it, the window stays and shows the camera.

use crate::common;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use crate::common::program::{is_alive, signal, until_gone};
use crate::common::window::{GRAPH, Window, options};
use crate::common::{Folder, has_plugin};
use crate::trust::lock;
use eframe::egui::Key;
use egui_kittest::kittest::Queryable;
use panoscope_graph::ParamValue;
use panoscope_host::audit::{ClipState, Event, read};
use panoscope_theatre::{Options, OutageStage, Theatre, Verified};

/// From the end of a process until the camera is shown, at best of some tries on a loaded machine.
const RAW_WITHIN: Duration = Duration::from_secs(1);

/// Draws until the camera's image is newer than `began`, when the process was ended; checks meanwhile that no older image counts as fresh. Returns the time since `began`.
fn until_camera(window: &mut Window, began: Instant) -> Duration {
    loop {
        window.harness.step();
        let theatre = window.theatre();
        let (age_ms, waited_ms) =
            (theatre.camera_age_ms().expect("there was one"), began.elapsed().as_secs_f64() * 1e3);
        let notices = window.notices();
        let first = notices.iter().find(|n| n.contains("the image processing")).map_or("", String::as_str);
        if first.starts_with("No image") {
            assert!(age_ms >= waited_ms - 1.0, "{age_ms} ms old, {waited_ms} ms without a process");
        }
        if first.starts_with("Camera image only") && age_ms < waited_ms {
            return began.elapsed();
        }
        assert!(began.elapsed() < common::PATIENCE, "no image of the camera: {notices:?}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Draws until all views are there again.
fn until_whole(window: &mut Window) {
    window.until("all views are back", |t| t.outage().is_none() && t.has_picture());
    window.until_shown("View Calm view");
    window.until("nothing is wrong", |t| t.notices().is_empty());
}

#[test]
fn a_killed_process_is_replaced_and_settings_stay() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::guarded("guard_killed", GRAPH);
    let set = |t: &Theatre| t.param_values("calm").is_some_and(|values| values[0] == ParamValue::Int(77));
    window.harness.state_mut().as_mut().expect("it is open").choose("calm", "past_weight", ParamValue::Int(77));
    window.until("the setting is applied", set);
    let (mut best, mut last) = (Duration::MAX, 0);
    for _ in 0..3 {
        let spare = window.until_spare();
        let worker = window.worker();
        signal(worker, "KILL");
        let began = Instant::now();
        let took = until_camera(&mut window, began);
        best = best.min(took);
        println!("from SIGKILL to the camera's image: {took:?}");
        assert!(window.notices()[0].contains("was killed (SIGKILL"), "{:?}", window.notices());
        assert!(window.harness.query_by_label("View Image camera").is_some());
        assert_eq!(window.worker(), spare, "the one that waited took over");
        until_whole(&mut window);
        window.until("the setting is there again", set);
        assert_ne!(last, worker);
        last = worker;
    }
    assert!(best < RAW_WITHIN, "the camera was shown after {best:?}");
}

#[test]
fn a_stopped_process_is_ended_and_replaced() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::guarded("guard_stopped", GRAPH);
    window.until_spare();
    let worker = window.worker();
    signal(worker, "STOP");
    let began = Instant::now();
    // Old images are called old before anything is known.
    window.until_notice("Image is 0.");
    assert!(window.theatre().outage().is_none());
    println!("from SIGSTOP to the camera's image: {:?}", until_camera(&mut window, began));
    assert!(window.notices()[0].contains("did not answer for one second"), "{:?}", window.notices());
    until_gone(&[worker]);
    until_whole(&mut window);
}

#[test]
fn without_a_process_that_waits_the_camera_comes_too() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::guarded("guard_both", GRAPH);
    let (spare, worker) = (window.until_spare(), window.worker());
    signal(spare, "KILL");
    signal(worker, "KILL");
    let began = Instant::now();
    println!("from two SIGKILLs to the camera's image: {:?}", until_camera(&mut window, began));
    until_whole(&mut window);
}

/// The body of a page of this machine; `None` while nothing answers.
fn page(port: u16, path: &str) -> Option<String> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(5))).ok()?;
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").ok()?;
    let mut text = String::new();
    stream.read_to_string(&mut text).ok()?;
    let (head, body) = text.split_once("\r\n\r\n")?;
    head.starts_with("HTTP/1.1 200").then(|| body.to_owned())
}

#[test]
fn a_page_for_reading_is_served_and_comes_back_after_a_crash() {
    if !has_plugin("flow") {
        return;
    }
    let port = TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a free port").port();
    let folder = Folder::new("guard_page");
    let options = options(&folder);
    let mut window = Window::guarded_as(folder, GRAPH, options, &["--web", &port.to_string()]);
    let shows = |window: &mut Window| {
        window.until("the page shows the graph", |_| page(port, "/state").is_some_and(|state| state.contains("calm")));
    };
    shows(&mut window);
    assert!(page(port, "/metrics").is_some_and(|metrics| metrics.contains("panoscope_")));
    let listening = &window.theatre().plan().listening;
    assert!(
        listening.iter().any(|one| one.what.to_string() == format!("web page at 127.0.0.1:{port}") && !one.is_public)
    );
    window.until_spare();
    signal(window.worker(), "KILL");
    until_camera(&mut window, Instant::now());
    until_whole(&mut window);
    shows(&mut window);
}

#[test]
fn a_clip_that_was_recorded_is_kept_and_all_is_logged() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let (folder, log) = (Folder::new("guard_clip"), Folder::new("guard_clip_log"));
    let options = Options { audit: Some(log.0.clone()), ..options(&folder) };
    let mut window = Window::guarded_with(folder, GRAPH, options);
    window.until_spare();
    window.key(Key::S);
    window.until("the still is saved", |t| t.remark().is_some_and(|r| r.contains("still_0001.png is saved")));
    window.key(Key::R);
    let clip = window.folder.0.join("kept/clip_0002.mkv");
    window.until("the clip grows", |_| std::fs::metadata(&clip).is_ok_and(|file| file.len() > 4000));
    signal(window.worker(), "KILL");
    let began = Instant::now();
    until_camera(&mut window, began);
    let killed = "the image processing was killed (SIGKILL), perhaps because memory ran out";
    let remark = format!("clip_0002.mkv ended early: {killed}; the part recorded so far is saved");
    assert_eq!(window.theatre().remark(), Some(remark.as_str()));
    assert!(window.notices()[0].contains(killed), "{:?}", window.notices());
    assert_eq!(window.theatre().clip_file(), None);
    // Only stills while the camera is alone.
    window.key(Key::R);
    assert_eq!(window.theatre().clip_file(), None);
    until_whole(&mut window);
    window.key(Key::R);
    window.until("the next clip grows", |t| {
        t.clip_file().is_some_and(|file| std::fs::metadata(file).is_ok_and(|file| file.len() > 4000))
    });
    window.key(Key::R);
    window.until("it is over", |t| t.clip_file().is_none());
    assert_eq!(window.kept(), ["clip_0002.mkv", "clip_0003.mkv", "still_0001.png"]);
    let bytes = std::fs::read(&clip).expect("the clip");
    assert!(bytes.starts_with(&[0x1A, 0x45, 0xDF, 0xA3]) && bytes.len() > 4000);
    drop(window);
    let report = read(&log.0).expect("the log");
    assert!(report.problems.is_empty(), "{report:?}");
    let events: Vec<Event> = report.entries.into_iter().map(|entry| entry.event).collect();
    let ended = Event::ProcessEnded { cause: "was killed (SIGKILL), perhaps because memory ran out".to_owned() };
    let expected = [
        Event::Still { number: 1 },
        Event::Clip { number: 2, state: ClipState::Started },
        ended,
        Event::Clip { number: 2, state: ClipState::Failed },
        Event::Clip { number: 3, state: ClipState::Started },
        Event::Clip { number: 3, state: ClipState::Ended },
        Event::Closed,
    ];
    assert_eq!(events[1..], expected);
}

#[test]
fn a_graph_that_crashes_again_and_again_leaves_the_camera() {
    if !has_plugin("flow") {
        return;
    }
    let text = GRAPH.replace(
        "[preset]",
        r#"[nodes.gray]
type = "frames"
params = { width_px = 64, height_px = 48, format = "gray8", rate_hz = 30.0 }
[nodes.bad]
type = "chaos"
inputs = { image = "gray.image" }
params = { harm = "segv", first = 30, ticks = 1000000000 }
[nodes.end]
type = "drain"
inputs = { image = "bad.image" }
[preset]"#,
    );
    let mut window = Window::guarded("guard_again", &text);
    let mut pids = Vec::new();
    for number in 1..=2 {
        window.until("a crash", |t| t.outage().is_some_and(|outage| outage.number >= number));
        window.until("the camera is shown", |t| {
            let shows = |outage: panoscope_theatre::Outage| matches!(outage.stage, OutageStage::Cameras(_));
            t.outage().is_some_and(shows) && t.camera_age_ms().is_some_and(|age| age < 500.0)
        });
        let notice = window.notices().swap_remove(0);
        assert!(notice.contains("crashed in node `bad` (SIGSEGV"), "{notice}");
        pids.push(window.worker());
        window.until_shown("Start again");
        window.click("Start again");
    }
    assert_ne!(pids[0], pids[1]);
}

#[test]
fn the_emergency_stop_reaches_the_process_and_outlasts_it() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::guarded("guard_arm", &GRAPH.replace("type = \"drain\"", "type = \"device\""));
    let stopped = |t: &Theatre| t.param_values("sink").is_some_and(|values| values.contains(&ParamValue::Bool(true)));
    window.until_spare();
    window.until("the arm's state is known", |t| t.param_values("sink").is_some());
    assert!(!stopped(window.theatre()));
    window.key(Key::E);
    window.until("it is stopped", stopped);
    assert!(window.theatre().remark().is_none(), "{:?}", window.theatre().remark());
    signal(window.worker(), "KILL");
    let began = Instant::now();
    until_camera(&mut window, began);
    assert!(window.theatre().is_stopped());
    window.until("the arm runs again, stopped", |t| t.outage().is_none() && stopped(t));
    // A stop that reaches nobody is no secret.
    window.harness.key_down(Key::E);
    window.until("it is released", |t| !t.is_stopped() && !stopped(t));
    window.harness.key_up(Key::E);
    window.harness.step();
    signal(window.worker(), "STOP");
    window.key(Key::E);
    window.until("the stop is refused", |t| {
        t.remark().is_some_and(|r| r == "sink did not accept the stop: switch the arm off")
    });
}

#[test]
fn an_arm_waits_for_a_release_after_a_crash() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::guarded("guard_arm_crash", &GRAPH.replace("type = \"drain\"", "type = \"device\""));
    let stopped = |t: &Theatre| t.param_values("sink").map(|values| values.contains(&ParamValue::Bool(true)));
    window.until_spare();
    window.until("the arm runs", |t| stopped(t) == Some(false));
    signal(window.worker(), "KILL");
    until_camera(&mut window, Instant::now());
    window.until("all views are back", |t| t.outage().is_none() && t.has_picture());
    window.until("the arm's state is known", |t| stopped(t).is_some());
    assert_eq!(stopped(window.theatre()), Some(true), "it does not follow by itself");
    assert!(window.theatre().is_stopped());
    window.until_notice("Emergency stop");
    window.harness.key_down(Key::E);
    window.until("it is released", |t| !t.is_stopped() && stopped(t) == Some(false));
    window.harness.key_up(Key::E);
}

/// [`GRAPH`] with a node that reads the model `anatomy.onnx`.
fn with_model() -> String {
    let text = GRAPH.replace("type = \"drain\"", "type = \"model_reader\"\nparams = { model = \"anatomy.onnx\" }");
    text.replace("[preset]", "[nodes.end]\ntype = \"drain\"\ninputs = { image = \"sink.image\" }\n[preset]")
}

#[test]
fn a_locked_graph_whose_model_is_gone_after_a_crash_shows_the_cameras_and_names_it() {
    if !has_plugin("flow") {
        return;
    }
    let (folder, text) = (Folder::new("guard_locked_model"), with_model());
    let model = folder.write("anatomy.onnx", "fine");
    lock(&folder.write("g.toml", &text), None);
    let options = options(&folder);
    let mut window = Window::guarded_with(folder, &text, options);
    assert_eq!(*window.theatre().verified(), Verified::AsLocked);
    let spare = window.until_spare();
    std::fs::remove_file(model).expect("it is there");
    // Without the process that read it.
    signal(spare, "KILL");
    signal(window.worker(), "KILL");
    window.until_notice("could not start again: the file anatomy.onnx does not exist in ");
    assert!(window.notices().iter().any(|notice| notice.starts_with("Camera image only")), "{:?}", window.notices());
    window.until("the camera is shown", |t| t.camera_age_ms().is_some_and(|age| age < 500.0));
    // Another file is not read.
    window.folder.write("anatomy.onnx", "good");
    window.click("Start again");
    window.until_notice("anatomy.onnx, which is not as it was locked");
    window.until("the camera is shown", |t| t.camera_age_ms().is_some_and(|age| age < 500.0));
    // The same one is.
    window.folder.write("anatomy.onnx", "fine");
    window.click("Start again");
    until_whole(&mut window);
}

#[test]
fn a_model_that_is_gone_after_a_crash_is_named_and_the_camera_stays() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("guard_model");
    let model = folder.write("anatomy.onnx", "fine");
    let options = options(&folder);
    let mut window = Window::guarded_with(folder, &with_model(), options);
    window.until_spare();
    std::fs::remove_file(model).expect("it is there");
    signal(window.worker(), "KILL");
    let named = "could not start again: the file anatomy.onnx does not exist in ";
    window.until_notice(named);
    let notice = window.notices().into_iter().find(|notice| notice.contains(named)).expect("the notice");
    assert!(notice.starts_with("Camera image only") && !notice.contains("keeps running"), "{notice}");
    window.until("the camera is shown", |t| t.camera_age_ms().is_some_and(|age| age < 500.0));
    // It is there again.
    window.folder.write("anatomy.onnx", "fine");
    window.click("Start again");
    until_whole(&mut window);
}

#[test]
fn a_window_that_closes_leaves_no_process() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::guarded("guard_close", GRAPH);
    let pids = [window.until_spare(), window.worker()];
    assert!(pids.iter().all(|pid| is_alive(*pid)));
    drop(window);
    until_gone(&pids);
}
