//! Tests of the window on running graphs, by keys, pointer and names of widgets.

use crate::common;
use crate::common::{Folder, GRAPH, Window, has_plugin, input, nothing_lost};
use eframe::egui::accesskit::Role;
use eframe::egui::{Event, Key, Modifiers, OutputCommand, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::App;
use panoscope_editor_model::surface::Viewpoint;
use panoscope_graph::ParamValue;
use panoscope_host::loader::{self as loader, Loader};

const NONE: Modifiers = Modifiers::NONE;
const CTRL: Modifiers = Modifiers::COMMAND;

fn weight(window: &Window) -> Option<ParamValue> {
    let engine = window.app().session().handle().engine()?;
    engine.param_values("mean")?.first().cloned()
}

#[test]
fn a_slider_tunes_the_running_graph_and_undo_takes_it_back() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("slider");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    assert!(!window.app().document().is_changed(), "looking changes nothing");
    window.select("mean");
    assert!(!window.app().document().is_changed(), "showing a value changes nothing");
    window.harness.get_by_role_and_label(Role::Slider, "past_weight").focus();
    window.steps(2);
    window.key(NONE, Key::ArrowRight);
    window.until("the value is applied", |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.param_values("mean").is_some_and(|v| v[0] == ParamValue::Int(101))
    });
    window.settled();
    let text = GRAPH.replace("past_weight = 100", "past_weight = 101");
    assert_eq!(**window.app().document().text(), text, "nothing but the value changed");
    window.until_shown("past_weight differs from the file");
    window.select("mean");
    window.harness.get_by_role_and_label(Role::Slider, "past_weight").focus();
    window.key(NONE, Key::Escape);
    window.key(CTRL, Key::Z);
    window.settled();
    assert_eq!(**window.app().document().text(), *GRAPH);
    assert_eq!(weight(&window), Some(ParamValue::Int(100)));
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_click_on_a_picture_opens_it_large_and_escape_closes_it() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("viewer");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.steps(3);
    window.harness.get_by_label("Node mean").click();
    window.steps(3);
    assert_eq!(window.app().viewed().map(ToString::to_string).as_deref(), Some("mean.image"));
    window.until_shown("64 x 48 px");
    window.key(NONE, Key::C);
    window.until_shown("Difference");
    window.harness.get_by_label("Difference").click();
    window.steps(3);
    window.key(NONE, Key::Escape);
    assert_eq!(window.app().viewed(), None);
    window.harness.get_by_label("Node mean");
}

#[test]
fn a_click_on_a_mistake_leads_to_its_line() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("line");
    let notes: String = (0..200).map(|n| format!("# note {n}\n")).collect();
    let text = format!("{notes}{GRAPH}").replace("mode = \"live\"", "mode = \"lively\"");
    let mut window = Window::open(&folder.write("g.toml", &text));
    window.steps(3);
    assert!(window.harness.query_by_label("Text of the file").is_none());
    window.key(NONE, Key::M);
    window.harness.get_by_label_contains("line 203: \"lively\"").click_accesskit();
    window.steps(40);
    let shown = window.harness.get_by_label("Text of the file").rect();
    // The line is visible, at the height in the text that follows from its number.
    let line = shown.top() + shown.height() * 203.0 / (text.lines().count() + 1) as f32;
    assert!(shown.top() < -1000.0 && (60.0..880.0).contains(&line), "{shown:?} {line}");
}

#[test]
fn rebuilt_plugins_are_loaded_by_a_key_and_damaged_ones_are_refused() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("rebuilt");
    let plugins = folder.0.join("plugins");
    std::fs::create_dir_all(&plugins).expect("a folder");
    let loader = Loader::search(&loader::search_path(&[]));
    let built = loader.found().find(|f| f.note.name == "flow").expect("looked for above").file.clone();
    let (file, whole) = (plugins.join(built.file_name().expect("a file")), std::fs::read(&built).expect("readable"));
    std::fs::write(&file, &whole).expect("written");
    let path = folder.write("g.toml", &GRAPH.replace("plugins = [", "plugin_paths = [\"plugins\"]\nplugins = ["));
    let mut window = Window::run(&path);
    let old = window.app().session().status().generation;

    std::fs::write(&file, &whole[..whole.len() / 2]).expect("written");
    window.key(CTRL, Key::R);
    window.until("the truncated plugin is refused", |app| app.session().status().problem.is_some());
    window.key(NONE, Key::M);
    window.until_shown("change not applied");
    window.key(NONE, Key::M);
    assert_eq!(window.app().session().status().generation, old);

    let (was, is) = (b"Forwards frames without a copy.", b"Forwards frames, newly compiled");
    let mut rebuilt = whole.clone();
    let at = rebuilt.windows(was.len()).position(|w| w == was).expect("the text of `pass`");
    rebuilt[at..at + is.len()].copy_from_slice(is);
    std::fs::write(&file, &rebuilt).expect("written");
    window.key(CTRL, Key::R);
    window.until("the new one is in", |app| app.session().status().generation > old);
    assert!(window.app().session().status().problem.is_none());
    // The descriptions of nodes come from the new plugin.
    window.key(NONE, Key::A);
    window.type_text("newly compiled");
    window.until_shown("Pick pass");
    window.key(NONE, Key::Escape);
    let report = window.close();
    assert!(report.nodes["kept"].faults == 0 && report.nodes["mean"].faults == 0, "{report:?}");
}

