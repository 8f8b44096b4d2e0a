//! Performs what the user asks for: by key, button, canvas or panel.

use eframe::egui::{Context, Event, Modifiers, Vec2, vec2};
use panoscope_editor_model::texts::{language, set_language, text};
use panoscope_eval::sweep::can_sweep;

use super::App;
use super::parts::Asked;
use crate::actions::Action;
use crate::canvas::CanvasRequest;
use crate::palette::{Palette, Picked, Purpose};
use crate::panels::inspector::InspectorRequest;
use crate::panels::params::ParamRequest;
use crate::panels::states::StateRequest;
use crate::viewer::Source;
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::folding::parent;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::ops::{self, PendingWire};
use panoscope_editor_model::playing::Change;
use panoscope_editor_widgets::ARROWS;

/// Distance that an arrow key moves the view, in points.
const PAN: f32 = 64.0;
/// Distance that Shift and an arrow key move nodes, in points of the graph: two grid steps.
const NUDGE: f32 = 16.0;

impl App {
    /// Performs a request of the canvas.
    pub(super) fn handle_canvas(&mut self, request: CanvasRequest) {
        self.asked = Some(Asked::Canvas(request.clone()));
        let doc = &mut self.document;
        match request {
            CanvasRequest::Wire { output, input, moved } => {
                let from = Output::new(&output.node, &output.port);
                let moved = moved.as_ref().map(|(end, index)| (end.node.as_str(), end.port.as_str(), *index));
                let result = ops::wire(doc, &from, (&input.node, &input.port), None, moved);
                self.try_edit(result);
            }
            CanvasRequest::Unwire { input, index } => {
                let result = ops::unwire(doc, &input.node, &input.port, index);
                self.try_edit(result);
            }
            CanvasRequest::Move(places) => {
                let stored = |(id, at): (String, _)| {
                    let at = self.canvas.stored(&id, at);
                    (id, at)
                };
                let places: Vec<_> = places.into_iter().map(stored).collect();
                let result = ops::move_nodes(doc, &places);
                self.try_edit(result);
            }
            CanvasRequest::Marks { marks, moved } => {
                let stored = |(id, at): (String, _)| {
                    let at = self.canvas.stored(&id, at);
                    (id, at)
                };
                let moved: Vec<_> = moved.into_iter().map(stored).collect();
                let result = ops::set_marks(doc, &marks, &moved);
                self.try_edit(result);
            }
            CanvasRequest::Insert { node, wire } => {
                let result = ops::insert(doc, &node, (&wire.0, &wire.1, wire.2));
                self.try_edit(result);
            }
            CanvasRequest::Open { part, open } => {
                let result = ops::set_open(doc, &part, open);
                self.try_edit(result);
            }
            CanvasRequest::ViewLarge(output) => self.view_large(output),
            CanvasRequest::Add { at, end } => {
                let pending = end.map(|end| {
                    if end.input {
                        PendingWire::Input(end.node, end.port)
                    } else {
                        PendingWire::Output(Output::new(&end.node, &end.port))
                    }
                });
                self.open_palette(Purpose::Add { at: Some((at.x, at.y)), pending });
            }
            CanvasRequest::Report(error) => self.notify(error.to_string(), true),
        }
    }

