//! Every language has the same texts as English, with the same variables; no text is there twice, and none is left over.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::{
    Language, Phrase, Value, add_languages, bytes, decimal, declared, files, filled, phrase, plain, set_language,
    syntax, text,
};

type Texts = BTreeMap<String, BTreeSet<String>>;

/// Crates whose windows have these texts.
const SPOKEN_BY: [&str; 4] = ["bench", "model", "theatre", "widgets"];

/// Texts that are the same in English and German, because the words are.
const SAME: &[&str] = &[
    "alarm-not-changed",
    "args-start",
    "arguments-start",
    "canvas-median",
    "canvas-name",
    "canvas-rate",
    "check-arm",
    "check-pedal",
    "eye-name",
    "form-argument",
    "form-overlay",
    "help-optional",
    "machine-ended",
    "measure-length",
    "mistakes-at",
    "node-median",
    "node-name",
    "node-rate-is",
    "overview-age",
    "overview-preset",
    "overview-share",
    "panel-button",
    "panel-graph",
    "panel-states",
    "panel-text",
    "plot-rate",
    "plugins-heading",
    "presets-heading",
    "state-live",
    "state-rate",
    "template-panorama",
    "top-presets",
    "top-text",
    "tour-name",
    "trace-path-name",
    "view-live",
    "view-zoomed",
    "worker-refused",
];

/// The texts of a language, and those that it has twice.
fn texts_of(language: Language) -> (Texts, Vec<String>) {
    let (mut all, mut twice) = (Texts::new(), Vec::new());
    for (_, area, text) in files().iter().filter(|(code, ..)| *code == language.code()) {
        let found = syntax::texts(text).unwrap_or_else(|error| panic!("{}/{area}.ftl: {error}", language.code()));
        for (name, variables) in found {
            if all.insert(name.clone(), variables).is_some() {
                twice.push(format!("{}/{area}.ftl: {name}", language.code()));
            }
        }
    }
    (all, twice)
}

