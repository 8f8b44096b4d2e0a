//! The editor's window: draws all panels and handles what the user asks for.

mod arguments;
mod attached;
mod commands;
mod conflict;
mod dialogs;
mod guide;
mod learning;
mod moments;
mod new_graph;
mod parts;
mod picking;
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
use panoscope_graph::edit::EditError;
use panoscope_graph::{GraphOptions, GraphText, installed};

use crate::actions;
use crate::canvas::{Canvas, Scene};
use crate::palette::{Palette, Types};
use crate::panels::files::Files;
use crate::panels::inspector::{self, InspectorRequest};
use crate::panels::plots::{Export, Plots};
use crate::panels::source::SourceFile;
use crate::panels::states::States;
use crate::panels::sweep::SweepPanel;
use crate::panels::timeline::TimelinePanel;
use crate::panels::top::{self, Switches};
use crate::panels::trace::TracePanel;
use crate::panels::{below, history, overview, params};
use crate::picker::Picker;
use crate::view3d::View3d;
use crate::viewer::Viewer;
use panoscope_editor_model::arguments::Form;
use panoscope_editor_model::disk::{self, DiskWatch};
use panoscope_editor_model::document::Document;
use panoscope_editor_model::numbered::{FolderError, next_file};
use panoscope_editor_model::observe::{Counters, Observer, Output};
use panoscope_editor_model::ops::{BypassError, Detour, InsertError};
use panoscope_editor_model::probe::Probe;
use panoscope_editor_model::session::{Phase, Session, Status};
use panoscope_editor_model::timeline::Timeline;
use panoscope_editor_model::trace::Trace;
use panoscope_editor_widgets::OutputCache;
use panoscope_editor_widgets::theme;

use conflict::Conflict;
pub use new_graph::{templates, with_source};
use panoscope_editor_widgets::{Costs, Shot};

