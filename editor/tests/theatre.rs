//! The theatre on running graphs, by keys, taps and names of widgets.

mod common;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use common::{Folder, PATIENCE, has_plugin};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers, Ui, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use panoscope_editor::session::Phase;
use panoscope_editor::theatre::{Layout, OpenError, Options, Theatre};
use panoscope_graph::ParamValue;
use panoscope_runtime::lock::{Lock, THEATRE_PLUGINS};

/// A camera, two stages, a setting.
const GRAPH: &str = r#"# Seen by a surgeon.
name = "case"
plugins = ["flow"]

[nodes.camera]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 30.0 }

[nodes.calm]
type = "smooth"
inputs = { image = "camera.image" }
params = { past_weight = 100 }

[nodes.sink]
type = "drain"
inputs = { image = "calm.image" }

[preset]
views = [{ from = "calm.image", label = "calm view" }, "camera.image"]
pinned = [{ param = "calm.past_weight", range = [50, 150], label = "calmness" }]
"#;

struct Window {
    harness: Harness<'static, Option<Theatre>>,
    folder: Folder,
}

fn options(folder: &Folder) -> Options {
    Options { folder: folder.0.join("kept"), ..Options::default() }
}

impl Window {
    fn open(name: &str, text: &str) -> Self {
        let folder = Folder::new(name);
        let path = folder.write("g.toml", text);
        Self::open_file(folder, path)
    }

    fn open_file(folder: Folder, path: PathBuf) -> Self {
        let options = options(&folder);
        let draw = move |ui: &mut Ui, theatre: &mut Option<Theatre>| {
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            let theatre = theatre
                .get_or_insert_with(|| Theatre::open(ui.ctx(), &path, &text, options.clone()).expect("it opens"));
            theatre.ui(ui);
        };
        let harness = Harness::builder().with_size(vec2(1440.0, 960.0)).build_ui_state(draw, None);
        let mut window = Self { harness, folder };
        window.until("it runs", |t| t.session().status().phase == Phase::Running);
        window
    }

    fn theatre(&self) -> &Theatre {
        self.harness.state().as_ref().expect("it is open")
    }

    fn until(&mut self, what: &str, holds: impl Fn(&Theatre) -> bool) {
        let until = Instant::now() + PATIENCE;
        self.harness.step();
        while !holds(self.theatre()) {
            let told = self.theatre().notices();
            assert!(Instant::now() < until, "not in time: {what}; told is {told:?}");
            std::thread::sleep(Duration::from_millis(15));
            self.harness.step();
        }
    }

    fn until_shown(&mut self, label: &str) {
        let until = Instant::now() + PATIENCE;
        while self.harness.query_by_label_contains(label).is_none() {
            assert!(Instant::now() < until, "nothing is called `{label}`");
            std::thread::sleep(Duration::from_millis(15));
            self.harness.step();
        }
    }

    fn key(&mut self, key: Key) {
        self.harness.key_press_modifiers(Modifiers::NONE, key);
        self.harness.step();
        self.harness.step();
    }

    fn past_weight(&self) -> Option<ParamValue> {
        let engine = self.theatre().session().handle().engine()?;
        engine.param_values("calm")?.first().cloned()
    }

    fn kept(&self) -> Vec<String> {
        let files = std::fs::read_dir(self.folder.0.join("kept")).into_iter().flatten().flatten();
        let mut names: Vec<String> = files.map(|f| f.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    fn told(&self) -> Vec<String> {
        self.theatre().notices().iter().map(|n| n.words.clone()).collect()
    }
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
    window.harness.get_by_label("View Calm view").click();
    window.harness.step();
    window.harness.step();
    assert_eq!(window.theatre().layout(), Layout::All);
    window.harness.get_by_label("Layout").click();
    window.harness.step();
    window.harness.step();
    assert_eq!(window.theatre().layout(), Layout::One(0));
}

#[test]
fn only_pinned_settings_can_be_touched_and_only_within_their_range() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("settings", GRAPH);
    window.until("the value is known", |t| t.session().handle().engine().is_some());
    window.until_shown("Calmness");
    let slider = window.harness.get_by_role_and_label(Role::Slider, "Calmness");
    let rect = slider.rect();
    let far = rect.right_center() + vec2(200.0, 0.0);
    window.harness.hover_at(rect.center());
    window.harness.step();
    window.harness.drag_at(rect.center());
    window.harness.step();
    window.harness.hover_at(far);
    window.harness.step();
    window.harness.drop_at(far);
    window.harness.step();
    let until = Instant::now() + PATIENCE;
    while window.past_weight() != Some(ParamValue::Int(150)) {
        assert!(Instant::now() < until, "it is {:?}", window.past_weight());
        std::thread::sleep(Duration::from_millis(15));
        window.harness.step();
    }
    let text = std::fs::read_to_string(window.folder.0.join("g.toml")).expect("it is there");
    assert_eq!(text, GRAPH, "nothing is written");
    // Keys that edit in the bench do nothing here.
    for key in [Key::Delete, Key::A, Key::B, Key::W] {
        window.key(key);
    }
    let engine = window.theatre().session().handle().engine().expect("it runs");
    assert_eq!(engine.graph().nodes.len(), 3);
}

#[test]
fn a_frozen_picture_says_so_and_a_live_one_stays_beside_it() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("freeze", GRAPH);
    window.until("the first pictures are there", |t| t.notices().is_empty() && t.has_picture());
    window.key(Key::F);
    assert!(window.theatre().is_frozen());
    window.until_shown("View Live: Image camera");
    window.harness.get_by_label("Go on").click();
    window.harness.step();
    window.harness.step();
    assert!(!window.theatre().is_frozen());
}

