//! Tests of the theatre on running graphs, by keys, taps and names of widgets.

#[path = "theatre/clips.rs"]
mod clips;
#[path = "theatre/lengths.rs"]
pub mod lengths;
#[path = "theatre/locks.rs"]
mod locks;

use std::time::{Duration, Instant};

use crate::common::window::{GRAPH, Window, options};
use crate::common::{Folder, PATIENCE, has_plugin, input};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Rect, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::session::Phase;
use panoscope_graph::ParamValue;
use panoscope_theatre::{Layout, Options, Theatre};

/// A box that stands still, so that the depth of a point is known, or not, in every image alike.
const MEASURED: &str = r#"plugins = ["phantom", "stereo", "flow"]
[nodes.scope]
type = "phantom"
params = { scene = "box", width = 320, height = 240, speed_mm_s = 0.0, breathing_mm = 0.0 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.sink]
type = "drain"
inputs = { image = "scope.left" }
[preset]
views = ["scope.left", "points.cloud"]
"#;

fn past_weight(window: &Window) -> Option<ParamValue> {
    let engine = window.theatre().session().expect("it runs here").handle().engine()?;
    engine.param_values("calm")?.first().cloned()
}

#[test]
fn layouts_change_by_one_key_by_pedal_and_by_tap() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("layouts", GRAPH);
    window.until_shown("View Calm view");
    assert_eq!(window.theatre().layout(), Layout::All);
    window.key(Key::Space);
    assert_eq!(window.theatre().layout(), Layout::One(0));
    window.key(Key::F13);
    assert_eq!(window.theatre().layout(), Layout::One(1));
    assert!(window.harness.query_by_label_contains("View Calm view").is_none());
    window.key(Key::Num1);
    assert_eq!(window.theatre().layout(), Layout::One(0));
    window.click("View Calm view");
    assert_eq!(window.theatre().layout(), Layout::All);
    window.click("Layout");
    assert_eq!(window.theatre().layout(), Layout::One(0));
}

#[test]
fn only_pinned_settings_can_be_touched_and_only_within_their_range() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("settings", GRAPH);
    window.until("the value is known", |t| t.session().expect("it runs here").handle().engine().is_some());
    window.until_shown("Calmness");
    let slider = window.harness.get_by_role_and_label(Role::Slider, "Calmness");
    let rect = slider.rect();
    let far = rect.right_center() + vec2(200.0, 0.0);
    input::drag(&mut window.harness, rect.center(), far);
    let until = Instant::now() + PATIENCE;
    while past_weight(&window) != Some(ParamValue::Int(150)) {
        assert!(Instant::now() < until, "it is {:?}", past_weight(&window));
        std::thread::sleep(Duration::from_millis(15));
        window.harness.step();
    }
    let text = std::fs::read_to_string(window.folder.0.join("g.toml")).expect("it is there");
    assert_eq!(text, GRAPH, "nothing is written");
    // Keys that edit in the bench do nothing here.
    for key in [Key::Delete, Key::A, Key::B, Key::W] {
        window.key(key);
    }
    let engine = window.theatre().session().expect("it runs here").handle().engine().expect("it runs");
    assert_eq!(engine.graph().nodes.len(), 3);
}

#[test]
fn a_frozen_picture_says_so_and_a_live_one_stays_beside_it() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("freeze", GRAPH);
    window.until("the first pictures are there", |t| t.notices().is_empty() && t.has_picture());
    for alone in [false, true] {
        if alone {
            window.key(Key::Num1);
        }
        window.until_shown("View Calm view");
        let before = window.harness.get_by_label("View Calm view").rect();
        window.key(Key::F);
        assert!(window.theatre().is_frozen());
        window.until_shown("View Live: Image camera");
        let frozen = window.harness.get_by_label("View Calm view").rect();
        assert_eq!(frozen, before, "a frozen picture keeps its size");
        let live = window.harness.get_by_label("View Live: Image camera").rect();
        let middle = Rect::from_center_size(frozen.center(), frozen.size() * 0.45);
        assert!(!live.intersects(middle) && live.width() > 120.0, "{live:?} over {frozen:?}");
        window.click("Continue");
        assert!(!window.theatre().is_frozen());
    }
}

