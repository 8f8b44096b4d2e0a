//! The docks: draws the borders and tabs of an arrangement, and handles the pointer and keys on them.
//!
//! This is not `egui_tiles` (0.18 needs another version of egui than the rest, and its tabs can hold rows) and not `egui_dock` (its tabs and
//! borders have no names for a screen reader, and a closed tab forgets its place). Both divide space by shares; here panels keep their size in
//! points when the window grows, and the graph takes the rest.

mod arrange;
mod bar;
mod borders;
mod drag;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use eframe::egui::{Pos2, Rect, Ui, Vec2};
use panoscope_editor_model::docks::{self, BrokenLayout, Layout, Panel, Window};
use panoscope_editor_model::texts::text;

use arrange::{Border, Group};

/// Time without a change until the arrangement is stored.
const PAUSE: Duration = Duration::from_millis(400);
/// Step of a size by keys, points.
pub const STEP: f32 = 32.0;

/// The name of a panel, on its tab.
pub fn title(panel: Panel) -> &'static str {
    match panel {
        Panel::Graph => text!("panel-graph"),
        Panel::Node => text!("panel-node"),
        Panel::Overview => text!("panel-overview"),
        Panel::Text => text!("panel-text"),
        Panel::Source => text!("panel-source"),
        Panel::Help => text!("panel-help"),
        Panel::Viewer => text!("panel-viewer"),
        Panel::Problems => text!("panel-problems"),
        Panel::History => text!("panel-history"),
        Panel::Timeline => text!("panel-timeline"),
        Panel::Trace => text!("panel-trace"),
        Panel::States => text!("panel-states"),
        Panel::Sweep => text!("panel-sweep"),
        Panel::Plots => text!("panel-plots"),
    }
}

/// What the user does with a panel by its tab.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DockRequest {
    /// Close it.
    Close(Panel),
    /// Put it into a window of its own, with its upper left corner at this place of the window, in points.
    TearOff(Panel, [i32; 2]),
}

/// The docks of the window.
pub struct Docks {
    /// The arrangement.
    pub layout: Layout,
    /// The panel that keys for panels act on.
    focused: Panel,
    /// The panel whose tab gets the keys of the window with the next frame.
    take_keys: Option<Panel>,
    groups: Vec<Group>,
    borders: Vec<Border>,
    drag: Option<drag::Drag>,
    /// Windows as they were opened: the system moves them from there.
    opened: HashMap<Panel, Window>,
    /// Where the arrangement is kept: folder and graph.
    file: Option<(PathBuf, PathBuf)>,
    stored: Layout,
    /// When it changed last, until it is stored.
    changed: Option<(Layout, Instant)>,
}

impl Default for Docks {
    fn default() -> Self {
        Self {
            layout: Layout::default(),
            focused: Panel::Graph,
            take_keys: None,
            groups: Vec::new(),
            borders: Vec::new(),
            drag: None,
            opened: HashMap::new(),
            file: None,
            stored: Layout::default(),
            changed: None,
        }
    }
}

impl Docks {
    /// The docks of a graph as they were last; with why their file is not used, where it is broken.
    pub fn of(config: Option<&Path>, graph: &Path) -> (Self, Option<BrokenLayout>) {
        let recalled = config.map_or(Ok(None), |config| docks::recall(config, graph));
        let (layout, broken) = match recalled {
            Ok(layout) => (layout.unwrap_or_default(), None),
            Err(broken) => (Layout::default(), Some(broken)),
        };
        let file = config.map(|config| (config.to_owned(), graph.to_owned()));
        let mut docks = Self::default();
        (docks.stored, docks.layout, docks.file) = (layout.clone(), layout, file);
        (docks, broken)
    }

    /// The panel that keys for panels act on.
    pub fn focused(&self) -> Panel {
        if self.layout.is_shown(self.focused) { self.focused } else { Panel::Graph }
    }

    /// Gives the keys for panels to a panel.
    pub fn focus(&mut self, panel: Panel) {
        self.focused = panel;
    }

    /// Gives the keys to the next or previous panel in the window.
    pub fn focus_next(&mut self, back: bool) {
        let all = self.layout.reachable();
        let now = all.iter().position(|panel| *panel == self.focused()).unwrap_or_default();
        let next = if back { now + all.len().max(1) - 1 } else { now + 1 };
        if let Some(panel) = all.get(next % all.len().max(1)) {
            self.focused = *panel;
            self.take_keys = Some(*panel);
        }
    }