#[test]
fn add_wire_tune_undo_save_and_reload_while_it_runs() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("edit");
    let path = folder.write("g.toml", GRAPH);
    let mut window = Window::run(&path);
    // Add a node: it has no wire yet, and the old graph keeps running.
    window.key(NONE, Key::A);
    window.until_shown("Pick every_nth");
    window.type_text("every");
    window.key(NONE, Key::Enter);
    assert_eq!(window.app().selected().as_deref(), Some("every_nth"));
    assert!(!window.app().document().view().valid);
    assert!(!window.running().contains(&"every_nth".to_owned()));
    // Connect it by keyboard: now the change is applied.
    window.key(NONE, Key::W);
    window.until_shown("Pick image from mean.image");
    window.type_text("mean");
    window.key(NONE, Key::Enter);
    window.settled();
    assert!(window.running().contains(&"every_nth".to_owned()));
    // Rewire the sink by dragging.
    window.key(NONE, Key::F);
    window.steps(3);
    window.drag("Output every_nth.image", "Input sink.image");
    window.settled();
    let text = window.app().document().text().to_string();
    assert!(text.contains("inputs = { image = \"every_nth.image\" }"), "{text}");
    assert!(text.starts_with("# Two paths.") && text.contains("# of 256"), "comments stay: {text}");
    window.until("ticks arrive by the new way", |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.report().nodes.get("every_nth").is_some_and(|n| n.count > 5)
    });
    // Save, undo everything, redo everything.
    window.key(CTRL, Key::S);
    assert_eq!(std::fs::read_to_string(&path).expect("saved"), text);
    assert_eq!(std::fs::read_to_string(folder.0.join("g.toml.bak")).expect("kept"), GRAPH);
    assert!(!window.app().document().is_changed());
    let steps = window.app().document().steps();
    (0..steps).for_each(|_| window.key(CTRL, Key::Z));
    window.settled();
    assert_eq!(**window.app().document().text(), *GRAPH, "byte for byte");
    assert!(!window.running().contains(&"every_nth".to_owned()));
    (0..steps).for_each(|_| window.key(Modifiers::COMMAND | Modifiers::SHIFT, Key::Z));
    window.settled();
    assert_eq!(**window.app().document().text(), *text);
    // Another program writes the file.
    std::fs::write(&path, text.replace("past_weight = 100", "past_weight = 7")).expect("written");
    window.until("the file is read again", |app| app.document().text().contains("past_weight = 7"));
    window.settled();
    assert_eq!(weight(&window), Some(ParamValue::Int(7)));
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_conflict_is_shown_and_nothing_is_lost() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("conflict");
    let path = folder.write("g.toml", GRAPH);
    let mut window = Window::run(&path);
    window.select("sink");
    window.key(NONE, Key::Delete);
    window.settled();
    let (ours, theirs) = (window.app().document().text().to_string(), GRAPH.replace("Two paths", "Theirs"));
    std::fs::write(&path, &theirs).expect("written");
    window.until_shown("Take the file's");
    assert_eq!(**window.app().document().text(), *ours);
    // The bar shows what differs: the comment of the file, the nodes that the window's text lacks.
    window.until_shown("Difference: 1 in this window (-)");
    window.harness.get_by_label("Text of the difference");
    // Saving does not overwrite a text that the user has not seen.
    window.key(CTRL, Key::S);
    assert_eq!(std::fs::read_to_string(&path).expect("read"), theirs);
    window.harness.get_by_label("Take the file's").click();
    window.steps(3);
    assert_eq!(**window.app().document().text(), *theirs);
    window.key(CTRL, Key::Z);
    assert_eq!(**window.app().document().text(), *ours, "undo brings it back");
}