/// Width of a thumbnail in px; sharp at zoom 1 on a screen of double density.
const THUMBNAIL: usize = 416;
/// Width of the large view in px.
const LARGE: usize = 2048;
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
    pub(crate) switches: Switches,
    pub(crate) detours: HashMap<String, Vec<Detour>>,
    /// The highlighted line of the file's text.
    reading: below::Reading,
    disk: DiskWatch,
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
        let for_wake = ctx.clone();
        session.set_wake(Arc::new(move || for_wake.request_repaint()));
        theme::apply_choice(ctx, options.theme);
        if options.scale > 0.0 {
            ctx.set_zoom_factor(options.scale);
        }
        let trace = session.follow_ticks();
        let observer = Observer::new(session.handle())?;
        let document = Document::with_options(path, text, session.loader(), options.given);
        let arguments = (!document.missing_args().is_empty())
            .then(|| arguments::form(&document, &session.loader(), options.config.as_deref()));
        if document.view().valid {
            session.run(document.runnable());
        }
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
            switches: Switches::default(),
            detours: HashMap::new(),
            reading: below::Reading::default(),
            disk: DiskWatch::new(path),
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
        // A form or templates come first; the next start with a graph that runs shows the tour.
        if is_new && app.arguments.is_none() && app.document.view().valid {
            app.start_guide();
        }
        Ok(app)
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

    /// The values that are read from an output's picture, while it is shown alone in the viewer or in the panel of its node.
    pub fn probe(&self, output: &Output) -> Option<&Probe> {
        self.probes.get(output)
    }

    /// Whether a picture has arrived that a snapshot can keep.
    pub fn has_picture(&self) -> bool {
        self.picture_of_now().is_some()
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
        self.request_previews();
        ctx.request_repaint_after(DiskWatch::INTERVAL);
        self.play_script(&ctx);
        self.shot.take(&ctx);
        self.shot.measure(&ctx, &self.costs, &self.session);
    }

    /// Whether a dialog is open that gets the keys.
    fn is_asking(&self) -> bool {
        let parts = self.part_name.is_some() || self.consent.is_some() || self.node_help.is_some();
        parts || self.palette.is_some() || self.files.is_some() || self.arguments.is_some() || self.help || self.plugins
    }

    fn panels(&mut self, ui: &mut Ui, status: &Status) {
        let counters = self.summed_counters();
        let bar = Frame::new().fill(theme::panel()).inner_margin(Margin::symmetric(16, 8));
        let actions = Panel::top("top")
            .frame(bar)
            .exact_size(44.0)
            .show(ui, |ui| top::show(ui, &self.document, status, &counters, self.switches));
        actions.inner.into_iter().for_each(|action| self.perform(action));
        self.machine_bar(ui);
        self.conflict_bar(ui);
        self.side(ui, status, &counters);
        self.source_panel(ui);
        self.below(ui, status, &counters);
        let view = self.document.view().clone();
        let problem = status.problem.as_ref().and_then(|t| Some((t.node.as_deref()?, t.message.as_str())));
        CentralPanel::no_frame().show(ui, |ui| {
            let rect = ui.available_rect_before_wrap();
            if self.viewer.source().is_some() {
                ui.allocate_rect(rect, egui::Sense::hover());
                let (mut others, trajectories) = (self.sources(), self.trajectories());
                others.extend(self.viewer.source().and_then(|source| self.of_second_run(source)));
                let trajectories: Vec<Output> = trajectories.into_iter().map(|(output, _)| output).collect();
                let probe = self.viewer.probe_request().and_then(|(output, _)| self.probes.get(output)).cloned();
                let image_rects = self.viewer.show(ui, rect, &self.shown, &others, &trajectories, probe.as_ref());
                self.pick_on(ui, image_rects);
                return;
            }
            let scene = Scene {
                view: &view,
                counters: &counters,
                shown: &self.shown,
                heat: self.switches.heat,
                running: status.phase == Phase::Running,
                problem,
            };
            let requests = self.canvas.show(ui, &scene, self.document.revision());
            requests.into_iter().for_each(|request| self.handle_canvas(request));
        });
        self.show_tour(ui.ctx());
    }

    /// The panel of the selected node, or of the whole graph. It is always visible, so that selecting does not move the canvas.
    fn side(&mut self, ui: &mut Ui, status: &Status, counters: &Counters) {
        let side = Frame::new().fill(theme::panel()).inner_margin(Margin::same(16));
        let panel = Panel::right("side").frame(side).default_size(320.0).size_range(260.0..=520.0);
        let view = self.document.view().clone();
        let Some(node) = self.selected().and_then(|id| view.node(&id)) else {
            let count = self.canvas.selected.len();
            let requests = panel.show(ui, |ui| overview::show(ui, &self.document, counters, count));
            for request in requests.inner {
                match request {
                    overview::OverviewRequest::Go(id) => self.canvas.show_node(&view, &id),
                    overview::OverviewRequest::Perform(action) => self.perform(action),
                    overview::OverviewRequest::Param(id, change) => {
                        self.handle_inspector(&id, InspectorRequest::Param(change))
                    }
                }
            }
            return;
        };
        let id = view.nodes[node].id();
        if let Some((_, param)) = self.go_to_param.take_if(|(node, _)| node == id) {
            params::go_to(ui.ctx(), &param);
        }
        let requests = panel.show(ui, |ui| {
            let (document, shown) = (&self.document, (&self.shown, &self.probes));
            let python = self.python_file(id).is_some();
            inspector::show(ui, document, (counters, status), shown, &self.canvas, (node, python))
        });
        let id = view.nodes[node].id().to_owned();
        requests.inner.into_iter().for_each(|request| self.handle_inspector(&id, request));
    }

    /// The panels below and beside the canvas that are switched on: text, problems, history, sweep, plots.
    fn below(&mut self, ui: &mut Ui, status: &Status, counters: &Counters) {
        let frame = Frame::new().fill(theme::panel()).inner_margin(Margin::symmetric(16, 12));
        let selected: Vec<String> = self.canvas.selected.iter().cloned().collect();
        if self.switches.text {
            let panel = Panel::left("text").frame(frame).default_size(430.0).size_range(200.0..=900.0);
            panel.show(ui, |ui| below::text(ui, &self.document, &selected, &mut self.reading));
        }
        if self.switches.problems {
            let panel = Panel::bottom("problems").frame(frame).default_size(180.0).size_range(80.0..=480.0);
            let go = panel.show(ui, |ui| below::problems(ui, &self.document, status, counters)).inner;
            if let Some(spot) = go {
                if let Some(line) = spot.line {
                    self.reading.go_to(line);
                    // A mistake outside of nodes is shown in the text.
                    self.switches.text |= spot.node.is_none();
                }
                if let Some(id) = spot.node {
                    self.canvas.show_node(&self.document.view().clone(), &id);
                }
            }
        }
        if self.switches.history {
            let panel = Panel::bottom("history").frame(frame).default_size(200.0).size_range(100.0..=480.0);
            let go = panel.show(ui, |ui| history::show(ui, &self.document)).inner;
            if let Some(at) = go {
                self.step_to(at);
            }
        }
        if self.switches.timeline {
            self.timeline_panel(ui, frame);
        }
        if self.switches.trace {
            let panel = Panel::bottom("trace").frame(frame).default_size(240.0).size_range(140.0..=560.0);
            let view = self.document.view().clone();
            let machine = self.session.attachment().map(|machine| machine.target().name.clone());
            let go = panel.show(ui, |ui| self.trace_panel.show(ui, &view, &self.trace, machine.as_deref())).inner;
            if let Some(id) = go {
                self.canvas.show_node(&view, &id);
            }
        }
        if self.switches.states {
            let panel = Panel::bottom("states").frame(frame).default_size(230.0).size_range(140.0..=480.0);
            let requests = panel.show(ui, |ui| self.states.show(ui)).inner;
            requests.into_iter().for_each(|request| self.handle_state(request));
        }
        if self.switches.sweep {
            let panel = Panel::bottom("sweep").frame(frame).default_size(270.0).size_range(160.0..=560.0);
            let (selected, path) = (self.selected(), self.session.path().to_owned());
            let request = panel
                .show(ui, |ui| self.sweep.show(ui, &self.document, counters, &self.shown, selected.as_deref(), &path));
            request.inner.into_iter().for_each(|request| self.handle_sweep(request));
        }
        if self.switches.plots {
            let panel = Panel::bottom("plots").frame(frame).default_size(220.0).size_range(120.0..=520.0);
            let export = panel.show(ui, |ui| self.plots.show(ui, self.document.view(), counters, &selected)).inner;
            if let Some(export) = export {
                self.export("plot", export);
            }
        }
    }

    /// Writes curves to a file in `out/` with the next number.
    pub(super) fn export(&mut self, what: &str, export: Export) {
        let ending = if matches!(export, Export::Csv(_)) { "csv" } else { "png" };
        let write = || -> Result<PathBuf, ExportError> {
            let file = next_file(Path::new("out"), what, ending)?;
            match export {
                Export::Csv(text) => disk::replace(&file, text.as_bytes(), None)?,
                Export::Picture(picture) => picture.save(&file)?,
            }
            Ok(file)
        };
        match write() {
            Ok(file) => self.notify(format!("written: {}", file.display()), false),
            Err(error) => self.notify(format!("the curves were not written: {error}"), true),
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