/// While it is not shown nobody asks for its images, so that none comes.
#[test]
fn a_view_that_was_not_shown_for_a_while_has_not_stopped() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("not_shown", GRAPH);
    window.until("the first pictures are there", |t| t.notices().is_empty() && t.has_picture());
    // Both keys hide it, and show it again.
    for key in [Key::F, Key::Num2] {
        window.key(key);
        let hidden = Instant::now();
        // Longer than a view may be silent.
        window.until("it was hidden for 1.5 s", |_| hidden.elapsed() > Duration::from_millis(1500));
        window.key(key);
        assert!(!window.theatre().is_frozen() && window.theatre().layout() == Layout::All);
        let notices = window.notices();
        assert!(notices.iter().all(|notice| !notice.contains("has stopped")), "{key:?}: {notices:?}");
    }
}

#[test]
fn stills_and_clips_are_kept_under_numbers() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let mut window = Window::open("keep", GRAPH);
    window.until("a picture is there", Theatre::has_picture);
    window.key(Key::S);
    window.until("the still is saved", |t| t.remark().is_some_and(|r| r.contains("still_0001.png is saved")));
    window.key(Key::R);
    let node = "theatre_clip";
    window.until("the clip runs", |t| {
        let engine = t.session().expect("it runs here").handle().engine().expect("it runs");
        engine.report().nodes.get(node).is_some_and(|n| n.count > 10)
    });
    assert!(window.theatre().clip_file().is_some_and(|f| f.ends_with("clip_0002.mkv")));
    let before =
        window.theatre().session().expect("it runs here").handle().engine().expect("it runs").report().nodes["calm"]
            .dropped;
    window.click("End clip");
    window.until("the clip is over", |t| {
        let engine = t.session().expect("it runs here").handle().engine().expect("it runs");
        t.clip_file().is_none() && engine.graph().node(node).is_none()
    });
    let after =
        window.theatre().session().expect("it runs here").handle().engine().expect("it runs").report().nodes["calm"]
            .dropped;
    assert_eq!(before, after, "recording loses no frame");
    assert_eq!(window.kept(), ["clip_0002.mkv", "still_0001.png"]);
    let still = image::open(window.folder.0.join("kept/still_0001.png")).expect("a picture");
    assert_eq!((still.width(), still.height()), (64, 48));
    let clip = std::fs::read(window.folder.0.join("kept/clip_0002.mkv")).expect("it is there");
    assert!(clip.starts_with(&[0x1A, 0x45, 0xDF, 0xA3]) && clip.len() > 1000);
}

#[test]
fn a_stage_in_fault_is_named_and_the_raw_view_takes_its_place() {
    if !has_plugin("flow") {
        return;
    }
    let text = GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"camera.image\" }\nparams = { past_weight = 100 }",
        "type = \"failing\"\ninputs = { image = \"camera.image\" }\nparams = { how = \"panic\", first = 10, ticks = 1000000 }",
    );
    let text = text.lines().filter(|l| !l.starts_with("pinned")).collect::<Vec<_>>().join("\n");
    let mut window = Window::open("fault", &text);
    window.until("the stage is named", |t| t.notices().iter().any(|n| n.message.contains("Stage `calm`")));
    window.until("the view has stopped", |t| t.notices().iter().any(|n| n.message == "Calm view has stopped"));
    window.until_shown("View Image camera (in place of Calm view)");
}

