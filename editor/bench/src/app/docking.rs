//! Draws the panels in their docks and windows, and handles the keys of docks.

use std::collections::HashMap;

use eframe::egui::{
    Context, Rect, RichText, Sense, Ui, UiBuilder, Vec2, ViewportBuilder, ViewportClass, ViewportId, WidgetInfo,
    WidgetType, vec2,
};
use panoscope_editor_model::docks::{Layout, Panel, Side, Window};
use panoscope_editor_model::texts::text;

use super::App;
use crate::actions::{self, Action};
use crate::canvas::Scene;
use crate::docks::{DockRequest, Docks, STEP, title};
use crate::panels::inspector::{self, InspectorRequest};
use crate::panels::{below, history, overview, params};
use panoscope_editor_model::observe::{Counters, Output};
use panoscope_editor_model::session::{Phase, Status};
use panoscope_editor_model::timeline::Held;
use panoscope_editor_widgets::theme;

/// The panel that an action opens or closes.
fn toggled_by(action: Action) -> Option<Panel> {
    Some(match action {
        Action::Text => Panel::Text,
        Action::Plots => Panel::Plots,
        Action::History => Panel::History,
        Action::Sweep => Panel::Sweep,
        Action::Problems => Panel::Problems,
        Action::Timeline => Panel::Timeline,
        Action::Trace => Panel::Trace,
        Action::NodePanel => Panel::Node,
        Action::Overview => Panel::Overview,
        _ => return None,
    })
}

impl App {
    /// The docks of the window.
    pub fn docks(&self) -> &Docks {
        &self.docks
    }

    /// Whether the panel or mode of an action is on.
    pub(super) fn is_on(&self, action: Action) -> bool {
        let panel = match action {
            Action::Heat => return self.heat,
            Action::Sweep => Panel::Sweep,
            Action::States => Panel::States,
            Action::History => Panel::History,
            Action::Plots => Panel::Plots,
            Action::Text => Panel::Text,
            Action::Problems => Panel::Problems,
            _ => return false,
        };
        self.docks.is_shown(panel)
    }

    /// Opens and closes the panels that follow what they show.
    fn follow_contents(&mut self) {
        self.follow_selection();
        let viewed = self.viewer.source().is_some() && self.docks.layout.viewer_beside;
        let contents =
            [(Panel::Source, self.source.is_some()), (Panel::Help, self.node_help.is_some()), (Panel::Viewer, viewed)];
        for (panel, has_content) in contents {
            match (has_content, self.docks.layout.is_open(panel)) {
                (true, false) => self.docks.open(panel),
                (false, true) => self.docks.layout.close(panel),
                _ => {}
            }
        }
    }

    /// Draws the docks into the remaining space.
    pub(super) fn show_docks(&mut self, ui: &mut Ui, status: &Status, counters: &Counters) {
        self.follow_contents();
        let whole = ui.available_rect_before_wrap();
        ui.allocate_rect(whole, Sense::hover());
        let titles = self.titles();
        let (panels, mut requests) = self.docks.begin(ui, whole, &titles);
        for (panel, rect) in panels {
            self.show_panel(ui, panel, rect, status, counters);
        }
        requests.extend(self.docks.end(ui, whole));
        let corner = ui.ctx().input(|i| i.viewport().inner_rect).map_or(Vec2::ZERO, |rect| rect.min.to_vec2());
        for request in requests {
            match request {
                DockRequest::Close(panel) => self.close_panel(panel),
                DockRequest::TearOff(panel, [x, y]) => {
                    self.tear_off(panel, [x as f32 + corner.x, y as f32 + corner.y]);
                }
            }
        }
    }

    /// Names on tabs that say more than the panel's own name.
    fn titles(&self) -> HashMap<Panel, String> {
        let mut titles = HashMap::new();
        if self.selected().is_none() && !self.docks.is_shown(Panel::Overview) {
            titles.insert(Panel::Node, title(Panel::Overview).to_owned());
        }
        let wrong = self.document.view().diagnostics.len();
        if wrong > 0 {
            titles.insert(Panel::Problems, text!("panel-problems.count", count = wrong));
        }
        titles
    }

