//! The program's window: asks for arguments that a graph requires, then shows the theatre; a panel beside the pictures changes them later.

use std::path::{Path, PathBuf};

use eframe::egui::{self, Context, Frame, Key, Margin, Modifiers, Panel, RichText, Ui, vec2};
use panoscope_editor_model::arguments::{self, Form};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::arguments_form::{self, FormRequest, FormStyle};
use panoscope_editor_widgets::theme;
use panoscope_graph::{GraphOptions, GraphText};
use panoscope_host::loader::lock::{ALWAYS_LOCKED, Lock};
use panoscope_host::loader::verify;
use panoscope_host::loader::{self as loader, Loader};

use super::runner::Runner;
use super::{Guard, OpenError, OpenFailed, Opened, Options, Ready, Refusal, Theatre};

/// The key that shows and hides the panel of arguments.
const KEY: Key = Key::A;
/// Width of the form in points.
const WIDTH: f32 = 620.0;

enum Stage {
    Asking,
    Failed(Box<OpenFailed>),
    Running(Box<Theatre>),
}

/// Where the graph is checked and run.
enum Place {
    /// In this process.
    Here,
    /// In a process that this one guards.
    Guarded(Guard),
}

/// A graph that was checked, and where.
enum Found {
    Here(Ready),
    Guarded(Guard, Opened),
}

/// The window of a graph with its arguments.
pub struct Opening {
    path: PathBuf,
    text: String,
    options: Options,
    given: GraphOptions,
    config: Option<PathBuf>,
    /// The form, while it is shown.
    form: Option<Form>,
    /// The values that are being checked.
    checking: Option<GraphOptions>,
    /// Whether the overlays of a form are being found.
    is_searching: bool,
    stage: Stage,
    place: Place,
}