#[test]
fn where_the_graph_stops_its_camera_goes_on_alone_and_it_can_be_started_again() {
    if !has_plugin("flow") {
        return;
    }
    let text = GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"camera.image\" }\nparams = { past_weight = 100 }",
        "type = \"failing\"\non_fault = \"stop\"\ninputs = { image = \"camera.image\" }\nparams = { how = \"panic\", first = 10, ticks = 1 }",
    );
    let text = text.lines().filter(|l| !l.starts_with("pinned")).collect::<Vec<_>>().join("\n");
    let mut window = Window::open("stops", &text);
    window.until("only the camera runs", |t| t.notices().iter().any(|n| n.message.starts_with("Camera image only")));
    window.until("it runs again", |t| {
        let engine = t.session().expect("it runs here").handle().engine().expect("it runs");
        t.session().expect("it runs here").status().phase == Phase::Running && engine.graph().nodes.len() == 1
    });
    window.until_shown("View Image camera");
    window.click("Start again");
    window.until("the whole graph is there", |t| {
        t.session().expect("it runs here").handle().engine().is_some_and(|e| e.graph().nodes.len() == 3)
    });
}

#[test]
fn a_camera_that_ends_has_a_notice() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("ends");
    let path = folder.write("g.toml", GRAPH);
    let options = Options { frames: Some(20), ..options(&folder) };
    let mut window = Window::open_with(folder, &path, options);
    window.until_notice("The source has ended");
    window.until_shown("Start again");
}

/// A stream whose light may be old when it comes.
const STREAM: &str = r#"plugins = ["fixtures", "flow"]
[nodes.stream]
type = "aged"
params = { age_ms = 0.0, media_ms = 20.0 }
[nodes.sink]
type = "drain"
inputs = { image = "stream.image" }
[preset]
views = ["stream.image"]
"#;

#[test]
fn a_stream_that_buffers_has_a_notice_of_its_age_at_once() {
    if !has_plugin("fixtures") {
        return;
    }
    let mut window = Window::open("buffers", STREAM);
    window.until("fresh pictures", |t| t.has_picture() && t.notices().is_empty());
    let set_age = |window: &Window, age_ms: f64| {
        let engine = window.theatre().session().expect("it runs here").handle().engine().expect("it runs");
        engine.set_param("stream", "age_ms", ParamValue::Float(age_ms)).expect("a good value");
        Instant::now()
    };
    // A loaded machine draws late: one try of many is at once.
    let (mut best, until) = (Duration::MAX, Instant::now() + PATIENCE);
    while best >= Duration::from_millis(200) {
        assert!(Instant::now() < until, "the notice of a picture that is 2 s old came after {best:?} at best");
        let begin = set_age(&window, 2000.0);
        window.until_notice("Image is 2.");
        best = best.min(begin.elapsed());
        set_age(&window, 0.0);
        window.until("fresh again", |t| t.notices().is_empty());
    }
}

#[test]
fn escape_held_for_two_seconds_leaves_and_a_short_one_does_not() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("leave", GRAPH);
    window.key(Key::Escape);
    for _ in 0..5 {
        window.harness.step();
    }
    assert!(!window.theatre().is_closing());
    window.harness.key_down(Key::Escape);
    let start = Instant::now();
    window.until("it leaves", Theatre::is_closing);
    assert!(start.elapsed() >= Duration::from_secs(2), "{:?}", start.elapsed());
}

