//! Divides the window among the panels.

use eframe::egui::{Rect, pos2, vec2};
use panoscope_editor_model::docks::{Dock, Layout, Panel};

/// Width of the line between two parts, points.
pub const GAP: f32 = 1.0;
/// Height of the tabs of a group, points.
pub const BAR: f32 = 28.0;
/// Least size of a part, points; the graph gets at least twice as much.
const MIN_VALUE: f32 = 96.0;

/// Panels in the same space.
#[derive(Clone, Debug)]
pub struct Group {
    /// The docked panels, in the order of their tabs.
    pub panels: Vec<Panel>,
    /// The one that is shown.
    pub front: Panel,
    /// The whole space.
    pub outer: Rect,
    /// The space below the tabs.
    pub inner: Rect,
    /// The tabs, in the same order.
    pub tabs: Vec<Rect>,
}

impl Group {
    /// Whether there are tabs: the graph alone needs none.
    pub fn has_bar(&self) -> bool {
        self.panels != [Panel::Graph]
    }
}

/// The border between two parts.
#[derive(Clone, Debug)]
pub struct Border {
    /// Path of indices to the row or column.
    pub path: Vec<usize>,
    /// Indices of the parts before and behind it.
    pub between: [usize; 2],
    /// Sizes of the parts, points; `None` for the one that takes what the others leave.
    pub sizes: [Option<f32>; 2],
    /// Panels that are shown at its sides.
    pub panels: [Panel; 2],
    /// Whether the parts are beside each other.
    pub row: bool,
    /// The line.
    pub line: Rect,
}

/// Whether something in the tree has space.
fn has_space(layout: &Layout, dock: &Dock) -> bool {
    match dock {
        Dock::Tabs(tabs) => tabs.panels.iter().any(|panel| layout.is_docked(*panel)),
        Dock::Row(parts) | Dock::Column(parts) => parts.iter().any(|part| has_space(layout, &part.dock)),
    }
}

/// Divides `rect`.
pub fn arrange(layout: &Layout, rect: Rect, groups: &mut Vec<Group>, borders: &mut Vec<Border>) {
    divide(layout, &layout.root, rect, &mut Vec::new(), groups, borders);
}

fn divide(
    layout: &Layout,
    dock: &Dock,
    rect: Rect,
    path: &mut Vec<usize>,
    groups: &mut Vec<Group>,
    borders: &mut Vec<Border>,
) {
    let row = matches!(dock, Dock::Row(_));
    let parts = match dock {
        Dock::Tabs(tabs) => {
            let panels: Vec<Panel> = tabs.panels.iter().copied().filter(|panel| layout.is_docked(*panel)).collect();
            let Some(front) = tabs.panels.first().and_then(|first| layout.front(*first)) else { return };
            let mut group = Group { panels, front, outer: rect, inner: rect, tabs: Vec::new() };
            if group.has_bar() {
                group.inner.min.y = (rect.min.y + BAR).min(rect.max.y);
            }
            return groups.push(group);
        }
        Dock::Row(parts) | Dock::Column(parts) => parts,
    };
    let shown: Vec<usize> = (0..parts.len()).filter(|n| has_space(layout, &parts[*n].dock)).collect();
    let length = if row { rect.width() } else { rect.height() };
    let room = (length - GAP * shown.len().saturating_sub(1) as f32).max(0.0);
    let wanted: Vec<(f32, bool)> =
        shown.iter().map(|n| (parts[*n].size, parts[*n].dock.contains(Panel::Graph))).collect();
    let sizes = sizes(&wanted, room);
    let mut at = if row { rect.left() } else { rect.top() };
    let mut before: Option<(usize, usize)> = None;
    for ((n, size), (_, takes_rest)) in shown.iter().zip(&sizes).zip(&wanted) {
        let space = match row {
            true => Rect::from_min_size(pos2(at, rect.top()), vec2(*size, rect.height())),
            false => Rect::from_min_size(pos2(rect.left(), at), vec2(rect.width(), *size)),
        };
        let first = groups.len();
        path.push(*n);
        divide(layout, &parts[*n].dock, space, path, groups, borders);
        path.pop();
        if let Some((other, group)) = before {
            let line = match row {
                true => Rect::from_min_size(pos2(at - GAP, rect.top()), vec2(GAP, rect.height())),
                false => Rect::from_min_size(pos2(rect.left(), at - GAP), vec2(rect.width(), GAP)),
            };
            let fixed = |part: usize| {
                let index = shown.iter().position(|n| *n == part)?;
                (!wanted[index].1).then_some(sizes[index])
            };
            borders.push(Border {
                path: path.clone(),
                between: [other, *n],
                sizes: [fixed(other), Some(*size).filter(|_| !takes_rest)],
                panels: [groups[group].front, groups.get(first).map_or(Panel::Graph, |group| group.front)],
                row,
                line,
            });
        }
        before = Some((*n, first));
        at += size + GAP;
    }
}

