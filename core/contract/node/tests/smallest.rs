//! The smallest plugin takes at most 30 lines, and `export_plugin!` makes a complete plugin of it.

use panoscope_node::abi;
use panoscope_node::harness::{Foreign, Harness, HarnessError, Setup};
use panoscope_node::{Gray8, export};

#[path = "smallest/lib.rs"]
mod plugin;

#[test]
fn it_is_small() {
    let lines = include_str!("smallest/lib.rs").lines().count();
    assert!(lines <= 30, "the smallest plugin has {lines} lines");
}

#[test]
fn its_descriptor_runs() -> Result<(), HarnessError> {
    // SAFETY: the descriptor is a static of this program, and the plugin obeys the ABI.
    let mut node = unsafe { Harness::<Foreign>::of_plugin(plugin::panoscope_plugin(), "negative", Setup::new(""))? };
    let out = node.input_image::<Gray8>("image", 3, 1, &[0, 1, 255]).process()?;
    assert_eq!(out.plane::<Gray8>("image")?.data, [255, 254, 0]);
    assert_eq!(node.node_type().plugin, "node", "named after the package, without its `panoscope-`");
    assert_eq!(node.node_type().inputs[0].doc, "Any picture.");
    // SAFETY: the descriptor is a static of this program, and the plugin obeys the ABI.
    let wrong = unsafe { Harness::<Foreign>::of_plugin(plugin::panoscope_plugin(), "negativ", Setup::new("")) };
    let wrong = wrong.err().map(|e| e.to_string());
    assert_eq!(wrong.as_deref(), Some("the plugin has no node type `negativ`; there are: negative"));
    Ok(())
}

#[test]
fn its_note_says_the_same() {
    // SAFETY: the descriptor and its note are statics of this program.
    let note = unsafe { &*plugin::PANOSCOPE_PLUGIN.note };
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned();
    assert_eq!((note.owner_len, note.note_type, text(&note.owner)), (12, abi::NOTE_TYPE, "Panoscope".to_owned()));
    assert_eq!(note.body_len as usize, size_of::<abi::NoteBody>());
    assert_eq!((note.body.abi_major, note.body.abi_minor), (abi::ABI_MAJOR, abi::ABI_MINOR));
    assert_eq!(text(&note.body.name), "node");
    assert_eq!(text(&note.body.version), env!("CARGO_PKG_VERSION"));
    assert_eq!(text(&note.body.nodes), "negative");
    let two = abi::Note::new("a", "1", &["b", "c"]);
    assert_eq!(text(&two.body.nodes), "b,c");
}

#[test]
fn plugins_are_named_after_their_package() {
    assert_eq!(export::plugin_name("panoscope-stitch"), "stitch");
    assert_eq!(export::plugin_name("stitch"), "stitch");
    assert_eq!(export::plugin_name("panoscope"), "panoscope");
}
