//! How the panels of the editor's window are arranged: beside and above each other, in tabs, and in windows of their own.
//!
//! An arrangement is a tree. Every panel has exactly one place in it, also while it is closed or in a window, so that it comes back where it
//! was. Sizes are in points; the part with the graph takes what the others leave.

mod error;
mod file;

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

pub use error::LayoutError;
pub use file::{BrokenLayout, Stored, recall, remember};

/// Maximum depth of a tree; deeper ones are not used.
const MAX_DEPTH: usize = 16;
/// Range of sizes, points.
const SIZES: std::ops::RangeInclusive<f32> = 20.0..=20_000.0;

/// A panel of the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Panel {
    /// The canvas.
    Graph,
    /// The selected node, or the whole graph while none is selected.
    Node,
    /// The whole graph: its preset, and where time goes.
    Overview,
    /// The text of the file.
    Text,
    /// The source of a node written in Python.
    Source,
    /// Help of a node type.
    Help,
    /// An output shown large.
    Viewer,
    /// Mistakes and faults.
    Problems,
    /// Changes of parameters.
    History,
    /// A recording.
    Timeline,
    /// Paths of ticks.
    Trace,
    /// Presets and snapshots.
    States,
    /// A sweep.
    Sweep,
    /// Curves.
    Plots,
}

impl Panel {
    /// All panels.
    pub const ALL: [Self; 14] = [
        Self::Graph,
        Self::Node,
        Self::Overview,
        Self::Text,
        Self::Source,
        Self::Help,
        Self::Viewer,
        Self::Problems,
        Self::History,
        Self::Timeline,
        Self::Trace,
        Self::States,
        Self::Sweep,
        Self::Plots,
    ];

    /// Preferred width and height, points.
    pub fn size(self) -> (f32, f32) {
        match self {
            Self::Graph | Self::Viewer => (640.0, 420.0),
            Self::Node | Self::Overview => (320.0, 360.0),
            Self::Text => (430.0, 360.0),
            Self::Source | Self::Help => (520.0, 420.0),
            Self::Timeline => (560.0, 190.0),
            _ => (560.0, 260.0),
        }
    }
}

/// A side of a panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Left of the panel.
    Left,
    /// Right of the panel.
    Right,
    /// Above the panel.
    Above,
    /// Below the panel.
    Below,
}

impl Side {
    fn is_row(self) -> bool {
        matches!(self, Self::Left | Self::Right)
    }

    fn is_after(self) -> bool {
        matches!(self, Self::Right | Self::Below)
    }
}

/// A place for a panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// In the tabs of another panel, before the docked one of this number.
    Tab {
        /// The other panel.
        with: Panel,
        /// The number.
        at: usize,
    },
    /// Beside the tabs of another panel.
    Beside {
        /// The other panel.
        of: Panel,
        /// Where.
        side: Side,
    },
    /// At an edge of the window, beside everything else.
    Edge(Side),
}

/// Panels in the same space, of which one is shown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tabs {
    /// The panels, in the order of their tabs. Never empty.
    pub panels: Vec<Panel>,
    /// The one that is shown, if it is open.
    pub active: Panel,
}

/// A part of a row or column.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Width in a row, height in a column; points.
    pub size: f32,
    /// What is in it.
    pub dock: Dock,
}

/// A node of the tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dock {
    /// Panels in tabs.
    Tabs(Tabs),
    /// Parts beside each other.
    Row(Vec<Part>),
    /// Parts above each other.
    Column(Vec<Part>),
}

/// A panel in a window of its own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// The panel.
    pub panel: Panel,
    /// Upper left corner on the screen; points.
    pub at: [f32; 2],
    /// Width and height; points.
    pub size: [f32; 2],
}

/// The arrangement of all panels.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// The tree.
    pub root: Dock,
    /// Panels that are open. The graph always is.
    pub open: BTreeSet<Panel>,
    /// Panels in windows of their own.
    pub windows: Vec<Window>,
    /// Whether the viewer is a panel of its own and does not cover the graph.
    pub viewer_beside: bool,
}