    /// Opens a panel in front of others; the keys for panels act on it.
    pub fn open(&mut self, panel: Panel) {
        self.layout.open(panel);
        self.focused = panel;
    }

    /// Opens or closes a panel; returns whether it is shown now.
    pub fn toggle(&mut self, panel: Panel) -> bool {
        self.layout.toggle(panel);
        let shown = self.layout.is_shown(panel);
        if shown {
            self.focused = panel;
        }
        shown
    }

    /// Whether a panel has space in the window or in one of its own.
    pub fn is_shown(&self, panel: Panel) -> bool {
        self.layout.is_shown(panel)
    }

    /// The rectangle of a panel in the window, without its tab; `None` while it is not shown there.
    pub fn rect(&self, panel: Panel) -> Option<Rect> {
        self.groups.iter().find(|group| group.front == panel).map(|group| group.inner)
    }

    /// The windows of panels, with the places at which they open.
    pub fn windows(&mut self) -> Vec<Window> {
        let windows = self.layout.windows.iter().filter(|window| self.layout.is_open(window.panel));
        let windows: Vec<Window> = windows.copied().collect();
        self.opened.retain(|panel, _| windows.iter().any(|window| window.panel == *panel));
        windows.into_iter().map(|window| *self.opened.entry(window.panel).or_insert(window)).collect()
    }

    /// A window is where the system or the user moved it.
    pub fn follow_window(&mut self, panel: Panel, at: Pos2, size: Vec2) {
        if let Some(window) = self.layout.windows.iter_mut().find(|window| window.panel == panel) {
            window.at = [at.x.round(), at.y.round()];
            window.size = [size.x.round().max(80.0), size.y.round().max(80.0)];
        }
    }

    /// Divides the window and draws tabs; returns the panels to draw with their rectangles, and what the user asks for.
    pub fn begin(
        &mut self,
        ui: &mut Ui,
        rect: Rect,
        titles: &HashMap<Panel, String>,
    ) -> (Vec<(Panel, Rect)>, Vec<DockRequest>) {
        let mut groups = Vec::new();
        let mut borders = Vec::new();
        arrange::arrange(&self.layout, rect, &mut groups, &mut borders);
        (self.groups, self.borders) = (groups, borders);
        let mut requests = Vec::new();
        self.show_bars(ui, titles, &mut requests);
        // The graph alone has no tab that could have the keys of the window.
        if self.take_keys.take().is_some()
            && let Some(id) = ui.memory(|memory| memory.focused())
        {
            ui.memory_mut(|memory| memory.surrender_focus(id));
        }
        let pressed = ui.input(|i| i.pointer.any_pressed().then(|| i.pointer.interact_pos()).flatten());
        if let Some(at) = pressed
            && let Some(group) = self.groups.iter().find(|group| group.outer.contains(at))
            && ui.ctx().layer_id_at(at).is_none_or(|layer| layer == ui.layer_id())
        {
            self.focused = group.front;
        }
        (self.groups.iter().map(|group| (group.front, group.inner)).collect(), requests)
    }

    /// Handles borders and the tab that is dragged, after the panels are drawn.
    pub fn end(&mut self, ui: &mut Ui, whole: Rect) -> Option<DockRequest> {
        self.show_borders(ui);
        let request = self.show_drag(ui, whole);
        self.store_later(ui);
        request
    }

    /// Stores the arrangement once it has not changed for a while and nothing is dragged.
    fn store_later(&mut self, ui: &Ui) {
        if self.file.is_none() || self.layout == self.stored && self.changed.is_none() {
            return;
        }
        match &self.changed {
            Some((layout, since)) if *layout == self.layout => {
                if since.elapsed() >= PAUSE && !ui.input(|i| i.pointer.any_down()) {
                    self.store();
                } else {
                    ui.ctx().request_repaint_after(PAUSE);
                }
            }
            _ => {
                self.changed = Some((self.layout.clone(), Instant::now()));
                ui.ctx().request_repaint_after(PAUSE);
            }
        }
    }

    /// Stores the arrangement, if it changed. One that cannot be written is lost, which is no reason to disturb anybody.
    fn store(&mut self) {
        self.changed = None;
        if let Some((config, graph)) = &self.file
            && self.layout != self.stored
        {
            let _ = docks::remember(config, graph, &self.layout);
            self.stored = self.layout.clone();
        }
    }
}

impl Drop for Docks {
    fn drop(&mut self) {
        self.store();
    }
}
