//! The keys of the theatre's foot pedal.

use panoscope_editor_model::pedal::{self, Binding};

/// Names of keys; two of them name the same key.
const KEYS: &[(&str, u8)] =
    &[("F13", 13), ("F14", 14), ("B", 2), ("7", 7), ("Num7", 7), ("Space", 32), ("PageDown", 33), ("Escape", 27)];
const ACTIONS: &[(&str, u8)] = &[("next", 0), ("freeze", 1), ("stop", 2), ("view1", 3)];

fn key(name: &str) -> Option<u8> {
    KEYS.iter().find(|(known, _)| *known == name).map(|(_, key)| *key)
}

fn name_of(list: &[(&str, u8)], number: u8) -> String {
    list.iter().find(|(_, known)| *known == number).map_or_else(String::new, |(name, _)| (*name).to_owned())
}

/// The text of a settings file with these keys.
fn text_of(keys: &[Binding<u8, u8>]) -> String {
    let mut text = "[keys]\n".to_owned();
    for Binding { ctrl, shift, alt, key, action } in keys {
        let held = [(ctrl, "Ctrl+"), (shift, "Shift+"), (alt, "Alt+")].into_iter().filter(|(is_held, _)| **is_held);
        let name: String = held.map(|(_, name)| name).chain([name_of(KEYS, *key).as_str()]).collect();
        text += &format!("\"{name}\" = \"{}\"\n", name_of(ACTIONS, *action));
    }
    text
}

pub fn run(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match pedal::parse(text, key, ACTIONS) {
        Ok(keys) => {
            assert!(!keys.is_empty(), "a file without keys is a mistake");
            let what = |one: &Binding<u8, u8>| (one.ctrl, one.shift, one.alt, one.key);
            for (at, one) in keys.iter().enumerate() {
                assert!(one.key != 27, "Escape leaves");
                assert!(keys[..at].iter().all(|other| what(other) != what(one)), "a key does one thing: {one:?}");
            }
            let again = pedal::parse(&text_of(&keys), key, ACTIONS).expect("what was written is read");
            let is_same = again.len() == keys.len() && keys.iter().all(|one| again.contains(one));
            assert!(is_same, "{keys:?} {again:?}");
        }
        Err(error) => assert!(!error.to_string().trim().is_empty(), "a mistake is named"),
    }
}

pub fn seeds() -> Vec<Vec<u8>> {
    let right = "# Mine.\n[keys]\nF13 = \"next\"\n\"Ctrl+Shift+B\" = \"freeze\"\n\"alt + 7\" = \"stop\"\nPageDown = \"view1\"\n";
    let texts = [
        right.to_owned(),
        right.replace("F13", "Escape"),
        right.replace("F13", "F99"),
        right.replace("F13", "\"Hyper+F13\""),
        right.replace("\"next\"", "3"),
        right.replace("next", "nxt"),
        right.replace("[keys]", "[pedal]"),
        "keys = 3\n".to_owned(),
        "[keys]\n".to_owned(),
        "[keys]\nNum7 = \"next\"\n7 = \"stop\"\n".to_owned(),
        "[keys]\n\"Ctrl+F13\" = \"stop\"\n\"CTRL+F13\" = \"next\"\n".to_owned(),
        format!("{right}[more]\nx = 1\n"),
        "[keys]\n\"++\" = \"next\"\n\"\" = \"next\"\n".to_owned(),
    ];
    texts.map(String::into_bytes).to_vec()
}
