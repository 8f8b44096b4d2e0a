//! Presets and snapshots: stores, applies, morphs, goes back.

use super::App;
use super::parts::Asked;
use crate::panels::states::StateRequest;
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::presets::{self, Changes};
use panoscope_editor_model::snapshots;
use panoscope_editor_model::texts::text;

impl App {
    /// Shows or hides the panel of presets and snapshots; reads their files when it opens.
    pub(super) fn toggle_states(&mut self) {
        if self.docks.toggle(Panel::States) {
            self.states.load(self.document.path());
        }
    }

    /// Performs a request of the panel.
    pub(super) fn handle_state(&mut self, request: StateRequest) {
        self.asked = Some(Asked::State(request.clone()));
        match request {
            StateRequest::Store(name) => {
                let result = self.states.presets.store(&name, self.document.view());
                match result {
                    Ok(()) => self.notify(text!("done-preset", name = name.trim()), false),
                    Err(error) => self.notify(error.to_string(), true),
                }
            }
            StateRequest::Apply(name) => {
                let preset = self.states.presets.get(&name).map(|preset| preset.values.clone());
                match preset {
                    Ok(values) => {
                        let changes = presets::changes_to(self.document.view(), &values);
                        self.apply_values(&format!("preset {name}"), None, &changes);
                    }
                    Err(error) => self.notify(error.to_string(), true),
                }
            }
            StateRequest::Remove(name) => {
                let result = self.states.presets.remove(&name);
                self.report_result(result);
            }
            StateRequest::Morph(from, to, share) => {
                let ends = (self.states.presets.get(&from), self.states.presets.get(&to));
                let (Ok(a), Ok(b)) = ends else { return };
                let values = presets::between(self.document.view(), a, b, share);
                let changes = presets::changes_to(self.document.view(), &values);
                let label = format!("morph {from} to {to}");
                self.apply_values(&label, Some(&label), &changes);
            }
            StateRequest::Take => match self.states.snapshots.take(&self.document) {
                Ok(number) => {
                    let picture = self.picture_of_now().and_then(|output| self.shown.pixels(&output)).cloned();
                    self.states.store_picture(number, picture.as_ref());
                    self.notify(text!("done-snapshot", number = number), false);
                }
                Err(error) => self.notify(error.to_string(), true),
            },
            StateRequest::Restore(number) => {
                let Some(snapshot) = self.states.snapshots.get(number).cloned() else { return };
                match snapshots::restore(&mut self.document, &snapshot) {
                    true => self.notify(text!("done-restored", number = number), false),
                    false => self.notify(text!("done-restored-already", number = number), false),
                }
            }
            StateRequest::Drop(number) => {
                let result = self.states.snapshots.remove(number);
                self.report_result(result);
            }
        }
    }

    fn report_result<E: std::fmt::Display>(&mut self, result: Result<(), E>) {
        if let Err(error) = result {
            self.notify(error.to_string(), true);
        }
    }

    fn apply_values(&mut self, label: &str, merge: Option<&str>, changes: &Changes) {
        let result = presets::apply(&mut self.document, label, merge, changes);
        if self.try_edit(result).is_some() && !changes.skipped.is_empty() {
            let (count, first) = (changes.skipped.len(), &changes.skipped[0]);
            let words = match count {
                1 => text!("done-left-out", step = label, first = first),
                count => text!("done-left-out-more", step = label, first = first, count = count - 1),
            };
            self.notify(words, true);
        }
    }

    /// The output whose picture stands for the graph: the one in the viewer, of the selected node, or the last one along the flow.
    pub(super) fn picture_of_now(&self) -> Option<Output> {
        let has_pixels = |output: &Output| self.shown.pixels(output).is_some_and(|p: &Pixels| p.width > 0);
        let view = self.document.view();
        let of_node = |n: usize| self.canvas.shown_output(view, n).map(|(output, _)| output);
        let selected = self.selected().and_then(|id| view.node(&id)).and_then(of_node);
        let viewed = self.viewer.source().map(|source| source.output.clone());
        // The rightmost and lowest node is the last one along the flow.
        let mut nodes: Vec<usize> = (0..view.nodes.len()).collect();
        let at = |n: &usize| self.canvas.position(view.nodes[*n].id()).unwrap_or_default();
        nodes.sort_by(|a, b| (at(b).y, at(b).x).partial_cmp(&(at(a).y, at(a).x)).unwrap_or(std::cmp::Ordering::Equal));
        viewed.into_iter().chain(selected).chain(nodes.into_iter().filter_map(of_node)).find(has_pixels)
    }
}
