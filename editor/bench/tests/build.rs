//! A graph built in few actions, and what the window says while it is unfinished, mended, or over.

use std::time::Instant;

use crate::common::{Folder, GRAPH, PATIENCE, Window, has_plugin, input};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers, Pos2, Rect, vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use panoscope_editor::app::Options;
use panoscope_editor_model::session::Phase;
use panoscope_editor_model::texts::{Language, set_language};

const NONE: Modifiers = Modifiers::NONE;
const SHIFT: Modifiers = Modifiers::SHIFT;

/// Opens the palette with a key, types, and takes the first entry once `row` is the first.
fn take(window: &mut Window, key: Key, typed: &str, row: &str) {
    window.key(NONE, key);
    if !typed.is_empty() {
        window.type_text(typed);
    }
    let until = Instant::now() + PATIENCE;
    while window.harness.query_by_label(row).is_none() {
        assert!(Instant::now() < until, "`{row}` is not offered for `{typed}`");
        window.steps(1);
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    window.key(NONE, Key::Enter);
    window.steps(3);
}

#[test]
fn a_panorama_from_nothing_in_four_actions() {
    for plugin in ["phantom", "stitch", "sinks"] {
        if !has_plugin(plugin) {
            return;
        }
    }
    let folder = Folder::new("four_actions");
    let empty = "# A panorama.\nmode = \"live\"\nplugins = []\n";
    let mut window = Window::open(&folder.write("g.toml", empty));
    window.steps(3);
    take(&mut window, Key::A, "panorama", "Pick panorama_surf");
    assert_eq!(window.app().selected().as_deref(), Some("panorama_surf"), "the shipped part comes first");
    take(&mut window, Key::A, "phantom", "Pick phantom");
    assert_eq!(window.app().selected().as_deref(), Some("phantom"));
    take(&mut window, Key::W, "", "Pick connect left, right to panorama_surf");
    window.until("it runs", |app| app.session().status().phase == Phase::Running);
    window.select("panorama_surf");
    window.key(NONE, Key::V);
    window.until("a panorama is shown", |app| app.has_picture() && app.viewed().is_some());
    let text = window.app().document().text().to_string();
    assert!(!text.contains("[editor]"), "nothing was placed by hand: {text}");
}

#[test]
fn all_inputs_are_connected_by_their_names_at_once() {
    for plugin in ["phantom", "stitch"] {
        if !has_plugin(plugin) {
            return;
        }
    }
    let folder = Folder::new("by_name");
    let text = "mode = \"live\"\nplugins = [\"phantom\", \"stitch\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.register]\n\
                type = \"register_surf\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\n[nodes.wide]\ntype = \"composite\"\n";
    let mut window = Window::open(&folder.write("g.toml", text));
    window.steps(3);
    window.select("wide");
    take(&mut window, Key::W, "", "Pick connect left, right, homography by name");
    let text = window.app().document().text().to_string();
    for wire in ["left = \"scope.left\"", "right = \"scope.right\"", "homography = \"register.homography\""] {
        assert!(text.rsplit("[nodes.wide]").next().is_some_and(|wide| wide.contains(wire)), "{wire}: {text}");
    }
    window.key(Modifiers::COMMAND, Key::Z);
    let text = window.app().document().text().to_string();
    assert!(!text.contains("register.homography"), "one step of undo: {text}");
}

#[test]
fn a_graph_that_is_being_built_is_unfinished_and_not_wrong() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("unfinished");
    let text = GRAPH.replace("type = \"smooth\"\ninputs = { image = \"b.image\" }\n", "type = \"smooth\"\n");
    let mut window = Window::open(&folder.write("g.toml", &text));
    window.steps(3);
    window.until_shown("State: unfinished: 1 input is not connected");
    window.until_painted("input `image` is not connected");
    let painted = window.painted();
    assert!(painted.iter().any(|text| text == "unfinished"), "{painted:#?}");
    assert!(!painted.iter().any(|text| text.contains("of `mean`")), "the node's name stands above: {painted:#?}");
    // A mistake is one, and its words are whole.
    let path = folder.write("wrong.toml", &GRAPH.replace("past_weight = 100", "past_weigth = 100"));
    let mut window = Window::open(&path);
    window.steps(3);
    window.until_shown("State: the file has mistakes");
    window.until_painted("past_weigth");
    let painted = window.painted();
    assert!(painted.iter().any(|text| text == "mistake"), "{painted:#?}");
    let words = window.app().document().view().nodes.iter().find_map(|n| n.mistakes.first().cloned()).expect("one");
    let words = panoscope_editor_model::graph_view::without_name(&words, "mean");
    assert!(painted.iter().any(|text| text.replace("  ", " ") == words), "{words}: {painted:#?}");
}

#[test]
fn a_mended_fault_is_acknowledged() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("acknowledged");
    let text = GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"b.image\" }\nparams = { past_weight = 100 } # of 256",
        "type = \"failing\"\ninputs = { image = \"b.image\" }\nparams = { first = 5, ticks = 1 }",
    );
    let mut window = Window::run(&folder.write("g.toml", &text));
    window.select("mean");
    window.until_painted("1 fault");
    window.until_shown("Acknowledge");
    window.key(SHIFT, Key::M);
    window.until_shown("1 fault is acknowledged");
    window.steps(3);
    assert!(window.harness.query_by_label("Acknowledge").is_none(), "the panel has no fault any more");
    let painted = window.painted();
    assert!(!painted.iter().any(|text| text.contains("1 fault  ")), "{painted:#?}");
    window.key(SHIFT, Key::M);
    window.until_shown("there is no fault to acknowledge");
}