/// Sizes in a room: those that are wanted, where the part with the graph takes the rest; smaller where the room is too small for that. Without
/// the graph all have their share.
fn sizes(wanted: &[(f32, bool)], room: f32) -> Vec<f32> {
    let fixed: f32 = wanted.iter().filter(|(_, takes_rest)| !takes_rest).map(|(size, _)| size.max(MIN_VALUE)).sum();
    let has_rest = wanted.iter().any(|(_, takes_rest)| *takes_rest);
    let for_fixed = if has_rest { fixed.min((room - 2.0 * MIN_VALUE).max(room / 3.0)) } else { room };
    let scale = if fixed > 0.0 { for_fixed / fixed } else { 0.0 };
    let rest = room - if fixed > 0.0 { for_fixed } else { 0.0 };
    wanted.iter().map(|(size, takes_rest)| if *takes_rest { rest } else { size.max(MIN_VALUE) * scale }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn divided(layout: &Layout, width: f32, height: f32) -> (Vec<Group>, Vec<Border>) {
        let (mut groups, mut borders) = (Vec::new(), Vec::new());
        let whole = Rect::from_min_size(pos2(0.0, 44.0), vec2(width, height));
        arrange(layout, whole, &mut groups, &mut borders);
        // All space is used once.
        let area: f32 = groups.iter().map(|group| group.outer.area()).sum();
        let lines: f32 = borders.iter().map(|border| border.line.area()).sum();
        assert!((area + lines - whole.area()).abs() < whole.area() * 1e-4, "{groups:?}");
        for (n, group) in groups.iter().enumerate() {
            assert!(whole.expand(0.1).contains_rect(group.outer) && group.outer.is_positive(), "{group:?}");
            assert!(groups[..n].iter().all(|other| !other.outer.shrink(0.1).intersects(group.outer)));
        }
        (groups, borders)
    }

    #[test]
    fn panels_keep_their_size_and_the_graph_takes_the_rest() {
        let mut layout = Layout::default();
        for (width, height) in [(1280.0, 676.0), (1440.0, 856.0), (3840.0, 2116.0)] {
            let (groups, borders) = divided(&layout, width, height);
            assert_eq!((groups.len(), borders.len()), (2, 1));
            assert_eq!(groups[1].outer.width(), 320.0);
            assert_eq!(groups[0].inner, groups[0].outer, "the graph alone has no tabs");
            assert_eq!(groups[0].outer.width(), width - 320.0 - GAP);
        }
        layout.open(Panel::Plots);
        layout.open(Panel::Sweep);
        layout.open(Panel::Text);
        let (groups, borders) = divided(&layout, 1440.0, 856.0);
        assert_eq!((groups.len(), borders.len()), (4, 3));
        let below = groups.iter().find(|group| group.front == Panel::Sweep).expect("below the graph");
        assert_eq!((below.panels.as_slice(), below.outer.height()), (&[Panel::Sweep, Panel::Plots][..], 260.0));
    }

    #[test]
    fn a_small_window_leaves_space_for_the_graph() {
        let mut layout = Layout::default();
        Panel::ALL.into_iter().for_each(|panel| layout.open(panel));
        let (groups, _) = divided(&layout, 480.0, 276.0);
        let graph = groups.iter().find(|group| group.front == Panel::Graph).expect("the graph");
        assert!(graph.outer.width() >= 150.0 && graph.outer.height() >= 90.0, "{graph:?}");
    }
}
