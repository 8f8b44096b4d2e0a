//! What the theatre says can be read in every language: no text under 11 px or cut, and none over the middle of an image. German screens are
//! compared with golden images.

use crate::looks_graph as graph;
use std::time::{Duration, Instant};

use crate::common::window::{GRAPH, Window, options};
use crate::common::{Folder, PATIENCE, has_plugin};
use eframe::egui::epaint::{ClippedShape, TextShape};
use eframe::egui::{Context, Key, Rect, Shape, Ui, pos2, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::texts::{Language, set_language, text};
use panoscope_editor_widgets::Shot;
use panoscope_editor_widgets::golden::{compare, paint};
use panoscope_editor_widgets::theme::BLACK;
use panoscope_theatre::{Layout, OpenError, OpenFailed, Options, Theatre};

/// Size of the smallest text, px of the screen.
const MIN_PX: f32 = 11.0;
/// How far a glyph may reach out of its clip rectangle, points: the edges of letters are smooth.
const EDGE: f32 = 1.5;

/// Stereo cameras on a box that stands still, with its surface, an arm, a stage that fails on request, and more settings than there is space for.
const SURGERY: &str = r#"name = "surgery"
plugins = ["phantom", "stereo", "flow", "fixtures"]
[nodes.scope]
type = "phantom"
params = { scene = "box", width = 320, height = 240, rate_hz = 8, speed_mm_s = 0.0, breathing_mm = 0.0 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.polish]
type = "failing"
inputs = { image = "scope.left" }
params = { first = 0, ticks = 0 }
[nodes.calm]
type = "smooth"
inputs = { image = "scope.right" }
params = { past_weight = 100 }
[nodes.sink]
type = "drain"
inputs = { image = "calm.image" }
[nodes.arm]
type = "device"
inputs = { image = "polish.image" }
[preset]
views = [{ from = "calm.image", label = "calm view" }, "points.cloud", "scope.left"]
pinned = [{ param = "calm.past_weight", range = [50, 150], label = "calmness" }, { param = "polish.ticks", label = "faults" }]
"#;

/// An arm for a graph of images that do not change.
const ARM: &str = "[nodes.arm]\ntype = \"device\"\ninputs = { image = \"calm.image\" }\n\n[preset]";

/// The texts of a frame, each with the rectangle that it is clipped to.
fn texts(shapes: &[ClippedShape]) -> Vec<(Rect, TextShape)> {
    fn collect(clip: Rect, shape: &Shape, found: &mut Vec<(Rect, TextShape)>) {
        match shape {
            Shape::Text(text) => found.push((clip, text.clone())),
            Shape::Vec(all) => all.iter().for_each(|one| collect(clip, one, found)),
            _ => {}
        }
    }
    let mut found = Vec::new();
    shapes.iter().for_each(|clipped| collect(clipped.clip_rect, &clipped.shape, &mut found));
    found
}

/// Asserts that all texts of a frame can be read. `long` begins texts from elsewhere that may be cut, such as an error of a plugin.
fn assert_legible(ctx: &Context, shapes: &[ClippedShape], pictures: &[Rect], what: &str, long: &[&str]) {
    let (points, screen) = (ctx.pixels_per_point(), ctx.content_rect());
    let all = texts(shapes);
    assert!(all.len() > 3, "{what}: only {} texts", all.len());
    for (clip, shape) in all {
        let said = shape.galley.text().to_owned();
        if said.trim().is_empty() {
            continue;
        }
        let sizes = shape.galley.job.sections.iter().map(|section| section.format.font_id.size * points);
        let least = sizes.fold(f32::MAX, f32::min);
        assert!(least >= MIN_PX - 0.05, "{what}: `{said}` has {least:.1} px");
        let rect = shape.visual_bounding_rect();
        if !long.iter().any(|beginning| said.starts_with(beginning)) {
            assert!(!shape.galley.elided, "{what}: `{said}` is cut");
            let room = clip.intersect(screen).expand(EDGE);
            assert!(room.contains_rect(rect), "{what}: `{said}` at {rect:?} reaches out of {room:?}");
        }
        for picture in pictures {
            let middle = Rect::from_center_size(picture.center(), picture.size() * 0.5);
            assert!(!rect.intersects(middle), "{what}: `{said}` covers the middle of {picture:?}");
        }
    }
}

/// Size of the window, px.
const SIZES: [[f32; 2]; 3] = [[1280.0, 720.0], [1440.0, 900.0], [3840.0, 2160.0]];

fn resize(window: &mut Window, [width, height]: [f32; 2]) {
    // In points of the present scale.
    window.harness.set_size(vec2(width, height) / window.harness.ctx.pixels_per_point());
    // The scale follows in the next frames.
    (0..4).for_each(|_| window.harness.step());
}

/// Images on the screen, by the beginnings of their names.
fn pictures(window: &Window) -> Vec<Rect> {
    let eyes = [text!("eye-left"), text!("eye-both")].map(str::to_owned);
    let names = [text!("view-name", title = ""), text!("measure-name").to_owned()].into_iter().chain(eyes);
    let found: Vec<_> = names.collect();
    let found = found.iter().flat_map(|name| window.harness.query_all_by_label_contains(name.trim()));
    found.map(|node| node.rect()).filter(|rect| rect.width() > 100.0 && rect.height() > 100.0).collect()
}

fn check_at(window: &mut Window, size: [f32; 2], what: &str, long: &[&str]) {
    resize(window, size);
    let shown = pictures(window);
    assert!(!shown.is_empty(), "{what}: no image");
    let output = window.harness.output();
    assert_legible(&window.harness.ctx, &output.shapes, &shown, &format!("{what} at {size:?}"), long);
}

fn check(window: &mut Window, what: &str, long: &[&str]) {
    SIZES.into_iter().for_each(|size| check_at(window, size, what, long));
    resize(window, [1440.0, 960.0]);
}

/// Waits until no view waits for its first image.
fn until_all_pictures(window: &mut Window) {
    window.until("a picture", Theatre::has_picture);
    let until = Instant::now() + PATIENCE;
    let waits = |window: &Window| {
        let all = texts(&window.harness.output().shapes);
        all.iter().any(|(_, shape)| shape.galley.text().starts_with(text!("no-image-starting")))
    };
    while waits(window) {
        assert!(Instant::now() < until, "a view has no image");
        std::thread::sleep(Duration::from_millis(15));
        window.harness.step();
    }
}

fn walk(language: Language) {
    if !["flow", "phantom", "stereo"].iter().all(|plugin| has_plugin(plugin)) {
        return;
    }
    set_language(language);
    let code = language.code();
    let folder = Folder::new(&format!("legible_{code}"));
    let path = folder.write("g.toml", SURGERY);
    let options = options(&folder);
    let mut window = Window::open_with(folder, &path, options);
    until_all_pictures(&mut window);
    check(&mut window, "live", &[]);
    window.key(Key::C);
    window.until("a line for each point", |t| t.checklist().len() >= 5);
    check(&mut window, "checklist", &[]);
    window.key(Key::C);
    window.key(Key::Num1);
    assert_eq!(window.theatre().layout(), Layout::One(0));
    check(&mut window, "one view", &[]);
    window.key(Key::Plus);
    check(&mut window, "zoomed", &[]);
    window.key(Key::Num1);
    window.key(Key::F);
    assert!(window.theatre().is_frozen());
    check(&mut window, "frozen", &[]);
    window.key(Key::F);
    window.key(Key::M);
    window.until_shown(text!("measure-name"));
    check(&mut window, "measuring", &[]);
    for key in [Key::ArrowLeft, Key::Enter, Key::ArrowRight, Key::ArrowRight, Key::Enter] {
        window.key(key);
    }
    window.until("a distance", |t| t.distance().is_some());
    check(&mut window, "measured", &[]);
    window.key(Key::M);
    window.key(Key::R);
    window.until("a clip", |t| t.clip_file().is_some());
    check(&mut window, "recording", &[]);
    window.key(Key::R);
    window.until("no clip", |t| t.clip_file().is_none());
    window.key(Key::E);
    window.until_notice(text!("alarm-emergency"));
    // The notice below the first one is that of this clip or of the disk.
    check(&mut window, "arm stopped", &[]);
    for way in ["side by side", "top and bottom", "rows"] {
        window.key(Key::D);
        window.until("a pair", |t| t.pair_tick().is_some());
        window.harness.step();
        // Rows are one picture of the whole screen: textures of a test have no more than 2048 rows.
        let sizes = SIZES.into_iter().filter(|[width, _]| way != "rows" || *width < 2000.0);
        for size in sizes {
            check_at(&mut window, size, way, &[]);
            assert_pair_is_complete(&window, &format!("{way} at {size:?}"));
        }
        resize(&mut window, [1440.0, 960.0]);
    }
    window.key(Key::D);
}

/// Asserts that each eye sees the state, the mark of a graph that was not locked, and the stop of the arm with its texts inside.
fn assert_pair_is_complete(window: &Window, what: &str) {
    let stops: Vec<Rect> =
        window.harness.query_all_by_label(text!("stop-arm.release")).map(|stop| stop.rect()).collect();
    let eyes =
        window.harness.query_all_by_label_contains(text!("three-d-off").split(' ').next().expect("a word")).count();
    assert!(eyes > 0 && stops.len() == eyes, "{what}: {} stops for {eyes} eyes", stops.len());
    let all = texts(&window.harness.output().shapes);
    let of = |message: &str| -> Vec<Rect> {
        let found = all.iter().filter(|(_, shape)| shape.galley.text() == message);
        found.map(|(_, shape)| shape.visual_bounding_rect()).collect()
    };
    for message in [text!("arm-stopped"), text!("arm-stopped.hold")] {
        let found = of(message);
        assert_eq!(found.len(), eyes, "{what}: `{message}`");
        assert!(
            found.iter().all(|text| stops.iter().any(|stop| stop.contains_rect(*text))),
            "{what}: `{message}` at {found:?} in {stops:?}"
        );
    }
    let states = [text!("state-live"), text!("state-delayed")];
    assert_eq!(states.iter().map(|state| of(state).len()).sum::<usize>(), eyes, "{what}: live or delayed");
    assert_eq!(of(text!("mark-never")).len(), eyes, "{what}: the mark");
}

/// Size of the letters whose capitals are 40 px high: those of this font have 0.69 of it.
const HEADLINE_PX: f32 = 57.0;

#[test]
fn the_most_harmful_notice_is_large_on_one_line() {
    if !has_plugin("flow") {
        return;
    }
    for language in Language::ALL {
        set_language(language);
        let text = GRAPH.replace("type = \"drain\"", "type = \"device\"");
        let mut window = Window::open(&format!("headline_{}", language.code()), &text);
        window.until("a picture", Theatre::has_picture);
        window.key(Key::E);
        window.until_notice(text!("alarm-emergency"));
        for (size, least_px) in [([1920.0, 1080.0], HEADLINE_PX), ([1280.0, 720.0], HEADLINE_PX / 1.5)] {
            resize(&mut window, size);
            let points = window.harness.ctx.pixels_per_point();
            let all = texts(&window.harness.output().shapes);
            let size_px = |(_, shape): &(Rect, TextShape)| shape.galley.job.sections[0].format.font_id.size * points;
            let largest = all.iter().max_by(|a, b| size_px(a).total_cmp(&size_px(b))).expect("texts");
            let (headline, _) = text!("alarm-emergency").split_once(": ").expect("two parts");
            assert_eq!(largest.1.galley.text(), headline);
            // The scale of the window has steps of 5 %.
            assert!(size_px(largest) >= least_px * 0.97, "{} px at {size:?}", size_px(largest));
            assert_eq!(largest.1.galley.rows.len(), 1);
        }
    }
}

#[test]
fn english_can_be_read() {
    walk(Language::English);
}

#[test]
fn german_can_be_read() {
    walk(Language::German);
}

/// The window of a graph that was refused, with a reason of one word.
fn refused(language: Language, size: [f32; 2]) -> Harness<'static, Option<OpenFailed>> {
    set_language(language);
    let draw = move |ui: &mut Ui, failed: &mut Option<OpenFailed>| {
        let make = || OpenFailed::new(ui.ctx(), "graphs/surgery.toml".as_ref(), &OpenError::NoPicture, Shot::default());
        failed.get_or_insert_with(make).ui(ui);
    };
    let mut harness = Harness::builder().with_size(vec2(size[0], size[1])).build_ui_state(draw, None);
    (0..3).for_each(|_| harness.step());
    harness
}

