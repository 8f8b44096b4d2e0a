use std::path::PathBuf;

use super::*;

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("panoscope_docks_{name}_{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// Every panel is in the tree once, and the tree is simple.
fn whole(layout: &Layout) {
    let mut panels = layout.root.panels();
    panels.sort();
    assert_eq!(panels, Panel::ALL, "{layout:#?}");
    let mut simple = layout.root.clone();
    simple.simplify();
    assert_eq!(simple, layout.root);
}

#[test]
fn a_panel_that_is_closed_comes_back_in_front() {
    let mut layout = Layout::default();
    whole(&layout);
    layout.toggle(Panel::Plots);
    layout.toggle(Panel::Sweep);
    assert!(layout.is_open(Panel::Plots) && !layout.is_shown(Panel::Plots) && layout.is_shown(Panel::Sweep));
    layout.toggle(Panel::Plots);
    assert!(layout.is_shown(Panel::Plots), "its key brings it to the front");
    layout.toggle(Panel::Plots);
    assert!(!layout.is_open(Panel::Plots) && layout.is_shown(Panel::Sweep));
    layout.close(Panel::Graph);
    assert!(layout.is_shown(Panel::Graph));
    whole(&layout);
}

#[test]
fn panels_move_around_the_graph_into_tabs_and_out_of_them() {
    let mut layout = Layout::default();
    layout.open(Panel::Plots);
    layout.open(Panel::Sweep);
    // From below to the tabs at the right.
    assert!(layout.move_beside_graph(Panel::Plots, Side::Right));
    whole(&layout);
    assert_eq!(layout.root.tabs_of(Panel::Plots), layout.root.tabs_of(Panel::Node));
    assert!(layout.is_shown(Panel::Plots) && !layout.is_shown(Panel::Node));
    // Once more: out of the tabs, further right.
    assert!(layout.move_beside_graph(Panel::Plots, Side::Right));
    whole(&layout);
    assert_ne!(layout.root.tabs_of(Panel::Plots), layout.root.tabs_of(Panel::Node));
    let order = layout.root.panels();
    let at = |panel| order.iter().position(|p| *p == panel).expect("in the tree");
    assert!(at(Panel::Plots) > at(Panel::Node) && at(Panel::Node) > at(Panel::Graph));
    // Above the graph there is nothing yet.
    assert!(layout.move_beside_graph(Panel::Plots, Side::Above));
    whole(&layout);
    assert_eq!(layout.root.neighbour(Panel::Graph, Side::Above, &|_| true), Some(Panel::Plots));
    assert!(!layout.move_beside_graph(Panel::Plots, Side::Above), "it is there, alone");
    assert!(!layout.move_beside_graph(Panel::Graph, Side::Left));
}

#[test]
fn a_panel_in_a_window_keeps_its_place() {
    let mut layout = Layout::default();
    let before = layout.clone();
    assert!(layout.tear_off(Panel::Node, [40.0, 60.0]));
    assert!(!layout.is_docked(Panel::Node) && layout.is_shown(Panel::Node));
    assert!(!layout.tear_off(Panel::Node, [0.0, 0.0]) && !layout.tear_off(Panel::Graph, [0.0, 0.0]));
    assert!(layout.reachable().ends_with(&[Panel::Node]));
    assert!(layout.dock(Panel::Node) && !layout.dock(Panel::Node));
    assert_eq!(layout, before);
}

#[test]
fn sizes_change_by_steps() {
    let mut layout = Layout::default();
    let width = |layout: &mut Layout| layout.root.part_of(Panel::Node, true).map(|part| part.size);
    let before = width(&mut layout).expect("a width");
    assert!(layout.grow(Panel::Node, 40.0));
    assert_eq!(width(&mut layout), Some(before + 40.0));
    assert!(layout.grow(Panel::Plots, -40.0), "its height");
    assert!(!layout.grow(Panel::Graph, 40.0));
    whole(&layout);
}

#[test]
fn each_graph_keeps_its_own_arrangement() {
    let folder = folder("file");
    let mut layout = Layout::default();
    layout.open(Panel::Plots);
    layout.move_beside_graph(Panel::Plots, Side::Above);
    layout.tear_off(Panel::Node, [-20.0, 60.5]);
    let (one, two) = (folder.join("one.toml"), folder.join("two.toml"));
    assert_eq!(recall(&folder, &one).expect("no file"), None);
    remember(&folder, &one, &layout).expect("written");
    assert_eq!(recall(&folder, &one).expect("read"), Some(layout));
    assert_eq!(recall(&folder, &two).expect("no file"), None);
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn broken_files_are_refused_with_the_reason() {
    let folder = folder("broken");
    let graph = folder.join("g.toml");
    remember(&folder, &graph, &Layout::default()).expect("written");
    let file = std::fs::read_dir(folder.join("layouts")).expect("a folder").flatten().next().expect("a file").path();
    let good = std::fs::read_to_string(&file).expect("text");
    let cases = [
        (good.replace("\"graph\"", "\"node\""), "several places"),
        (good.replace("\"plots\"", "\"curves\""), "unknown variant `curves`"),
        (good.replace("size = 320.0", "size = nan"), "a size is NaN"),
        (good.replace("size = 320.0", "size = -1.0"), "a size is -1"),
        (good[..good.len() / 2].to_owned(), ""),
        ("[".to_owned(), ""),
        ("x".repeat(70_000), "more than"),
        (format!("graph = \"g\"\nroot = {}", "{ row = [{ size = 100.0, dock = ".repeat(400)), ""),
    ];
    for (text, reason) in cases {
        assert_ne!(text, good);
        std::fs::write(&file, &text).expect("written");
        let error = recall(&folder, &graph).expect_err("broken").to_string();
        assert!(error.contains(reason) && error.contains("is not used"), "{error}");
    }
    // A panel that an older version did not know gets its place.
    std::fs::write(&file, good.replace("\"sweep\", ", "").replace("\"help\"", "")).expect("written");
    whole(&recall(&folder, &graph).expect("read").expect("known"));
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn arrangements_stay_whole_whatever_is_done() {
    let sides = [Side::Left, Side::Right, Side::Above, Side::Below];
    let mut layout = Layout::default();
    let mut state = 7u64;
    for _ in 0..4000 {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let bits = (state >> 33) as usize;
        let panel = Panel::ALL[bits % Panel::ALL.len()];
        match bits / 16 % 5 {
            0 => layout.toggle(panel),
            1 => _ = layout.tear_off(panel, [1.0, 2.0]),
            2 => _ = layout.dock(panel),
            3 => _ = layout.grow(panel, if bits & 1024 > 0 { 40.0 } else { -40.0 }),
            _ => _ = layout.move_beside_graph(panel, sides[bits / 128 % 4]),
        }
        whole(&layout);
        assert!(layout.is_shown(Panel::Graph), "{layout:#?}");
        assert_eq!(layout.clone().checked(), Ok(layout.clone()));
    }
    let text = Stored::text("g", &layout).expect("written");
    assert_eq!(Stored::parse(&text), Ok(("g".to_owned(), layout)));
}