#[test]
fn stills_and_clips_are_kept_under_numbers() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let mut window = Window::open("keep", GRAPH);
    window.until("a picture is there", Theatre::has_picture);
    window.key(Key::S);
    window.until("the still is kept", |t| t.remark().is_some_and(|r| r.contains("still_0001.png is kept")));
    window.key(Key::R);
    let node = "theatre_clip";
    window.until("the clip runs", |t| {
        let engine = t.session().handle().engine().expect("it runs");
        engine.report().nodes.get(node).is_some_and(|n| n.count > 10)
    });
    assert!(window.theatre().clip_file().is_some_and(|f| f.ends_with("clip_0002.mkv")));
    let before = window.theatre().session().handle().engine().expect("it runs").report().nodes["calm"].dropped;
    window.harness.get_by_label("End clip").click();
    window.until("the clip is over", |t| {
        let engine = t.session().handle().engine().expect("it runs");
        t.clip_file().is_none() && engine.graph().node(node).is_none()
    });
    let after = window.theatre().session().handle().engine().expect("it runs").report().nodes["calm"].dropped;
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
    window.until("the stage is named", |t| t.notices().iter().any(|n| n.words.contains("Stage `calm`")));
    window.until("the view has stopped", |t| t.notices().iter().any(|n| n.words == "Calm view has stopped"));
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
    window.until("only the camera runs", |t| t.notices().iter().any(|n| n.words.starts_with("Camera picture only")));
    window.until("it runs again", |t| {
        let engine = t.session().handle().engine().expect("it runs");
        t.session().status().phase == Phase::Running && engine.graph().nodes.len() == 1
    });
    window.until_shown("View Image camera");
    window.harness.get_by_label("Start again").click();
    window.until("the whole graph is there", |t| {
        t.session().handle().engine().is_some_and(|e| e.graph().nodes.len() == 3)
    });
}

#[test]
fn a_camera_that_ends_is_told() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("ends");
    let path = folder.write("g.toml", GRAPH);
    let options = Options { frames: Some(20), ..options(&folder) };
    let draw = move |ui: &mut Ui, theatre: &mut Option<Theatre>| {
        theatre.get_or_insert_with(|| Theatre::open(ui.ctx(), &path, GRAPH, options.clone()).expect("it opens")).ui(ui);
    };
    let harness = Harness::builder().with_size(vec2(1440.0, 960.0)).build_ui_state(draw, None);
    let mut window = Window { harness, folder };
    window.until("it is told", |t| t.notices().iter().any(|n| n.words == "The source has ended"));
    window.until_shown("Start again");
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
    assert!(!window.theatre().has_left());
    window.harness.key_down(Key::Escape);
    let start = Instant::now();
    window.until("it leaves", Theatre::has_left);
    assert!(start.elapsed() >= Duration::from_secs(2), "{:?}", start.elapsed());
}

