//! The editor in German: names, the palette, the list of keys, numbers with a comma, and a change of the language while frames flow.

use crate::common::{Folder, GRAPH, Window, has_plugin, input, nothing_lost};
use eframe::egui::{Key, Modifiers, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::texts::{Language, set_language};
use panoscope_graph::ParamValue;

const NONE: Modifiers = Modifiers::NONE;

/// The buttons of the bar above, from right to left; the first of them only look at the graph.
const BUTTONS: [&str; 15] = [
    "Tasten",
    "Presets",
    "Verlauf",
    "Kurven",
    "Text",
    "Auslastung",
    "Einpassen",
    "Reihe",
    "Probleme",
    "Aufzeichnen",
    "Suchen",
    "Hinzufügen",
    "Speichern",
    "Wiederholen",
    "Rückgängig",
];
const LOOK: usize = 7;

#[test]
fn the_editor_is_used_in_german() {
    if !has_plugin("flow") {
        return;
    }
    set_language(Language::German);
    let folder = Folder::new("german");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.until_shown("Zustand: läuft");

    // The palette finds commands by their German words, and by their English names.
    for (typed, found) in
        [("kurven", "Kurven von Zeiten und Werten wählen"), ("plots", "Kurven von Zeiten und Werten wählen")]
    {
        window.key(Modifiers::COMMAND, Key::K);
        window.harness.get_by_label("Suche").type_text(typed);
        window.steps(2);
        window.until_shown(found);
        window.key(NONE, Key::Escape);
    }

    // A value is typed with a comma, and shown with one.
    window.harness.get_by_label("Knoten b").click_accesskit();
    window.steps(2);
    input::fill(&mut window.harness, "rate_hz Wert", "42,5");
    window.until("the value is applied", |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.param_values("b").is_some_and(|values| values.contains(&ParamValue::Float(42.5)))
    });
    assert!(window.app().document().text().contains("rate_hz = 42.5"), "the file has a decimal point");

    // The list of keys.
    window.key(NONE, Key::F1);
    assert!(window.harness.query_by_label("Knoten hinzufügen").is_some());
    window.key(NONE, Key::Escape);

    // Another language, while frames flow.
    window.key(Modifiers::SHIFT, Key::L);
    window.until_shown("State: running");
    assert!(window.harness.query_by_label("Node b").is_some() && window.harness.query_by_label("Knoten b").is_none());
    window.key(Modifiers::SHIFT, Key::L);
    window.until_shown("Zustand: läuft");
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn the_german_bar_has_room_for_its_words() {
    if !has_plugin("flow") {
        return;
    }
    set_language(Language::German);
    let folder = Folder::new("german_bar");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.until_shown("Zustand: läuft");
    for size in [vec2(1280.0, 720.0), vec2(1440.0, 900.0), vec2(1920.0, 1080.0)] {
        window.harness.set_size(size);
        window.steps(4);
        let state = window.harness.get_by_label("Zustand: läuft").rect();
        // What only looks at the graph is in a menu, where the window has no space for it.
        let folded = window.harness.query_all_by_label("Ansicht").count() > 0;
        assert!(!folded || size.x < 1440.0, "at {size} everything is in the bar");
        for name in &BUTTONS[if folded { LOOK } else { 0 }..] {
            let mut all = window.harness.query_all_by_label(name).map(|node| node.rect());
            let button = all.find(|rect| rect.top() < 48.0).unwrap_or_else(|| panic!("no `{name}`"));
            assert!(
                button.left() > state.right() && button.right() <= size.x,
                "{name} at {size}: {button:?} {state:?}"
            );
        }
    }
    window.close();
}
