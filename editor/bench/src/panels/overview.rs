//! The panel of the whole graph, shown while not exactly one node is selected.

use eframe::egui::{Grid, RichText, ScrollArea, Sense, Ui, WidgetInfo, WidgetType, vec2};

use super::inspector::section;
use super::params;
use crate::actions::{self, Action};
use panoscope_editor_model::document::Document;
use panoscope_editor_model::folding::opening;
use panoscope_editor_model::graph_view::NodeView;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_widgets::format_time;
use panoscope_editor_widgets::theme;

/// A request of this panel.
#[derive(Clone, Debug, PartialEq)]
pub enum OverviewRequest {
    /// Go to a node.
    Go(String),
    /// Perform an action on the selection.
    Perform(Action),
    /// A request about a parameter of a node.
    Param(String, params::ParamRequest),
}

/// Shows the panel; returns the user's requests.
pub fn show(ui: &mut Ui, document: &Document, counters: &Counters, selected: usize) -> Vec<OverviewRequest> {
    let view = document.view();
    let mut requests = Vec::new();
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        if selected > 1 {
            ui.label(RichText::new(format!("{selected} nodes selected")).size(15.0));
            if ui.button("Make a part").on_hover_text(actions::hint(Action::MakePart)).clicked() {
                requests.push(OverviewRequest::Perform(Action::MakePart));
            }
        } else {
            ui.label(RichText::new(&view.name).size(16.0));
            ui.label(RichText::new(opening(document.text())).size(12.0).color(theme::muted()));
        }
        if document.pins().next().is_some() {
            section(ui, "Preset");
        }
        for (node, param, label) in document.pins() {
            let all = if view.node(node).is_some() { view } else { view.flat() };
            let this = all.node(node).map(|n| &all.nodes[n]);
            let declared = this.and_then(|n| n.node_type.as_ref()?.params.iter().find(|p| p.name == param));
            if let (Some(this), Some(declared)) = (this, declared) {
                ui.push_id((node, param), |ui| {
                    let change = params::one(ui, document, this, declared, label);
                    requests.extend(change.map(|c| OverviewRequest::Param(node.to_owned(), c)));
                });
            }
        }
        section(ui, "Where time goes");
        shares(ui, &view.nodes, counters, &mut requests);
    });
    requests
}

/// Shows a bar per node: its share of one core.
fn shares(ui: &mut Ui, nodes: &[NodeView], counters: &Counters, requests: &mut Vec<OverviewRequest>) {
    let mut rows: Vec<(&NodeView, f64, f64)> = nodes
        .iter()
        .filter_map(|n| counters.nodes.get(n.id()).map(|c| (n, c.p50_ms, c.p50_ms * c.fps / 1e3)))
        .collect();
    rows.sort_by(|a, b| b.2.total_cmp(&a.2));
    if rows.is_empty() {
        ui.label(RichText::new("nothing runs").color(theme::muted()));
        return;
    }
    let most = rows.first().map_or(1.0, |r| r.2.max(1e-6));
    let width = ui.available_width();
    Grid::new("shares").num_columns(1).spacing([0.0, 2.0]).show(ui, |ui| {
        for (node, p50_ms, share) in rows.into_iter().take(24) {
            let (rect, row) = ui.allocate_exact_size(vec2(width, 24.0), Sense::click());
            row.widget_info(|| WidgetInfo::labeled(WidgetType::Link, true, format!("Go to {}", node.id())));
            let painter = ui.painter();
            if row.hovered() {
                painter.rect_filled(rect, 4.0, theme::raised());
            }
            let bar = eframe::egui::Rect::from_min_size(
                rect.left_bottom() - vec2(0.0, 3.0),
                vec2(width * (share / most) as f32, 2.0),
            );
            painter.rect_filled(bar, 1.0, theme::family(node.family()));
            let font = eframe::egui::FontId::proportional(12.0);
            let middle = rect.center().y - 1.0;
            let at = |x| eframe::egui::pos2(x, middle);
            use eframe::egui::Align2;
            painter.text(at(rect.left()), Align2::LEFT_CENTER, node.id(), font.clone(), theme::text());
            let caption = format!("{}   {:.0} %", format_time(p50_ms), share * 100.0);
            painter.text(at(rect.right()), Align2::RIGHT_CENTER, caption, font, theme::muted());
            if row.clicked() {
                requests.push(OverviewRequest::Go(node.id().to_owned()));
            }
            ui.end_row();
        }
    });
}