    /// Performs a request of the inspector about a node.
    pub(super) fn handle_inspector(&mut self, node: &str, request: InspectorRequest) {
        self.asked = Some(Asked::Inspector(node.to_owned(), request.clone()));
        let doc = &mut self.document;
        match request {
            InspectorRequest::Sweep => {
                self.canvas.select_only(node);
                self.docks.open(Panel::Sweep);
                let swept = doc.view().node(node).and_then(|n| {
                    let params = &doc.view().nodes[n].node_type.as_ref()?.params;
                    params.iter().find(|p| can_sweep(&p.kind)).map(|p| p.name.clone())
                });
                if let Some(param) = swept {
                    self.sweep.choose(&self.document, node, &param);
                }
            }
            InspectorRequest::Param(ParamRequest::Pick(param)) => self.begin_picking(node, &param),
            InspectorRequest::Param(ParamRequest::Browse(param)) => self.browse(node, &param),
            InspectorRequest::Param(ParamRequest::Change(change)) => {
                let result = ops::set_param(doc, node, &change.param, change.value.as_ref());
                self.try_edit(result);
            }
            InspectorRequest::Input { input, index, from: Some(from) } => {
                // An index behind the end of a list adds an entry.
                let index = Some(index).filter(|i| *i != usize::MAX);
                let result = ops::wire(doc, &from, (node, &input), index, None);
                self.try_edit(result);
            }
            InspectorRequest::Input { input, index, from: None } => {
                let result = ops::unwire(doc, node, &input, index);
                self.try_edit(result);
            }
            InspectorRequest::ViewLarge(output) => self.view_large(output),
            InspectorRequest::Acknowledge => self.acknowledge(),
            InspectorRequest::Help => self.show_node_help(Some(node)),
            InspectorRequest::Source => self.open_source(Some(node)),
            InspectorRequest::Trace => {
                self.docks.open(Panel::Trace);
                self.trace_panel.choose_drop_of(node);
            }
            InspectorRequest::Probe(at) => self.panel_point = Some(at),
            InspectorRequest::Thumbnail(port) => self.canvas.choose_output(node, &port),
            InspectorRequest::Rename(name) => {
                let result = ops::rename(doc, node, &name);
                if let Some(id) = self.try_edit(result) {
                    self.canvas.select_only(&id);
                }
            }
            InspectorRequest::Go(id) => {
                self.open_parts_around(&id);
                self.canvas.show_node(&self.document.view().clone(), &id);
            }
            InspectorRequest::Open => {
                let result = ops::set_open(doc, node, true);
                self.try_edit(result);
            }
            InspectorRequest::Dissolve => {
                self.canvas.select_only(node);
                self.dissolve();
            }
        }
    }

    /// Positions of nodes as the file stores them.
    fn stored(&self, places: Vec<(String, (f32, f32))>) -> Vec<(String, (f32, f32))> {
        let stored = |(id, (x, y)): (String, (f32, f32))| {
            let at = self.canvas.stored(&id, eframe::egui::pos2(x, y));
            (id, at)
        };
        places.into_iter().map(stored).collect()
    }

    /// Shows an output in the viewer.
    pub(super) fn view_large(&mut self, output: Output) {
        if self.picker.take().is_some() {
            self.viewer.set_picking(false);
        }
        let source = self.source(output);
        self.viewer.open(source);
    }

    /// Performs an action.
    pub fn perform(&mut self, action: Action) {
        self.asked = Some(Asked::Action(action));
        match action {
            Action::OpenPart => self.open_or_fold(),
            Action::MakePart => self.name_part(),
            Action::Dissolve => self.dissolve(),
            Action::Arguments => self.show_arguments(),
            Action::Undo | Action::Redo => self.undo_or_redo(action == Action::Undo),
            Action::Save => self.save(),
            Action::Fit => self.canvas.fit(),
            Action::ZoomIn if self.viewer.viewpoint().is_some() => self.viewer.view3d().zoom_by(1.0),
            Action::ZoomOut if self.viewer.viewpoint().is_some() => self.viewer.view3d().zoom_by(-1.0),
            Action::ZoomIn => self.canvas.zoom_by(2),
            Action::ZoomOut => self.canvas.zoom_by(-2),
            Action::Delete => self.delete(),
            Action::Duplicate => self.duplicate(),
            Action::Bypass => self.bypass(),
            Action::SelectAll => self.select_all(),
            Action::Next => self.select_next(false),
            Action::NextToo => self.select_next(true),
            Action::Frame | Action::Note => self.mark(action == Action::Frame),
            Action::Align => self.align(),
            Action::Arrange => self.arrange(),
            Action::View => self.view(),
            Action::Heat => self.heat ^= true,
            Action::Back => self.step_to(self.document.history().at().saturating_sub(1)),
            Action::Forward => self.step_to(self.document.history().at() + 1),
            Action::States => self.toggle_states(),
            Action::Snapshot => self.take_snapshot(),
            Action::Record => self.record(),
            Action::Acknowledge => self.acknowledge(),
            Action::Play => self.change_playing(Change::Toggle),
            Action::TickForward => self.change_playing(Change::Step),
            Action::Loop => self.change_playing(Change::Loop),
            Action::Speed => self.change_playing(Change::Speed),
            Action::TickBack => match &self.timeline {
                Some(timeline) => timeline.step(-1),
                None => self.notify(text!("need-recording"), true),
            },
            Action::NextProblem => self.step_problem(false),
            Action::PreviousProblem => self.step_problem(true),
            Action::Restart => self.session.restart(self.document.runnable()),
            Action::Plugins => self.plugins = true,
            Action::Reload => self.session.reload_plugins(),
            Action::Escape => self.escape(),
            Action::Add => self.open_palette(Purpose::Add { at: None, pending: None }),
            Action::Connect => self.connect(),
            Action::Find => self.open_palette(Purpose::Find),
            Action::Theme => self.change_theme = true,
            Action::Language => self.change_language(),
            Action::Commands => self.open_palette(Purpose::Command),
            Action::Help => self.help = true,
            Action::Guide => self.start_guide(),
            Action::NodeHelp => self.toggle_node_help(),
            Action::Source => self.open_source(self.selected().as_deref()),
            Action::Compare => self.compare(),
            Action::Text
            | Action::Plots
            | Action::History
            | Action::Sweep
            | Action::Problems
            | Action::Timeline
            | Action::Trace
            | Action::NodePanel
            | Action::Overview
            | Action::ViewerBeside
            | Action::NextPanel
            | Action::PreviousPanel
            | Action::PanelLeft
            | Action::PanelRight
            | Action::PanelAbove
            | Action::PanelBelow
            | Action::PanelLarger
            | Action::PanelSmaller
            | Action::TearOff
            | Action::ClosePanel
            | Action::ResetLayout => self.perform_on_panel(action),
        }
    }

