//! Edits change what they name and not a byte else.

use crate::common;
use panoscope_graph::edit::{EditError, GraphEdit, parse_value};

const TEXT: &str = r#"# Wide view.   Odd   spacing is kept.
name    = "panorama"
plugins = ["phantom", "stitch",   "sinks"]  # three

[nodes.scope]   # the source
type = "phantom"
params = { seed = 7 }   # lucky

# Registration.
[nodes.register]
type   = "register_surf"
inputs = { left = "scope.left", right = "scope.right" }

[nodes.wide]
type = "composite"
# Three views of one instant.
inputs = { left = "scope.left", right = { from = "scope.right", queue = 2 }, homography = "register.homography" }

[nodes.pics]
type = "write_images"
[nodes.pics.inputs]
images = [ "wide.panorama", { from = 'register.homography' }, "scope.left" ] # all

[preset]                       # what may be touched
pinned = [ { param = "wide.blend_px", range = [0, 40] }, { param = "register.scale" } ]

[editor]
scope = { x = 1, y = 2 }
"#;

fn edit() -> GraphEdit {
    GraphEdit::parse(TEXT).expect("TOML")
}

/// Lines of `new` and `old` that differ, as (old, new) pairs; both must have as many lines.
fn changed(new: &str) -> Vec<(String, String)> {
    assert_eq!(new.lines().count(), TEXT.lines().count(), "{new}");
    TEXT.lines().zip(new.lines()).filter(|(a, b)| a != b).map(|(a, b)| (a.to_owned(), b.to_owned())).collect()
}

#[test]
fn nothing_changed_is_nothing_changed() {
    assert_eq!(edit().text(), TEXT);
    let crlf = TEXT.replace('\n', "\r\n");
    assert_eq!(GraphEdit::parse(&crlf).expect("TOML").text(), crlf);
}

#[test]
fn a_parameter_is_set_in_place() {
    let mut e = edit();
    e.set_param("scope", "seed", &parse_value("9")).expect("a node");
    let lines = changed(&e.text());
    assert_eq!(lines.len(), 1);
    assert_eq!(lines[0].1, "params = { seed = 9 }   # lucky");
}

#[test]
fn a_first_parameter_is_added_and_taken_back() {
    let mut e = edit();
    e.set_param("wide", "blend_px", &parse_value("12")).expect("a node");
    let text = e.text();
    let line = "params = { blend_px = 12 }\n";
    assert_eq!(text.replacen(line, "", 1), TEXT, "{text}");
    e.unset_param("wide", "blend_px").expect("a node");
    assert_eq!(e.text(), TEXT);
}

#[test]
fn inputs_are_connected_and_disconnected() {
    let mut e = edit();
    e.set_input("register", "left", &["scope.wide"]).expect("a node");
    assert_eq!(changed(&e.text())[0].1, "inputs = { left = \"scope.wide\", right = \"scope.right\" }");
    let mut e = edit();
    e.remove_input("register", "right").expect("a node");
    let lines = changed(&e.text());
    assert_eq!(lines.len(), 1, "{lines:?}");
    assert!(lines[0].1.starts_with("inputs = { left = \"scope.left\""), "{lines:?}");
    let mut e = edit();
    e.set_input("pics", "images", &["scope.left", "scope.right"]).expect("a node");
    assert_eq!(changed(&e.text())[0].1, "images = [\"scope.left\", \"scope.right\"] # all");
}

#[test]
fn a_node_is_added_behind_the_last_one() {
    let mut e = edit();
    e.add_node("out", "preview").expect("a new name");
    e.set_input("out", "packet", &["wide.panorama"]).expect("a node");
    e.add_plugin("sinks").expect("a list");
    let text = e.text();
    let added = "\n[nodes.out]\ntype = \"preview\"\ninputs = { packet = \"wide.panorama\" }\n";
    assert!(text.contains(added), "{text}");
    assert_eq!(text.replacen(added, "", 1), TEXT, "{text}");
    assert!(
        text.find("[nodes.pics]") < text.find("[nodes.out]") && text.find("[nodes.out]") < text.find("[preset]"),
        "{text}"
    );
    assert_eq!(e.add_node("out", "preview"), Err(EditError::NodeExists { id: "out".to_owned() }));
    assert_eq!(e.add_node("my out", "preview"), Err(EditError::BadId { id: "my out".to_owned() }));
}

#[test]
fn a_removed_node_takes_its_connections_along() {
    let mut e = edit();
    e.remove_node("register").expect("a node");
    let text = e.text();
    assert!(!text.contains("register"), "{text}");
    for kept in [
        "# three",
        "# the source",
        "# lucky",
        "# Three views of one instant.",
        "right = { from = \"scope.right\", queue = 2 }",
        "# all",
    ] {
        assert!(text.contains(kept), "{text}");
    }
    assert_eq!(e.remove_node("register"), Err(EditError::NoNode { id: "register".to_owned() }));
}

#[test]
fn a_renamed_node_keeps_its_readers() {
    let mut e = edit();
    e.rename_node("scope", "endoscope").expect("a node");
    let lines = changed(&e.text());
    for (old, new) in &lines {
        assert_eq!(
            old.replace("scope.", "endoscope.").replace("scope]", "endoscope]").replace("scope =", "endoscope ="),
            *new
        );
    }
    assert_eq!(lines.len(), 5, "{lines:?}");
    e.rename_node("endoscope", "scope").expect("a node");
    assert_eq!(e.text(), TEXT);
    let mut e = edit();
    e.rename_node("register", "align").expect("a node");
    assert!(e.text().contains("# Registration.\n[nodes.align]\n"), "{}", e.text());
    assert!(e.text().contains("{ param = \"align.scale\" }"), "{}", e.text());
    assert_eq!(e.rename_node("align", "wide"), Err(EditError::NodeExists { id: "wide".to_owned() }));
}