    fn tear_off(&mut self, panel: Panel, at: [f32; 2]) {
        if self.docks.layout.tear_off(panel, at) {
            self.docks.focus(panel);
        } else if panel == Panel::Graph {
            self.notify(text!("dock-graph-stays"), true);
        }
    }

    fn close_panel(&mut self, panel: Panel) {
        match panel {
            Panel::Graph => self.notify(text!("dock-graph-open"), true),
            Panel::Source => self.close_source(),
            Panel::Help => self.node_help = None,
            Panel::Viewer => {
                self.end_picking();
                self.viewer.close();
            }
            _ => self.docks.layout.close(panel),
        }
    }

    /// Performs an action on the panel that has the keys.
    pub(super) fn perform_on_panel(&mut self, action: Action) {
        if let Some(panel) = toggled_by(action) {
            self.docks.toggle(panel);
            return;
        }
        let panel = self.docks.focused();
        let name = title(panel);
        let done = match action {
            Action::NextPanel | Action::PreviousPanel => {
                self.docks.focus_next(action == Action::PreviousPanel);
                let now = title(self.docks.focused());
                return self.notify(text!("dock-keys", panel = now), false);
            }
            Action::ResetLayout => {
                let open = self.docks.layout.open.clone();
                self.docks.layout = Layout { open, ..Layout::default() };
                return self.notify(text!("dock-reset"), false);
            }
            Action::ViewerBeside => {
                self.docks.layout.viewer_beside ^= true;
                let words = match self.docks.layout.viewer_beside {
                    true => text!("dock-viewer-beside"),
                    false => text!("dock-viewer-over"),
                };
                return self.notify(words, false);
            }
            Action::ClosePanel => return self.close_panel(panel),
            Action::TearOff => {
                if !self.docks.layout.dock(panel) {
                    let at = self.docks.rect(panel).unwrap_or(Rect::ZERO).min;
                    self.tear_off(panel, [at.x + 24.0, at.y + 24.0]);
                }
                return;
            }
            Action::PanelLeft => self.docks.layout.move_beside_graph(panel, Side::Left),
            Action::PanelRight => self.docks.layout.move_beside_graph(panel, Side::Right),
            Action::PanelAbove => self.docks.layout.move_beside_graph(panel, Side::Above),
            Action::PanelBelow => self.docks.layout.move_beside_graph(panel, Side::Below),
            Action::PanelLarger => self.docks.layout.grow(panel, STEP),
            Action::PanelSmaller => self.docks.layout.grow(panel, -STEP),
            _ => true,
        };
        if !done {
            let words = match panel {
                Panel::Graph => text!("dock-choose").to_owned(),
                _ => text!("dock-already", panel = name),
            };
            self.notify(words, true);
        }
    }

    /// Draws the panels that have windows of their own.
    ///
    /// `windows` are those at the beginning of the frame: a panel is drawn once in a frame.
    pub(super) fn show_windows(&mut self, ctx: &Context, windows: &[Window], status: &Status, counters: &Counters) {
        for window in windows {
            let panel = window.panel;
            let name = format!("{} - {}", title(panel), self.document.view().name);
            let builder = ViewportBuilder::default()
                .with_title(name)
                .with_app_id("panoscope-editor")
                .with_position(window.at)
                .with_inner_size(window.size);
            let id = ViewportId::from_hash_of(("panel", panel));
            ctx.show_viewport_immediate(id, builder, |ui, class| {
                self.show_window(ui, panel, class, status, counters);
            });
        }
    }