#[test]
fn a_node_is_bypassed_and_put_back() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("bypass");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.select("mean");
    window.key(NONE, Key::B);
    window.settled();
    assert!(
        window.app().document().text().contains("[nodes.sink]\ntype = \"drain\"\ninputs = { image = \"b.image\" }")
    );
    window.select("mean");
    window.key(NONE, Key::B);
    window.settled();
    assert_eq!(**window.app().document().text(), *GRAPH);
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_wire_of_the_wrong_type_is_refused_with_a_reason() {
    if !has_plugin("flow") || !has_plugin("phantom") || !has_plugin("stitch") {
        return;
    }
    let folder = Folder::new("refuse");
    let text = r#"plugins = ["phantom", "stitch"]
[nodes.scope]
type = "phantom"
[nodes.wide]
type = "composite"
inputs = { left = "scope.left", right = "scope.right", homography = "scope.homography" }
"#;
    let mut window = Window::run(&folder.write("g.toml", text));
    window.steps(3);
    window.drag("Output scope.left", "Input wide.homography");
    assert_eq!(**window.app().document().text(), *text);
    let view = window.app().document().view().clone();
    let why = view.check_wire(0, "left", 1, "homography").expect_err("another type");
    assert_eq!(why.to_string(), "this input accepts homography, but the output sends image");
    assert!(view.check_wire(1, "panorama", 0, "camera_pose").is_err());
}

#[test]
fn faults_show_and_the_window_stays() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("faults");
    let text = GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"b.image\" }\nparams = { past_weight = 100 }",
        "type = \"failing\"\ninputs = { image = \"b.image\" }\nparams = { how = \"panic\", first = 3, ticks = 1000000 }",
    );
    let mut window = Window::run(&folder.write("g.toml", &text));
    window.select("mean");
    window.until_shown("LAST FAULT");
    window.key(NONE, Key::M);
    window.until_shown("FAULTS, NEWEST FIRST");
    assert_eq!(window.app().selected().as_deref(), Some("mean"));
    let report = window.close();
    assert!(report.nodes["mean"].faults > 0);
    nothing_lost(&folder, &report);
}

#[test]
fn a_file_with_mistakes_opens_with_them_and_runs_once_they_are_fixed() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("mistakes");
    let path = folder.write("g.toml", &GRAPH.replace("\"b.image\"", "\"b.imaje\""));
    let mut window = Window::open(&path);
    window.steps(3);
    window.key(NONE, Key::M);
    window.until_shown("has no output `imaje`");
    let view = window.app().document().view().clone();
    assert!(view.nodes[view.node("mean").expect("it is drawn")].mistakes[0].contains("imaje"));
    std::fs::write(&path, GRAPH).expect("written");
    window.settled();
    assert_eq!(window.running().len(), 5);
}

#[test]
fn frames_plugins_and_curves_by_keyboard() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("extras");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.select("mean");
    window.key(NONE, Key::G);
    window.until_shown("Text of the mark");
    window.key(NONE, Key::Escape);
    window.steps(3);
    window.harness.get_by_label("Frame Frame");
    assert_eq!(window.app().document().view().marks.len(), 1);
    window.settled();
    window.key(CTRL, Key::Z);
    assert_eq!(**window.app().document().text(), *GRAPH);
    window.key(NONE, Key::U);
    window.until_shown("flow  ");
    window.key(NONE, Key::Escape);
    window.steps(3);
    assert!(window.harness.query_by_label("Reload").is_none());
    window.key(NONE, Key::P);
    window.until_shown("Values");
    window.harness.get_by_label("Values").click();
    window.steps(3);
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn dropped_pictures_become_a_source_and_a_new_file_offers_templates() {
    if !has_plugin("flow") || !has_plugin("capture") {
        return;
    }
    let folder = Folder::new("drop");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    let file = folder.0.join("left.png");
    image::RgbImage::new(32, 24).save(&file).expect("a picture");
    window.harness.state_mut().as_mut().expect("it is open").dropped(vec![file]);
    window.steps(3);
    assert!(window.app().document().text().contains("[nodes.scope]\ntype = \"capture\""));
    assert_eq!(window.app().selected().as_deref(), Some("scope"));
    drop(window);
    let mut window = Window::open(&folder.0.join("new.toml"));
    window.until_shown("Template Panorama");
    window.harness.get_by_label("Template Empty").click();
    window.steps(3);
    assert!(window.app().document().text().contains("plugins = []"));
    assert!(!folder.0.join("new.toml").is_file(), "nothing is written before it is saved");
}

