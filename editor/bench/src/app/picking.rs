//! Values that are picked: on the picture, from the folders, out of the history, and those that are swept.

use std::path::Path;

use eframe::egui::{Rect, Ui};

use super::App;
use crate::panels::files::{Files, Target};
use crate::panels::sweep::Wish as SweepWish;
use crate::picker::{self, Picker};
use panoscope_editor_model::ops;
use panoscope_editor_model::sweeping::Progress;

impl App {
    /// Picks points or rectangles of a parameter on the picture that they lie in.
    pub(super) fn begin_picking(&mut self, node: &str, param: &str) {
        match Picker::of(&self.document, node, param) {
            Some((picker, output)) => {
                self.look_at(output);
                self.viewer.set_picking(true);
                self.picker = Some(picker);
            }
            None => self.tell(format!("{node} sees no picture yet: connect one, then pick"), true),
        }
    }

    /// No more picking.
    pub(super) fn end_picking(&mut self) {
        if self.picker.take().is_some() {
            self.viewer.set_picking(false);
            self.viewer.close();
        }
    }

    /// Shows the handles over the picture that stands in the viewer.
    pub(super) fn pick_on(&mut self, ui: &mut Ui, stands: Option<(Rect, Rect)>) {
        let Some(mut picker) = self.picker.take() else { return };
        let output = self.viewed().cloned();
        let (values, output) = match (picker.values(&self.document), output) {
            (Some(values), Some(output)) => (values, output),
            // The node is gone, or the viewer was closed.
            _ => return self.viewer.set_picking(false),
        };
        let asked = stands
            .zip(self.shown.size(&output))
            .and_then(|((inner, bar), size)| picker.show(ui, inner, bar, size, &values));
        match asked {
            Some(picker::Wish::Set(new)) => {
                let result =
                    ops::set_param(&mut self.document, &picker.node, &picker.param, Some(&picker::to_toml(&new)));
                self.try_edit(result);
                self.picker = Some(picker);
            }
            Some(picker::Wish::Done) => {
                self.picker = Some(picker);
                self.end_picking();
            }
            None => self.picker = Some(picker),
        }
    }

    /// The parameter that is picked on the picture.
    pub fn picked(&self) -> Option<(&str, &str)> {
        self.picker.as_ref().map(|p| (p.node.as_str(), p.param.as_str()))
    }

    /// Opens the list of files for a parameter.
    pub(super) fn browse(&mut self, node: &str, param: &str) {
        let view = self.document.view();
        let now = view.node(node).and_then(|n| view.nodes[n].outline.params.get(param)?.as_str()).unwrap_or_default();
        let target = Target::Param { node: node.to_owned(), param: param.to_owned() };
        self.files = Some(Files::new(target, self.folder(), now));
    }

    /// The folder that paths of the graph start from.
    fn folder(&self) -> &Path {
        self.document.path().parent().unwrap_or(Path::new(""))
    }

    /// Takes what was picked in the list of files.
    pub(super) fn take_file(&mut self, picked: Option<String>) {
        let (Some(files), Some(path)) = (self.files.take(), picked) else { return };
        match files.target {
            Target::Param { node, param } => {
                let result = ops::set_param(&mut self.document, &node, &param, Some(&path.into()));
                self.document.end_merge();
                self.try_edit(result);
            }
            Target::Recording => self.sweep.recording = path,
        }
    }

    /// Lets so many changes of the history be in force.
    pub(super) fn step_to(&mut self, at: usize) {
        let (now, all) = (self.document.history().at(), self.document.history().changes().len());
        if at == now || at > all {
            let words =
                if at > now { "nothing lies ahead in the history" } else { "nothing lies behind in the history" };
            return self.tell(words, false);
        }
        let result = ops::step_to(&mut self.document, at);
        self.try_edit(result);
    }

    /// Does what the sweep's panel asks for.
    pub(super) fn grant_sweep(&mut self, wish: SweepWish) {
        match wish {
            SweepWish::Start(request, recording) => {
                let handle = self.session.handle();
                self.sweep.start(request, recording, self.session.loader(), move || handle.wake());
            }
            SweepWish::Export(export) => self.export("sweep", export),
            SweepWish::Browse => {
                self.files = Some(Files::new(Target::Recording, self.folder(), &self.sweep.recording));
            }
        }
    }

    /// `param=value` of a node, as a script says it.
    pub(super) fn set_from_script(&mut self, node: &str, setting: &str) {
        let read = |text: &str| format!("v = {text}").parse::<toml::Table>().ok()?.remove("v");
        let Some((param, value)) = setting.split_once('=').and_then(|(p, v)| Some((p, read(v)?))) else {
            return self.tell(format!("`{setting}` is no PARAM=VALUE"), true);
        };
        let result = ops::set_param(&mut self.document, node, param, Some(&value));
        self.document.end_merge();
        self.try_edit(result);
    }

    /// Sweeps `param measure`, as a script says it, over few values.
    pub(super) fn sweep_from_script(&mut self, words: &str) {
        self.switches.sweep = true;
        if let Some((param, measure)) = words.split_once(' ')
            && let Some((node, name)) = param.split_once('.')
        {
            self.sweep.choose(&self.document, node, name);
            let wish = self.sweep.quick(&self.document, self.session.path(), measure);
            self.grant_sweep(wish);
        }
    }

    /// How the sweep stands that was begun last.
    pub fn sweep(&self) -> Option<Progress> {
        self.sweep.progress()
    }
}