impl Default for Layout {
    /// The text at the left, the node at the right, everything else below the graph.
    fn default() -> Self {
        use Panel::*;
        let part = |size: f32, dock: Dock| Part { size, dock };
        let middle = Dock::Column(vec![
            part(Graph.size().1, Dock::tabs(&[Graph])),
            part(Plots.size().1, Dock::tabs(&[Problems, History, Timeline, Trace, States, Sweep, Plots])),
        ]);
        let root = Dock::Row(vec![
            part(Text.size().0, Dock::tabs(&[Text])),
            part(Source.size().0, Dock::tabs(&[Source, Help])),
            part(Graph.size().0, middle),
            part(Viewer.size().0, Dock::tabs(&[Viewer])),
            part(Node.size().0, Dock::tabs(&[Node, Overview])),
        ]);
        Self { root, open: BTreeSet::from([Graph, Node]), windows: Vec::new(), viewer_beside: false }
    }
}

impl Dock {
    fn tabs(panels: &[Panel]) -> Self {
        Self::Tabs(Tabs { panels: panels.to_vec(), active: panels[0] })
    }

    /// All panels, in the order of the tree.
    pub fn panels(&self) -> Vec<Panel> {
        match self {
            Self::Tabs(tabs) => tabs.panels.clone(),
            Self::Row(parts) | Self::Column(parts) => parts.iter().flat_map(|part| part.dock.panels()).collect(),
        }
    }

    /// Whether a panel is in it.
    pub fn contains(&self, panel: Panel) -> bool {
        match self {
            Self::Tabs(tabs) => tabs.panels.contains(&panel),
            Self::Row(parts) | Self::Column(parts) => parts.iter().any(|part| part.dock.contains(panel)),
        }
    }

    /// The tabs that a panel is in.
    pub fn tabs_of(&self, panel: Panel) -> Option<&Tabs> {
        match self {
            Self::Tabs(tabs) => tabs.panels.contains(&panel).then_some(tabs),
            Self::Row(parts) | Self::Column(parts) => parts.iter().find_map(|part| part.dock.tabs_of(panel)),
        }
    }

    /// As [`Self::tabs_of`], to change them.
    pub fn tabs_of_mut(&mut self, panel: Panel) -> Option<&mut Tabs> {
        match self {
            Self::Tabs(tabs) => tabs.panels.contains(&panel).then_some(tabs),
            Self::Row(parts) | Self::Column(parts) => parts.iter_mut().find_map(|part| part.dock.tabs_of_mut(panel)),
        }
    }

    /// Takes a panel out; returns whether nothing is left.
    fn remove(&mut self, panel: Panel) -> bool {
        match self {
            Self::Tabs(tabs) => {
                tabs.panels.retain(|other| *other != panel);
                if tabs.active == panel {
                    tabs.active = tabs.panels.first().copied().unwrap_or(panel);
                }
                tabs.panels.is_empty()
            }
            Self::Row(parts) | Self::Column(parts) => {
                parts.retain_mut(|part| !part.dock.remove(panel));
                parts.is_empty()
            }
        }
    }

    /// Dissolves rows and columns of one part, and rows in rows.
    fn simplify(&mut self) {
        let is_row = matches!(self, Self::Row(_));
        let (Self::Row(parts) | Self::Column(parts)) = self else { return };
        let mut simple = Vec::with_capacity(parts.len());
        for mut part in parts.drain(..) {
            part.dock.simplify();
            match part.dock {
                Self::Row(inner) if is_row => simple.extend(inner),
                Self::Column(inner) if !is_row => simple.extend(inner),
                _ => simple.push(part),
            }
        }
        *parts = simple;
        if parts.len() == 1
            && let Some(part) = parts.pop()
        {
            *self = part.dock;
        }
    }