impl Opening {
    /// Opens a window on a graph that was read with `given`, and runs it in this process. Where it is not `ready` because arguments lack values,
    /// the window asks for them first; values that are remembered in the folder `config` are offered.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn new(
        ctx: &Context,
        graph: &GraphText,
        given: GraphOptions,
        ready: Option<Ready>,
        config: Option<PathBuf>,
        options: Options,
    ) -> Result<Self, OpenError> {
        Self::begin(ctx, graph, given, ready.map(Found::Here), config, options, Place::Here)
    }

    /// As [`Self::new`], with a graph that runs in a guarded process. It was `opened` there, unless it lacks arguments.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn guarded(
        ctx: &Context,
        graph: &GraphText,
        given: GraphOptions,
        opened: Option<Opened>,
        config: Option<PathBuf>,
        options: Options,
        guard: Guard,
    ) -> Result<Self, OpenError> {
        let found = opened.map(|opened| Found::Guarded(guard.clone(), opened));
        let for_wake = ctx.clone();
        guard.set_wake(std::sync::Arc::new(move || for_wake.request_repaint()));
        Self::begin(ctx, graph, given, found, config, options, Place::Guarded(guard))
    }

    fn begin(
        ctx: &Context,
        graph: &GraphText,
        given: GraphOptions,
        found: Option<Found>,
        config: Option<PathBuf>,
        options: Options,
        place: Place,
    ) -> Result<Self, OpenError> {
        let (path, text) = (graph.path().to_owned(), graph.text().to_owned());
        let asks = found.is_none();
        let (form, checking, is_searching) = (None, None, false);
        let mut this =
            Self { path, text, options, given, config, form, checking, is_searching, stage: Stage::Asking, place };
        match found {
            Some(found) => {
                let given = this.given.clone();
                this.stage = Stage::Running(Box::new(this.open(ctx, found, &given)?));
            }
            None => {
                theme::apply(ctx);
                theme::apply_theatre(ctx);
            }
        }
        if asks {
            match &this.place {
                Place::Here => {
                    let loader = this.options.loader_for(graph);
                    let form = Form::new(&this.path, &this.text, &this.given, &loader);
                    this.show_remembered(form);
                }
                Place::Guarded(guard) => {
                    guard.find_overlays(&this.text, &this.given);
                    this.is_searching = true;
                }
            }
        }
        Ok(this)
    }

    /// The theatre of a graph that was checked.
    fn open(&self, ctx: &Context, found: Found, given: &GraphOptions) -> Result<Theatre, OpenError> {
        match found {
            Found::Here(ready) => Theatre::of(ctx, &self.path, self.options.clone(), ready),
            Found::Guarded(guard, opened) => {
                Theatre::guarded(ctx, &self.path, (&self.text, given), self.options.clone(), opened, guard)
            }
        }
    }

    /// The theatre, once the graph runs.
    pub fn theatre(&self) -> Option<&Theatre> {
        match &self.stage {
            Stage::Running(theatre) => Some(theatre),
            Stage::Asking | Stage::Failed(_) => None,
        }
    }

    /// The form, while it is shown.
    pub fn form(&self) -> Option<&Form> {
        self.form.as_ref()
    }

    /// Shows a form with the values that were given last time.
    fn show_remembered(&mut self, mut form: Form) {
        if let Some(remembered) = self.config.as_deref().and_then(|folder| arguments::recall(folder, &self.path)) {
            form.recall(remembered);
        }
        self.form = Some(form);
    }

    /// Shows the panel of arguments, or hides it.
    fn toggle_form(&mut self) {
        if self.form.take().is_some() || self.is_searching {
            return;
        }
        match &self.place {
            Place::Here => {
                let session = self.theatre().and_then(Theatre::session);
                let loader = session.map(panoscope_editor_model::session::Session::loader).unwrap_or_default();
                self.show_panel(Form::new(&self.path, &self.text, &self.given, &loader));
            }
            Place::Guarded(guard) => {
                guard.find_overlays(&self.text, &self.given);
                self.is_searching = true;
            }
        }
    }

    fn show_panel(&mut self, form: Form) {
        if !form.is_empty() {
            self.form = Some(form);
        } else if let Stage::Running(theatre) = &mut self.stage {
            theatre.notify(text!("arguments-none"), false);
        }
    }

    /// Takes the answers of the guarded process.
    fn take_answers(&mut self, ctx: &Context) {
        let Place::Guarded(guard) = &self.place else { return };
        let guard = guard.clone();
        if self.is_searching
            && let Some(overlays) = guard.take_overlays()
        {
            self.is_searching = false;
            let form = Form::with_overlays(&self.path, &self.text, &self.given, overlays);
            match self.stage {
                Stage::Asking => self.show_remembered(form),
                Stage::Running(_) => self.show_panel(form),
                Stage::Failed(_) => {}
            }
        }
        if let Some(given) = self.checking.take() {
            match guard.take_prepared() {
                Some(answer) => self.take_checked(ctx, given, answer.map(|opened| Found::Guarded(guard, opened))),
                None => self.checking = Some(given),
            }
        }
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        self.take_answers(&ctx);
        let dropped: Vec<PathBuf> = ctx.input(|i| i.raw.dropped_files.iter().map(|f| f.path().to_owned()).collect());
        if let Some(form) = &mut self.form {
            form.drop_files(dropped);
        }
        let mut request = None;
        let typing = ctx.text_edit_focused();
        let is_running = matches!(self.stage, Stage::Running(_));
        if is_running && !typing && ctx.input_mut(|i| i.consume_key(Modifiers::NONE, KEY)) {
            self.toggle_form();
        }
        match &mut self.stage {
            Stage::Failed(failed) => failed.ui(ui),
            Stage::Asking => {
                let whole = ui.available_rect_before_wrap();
                let size = vec2(WIDTH.min(whole.width() - 40.0), whole.height() * 0.9);
                let room = egui::Rect::from_center_size(whole.center(), size);
                let layout = egui::Layout::top_down(egui::Align::Min);
                ui.scope_builder(egui::UiBuilder::new().max_rect(room).layout(layout), |ui| {
                    request = Self::show_form(ui, &self.path, self.form.as_mut(), text!("arguments-start"), size.y);
                });
                self.options.shot.take(&ctx);
            }
            Stage::Running(theatre) => {
                if self.form.is_some() {
                    // Beside the pictures: nothing covers them.
                    let frame = Frame::new().fill(theme::panel()).inner_margin(Margin::same(20));
                    let panel = Panel::left("arguments").frame(frame).exact_size(460.0);
                    let (path, form) = (&self.path, &mut self.form);
                    panel.show(ui, |ui| {
                        let height = ui.available_height();
                        request = Self::show_form(ui, path, form.as_mut(), text!("arguments-apply"), height);
                    });
                }
                let whole = ui.available_rect_before_wrap();
                let room = egui::UiBuilder::new().max_rect(whole);
                // Letters that are typed into the form are no keys of the theatre.
                ui.scope_builder(room, |ui| theatre.ui_with_keys(ui, !typing));
            }
        }
        match request {
            Some(FormRequest::Apply) => self.apply(&ctx),
            Some(FormRequest::Cancel) => match self.stage {
                Stage::Running(_) => self.form = None,
                Stage::Asking | Stage::Failed(_) => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            },
            Some(FormRequest::Browse(_)) | None => {}
        }
    }

    fn show_form(ui: &mut Ui, path: &Path, form: Option<&mut Form>, apply: &str, height: f32) -> Option<FormRequest> {
        let form = form?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        ui.label(RichText::new(text!("arguments-heading", file = name)).size(26.0));
        ui.add(egui::Label::new(RichText::new(text!("arguments-drop")).size(15.0).color(theme::muted())).wrap());
        ui.add_space(3.0 * theme::STEP);
        let style = FormStyle { apply, browse: false, size: 17.0, height: (height - 220.0).max(160.0) };
        let request = arguments_form::show(ui, form, style);
        let enter = ui.input_mut(|i| i.consume_key(Modifiers::NONE, Key::Enter));
        request.or(enter.then_some(FormRequest::Apply))
    }

    /// Takes the values of the form: the graph is checked with them.
    fn apply(&mut self, ctx: &Context) {
        let Some(form) = &mut self.form else { return };
        if self.checking.is_some() {
            return;
        }
        let Ok(given) = form.finish() else { return };
        match &self.place {
            Place::Here => {
                let parsed = GraphText::parse_with(&self.path, &self.text, &given);
                let ready = Ready::of(&parsed, &self.options);
                let found = ready.map(Found::Here).map_err(|error| Refusal::of(&self.path, &error));
                self.take_checked(ctx, given, found);
            }
            Place::Guarded(guard) => {
                guard.prepare(&self.text, &given);
                self.checking = Some(given);
            }
        }
    }

    /// Starts the theatre with values that were checked, or changes its running graph.
    fn take_checked(&mut self, ctx: &Context, given: GraphOptions, found: Result<Found, Refusal>) {
        let report = |form: &mut Option<Form>, problem: String| {
            if let Some(form) = form {
                form.problems = vec![problem];
            }
        };
        match (&mut self.stage, found) {
            (Stage::Running(theatre), Ok(found)) => {
                let changed = match found {
                    Found::Here(ready) => theatre.exchange(ready.opened, |runner| runner.seal(ready.seal)),
                    Found::Guarded(guard, opened) => {
                        theatre.exchange(opened.clone(), |_| guard.begin(&self.text, &given, &opened))
                    }
                };
                if let Err(refused) = changed {
                    return report(&mut self.form, refused.to_owned());
                }
            }
            // The running graph goes on, and the form says what is wrong.
            (Stage::Running(_), Err(refusal)) => return report(&mut self.form, refusal.message),
            (_, Ok(found)) => {
                let theatre = self.open(ctx, found, &given);
                self.stage = match theatre {
                    Ok(theatre) => Stage::Running(Box::new(theatre)),
                    Err(error) => self.options.failed(ctx, &self.path, Refusal::of(&self.path, &error)),
                };
            }
            // Wrong values can be put right here.
            (Stage::Asking | Stage::Failed(_), Err(refusal)) if refusal.is_mistake => {
                return report(&mut self.form, refusal.message);
            }
            (stage, Err(refusal)) => *stage = self.options.failed(ctx, &self.path, refusal),
        }
        if let Some(folder) = &self.config
            && let Err(error) = arguments::remember(folder, &self.path, &given)
            && let Stage::Running(theatre) = &mut self.stage
        {
            theatre.notify(text!("arguments-not-kept", reason = error.to_string()), true);
        }
        self.given = given;
        self.form = None;
    }
}

