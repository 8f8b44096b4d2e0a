//! Thousands of damaged graphs: the check never panics and its places stay inside the text.

use crate::common;
use panoscope_base::random::SplitMix64;
use panoscope_graph::{Catalog, GraphText, check, edit::GraphEdit};
use std::path::Path;

fn pick<'a, T>(random: &mut SplitMix64, items: &'a [T]) -> &'a T {
    &items[random.below(items.len())]
}

const SCRAPS: [&str; 44] = [
    "\"",
    "'",
    "[",
    "]",
    "{",
    "}",
    "=",
    ".",
    ",",
    "#",
    "\n",
    "\r\n",
    "\t",
    " ",
    "\\",
    "\"\"\"",
    "[[",
    "]]",
    "-1",
    "1e999",
    "nan",
    "inf",
    "99999999999999999999999",
    "true",
    "é",
    "内",
    "\u{1f600}",
    "\u{0}",
    "\u{feff}",
    "0x",
    "nodes",
    "[nodes.",
    "type = ",
    "inputs = ",
    "delay = 1",
    "align = \"latest\"",
    "trigger = true",
    "scope.left",
    "a.b.c",
    "\"\" = 1",
    "1979-05-27",
    "[nodes.scope]\n",
    "[nodes.a]\n",
    "left = \"wide.panorama\"",
];

fn boundary(text: &str, at: usize) -> usize {
    text.floor_char_boundary(at.min(text.len()))
}

fn damage(random: &mut SplitMix64, text: &mut String, others: &[String]) {
    let a = boundary(text, random.below(text.len() + 1));
    match random.below(7) {
        0 => text.insert_str(a, pick::<&str>(random, &SCRAPS)),
        1 => {
            let b = boundary(text, a + random.below(12));
            text.replace_range(a.min(b)..a.max(b), "");
        }
        2 => {
            let b = boundary(text, a + random.below(12));
            let scrap = *pick(random, &SCRAPS);
            text.replace_range(a.min(b)..a.max(b), scrap);
        }
        3 => text.truncate(a),
        4 => {
            let other = pick(random, others);
            let from = boundary(other, random.below(other.len()));
            let to = boundary(other, from + random.below(80));
            text.insert_str(a, &other[from..to.max(from)]);
        }
        5 => {
            // A line again, somewhere else.
            let lines: Vec<String> = text.lines().map(str::to_owned).collect();
            if !lines.is_empty() {
                let line = pick(random, &lines).clone() + "\n";
                let at = text[..a].rfind('\n').map_or(0, |n| n + 1);
                text.insert_str(at, &line);
            }
        }
        _ => {
            let lines: Vec<&str> = text.lines().collect();
            if lines.len() > 1 {
                let gone = random.below(lines.len());
                let kept: Vec<&str> = lines.iter().enumerate().filter(|(i, _)| *i != gone).map(|(_, l)| *l).collect();
                *text = kept.join("\n") + "\n";
            }
        }
    }
}

/// Whether a table has dotted keys of one prefix with other keys between them: `toml_edit` writes them together.
fn has_scattered_keys(text: &str) -> bool {
    let mut ended: Vec<&str> = Vec::new();
    let mut last = "";
    for line in text.lines().map(str::trim) {
        if line.starts_with('[') {
            ended.clear();
            last = "";
        }
        let Some((key, _)) = line.split_once('=') else { continue };
        let prefix = key.split_once('.').map_or(key, |(prefix, _)| prefix).trim();
        if prefix != last {
            if ended.contains(&prefix) {
                return true;
            }
            ended.push(last);
            last = prefix;
        }
    }
    false
}

fn check_one(text: &str, sets: &[&str], catalog: &Catalog) -> bool {
    let mut graph_text = GraphText::parse(Path::new("no_such_folder/mutant.toml"), text);
    for set in sets {
        graph_text.set(set);
    }
    let checked = check(&graph_text, catalog);
    for d in &checked.diagnostics {
        if d.file != "command line" {
            assert!(text.get(d.span.clone()).is_some(), "{:?} of {d:?} in\n{text}", d.span);
            assert!(d.line >= 1 && d.line <= text.matches('\n').count() + 1, "{d:?} in\n{text}");
            for note in &d.notes {
                assert!(text.get(note.span.clone()).is_some(), "{note:?} in\n{text}");
            }
        }
        assert!(!d.message.is_empty() && !d.code.is_empty());
    }
    assert!(!checked.diagnostics.render(true).contains("\x1b[1;31merror[]"));
    assert_eq!(checked.graph.is_some(), !checked.diagnostics.has_errors(), "{}\n{text}", checked.diagnostics);
    if let Some(graph) = &checked.graph {
        assert_eq!(graph.order.len(), graph.nodes.len());
        let _ = panoscope_graph::to_dot(graph, catalog);
    }
    // `toml_edit` tidies spaces inside table headers; everything else stays as it is.
    let tidied = text.lines().any(|l| l.trim_start().starts_with('[') && l.contains([' ', '\t']));
    if let Ok(edit) = GraphEdit::parse(text)
        && !tidied
        && !has_scattered_keys(text)
        && !text.contains('\r')
        && !text.starts_with('\u{feff}')
    {
        assert_eq!(edit.text(), text);
    }
    checked.graph.is_some()
}

#[test]
fn damaged_graphs_never_panic() {
    let catalog = common::catalog();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/bad_graphs");
    let mut seeds: Vec<(String, String)> = std::fs::read_dir(folder)
        .expect("tests/bad_graphs")
        .filter_map(|entry| {
            let path = entry.expect("an entry").path();
            let name = path.file_name()?.to_string_lossy().into_owned();
            name.ends_with(".toml").then(|| (name, std::fs::read_to_string(&path).unwrap_or_default()))
        })
        .collect();
    seeds.sort();
    let seeds: Vec<String> = seeds.into_iter().map(|(_, text)| text).filter(|t| !t.is_empty()).collect();
    let mut random = SplitMix64(7);
    for _ in 0..6000 {
        let mut text = pick(&mut random, &seeds).clone();
        for _ in 0..1 + random.below(6) {
            damage(&mut random, &mut text, &seeds);
        }
        let sets: &[&str] =
            if random.below(4) == 0 { &["scope.seed=3", "a.b=é", "wide.blend_px=[", "=.="] } else { &[] };
        check_one(&text, sets, &catalog);
    }
}

/// What starts valid and is damaged once often stays valid: the invariants of checked graphs are tried on it.
#[test]
fn many_valid_graphs_survive_one_damage() {
    let catalog = common::catalog();
    let seeds = [common::graphs::PANORAMA.to_owned(), common::graphs::EVERY_KEY.to_owned()];
    for seed in &seeds {
        assert!(check_one(seed, &[], &catalog), "a seed is not valid");
    }
    let mut random = SplitMix64(7);
    let (mut survivors, mut changed) = (0, 0);
    let count = 3000;
    for _ in 0..count {
        let seed = pick(&mut random, &seeds);
        let mut text = seed.clone();
        damage(&mut random, &mut text, &seeds);
        let survives = check_one(&text, &[], &catalog);
        survivors += usize::from(survives);
        changed += usize::from(survives && text != *seed);
    }
    println!("{survivors} of {count} damaged graphs are valid, {changed} of them changed");
    // Neither bound is near: most damage is an error, much of it hits comments and labels.
    assert!(survivors < count * 3 / 4, "{survivors} of {count} survive: the check misses damage");
    assert!(changed > count / 20, "{changed} of {count} survive with a change: the invariants are hardly tried");
}
