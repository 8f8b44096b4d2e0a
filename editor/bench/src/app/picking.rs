//! Picks values: on an image, from the file list, from the history; and starts sweeps.

use std::path::Path;

use eframe::egui::{Context, Rect, Ui};

use super::App;
use crate::panels::files::{Files, Target};
use crate::panels::sweep::SweepRequest;
use crate::picker::{self, Picker};
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::ops;
use panoscope_editor_model::sweeping::Progress;
use panoscope_editor_model::texts::text;

impl App {
    /// Starts picking points or rectangles of a parameter on the image that they refer to.
    pub(super) fn begin_picking(&mut self, node: &str, param: &str) {
        match Picker::of(&self.document, node, param) {
            Some((picker, output)) => {
                self.view_large(output);
                self.viewer.set_picking(true);
                self.picker = Some(picker);
            }
            None => self.notify(text!("need-image", node = node), true),
        }
    }

    /// Ends picking.
    pub(super) fn end_picking(&mut self) {
        if self.picker.take().is_some() {
            self.viewer.set_picking(false);
            self.viewer.close();
        }
    }

    /// Shows the picker's handles on the image in the viewer.
    pub(super) fn pick_on(&mut self, ui: &mut Ui, image_rects: Option<(Rect, Rect)>) {
        let Some(mut picker) = self.picker.take() else { return };
        let output = self.viewed().cloned();
        let (values, output) = match (picker.values(&self.document), output) {
            (Some(values), Some(output)) => (values, output),
            // The node was removed, or the viewer was closed.
            _ => return self.viewer.set_picking(false),
        };
        let requested = image_rects
            .zip(self.shown.size(&output))
            .and_then(|((inner, bar), size)| picker.show(ui, inner, bar, size, &values));
        match requested {
            Some(picker::PickerRequest::Set(new)) => {
                let result =
                    ops::set_param(&mut self.document, &picker.node, &picker.param, Some(&picker::to_toml(&new)));
                self.try_edit(result);
                self.picker = Some(picker);
            }
            Some(picker::PickerRequest::Done) => {
                self.picker = Some(picker);
                self.end_picking();
            }
            None => self.picker = Some(picker),
        }
    }

    /// Node and parameter that are picked now.
    pub fn picked(&self) -> Option<(&str, &str)> {
        self.picker.as_ref().map(|p| (p.node.as_str(), p.param.as_str()))
    }

    /// Opens the file list for a parameter.
    pub(super) fn browse(&mut self, node: &str, param: &str) {
        let view = self.document.view();
        let now = view.node(node).and_then(|n| view.nodes[n].outline.params.get(param)?.as_str()).unwrap_or_default();
        let target = Target::Param { node: node.to_owned(), param: param.to_owned() };
        self.files = Some(Files::new(target, self.folder(), now));
    }

    /// The folder that relative paths in the graph start from.
    pub(super) fn folder(&self) -> &Path {
        self.document.path().parent().unwrap_or(Path::new(""))
    }

    /// Uses the path that was picked in the file list.
    pub(super) fn take_file(&mut self, picked: Option<String>, ctx: &Context) {
        let (Some(files), Some(path)) = (self.files.take(), picked) else { return };
        match files.target {
            Target::Param { node, param } => {
                let result = ops::set_param(&mut self.document, &node, &param, Some(&path.into()));
                self.document.end_merge();
                self.try_edit(result);
            }
            Target::Argument { arg } => {
                if let Some(form) = &mut self.arguments {
                    form.values.insert(arg, path);
                }
            }
            Target::Recording => self.sweep.recording = path,
            target @ (Target::Timeline | Target::SecondTimeline) => self.open_picked(&target, &path, ctx),
        }
    }

    /// Applies the first `at` changes of the history.
    pub(super) fn step_to(&mut self, at: usize) {
        let (now, all) = (self.document.history().at(), self.document.history().changes().len());
        if at == now || at > all {
            let message = if at > now { text!("done-newest") } else { text!("done-oldest") };
            return self.notify(message, false);
        }
        let result = ops::step_to(&mut self.document, at);
        self.try_edit(result);
    }

    /// Performs a request of the sweep panel.
    pub(super) fn handle_sweep(&mut self, request: SweepRequest) {
        match request {
            SweepRequest::Start(request, recording) => {
                let handle = self.session.handle();
                self.sweep.start(request, recording, self.session.loader(), move || handle.wake());
            }
            SweepRequest::Export(export) => self.export("sweep", export),
            SweepRequest::Browse => {
                self.files = Some(Files::new(Target::Recording, self.folder(), &self.sweep.recording));
            }
        }
    }

    /// Sets a parameter from a script's `param=value`.
    pub(super) fn set_from_script(&mut self, node: &str, setting: &str) {
        let read = |text: &str| format!("v = {text}").parse::<toml::Table>().ok()?.remove("v");
        let Some((param, value)) = setting.split_once('=').and_then(|(p, v)| Some((p, read(v)?))) else {
            return self.notify(format!("`{setting}` is not of the form PARAM=VALUE"), true);
        };
        let result = ops::set_param(&mut self.document, node, param, Some(&value));
        self.document.end_merge();
        self.try_edit(result);
    }

    /// Starts a short sweep from a script's `node.param measure`.
    pub(super) fn sweep_from_script(&mut self, setting: &str) {
        self.docks.open(Panel::Sweep);
        if let Some((param, measure)) = setting.split_once(' ')
            && let Some((node, name)) = param.split_once('.')
        {
            self.sweep.choose(&self.document, node, name);
            let request = self.sweep.quick(&self.document, self.session.path(), measure);
            self.handle_sweep(request);
        }
    }

    /// The progress of the last sweep.
    pub fn sweep(&self) -> Option<Progress> {
        self.sweep.progress()
    }
}
