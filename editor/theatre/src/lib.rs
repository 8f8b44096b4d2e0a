//! The theatre: a surgeon's window on a running graph. Full screen, dark, with large type; it shows images, notices and only the settings that
//! the preset offers. Nothing covers the middle of an image: notices are above, buttons below, and the live image beside a frozen one is in
//! a corner.
//!
//! The camera's own image stays visible whatever fails: it replaces a view that stops, and if the graph cannot run, its sources are started
//! alone.

mod actions;
mod alarms;
mod arm;
mod arrange;
mod attached;
mod audit;
mod bars;
#[cfg(test)]
mod campaign;
mod checklist;
mod guard;
mod link;
mod lost;
mod marks;
mod measure;
mod notices;
mod open;
mod open_failed;
mod opening;
mod outage;
mod page;
mod pedal;
mod plan;
mod previews;
mod recording;
mod refusal;
mod runner;
mod script;
mod settings;
mod sinks;
mod stage;
mod storage;
mod three_d;
mod time;
mod wiring;
pub mod worker;
mod zoom;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{self, Context, InputState, Key, Rect, Ui, pos2, vec2};
use panoscope_editor_model::texts::text;
use panoscope_graph::edit::GraphEdit;
use panoscope_graph::{GraphOptions, ParamValue};
use panoscope_imaging::composition::Composition;

use panoscope_editor_model::content::Rig;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::session::Session;
use panoscope_editor_model::surface::Viewpoint;
use panoscope_editor_widgets::OutputCache;
use panoscope_editor_widgets::theme;
use panoscope_editor_widgets::{Costs, Shot};

pub use actions::{Action, key_name};
pub use alarms::{ALL as ALARMS, Alarm, Urgency};
pub use arrange::Layout;
pub use attached::MachineFacts;
pub use guard::{Guard, Program};
pub use measure::{Length, Tapped};
pub use notices::Notice;
pub use open::{OpenError, Opened, Options, Ready, Verified};
pub use open_failed::OpenFailed;
pub use opening::Opening;
pub use plan::{Listens, Pane, Plan, Setting};
pub use refusal::Refusal;
pub use runner::{Outage, OutageStage};
pub use storage::{free_bytes, with_clip, without_clip, write_still};
pub use three_d::ThreeD;

use audit::Audit;
pub use checklist::{Check, State};
use measure::Measure;
use notices::{Doubts, Facts, Stages};
use outage::Resuming;
use pedal::Pedal;
use previews::{LastPacket, Repeats};
use runner::{Local, Runner};
use settings::toml_of;
use sinks::SinkFiles;
use storage::{Clip, Storage};
use three_d::Pair;
use zoom::Zoom;

/// How long Esc must be held to close the window, and the stop to release the arm.
const HOLD: Duration = Duration::from_secs(2);
/// How long a remark is shown.
const REMARK: Duration = Duration::from_secs(5);
const TOP: f32 = 108.0;
const BOTTOM: f32 = 104.0;
const EDGE: f32 = 20.0;
/// Height of the window in points that the sizes are designed for.
const REFERENCE_HEIGHT_PT: f32 = 960.0;
/// Minimum width in points that all buttons need.
const MIN_WIDTH_PT: f32 = 1180.0;

/// The window.
pub struct Theatre {
    plan: Plan,
    path: PathBuf,
    runner: Box<dyn Runner>,
    /// The machine that runs the graph, if it is another one.
    machine: Option<attached::Machine>,
    /// Text of the whole graph: the file's, with the current settings and clip.
    text: String,
    /// The reason why only the sources run; `None` while the whole graph runs.
    raw_only: Option<String>,
    /// Which camera's image is the raw view: an index into those of the plan.
    raw_camera: usize,
    shown: OutputCache,
    /// Previews of the raw view, which continues while the other views are frozen.
    live: OutputCache,
    last_packets: HashMap<Output, LastPacket>,
    /// The packets of [`Self::shown`]: not newer than the last ones.
    shown_packets: HashMap<Output, LastPacket>,
    /// How often each camera has sent its last image.
    repeats: HashMap<Output, Repeats>,
    /// Silent cameras that faults have named.
    named_lost: Vec<Output>,
    /// Since when each output is requested without a break.
    requested: HashMap<Output, Instant>,
    running_since: Option<Instant>,
    /// Since when nodes are opened, until they run.
    starting_since: Option<Instant>,
    layout: Layout,
    frozen: Option<Instant>,
    measure: Measure,
    /// Stereo geometry of the points that are measured.
    rig: Option<Rig>,
    viewpoints: HashMap<Output, Viewpoint>,
    /// Where the views are while all of them are shown.
    composition: Composition,
    storage: Storage,
    clip: Option<Clip>,
    sink_files: SinkFiles,
    emergency: bool,
    /// Settings that were changed in this window, by node and parameter.
    chosen: HashMap<(String, String), ParamValue>,
    /// Visible page of the settings.
    page: usize,
    /// Whether the checklist is shown, and its lines.
    checking: bool,
    checks: Vec<Check>,
    stages: Stages,
    doubts: Doubts,
    notices: Vec<Notice>,
    remark: Option<(String, bool, Instant)>,
    /// Since when Esc is held.
    leaving: Option<Instant>,
    /// Whether the press that released the arm still lasts.
    has_released: bool,
    /// Whether the button that ends the theatre was held in the last frame.
    end_held: bool,
    /// Since when the stop is held to release the arm.
    releasing: Option<Instant>,
    verified: Verified,
    audit: Audit,
    /// Whether the graph may read only the files of its lock.
    sealed: bool,
    resuming: Resuming,
    scale: f32,
    /// The visible part of the main view, and whether another view is in its corner.
    zoom: Zoom,
    inset: bool,
    three_d: ThreeD,
    pair: Pair,
    pedal: Pedal,
    closing: bool,
    shot: Shot,
    costs: Costs,
}