    fn show_window(&mut self, ui: &mut Ui, panel: Panel, class: ViewportClass, status: &Status, counters: &Counters) {
        let ctx = ui.ctx().clone();
        let is_own = class != ViewportClass::EmbeddedWindow;
        if is_own {
            // A window of the system has its own keys and place.
            let typing = ctx.text_edit_focused();
            for action in ctx.input_mut(|input| actions::pressed(input, typing)) {
                self.docks.focus(panel);
                self.perform(action);
            }
            let (closed, rect, focused) = ctx.input(|i| {
                let viewport = i.viewport();
                (viewport.close_requested(), viewport.inner_rect.zip(viewport.outer_rect), viewport.focused)
            });
            if let Some((inner, outer)) = rect {
                self.docks.follow_window(panel, outer.min, inner.size());
            }
            if focused == Some(true) && ctx.input(|i| i.pointer.any_pressed()) {
                self.docks.focus(panel);
            }
            if closed {
                self.close_panel(panel);
                return;
            }
        } else if ctx.input(|i| i.pointer.any_pressed()) && ui.ui_contains_pointer() {
            self.docks.focus(panel);
        }
        let rect = ui.available_rect_before_wrap();
        ui.allocate_rect(rect, Sense::hover());
        let bar = rect.with_max_y(rect.top() + 32.0);
        ui.painter().rect_filled(rect, 0.0, theme::panel());
        let row = UiBuilder::new().max_rect(bar.shrink2(vec2(12.0, 4.0)));
        let (mut back, mut close) = (false, false);
        ui.scope_builder(row, |ui| {
            ui.horizontal(|ui| {
                let name = title(panel);
                let button = |ui: &mut Ui, caption: &str, action: Action| {
                    let button = ui.button(caption).on_hover_text(actions::hint(action));
                    let label = || {
                        WidgetInfo::labeled(
                            WidgetType::Button,
                            true,
                            text!("panel-button", button = caption, panel = name),
                        )
                    };
                    button.widget_info(label);
                    button.clicked()
                };
                back = button(ui, text!("panel-dock"), Action::TearOff);
                close = button(ui, text!("panel-shut"), Action::ClosePanel);
            });
        });
        self.show_panel(ui, panel, rect.with_min_y(bar.bottom()), status, counters);
        if back {
            self.docks.layout.dock(panel);
        }
        if close {
            self.close_panel(panel);
        }
    }

    /// Draws a panel in a rectangle.
    fn show_panel(&mut self, ui: &mut Ui, panel: Panel, rect: Rect, status: &Status, counters: &Counters) {
        let margin = match panel {
            Panel::Graph | Panel::Viewer => Vec2::ZERO,
            Panel::Node | Panel::Overview => Vec2::splat(16.0),
            _ => vec2(16.0, 12.0),
        };
        if margin != Vec2::ZERO {
            ui.painter().rect_filled(rect, 0.0, theme::panel());
        }
        let inner = rect.shrink2(margin.min(rect.size() / 2.0));
        let mut child = ui.new_child(UiBuilder::new().id_salt(("panel", panel)).max_rect(inner));
        child.set_clip_rect(rect.intersect(ui.clip_rect()));
        let ui = &mut child;
        match panel {
            Panel::Graph => self.graph_panel(ui, status, counters),
            Panel::Node => self.node_panel(ui, status, counters),
            Panel::Overview => self.overview_panel(ui, counters),
            Panel::Text => {
                let selected: Vec<String> = self.canvas.selected.iter().cloned().collect();
                below::text(ui, &self.document, &selected, &mut self.reading);
            }
            Panel::Source => self.source_panel(ui),
            Panel::Help => self.help_panel(ui),
            Panel::Viewer => self.viewer_panel(ui),
            Panel::Problems => self.problems_panel(ui, status, counters),
            Panel::History => {
                if let Some(at) = history::show(ui, &self.document) {
                    self.step_to(at);
                }
            }
            Panel::Timeline => self.timeline_panel(ui),
            Panel::Trace => {
                let view = self.document.view().clone();
                let machine = self.session.attachment().map(|machine| machine.target().name.clone());
                if let Some(id) = self.trace_panel.show(ui, &view, &self.trace, machine.as_deref()) {
                    self.canvas.show_node(&view, &id);
                }
            }
            Panel::States => {
                let requests = self.states.show(ui);
                requests.into_iter().for_each(|request| self.handle_state(request));
            }
            Panel::Sweep => {
                let (selected, path) = (self.selected(), self.session.path().to_owned());
                let (document, shown) = (&self.document, &self.shown);
                let request = self.sweep.show(ui, document, counters, shown, selected.as_deref(), &path);
                request.into_iter().for_each(|request| self.handle_sweep(request));
            }
            Panel::Plots => {
                let selected: Vec<String> = self.canvas.selected.iter().cloned().collect();
                if let Some(export) = self.plots.show(ui, self.document.view(), counters, &selected) {
                    self.export("plot", export);
                }
            }
        }
    }