#[test]
fn nodes_are_chosen_moved_aligned_and_copied_by_keys() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("arrange");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    let shift = Modifiers::SHIFT;
    window.select("b");
    window.key(shift, Key::N);
    let selected = |window: &Window| window.app().canvas().selected.iter().cloned().collect::<Vec<_>>();
    assert_eq!(selected(&window), ["b", "mean"]);
    let position = |window: &Window, id: &str| window.app().canvas().position(id).expect("it is drawn");
    let before = ["b", "mean"].map(|id| position(&window, id));
    for key in [Key::ArrowDown, Key::ArrowDown, Key::ArrowRight] {
        window.key(shift, key);
    }
    window.steps(2);
    let after = ["b", "mean"].map(|id| position(&window, id));
    assert_eq!([after[0] - before[0], after[1] - before[1]], [vec2(16.0, 32.0); 2]);
    window.key(NONE, Key::L);
    window.steps(2);
    assert_eq!(position(&window, "b").y, position(&window, "mean").y, "one lies beside the other");
    window.key(CTRL, Key::Z);
    window.key(CTRL, Key::Z);
    assert_eq!(**window.app().document().text(), *GRAPH, "all moves are one step");
    window.settled();
    // Copies are wired among themselves, as text in the clipboard.
    window.select("b");
    window.key(shift, Key::N);
    window.harness.event(Event::Copy);
    window.harness.step();
    let copied = window.harness.output().platform_output.commands.iter().find_map(|command| match command {
        OutputCommand::CopyText(text) => Some(text.clone()),
        _ => None,
    });
    let copied = copied.expect("something is copied");
    assert!(copied.contains("[nodes.mean]") && copied.contains("# of 256"), "{copied}");
    window.steps(1);
    window.harness.event(Event::Paste(copied));
    window.steps(2);
    assert_eq!(selected(&window), ["b_2", "mean_2"]);
    assert!(window.app().document().text().contains("inputs = { image = \"b_2.image\" }"));
    window.key(CTRL, Key::D);
    assert_eq!(selected(&window).len(), 2);
    window.key(CTRL, Key::Z);
    window.key(CTRL, Key::Z);
    window.settled();
    assert_eq!(**window.app().document().text(), *GRAPH);
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_box_selects_a_node_dropped_on_a_wire_goes_into_it_and_a_pin_offers_what_fits() {
    if !has_plugin("flow") || !has_plugin("stitch") {
        return;
    }
    let folder = Folder::new("gestures");
    let lone = "\n[nodes.lone]\ntype = \"pass\"\n\n[editor]\na = { x = 0, y = 0 }\nkept = { x = 320, y = 0 }\nb = { x = 0, y = 320 }\nmean = { x = 560, y = 320 }\nsink = { x = 860, y = 320 }\nlone = { x = 280, y = 620 }\n";
    let mut window = Window::open(&folder.write("g.toml", &format!("{GRAPH}{lone}")));
    window.steps(3);
    // A selection frame around the upper two nodes.
    let at = |window: &Window, label: &str| window.harness.get_by_label(label).rect();
    let (a, kept) = (at(&window, "Node a"), at(&window, "Node kept"));
    window.harness.event(Event::ModifiersChanged(Modifiers::SHIFT));
    input::drag(&mut window.harness, a.min - vec2(12.0, 12.0), kept.max - vec2(20.0, 20.0));
    window.harness.event(Event::ModifiersChanged(NONE));
    window.steps(2);
    assert_eq!(window.app().canvas().selected.iter().collect::<Vec<_>>(), ["a", "kept"]);
    // The unconnected node is dragged by its header until its centre is on the wire from b to mean.
    let head = at(&window, "Node lone").center_top() + vec2(0.0, 8.0);
    let wire =
        (at(&window, "Output b.image").center().to_vec2() + at(&window, "Input mean.image").center().to_vec2()) / 2.0;
    let by = wire.to_pos2() - at(&window, "Node lone").center();
    input::drag(&mut window.harness, head, head + by);
    window.settled();
    let text = window.app().document().text().to_string();
    assert!(text.contains("inputs = { image = \"lone.image\" }"), "{text}");
    assert!(window.running().contains(&"lone".to_owned()));
    // A wire dropped on the background opens the palette with the node types that fit.
    let from = at(&window, "Output mean.image").center();
    input::drag(&mut window.harness, from, from + vec2(40.0, 200.0));
    window.until_shown("Pick every_nth");
    window.type_text("reg");
    window.until_shown("Pick register_surf");
    window.key(NONE, Key::Escape);
}

