//! The editor's window on running graphs of the `flow` plugin, without a screen.
#![allow(dead_code, reason = "each test binary uses a part")]

#[path = "../../../theatre/tests/common/input.rs"]
pub mod input;
#[path = "../../../theatre/tests/common/shared.rs"]
mod shared;

use std::path::Path;
use std::time::{Duration, Instant};

use eframe::egui::{Key, Modifiers, Rect, Shape, Ui, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::{App, Options};
use panoscope_editor_model::session::Phase;

pub use shared::{Folder, PATIENCE, has_plugin};

/// Two independent paths; `kept` records every tick of the first one.
pub const GRAPH: &str = r#"# Two paths.
name = "two"
mode = "live"
plugins = ["flow", "fixtures"]   # small nodes

[nodes.a]            # the path that nobody touches
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 50.0 }

[nodes.kept]
type = "ledger"
inputs = { images = [{ from = "a.image", queue = 64 }] }
params = { path = "kept.jsonl" }

[nodes.b]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 50.0 }

# Averages.
[nodes.mean]
type = "smooth"
inputs = { image = "b.image" }
params = { past_weight = 100 } # of 256

[nodes.sink]
type = "drain"
inputs = { image = "mean.image" }
"#;

/// The window.
pub struct Window {
    pub harness: Harness<'static, Option<App>>,
    pub textures: panoscope_editor_widgets::golden::Textures,
}

impl Window {
    /// Opens a graph file.
    pub fn open(path: &Path) -> Self {
        Self::open_with(path, Options::default())
    }

    /// Opens a graph file in a window with options.
    pub fn open_with(path: &Path, options: Options) -> Self {
        let path = path.to_owned();
        let draw = move |ui: &mut Ui, app: &mut Option<App>| {
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            let app = app.get_or_insert_with(|| App::open(ui.ctx(), &path, &text, options.clone()).expect("threads"));
            app.ui(ui);
        };
        let textures = panoscope_editor_widgets::golden::Textures::default();
        let builder = Harness::builder().with_size(vec2(1440.0, 900.0)).renderer(textures.clone());
        Self { harness: builder.build_ui_state(draw, None), textures }
    }

    /// Opens a graph file and waits until it runs.
    pub fn run(path: &Path) -> Self {
        let mut window = Self::open(path);
        window.until("it runs", |app| app.session().status().phase == Phase::Running);
        window
    }

    pub fn app(&self) -> &App {
        self.harness.state().as_ref().expect("the window is open")
    }

