//! Parts: opened and folded, made of the selection, dissolved; and the question before a part changes that is used several times.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use eframe::egui::text::{CCursor, CCursorRange};
use eframe::egui::text_edit::TextEditState;
use eframe::egui::{self, Context, Frame, Key, Margin, RichText, TextEdit};
use panoscope_editor_model::texts::text;
use panoscope_graph::edit::EditError;

use super::App;
use crate::actions::Action;
use crate::canvas::CanvasRequest;
use crate::panels::inspector::InspectorRequest;
use crate::panels::states::StateRequest;
use panoscope_editor_model::graph_view::PartView;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::ops;
use panoscope_editor_widgets::theme;

/// What the user asked for.
#[derive(Clone, Debug)]
pub(super) enum Asked {
    Canvas(CanvasRequest),
    Inspector(String, InspectorRequest),
    Action(Action),
    State(StateRequest),
}

/// A change of a part that is used several times.
pub(super) struct Consent {
    file: PathBuf,
    users: Vec<String>,
    asked: Asked,
}

impl App {
    /// Opens or folds the selected part. A selected node of an opened part folds the part.
    pub(super) fn open_or_fold(&mut self) {
        let view = self.document.view().clone();
        let around = |id: &str| view.part(panoscope_editor_model::folding::parent(id)).map(|p| (p.id.clone(), false));
        let chosen = self.selected().and_then(|id| match view.part(&id) {
            Some(part) => Some((part.id.clone(), !part.open)),
            None => around(&id),
        });
        let Some((part, open)) = chosen else { return self.notify(text!("part-select-open"), true) };
        let result = ops::set_open(&mut self.document, &part, open);
        if self.try_edit(result).is_some() {
            self.canvas.select_only(&part);
        }
    }

    /// Opens the folded parts that a node is inside of, so that it is shown.
    pub(super) fn open_parts_around(&mut self, node: &str) {
        loop {
            let view = self.document.view().clone();
            let around = |part: &&PartView| {
                !part.open && node.strip_prefix(part.id.as_str()).is_some_and(|rest| rest.starts_with('/'))
            };
            let Some(part) = view.parts.iter().find(around).filter(|_| view.node(node).is_none()) else { break };
            let result = ops::set_open(&mut self.document, &part.id, true);
            if self.try_edit(result).is_none() {
                break;
            }
        }
        self.canvas.keep_in_view(&self.document.view().clone(), self.document.revision(), node);
    }

    /// Asks for the name of a part of the selected nodes.
    pub(super) fn name_part(&mut self) {
        match self.canvas.selected.is_empty() {
            true => self.notify(text!("part-select-nodes"), true),
            false => self.part_name = Some((ops::free_name(self.document.view(), "", "part"), false)),
        }
    }

