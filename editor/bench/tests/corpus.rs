//! All shipped graphs and generated ones, arranged in windows of three sizes: nothing overlaps, texts are legible, the window is used.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::{Vec2, vec2};
use panoscope_editor::arrangement::Arrangement;
use panoscope_host::loader::{self as loader, Loader};

const SIZES: [Vec2; 3] = [vec2(1280.0, 720.0), vec2(1440.0, 900.0), vec2(3840.0, 2160.0)];
/// Least size of a text, in points.
const TEXT: f32 = 11.0;
/// Share of the canvas that a graph uses.
const USED: f32 = 0.55;

fn node(id: &str, node_type: &str, from: &[String]) -> String {
    let inputs = match from {
        [] => String::new(),
        [one] => format!("inputs = {{ image = \"{one}\" }}\n"),
        many => format!("inputs = {{ images = {many:?} }}\n"),
    };
    format!("[nodes.{id}]\ntype = \"{node_type}\"\n{inputs}")
}

fn output(id: impl std::fmt::Display) -> String {
    format!("{id}.image")
}

/// Chains, fans, trees, ladders, loops of several sizes.
fn generated() -> Vec<(String, String)> {
    let head = "plugins = [\"flow\", \"fixtures\"]\n".to_owned();
    let source = node("s", "frames", &[]);
    let mut graphs = Vec::new();
    for count in [2, 6, 14, 40, 120] {
        let chain: String = (0..count)
            .map(|n| {
                let from = if n == 0 { output("s") } else { output(format!("n{}", n - 1)) };
                node(&format!("n{n}"), "pass", &[from])
            })
            .collect();
        graphs.push((format!("chain of {count}"), format!("{head}{source}{chain}")));
    }
    for count in [5, 12, 30] {
        let fan: String = (0..count).map(|n| node(&format!("n{n}"), "drain", &[output("s")])).collect();
        graphs.push((format!("fan of {count}"), format!("{head}{source}{fan}")));
    }
    for count in [15, 63] {
        let from = |n: usize| if n == 0 { output("s") } else { output(format!("n{}", (n - 1) / 2)) };
        let tree: String = (0..count).map(|n| node(&format!("n{n}"), "pass", &[from(n)])).collect();
        graphs.push((format!("tree of {count}"), format!("{head}{source}{tree}")));
    }
    for (rows, length) in [(2, 6), (4, 10), (13, 23)] {
        let mut text = format!("{head}{source}");
        for row in 0..rows {
            for n in 0..length {
                let from = if n == 0 { output("s") } else { output(format!("n{row}_{}", n - 1)) };
                text += &node(&format!("n{row}_{n}"), "pass", &[from]);
            }
        }
        let ends: Vec<String> = (0..rows).map(|row| output(format!("n{row}_{}", length - 1))).collect();
        text += &node("all", "ledger", &ends);
        graphs.push((format!("{rows} chains of {length}"), text));
    }
    let by_hand: Vec<(String, String)> =
        graphs.iter().map(|(name, text)| (format!("{name}, by hand"), placed_by_hand(text))).collect();
    graphs.extend(by_hand);
    graphs
}

/// A graph with positions that have nothing to do with its wires, on a grid with gaps of 32 points and more.
fn placed_by_hand(text: &str) -> String {
    let nodes: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("[nodes.")?.strip_suffix(']')).collect();
    let columns = (nodes.len() as f32).sqrt().ceil() as usize;
    // Every node somewhere else than its neighbours.
    let stride = if nodes.len().is_multiple_of(7) { 5 } else { 7 };
    let place = |(n, id): (usize, &&str)| {
        let at = n * stride % nodes.len();
        format!("{id} = {{ x = {}, y = {} }}\n", at % columns * 248 + n % 3 * 8, at / columns * 288 + n % 5 * 8)
    };
    let editor: String = nodes.iter().enumerate().map(place).collect();
    format!("{text}\n[editor]\n{editor}")
}

fn shipped() -> Vec<(String, PathBuf)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../graphs");
    let files = std::fs::read_dir(folder).expect("the graphs are there").flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = files.filter(|file| file.extension().is_some_and(|e| e == "toml")).collect();
    files.sort();
    files.into_iter().map(|file| (file.file_stem().unwrap_or_default().to_string_lossy().into_owned(), file)).collect()
}

#[test]
fn graphs_are_legible_and_use_the_window() {
    let loader = Arc::new(Loader::search(&loader::search_path(&[])));
    for plugin in ["flow", "fixtures", "phantom", "stitch", "stereo"] {
        if !loader.found().any(|found| found.note.name == plugin) {
            panoscope_testing::skipped!(
                "plugin `{plugin}` is not in PANOSCOPE_PLUGIN_PATH; `cargo xtask test` sets it"
            );
            return;
        }
    }
    let files = shipped().into_iter().map(|(name, file)| {
        let text = std::fs::read_to_string(&file).expect("it is read");
        (name, file, text)
    });
    let made = generated().into_iter().map(|(name, text)| (name, PathBuf::from("generated.toml"), text));
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (name, path, text) in files.chain(made) {
        count += 1;
        for size in SIZES {
            let seen = Arrangement::of(&path, &text, Arc::clone(&loader), size);
            let line = format!(
                "{name:24} {:4}x{:<4} {:3} nodes, scale {:.2}, text {:4.1}, named {:3.0} %, used {:3.0} %, covered {:3.0} %",
                size.x,
                size.y,
                seen.nodes,
                seen.scale,
                seen.min_text.unwrap_or_default(),
                seen.named * 100.0,
                seen.used * 100.0,
                seen.covered * 100.0
            );
            println!("{line}");
            let small = seen.min_text.is_some_and(|text| text < TEXT) || seen.min_text.is_none();
            // A few nodes that are larger than designed need no more of the window.
            let empty = seen.used < USED && seen.scale < 1.2;
            // Where nodes are is up to who placed them; where wires run is not.
            let by_hand = name.ends_with("by hand");
            if (small || empty) && !by_hand || seen.overlaps > 0 || seen.nodes == 0 || !seen.under.is_empty() {
                wrong.push(format!("{line}, {} overlaps, under nodes: {:?}", seen.overlaps, seen.under));
            }
        }
    }
    assert!(count >= 30, "{count} graphs");
    assert!(wrong.is_empty(), "{:#?}", wrong);
}