#[test]
fn a_camera_that_does_not_open_shows_the_full_error_in_its_view() {
    if !has_plugin("flow") || !has_plugin("capture") {
        return;
    }
    let folder = Folder::new("does_not_open");
    for side in ["left.mp4", "right.mp4"] {
        folder.write(side, "no video at all");
    }
    let text = "plugins = [\"capture\", \"flow\"]\n[nodes.scope]\ntype = \"capture\"\nparams = { left = \"left.mp4\", right = \"right.mp4\" }\n[nodes.sink]\ntype = \"drain\"\ninputs = { image = \"scope.left\" }\n";
    let path = folder.write("g.toml", text);
    let options = options(&folder);
    let mut window = Window::open_with(folder, &path, options);
    window.until_notice("No image: ");
    // Then the camera is tried alone, which fails too.
    window.until_shown("press Enter to start again");
    let notice = window.notices().into_iter().find(|w| w.starts_with("No image: ")).expect("it is shown");
    let whole = notice.trim_start_matches("No image: ").to_owned();
    assert!(whole.contains("left.mp4"), "{whole}");
    window.until_shown("View Left camera");
    let pane = window.harness.get_by_label("View Left camera").rect();
    let why = window.harness.get_by_label(&whole).rect();
    let remedy = window.harness.get_by_label_contains("press Enter to start again").rect();
    assert!(pane.contains_rect(why) && pane.contains_rect(remedy), "{why:?} and {remedy:?} in {pane:?}");
    assert!(why.bottom() <= remedy.top(), "the remedy is below the reason");
    assert!(why.height() > 30.0, "a long message is wrapped: {why:?}");
    window.until_shown("Start again");
}

#[test]
fn the_emergency_stop_is_shown_for_an_arm_and_outlasts_changes() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let mut window = Window::open("no_arm", GRAPH);
    window.until_shown("Freeze");
    assert!(window.harness.query_by_label_contains("Emergency stop of the arm").is_none());
    drop(window);
    let text = GRAPH.replace("type = \"drain\"", "type = \"device\"");
    let mut window = Window::open("arm", &text);
    window.until_shown("Emergency stop of the arm");
    let stopped = |t: &Theatre| {
        let values = t.session().expect("it runs here").handle().engine().and_then(|e| e.param_values("sink"));
        values.is_some_and(|v| v.contains(&ParamValue::Bool(true)))
    };
    let centre = window.harness.get_by_label("Emergency stop of the arm").rect().center();
    window.harness.hover_at(centre);
    window.harness.step();
    window.harness.drag_at(centre);
    window.harness.step();
    window.harness.step();
    assert!(window.theatre().is_stopped() && stopped(window.theatre()), "on touch, at once");
    window.harness.drop_at(centre);
    window
        .until("the notice is shown", |t| t.notices().first().is_some_and(|n| n.message.starts_with("Emergency stop")));
    // Neither a change of the graph nor another press releases it.
    window.key(Key::R);
    window.until("the clip runs", |t| {
        t.session().expect("it runs here").handle().engine().is_some_and(|e| e.graph().node("theatre_clip").is_some())
    });
    window.key(Key::E);
    assert!(window.theatre().is_stopped() && stopped(window.theatre()));
    // Holding for two seconds releases it.
    window.harness.key_down(Key::E);
    window.until("it is released", |t| !t.is_stopped() && !stopped(t));
    window.harness.key_up(Key::E);
    window.harness.step();
    window.key(Key::E);
    assert!(window.theatre().is_stopped(), "by key, too");
}

#[test]
fn distances_are_measured_by_two_taps() {
    if !has_plugin("phantom") || !has_plugin("stereo") {
        return;
    }
    let mut window = Window::open("measure", MEASURED);
    window.key(Key::M);
    window.until_shown("Measure here");
    assert!(window.theatre().is_frozen());
    let rect = window.harness.get_by_label("Measure here").rect();
    for share in [0.4, 0.6] {
        input::tap(&mut window.harness, rect.min + rect.size() * share);
    }
    // A distance is shown together with its error or not at all.
    window.until("a distance with its error", |t| t.distance().is_some());
    let length = window.theatre().distance().expect("both points are known");
    assert!((1.0..100.0).contains(&length.mm), "{length}");
    assert!((1e-6..length.mm).contains(&length.error_mm) && length.to_string().contains(" ± "), "{length}");
    window.key(Key::S);
    window.until("the still is saved", |t| t.remark().is_some_and(|r| r.contains("is saved")));
    window.key(Key::M);
    assert!(!window.theatre().is_frozen());
    assert!(window.notices().iter().all(|w| !w.contains("stopped")), "{:?}", window.notices());
    assert_eq!(window.theatre().distance(), None);
}