    fn undo_or_redo(&mut self, is_undo: bool) {
        let step = if is_undo { self.document.undo() } else { self.document.redo() };
        if let Some(step) = step {
            self.notify(
                if is_undo { text!("done-undone", step = step) } else { text!("done-redone", step = step) },
                false,
            );
        }
    }

    fn select_all(&mut self) {
        self.canvas.selected = self.document.view().nodes.iter().map(|n| n.id().to_owned()).collect();
    }

    /// Puts a frame around the selection, or a note.
    fn mark(&mut self, is_frame: bool) {
        let marks = if is_frame { self.canvas.frame_selection() } else { self.canvas.add_note() };
        let result = ops::set_marks(&mut self.document, &marks, &[]);
        self.try_edit(result);
    }

    fn take_snapshot(&mut self) {
        self.states.load(self.document.path());
        self.handle_state(StateRequest::Take);
    }

    fn connect(&mut self) {
        match self.selected() {
            Some(node) => self.open_palette(Purpose::Connect { node }),
            None => self.notify(text!("need-one-node"), true),
        }
    }

    fn change_language(&mut self) {
        set_language(language().next());
        self.notify(text!("language-now"), false);
    }

    /// Aligns the selected nodes.
    fn align(&mut self) {
        let places = self.stored(self.canvas.aligned());
        if places.len() > 1 {
            let result = ops::move_nodes(&mut self.document, &places);
            self.try_edit(result);
        } else {
            self.notify(text!("need-two-nodes"), true);
        }
    }

    /// Closes the uppermost of what is open, or clears the selection.
    fn escape(&mut self) {
        if self.picker.is_some() {
            return self.end_picking();
        }
        let closed = self.end_guide() || self.node_help.take().is_some() || self.close_tour();
        if !closed && !self.viewer.clear_line() && !self.viewer.close() {
            self.canvas.selected.clear();
            self.canvas.selected_wire = None;
        }
    }

    /// An output with its packet type.
    pub(super) fn source(&self, output: Output) -> Source {
        let view = self.document.view();
        let packet = view.packet_of(&output).map(|p| p.name.clone());
        Source { output, packet: packet.unwrap_or_default() }
    }

    /// Compares the output in the viewer with the next one, and after the last one with none.
    fn compare(&mut self) {
        let Some(shown) = self.viewer.source().cloned() else { return };
        let second = self.of_second_run(&shown);
        let others = second.into_iter().chain(self.sources().into_iter().filter(|s| *s != shown));
        let others: Vec<Source> = others.collect();
        let now = self.viewer.sources().nth(1).and_then(|b| others.iter().position(|o| o == b));
        let next = others.get(now.map_or(0, |n| n + 1)).cloned();
        self.viewer.compare(next);
    }

    fn open_palette(&mut self, purpose: Purpose) {
        if matches!(purpose, Purpose::Add { .. }) {
            let handle = self.session.handle();
            self.types.gather(self.session.loader(), self.document.path(), move || handle.wake());
        }
        self.palette = Some(Palette::new(purpose));
    }