    /// Puts a panel beside the tabs that `anchor` is in; returns whether they were found.
    fn insert_beside(&mut self, anchor: Panel, side: Side, panel: Panel) -> bool {
        let size = |panel: Panel| if side.is_row() { panel.size().0 } else { panel.size().1 };
        let new = Part { size: size(panel), dock: Self::tabs(&[panel]) };
        let is_row = matches!(self, Self::Row(_));
        match self {
            Self::Tabs(tabs) if tabs.panels.contains(&anchor) => {
                let old = Part { size: size(anchor), dock: Self::Tabs(tabs.clone()) };
                let parts = if side.is_after() { vec![old, new] } else { vec![new, old] };
                *self = if side.is_row() { Self::Row(parts) } else { Self::Column(parts) };
                true
            }
            Self::Tabs(_) => false,
            Self::Row(parts) | Self::Column(parts) => {
                let Some(at) = parts.iter().position(|part| part.dock.contains(anchor)) else { return false };
                if is_row == side.is_row() && matches!(parts[at].dock, Self::Tabs(_)) {
                    parts.insert(at + usize::from(side.is_after()), new);
                    return true;
                }
                parts[at].dock.insert_beside(anchor, side, panel)
            }
        }
    }

    /// Puts a panel beside everything.
    fn insert_at_edge(&mut self, side: Side, panel: Panel) {
        let (width, height) = panel.size();
        let new = Part { size: if side.is_row() { width } else { height }, dock: Self::tabs(&[panel]) };
        let old = Part { size: 640.0, dock: self.clone() };
        let parts = if side.is_after() { vec![old, new] } else { vec![new, old] };
        *self = if side.is_row() { Self::Row(parts) } else { Self::Column(parts) };
    }

    /// The row or column at a path of indices from the root.
    pub fn parts_at(&mut self, path: &[usize]) -> Option<&mut Vec<Part>> {
        let (Self::Row(parts) | Self::Column(parts)) = self else { return None };
        match path.split_first() {
            Some((first, rest)) => parts.get_mut(*first)?.dock.parts_at(rest),
            None => Some(parts),
        }
    }

    /// The panel nearest to `panel` on a side of it, in other tabs than its own, among those that `counts` accepts.
    fn neighbour(&self, panel: Panel, side: Side, counts: &dyn Fn(Panel) -> bool) -> Option<Panel> {
        let is_row = matches!(self, Self::Row(_));
        let (Self::Row(parts) | Self::Column(parts)) = self else { return None };
        let at = parts.iter().position(|part| part.dock.contains(panel))?;
        let inside = parts[at].dock.neighbour(panel, side, counts);
        if inside.is_some() || is_row != side.is_row() {
            return inside;
        }
        let first = |part: &Part| part.dock.panels().into_iter().find(|panel| counts(*panel));
        match side.is_after() {
            true => parts[at + 1..].iter().find_map(first),
            false => parts[..at].iter().rev().find_map(first),
        }
    }

    fn depth(&self) -> usize {
        match self {
            Self::Tabs(_) => 1,
            Self::Row(parts) | Self::Column(parts) => {
                1 + parts.iter().map(|part| part.dock.depth()).max().unwrap_or_default()
            }
        }
    }

    /// Calls `each` for every part.
    fn each_part(&self, each: &mut dyn FnMut(&Part)) {
        if let Self::Row(parts) | Self::Column(parts) = self {
            for part in parts {
                each(part);
                part.dock.each_part(each);
            }
        }
    }

    /// The part that a panel is in, innermost of the rows, or of the columns.
    fn part_of(&mut self, panel: Panel, row: bool) -> Option<&mut Part> {
        let is_row = matches!(self, Self::Row(_));
        let (Self::Row(parts) | Self::Column(parts)) = self else { return None };
        let part = parts.iter_mut().find(|part| part.dock.contains(panel))?;
        let deeper = part.dock.clone().part_of(panel, row).is_some();
        match (deeper, is_row == row) {
            (true, _) => part.dock.part_of(panel, row),
            (false, true) => Some(part),
            (false, false) => None,
        }
    }
}

impl Layout {
    /// Whether a panel is open.
    pub fn is_open(&self, panel: Panel) -> bool {
        self.open.contains(&panel)
    }

    /// Whether a panel is in a window of its own.
    pub fn is_torn(&self, panel: Panel) -> bool {
        self.windows.iter().any(|window| window.panel == panel)
    }

    /// Whether a panel has space in the tree. It may still be behind another tab.
    pub fn is_docked(&self, panel: Panel) -> bool {
        self.is_open(panel) && !self.is_torn(panel)
    }

