//! The theatre on running graphs, without a screen.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use eframe::egui::{Key, Modifiers, Ui, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::session::Phase;
use panoscope_graph::GraphOptions;
use panoscope_theatre::{Guard, Options, Program, Theatre};

use super::{Folder, PATIENCE};
use panoscope_editor_widgets::golden::Textures;

/// A camera, two stages, a setting.
pub const GRAPH: &str = r#"# Seen by a surgeon.
name = "case"
plugins = ["flow", "fixtures"]

[nodes.camera]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 30.0 }

[nodes.calm]
type = "smooth"
inputs = { image = "camera.image" }
params = { past_weight = 100 }

[nodes.sink]
type = "drain"
inputs = { image = "calm.image" }

[preset]
views = [{ from = "calm.image", label = "calm view" }, "camera.image"]
pinned = [{ param = "calm.past_weight", range = [50, 150], label = "calmness" }]
"#;

/// The window.
pub struct Window {
    pub harness: Harness<'static, Option<Theatre>>,
    pub folder: Folder,
    pub textures: Textures,
    pub guard: Option<Guard>,
}

/// Options that write stills and clips to the test's folder.
pub fn options(folder: &Folder) -> Options {
    Options { folder: folder.0.join("kept"), ..Options::default() }
}

impl Window {
    /// Writes a graph, opens it and waits until it runs.
    pub fn open(name: &str, text: &str) -> Self {
        let folder = Folder::new(name);
        let path = folder.write("g.toml", text);
        let options = options(&folder);
        let mut window = Self::open_with(folder, &path, options);
        window.until("it runs", |t| t.session().expect("it runs here").status().phase == Phase::Running);
        window
    }

    /// Opens a graph file with options.
    pub fn open_with(folder: Folder, path: &Path, options: Options) -> Self {
        let path: PathBuf = path.to_owned();
        let draw = move |ui: &mut Ui, theatre: &mut Option<Theatre>| {
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            let open = || Theatre::open(ui.ctx(), &path, &text, options.clone()).expect("it opens");
            theatre.get_or_insert_with(open).ui(ui);
        };
        let textures = Textures::default();
        let builder = Harness::builder().with_size(vec2(1440.0, 960.0)).renderer(textures.clone());
        Self { harness: builder.build_ui_state(draw, None), folder, textures, guard: None }
    }

    /// Writes a graph and opens it in a process that the window guards; waits until a picture is there.
    pub fn guarded(name: &str, text: &str) -> Self {
        let folder = Folder::new(name);
        let options = options(&folder);
        Self::guarded_with(folder, text, options)
    }

    /// As [`Self::guarded`], with options.
    pub fn guarded_with(folder: Folder, text: &str, options: Options) -> Self {
        Self::guarded_as(folder, text, options, &[])
    }

    /// As [`Self::guarded_with`], with more arguments for the process that runs the graph.
    pub fn guarded_as(folder: Folder, text: &str, options: Options, more: &[&str]) -> Self {
        let path = folder.write("g.toml", text);
        let program = Program {
            file: env!("CARGO_BIN_EXE_panoscope-theatre").into(),
            arguments: [path.clone().into(), "--into".into(), folder.0.join("kept").into()]
                .into_iter()
                .chain(more.iter().map(|word| (*word).into()))
                .collect(),
        };
        let guard = Guard::new(program, path.clone()).expect("a thread");
        let given = GraphOptions::default();
        guard.prepare(text, &given);
        let opened = guard.wait_prepared().unwrap_or_else(|refusal| panic!("{}", refusal.terminal_text()));
        let (handle, text) = (guard.clone(), text.to_owned());
        let mut opened = Some(opened);
        let draw = move |ui: &mut Ui, theatre: &mut Option<Theatre>| {
            let open = || {
                let opened = opened.take().expect("it is opened once");
                let (guard, options) = (handle.clone(), options.clone());
                Theatre::guarded(ui.ctx(), &path, (&text, &given), options, opened, guard).expect("threads")
            };
            theatre.get_or_insert_with(open).ui(ui);
        };
        let textures = Textures::default();
        let builder = Harness::builder().with_size(vec2(1440.0, 960.0)).renderer(textures.clone());
        let mut window = Self { harness: builder.build_ui_state(draw, None), folder, textures, guard: Some(guard) };
        window.until("a picture", Theatre::has_picture);
        window
    }

    /// Number of the process that runs the graph.
    pub fn worker(&self) -> i32 {
        self.guard.as_ref().and_then(|guard| guard.processes().0).expect("it runs")
    }

    /// Waits until a second process is ready to take over; returns its number.
    pub fn until_spare(&mut self) -> i32 {
        let guard = self.guard.clone().expect("it is guarded");
        self.until("a second process waits", |_| guard.processes().1.is_some());
        guard.processes().1.expect("it waits")
    }

    pub fn theatre(&self) -> &Theatre {
        self.harness.state().as_ref().expect("it is open")
    }

    /// Draws frames until a condition holds.
    pub fn until(&mut self, what: &str, holds: impl Fn(&Theatre) -> bool) {
        let until = Instant::now() + PATIENCE;
        self.harness.step();
        while !holds(self.theatre()) {
            let (notices, checks) = (self.theatre().notices(), self.theatre().checklist());
            assert!(Instant::now() < until, "not in time: {what}; notices: {notices:?}; checklist: {checks:?}");
            std::thread::sleep(Duration::from_millis(15));
            self.harness.step();
        }
    }

    /// Draws frames until a notice with this text is shown.
    pub fn until_notice(&mut self, message: &str) {
        self.until(message, |t| t.notices().iter().any(|n| n.message.contains(message)));
    }

    /// Draws frames until a widget of this name is shown.
    pub fn until_shown(&mut self, label: &str) {
        let until = Instant::now() + PATIENCE;
        while self.harness.query_by_label_contains(label).is_none() {
            assert!(Instant::now() < until, "nothing is called `{label}`");
            std::thread::sleep(Duration::from_millis(15));
            self.harness.step();
        }
    }

    pub fn key(&mut self, key: Key) {
        self.harness.key_press_modifiers(Modifiers::NONE, key);
        self.harness.step();
        self.harness.step();
    }

    pub fn click(&mut self, label: &str) {
        self.harness.get_by_label(label).click();
        self.harness.step();
        self.harness.step();
    }

    /// Names of the files in the folder for stills and clips.
    pub fn kept(&self) -> Vec<String> {
        let files = std::fs::read_dir(self.folder.0.join("kept")).into_iter().flatten().flatten();
        let names = files.map(|f| f.file_name().to_string_lossy().into_owned());
        // A run locks its files against other runs until it ends.
        let mut names: Vec<String> = names.filter(|name| !name.ends_with(".lock")).collect();
        names.sort();
        names
    }

    pub fn notices(&self) -> Vec<String> {
        self.theatre().notices().iter().map(|n| n.message.clone()).collect()
    }
}