    /// Performs what was picked in the palette.
    pub(super) fn pick(&mut self, picked: Picked) {
        match picked {
            Picked::Add(node_type, at, pending) => {
                let place = at.map_or_else(|| self.canvas.place_for_new(), |(x, y)| eframe::egui::pos2(x, y));
                // Beside the node that it is connected to, else where the pointer is.
                let part = match &pending {
                    Some(PendingWire::Output(output)) => parent(&output.node).to_owned(),
                    Some(PendingWire::Input(node, _)) => parent(node).to_owned(),
                    None => self.canvas.part_at(place),
                };
                let stored = self.canvas.stored(&format!("{part}/"), place);
                let at = at.or_else(|| self.place_among(&part)).map(|_| stored);
                let result = ops::add(&mut self.document, &part, &node_type, at, pending.as_ref());
                let added = self.try_edit(result);
                self.show_added(added);
            }
            Picked::AddPart(file, at) => {
                let at = at.or_else(|| self.place_among(""));
                let result = ops::add_part(&mut self.document, &file, at);
                let added = self.try_edit(result);
                self.show_added(added);
            }
            Picked::ConnectAll(wires) => {
                let result = ops::connect_all(&mut self.document, &wires);
                if self.try_edit(result).is_some() {
                    let ends = wires.into_iter().map(|(from, (node, input))| format!("{node}.{input}: {from}"));
                    self.notify(text!("done-connected", wires = ends.collect::<Vec<_>>().join(", ")), false);
                }
            }
            Picked::Connect(node, input, from) => {
                self.handle_inspector(&node, InspectorRequest::Input { input, index: usize::MAX, from: Some(from) })
            }
            Picked::Go(id) => self.canvas.show_node(&self.document.view().clone(), &id),
            Picked::Perform(action) => self.perform(action),
            Picked::Param(node, param) => {
                self.open_parts_around(&node);
                self.canvas.show_node(&self.document.view().clone(), &node);
                self.docks.open(Panel::Node);
                self.go_to_param = Some((node, param));
            }
        }
    }

    /// A position for a new node of a part, or of the graph where `part` is empty; `None` where all of its nodes are laid out automatically.
    fn place_among(&self, part: &str) -> Option<(f32, f32)> {
        ops::is_placed_by_hand(self.document.view(), part).then(|| self.canvas.place_for_new().into())
    }

    /// Selects an added node and moves the view to it.
    fn show_added(&mut self, added: Option<String>) {
        let Some(id) = added else { return };
        self.make_room(std::slice::from_ref(&id));
        self.canvas.select_only(&id);
        self.canvas.keep_in_view(&self.document.view().clone(), self.document.revision(), &id);
    }

    /// Arranges the selected nodes along the flow, or all nodes where fewer than two are selected.
    fn arrange(&mut self) {
        let count = if self.canvas.selected.len() > 1 {
            let places = self.stored(self.canvas.arranged(self.document.view()));
            let count = places.len();
            let result = ops::move_nodes(&mut self.document, &places);
            self.try_edit(result).map(|()| count)
        } else {
            let result = ops::arrange_all(&mut self.document);
            self.canvas.fit();
            self.try_edit(result)
        };
        match count {
            Some(0) => self.notify(text!("done-arranged-already"), false),
            Some(count) => self.notify(text!("done-arranged", count = count), false),
            None => {}
        }
    }

    /// Moves added nodes so that they do not overlap others, as part of the same undo step.
    pub(super) fn make_room(&mut self, added: &[String]) {
        let view = self.document.view().clone();
        let by = self.canvas.offset_to_free_space(&view, self.document.revision(), added);
        if by == Vec2::ZERO {
            return;
        }
        let result = self.document.amend(|edit| {
            for id in added.iter().filter(|id| parent(id).is_empty()) {
                if let Some((x, y)) = view.node(id).and_then(|n| view.nodes[n].position) {
                    edit.set_position(id, f64::from(x + by.x), f64::from(y + by.y));
                }
            }
            Ok(())
        });
        self.try_edit(result);
    }

