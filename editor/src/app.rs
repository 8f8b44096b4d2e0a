//! The window: what is shown where, and how touches become changes of the graph.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{self, CentralPanel, Context, Frame, Margin, Panel, RichText, Ui};
use panoscope_graph::GraphText;

use crate::actions::{self, Action};
use crate::canvas::{Ask, Canvas, Scene, is_pictorial};
use crate::disk::{self, DiskWatch};
use crate::document::Document;
use crate::observe::{Observer, Output, Wanted};
use crate::ops::{self, Detour};
use crate::panels::Shown;
use crate::panels::inspector::{self, Wish};
use crate::panels::top::{self, Switches};
use crate::session::{Phase, Session, Status};
use crate::theme;
use crate::viewer::Viewer;

/// Pixels across of a thumbnail; enough for a sharp one at zoom 1 and double density.
const THUMBNAIL: usize = 416;
/// Pixels across of the big picture.
const LARGE: usize = 2048;
/// How long a note stays.
const NOTE: Duration = Duration::from_secs(6);

/// How the window is opened.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Most ticks of each source.
    pub frames: Option<u64>,
    /// Size of everything; 0 leaves it as it is.
    pub scale: f32,
    /// File of a screenshot, and the seconds until it is taken.
    pub screenshot: Option<(PathBuf, f64)>,
    /// What is done before the screenshot.
    pub script: Vec<String>,
}

