//! The tabs above a group of panels.

use std::collections::HashMap;

use eframe::egui::{Color32, CursorIcon, FontId, Id, Rect, Sense, Stroke, Ui, WidgetInfo, WidgetType, pos2, vec2};
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::texts::text;

use super::arrange::{BAR, Group};
use super::drag::Drag;
use super::{DockRequest, Docks, title};
use crate::actions::{Action, hint};
use panoscope_editor_widgets::theme;

/// Distance between a tab's name and its edges, points.
const PAD: f32 = 12.0;
/// Width of a button, points.
const BUTTON: f32 = 22.0;

impl Docks {
    /// Draws the tabs of all groups and handles input on them.
    pub(super) fn show_bars(&mut self, ui: &mut Ui, titles: &HashMap<Panel, String>, requests: &mut Vec<DockRequest>) {
        let focused = self.focused();
        for group in &mut self.groups {
            group.tabs.clear();
            if !group.has_bar() {
                continue;
            }
            let bar = group.outer.with_max_y(group.inner.top());
            ui.painter().rect_filled(bar, 0.0, theme::panel());
            ui.painter().hline(bar.x_range(), bar.bottom() - 0.5, Stroke::new(1.0, theme::line()));
            let buttons = Rect::from_min_max(pos2(bar.right() - 2.0 * BUTTON - 4.0, bar.top()), bar.max);
            let room = (buttons.left() - bar.left()) / group.panels.len() as f32;
            let mut left = bar.left();
            for panel in group.panels.clone() {
                let front = panel == group.front;
                let name = titles.get(&panel).map_or_else(|| title(panel), String::as_str);
                let color = if front { theme::text() } else { theme::muted() };
                let galley = ui.painter().layout_no_wrap(name.to_owned(), FontId::proportional(12.0), color);
                let width = (galley.size().x + 2.0 * PAD).min(room);
                let rect = Rect::from_min_size(pos2(left, bar.top()), vec2(width, BAR));
                left += width;
                let response = ui.interact(rect, Id::new(("tab", panel)), Sense::click_and_drag());
                response.widget_info(|| {
                    WidgetInfo::selected(
                        WidgetType::SelectableLabel,
                        true,
                        front,
                        text!("panel-name", panel = title(panel)),
                    )
                });
                let painter = ui.painter_at(rect);
                if response.hovered() && !front {
                    painter.rect_filled(rect, 0.0, theme::raised());
                }
                painter.galley(pos2(rect.left() + PAD, rect.center().y - galley.size().y / 2.0), galley, color);
                if front {
                    let has_keys = panel == focused || response.has_focus();
                    let line = if has_keys { theme::accent() } else { theme::muted().gamma_multiply(0.6) };
                    painter.hline(rect.x_range().shrink(PAD / 2.0), rect.bottom() - 1.0, Stroke::new(2.0, line));
                }
                if self.take_keys == Some(panel) {
                    response.request_focus();
                    self.take_keys = None;
                }
                if response.clicked() || response.gained_focus() {
                    self.focused = panel;
                }
                if response.clicked()
                    && let Some(tabs) = self.layout.root.tabs_of_mut(panel)
                {
                    tabs.active = panel;
                }
                if response.drag_started() {
                    self.drag = Some(Drag::new(panel, rect.size()));
                }
                if response.double_clicked() {
                    requests.push(DockRequest::TearOff(panel, [rect.left() as i32, rect.top() as i32]));
                }
                if response.middle_clicked() && panel != Panel::Graph {
                    requests.push(DockRequest::Close(panel));
                }
                response.on_hover_cursor(CursorIcon::Grab);
                group.tabs.push(rect);
            }
            if group.front != Panel::Graph {
                requests.extend(buttons_of(ui, group, buttons));
            }
        }
    }
}

/// Shows the buttons that close the shown panel and put it into a window of its own.
fn buttons_of(ui: &mut Ui, group: &Group, rect: Rect) -> Option<DockRequest> {
    let panel = group.front;
    let button = |n: f32, action: Action, name: String, lines: &[[[f32; 2]; 2]]| {
        let at = Rect::from_min_size(pos2(rect.left() + n * BUTTON, rect.top()), vec2(BUTTON, BAR));
        let response = ui.interact(at, Id::new((action, panel)), Sense::click());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, name.clone()));
        let lit = response.hovered() || response.has_focus();
        let color: Color32 = if lit { theme::text() } else { theme::muted() };
        let point = |[x, y]: [f32; 2]| at.center() + vec2(x, y);
        for ends in lines {
            ui.painter().line_segment([point(ends[0]), point(ends[1])], Stroke::new(1.3, color));
        }
        response.on_hover_text(hint(action)).clicked()
    };
    // A window leaving to the upper right, and a cross.
    const LEAVE: [[[f32; 2]; 2]; 6] = [
        [[-1.0, -4.0], [-4.0, -4.0]],
        [[-4.0, -4.0], [-4.0, 4.0]],
        [[-4.0, 4.0], [4.0, 4.0]],
        [[4.0, 4.0], [4.0, 1.0]],
        [[0.0, 0.0], [4.5, -4.5]],
        [[1.5, -4.5], [4.5, -4.5]],
    ];
    const CROSS: [[[f32; 2]; 2]; 2] = [[[-4.0, -4.0], [4.0, 4.0]], [[-4.0, 4.0], [4.0, -4.0]]];
    let torn = button(0.0, Action::TearOff, text!("panel-tear-off.name", panel = title(panel)), &LEAVE);
    let closed = button(1.0, Action::ClosePanel, text!("panel-close.name", panel = title(panel)), &CROSS);
    let at = [group.outer.left() as i32, group.outer.top() as i32];
    match (torn, closed) {
        (true, _) => Some(DockRequest::TearOff(panel, at)),
        (_, true) => Some(DockRequest::Close(panel)),
        _ => None,
    }
}