#[test]
fn every_language_has_all_texts_with_the_variables_of_the_english_ones() {
    let (english, _) = texts_of(Language::English);
    assert_eq!(english.len(), declared().len());
    let mut wrong = Vec::new();
    for language in Language::ALL {
        let code = language.code();
        let (texts, twice) = texts_of(language);
        wrong.extend(twice.into_iter().map(|name| format!("{name}: it is there twice")));
        for (name, variables) in &english {
            match texts.get(name) {
                None => wrong.push(format!("{code}: {name} is missing")),
                Some(own) if own != variables => wrong.push(format!("{code}: {name} has {own:?}, not {variables:?}")),
                Some(_) => {}
            }
        }
        let left = texts.keys().filter(|name| !english.contains_key(*name));
        wrong.extend(left.map(|name| format!("{code}: there is no English {name}")));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn every_language_has_the_same_files_and_every_folder_is_a_language() {
    let areas = |code: &str| -> BTreeSet<&str> {
        files().iter().filter(|(of, ..)| *of == code).map(|(_, area, _)| *area).collect()
    };
    for language in Language::ALL {
        assert_eq!(areas(language.code()), areas("en"), "{language:?}");
        assert!(!language.name().is_empty());
    }
    for (code, area, _) in files() {
        assert!(Language::ALL.iter().any(|language| language.code() == *code), "{code}/{area}.ftl: no such language");
    }
}

/// The Rust files below a folder.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
        let path = entry.path();
        if path.is_dir() {
            // Every text is named where the languages are compared.
            if !path.ends_with("model/src/texts") {
                sources(&path, found);
            }
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn every_text_is_used() {
    let mut paths = Vec::new();
    for name in SPOKEN_BY {
        sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name).join("src"), &mut paths);
    }
    assert!(paths.len() > 50, "the crates are found");
    let code: String = paths.iter().map(|path| std::fs::read_to_string(path).expect("a source")).collect();
    let is_named = |name: &str| code.contains(&format!("\"{name}\""));
    // A table in the code names a text once, and uses its attributes, too.
    let of_table = |name: &'static str| -> Option<&'static str> {
        let (message, attribute) = name.split_once('.')?;
        let is_known = TABLES.iter().any(|(start, known)| message.starts_with(start) && known.contains(&attribute));
        is_known.then_some(message)
    };
    let unused: Vec<&str> = declared()
        .iter()
        .map(|(name, _)| *name)
        .filter(|name| !is_named(name) && !of_table(name).is_some_and(is_named))
        .collect();
    assert!(unused.is_empty(), "no window uses {unused:#?}");
}

/// Beginnings of names and the attributes that a table in the code uses of each.
const TABLES: &[(&str, &[&str])] = &[("alarm-", &["cause", "action"])];

#[test]
fn texts_are_translated_and_not_only_copied() {
    let (mut same, mut count) = (Vec::new(), 0);
    for (name, variables) in declared() {
        let in_language = |language| {
            set_language(language);
            match variables.is_empty() {
                true => plain(name).to_owned(),
                false => {
                    let values: Vec<(&str, Value)> = variables.iter().map(|v| (*v, Value::from("x"))).collect();
                    filled(name, &values)
                }
            }
        };
        count += 1;
        if in_language(Language::English) == in_language(Language::German) {
            same.push(*name);
        }
    }
    assert!(count > 100);
    let unexpected: Vec<&&str> = same.iter().filter(|name| !SAME.contains(name)).collect();
    assert!(unexpected.is_empty(), "translated, or one of SAME? {unexpected:#?}");
    let gone: Vec<&&str> = SAME.iter().filter(|name| !same.contains(name)).collect();
    assert!(gone.is_empty(), "these differ meanwhile: {gone:#?}");
}

#[test]
fn numbers_and_plurals_follow_the_language() {
    let heading = |count: usize| text!("checklist-left", count = count);
    assert_eq!((heading(1), heading(3)), ("1 point is not ready".to_owned(), "3 points are not ready".to_owned()));
    let clock = || text!("check-machine-clock", reach = decimal(0.82, 1), error = decimal(0.41, 1), offset = "-3.2");
    assert_eq!(clock(), "reached in 0.8 ms; ages are right to 0.4 ms (its clock is -3.2 ms)");
    set_language(Language::German);
    assert_eq!(
        (heading(1), heading(3)),
        ("1 Punkt ist nicht bereit".to_owned(), "3 Punkte sind nicht bereit".to_owned())
    );
    assert_eq!(text!("check-image", ms = 350), "Bild 350 ms alt");
    assert_eq!(text!("alarm-disk-low", size = bytes(1_900_000_000)), "Speicher fast voll: 1,9 GB frei");
    assert!(clock().starts_with("in 0,8 ms erreicht; Alter auf 0,4 ms genau"), "{}", clock());
}

#[test]
fn a_phrase_is_put_into_words_later_and_survives_the_way_to_another_process() {
    let crash = phrase!("worker-crashed-in", node = "wide", signal = "SIGSEGV");
    let notice = phrase!("notice-cameras-until", seconds = 2, event = &crash);
    let english = "Camera image only, all views in 2 s: the image processing crashed in node `wide` (SIGSEGV)";
    assert_eq!(notice.to_string(), english);
    set_language(Language::German);
    let german = "Nur Kamerabild, alle Ansichten in 2 s: Bildverarbeitung in Knoten „wide“ abgestürzt (SIGSEGV)";
    assert_eq!((notice.to_string().as_str(), notice.english().as_str()), (german, english));
    let sent = serde_json::to_string(&notice).expect("memory takes it");
    let there: Phrase = serde_json::from_str(&sent).expect("it is read");
    assert_eq!((&there, there.to_string().as_str()), (&notice, german));
}

#[test]
fn what_is_wrong_falls_back_to_english_and_never_to_nothing() {
    set_language(Language::German);
    // A variable without a value, as another process may send it.
    let lacking: Phrase =
        serde_json::from_str(r#"{"id": "alarm-camera-lost", "values": [["camera", {"Text": "Left"}]]}"#).expect("read");
    assert!(lacking.to_string().starts_with("Left getrennt: kein Bild seit "), "{lacking}");
    let unknown: Phrase = serde_json::from_str(r#"{"id": "no-such-text", "values": []}"#).expect("read");
    assert_eq!(unknown.to_string(), "no-such-text");
}

/// The English texts with every word in brackets, as a file of another language.
fn bracketed() -> String {
    let mut all = String::new();
    for (_, _, text) in files().iter().filter(|(code, ..)| *code == "en") {
        let resource = fluent_syntax::parser::parse(*text).expect("English has no mistakes");
        all.push_str(&fluent_syntax::serializer::serialize(&resource));
    }
    // A text begins after ` = `, of a message or of an attribute, and after `] ` where there are several.
    let line = |line: &str| match (line.trim_start().chars().next(), line.split_once(" = "), line.split_once("] ")) {
        (Some('[' | '*'), _, Some((name, text))) => format!("{name}] ⟦{text}"),
        (_, Some((name, text)), _) => format!("{name} = ⟦{text}"),
        _ => line.to_owned(),
    };
    let texts = all.lines().map(line).collect::<Vec<_>>().join("\n");
    format!("language-name = Probe\nlanguage-decimal-sign = ,\n{texts}\n")
}

#[test]
fn one_file_adds_a_language_and_english_stands_in_for_what_it_lacks() {
    let folder = std::env::temp_dir().join(format!("panoscope_texts_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("created");
    let whole = bracketed();
    std::fs::write(folder.join("xx.ftl"), &whole).expect("written");
    let some =
        "language-name = Français\ntop-save = Enregistrer\nno-such-text = Rien\nalarm-image-old = { $inconnu }\n";
    std::fs::write(folder.join("fr.ftl"), some).expect("written");
    for (name, text) in [("de.ftl", "top-save = Anders\n"), ("yy.ftl", "top-save"), ("Nope.ftl", "a = b\n")] {
        std::fs::write(folder.join(name), text).expect("written");
    }
    let problems: Vec<String> = add_languages(&folder).iter().map(ToString::to_string).collect();
    std::fs::remove_dir_all(&folder).expect("removed");
    let says = |words: &[&str]| problems.iter().any(|problem| words.iter().all(|word| problem.contains(word)));
    assert!(says(&["de.ftl", "already"]) && says(&["yy.ftl"]) && says(&["Nope.ftl", "code"]), "{problems:#?}");
    assert!(says(&["fr.ftl", "2 texts"]), "{problems:#?}");
    assert_eq!(problems.len(), 4, "{problems:#?}");
    let of = |code: &str| Language::of_locale(code).expect("it was added");

    // Every text of the windows comes from the file.
    let other = of("xx_YY.UTF-8");
    assert_eq!((other.code(), other.name()), ("xx", "Probe"));
    set_language(other);
    let mut left = Vec::new();
    for (id, variables) in declared() {
        let shown = match variables.is_empty() {
            true => plain(id).to_owned(),
            false => filled(id, &variables.iter().map(|name| (*name, Value::from(2))).collect::<Vec<_>>()),
        };
        if !shown.contains('⟦') {
            left.push((*id, shown));
        }
    }
    assert!(left.is_empty(), "not from the file: {left:#?}");
    assert!(text!("alarm-image-old", seconds = decimal(0.42, 1)).contains("0,4"), "its decimal sign");

    // What a file lacks, or has with another variable, is English.
    set_language(of("fr"));
    assert_eq!((text!("top-save"), text!("top-undo")), ("Enregistrer", "Undo"));
    assert_eq!(text!("alarm-image-old", seconds = decimal(0.42, 1)), "Image is 0.4 s old");
    // The languages go round, and end in English.
    let round: Vec<&str> =
        std::iter::successors(Some(Language::English), |now| Some(now.next())).take(5).map(Language::code).collect();
    assert_eq!(round, ["en", "de", "fr", "xx", "en"]);
}