impl Options {
    /// The plugins that the form may load to find the overlays that fit: those of the lock, where there is one.
    pub(super) fn loader_for(&self, graph: &GraphText) -> Loader {
        let all = || Loader::search(&loader::search_path(&graph.plugin_paths()));
        match Lock::read(graph.path()) {
            _ if self.unlocked => all(),
            Ok(None) if self.trust.is_empty() => all(),
            Ok(Some(lock)) if lock.check_signature(graph.path(), &self.trust).is_ok() => {
                verify::loader_before_opening(graph, &lock, &ALWAYS_LOCKED)
            }
            // What is wrong with the lock is said when the graph is opened; until then nothing is loaded.
            _ => Loader::default(),
        }
    }

    fn failed(&self, ctx: &Context, path: &Path, refusal: Refusal) -> Stage {
        eprintln!("{}", refusal.terminal_text());
        self.log_refusal(path, &refusal);
        Stage::Failed(Box::new(OpenFailed::of(ctx, refusal, self.shot.clone())))
    }
}

impl eframe::App for Opening {
    fn ui(&mut self, ui: &mut Ui, _: &mut eframe::Frame) {
        Self::ui(self, ui);
    }

    fn clear_color(&self, _: &egui::Visuals) -> [f32; 4] {
        theme::BLACK.to_normalized_gamma_f32()
    }

    fn on_exit(&mut self, gl: Option<&eframe::glow::Context>) {
        match (&mut self.stage, &mut self.place) {
            (Stage::Running(theatre), _) => eframe::App::on_exit(theatre.as_mut(), gl),
            (_, Place::Guarded(guard)) => guard.close(),
            _ => {}
        }
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}