    /// Copies, cuts and pastes nodes as text.
    pub(super) fn clipboard(&mut self, ctx: &Context, typing: bool) {
        if typing {
            return;
        }
        let events = ctx.input(|i| i.events.clone());
        for event in events {
            match event {
                Event::Copy | Event::Cut if !self.canvas.selected.is_empty() => {
                    let nodes: Vec<String> = self.canvas.selected.iter().cloned().collect();
                    let result = ops::copy(&self.document, &nodes);
                    if let Some(text) = self.try_edit(result) {
                        ctx.copy_text(text);
                        if event == Event::Cut {
                            self.delete();
                        }
                    }
                }
                Event::Paste(text) => {
                    let at = self.place_among("").map(|_| self.canvas.middle().into());
                    let result = ops::paste(&mut self.document, &text, at);
                    if let Some(names) = self.try_edit(result) {
                        self.make_room(&names);
                        self.canvas.selected = names.into_iter().collect();
                    }
                }
                _ => {}
            }
        }
    }

    /// Arrow keys move the view, with Shift the selected nodes. While the viewer is open, it gets the arrow keys.
    pub(super) fn arrows(&mut self, ctx: &Context, typing: bool) {
        let by_viewer = self.viewer.source().is_some()
            && (!self.docks.layout.viewer_beside || self.docks.focused() == Panel::Viewer);
        if typing || by_viewer || ctx.memory(|m| m.focused().is_some()) {
            return;
        }
        for (key, [x, y]) in ARROWS {
            let direction = vec2(x, y);
            if ctx.input_mut(|i| i.consume_key(Modifiers::SHIFT, key)) {
                let places = self.stored(self.canvas.nudged(direction * NUDGE));
                let result = ops::nudge_nodes(&mut self.document, &places);
                self.try_edit(result);
            } else if ctx.input_mut(|i| i.consume_key(Modifiers::NONE, key)) {
                self.canvas.pan_by(direction * -PAN);
            }
        }
    }

    fn view(&mut self) {
        self.end_picking();
        if self.viewer.close() {
            return;
        }
        let view = self.document.view().clone();
        let of_selected = || {
            let node = self.canvas.selected.iter().next().and_then(|id| view.node(id))?;
            Some(self.canvas.shown_output(&view, node)?.0)
        };
        if let Some(output) = self.canvas.under_pointer.clone().or_else(of_selected) {
            self.view_large(output);
        }
    }

    /// Selects the node after the last selected one; `extend` keeps the current selection.
    fn select_next(&mut self, extend: bool) {
        let view = self.document.view().clone();
        let now = self.canvas.selected.iter().filter_map(|id| view.node(id)).max();
        let next = now.map_or(0, |n| (n + 1) % view.nodes.len().max(1));
        match view.nodes.get(next) {
            Some(node) if extend => drop(self.canvas.selected.insert(node.id().to_owned())),
            Some(node) => self.canvas.select_only(node.id()),
            None => {}
        }
    }

    fn delete(&mut self) {
        if let Some((node, input, index)) = self.canvas.selected_wire.take() {
            let result = ops::unwire(&mut self.document, &node, &input, index);
            self.try_edit(result);
            return;
        }
        if let Some(marks) = self.canvas.without_selected_mark() {
            let result = ops::set_marks(&mut self.document, &marks, &[]);
            self.try_edit(result);
            return;
        }
        let nodes: Vec<String> = self.canvas.selected.iter().cloned().collect();
        if !nodes.is_empty() {
            let result = ops::remove(&mut self.document, &nodes);
            self.try_edit(result);
        }
    }

    fn duplicate(&mut self) {
        let canvas = &self.canvas;
        let place = |id: &String| {
            let at = canvas.stored(id, canvas.position(id)?);
            Some((id.clone(), self.place_among(parent(id)).map(|_| at)))
        };
        let nodes: Vec<(String, Option<(f32, f32)>)> = canvas.selected.iter().filter_map(place).collect();
        if nodes.is_empty() {
            return;
        }
        let result = ops::duplicate(&mut self.document, &nodes);
        if let Some(copies) = self.try_edit(result) {
            self.make_room(&copies);
            self.canvas.selected = copies.into_iter().collect();
        }
    }

    fn bypass(&mut self) {
        for id in self.canvas.selected.clone() {
            if let Some(detours) = self.detours.remove(&id) {
                let result = ops::end_bypass(&mut self.document, &id, &detours);
                // The bypass was undone already, so it is started again.
                if self.try_edit(result) != Some(false) {
                    continue;
                }
            }
            let result = ops::bypass(&mut self.document, &id);
            if let Some(detours) = self.try_edit(result) {
                self.notify(text!("done-bypassed", node = &id), false);
                self.detours.insert(id, detours);
            }
        }
    }
}
