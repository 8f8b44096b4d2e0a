//! A tab that is dragged: shows where the panel would go, and puts it there.

use eframe::egui::{Align2, Context, FontId, Id, LayerId, Order, Pos2, Rect, Stroke, StrokeKind, Ui, Vec2, vec2};
use panoscope_editor_model::docks::{Panel, Side, Target};

use super::arrange::{BAR, Group};
use super::{DockRequest, Docks, title};
use panoscope_editor_widgets::theme;

/// Share of a panel at each of its sides where a panel is placed beside it; in the middle it becomes a tab.
const SHARE: f32 = 0.28;
/// Distance from the edges of the window within which a panel is placed beside everything, points.
const EDGE: f32 = 14.0;

/// A dragged tab.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drag {
    panel: Panel,
    size: Vec2,
}

impl Drag {
    /// A tab of this size.
    pub fn new(panel: Panel, size: Vec2) -> Self {
        Self { panel, size }
    }
}

/// The half of a rectangle at a side of it.
fn half(rect: Rect, side: Side, share: f32) -> Rect {
    let (width, height) = (rect.width() * share, rect.height() * share);
    match side {
        Side::Left => rect.with_max_x(rect.left() + width),
        Side::Right => rect.with_min_x(rect.right() - width),
        Side::Above => rect.with_max_y(rect.top() + height),
        Side::Below => rect.with_min_y(rect.bottom() - height),
    }
}

/// The side of a rectangle that a point is near, within `reach` of it: as a share of its size, or in points.
fn side_of(rect: Rect, at: Pos2, reach: Vec2) -> Option<Side> {
    let sides = [
        (Side::Left, (at.x - rect.left()) / reach.x),
        (Side::Right, (rect.right() - at.x) / reach.x),
        (Side::Above, (at.y - rect.top()) / reach.y),
        (Side::Below, (rect.bottom() - at.y) / reach.y),
    ];
    let nearest = sides.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    (nearest.1 < 1.0).then_some(nearest.0)
}

/// Where a panel goes that is dropped at a point, with the rectangle that shows it.
fn target_at(groups: &[Group], whole: Rect, at: Pos2, tab: Vec2) -> Option<(Target, Rect)> {
    if let Some(side) = side_of(whole, at, Vec2::splat(EDGE)) {
        return Some((Target::Edge(side), half(whole, side, 0.22)));
    }
    let group = groups.iter().find(|group| group.outer.contains(at))?;
    let with = group.front;
    if group.has_bar() && at.y < group.inner.top() {
        let number = group.tabs.iter().filter(|tab| tab.center().x < at.x).count();
        let end = group.tabs.last().map_or(group.outer.left(), |tab| tab.right());
        let left = group.tabs.get(number).map_or(end, |tab| tab.left());
        let rect = Rect::from_min_size(Pos2::new(left, group.outer.top()), tab);
        return Some((Target::Tab { with, at: number }, rect.intersect(group.outer)));
    }
    match side_of(group.inner, at, group.inner.size() * SHARE) {
        Some(side) => Some((Target::Beside { of: with, side }, half(group.inner, side, 0.5))),
        None => Some((Target::Tab { with, at: usize::MAX }, group.inner)),
    }
}

impl Docks {
    /// The panel whose tab is dragged.
    pub fn dragged(&self) -> Option<Panel> {
        self.drag.map(|drag| drag.panel)
    }

    /// Leaves the dragged panel where it is.
    pub fn cancel_drag(&mut self, ctx: &Context) {
        self.drag = None;
        ctx.stop_dragging();
    }

    /// Shows the dragged tab and its target. A drop outside of the window puts the panel into one of its own.
    pub(super) fn show_drag(&mut self, ui: &Ui, whole: Rect) -> Option<DockRequest> {
        let drag = self.drag?;
        let (at, released) = ui.input(|i| (i.pointer.latest_pos(), i.pointer.any_released() || !i.pointer.any_down()));
        if released {
            self.drag = None;
        }
        let at = at?;
        let window = ui.ctx().content_rect();
        let outside = !window.contains(at) && drag.panel != Panel::Graph;
        if released && outside {
            return Some(DockRequest::TearOff(drag.panel, [at.x as i32 - 40, at.y as i32 - 14]));
        }
        let target = target_at(&self.groups, whole, at, drag.size).filter(|_| !outside);
        match target {
            Some((target, _)) if released => {
                self.layout.place(drag.panel, target);
                self.focused = drag.panel;
            }
            Some((_, rect)) => {
                let layer = LayerId::new(Order::Foreground, "dock target".into());
                let painter = ui.ctx().layer_painter(layer);
                painter.rect_filled(rect, 4.0, theme::accent().gamma_multiply(0.18));
                painter.rect_stroke(rect, 4.0, Stroke::new(2.0, theme::accent()), StrokeKind::Inside);
            }
            None => {}
        }
        if !released {
            ghost(ui, drag.panel, at);
            ui.ctx().request_repaint();
        }
        None
    }
}

/// Draws the name of a dragged panel beside the pointer.
fn ghost(ui: &Ui, panel: Panel, at: Pos2) {
    let layer = LayerId::new(Order::Tooltip, Id::new("dragged panel"));
    let painter = ui.ctx().layer_painter(layer);
    let rect = Rect::from_min_size(at + vec2(10.0, 6.0), vec2(96.0, BAR));
    painter.rect_filled(rect, 4.0, theme::raised());
    painter.rect_stroke(rect, 4.0, Stroke::new(1.0, theme::accent()), StrokeKind::Inside);
    painter.text(rect.center(), Align2::CENTER_CENTER, title(panel), FontId::proportional(12.0), theme::text());
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::pos2;

    #[test]
    fn the_place_under_the_pointer_is_the_target() {
        let group = |panel: Panel, rect: Rect, bar: f32| Group {
            panels: vec![panel],
            front: panel,
            outer: rect,
            inner: rect.with_min_y(rect.top() + bar),
            tabs: vec![Rect::from_min_size(rect.min, vec2(80.0, bar))],
        };
        let whole = Rect::from_min_size(pos2(0.0, 44.0), vec2(1000.0, 600.0));
        let graph = group(Panel::Graph, whole.with_max_x(700.0), 0.0);
        let node = group(Panel::Node, whole.with_min_x(701.0), 28.0);
        let groups = [graph, node];
        let at = |x: f32, y: f32| target_at(&groups, whole, pos2(x, y), vec2(80.0, 28.0)).map(|(target, _)| target);
        assert_eq!(at(4.0, 300.0), Some(Target::Edge(Side::Left)));
        assert_eq!(at(350.0, 640.0), Some(Target::Edge(Side::Below)));
        assert_eq!(at(350.0, 300.0), Some(Target::Tab { with: Panel::Graph, at: usize::MAX }));
        assert_eq!(at(350.0, 560.0), Some(Target::Beside { of: Panel::Graph, side: Side::Below }));
        assert_eq!(at(650.0, 340.0), Some(Target::Beside { of: Panel::Graph, side: Side::Right }));
        assert_eq!(at(720.0, 66.0), Some(Target::Tab { with: Panel::Node, at: 0 }));
        assert_eq!(at(900.0, 66.0), Some(Target::Tab { with: Panel::Node, at: 1 }));
        assert_eq!(at(850.0, 140.0), Some(Target::Beside { of: Panel::Node, side: Side::Above }));
        assert_eq!(at(1200.0, 300.0), Some(Target::Edge(Side::Right)), "beyond the edge");
    }
}
