//! The form for arguments and overlays of the graph.

use std::path::Path;

use eframe::egui::{self, Context, Frame, Key, Margin, RichText};
use panoscope_editor_model::texts::text;
use panoscope_host::loader::Loader;

use super::App;
use crate::panels::files::{Files, Target};
use panoscope_editor_model::arguments::{self, Form};
use panoscope_editor_model::document::Document;
use panoscope_editor_widgets::arguments_form::{self, FormRequest, FormStyle};
use panoscope_editor_widgets::theme;

/// A form with the current values of the graph, and where there are none with those that were given last.
pub(super) fn form(document: &Document, loader: &Loader, config: Option<&Path>) -> Form {
    let mut form = Form::new(document.path(), document.text(), &document.options(), loader);
    if let Some(remembered) = config.and_then(|folder| arguments::recall(folder, document.path())) {
        form.recall(remembered);
    }
    form
}

impl App {
    /// Opens the form.
    pub(super) fn show_arguments(&mut self) {
        let form = form(&self.document, &self.session.loader(), self.config.as_deref());
        match form.is_empty() {
            true => self.notify(text!("args-none"), false),
            false => self.arguments = Some(form),
        }
    }

    /// The open form.
    pub fn arguments(&self) -> Option<&Form> {
        self.arguments.as_ref()
    }

    /// Shows the form while it is open.
    pub(super) fn ask_arguments(&mut self, ctx: &Context) {
        let Some(mut form) = self.arguments.take() else { return };
        let frame = Frame::popup(&ctx.global_style()).inner_margin(Margin::same(24));
        let modal = egui::Modal::new("arguments".into()).backdrop_color(theme::sunk().gamma_multiply(0.5));
        let starts = !self.document.missing_args().is_empty();
        let shown = modal.frame(frame).show(ctx, |ui| {
            ui.set_width(520.0);
            ui.label(RichText::new(text!("args-heading", graph = &self.document.view().name)).size(18.0));
            let hint = if starts { text!("args-starts") } else { text!("args-applies") };
            ui.label(RichText::new(hint).size(12.0).color(theme::muted()));
            ui.add_space(2.0 * theme::STEP);
            let height = (ctx.content_rect().height() - 320.0).max(160.0);
            let style = FormStyle {
                apply: if starts { text!("args-start") } else { text!("args-apply") },
                browse: true,
                size: 13.5,
                height,
            };
            arguments_form::show(ui, &mut form, style)
        });
        let on_top = self.files.is_none();
        let enter = on_top && ctx.input_mut(|i| i.consume_key(egui::Modifiers::NONE, Key::Enter));
        match shown.inner {
            Some(FormRequest::Browse(arg)) => {
                let now = form.values.get(&arg).cloned().unwrap_or_default();
                self.files = Some(Files::new(Target::Argument { arg }, self.folder(), &now));
            }
            Some(FormRequest::Cancel) => return,
            Some(FormRequest::Apply) => return self.apply_arguments(form),
            None if enter => return self.apply_arguments(form),
            None if shown.should_close() && on_top => return,
            None => {}
        }
        self.arguments = Some(form);
    }

    /// Takes the values of a form, and remembers them. The form stays open where something is wrong.
    fn apply_arguments(&mut self, mut form: Form) {
        match form.finish() {
            Ok(given) => {
                let remembered = self.config.as_deref().map(|c| arguments::remember(c, self.document.path(), &given));
                if let Some(Err(error)) = remembered {
                    self.notify(text!("args-not-kept", reason = error.to_string()), true);
                }
                self.document.set_given(given);
            }
            Err(_) => self.arguments = Some(form),
        }
    }

    /// Puts dropped files into the open form; returns them where none is open.
    pub(super) fn drop_on_form(&mut self, files: Vec<std::path::PathBuf>) -> Vec<std::path::PathBuf> {
        let Some(form) = &mut self.arguments else { return files };
        let left = form.drop_files(files);
        if let Some(file) = left.first() {
            self.notify(text!("args-no-place", file = file.display().to_string()), true);
        }
        Vec::new()
    }
}