    /// Whether a panel is open and not behind another tab.
    pub fn is_shown(&self, panel: Panel) -> bool {
        self.is_open(panel) && (self.is_torn(panel) || self.front(panel) == Some(panel))
    }

    /// The panel that is shown of the tabs that `panel` is in.
    pub fn front(&self, panel: Panel) -> Option<Panel> {
        let tabs = self.root.tabs_of(panel)?;
        let active = Some(tabs.active).filter(|active| self.is_docked(*active));
        active.or_else(|| tabs.panels.iter().copied().find(|panel| self.is_docked(*panel)))
    }

    /// Opens a panel where it was last, in front of other tabs.
    pub fn open(&mut self, panel: Panel) {
        self.open.insert(panel);
        if !self.is_torn(panel)
            && let Some(tabs) = self.root.tabs_of_mut(panel)
        {
            tabs.active = panel;
        }
    }

    /// Closes a panel, which keeps its place. The graph stays.
    pub fn close(&mut self, panel: Panel) {
        if panel != Panel::Graph {
            self.open.remove(&panel);
        }
    }

    /// Opens a panel that is closed or behind another tab, and closes one that is shown.
    pub fn toggle(&mut self, panel: Panel) {
        if self.is_shown(panel) { self.close(panel) } else { self.open(panel) }
    }

    /// The panels that are docked in the tabs that `panel` is in.
    pub fn together(&self, panel: Panel) -> Vec<Panel> {
        let panels = self.root.tabs_of(panel).into_iter().flat_map(|tabs| &tabs.panels);
        panels.copied().filter(|panel| self.is_docked(*panel)).collect()
    }

    /// Moves a panel to another place, also out of a window, and opens it. Returns whether that changed anything.
    pub fn place(&mut self, panel: Panel, target: Target) -> bool {
        let before = self.clone();
        let (anchor, side) = match target {
            Target::Tab { with, .. } => (with, None),
            Target::Beside { of, side } => (of, Some(side)),
            Target::Edge(side) => {
                self.root.remove(panel);
                self.root.insert_at_edge(side, panel);
                return self.placed(panel, &before);
            }
        };
        // A panel that is placed beside its own tabs is placed beside the others there.
        let others = self.root.tabs_of(anchor).map(|tabs| tabs.panels.clone()).unwrap_or_default();
        let others: Vec<Panel> = others.into_iter().filter(|other| *other != panel).collect();
        let shown = others.iter().copied().find(|other| self.is_docked(*other));
        let anchor = match (anchor == panel, shown) {
            (false, _) => anchor,
            (true, Some(other)) => other,
            (true, None) => return false,
        };
        self.root.remove(panel);
        match (target, side) {
            (_, Some(side)) => _ = self.root.insert_beside(anchor, side, panel),
            (Target::Tab { at, .. }, None) => {
                if let Some(tabs) = self.root.tabs_of_mut(anchor) {
                    // Tabs of panels that are not docked are not counted.
                    let before = |panel: &Panel| before.is_docked(*panel);
                    let shown = tabs.panels.iter().enumerate().filter(|(_, panel)| before(panel));
                    let at = shown.map(|(index, _)| index).nth(at).unwrap_or(tabs.panels.len());
                    tabs.panels.insert(at, panel);
                }
            }
            _ => {}
        }
        self.placed(panel, &before)
    }

    fn placed(&mut self, panel: Panel, before: &Self) -> bool {
        self.root.simplify();
        self.windows.retain(|window| window.panel != panel);
        self.open(panel);
        self != before
    }

    /// Moves a panel to a side of the graph: into the tabs that are there, out of them if it is there already, or to a place of its own.
    /// Returns whether that changed anything.
    pub fn move_beside_graph(&mut self, panel: Panel, side: Side) -> bool {
        if panel == Panel::Graph {
            return false;
        }
        let there = self.root.neighbour(Panel::Graph, side, &|other| self.is_docked(other));
        let together = there.map(|there| self.together(there)).unwrap_or_default();
        let target = match there {
            Some(of) if together.contains(&panel) => Target::Beside { of, side },
            Some(with) => Target::Tab { with, at: usize::MAX },
            None => Target::Beside { of: Panel::Graph, side },
        };
        if together == [panel] { false } else { self.place(panel, target) }
    }

