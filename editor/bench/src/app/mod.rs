//! The editor's window: draws all panels and handles what the user asks for.

mod arguments;
mod attached;
mod commands;
mod conflict;
mod dialogs;
mod docking;
mod guide;
mod learning;
mod moments;
mod new_graph;
mod parts;
mod picking;
mod playing;
mod previews;
mod saving;
mod script;
mod states;
mod tour;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{self, CentralPanel, Context, Frame, Margin, Panel, Ui};
use panoscope_editor_model::texts::text;
use panoscope_graph::edit::EditError;
use panoscope_graph::{GraphOptions, GraphText, installed};

use crate::actions;
use crate::canvas::Canvas;
use crate::docks::Docks;
use crate::palette::{Palette, Types};
use crate::panels::below;
use crate::panels::files::Files;
use crate::panels::plots::{Export, Plots};
use crate::panels::source::SourceFile;
use crate::panels::states::States;
use crate::panels::sweep::SweepPanel;
use crate::panels::timeline::TimelinePanel;
use crate::panels::top;
use crate::panels::trace::TracePanel;
use crate::picker::Picker;
use crate::view3d::View3d;
use crate::viewer::Viewer;
use panoscope_editor_model::arguments::Form;
use panoscope_editor_model::disk::{DiskAlarm, DiskWatch};
use panoscope_editor_model::document::Document;
use panoscope_editor_model::numbered::{FolderError, next_file};
use panoscope_editor_model::observe::{Counters, Observer, Output};
use panoscope_editor_model::ops::{BypassError, Detour, InsertError};
use panoscope_editor_model::probe::Probe;
use panoscope_editor_model::session::{FinishedRecording, Phase, Session, Status};
use panoscope_editor_model::timeline::Timeline;
use panoscope_editor_model::trace::Trace;
use panoscope_editor_widgets::OutputCache;
use panoscope_editor_widgets::theme;

use conflict::Conflict;
pub use new_graph::{templates, with_source};
use panoscope_editor_widgets::{Costs, Shot};

/// Width of the picture in the panel of a node, px.
const THUMBNAIL: usize = 416;
/// Width of the large view in px.
const LARGE: usize = 2048;
/// Time between two frames while the graph runs and nothing is new: ages of pictures are shown in seconds.
const RUNNING: Duration = Duration::from_secs(1);
/// How long a notification is shown.
const NOTE: Duration = Duration::from_secs(6);

/// Options of the window.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Maximum number of ticks of each source.
    pub frames: Option<u64>,
    /// Scale of everything; 0 for the default.
    pub scale: f32,
    /// Dark or light.
    pub theme: theme::Choice,
    /// Screenshot and costs of the window, for `cargo xtask screens` and `panoscope bench editor`.
    pub shot: Shot,
    /// Program that opens another graph in a window of its own; this program without one.
    pub opener: Option<PathBuf>,
    /// Overlays and values of the graph's arguments.
    pub given: GraphOptions,
    /// Folder for values of arguments that are remembered; `None` to remember none.
    pub config: Option<PathBuf>,
}

