//! What the surgeon sees: zoom, a second view in a corner, the stereo pair for 3-D displays; and a pedal with keys of its own.

use std::time::{Duration, Instant};

use crate::common::window::{GRAPH, Window, options};
use crate::common::{Folder, PATIENCE, has_plugin, input};
use eframe::egui::{Key, Rect, Vec2, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::session::Phase;
use panoscope_theatre::{Layout, Options, State, Theatre, ThreeD};

/// A stereo camera with a stage that is rectified already, and a path that nobody touches.
const STEREO: &str = r#"name = "stereo"
plugins = ["phantom", "flow", "fixtures"]
[nodes.scope]
type = "phantom"
params = { scene = "box", width = 160, height = 120 }
[nodes.sink]
type = "drain"
inputs = { image = "scope.left" }
[nodes.other]
type = "drain"
inputs = { image = "scope.right" }
[nodes.a]
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 50.0 }
[nodes.kept]
type = "ledger"
inputs = { images = [{ from = "a.image", queue = 64 }] }
params = { path = "kept.jsonl" }
[nodes.arm]
type = "device"
inputs = { image = "a.image" }
[preset]
views = ["scope.left"]
"#;

fn rect(window: &Window, label: &str) -> Rect {
    window.harness.get_by_label_contains(label).rect()
}

fn nothing_dropped(window: &Window, nodes: &[&str]) {
    let engine = window.theatre().session().expect("it runs here").handle().engine().expect("it runs");
    let count = || engine.report().nodes[nodes[0]].count;
    let end = Instant::now() + PATIENCE;
    while count() <= 5 && Instant::now() < end {
        std::thread::sleep(Duration::from_millis(10));
    }
    let report = engine.report();
    for node in nodes {
        assert_eq!((report.nodes[*node].dropped, report.nodes[*node].faults), (0, 0), "{node}");
    }
    assert!(report.nodes[nodes[0]].count > 5, "it runs on");
}

#[test]
fn the_main_view_is_zoomed_and_another_one_stands_in_its_corner() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("zoom", GRAPH);
    window.until("a picture", Theatre::has_picture);
    window.key(Key::Num1);
    assert_eq!(window.theatre().layout(), Layout::One(0));
    window.key(Key::Plus);
    window.key(Key::Plus);
    assert!((window.theatre().zoom() - 1.5625).abs() < 1e-3);
    window.until_shown("Calm view  \u{b7}  1.6 x");
    // The whole picture is in a corner, and covers no middle.
    window.until_shown("Whole picture");
    let (main, whole) = (rect(&window, "View Calm view"), rect(&window, "Whole picture"));
    let middle = Rect::from_center_size(main.center(), main.size() * 0.5);
    assert!(!whole.intersects(middle), "{whole:?} covers the middle of {main:?}");
    // A drag and the arrows move the view.
    input::drag(&mut window.harness, main.center(), main.center() - vec2(120.0, 60.0));
    assert_eq!(window.theatre().layout(), Layout::One(0), "a drag is no tap");
    window.key(Key::Minus);
    window.key(Key::Minus);
    assert!((window.theatre().zoom() - 1.0).abs() < 1e-3);
    assert!(window.harness.query_by_label("Whole picture").is_none());

    window.key(Key::I);
    window.until_shown("View Camera");
    let (main, corner) = (rect(&window, "View Calm view"), rect(&window, "View Camera"));
    assert!(corner.width() < main.width() / 2.0, "{corner:?}");
    let middle = Rect::from_center_size(main.center(), main.size() * 0.5);
    assert!(!corner.intersects(middle), "{corner:?} covers the middle of {main:?}");
    window.key(Key::I);
    assert!(window.harness.query_by_label_contains("View Camera").is_none());
    // Another layout starts unzoomed.
    window.key(Key::Plus);
    window.key(Key::Space);
    assert_eq!(window.theatre().zoom(), 1.0);
    nothing_dropped(&window, &["sink"]);
}

/// Half of the window, whose frame in tests is 8 points wide.
const HALF: Vec2 = vec2(712.0, 472.0);

#[test]
fn a_pair_that_comes_from_another_process_is_of_one_tick() {
    if !has_plugin("flow") || !has_plugin("phantom") {
        return;
    }
    let mut window = Window::guarded("three_d_guarded", STEREO);
    window.key(Key::D);
    window.until("a pair whose tick is known", |t| t.pair_tick().is_some_and(|tick| tick > 0));
}