#[test]
fn distances_are_measured_and_surfaces_turned_by_keys_alone() {
    if !has_plugin("phantom") || !has_plugin("stereo") {
        return;
    }
    let mut window = Window::open("measure_keys", MEASURED);
    window.key(Key::M);
    window.until_shown("Measure here");
    // The first arrow key shows the crosshair in the centre; Enter taps.
    for key in [Key::ArrowLeft, Key::ArrowLeft, Key::ArrowLeft, Key::Enter] {
        window.key(key);
    }
    (0..5).for_each(|_| window.key(Key::ArrowRight));
    window.key(Key::Enter);
    // The calibration that gives the error may come after the points.
    window.until("a distance with its error", |t| t.distance().is_some());
    let length = window.theatre().distance().expect("both points are known");
    assert!((0.5..100.0).contains(&length.mm), "{length}");
    window.key(Key::M);
    window.key(Key::Num2);
    assert_eq!(window.theatre().layout(), Layout::One(1));
    // Keys turn a surface that is shown; until then the camera's image may be in its place.
    window.until_shown("Turn Points");
    let before = window.theatre().viewpoint("points.cloud").expect("it is shown");
    window.key(Key::ArrowLeft);
    window.key(Key::Plus);
    let after = window.theatre().viewpoint("points.cloud").expect("it is shown");
    assert!(after.yaw > before.yaw && after.zoom > before.zoom, "{before:?} {after:?}");
    window.key(Key::Home);
    assert_eq!(window.theatre().viewpoint("points.cloud"), Some(before));
}

/// Asserts that every widget that can have the focus has a name of its own and is reached by Tab.
fn reached_by_tab(window: &mut Window, what: &str) {
    input::steps(&mut window.harness, 2);
    input::all_named(&window.harness, what, 4);
    let mut all = input::focusable(&window.harness);
    let nameless: Vec<&String> =
        all.iter().filter(|name| name.trim().is_empty() || name.starts_with("nameless")).collect();
    assert!(nameless.is_empty(), "{what}: {nameless:?}");
    let mut round = input::round_by_tab(&mut window.harness);
    all.sort();
    round.sort();
    assert_eq!(round, all, "{what}: by Tab, and all");
    let doubled: Vec<&[String]> = all.windows(2).filter(|pair| pair[0] == pair[1]).collect();
    assert!(doubled.is_empty(), "{what}: {doubled:?}");
    window.key(Key::Escape);
}

#[test]
fn everything_has_a_name_and_is_reached_by_tab() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("names", &GRAPH.replace("type = \"drain\"", "type = \"device\""));
    window.until("a picture is there", Theatre::has_picture);
    window.until_shown("Calmness");
    reached_by_tab(&mut window, "views");
    window.key(Key::F);
    window.until_shown("View Live: Image camera");
    reached_by_tab(&mut window, "frozen");
    window.key(Key::F);
    window.key(Key::Num1);
    reached_by_tab(&mut window, "one view");
    window.key(Key::E);
    window.until_shown("Release the arm");
    reached_by_tab(&mut window, "arm stopped");
    // Enter presses the focused button.
    window.harness.get_by_label("Freeze").focus();
    window.key(Key::Enter);
    assert!(window.theatre().is_frozen());
    drop(window);
    if !has_plugin("phantom") || !has_plugin("stereo") {
        return;
    }
    let mut window = Window::open("names_3d", MEASURED);
    window.until("a picture is there", Theatre::has_picture);
    reached_by_tab(&mut window, "surface");
    window.key(Key::M);
    window.until_shown("Measure here");
    reached_by_tab(&mut window, "measuring");
}