/// Why the window did not open.
#[derive(Debug, thiserror::Error)]
#[error("no thread could be started: {0}")]
pub struct OpenError(#[from] std::io::Error);

/// The window.
pub struct App {
    pub(crate) session: Session,
    pub(crate) observer: Observer,
    pub(crate) document: Document,
    pub(crate) canvas: Canvas,
    pub(crate) shown: Shown,
    pub(crate) viewer: Option<Viewer>,
    pub(crate) switches: Switches,
    pub(crate) detours: HashMap<String, Vec<Detour>>,
    disk: DiskWatch,
    /// The file's new text, when it and ours have both changed.
    conflict: Option<String>,
    note: Option<(String, bool, Instant)>,
    asked: u64,
    options: Options,
    start: Instant,
    /// CPU time of the window's thread, ms, and frames drawn.
    pub(crate) cost: (f64, u64),
}

impl App {
    /// Opens a graph file whose text was read, and sets it going if it is right.
    ///
    /// # Errors
    /// The system gave no thread.
    pub fn open(ctx: &Context, path: &Path, text: &str, options: Options) -> Result<Self, OpenError> {
        theme::apply(ctx);
        if options.scale > 0.0 {
            ctx.set_zoom_factor(options.scale);
        }
        let paths = GraphText::parse(path, text).plugin_paths();
        let session = Session::new(path, &paths, options.frames)?;
        let for_wake = ctx.clone();
        session.set_wake(Arc::new(move || for_wake.request_repaint()));
        let observer = Observer::new(session.handle())?;
        let document = Document::new(path, text, session.loader());
        if document.view().right {
            session.run(text);
        }
        Ok(Self {
            observer,
            document,
            canvas: Canvas::default(),
            shown: Shown::default(),
            viewer: None,
            switches: Switches::default(),
            detours: HashMap::new(),
            disk: DiskWatch::new(path),
            conflict: None,
            note: None,
            asked: 1,
            options,
            start: Instant::now(),
            cost: (0.0, 0),
            session,
        })
    }

    /// The document.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// The session.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// The canvas.
    pub fn canvas(&self) -> &Canvas {
        &self.canvas
    }

    /// The output that is shown large.
    pub fn viewed(&self) -> Option<&Output> {
        self.viewer.as_ref().map(|v| &v.output)
    }

    /// Mean CPU time of the window's thread per frame in ms, and frames drawn so far.
    pub fn cost(&self) -> (f64, u64) {
        (self.cost.0 / self.cost.1.max(1) as f64, self.cost.1)
    }

    /// Tells the user something for a while.
    pub(crate) fn tell(&mut self, words: impl Into<String>, wrong: bool) {
        self.note = Some((words.into(), wrong, Instant::now()));
    }

    pub(crate) fn try_edit<T, E: std::fmt::Display>(&mut self, result: Result<T, E>) -> Option<T> {
        result.map_err(|e| self.tell(e.to_string(), true)).ok()
    }

    /// Asks the session to run a text that is new and right.
    fn follow(&mut self) {
        if self.asked != self.document.revision() {
            self.asked = self.document.revision();
            if self.document.view().right {
                self.session.run(self.document.text());
            }
        }
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        let began = thread_cpu_ms();
        let ctx = ui.ctx().clone();
        let status = self.session.status();
        self.document.set_loader(self.session.loader());
        self.shown.update(&ctx, self.observer.take());
        if let Some(text) = self.disk.look() {
            self.changed_on_disk(text);
        }
        let typing = ctx.text_edit_focused();
        for action in ctx.input_mut(|input| actions::pressed(input, typing)) {
            self.act(action);
        }
        if ctx.input(|i| i.pointer.any_released()) {
            self.document.end_merge();
        }
        self.panels(ui, &status);
        self.notes(&ctx);
        self.follow();
        self.want();
        ctx.request_repaint_after(DiskWatch::INTERVAL);
        self.picture_of_window(&ctx);
        self.cost.0 += thread_cpu_ms() - began;
        self.cost.1 += 1;
    }

    fn panels(&mut self, ui: &mut Ui, status: &Status) {
        let counters = self.observer.counters();
        let bar = Frame::new().fill(theme::PANEL).inner_margin(Margin::symmetric(16, 8));
        let asked = Panel::top("top")
            .frame(bar)
            .exact_size(44.0)
            .show(ui, |ui| top::show(ui, &self.document, status, &counters, self.switches));
        asked.inner.into_iter().for_each(|action| self.act(action));
        self.conflict_bar(ui);
        let view = self.document.view().clone();
        let selected = self.selected();
        let side = Frame::new().fill(theme::PANEL).inner_margin(Margin::same(16));
        if let Some(node) = selected.as_deref().and_then(|id| view.node(id)) {
            let wishes = Panel::right("inspector")
                .frame(side)
                .default_size(320.0)
                .size_range(260.0..=520.0)
                .show(ui, |ui| inspector::show(ui, &self.document, &counters, &self.shown, &self.canvas, node));
            let id = view.nodes[node].id().to_owned();
            wishes.inner.into_iter().for_each(|wish| self.grant(&id, wish));
        }
        let view = self.document.view().clone();
        let trouble = status.trouble.as_ref().and_then(|t| Some((t.node.as_deref()?, t.words.as_str())));
        CentralPanel::no_frame().show(ui, |ui| {
            let scene = Scene {
                view: &view,
                counters: &counters,
                shown: &self.shown,
                heat: self.switches.heat,
                running: status.phase == Phase::Running,
                trouble,
            };
            let rect = ui.available_rect_before_wrap();
            if let Some(viewer) = &mut self.viewer {
                ui.allocate_rect(rect, egui::Sense::hover());
                if !viewer.show(ui, rect, &self.shown) {
                    self.viewer = None;
                }
                return;
            }
            let asks = self.canvas.show(ui, &scene, self.document.revision());
            asks.into_iter().for_each(|ask| self.answer(ask));
        });
    }

    fn selected(&self) -> Option<String> {
        let mut selected = self.canvas.selected.iter();
        selected.next().filter(|_| selected.next().is_none()).cloned()
    }

    /// Does what the canvas asks for.
    fn answer(&mut self, ask: Ask) {
        let doc = &mut self.document;
        match ask {
            Ask::Wire { output, input, moved } => {
                let from = Output::new(&output.node, &output.port);
                let moved = moved.as_ref().map(|(end, index)| (end.node.as_str(), end.port.as_str(), *index));
                let result = ops::wire(doc, &from, (&input.node, &input.port), None, moved);
                self.try_edit(result);
            }
            Ask::Unwire { input, index } => {
                let result = ops::unwire(doc, &input.node, &input.port, index);
                self.try_edit(result);
            }
            Ask::Move(places) => {
                let places: Vec<_> = places.into_iter().map(|(id, at)| (id, (at.x, at.y))).collect();
                let result = ops::move_nodes(doc, &places);
                self.try_edit(result);
            }
            Ask::Insert { node, wire } => {
                let result = ops::insert(doc, &node, (&wire.0, &wire.1, wire.2));
                self.try_edit(result);
            }
            Ask::Look(output) => self.look_at(output),
            Ask::Add { .. } => {}
            Ask::Tell(words) => self.tell(words, true),
        }
    }

    /// Does what the inspector asks for.
    fn grant(&mut self, node: &str, wish: Wish) {
        let doc = &mut self.document;
        match wish {
            Wish::Param(change) => {
                let result = ops::set_param(doc, node, &change.param, change.value.as_ref());
                self.try_edit(result);
            }
            Wish::Input { input, index, from: Some(from) } => {
                let result = ops::wire(doc, &from, (node, &input), Some(index), None);
                self.try_edit(result);
            }
            Wish::Input { input, index, from: None } => {
                let result = ops::unwire(doc, node, &input, index);
                self.try_edit(result);
            }
            Wish::Look(output) => self.look_at(output),
            Wish::Thumbnail(port) => self.canvas.choose_output(node, &port),
            Wish::Rename(name) => {
                let result = ops::rename(doc, node, &name);
                if self.try_edit(result).is_some() {
                    self.canvas.select_only(&name);
                }
            }
        }
    }

    /// Shows an output large.
    pub(crate) fn look_at(&mut self, output: Output) {
        let view = self.document.view();
        let packet = view.node(&output.node).and_then(|n| view.packet(n, &output.port)).map(|p| p.name.clone());
        self.viewer = Some(Viewer { output, packet: packet.unwrap_or_default() });
    }

    /// Does an action.
    pub fn act(&mut self, action: Action) {
        match action {
            Action::Undo => {
                if let Some(label) = self.document.undo() {
                    self.tell(format!("undone: {label}"), false);
                }
            }
            Action::Redo => {
                if let Some(label) = self.document.redo() {
                    self.tell(format!("done again: {label}"), false);
                }
            }
            Action::Save => self.save(),
            Action::Fit => self.canvas.fit(),
            Action::ZoomIn => self.canvas.zoom_by(2),
            Action::ZoomOut => self.canvas.zoom_by(-2),
            Action::Delete => self.delete(),
            Action::Duplicate => self.duplicate(),
            Action::Bypass => self.bypass(),
            Action::SelectAll => {
                self.canvas.selected = self.document.view().nodes.iter().map(|n| n.id().to_owned()).collect();
            }
            Action::Next => self.next(),
            Action::View => self.view(),
            Action::Heat => self.switches.heat ^= true,
            Action::Text => self.switches.text ^= true,
            Action::Plots => self.switches.plots ^= true,
            Action::Problems => self.switches.problems ^= true,
            Action::Restart => self.session.restart(self.document.text()),
            Action::Reload => self.session.reload_plugins(),
            Action::Escape => {
                if self.viewer.take().is_none() {
                    self.canvas.selected.clear();
                    self.canvas.selected_wire = None;
                }
            }
            Action::Add | Action::Connect | Action::Find | Action::Help => {}
        }
    }

    fn view(&mut self) {
        if self.viewer.take().is_some() {
            return;
        }
        let view = self.document.view().clone();
        let of_selected = || {
            let node = self.canvas.selected.iter().next().and_then(|id| view.node(id))?;
            Some(self.canvas.shown_output(&view, node)?.0)
        };
        if let Some(output) = self.canvas.under_pointer.clone().or_else(of_selected) {
            self.look_at(output);
        }
    }

    fn next(&mut self) {
        let view = self.document.view().clone();
        let now = self.canvas.selected.iter().next_back().and_then(|id| view.node(id));
        let next = now.map_or(0, |n| (n + 1) % view.nodes.len().max(1));
        if let Some(node) = view.nodes.get(next) {
            self.canvas.select_only(node.id());
        }
    }

    fn delete(&mut self) {
        if let Some((node, input, index)) = self.canvas.selected_wire.take() {
            let result = ops::unwire(&mut self.document, &node, &input, index);
            self.try_edit(result);
            return;
        }
        let nodes: Vec<String> = self.canvas.selected.iter().cloned().collect();
        if !nodes.is_empty() {
            let result = ops::remove(&mut self.document, &nodes);
            self.try_edit(result);
        }
    }

    fn duplicate(&mut self) {
        let canvas = &self.canvas;
        let nodes: Vec<(String, (f32, f32))> =
            canvas.selected.iter().filter_map(|id| canvas.place(id).map(|at| (id.clone(), (at.x, at.y)))).collect();
        if nodes.is_empty() {
            return;
        }
        let result = ops::duplicate(&mut self.document, &nodes);
        if let Some(copies) = self.try_edit(result) {
            self.canvas.selected = copies.into_iter().collect();
        }
    }

    fn bypass(&mut self) {
        for id in self.canvas.selected.clone() {
            match self.detours.remove(&id) {
                Some(detours) => {
                    let result = ops::end_bypass(&mut self.document, &id, &detours);
                    self.try_edit(result);
                }
                None => {
                    let result = ops::bypass(&mut self.document, &id);
                    if let Some(detours) = self.try_edit(result) {
                        self.tell(format!("{id} is bypassed"), false);
                        self.detours.insert(id, detours);
                    }
                }
            }
        }
    }

    fn save(&mut self) {
        // Someone else's text is not overwritten unseen.
        if let Ok(text) = std::fs::read_to_string(self.document.path())
            && text != **self.document.saved()
            && text != **self.document.text()
        {
            self.conflict = Some(text);
            return;
        }
        let text = Arc::clone(self.document.text());
        let result = disk::save(self.document.path(), &text);
        if self.try_edit(result).is_some() {
            self.disk.settle();
            self.document.now_saved(&text);
            self.tell("saved", false);
        }
    }

    fn changed_on_disk(&mut self, text: String) {
        if text == **self.document.saved() {
            return;
        }
        if self.document.is_changed() && text != **self.document.text() {
            self.conflict = Some(text);
            return;
        }
        self.document.set_text(&text, "change on disk", None);
        self.document.now_saved(&text);
        self.tell("the file changed on disk and was read again; undo brings the old text back", false);
    }

    fn conflict_bar(&mut self, ui: &mut Ui) {
        if self.conflict.is_none() {
            return;
        }
        let frame = Frame::new().fill(theme::WARN.gamma_multiply(0.18)).inner_margin(Margin::symmetric(16, 8));
        Panel::top("conflict").frame(frame).show(ui, |ui| {
            ui.horizontal(|ui| {
                ui.label("The file was changed on disk, and so was the graph here.");
                let theirs = ui.button("Take the file's").on_hover_text("Undo brings the graph of this window back");
                let ours = ui
                    .button("Keep this one")
                    .on_hover_text("The next save replaces the file; its text is kept as a backup");
                if theirs.clicked()
                    && let Some(text) = self.conflict.take()
                {
                    self.document.set_text(&text, "take the file's text", None);
                    self.document.now_saved(&text);
                } else if ours.clicked()
                    && let Some(text) = self.conflict.take()
                {
                    self.document.now_saved(&text);
                }
            });
        });
    }

    /// What was told last, at the lower edge; never over a picture's middle.
    fn notes(&mut self, ctx: &Context) {
        let Some((words, wrong, since)) = &self.note else { return };
        if since.elapsed() > NOTE {
            self.note = None;
            return;
        }
        ctx.request_repaint_after(NOTE.saturating_sub(since.elapsed()));
        let color = if *wrong { theme::FAULT } else { theme::LINE };
        egui::Area::new("note".into())
            .anchor(egui::Align2::LEFT_BOTTOM, egui::vec2(16.0, -16.0))
            .interactable(false)
            .show(ctx, |ui| {
                Frame::new()
                    .fill(theme::PANEL)
                    .stroke(egui::Stroke::new(1.0, color))
                    .corner_radius(6.0)
                    .inner_margin(Margin::symmetric(12, 8))
                    .show(ui, |ui| {
                        ui.add(egui::Label::new(RichText::new(words)).wrap_mode(egui::TextWrapMode::Extend))
                    });
            });
    }

    /// Tells the observer what can be seen.
    fn want(&mut self) {
        let mut wanted: HashMap<Output, Wanted> = HashMap::new();
        let mut want = |output: &Output, packet: &str, most_width: usize| {
            let entry = wanted.entry(output.clone()).or_insert(Wanted { packet: packet.to_owned(), most_width });
            entry.most_width = entry.most_width.max(most_width);
        };
        match &self.viewer {
            Some(viewer) => want(&viewer.output, &viewer.packet, LARGE),
            None => self.canvas.visible().for_each(|(output, packet)| want(output, packet, THUMBNAIL)),
        }
        if let Some(node) = self.selected().and_then(|id| self.document.view().node(&id))
            && let Some((output, packet)) = self.canvas.shown_output(self.document.view(), node)
        {
            want(&output, &packet, if is_pictorial(&packet) { THUMBNAIL } else { 1 });
        }
        let outputs: HashSet<Output> = wanted.keys().cloned().collect();
        self.shown.keep(|output| outputs.contains(output));
        self.observer.want(wanted);
    }

    fn picture_of_window(&mut self, ctx: &Context) {
        let Some((file, after)) = self.options.screenshot.clone() else { return };
        let elapsed = self.start.elapsed().as_secs_f64();
        if elapsed > after * 0.4 && !self.options.script.is_empty() {
            let script = std::mem::take(&mut self.options.script);
            script.iter().for_each(|step| self.play(step));
        }
        let taken = ctx.input(|i| {
            i.events.iter().find_map(|e| match e {
                egui::Event::Screenshot { image, .. } => Some(Arc::clone(image)),
                _ => None,
            })
        });
        if let Some(image) = taken {
            let rgb: Vec<u8> = image.pixels.iter().flat_map(|p| [p.r(), p.g(), p.b()]).collect();
            let [width, height] = image.size.map(|n| n as u32);
            let saved = image::RgbImage::from_raw(width, height, rgb).map(|picture| picture.save(&file));
            match saved {
                Some(Ok(())) => println!("{}", file.display()),
                Some(Err(error)) => eprintln!("error: {} was not written: {error}", file.display()),
                None => eprintln!("error: the window gave no picture"),
            }
            let (ms, frames) = self.cost();
            println!("ui {ms:.2} ms per frame, {frames} frames in {elapsed:.1} s");
            self.options.screenshot = None;
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        } else if elapsed > after {
            ctx.send_viewport_cmd(egui::ViewportCommand::Screenshot(egui::UserData::default()));
            ctx.request_repaint_after(Duration::from_millis(200));
        } else {
            ctx.request_repaint_after(Duration::from_millis(100));
        }
    }

    /// One step of a script: `select:NODE`, `view:NODE.PORT`, `heat`, ...
    fn play(&mut self, step: &str) {
        let (word, rest) = step.split_once(':').unwrap_or((step, ""));
        match word {
            "select" => self.canvas.select_only(rest),
            "view" => {
                if let Some((node, port)) = rest.split_once('.') {
                    self.look_at(Output::new(node, port));
                }
            }
            _ => {
                let named = actions::ALL.iter().find(|(a, ..)| format!("{a:?}").eq_ignore_ascii_case(word));
                match named {
                    Some((action, ..)) => self.act(*action),
                    None => self.tell(format!("there is no action `{word}`"), true),
                }
            }
        }
    }
}

impl eframe::App for App {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        Self::ui(self, ui);
    }

    fn on_exit(&mut self, _: Option<&eframe::glow::Context>) {
        self.session.close();
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}

/// CPU time of this thread in ms.
fn thread_cpu_ms() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: fills the struct that it is given.
    let answer = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    if answer == 0 { time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6 } else { 0.0 }
}