impl Theatre {
    /// Opens a window on the graph file at `path` with its text: compares it with its lock and starts it in this process. A refusal is logged,
    /// too.
    ///
    /// # Errors
    /// See [`OpenError`]; nothing is started.
    pub fn open(ctx: &Context, path: &Path, text: &str, options: Options) -> Result<Self, OpenError> {
        let ready = Ready::check(path, text, &options)
            .inspect_err(|error| options.log_refusal(path, &Refusal::of(path, error)))?;
        Self::of(ctx, path, options, ready)
    }

    /// As [`Self::open`], for a graph that was checked already.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn of(ctx: &Context, path: &Path, options: Options, ready: Ready) -> Result<Self, OpenError> {
        let for_wake = ctx.clone();
        let wake = Arc::new(move || for_wake.request_repaint());
        let local = Local::new(path, ready.loader, ready.seal, options.frames, wake)?;
        Self::show(ctx, path, options, ready.opened, Box::new(local))
    }

    /// Opens a window on a graph that a guarded process has prepared from the text `file` of the graph file, with the arguments `given`.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn guarded(
        ctx: &Context,
        path: &Path,
        (file, given): (&str, &GraphOptions),
        options: Options,
        opened: Opened,
        guard: Guard,
    ) -> Result<Self, OpenError> {
        let for_wake = ctx.clone();
        guard.set_wake(Arc::new(move || for_wake.request_repaint()));
        guard.begin(file, given, &opened);
        Self::show(ctx, path, options, opened, Box::new(guard))
    }

    fn show(
        ctx: &Context,
        path: &Path,
        options: Options,
        opened: Opened,
        runner: Box<dyn Runner>,
    ) -> Result<Self, OpenError> {
        theme::apply(ctx);
        theme::apply_theatre(ctx);
        let mut audit = Audit::new(options.audit.as_deref())?;
        audit.opened(path, &opened);
        let mut this = Self {
            plan: opened.plan,
            path: path.to_owned(),
            runner,
            machine: None,
            text: String::new(),
            raw_only: None,
            raw_camera: 0,
            shown: OutputCache::default(),
            live: OutputCache::default(),
            last_packets: HashMap::new(),
            shown_packets: HashMap::new(),
            repeats: HashMap::new(),
            named_lost: Vec::new(),
            requested: HashMap::new(),
            running_since: None,
            starting_since: None,
            layout: Layout::All,
            frozen: None,
            measure: Measure::default(),
            rig: None,
            viewpoints: HashMap::new(),
            composition: Composition::default(),
            storage: Storage::new(&options.folder, options.label.as_deref())?,
            clip: None,
            sink_files: SinkFiles::default(),
            emergency: false,
            chosen: HashMap::new(),
            page: 0,
            checking: false,
            checks: Vec::new(),
            stages: Stages::default(),
            doubts: Doubts::default(),
            notices: Vec::new(),
            remark: None,
            leaving: None,
            has_released: false,
            end_held: false,
            releasing: None,
            verified: opened.verified,
            audit,
            sealed: opened.sealed,
            resuming: Resuming::default(),
            scale: options.scale,
            zoom: Zoom::default(),
            inset: false,
            three_d: ThreeD::Off,
            pair: Pair::default(),
            pedal: Pedal::load(options.pedal.as_deref()),
            closing: false,
            shot: options.shot,
            costs: Costs::default(),
        };
        this.watch_sinks();
        this.run(opened.text);
        Ok(this)
    }

    /// Views and settings of the graph.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Whether the running graph is as it was locked.
    pub fn verified(&self) -> &Verified {
        &self.verified
    }

    /// The session that runs the graph, where it runs in this process.
    pub fn session(&self) -> Option<&Session> {
        self.runner.session()
    }

    /// The crash that the run has not recovered from.
    pub fn outage(&self) -> Option<Outage> {
        self.runner.outage()
    }

    /// Age of the camera's own image, ms; `None` before the first one.
    pub fn camera_age_ms(&self) -> Option<f64> {
        self.age_ms(&self.raw()?.output)
    }

    /// Values of a node's parameters in the running graph.
    pub fn param_values(&self, node: &str) -> Option<Vec<ParamValue>> {
        self.runner.values(node)
    }

    /// The current notices, the most urgent first.
    pub fn notices(&self) -> &[Notice] {
        &self.notices
    }

    /// Which views are shown.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Whether the images are frozen.
    pub fn is_frozen(&self) -> bool {
        self.frozen.is_some()
    }

    /// File of the clip being recorded.
    pub fn clip_file(&self) -> Option<&Path> {
        self.clip.as_ref().map(|c| c.file.as_path())
    }

    /// The tapped points.
    pub fn tapped(&self) -> &[Tapped] {
        self.measure.points()
    }

    /// Distance between the last two tapped points.
    pub fn distance(&self) -> Option<Length> {
        self.measure.distance()
    }

    /// Whether the window was asked to close.
    pub fn is_closing(&self) -> bool {
        self.closing
    }

    /// The last remark.
    pub fn remark(&self) -> Option<&str> {
        self.remark.as_ref().map(|(message, ..)| message.as_str())
    }

    /// Shows a remark for some seconds; `wrong` marks it as an error.
    pub(crate) fn notify(&mut self, message: impl Into<String>, wrong: bool) {
        self.remark = Some((message.into(), wrong, time::now()));
    }

    /// Changes the running graph to another one of the same file, with the settings that were changed in this window. `take` makes the runner use
    /// what was prepared for it.
    ///
    /// # Errors
    /// Why not, in words: a clip is recorded, the arm is stopped, the graph was locked meanwhile, or it is being restarted; nothing is changed.
    pub(crate) fn exchange(&mut self, opened: Opened, take: impl FnOnce(&dyn Runner)) -> Result<(), &'static str> {
        if self.emergency {
            return Err(text!("exchange-arm"));
        }
        if self.clip.is_some() {
            return Err(text!("exchange-clip"));
        }
        if self.runner.outage().is_some() {
            return Err(text!("exchange-restarting"));
        }
        if opened.sealed && !self.sealed {
            // What runs was loaded without being compared.
            return Err(text!("exchange-locked"));
        }
        self.audit.opened(&self.path, &opened);
        self.sealed = opened.sealed;
        take(self.runner.as_ref());
        let mut text = opened.text;
        for ((node, param), value) in &self.chosen {
            let Some(value) = toml_of(value) else { continue };
            let edited = GraphEdit::parse(&text).and_then(|mut edit| {
                edit.set_param(node, param, &value)?;
                Ok(edit.text())
            });
            // A node that the new graph does not have needs no setting.
            text = edited.unwrap_or(text);
        }
        (self.plan, self.verified) = (opened.plan, opened.verified);
        (self.layout, self.frozen, self.measure, self.rig) = (Layout::All, None, Measure::default(), None);
        (self.zoom, self.three_d) = (Zoom::default(), ThreeD::Off);
        self.doubts = Doubts::default();
        self.raw_camera = 0;
        self.watch_sinks();
        self.forget_images();
        self.run(text);
        Ok(())
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        self.ui_with_keys(ui, true);
    }

    /// Draws a frame; with `keys` the theatre takes its keys.
    pub(crate) fn ui_with_keys(&mut self, ui: &mut Ui, keys: bool) {
        self.costs.count_frame();
        let ctx = ui.ctx().clone();
        self.follow_machine();
        let counters = self.runner.counters();
        self.take_previews(&ctx);
        self.follow_outage();
        self.fall_back(&self.runner.status());
        let status = self.runner.status();
        let facts = self.facts(&status, &counters);
        self.notices = notices::notices(&facts);
        self.measure.set_doubt(facts.measuring_doubt());
        self.update_recordings(&status, &counters);
        self.see_refused_stops();
        self.audit.update(&counters);
        // These keys press the focused button, or choose a point while measuring.
        let reserved: &[Key] = match ctx.memory(|m| m.focused().is_some()) {
            true => &[Key::Space, Key::Enter],
            false if self.measure.is_on() => &[Key::Enter],
            false => &[],
        };
        // While a text is typed only the pedal's keys count.
        let pressed = match keys {
            true => ctx.input_mut(|input| actions::pressed(input, reserved, &self.pedal.keys)),
            false => {
                let keys = self.pedal.keys.iter().filter(|key| !actions::enters_text(key)).copied();
                let keys: Vec<_> = keys.collect();
                ctx.input_mut(|input| actions::pressed_by_pedal(input, &keys))
            }
        };
        for action in pressed {
            self.perform(action);
        }
        self.leave(&ctx);
        self.follow_screen(&ctx);
        let whole = ui.available_rect_before_wrap();
        ui.allocate_rect(whole, egui::Sense::hover());
        if self.shows_pair() {
            self.show_pair(ui, whole, &status, &facts);
            return self.end_frame(&ctx);
        }
        let top = Rect::from_min_size(whole.min, vec2(whole.width(), TOP));
        let bottom = Rect::from_min_max(pos2(whole.left(), whole.bottom() - BOTTOM), whole.max);
        let stage =
            Rect::from_min_max(pos2(whole.left() + EDGE, top.bottom()), pos2(whole.right() - EDGE, bottom.top() - 8.0));
        self.top_bar(ui, top, &status, &facts);
        self.update_checklist(&facts, &counters);
        let mut pictures = stage;
        if self.checking {
            // Beside the pictures, which become narrower.
            pictures.min.x += checklist::WIDTH + EDGE;
            self.show_checklist(ui, stage.with_max_x(stage.left() + checklist::WIDTH));
        }
        self.stage(ui, pictures, &facts);
        self.bottom_bar(ui, bottom);
        self.end_frame(&ctx);
    }

    /// Requests what the next frame needs.
    fn end_frame(&mut self, ctx: &Context) {
        self.request_previews();
        // Ages must be redrawn even when nothing new arrives.
        ctx.request_repaint_after(Duration::from_millis(100));
        self.play_script(ctx);
        self.shot.take(ctx);
        self.shot.measure_with(ctx, &self.costs, || self.runner.report());
    }

    /// Scales the window with the screen's height, limited by the width that the buttons need.
    fn follow_screen(&self, ctx: &Context) {
        let now = ctx.zoom_factor();
        let size_px = ctx.viewport_rect().size() * now;
        let zoom = (size_px.y / REFERENCE_HEIGHT_PT * self.scale).min(size_px.x / MIN_WIDTH_PT).clamp(0.5, 4.0);
        // In steps, so that the window manager's rounding does not make it oscillate.
        let zoom = (zoom * 20.0).round() / 20.0;
        if (zoom - now).abs() > 0.01 {
            ctx.set_zoom_factor(zoom);
        }
    }

    /// The views that the layout shows.
    fn displayed(&self) -> Vec<&Pane> {
        match self.layout {
            Layout::All => self.plan.views.iter().collect(),
            Layout::One(n) => {
                let count = self.plan.views.len();
                let other = Some((n + 1) % count.max(1)).filter(|other| self.inset && *other != n);
                [Some(n), other].into_iter().flatten().filter_map(|n| self.plan.views.get(n)).collect()
            }
        }
    }

    /// Whether the raw view replaces a view, because it has stopped or is too old.
    fn replaced(&self, pane: &Pane, facts: &Facts) -> bool {
        self.shows_raw() || facts.stopped.contains(&pane.label) || self.is_withdrawn(pane)
    }

    /// Whether the main view has an image.
    pub fn has_picture(&self) -> bool {
        let main = self.plan.views.get(self.layout.main());
        main.is_some_and(|m| self.shown.texture(&m.output).is_some())
    }

    /// Sets the text of the whole graph and runs it.
    fn run(&mut self, text: String) {
        self.set_text(text);
        if self.raw_only.is_none() {
            self.runner.run(&self.text);
        }
    }

    /// Sets the text of the whole graph.
    fn set_text(&mut self, text: String) {
        self.text = text;
        self.keep();
    }

    /// Handles Esc, a pedal's key and the button for touch: a short press ends measuring, holding it for two seconds closes the window.
    fn leave(&mut self, ctx: &Context) {
        let by_key = |i: &InputState| i.key_down(Key::Escape) || actions::is_held(i, Action::End, &self.pedal.keys);
        let down = std::mem::take(&mut self.end_held) || ctx.input(by_key);
        if !down {
            if self.leaving.take().is_some_and(|since| time::since(since) < HOLD / 4) && self.measure.is_on() {
                self.toggle_measuring();
            }
            return;
        }
        let since = *self.leaving.get_or_insert_with(time::now);
        ctx.request_repaint();
        if time::since(since) >= HOLD && !self.closing {
            self.closing = true;
            ctx.send_viewport_cmd(egui::ViewportCommand::Close);
        }
    }
}

impl eframe::App for Theatre {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        Self::ui(self, ui);
    }

    fn clear_color(&self, _: &egui::Visuals) -> [f32; 4] {
        theme::BLACK.to_normalized_gamma_f32()
    }

    fn on_exit(&mut self, _: Option<&eframe::glow::Context>) {
        panoscope_engine::ending::signals::notice();
        self.runner.close();
        self.audit.close();
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}