#[test]
fn settings_are_set_by_keys_and_all_can_be_reached() {
    if !has_plugin("flow") {
        return;
    }
    let mut text = GRAPH[..GRAPH.find("pinned").expect("it pins")].to_owned();
    text += "pinned = [\n";
    for k in 0..9 {
        text += &format!("  {{ param = \"more{k}.past_weight\", range = [50, 150], label = \"weight {k}\" }},\n");
    }
    text += "]\n";
    for k in 0..9 {
        text += &format!(
            "[nodes.more{k}]\ntype = \"smooth\"\ninputs = {{ image = \"camera.image\" }}\nparams = {{ past_weight = 100 }}\n[nodes.end{k}]\ntype = \"drain\"\ninputs = {{ image = \"more{k}.image\" }}\n"
        );
    }
    let mut window = Window::open("pages", &text);
    window.until_shown("Weight 0");
    // An arrow key changes the value and does not move the focus.
    window.harness.get_by_role_and_label(Role::Slider, "Weight 0").focus();
    for _ in 0..3 {
        window.key(Key::ArrowRight);
    }
    assert_eq!(input::focused(&window.harness).as_deref(), Some("Weight 0"));
    window.until("the value is applied", |t| {
        let values = t.session().expect("it runs here").handle().engine().and_then(|e| e.param_values("more0"));
        values.is_some_and(|v| v[0] == ParamValue::Int(103))
    });
    window.key(Key::Escape);
    let mut seen = std::collections::BTreeSet::new();
    for _ in 0..9 {
        seen.extend((0..9).filter(|k| window.harness.query_by_label(&format!("Weight {k}")).is_some()));
        window.key(Key::T);
    }
    assert_eq!(seen.len(), 9, "{seen:?}");
    window.harness.get_by_label("More settings");
}

#[test]
fn settings_leave_room_for_the_buttons_in_a_narrow_window() {
    if !has_plugin("flow") || !has_plugin("phantom") || !has_plugin("stereo") {
        return;
    }
    let text = MEASURED
        .replace("\"flow\"]", "\"flow\", \"fixtures\"]")
        .replace("type = \"drain\"", "type = \"device\"")
        + "pinned = [{ param = \"points.far_mm\", range = [50, 500], label = \"farthest depth\" }, { param = \"points.near_mm\", range = [1, 40], label = \"nearest depth\" }]\n";
    let folder = Folder::new("narrow");
    let path = folder.write("g.toml", &text);
    let options = Options { scale: 2.0, ..options(&folder) };
    let mut window = Window::open_with(folder, &path, options);
    window.until("a picture is there", Theatre::has_picture);
    window.harness.set_size(vec2(1440.0, 810.0));
    input::steps(&mut window.harness, 6);
    let setting = window.harness.get_by_role_and_label(Role::Slider, "Farthest depth").rect();
    let screen = window.harness.ctx.content_rect();
    assert!(screen.contains_rect(setting) && setting.width() > 80.0, "{setting:?} in {screen:?}");
    for name in ["Layout", "Freeze", "Still", "Record", "Measure", "More settings", "Emergency stop of the arm"] {
        let button = window.harness.get_by_role_and_label(Role::Button, name).rect();
        assert!(!button.intersects(setting), "{name} at {button:?}, the setting at {setting:?}");
    }
}

#[test]
fn a_lost_camera_is_named_and_the_other_one_goes_on() {
    if !has_plugin("flow") {
        return;
    }
    let text = "plugins = [\"flow\", \"fixtures\"]\n[nodes.camera]\ntype = \"frames\"\nparams = { width_px = 64, height_px = 48, rate_hz = 30.0 }\n[nodes.second]\ntype = \"chaos_source\"\nparams = { harm = \"nothing\", first = 600, ticks = 1000000000 }\n[nodes.sink]\ntype = \"drain\"\ninputs = { image = \"camera.image\" }\n[nodes.other]\ntype = \"drain\"\ninputs = { image = \"second.image\" }\n[preset]\nviews = [\"camera.image\", \"second.image\"]\n";
    let mut window = Window::open("lost", text);
    window.until("one of the two is lost", |t| {
        let says = |words: &str| t.notices().iter().any(|notice| notice.message.contains(words));
        says("Second image camera lost: no image for ") && !says("Camera image")
    });
    window.until("the other one goes on", Theatre::has_picture);
}