#[test]
fn outputs_are_recalled_by_number_and_compared_by_keys() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("recall");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    let viewed = |window: &Window| window.app().viewed().map(ToString::to_string);
    for (node, output) in [("b", "b.image"), ("mean", "mean.image")] {
        window.select(node);
        window.key(NONE, Key::V);
        assert_eq!(viewed(&window).as_deref(), Some(output));
        window.until_shown("64 x 48 px");
        window.key(NONE, Key::Escape);
    }
    // From the graph as well as from another output.
    window.key(NONE, Key::Num1);
    assert_eq!(viewed(&window).as_deref(), Some("b.image"));
    window.key(NONE, Key::Num2);
    assert_eq!(viewed(&window).as_deref(), Some("mean.image"));
    window.key(NONE, Key::Num9);
    assert_eq!(viewed(&window).as_deref(), Some("mean.image"), "nothing has that number");
    window.key(NONE, Key::C);
    let place = window.app().canvas().rect;
    // The line moves once both images are there.
    let until = std::time::Instant::now() + common::PATIENCE;
    while window.app().wipe().is_some_and(|line| line > 0.4) {
        assert!(std::time::Instant::now() < until, "{:?}", window.app().wipe());
        window.key(NONE, Key::ArrowLeft);
    }
    for mode in ["Blink", "Difference", "Wipe"] {
        window.harness.get_by_label(mode).focus();
        window.steps(1);
        window.key(NONE, Key::Enter);
        window.steps(2);
        assert_eq!(window.app().wipe().is_some(), mode == "Wipe");
    }
    window.key(NONE, Key::Escape);
    window.key(NONE, Key::Escape);
    window.steps(3);
    assert_eq!((viewed(&window), window.app().canvas().rect), (None, place), "the view of the graph did not move");
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_surface_is_turned_cut_and_measured_by_keys() {
    if !has_plugin("phantom") || !has_plugin("stereo") {
        return;
    }
    let folder = Folder::new("space");
    let text = r#"plugins = ["phantom", "stereo"]
[nodes.scope]
type = "phantom"
params = { scene = "box", width = 320, height = 240 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.lengths]
type = "measure"
inputs = { cloud = "points.cloud" }
"#;
    let mut window = Window::run(&folder.write("g.toml", text));
    window.select("points");
    window.key(NONE, Key::V);
    window.until_shown("Surface of points.cloud");
    window.until("it is painted", App::has_surface);
    let before = window.app().view3d().viewpoint();
    window.key(NONE, Key::ArrowLeft);
    window.key(NONE, Key::Plus);
    let after = window.app().view3d().viewpoint();
    assert!(after.yaw > before.yaw && after.zoom > before.zoom, "{before:?} {after:?}");
    window.key(NONE, Key::Home);
    window.until("it is painted as at first", App::has_surface);
    // Two points by crosshair: the first arrow key shows it in the centre.
    window.harness.get_by_label("Measure").click_accesskit();
    window.steps(3);
    window.until_shown("Measuring");
    for key in [Key::ArrowLeft, Key::Enter, Key::ArrowRight, Key::ArrowRight, Key::ArrowRight, Key::Enter] {
        window.key(NONE, key);
    }
    // The scene moves: where the surface of that moment has a hole, Enter sets no point.
    for _ in 0..20 {
        if window.app().view3d().distance_mm().is_none() {
            window.key(NONE, Key::ArrowRight);
            window.key(NONE, Key::Enter);
        }
    }
    let mm = window.app().view3d().distance_mm().expect("both points are known");
    assert!((0.1..100.0).contains(&mm), "{mm}");
}

#[test]
fn a_surface_has_no_ruler_and_no_lengths_while_the_calibration_does_not_fit() {
    if ["phantom", "stereo", "overlay", "flow"].iter().any(|name| !has_plugin(name)) {
        return;
    }
    let folder = Folder::new("drifted-surface");
    // An uncorrected lens distortion bends the rows, as with a calibration that does not fit any more.
    let text = r#"plugins = ["phantom", "stereo", "overlay", "flow"]
[nodes.scope]
type = "phantom"
params = { width = 320, height = 240, distortion_k1 = 0.4 }
[nodes.match]
type = "stereo_bm"
inputs = { left = "scope.left", right = "scope.right" }
params = { drift_px = 0.3 }
[nodes.colours]
type = "colorize"
inputs = { disparity = "match.disparity" }
[nodes.sink]
type = "drain"
inputs = { image = "colours.image" }
"#;
    let mut window = Window::run(&folder.write("g.toml", text));
    // The first ticks may have come already: a window that saw none has a ruler.
    assert!(Viewpoint::default().has_ruler);
    window.until("lengths are doubted", |app| !app.view3d().viewpoint().has_ruler);
}
