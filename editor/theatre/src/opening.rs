//! The program's window: asks for arguments that a graph requires, then shows the theatre; a panel beside the pictures changes them later.

use std::path::{Path, PathBuf};

use eframe::egui::{self, Context, Frame, Key, Margin, Modifiers, Panel, RichText, Ui, vec2};
use panoscope_editor_model::arguments::{self, Form};
use panoscope_editor_widgets::arguments_form::{self, FormRequest, FormStyle};
use panoscope_editor_widgets::theme;
use panoscope_graph::{GraphOptions, GraphText};
use panoscope_loader::lock::{ALWAYS_LOCKED, Lock};
use panoscope_loader::verify;
use panoscope_loader::{self as loader, Loader};

use super::{OpenError, OpenFailed, Options, Ready, Theatre};

/// The key that shows and hides the panel of arguments.
const KEY: Key = Key::A;
/// Width of the form in points.
const WIDTH: f32 = 620.0;

enum Stage {
    Asking,
    Failed(Box<OpenFailed>),
    Running(Box<Theatre>),
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
    stage: Stage,
}

impl Opening {
    /// Opens a window on a graph that was read with `given`. Where it is not `ready` because arguments lack values, the window asks for them first;
    /// values that are remembered in the folder `config` are offered.
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
        let (path, text) = (graph.path().to_owned(), graph.text().to_owned());
        let stage = match ready {
            Some(ready) => Stage::Running(Box::new(Theatre::of(ctx, &path, options.clone(), ready)?)),
            None => {
                theme::apply(ctx);
                theme::apply_theatre(ctx);
                Stage::Asking
            }
        };
        let mut this = Self { path, text, options, given, config, form: None, stage };
        if matches!(this.stage, Stage::Asking) {
            let loader = this.options.loader_for(graph);
            this.form = Some(this.new_form(&loader));
        }
        Ok(this)
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

    fn new_form(&self, loader: &Loader) -> Form {
        let mut form = Form::new(&self.path, &self.text, &self.given, loader);
        if let Some(remembered) = self.config.as_deref().and_then(|folder| arguments::recall(folder, &self.path)) {
            form.recall(remembered);
        }
        form
    }

    /// Draws a frame.
    pub fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        let dropped: Vec<PathBuf> = ctx.input(|i| i.raw.dropped_files.iter().map(|f| f.path().to_owned()).collect());
        if let Some(form) = &mut self.form {
            form.drop_files(dropped);
        }
        let mut request = None;
        match &mut self.stage {
            Stage::Failed(failed) => failed.ui(ui),
            Stage::Asking => {
                let whole = ui.available_rect_before_wrap();
                let size = vec2(WIDTH.min(whole.width() - 40.0), whole.height() * 0.9);
                let room = egui::Rect::from_center_size(whole.center(), size);
                let layout = egui::Layout::top_down(egui::Align::Min);
                ui.scope_builder(egui::UiBuilder::new().max_rect(room).layout(layout), |ui| {
                    request = Self::show_form(ui, &self.path, self.form.as_mut(), "Start", size.y);
                });
                self.options.shot.take(&ctx);
            }
            Stage::Running(theatre) => {
                let typing = ctx.text_edit_focused();
                if !typing && ctx.input_mut(|i| i.consume_key(Modifiers::NONE, KEY)) {
                    let loader = theatre.session().loader();
                    self.form = match self.form {
                        Some(_) => None,
                        None => Some(Form::new(&self.path, &self.text, &self.given, &loader)),
                    };
                    if self.form.as_ref().is_some_and(Form::is_empty) {
                        self.form = None;
                        theatre.notify("the graph has no arguments", false);
                    }
                }
                if self.form.is_some() {
                    // Beside the pictures: nothing covers them.
                    let frame = Frame::new().fill(theme::PANEL).inner_margin(Margin::same(20));
                    let panel = Panel::left("arguments").frame(frame).exact_size(460.0);
                    let (path, form) = (&self.path, &mut self.form);
                    panel.show(ui, |ui| {
                        let height = ui.available_height();
                        request = Self::show_form(ui, path, form.as_mut(), "Apply", height);
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
        ui.label(RichText::new(format!("Arguments of {name}")).size(26.0));
        ui.add(
            egui::Label::new(RichText::new("Files can be dropped on the window.").size(15.0).color(theme::MUTED))
                .wrap(),
        );
        ui.add_space(3.0 * theme::STEP);
        let style = FormStyle { apply, browse: false, size: 17.0, height: (height - 220.0).max(160.0) };
        let request = arguments_form::show(ui, form, style);
        let enter = ui.input_mut(|i| i.consume_key(Modifiers::NONE, Key::Enter));
        request.or(enter.then_some(FormRequest::Apply))
    }

    /// Takes the values of the form: starts the theatre, or changes its running graph.
    fn apply(&mut self, ctx: &Context) {
        let Some(form) = &mut self.form else { return };
        let Ok(given) = form.finish() else { return };
        let parsed = GraphText::parse_with(&self.path, &self.text, &given);
        let ready = Ready::of(&parsed, &self.options);
        match (&mut self.stage, ready) {
            (Stage::Running(theatre), Ok(ready)) => {
                if let Err(refused) = theatre.exchange(ready) {
                    form.problems = vec![refused.to_owned()];
                    return;
                }
            }
            // The running graph goes on, and the form says what is wrong.
            (Stage::Running(_), Err(error)) => {
                form.problems = vec![error.to_string()];
                return;
            }
            (stage, Ok(ready)) => match Theatre::of(ctx, &self.path, self.options.clone(), ready) {
                Ok(theatre) => *stage = Stage::Running(Box::new(theatre)),
                Err(error) => *stage = self.options.failed(ctx, &self.path, &error),
            },
            // Wrong values can be put right here.
            (Stage::Asking | Stage::Failed(_), Err(error @ OpenError::Graph(_))) => {
                form.problems = vec![error.to_string()];
                return;
            }
            (stage, Err(error)) => *stage = self.options.failed(ctx, &self.path, &error),
        }
        if let Some(folder) = &self.config
            && let Err(error) = arguments::remember(folder, &self.path, &given)
            && let Stage::Running(theatre) = &mut self.stage
        {
            theatre.notify(format!("the values were not remembered: {error}"), true);
        }
        self.given = given;
        self.form = None;
    }
}

impl Options {
    /// The plugins that the form may load to find the overlays that fit: those of the lock, where there is one.
    fn loader_for(&self, graph: &GraphText) -> Loader {
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

    fn failed(&self, ctx: &Context, path: &Path, error: &OpenError) -> Stage {
        eprintln!("{}", error.terminal_text());
        self.log_refusal(path, error);
        Stage::Failed(Box::new(OpenFailed::new(ctx, path, error, self.shot.clone())))
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
        if let Stage::Running(theatre) = &mut self.stage {
            eframe::App::on_exit(theatre.as_mut(), gl);
        }
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}