    /// Shows the question for the name of a new part.
    pub(super) fn ask_part_name(&mut self, ctx: &Context) {
        let Some((mut name, shown)) = self.part_name.take() else { return };
        let frame = Frame::popup(&ctx.global_style()).inner_margin(Margin::same(24));
        let modal = egui::Modal::new("part name".into()).backdrop_color(theme::sunk().gamma_multiply(0.5));
        let (mut done, mut cancel) = (false, false);
        let answer = modal.frame(frame).show(ctx, |ui| {
            ui.set_width(420.0);
            ui.label(RichText::new(text!("part-heading", count = self.canvas.selected.len())).size(18.0));
            ui.add_space(theme::STEP);
            let field =
                ui.add(TextEdit::singleline(&mut name).desired_width(f32::INFINITY).hint_text(text!("part-name.hint")));
            ui.ctx().accesskit_node_builder(field.id, |node| node.set_label(text!("part-name")));
            if !shown {
                field.request_focus();
                // The proposed name is replaced by typing.
                let mut state = TextEditState::load(ui.ctx(), field.id).unwrap_or_default();
                let all = CCursorRange::two(CCursor::new(0), CCursor::new(name.chars().count()));
                state.cursor.set_char_range(Some(all));
                state.store(ui.ctx(), field.id);
            }
            done |= field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter));
            let file = ops::part_file(&self.document, &name);
            let caption = text!("part-writes", file = file.display().to_string());
            ui.label(RichText::new(caption).size(12.0).color(theme::muted()));
            ui.add_space(theme::STEP);
            ui.horizontal(|ui| {
                done |= ui.button(text!("part-make")).clicked();
                cancel |= ui.button(text!("part-cancel")).clicked();
            });
        });
        if done {
            let nodes: Vec<String> = self.canvas.selected.iter().cloned().collect();
            let result = ops::make_part(&mut self.document, &nodes, name.trim());
            match self.try_edit(result) {
                Some(id) => {
                    self.make_room(std::slice::from_ref(&id));
                    self.canvas.select_only(&id);
                }
                // The error is shown; another name may do.
                None if self.consent.is_none() => self.part_name = Some((name, true)),
                None => {}
            }
        } else if !cancel && !answer.should_close() {
            self.part_name = Some((name, true));
        }
    }

    /// Puts the nodes of the selected part in its place.
    pub(super) fn dissolve(&mut self) {
        let part = self.selected().filter(|id| self.document.view().part(id).is_some());
        let Some(part) = part else { return self.notify(text!("part-select-dissolve"), true) };
        let result = ops::dissolve(&mut self.document, &part);
        if let Some(nodes) = self.try_edit(result) {
            self.notify(text!("part-dissolved", part = part), false);
            self.canvas.selected = nodes.into_iter().collect();
        }
    }

    /// Keeps a refused change of a part that is used several times, so that the user can allow it.
    pub(super) fn hold_for_consent(&mut self, error: &EditError) -> bool {
        let EditError::SharedPart { file, users } = error else { return false };
        let Some(asked) = self.asked.clone() else { return false };
        self.consent = Some(Consent { file: file.clone(), users: users.clone(), asked });
        true
    }

    /// Asks before a part changes that is used several times.
    pub(super) fn ask_consent(&mut self, ctx: &Context) {
        let Some(consent) = &self.consent else { return };
        let name = consent.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (count, users) = (consent.users.len(), consent.users.join(", "));
        let frame = Frame::popup(&ctx.global_style()).inner_margin(Margin::same(24));
        let modal = egui::Modal::new("shared part".into()).backdrop_color(theme::sunk().gamma_multiply(0.5));
        let (mut yes, mut no) = (false, false);
        let answer = modal.frame(frame).show(ctx, |ui| {
            ui.set_width(460.0);
            ui.label(RichText::new(text!("part-used", part = name, count = count)).size(18.0));
            ui.label(text!("part-applies", users = users));
            let others = text!("part-others");
            ui.label(RichText::new(others).size(12.0).color(theme::muted()));
            ui.add_space(theme::STEP);
            ui.horizontal(|ui| {
                yes = ui.button(text!("part-change-all", count = count)).clicked();
                no = ui.button(text!("part-cancel")).clicked();
            });
        });
        if yes {
            let Some(consent) = self.consent.take() else { return };
            self.document.allow_shared(&consent.file);
            match consent.asked {
                Asked::Canvas(request) => self.handle_canvas(request),
                Asked::State(request) => self.handle_state(request),
                Asked::Inspector(node, request) => self.handle_inspector(&node, request),
                Asked::Action(action) => self.perform(action),
            }
        } else if no || answer.should_close() {
            self.consent = None;
        }
    }

    /// The counters of the nodes, and of each folded part: the times of its nodes added up, their rate and age as those of the slowest.
    pub(super) fn summed_counters(&mut self) -> Arc<Counters> {
        let (counters, revision) = (self.observer.counters(), self.document.revision());
        let view = self.document.view();
        if !view.nodes.iter().any(|n| n.is_part) {
            return counters;
        }
        if let Some((of, at, summed)) = &self.summed
            && Arc::ptr_eq(of, &counters)
            && *at == revision
        {
            return Arc::clone(summed);
        }
        let mut summed = Counters::clone(&counters);
        let mut faults = HashMap::new();
        for part in view.nodes.iter().filter(|n| n.is_part) {
            let inside = |id: &str| id.strip_prefix(part.id()).is_some_and(|rest| rest.starts_with('/'));
            let nodes: Vec<_> = counters.nodes.iter().filter(|(id, _)| inside(id)).map(|(_, c)| c).collect();
            let Some(first) = nodes.first() else { continue };
            let mut sum = (*first).clone();
            sum.metrics.clear();
            for node in &nodes[1..] {
                sum.p50_ms += node.p50_ms;
                sum.p99_ms += node.p99_ms;
                sum.fps = sum.fps.min(node.fps);
                sum.count = sum.count.min(node.count);
                sum.dropped += node.dropped;
                sum.faults += node.faults;
                sum.restarts += node.restarts;
                sum.copies += node.copies;
                sum.age_p50_ms = [sum.age_p50_ms, node.age_p50_ms].into_iter().flatten().reduce(f64::max);
                sum.age_p99_ms = [sum.age_p99_ms, node.age_p99_ms].into_iter().flatten().reduce(f64::max);
            }
            summed.nodes.insert(part.id().to_owned(), sum);
            let newest = counters.faults.iter().filter(|(id, _)| inside(id)).max_by_key(|(_, fault)| fault.unix_ms);
            if let Some((_, fault)) = newest {
                faults.insert(part.id().to_owned(), fault.clone());
            }
        }
        summed.faults.extend(faults);
        let summed = Arc::new(summed);
        self.summed = Some((counters, revision, Arc::clone(&summed)));
        summed
    }
}