#[test]
fn a_locked_preset_opens_only_as_it_was_locked_or_when_it_is_said() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("locked");
    let path = folder.write("g.toml", GRAPH);
    lock(&path);
    let open = |unlocked, text: &str| {
        let context = eframe::egui::Context::default();
        Theatre::open(&context, &path, text, Options { unlocked, ..options(&folder) }).map(drop)
    };
    open(false, GRAPH).expect("as it was locked");
    let other = GRAPH.replace("rate_hz = 30.0", "rate_hz = 25.0");
    match open(false, &other) {
        Err(OpenError::Locked(differences)) => {
            let words: Vec<String> = differences.iter().map(ToString::to_string).collect();
            assert_eq!(words, ["graph `g.toml` has changed since the graph was locked"]);
        }
        other => panic!("{other:?}"),
    }
    std::fs::write(&path, &other).expect("written");
    let mut window = Window { harness: harness_unlocked(&path, &folder), folder };
    window.until("it is told", |t| t.notices().iter().any(|n| n.words.starts_with("Runs unlocked: graph `g.toml`")));
}

fn harness_unlocked(path: &Path, folder: &Folder) -> Harness<'static, Option<Theatre>> {
    let (path, options) = (path.to_owned(), Options { unlocked: true, ..options(folder) });
    let draw = move |ui: &mut Ui, theatre: &mut Option<Theatre>| {
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        theatre.get_or_insert_with(|| Theatre::open(ui.ctx(), &path, &text, options.clone()).expect("it opens")).ui(ui);
    };
    Harness::builder().with_size(vec2(1440.0, 960.0)).build_ui_state(draw, None)
}

fn lock(path: &Path) {
    use panoscope_graph::{GraphText, check};
    use panoscope_runtime::{Loader, loader};
    let loader = Loader::search(&loader::search_path(&[]));
    let text = GraphText::load(path).expect("it is there");
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().expect("it is right");
    let lock = Lock::of(&graph, &catalog, &loader, path, text.text(), &THEATRE_PLUGINS);
    assert!(lock.files.iter().all(|f| !f.sha256.is_empty()), "{lock:?}");
    lock.write(path).expect("it is written");
}

#[test]
fn the_emergency_stop_is_there_where_there_is_an_arm_and_outlasts_changes() {
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
        let values = t.session().handle().engine().and_then(|e| e.param_values("sink"));
        values.is_some_and(|v| v[1] == ParamValue::Bool(true))
    };
    let centre = window.harness.get_by_label("Emergency stop of the arm").rect().center();
    window.harness.hover_at(centre);
    window.harness.step();
    window.harness.drag_at(centre);
    window.harness.step();
    window.harness.step();
    assert!(window.theatre().is_stopped() && stopped(window.theatre()), "on touch, at once");
    window.harness.drop_at(centre);
    window.until("it is told", |t| t.notices().first().is_some_and(|n| n.words.starts_with("Emergency stop")));
    // A change of the graph does not let it go, nor does another press.
    window.key(Key::R);
    window.until("the clip runs", |t| {
        t.session().handle().engine().is_some_and(|e| e.graph().node("theatre_clip").is_some())
    });
    window.key(Key::E);
    assert!(window.theatre().is_stopped() && stopped(window.theatre()));
    // Held for two seconds it does.
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
    let text = r#"plugins = ["phantom", "stereo", "flow"]
[nodes.scope]
type = "phantom"
params = { scene = "box", width = 320, height = 240 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.sink]
type = "drain"
inputs = { image = "scope.left" }
[preset]
views = ["scope.left", "points.cloud"]
"#;
    let mut window = Window::open("measure", text);
    window.key(Key::M);
    window.until_shown("Measure here");
    assert!(window.theatre().is_frozen());
    let rect = window.harness.get_by_label("Measure here").rect();
    for share in [0.4, 0.6] {
        let at = rect.min + rect.size() * share;
        window.harness.hover_at(at);
        window.harness.step();
        window.harness.drag_at(at);
        window.harness.step();
        window.harness.drop_at(at);
        window.harness.step();
    }
    window.harness.step();
    let length = window.theatre().distance().expect("both points are known");
    assert!((1.0..100.0).contains(&length.mm), "{length}");
    window.until("the error is known", |t| t.distance().is_some_and(|l| l.error_mm.is_some()));
    let length = window.theatre().distance().expect("both points are known");
    assert!(
        length.error_mm.is_some_and(|e| e > 0.0 && e < length.mm) && length.to_string().contains(" ± "),
        "{length}"
    );
    window.key(Key::S);
    window.until("the still is kept", |t| t.remark().is_some_and(|r| r.contains("is kept")));
    window.key(Key::M);
    assert!(!window.theatre().is_frozen());
    assert!(window.told().iter().all(|w| !w.contains("stopped")), "{:?}", window.told());
    assert_eq!(window.theatre().distance(), None);
}
