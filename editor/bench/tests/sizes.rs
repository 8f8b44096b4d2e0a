//! The window at four sizes, in both themes and both languages: no words overlap in the bar above and in the panels, and none leave the window. With
//! `PANOSCOPE_SCREENS=FOLDER` pictures are written there: dark ones in English, light ones in German.

use std::path::Path;

use crate::common::{Folder, Window, has_plugin};
use crate::looks_graph::GRAPH;
use eframe::egui::{Key, Modifiers, Rect, Shape, Vec2, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::Options;
use panoscope_editor_model::session::Phase;
use panoscope_editor_model::texts::{Language, set_language, text};
use panoscope_editor_widgets::golden::paint;
use panoscope_editor_widgets::theme::{Choice, ground};

const NONE: Modifiers = Modifiers::NONE;
/// Sizes of the window in px, and px per point.
const SIZES: [([f32; 2], f32); 4] =
    [([1280.0, 720.0], 1.0), ([1920.0, 1080.0], 1.0), ([2560.0, 1440.0], 1.0), ([3840.0, 2160.0], 2.0)];
/// A key with its modifiers, if any is pressed.
type Pressed = Option<(Modifiers, Key)>;
/// What is shown: its name, the node that is selected, and the key that shows it and puts it away.
const SHOWN: [(&str, &str, Pressed); 9] = [
    ("graph", "", None),
    ("node", "level", None),
    ("plots", "", Some((NONE, Key::P))),
    ("timeline", "", Some((NONE, Key::J))),
    ("sweep", "level", Some((NONE, Key::S))),
    ("problems", "", Some((NONE, Key::M))),
    ("presets", "", Some((NONE, Key::R))),
    ("add", "", Some((NONE, Key::A))),
    ("keys", "", Some((NONE, Key::F1))),
];

/// Those of them that are dialogs.
const DIALOGS: [&str; 2] = ["add", "keys"];
/// Those of them whose pictures are written.
const WRITTEN: [&str; 4] = ["node", "plots", "timeline", "keys"];

/// The visible part of each text of the last frame, beyond the graph itself, whose nodes may lie below a panel.
fn texts(window: &Window) -> Vec<(String, Rect)> {
    fn collect(shape: &Shape, clip: Rect, found: &mut Vec<(String, Rect)>) {
        match shape {
            Shape::Vec(shapes) => shapes.iter().for_each(|shape| collect(shape, clip, found)),
            // The names of axes are turned.
            Shape::Text(text) if text.angle == 0.0 => {
                for row in &text.galley.rows {
                    let rect = row.rect_without_leading_space().translate(text.pos.to_vec2()).intersect(clip);
                    let words: String = row.glyphs.iter().map(|glyph| glyph.chr).collect();
                    if rect.is_positive() && !words.trim().is_empty() {
                        found.push((words, rect));
                    }
                }
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    window.harness.output().shapes.iter().for_each(|part| collect(&part.shape, part.clip_rect, &mut found));
    let graph = window.app().canvas().rect;
    found.retain(|(_, rect)| !graph.intersects(*rect));
    found
}

/// Texts of which one lies over another one.
fn overlaps(texts: &[(String, Rect)]) -> Vec<String> {
    let mut found = Vec::new();
    for (at, (a, first)) in texts.iter().enumerate() {
        for (b, second) in &texts[at + 1..] {
            let both = first.intersect(*second);
            // Letters of two rows may touch.
            if both.width() > 2.0 && both.height() > 4.0 {
                found.push(format!("`{a}` at {first:?} and `{b}` at {second:?}"));
            }
        }
    }
    found
}

#[test]
fn nothing_overlaps_at_any_size_in_any_theme_or_language() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("sizes");
    let path = folder.write("looks.toml", GRAPH);
    let to = std::env::var_os("PANOSCOPE_SCREENS");
    let mut wrong = Vec::new();
    for language in Language::ALL {
        set_language(language);
        for (theme, theme_name) in [(Choice::Dark, "dark"), (Choice::Light, "light")] {
            let mut window = Window::open_with(&path, Options { theme, ..Options::default() });
            window.until("it runs", |app| app.session().status().phase == Phase::Running);
            for ([width, height], scale) in SIZES {
                window.harness.set_pixels_per_point(scale);
                window.harness.set_size(vec2(width, height) / scale);
                for (name, node, key) in SHOWN {
                    let what = format!("{width}x{height}_{theme_name}_{}_{name}", language.code());
                    show(&mut window, node, key);
                    // A dialog lies over the panels.
                    if !DIALOGS.contains(&name) {
                        wrong.extend(overlaps(&texts(&window)).into_iter().map(|text| format!("{what}: {text}")));
                    }
                    let whole = Rect::from_min_size(Default::default(), Vec2::new(width, height) / scale).expand(0.5);
                    let outside = texts(&window).into_iter().filter(|(_, rect)| !whole.contains_rect(*rect));
                    wrong.extend(outside.map(|(text, rect)| format!("{what}: `{text}` at {rect:?} leaves the window")));
                    // Each theme and each language, not both of both: a picture takes seconds.
                    let is_written = (theme == Choice::Dark) == (language == Language::English);
                    if let Some(to) = to.as_ref().filter(|_| is_written && WRITTEN.contains(&name)) {
                        write(&window, &Path::new(to).join(format!("{what}.png")));
                    }
                    put_away(&mut window, key);
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{} of them: {wrong:#?}", wrong.len());
}

fn show(window: &mut Window, node: &str, key: Pressed) {
    if !node.is_empty() {
        let name = text!("canvas-node", node = node);
        window.harness.get_by_label(&name).click_accesskit();
    }
    if let Some((modifiers, key)) = key {
        window.key(modifiers, key);
    }
    window.steps(6);
}

fn put_away(window: &mut Window, key: Pressed) {
    match key {
        Some((_, Key::A | Key::F1)) => window.key(NONE, Key::Escape),
        Some((modifiers, key)) => window.key(modifiers, key),
        None => {}
    }
    window.key(NONE, Key::Escape);
    window.steps(3);
}

fn write(window: &Window, file: &Path) {
    std::fs::create_dir_all(file.parent().expect("a folder")).expect("created");
    let picture = paint(&window.harness.ctx, window.harness.output(), &window.textures, ground());
    picture.save(file).expect("written");
}