    /// Makes the part of a panel larger or smaller, in points. The graph and the only part of a row or column have no size of their own.
    pub fn grow(&mut self, panel: Panel, by: f32) -> bool {
        if panel == Panel::Graph {
            return false;
        }
        let row = self.root.part_of(panel, true).is_some_and(|part| !part.dock.contains(Panel::Graph));
        let Some(part) = self.root.part_of(panel, row) else { return false };
        if part.dock.contains(Panel::Graph) {
            return false;
        }
        part.size = (part.size + by).clamp(80.0, 4000.0);
        true
    }

    /// Puts a panel into a window of its own, at this place on the screen. The graph stays.
    pub fn tear_off(&mut self, panel: Panel, at: [f32; 2]) -> bool {
        if panel == Panel::Graph || self.is_torn(panel) {
            return false;
        }
        let (width, height) = panel.size();
        self.open.insert(panel);
        self.windows.push(Window { panel, at, size: [width, height] });
        true
    }

    /// Puts a panel from its window back to its place.
    pub fn dock(&mut self, panel: Panel) -> bool {
        let before = self.windows.len();
        self.windows.retain(|window| window.panel != panel);
        let was_torn = self.windows.len() < before;
        if was_torn {
            self.open(panel);
        }
        was_torn
    }

    /// Panels that can be reached, in the order of the tree, then those in windows.
    pub fn reachable(&self) -> Vec<Panel> {
        let shown = self.root.panels().into_iter().filter(|panel| self.is_docked(*panel) && self.is_shown(*panel));
        shown.chain(self.windows.iter().map(|window| window.panel).filter(|panel| self.is_open(*panel))).collect()
    }

    /// The same with every panel in it once.
    ///
    /// # Errors
    /// It cannot be used: the graph is missing, a panel has several places, or a size is not usable.
    pub fn checked(mut self) -> Result<Self, LayoutError> {
        if self.root.depth() > MAX_DEPTH {
            return Err(LayoutError::TooDeep);
        }
        let panels = self.root.panels();
        if let Some(twice) = Panel::ALL.iter().find(|panel| panels.iter().filter(|p| p == panel).count() > 1) {
            return Err(LayoutError::Twice { panel: *twice });
        }
        if !panels.contains(&Panel::Graph) {
            return Err(LayoutError::NoGraph);
        }
        let mut wrong = None;
        self.root.each_part(&mut |part| {
            if !SIZES.contains(&part.size) {
                wrong = Some(LayoutError::Size { size: part.size });
            } else if part.dock.panels().is_empty() {
                wrong = Some(LayoutError::NoPanel);
            }
        });
        for window in &self.windows {
            let [numbers, sizes] = [window.at, window.size];
            if !numbers.iter().all(|x| x.abs() <= *SIZES.end()) || !sizes.iter().all(|x| SIZES.contains(x)) {
                wrong = Some(LayoutError::WindowPlace { panel: window.panel });
            }
            if window.panel == Panel::Graph || self.windows.iter().filter(|w| w.panel == window.panel).count() > 1 {
                wrong = Some(LayoutError::Window { panel: window.panel });
            }
        }
        if let Some(wrong) = wrong {
            return Err(wrong);
        }
        self.open.insert(Panel::Graph);
        // A panel that the file does not know yet gets the place that it has by default.
        let default = Self::default();
        for panel in Panel::ALL.into_iter().filter(|panel| !panels.contains(panel)) {
            let beside = default.root.tabs_of(panel).into_iter().flat_map(|tabs| tabs.panels.clone());
            let known = beside.into_iter().find(|other| *other != Panel::Graph && self.root.contains(*other));
            match known.and_then(|other| self.root.tabs_of_mut(other)) {
                Some(tabs) => tabs.panels.push(panel),
                None => _ = self.root.insert_beside(Panel::Graph, Side::Right, panel),
            }
        }
        self.root.simplify();
        Ok(self)
    }
}

#[cfg(test)]
mod tests;