#[test]
fn the_stereo_pair_is_shown_for_3d_displays() {
    if !has_plugin("flow") || !has_plugin("phantom") {
        return;
    }
    let mut window = Window::open("three_d", STEREO);
    window.until("a picture", Theatre::has_picture);
    window.key(Key::D);
    assert_eq!(window.theatre().three_d(), ThreeD::SideBySide);
    window.until("a pair", |t| t.pair_tick().is_some());
    window.harness.step();
    let (left, right) = (rect(&window, "Left eye"), rect(&window, "Right eye"));
    assert_eq!(left.size(), right.size());
    assert!(
        (right.left() - left.left() - HALF.x).abs() < 1.0 && (right.top() - left.top()).abs() < 0.1,
        "{left:?} {right:?}"
    );
    // Stretched to twice its width the image has its proportions.
    assert!((2.0 * left.width() / left.height() - 160.0 / 120.0).abs() < 0.02, "{left:?}");
    // The stop of the arm is there for both eyes, at the same place, and not on the image.
    let stops: Vec<Rect> =
        window.harness.get_all_by_label("Emergency stop of the arm").map(|stop| stop.rect()).collect();
    assert_eq!(stops.len(), 2);
    assert!(stops.iter().all(|stop| !stop.intersects(left) && !stop.intersects(right)), "{stops:?}");
    assert!((stops[1].left() - stops[0].left() - HALF.x).abs() < 1.0);
    window.key(Key::D);
    assert_eq!(window.theatre().three_d(), ThreeD::TopBottom);
    window.until("a pair", |t| t.pair_tick().is_some());
    window.harness.step();
    let (left, right) = (rect(&window, "Left eye"), rect(&window, "Right eye"));
    assert!((right.top() - left.top() - HALF.y).abs() < 1.0 && (right.left() - left.left()).abs() < 0.1);
    assert!((left.width() / (2.0 * left.height()) - 160.0 / 120.0).abs() < 0.02, "{left:?}");
    window.key(Key::D);
    assert_eq!(window.theatre().three_d(), ThreeD::Rows);
    window.until("a pair", |t| t.pair_tick().is_some());
    window.harness.step();
    window.until_shown("Both eyes");
    // The arm is stopped by its key in 3-D too.
    window.key(Key::E);
    assert!(window.theatre().is_stopped());
    window.key(Key::D);
    assert_eq!(window.theatre().three_d(), ThreeD::Off);
    window.until_shown("View ");
    nothing_dropped(&window, &["kept", "a"]);
}

#[test]
fn a_graph_without_a_pair_says_so() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("no_pair", GRAPH);
    window.until("a picture", Theatre::has_picture);
    window.key(Key::D);
    assert_eq!(window.theatre().three_d(), ThreeD::Off);
    assert!(window.theatre().remark().is_some_and(|remark| remark.contains("no stereo pair")));
}

#[test]
fn a_pedal_has_the_keys_of_its_file_and_mistakes_are_named() {
    if !has_plugin("flow") {
        return;
    }
    let open = |name: &str, text: &str| {
        let folder = Folder::new(name);
        let pedal = Some(folder.write("pedal.toml", text));
        let path = folder.write("g.toml", GRAPH);
        let options = Options { pedal, ..options(&folder) };
        let mut window = Window::open_with(folder, &path, options);
        window.until("it runs", |t| t.session().expect("it runs here").status().phase == Phase::Running);
        window.until("a picture", Theatre::has_picture);
        window
    };
    let mut window = open("pedal", "[keys]\nB = \"freeze\"\nF13 = \"view2\"\n");
    window.key(Key::B);
    assert!(window.theatre().is_frozen());
    window.key(Key::B);
    window.key(Key::F13);
    assert_eq!((window.theatre().is_frozen(), window.theatre().layout()), (false, Layout::One(1)));
    window.key(Key::F14);
    assert!(!window.theatre().is_frozen(), "the usual keys are replaced");
    window.key(Key::C);
    window.until("its line is ready", |t| {
        t.checklist()
            .iter()
            .any(|check| check.name == "Pedal" && check.state == State::Ready && check.words == "2 keys")
    });
    nothing_dropped(&window, &["sink"]);
    drop(window);
    let mut window = open("wrong_pedal", "[keys]\nF13 = \"fly\"\n");
    window.until_notice("The pedal's settings are not used");
    window.until_notice("there is no action `fly`");
    window.key(Key::F14);
    assert!(window.theatre().is_frozen(), "the usual keys work");
}