#[test]
fn positions_go_to_the_editors_table() {
    let mut e = edit();
    e.set_position("scope", 10.0, 20.5);
    e.set_position("wide", 3.0, 4.0);
    let text = e.text();
    assert!(text.ends_with("[editor]\nscope = { x = 10.0, y = 20.5 }\nwide = { x = 3.0, y = 4.0 }\n"), "{text}");
    assert!(text.starts_with(&TEXT[..TEXT.find("[editor]").expect("a table")]));
}

#[test]
fn an_empty_file_can_be_filled() {
    let mut e = GraphEdit::parse("# new\n").expect("TOML");
    e.add_plugin("phantom").expect("a list");
    e.add_plugin("sinks").expect("a list");
    e.add_node("scope", "phantom").expect("a new name");
    e.add_node("out", "preview").expect("a new name");
    e.set_input("out", "packet", &["scope.left"]).expect("a node");
    let text = panoscope_graph::GraphText::parse(std::path::Path::new("new.toml"), &e.text());
    let (graph, _) =
        panoscope_graph::check(&text, &common::catalog()).into_result().unwrap_or_else(|d| panic!("{}\n{d}", e.text()));
    assert_eq!(graph.edges.len(), 1);
    assert!(matches!(GraphEdit::parse("= 3"), Err(EditError::Syntax { .. })));
}

#[test]
fn one_place_of_an_input_is_connected_and_disconnected() {
    let text = "[nodes.a]\ntype = \"t\"\n[nodes.b]\ntype = \"u\" # mine\ninputs = { x = { from = \"a.p\", delay = 1 }, l = [\"a.p\", { from = \"a.q\", queue = 2 }] }\n";
    let mut edit = GraphEdit::parse(text).unwrap();
    edit.connect("b", "x", false, 0, "a.r").unwrap();
    edit.connect("b", "l", true, 1, "a.s").unwrap();
    edit.connect("b", "l", true, 2, "a.t").unwrap();
    edit.connect("b", "n", true, 0, "a.u").unwrap();
    let expected = "inputs = { x = { from = \"a.r\", delay = 1 }, l = [\"a.p\", { from = \"a.s\", queue = 2 }, \"a.t\"], n = [\"a.u\"] }\n";
    assert!(edit.text().ends_with(expected), "{}", edit.text());
    edit.disconnect("b", "l", 0).unwrap();
    edit.disconnect("b", "n", 0).unwrap();
    edit.disconnect("b", "x", 0).unwrap();
    edit.disconnect("b", "none", 0).unwrap();
    let expected = "type = \"u\" # mine\ninputs = { l = [{ from = \"a.s\", queue = 2 }, \"a.t\"] }\n";
    assert!(edit.text().ends_with(expected), "{}", edit.text());
}

#[test]
fn a_copy_stands_behind_the_last_node_and_before_what_follows() {
    let text = "[nodes.a]\ntype = \"t\"\n\n[nodes.a.params]\nx = 1 # one\n\n[preset]\npinned = []\n";
    let mut edit = GraphEdit::parse(text).unwrap();
    edit.duplicate_node("a", "b").unwrap();
    let copy = "[nodes.b]\ntype = \"t\"\n\n[nodes.b.params]\nx = 1 # one\n";
    assert!(edit.text().contains(copy), "{}", edit.text());
    assert!(edit.text().ends_with("\n[preset]\npinned = []\n"), "{}", edit.text());
    assert!(edit.duplicate_node("a", "b").is_err() && edit.duplicate_node("z", "c").is_err());
}

#[test]
fn nodes_of_another_file_are_pasted_under_new_names() {
    let from = GraphEdit::parse(
        "[nodes.a]\ntype = \"t\" # one\n[nodes.b]\ntype = \"u\"\ninputs = { x = \"a.p\", y = \"z.q\" }\n",
    )
    .unwrap();
    assert_eq!(from.node_names(), ["a", "b"]);
    let mut edit = GraphEdit::parse("[nodes.a]\ntype = \"t\"\n").unwrap();
    let names = [("a", "a_2"), ("b", "b")].map(|(old, new)| (old.to_owned(), new.to_owned()));
    edit.paste_nodes(&from, &names).unwrap();
    let expected = "[nodes.a]\ntype = \"t\"\n\n[nodes.a_2]\ntype = \"t\" # one\n\n[nodes.b]\ntype = \"u\"\ninputs = { x = \"a_2.p\", y = \"z.q\" }\n";
    assert_eq!(edit.text(), expected);
    assert!(edit.paste_nodes(&from, &names).is_err());
}

#[test]
fn views_of_the_preset_follow_their_nodes() {
    let text =
        "[nodes.a]\ntype = \"t\"\n[nodes.b]\ntype = \"t\"\n[preset]\nviews = [\"a.p\", { from = \"b.q\" }] # shown\n";
    let mut edit = GraphEdit::parse(text).expect("TOML");
    edit.rename_node("a", "left").expect("a node");
    assert!(edit.text().contains("views = [\"left.p\", { from = \"b.q\" }] # shown"), "{}", edit.text());
    edit.remove_node("left").expect("a node");
    assert!(edit.text().contains("{ from = \"b.q\"") && !edit.text().contains("left"), "{}", edit.text());
}