#[test]
fn a_full_disk_has_a_plain_notice() {
    if !has_plugin("flow") {
        return;
    }
    // Writing to this file fails as on a full disk.
    let ledger = "\n[nodes.kept]\ntype = \"ledger\"\ninputs = { images = [\"camera.image\"] }\nparams = { path = \"/dev/full\" }\n";
    let text = GRAPH.replace("rate_hz = 30.0", "rate_hz = 240.0") + ledger;
    let mut window = Window::open("full", &text);
    window.until_notice("The disk is full: `kept` cannot write");
    window.until("the picture goes on", |t| t.has_picture() && !t.is_frozen());
}

#[test]
fn a_sink_on_a_full_disk_keeps_its_notice_and_a_clip_ends() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let folder = Folder::new("no_room_sink");
    // Writing to this file fails as on a full disk.
    let full = folder.0.join("full.mkv");
    std::os::unix::fs::symlink("/dev/full", &full).expect("a link");
    let sink = format!(
        "\n[nodes.kept]\ntype = \"write_video\"\ninputs = {{ image = \"camera.image\" }}\nparams = {{ path = \"{}\" }}\n",
        full.display()
    );
    let text = GRAPH.replace("\"fixtures\"]", "\"fixtures\", \"sinks\"]") + &sink;
    let mut window = Window::open("no_room", &text);
    window.until_notice("The disk is full: `kept` cannot write");
    let faults =
        |t: &Theatre| t.session().expect("it runs here").handle().engine().map(|e| e.report().nodes["kept"].faults);
    let kept = window.folder.0.join("kept");
    std::fs::create_dir_all(&kept).expect("a folder");
    std::os::unix::fs::symlink("/dev/full", kept.join("clip_0001.mkv")).expect("a link");
    window.key(Key::R);
    window.until("the clip is ended", |t| {
        t.remark().is_some_and(|r| r.contains("clip_0001.mkv ended early: the disk is full")) && t.clip_file().is_none()
    });
    assert_eq!(faults(window.theatre()), Some(1), "it was not opened again and again");
    window.until_notice("The disk is full: `kept` cannot write");
}

#[test]
fn a_drifted_calibration_and_swapped_cameras_have_notices() {
    if !has_plugin("phantom") || !has_plugin("stereo") {
        return;
    }
    let graph = |left: &str, right: &str, k1: f64| {
        format!(
            "plugins = [\"phantom\", \"stereo\", \"flow\"]\n[nodes.scope]\ntype = \"phantom\"\nparams = {{ width = 320, height = 240, distortion_k1 = {k1:.1} }}\n[nodes.match]\ntype = \"stereo_bm\"\ninputs = {{ left = \"scope.{left}\", right = \"scope.{right}\" }}\nparams = {{ drift_px = 0.3 }}\n[nodes.sink]\ntype = \"drain\"\ninputs = {{ image = \"scope.left\" }}\n[preset]\nviews = [\"match.disparity\", \"scope.left\"]\n"
        )
    };
    // An uncorrected lens distortion bends the rows, as with a calibration that does not fit any more.
    let mut window = Window::open("drift", &graph("left", "right", 0.4));
    window.until_notice("The calibration does not fit any more");
    drop(window);
    let mut window = Window::open("swapped", &graph("right", "left", 0.0));
    window.until_notice("The left and right cameras are swapped");
    assert!(window.notices().iter().all(|w| !w.contains("does not fit")), "{:?}", window.notices());
}