/// Why the window did not open.
#[derive(Debug, thiserror::Error)]
#[error("no thread could be started: {0}")]
pub struct OpenError(#[from] std::io::Error);

/// Why curves were not written.
#[derive(Debug, thiserror::Error)]
enum ExportError {
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Table(#[from] std::io::Error),
    #[error(transparent)]
    Picture(#[from] image::ImageError),
}

/// The window.
pub struct App {
    pub(crate) session: Session,
    pub(crate) observer: Observer,
    pub(crate) document: Document,
    pub(crate) canvas: Canvas,
    pub(crate) shown: OutputCache,
    pub(crate) viewer: Viewer,
    /// Values of the pictures in the viewer and in the panel, and the point under the pointer in the panel.
    probes: HashMap<Output, Probe>,
    panel_point: Option<[f32; 2]>,
    plots: Plots,
    sweep: SweepPanel,
    states: States,
    trace: Arc<Trace>,
    trace_panel: TracePanel,
    timeline: Option<Timeline>,
    timeline_panel: TimelinePanel,
    /// The newest recording of this window that was shown.
    shown_recording: Option<FinishedRecording>,
    picker: Option<Picker>,
    files: Option<Files>,
    palette: Option<Palette>,
    types: Types,
    help: bool,
    /// Whether the theme is to change with the next frame.
    change_theme: bool,
    /// A parameter that is to be shown and to get the keys, in the panel of its node.
    go_to_param: Option<(String, String)>,
    plugins: bool,
    tour: tour::ProblemTour,
    guide: Option<guide::Guide>,
    node_help: Option<learning::NodeHelp>,
    /// The opened source of a Python plugin, and whether the next closing discards its changes.
    source: Option<SourceFile>,
    discards_source: bool,
    /// Program that opens another graph; this one by default.
    opener: Option<PathBuf>,
    /// Whether nodes are coloured by their load.
    heat: bool,
    pub(crate) docks: Docks,
    pub(crate) detours: HashMap<String, Vec<Detour>>,
    /// The highlighted line of the file's text.
    reading: below::Reading,
    disk: DiskWatch,
    /// Wakes the window when a file changes on disk; `None` where the graph runs on another machine.
    alarm: Option<DiskAlarm>,
    conflicts: Vec<Conflict>,
    /// Watches of part and overlay files.
    other_disks: HashMap<PathBuf, DiskWatch>,
    /// The open form for arguments, and the folder where its values are remembered.
    arguments: Option<Form>,
    config: Option<PathBuf>,
    /// The name being typed for a new part, and whether the field was shown already.
    part_name: Option<(String, bool)>,
    /// A change of a part that is used several times, until the user agrees or not.
    consent: Option<parts::Consent>,
    /// What the user asked for last, to be repeated after a consent.
    asked: Option<parts::Asked>,
    /// Counters with those of folded parts, and what they were made of.
    summed: Option<(Arc<Counters>, u64, Arc<Counters>)>,
    /// Whether the view moves with every frame, for measurements.
    panning: bool,
    notification: Option<(String, bool, Instant)>,
    /// Revision of the document that was last passed to the session.
    requested_revision: u64,
    /// The graph of the machine that was shown last, where the graph runs on another one.
    machine_revision: u64,
    shot: Shot,
    costs: Costs,
}

/// Makes the session, and changes of files unless the graph runs on another machine, redraw the window.
fn wake_by(session: &Session, ctx: &Context) -> std::io::Result<Option<DiskAlarm>> {
    let for_wake = ctx.clone();
    session.set_wake(Arc::new(move || for_wake.request_repaint()));
    let for_alarm = ctx.clone();
    let is_here = session.attachment().is_none();
    is_here.then(|| DiskAlarm::new(move || for_alarm.request_repaint())).transpose()
}

impl App {
    /// Opens a window on the graph file at `path` with its text, and starts the graph if it is valid.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn open(ctx: &Context, path: &Path, text: &str, options: Options) -> Result<Self, OpenError> {
        let paths = GraphText::parse_with(path, text, &options.given).plugin_paths();
        let session = Session::new(path, &paths, options.frames)?;
        Self::with_session(ctx, path, text, session, options)
    }

    /// Opens a window on a session that runs nothing yet, or that runs the text elsewhere.
    fn with_session(
        ctx: &Context,
        path: &Path,
        text: &str,
        session: Session,
        options: Options,
    ) -> Result<Self, OpenError> {
        theme::apply_choice(ctx, options.theme);
        if options.scale > 0.0 {
            ctx.set_zoom_factor(options.scale);
        }
        let alarm = wake_by(&session, ctx)?;
        let trace = session.follow_ticks();
        let observer = Observer::new(session.handle())?;
        let document = Document::with_options(path, text, session.loader(), options.given);
        let arguments = (!document.missing_args().is_empty())
            .then(|| arguments::form(&document, &session.loader(), options.config.as_deref()));
        if document.view().valid {
            session.run(document.runnable());
        }
        // Pictures of a script are the same for everybody.
        let config = options.config.as_deref().filter(|_| !options.shot.is_scripted());
        let (docks, broken) = Docks::of(config, path);
        let is_new = guide::is_first_start(options.config.as_deref()) && !options.shot.is_scripted();
        let mut app = Self {
            observer,
            document,
            canvas: Canvas::default(),
            shown: OutputCache::default(),
            viewer: Viewer::default(),
            probes: HashMap::new(),
            panel_point: None,
            plots: Plots::default(),
            sweep: SweepPanel::default(),
            states: States::default(),
            trace,
            trace_panel: TracePanel::default(),
            timeline: None,
            timeline_panel: TimelinePanel::default(),
            shown_recording: None,
            picker: None,
            files: None,
            palette: None,
            types: Types::default(),
            help: false,
            change_theme: false,
            go_to_param: None,
            plugins: false,
            tour: tour::ProblemTour::default(),
            guide: None,
            node_help: None,
            source: None,
            discards_source: false,
            opener: options.opener,
            heat: false,
            docks,
            detours: HashMap::new(),
            reading: below::Reading::default(),
            disk: DiskWatch::new(path),
            alarm,
            conflicts: Vec::new(),
            other_disks: HashMap::new(),
            arguments,
            config: options.config,
            part_name: None,
            consent: None,
            asked: None,
            summed: None,
            panning: false,
            notification: installed::notice(path).map(|notice| (notice, false, Instant::now())),
            requested_revision: 1,
            machine_revision: 0,
            shot: options.shot,
            costs: Costs::default(),
            session,
        };
        app.greet(broken.map(|broken| broken.to_string()), is_new);
        Ok(app)
    }

    /// Says why the stored layout is not used, and shows a newcomer around.
    fn greet(&mut self, broken_layout: Option<String>, is_new: bool) {
        if let Some(reason) = broken_layout {
            self.notify(text!("layout-unused", reason = reason), true);
        }
        // A form or templates come first; the next start with a graph that runs shows the tour.
        if is_new && self.arguments.is_none() && self.document.view().valid {
            self.start_guide();
        }
    }

    /// The graph file being edited.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// The session that runs the graph.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// The canvas that shows the graph.
    pub fn canvas(&self) -> &Canvas {
        &self.canvas
    }

    /// The output that is shown large.
    pub fn viewed(&self) -> Option<&Output> {
        self.viewer.source().map(|v| &v.output)
    }

    /// The output that it is compared with.
    pub fn compared_with(&self) -> Option<&Output> {
        self.viewer.sources().nth(1).map(|v| &v.output)
    }

    /// The values that are read from an output's picture, while it is shown alone in the viewer or in the panel of its node.
    pub fn probe(&self, output: &Output) -> Option<&Probe> {
        self.probes.get(output)
    }

    /// Whether a picture has arrived that a snapshot can keep.
    pub fn has_picture(&self) -> bool {
        self.picture_of_now().is_some()
    }

    /// The picture of an output as it was rendered last.
    pub fn picture(&self, output: &Output) -> Option<&panoscope_editor_model::pixels::Pixels> {
        self.shown.pixels(output)
    }

    /// The panel of tick paths.
    pub fn trace_panel(&self) -> &TracePanel {
        &self.trace_panel
    }

    /// The 3-D view.
    pub fn view3d(&self) -> &View3d {
        self.viewer.view3d_state()
    }

    /// Whether a cloud is shown as a surface, rendered from the current viewpoint.
    pub fn has_surface(&self) -> bool {
        let depth_buffer = self.viewed().and_then(|output| self.shown.packet(output)?.depth_buffer.as_ref());
        depth_buffer.is_some_and(|depth_buffer| self.viewer.viewpoint() == Some(depth_buffer.viewpoint))
    }

    /// Position of the line between two outputs, as a fraction of the image's width, while they are compared by wipe.
    pub fn wipe(&self) -> Option<f32> {
        self.viewer.wipe_line()
    }

    /// The description of each wire, with its maximum queue length in the recorded history.
    pub fn queues(&self) -> Vec<(String, f64)> {
        let (counters, view) = (self.observer.counters(), self.document.view().flat());
        let most = |points: &std::collections::VecDeque<[f64; 2]>| points.iter().map(|p| p[1]).fold(0.0, f64::max);
        counters.queues.iter().map(|(end, points)| (view.wire_name(end), most(points))).collect()
    }

    /// Mean CPU time of the window's thread per frame in ms, and the number of frames.
    pub fn cost(&self) -> (f64, u64) {
        self.costs.mean()
    }

    /// Shows a notification for some seconds; `wrong` marks it as an error.
    pub(crate) fn notify(&mut self, message: impl Into<String>, wrong: bool) {
        self.notification = Some((message.into(), wrong, Instant::now()));
    }

    /// The result of an edit; an error is shown. Where a part would change that is used several times, the user is asked.
    pub(crate) fn try_edit<T, E: std::fmt::Display + 'static>(&mut self, result: Result<T, E>) -> Option<T> {
        result.map_err(|error| self.refuse(&error)).ok()
    }

    fn refuse<E: std::fmt::Display + 'static>(&mut self, error: &E) {
        let any = error as &dyn std::any::Any;
        let edit = any.downcast_ref::<EditError>();
        let edit = edit.or_else(|| match any.downcast_ref::<BypassError>() {
            Some(BypassError::Edit(error)) => Some(error),
            _ => None,
        });
        let edit = edit.or_else(|| match any.downcast_ref::<InsertError>() {
            Some(InsertError::Edit(error)) => Some(error),
            _ => None,
        });
        if !edit.is_some_and(|edit| self.hold_for_consent(edit)) {
            self.notify(error.to_string(), true);
        }
    }

    /// Requests the session to run a new, valid text.
    fn run_document(&mut self) {
        if self.requested_revision != self.document.revision() {
            self.requested_revision = self.document.revision();
            if self.document.view().valid && self.may_run() {
                self.session.run_from(self.document.saved(), self.document.runnable());
            }
        }
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        self.costs.count_frame();
        let ctx = ui.ctx().clone();
        if std::mem::take(&mut self.change_theme) {
            theme::apply_choice(&ctx, if theme::is_light() { theme::Choice::Dark } else { theme::Choice::Light });
            ui.set_style(ctx.global_style());
        }
        let status = self.session.status();
        self.document.set_loader(self.session.loader());
        if self.document.history().has_pending() && *status.running == **self.document.runnable() {
            self.document.set_tick(status.tick);
        }
        self.follow_recording(&ctx, &status);
        self.shown.set_over(matches!(status.phase, Phase::Ended) && self.timeline.is_none());
        self.take_pictures(&ctx);
        self.probes = self.timeline.as_ref().map_or_else(|| self.observer.probes(), |timeline| timeline.probes());
        self.follow_machine();
        if !self.is_attached() {
            if let Some(text) = self.disk.poll() {
                self.changed_on_disk(text);
            }
            self.poll_other_files();
        }
        let typing = ctx.text_edit_focused();
        if self.docks.dragged().is_some() && ctx.input_mut(|i| i.consume_key(egui::Modifiers::NONE, egui::Key::Escape))
        {
            self.docks.cancel_drag(&ctx);
        }
        // While a picker or a dialog is open, it gets the keys.
        if self.picker.is_some() && !self.help {
            for action in ctx.input_mut(actions::pressed_while_picking) {
                self.perform(action);
            }
        } else if !self.is_asking() {
            for action in ctx.input_mut(|input| actions::pressed(input, typing)) {
                self.perform(action);
            }
            self.clipboard(&ctx, typing);
            self.arrows(&ctx, typing);
            if !typing {
                ctx.input_mut(|input| self.viewer.recall_by_key(input));
            }
        }
        if ctx.input(|i| i.pointer.any_released()) {
            self.document.end_merge();
        }
        self.panels(ui, &status);
        self.palettes(&ctx);
        self.offer_templates(&ctx);
        self.ask_arguments(&ctx);
        self.ask_part_name(&ctx);
        self.ask_consent(&ctx);
        self.take_dropped(&ctx);
        self.show_guide(&ctx);
        self.show_notification(&ctx);
        self.run_document();
        self.request_previews(ctx.pixels_per_point());
        self.rest(&ctx, &status);
        self.play_script(&ctx);
        self.shot.take(&ctx);
        self.shot.measure(&ctx, &self.costs, &self.session);
    }

    /// Asks for the frames that are due without an event. While nothing runs there are none, so that a window at rest costs nothing.
    fn rest(&mut self, ctx: &Context, status: &Status) {
        let paths = self.document.saved_files().map(|(path, _)| path).chain([self.document.path()]);
        if self.is_attached() {
            ctx.request_repaint_after(DiskWatch::INTERVAL);
        } else if let Some(alarm) = &self.alarm {
            alarm.watch(paths);
        }
        if let Phase::Running | Phase::Starting = status.phase {
            ctx.request_repaint_after(RUNNING);
        }
        if let Some(left) = self.shown.until_stale() {
            ctx.request_repaint_after(left);
        }
    }

    /// Whether a dialog is open that gets the keys.
    fn is_asking(&self) -> bool {
        let parts = self.part_name.is_some() || self.consent.is_some();
        parts || self.palette.is_some() || self.files.is_some() || self.arguments.is_some() || self.help || self.plugins
    }

    fn panels(&mut self, ui: &mut Ui, status: &Status) {
        let counters = self.summed_counters();
        let bar = Frame::new().fill(theme::panel()).inner_margin(Margin::symmetric(16, 8));
        let actions = Panel::top("top").frame(bar).exact_size(44.0).show(ui, |ui| {
            let recorded = self.timeline.as_ref().map(Timeline::path);
            let playing = self.playing_now(status);
            top::show(ui, &self.document, (status, &counters, recorded), playing, |action| self.is_on(action))
        });
        actions.inner.into_iter().for_each(|action| self.perform(action));
        self.machine_bar(ui);
        self.conflict_bar(ui);
        let windows = self.docks.windows();
        CentralPanel::no_frame().show(ui, |ui| self.show_docks(ui, status, &counters));
        self.show_windows(ui.ctx(), &windows, status, &counters);
        self.show_tour(ui.ctx());
    }

    /// Writes curves to a file in `out/` with the next number.
    pub(super) fn export(&mut self, what: &str, export: Export) {
        let ending = if matches!(export, Export::Csv(_)) { "csv" } else { "png" };
        let write = || -> Result<PathBuf, ExportError> {
            let file = next_file(Path::new("out"), what, ending)?;
            match export {
                Export::Csv(text) => panoscope_base::files::replace(&file, text.as_bytes())?,
                Export::Picture(picture) => picture.save(&file)?,
            }
            Ok(file)
        };
        match write() {
            Ok(file) => self.notify(text!("done-written", file = file.display().to_string()), false),
            Err(error) => self.notify(text!("done-not-written", reason = error.to_string()), true),
        }
    }

    /// The selected node, if exactly one is selected.
    pub fn selected(&self) -> Option<String> {
        let mut selected = self.canvas.selected.iter();
        selected.next().filter(|_| selected.next().is_none()).cloned()
    }
}

impl eframe::App for App {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        Self::ui(self, ui);
    }

    fn clear_color(&self, _: &egui::Visuals) -> [f32; 4] {
        theme::ground().to_normalized_gamma_f32()
    }

    fn on_exit(&mut self, _: Option<&eframe::glow::Context>) {
        panoscope_engine::ending::signals::notice();
        self.session.close();
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}
