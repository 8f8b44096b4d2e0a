//! The editor's state of a graph: presets and snapshots next to it, the arrangement of its panels in the user's folder.

use std::path::Path;
use std::sync::Arc;

use panoscope_editor_model::docks::{Layout, Panel, Side, Stored, Target};
use panoscope_editor_model::document::Document;
use panoscope_editor_model::{presets, snapshots};
use panoscope_host::loader::Loader;

const GRAPH: &str = "plugins = [\"p\"]\n[nodes.a]\ntype = \"t\"\nparams = { x = 1, y = 0.5, on = true }\n";

fn document() -> Document {
    Document::new(Path::new("fuzz/g.toml"), GRAPH, Arc::new(Loader::search(&[])))
}

pub fn presets(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let Ok(list) = presets::parse(text) else { return };
    let Ok(written) = presets::text_of(&list) else { return };
    let again = presets::parse(&written).expect("what was written is read");
    // As text, because a NaN differs from itself.
    assert_eq!(presets::text_of(&again).ok().as_deref(), Some(written.as_str()));
    let document = document();
    for pair in list.windows(2) {
        for share in [0.0, 0.3, 1.0] {
            let values = presets::between(document.view(), &pair[0], &pair[1], share);
            let changes = presets::changes_to(document.view(), &values);
            assert!(changes.changes.len() + changes.skipped.len() <= values.len(), "one answer for each value");
        }
    }
}

pub fn preset_seeds() -> Vec<Vec<u8>> {
    let preset = |name: &str, x: &str| {
        format!("[[preset]]\nname = \"{name}\"\n[preset.values]\n\"a.x\" = {x}\n\"a.y\" = 0.25\n\"a.on\" = false\n")
    };
    let both = preset("soft", "1") + &preset("hard", "90");
    let texts = [
        both.clone(),
        both.replace("90", "nan"),
        both.replace("90", "[1.0, 2.0]"),
        both.replace("90", "{ b = 1979-05-27 }"),
        both.replace("a.x", "a"),
        both.replace("[preset.values]", "[preset.value]"),
    ];
    texts.map(String::into_bytes).to_vec()
}

pub fn snapshot(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let Ok(snapshot) = snapshots::parse(text) else { return };
    let mut document = document();
    let differs = snapshots::restore(&mut document, &snapshot);
    assert_eq!(document.text().as_ref() as &str, snapshot.text, "the text is the snapshot's");
    assert!(differs || snapshot.text == GRAPH);
    while document.undo().is_some() {}
    assert_eq!(document.text().as_ref() as &str, GRAPH, "each snapshot is undone");
}

pub fn snapshot_seeds() -> Vec<Vec<u8>> {
    let text = format!("taken_s = 5\ntext = {}\n", toml::Value::from(GRAPH.replace("x = 1", "x = 2")));
    let part = "[[files]]\npath = \"parts/p.toml\"\ntext = \"[part]\\n\"\n";
    let outside = part.replace("parts/p.toml", "../../elsewhere.toml");
    [text.clone(), format!("{text}{part}"), format!("{text}{outside}"), text.replace("taken_s = 5", "taken_s = -5")]
        .map(String::into_bytes)
        .to_vec()
}

pub fn layout(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let Ok((graph, layout)) = Stored::parse(text) else { return };
    let written = Stored::text(&graph, &layout).expect("what was read is written");
    let (again, same) = Stored::parse(&written).expect("what was written is read");
    assert_eq!((again, Stored::text(&graph, &same).ok()), (graph, Some(written)));
    // Whatever is done with a panel, each has one place.
    let mut moved = layout.clone();
    for panel in Panel::ALL {
        moved.toggle(panel);
        moved.tear_off(panel, [10.0, 20.0]);
        moved.grow(panel, 32.0);
        moved.dock(panel);
        moved.place(panel, Target::Beside { of: Panel::Graph, side: Side::Below });
        moved.move_beside_graph(panel, Side::Left);
        moved.close(panel);
    }
    let mut places = moved.root.panels();
    places.sort();
    let mut all = Panel::ALL.to_vec();
    all.sort();
    assert_eq!(places, all);
    assert!(moved.is_open(Panel::Graph) && moved.checked().is_ok());
}

pub fn layout_seeds() -> Vec<Vec<u8>> {
    let text = |layout: &Layout| Stored::text("/graphs/depth.toml", layout).unwrap_or_default();
    let mut torn = Layout::default();
    torn.open(Panel::Plots);
    torn.tear_off(Panel::Plots, [40.0, 60.0]);
    torn.place(Panel::History, Target::Tab { with: Panel::Node, at: 0 });
    let texts = [
        text(&Layout::default()),
        text(&torn),
        text(&torn).replace("plots", "graph"),
        text(&torn).replace("60.0", "nan"),
    ];
    // As deep as a file can be.
    let deep = format!("graph = \"g\"\n[[root{}]]\nsize = 100.0\n", ".row.dock".repeat(5000));
    texts.into_iter().chain([deep]).map(String::into_bytes).collect()
}