    /// Draws frames until a condition holds.
    pub fn until(&mut self, what: &str, holds: impl Fn(&App) -> bool) {
        let until = Instant::now() + PATIENCE;
        loop {
            self.harness.step();
            if holds(self.app()) {
                return;
            }
            let status = self.app().session().status();
            assert!(Instant::now() < until, "waited for: {what}\n{status:#?}\n{}", self.app().document().text());
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Draws frames until a widget of this name is shown.
    pub fn until_shown(&mut self, label: &str) {
        let until = Instant::now() + PATIENCE;
        while self.harness.query_by_label_contains(label).is_none() {
            assert!(Instant::now() < until, "nothing is called `{label}`");
            self.harness.step();
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Clicks a button until a widget of this name is shown, because a click has no effect in a frame in which the panel moves.
    pub fn click_until_shown(&mut self, button: &str, label: &str) {
        let until = Instant::now() + PATIENCE;
        while self.harness.query_by_label_contains(label).is_none() {
            assert!(Instant::now() < until, "a click on `{button}` shows nothing that is called `{label}`");
            self.harness.get_by_label(button).click_accesskit();
            for _ in 0..50 {
                self.harness.step();
                if self.harness.query_by_label_contains(label).is_some() {
                    return;
                }
                std::thread::sleep(Duration::from_millis(10));
            }
        }
    }

    pub fn key(&mut self, modifiers: Modifiers, key: Key) {
        self.harness.key_press_modifiers(modifiers, key);
        self.steps(2);
    }

    pub fn type_text(&mut self, text: &str) {
        self.harness.get_by_label("Palette").type_text(text);
        self.steps(2);
    }

    pub fn steps(&mut self, count: usize) {
        (0..count).for_each(|_| self.harness.step());
    }

    /// Selects a node without a pointer, as a screen reader does.
    pub fn select(&mut self, id: &str) {
        self.harness.get_by_label(&format!("Node {id}")).click_accesskit();
        self.steps(2);
        assert_eq!(self.app().selected().as_deref(), Some(id));
    }

    /// Drags from one named widget to another.
    pub fn drag(&mut self, from: &str, to: &str) {
        let at = |label: &str| self.harness.get_by_label(label).rect().center();
        let (from, to) = (at(from), at(to));
        input::drag(&mut self.harness, from, to);
    }

    /// Waits until the text of the document runs.
    pub fn settled(&mut self) {
        self.until("the text runs", |app| {
            let status = app.session().status();
            !status.busy && *status.running == **app.document().runnable()
        });
    }

    /// All texts that the last frame drew, as they stand on the screen: shortened ones end with an ellipsis.
    pub fn painted(&self) -> Vec<String> {
        self.painted_at().into_iter().map(|(text, _)| text).collect()
    }

    /// As [`Self::painted`], each with its rectangle in the window.
    pub fn painted_at(&self) -> Vec<(String, Rect)> {
        fn collect(shape: &Shape, found: &mut Vec<(String, Rect)>) {
            match shape {
                Shape::Vec(shapes) => shapes.iter().for_each(|shape| collect(shape, found)),
                Shape::Text(text) => {
                    let rows = text.galley.rows.iter().map(|row| row.glyphs.iter().map(|g| g.chr).collect::<String>());
                    found.push((rows.collect::<Vec<_>>().join(" "), text.visual_bounding_rect()));
                }
                _ => {}
            }
        }
        let mut found = Vec::new();
        self.harness.output().shapes.iter().for_each(|clipped| collect(&clipped.shape, &mut found));
        found
    }

    /// Draws frames until a text is on the screen.
    pub fn until_painted(&mut self, text: &str) {
        let until = Instant::now() + PATIENCE;
        while !self.painted().iter().any(|painted| painted.contains(text)) {
            assert!(Instant::now() < until, "`{text}` is not drawn: {:#?}", self.painted());
            self.harness.step();
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Names of the nodes that run.
    pub fn running(&self) -> Vec<String> {
        let engine = self.app().session().handle().engine().expect("it runs");
        engine.graph().nodes.into_iter().map(|n| n.id).collect()
    }

    /// Ends the run and finishes its files, as closing the window does.
    pub fn close(mut self) -> panoscope_engine::Report {
        self.until("some ticks have come through", |app| {
            let engine = app.session().handle().engine().expect("it runs");
            engine.report().nodes["kept"].count > 20
        });
        let engine = self.app().session().handle().engine().expect("it ran");
        drop(self);
        engine.report()
    }
}

/// Asserts that the first path of [`GRAPH`] lost no tick: every tick is recorded, none was dropped.
pub fn nothing_lost(folder: &Folder, report: &panoscope_engine::Report) {
    let text = std::fs::read_to_string(folder.0.join("kept.jsonl")).expect("the ledger was written");
    let seqs: Vec<u64> = text
        .lines()
        .filter_map(|line| line.split("\"seq\":").nth(1)?.split([',', '}']).next()?.trim().parse().ok())
        .collect();
    assert!(seqs.len() > 10, "{} ticks", seqs.len());
    assert_eq!(report.nodes["a"].dropped + report.nodes["kept"].dropped, 0);
    assert!(seqs.iter().enumerate().all(|(i, seq)| *seq == i as u64), "a tick is missing");
}