#[test]
fn the_times_of_a_run_stay_after_its_end() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("over");
    let options = Options { frames: Some(40), ..Options::default() };
    let mut window = Window::open_with(&folder.write("g.toml", GRAPH), options);
    window.until("it has ended", |app| app.session().status().phase == Phase::Ended);
    window.until_painted("40 frames in ");
    window.until_painted("40 ticks");
    let painted = window.painted();
    assert!(painted.iter().filter(|text| text.contains("p99") || text.ends_with("ms")).count() >= 3, "{painted:#?}");
    assert!(!painted.iter().any(|text| text == "at rest"), "{painted:#?}");
}

/// Whether the names and buttons of the bar lie beside each other within the window.
fn bar_overlaps(window: &Window, width: f32) -> Vec<String> {
    let nodes = window.harness.root().children_recursive();
    let in_bar = nodes.filter(|node| {
        let role = node.accesskit_node().role();
        matches!(role, Role::Button | Role::Label) && node.rect().bottom() <= 44.0 && node.rect().width() > 0.0
    });
    let all: Vec<(String, Rect)> = in_bar
        .map(|node| {
            let node_name = node.accesskit_node().label().or(node.accesskit_node().value()).unwrap_or_default();
            (node_name, node.rect())
        })
        .collect();
    assert!(all.len() > 5, "{all:?}");
    let mut wrong: Vec<String> =
        all.iter().filter(|(_, r)| r.left() < 0.0 || r.right() > width).map(|(n, r)| format!("{n} at {r:?}")).collect();
    for (k, (a, first)) in all.iter().enumerate() {
        let over = all[..k].iter().filter(|(_, second)| first.shrink(1.0).intersect(second.shrink(1.0)).is_positive());
        wrong.extend(over.map(|(b, _)| format!("{a} over {b}")));
    }
    wrong
}

#[test]
fn nothing_overlaps_in_the_bar_of_a_narrow_window() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("narrow");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    for language in [Language::German, Language::English] {
        set_language(language);
        for width in [1920.0, 1280.0, 960.0, 800.0, 640.0] {
            window.harness.set_size(vec2(width, 720.0));
            window.steps(4);
            let wrong = bar_overlaps(&window, width);
            assert!(wrong.is_empty(), "{language:?} at {width}: {wrong:#?}");
        }
    }
    // What is not in the bar is in its menus.
    window.click_until_shown("Look", "Heat");
    window.harness.get_by_label("Heat").click();
    window.steps(2);
}

#[test]
fn the_keys_use_the_height_of_the_window() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("keys");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    for size in [vec2(1280.0, 720.0), vec2(1920.0, 1080.0)] {
        window.harness.set_size(size);
        window.steps(2);
        window.key(NONE, Key::F1);
        window.until_shown("Double click");
        window.steps(3);
        let inside = Rect::from_min_size(Pos2::ZERO, size);
        let last = window.harness.get_by_label("Double click").rect();
        assert!(inside.contains_rect(last), "{last:?} in {size:?}");
        window.key(NONE, Key::Escape);
        window.steps(2);
    }
}

#[test]
fn the_name_of_a_new_part_is_selected_and_it_covers_nothing() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("named");
    let places = "\n[editor]\na = { x = 0, y = 0 }\nkept = { x = 240, y = 0 }\nb = { x = 0, y = 280 }\n\
                  mean = { x = 480, y = 216 }\nsink = { x = 240, y = 232 }\n";
    let mut window = Window::run(&folder.write("g.toml", &format!("{GRAPH}{places}")));
    window.select("mean");
    window.key(SHIFT, Key::N);
    window.key(NONE, Key::K);
    window.until_shown("Name of the part");
    window.steps(2);
    window.harness.get_by_label("Name of the part").type_text("calm");
    window.steps(2);
    window.key(NONE, Key::Enter);
    window.until_shown("Node calm");
    window.steps(3);
    let rects = window.app().canvas().node_rects();
    for (k, (a, first)) in rects.iter().enumerate() {
        for (b, second) in &rects[..k] {
            let both = first.shrink(1.0).intersect(second.shrink(1.0));
            assert!(!both.is_positive(), "{a} at {first:?} lies on {b} at {second:?}");
        }
    }
}

#[test]
fn a_sweep_says_what_it_lacks_and_its_lists_are_filtered() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("lacks");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.select("mean");
    window.key(NONE, Key::S);
    window.until_shown("Choose a measure");
    // Another selection is no other parameter.
    let now = |window: &Window| window.harness.get_by_role_and_label(Role::ComboBox, "Swept parameter").value();
    let before = now(&window);
    window.select("b");
    window.steps(2);
    assert_eq!(now(&window), before);
    window.harness.get_by_role_and_label(Role::ComboBox, "Swept parameter").click();
    window.until_shown("Filter the parameters");
    assert!(window.harness.query_by_label("b.rate_hz").is_some());
    window.harness.get_by_label("Filter the parameters").focus();
    window.steps(2);
    window.harness.get_by_label("Filter the parameters").type_text("past");
    window.steps(3);
    assert!(window.harness.query_by_label("b.rate_hz").is_none(), "it is filtered out");
    input::fill(&mut window.harness, "Sweep measure", "mean.p50_ms");
    window.steps(2);
    assert!(window.harness.query_by_label_contains("Choose a measure").is_none());
}