#[test]
fn a_refusal_can_be_read() {
    for language in Language::ALL {
        for size in SIZES {
            let harness = refused(language, size);
            assert_legible(&harness.ctx, &harness.output().shapes, &[], &format!("refused, {language:?}"), &[]);
            assert!(harness.query_by_label(text!("refused-title")).is_some());
        }
    }
}

#[test]
fn the_language_changes_by_a_key() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = Window::open("language_key", GRAPH);
    window.until("a picture", Theatre::has_picture);
    assert!(window.harness.query_by_label("Freeze").is_some());
    window.key(Key::L);
    assert_eq!(window.theatre().remark(), Some("Die Sprache ist Deutsch"));
    assert!(window.harness.query_by_label("Einfrieren").is_some() && window.harness.query_by_label("Freeze").is_none());
    assert!(window.harness.query_by_label_contains("Ansicht Calm view").is_some());
    window.key(Key::L);
    assert_eq!(window.theatre().remark(), Some("The language is English"));
    assert!(window.harness.query_by_label("Freeze").is_some());
}

/// Opens a graph of images that do not change, with an arm, in German, in a small window.
fn calm(name: &str) -> Window {
    set_language(Language::German);
    let folder = Folder::new(name);
    let text = graph::GRAPH.replace("[preset]", ARM).replace(r#"["flow"]"#, r#"["flow", "fixtures"]"#);
    let path = folder.write("looks.toml", &text);
    let options = Options { frames: Some(graph::TICKS), ..options(&folder) };
    let mut window = Window::open_with(folder, &path, options);
    resize(&mut window, [1280.0, 720.0]);
    window.until("it has ended", |t| {
        t.notices().iter().any(|n| n.message == "Die Quelle ist zu Ende") && t.has_picture()
    });
    let ended = Instant::now();
    window.until("all is at rest, and old", |_| ended.elapsed() > Duration::from_millis(1500));
    window
}

/// Compares a screen with its golden image; the ages above the images and in the bar grow and are masked, and so are lines of the checklist about
/// this machine.
fn compare_screen(window: &mut Window, name: &str) {
    (0..3).for_each(|_| window.harness.step());
    let points = window.harness.ctx.pixels_per_point();
    let titles = pictures(window)
        .into_iter()
        .map(|view| Rect::from_min_max(pos2(view.right() - 180.0, view.top()), pos2(view.right(), view.top() + 32.0)));
    let of_machine = ["Checkliste", "Prüfpunkt Kamera", "Prüfpunkt Speicher"];
    let lines = of_machine.into_iter().flat_map(|name| window.harness.query_all_by_label_contains(name));
    let masked: Vec<Rect> = titles.chain(lines.map(|line| line.rect())).map(|rect| rect * points).collect();
    let picture = paint(&window.harness.ctx, window.harness.output(), &window.textures, BLACK);
    compare(name, picture, &masked);
}

#[test]
fn german_screens_match_their_golden_images() {
    if !has_plugin("flow") {
        return;
    }
    let mut window = calm("golden_german");
    compare_screen(&mut window, "german_views");
    window.key(Key::E);
    window.until_notice("Not-Halt: Arm gestoppt");
    compare_screen(&mut window, "german_arm_stopped");
    window.key(Key::C);
    window.until("the checklist", |t| !t.checklist().is_empty());
    compare_screen(&mut window, "german_checklist");
}