    fn graph_panel(&mut self, ui: &mut Ui, status: &Status, counters: &Counters) {
        if self.viewer.source().is_some() && !self.docks.layout.viewer_beside {
            return self.viewer_panel(ui);
        }
        let view = self.document.view().clone();
        let problem = status.problem.as_ref().and_then(|t| Some((t.node.as_deref()?, t.message.as_str())));
        let held = |output: &Output| self.timeline.as_ref().map_or(Held::Lacking, |timeline| timeline.held(output));
        let scene = Scene {
            view: &view,
            counters,
            shown: &self.shown,
            heat: self.heat,
            running: status.phase == Phase::Running,
            problem,
            recorded: self.timeline.as_ref().map(|_| &held as &dyn Fn(&Output) -> Held),
        };
        let requests = self.canvas.show(ui, &scene, self.document.revision());
        requests.into_iter().for_each(|request| self.handle_canvas(request));
    }

    fn viewer_panel(&mut self, ui: &mut Ui) {
        let rect = ui.available_rect_before_wrap();
        ui.allocate_rect(rect, Sense::hover());
        let (mut others, trajectories) = (self.sources(), self.trajectories());
        others.extend(self.viewer.source().and_then(|source| self.of_second_run(source)));
        let trajectories: Vec<Output> = trajectories.into_iter().map(|(output, _)| output).collect();
        let probe = self.viewer.probe_request().and_then(|(output, _)| self.probes.get(output)).cloned();
        let comparison = self.comparison();
        let numbers = (probe.as_ref(), comparison.as_ref());
        let image_rects = self.viewer.show(ui, rect, &self.shown, &others, &trajectories, numbers);
        self.pick_on(ui, image_rects);
    }

    /// The panel of the selected node, or of the whole graph.
    fn node_panel(&mut self, ui: &mut Ui, status: &Status, counters: &Counters) {
        let view = self.document.view().clone();
        let Some(node) = self.selected().and_then(|id| view.node(&id)) else {
            if self.docks.is_shown(Panel::Overview) {
                ui.label(RichText::new(text!("node-none")).color(theme::muted()));
                return;
            }
            return self.overview_panel(ui, counters);
        };
        let id = view.nodes[node].id().to_owned();
        if let Some((_, param)) = self.go_to_param.take_if(|(node, _)| *node == id) {
            params::go_to(ui.ctx(), &param);
        }
        let (document, shown) = (&self.document, (&self.shown, &self.probes));
        let python = self.python_file(&id).is_some();
        let requests = inspector::show(ui, document, (counters, status), shown, &self.canvas, (node, python));
        requests.into_iter().for_each(|request| self.handle_inspector(&id, request));
    }

    fn overview_panel(&mut self, ui: &mut Ui, counters: &Counters) {
        let selected = self.selected().filter(|_| self.docks.is_shown(Panel::Node));
        let count = self.canvas.selected.len();
        for request in overview::show(ui, &self.document, counters, count, selected.as_deref()) {
            match request {
                overview::OverviewRequest::Go(id) => self.canvas.show_node(&self.document.view().clone(), &id),
                overview::OverviewRequest::Perform(action) => self.perform(action),
                overview::OverviewRequest::Param(id, change) => {
                    self.handle_inspector(&id, InspectorRequest::Param(change));
                }
            }
        }
    }

    fn problems_panel(&mut self, ui: &mut Ui, status: &Status, counters: &Counters) {
        let Some(spot) = below::problems(ui, &self.document, status, counters) else { return };
        if let Some(line) = spot.line {
            self.reading.go_to(line);
            // A mistake outside of nodes is shown in the text.
            if spot.node.is_none() {
                self.docks.open(Panel::Text);
            }
        }
        if let Some(id) = spot.node {
            self.canvas.show_node(&self.document.view().clone(), &id);
        }
    }
}
