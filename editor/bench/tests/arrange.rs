//! Nodes laid out again: by a key, after a node was added; wires pass under no node meanwhile.

use crate::common::{Folder, GRAPH, PATIENCE, Window, has_plugin};
use eframe::egui::{Key, Modifiers, Rect, vec2};
use egui_kittest::kittest::Queryable;
use std::time::Instant;

const NONE: Modifiers = Modifiers::NONE;
const CTRL: Modifiers = Modifiers::COMMAND;
const SHIFT: Modifiers = Modifiers::SHIFT;

/// Positions in the file where nodes lie on each other and wires go backward.
const PILED: &str = "\n[editor]\na = { x = 600, y = 0 }\nkept = { x = 0, y = 16 }\nb = { x = 620, y = 40 }\nmean = { x = 300, y = 20 }\n\
                     sink = { x = 320, y = 60 }\n";

fn overlaps(window: &Window) -> Vec<(String, String)> {
    let rects = window.app().canvas().node_rects();
    let lies_on = |a: &Rect, b: &Rect| a.shrink(1.0).intersect(b.shrink(1.0)).is_positive();
    let pairs = rects.iter().enumerate().flat_map(|(n, a)| rects[..n].iter().map(move |b| (a, b)));
    pairs.filter(|(a, b)| lies_on(&a.1, &b.1)).map(|(a, b)| (a.0.clone(), b.0.clone())).collect()
}

fn under(window: &Window) -> Vec<String> {
    window.app().canvas().wires_under_nodes(window.app().document().view())
}

fn add(window: &mut Window, node_type: &str) {
    window.key(NONE, Key::A);
    window.type_text(node_type);
    let (row, until) = (format!("Pick {node_type}"), Instant::now() + PATIENCE);
    while window.harness.query_by_label(&row).is_none() {
        assert!(Instant::now() < until, "`{row}` is not offered");
        window.steps(1);
    }
    window.key(NONE, Key::Enter);
    window.steps(3);
}

#[test]
fn a_key_arranges_all_nodes_and_undo_puts_them_back() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("arrange_all");
    let text = format!("{GRAPH}{PILED}");
    let mut window = Window::run(&folder.write("g.toml", &text));
    window.steps(3);
    assert!(!overlaps(&window).is_empty(), "they lie on each other at first");
    window.key(SHIFT, Key::A);
    window.steps(3);
    assert_eq!(overlaps(&window), []);
    assert_eq!(under(&window), Vec::<String>::new());
    assert_eq!(**window.app().document().text(), *GRAPH, "no position is left in the file");
    window.until_shown("5 nodes are arranged");
    window.key(CTRL, Key::Z);
    assert_eq!(**window.app().document().text(), *text, "one step of undo");
}

#[test]
fn a_key_arranges_the_selected_nodes_and_leaves_the_others() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("arrange_selection");
    let mut window = Window::run(&folder.write("g.toml", &format!("{GRAPH}{PILED}")));
    window.steps(3);
    let at = |window: &Window, id: &str| window.app().canvas().position(id).expect("a position");
    let (a, kept) = (at(&window, "a"), at(&window, "kept"));
    // `b`, `mean` and `sink`, which follow each other in the file.
    window.select("b");
    (0..2).for_each(|_| window.key(SHIFT, Key::N));
    window.key(SHIFT, Key::A);
    window.steps(3);
    window.until_shown("3 nodes are arranged");
    assert_eq!((at(&window, "a"), at(&window, "kept")), (a, kept), "the others stay");
    let [b, mean, sink] = ["b", "mean", "sink"].map(|id| at(&window, id).x);
    assert!(b < mean && mean < sink, "along the flow: {b} {mean} {sink}");
    assert_eq!(overlaps(&window), []);
}

#[test]
fn a_node_added_by_key_is_laid_out_with_the_others() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("added");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.steps(3);
    window.select("mean");
    add(&mut window, "pass");
    assert!(!window.app().document().text().contains("[editor]"), "it has no position by hand");
    window.key(NONE, Key::W);
    window.type_text("b.image");
    window.key(NONE, Key::Enter);
    window.steps(3);
    let at = |window: &Window, id: &str| window.app().canvas().position(id).expect("a position").x;
    assert!(at(&window, "pass") > at(&window, "b"), "it reads `b`, so it is behind it");
    assert_eq!(overlaps(&window), []);
    assert_eq!(under(&window), Vec::<String>::new());
}

#[test]
fn wires_go_around_a_node_that_is_dragged_between_their_ends() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("dragged");
    // `kept` lies between `b` and `mean`, which are connected.
    let text = format!(
        "{GRAPH}\n[editor]\nb = {{ x = 0, y = 0 }}\nkept = {{ x = 280, y = 0 }}\nmean = {{ x = 560, y = 0 }}\n\
         sink = {{ x = 840, y = 0 }}\na = {{ x = 0, y = 400 }}\n"
    );
    let mut window = Window::run(&folder.write("g.toml", &text));
    window.steps(3);
    assert_eq!(under(&window), Vec::<String>::new());
    // While a node is moved onto the wire's path as well.
    let names = |window: &Window| window.app().canvas().node_rects();
    let rect = |window: &Window, id: &str| names(window).into_iter().find(|(n, _)| n == id).expect("shown").1;
    let from = rect(&window, "a").center();
    for step in 1..8 {
        let at = from + vec2(30.0, -24.0) * step as f32;
        let now = rect(&window, "a").center();
        crate::common::input::drag(&mut window.harness, now, at);
        window.steps(2);
        let lying = overlaps(&window);
        if lying.is_empty() {
            assert_eq!(under(&window), Vec::<String>::new(), "step {step}");
        }
    }
}
