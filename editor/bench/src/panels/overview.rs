//! The panel of the whole graph, shown while not exactly one node is selected.

use eframe::egui::{
    Align2, Button, Color32, FontId, Rect, RichText, ScrollArea, Sense, Ui, WidgetInfo, WidgetType, pos2, vec2,
};

use super::inspector::section;
use super::params;
use super::prose::prose;
use crate::actions::{self, Action};
use panoscope_editor_model::document::Document;
use panoscope_editor_model::folding::opening;
use panoscope_editor_model::graph_view::{GraphView, NodeView};
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::texts::{decimal, text};
use panoscope_editor_widgets::format_time;
use panoscope_editor_widgets::theme;

/// Maximum number of rows of a list.
const MAX_ROWS: usize = 24;

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

/// Shows the panel; returns the user's requests. Settings of the node `elsewhere` are left out: the panel of the node has them, and a widget can be
/// at one place only.
pub fn show(
    ui: &mut Ui,
    document: &Document,
    counters: &Counters,
    selected: usize,
    elsewhere: Option<&str>,
) -> Vec<OverviewRequest> {
    let view = document.view();
    let mut requests = Vec::new();
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        if selected > 1 {
            ui.label(RichText::new(text!("overview-selected", count = selected)).size(15.0));
            if ui.button(text!("overview-make-part")).on_hover_text(actions::hint(Action::MakePart)).clicked() {
                requests.push(OverviewRequest::Perform(Action::MakePart));
            }
        } else {
            ui.label(RichText::new(&view.name).size(16.0));
            about(ui, &opening(document.text()));
        }
        let mut pins = document.pins().filter(|(node, ..)| Some(*node) != elsewhere).peekable();
        if pins.peek().is_some() {
            section(ui, text!("overview-preset"));
        }
        for (node, param, label) in pins {
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
        section(ui, text!("overview-time"));
        shares(ui, &view.nodes, counters, &mut requests);
        ages(ui, view, counters, &mut requests);
    });
    requests
}

/// Shows what a graph is for: its first sentence, and all of it where that is asked for. Commands are in mono type, each with a button that copies
/// it.
fn about(ui: &mut Ui, text: &str) {
    let id = ui.make_persistent_id("about the graph");
    let whole = ui.data(|data| data.get_temp::<bool>(id)).unwrap_or_default();
    let first = first_sentence(text);
    prose(ui, if whole { text } else { first }, theme::muted());
    if first.len() < text.len() {
        let caption = if whole { text!("overview-less") } else { text!("overview-more") };
        let more = Button::new(RichText::new(caption).size(11.0).color(theme::accent())).frame(false);
        if ui.add(more).clicked() {
            ui.data_mut(|data| data.insert_temp(id, !whole));
        }
    }
}

/// A text up to the end of its first sentence: a full stop outside of commands and brackets, before a capital letter.
fn first_sentence(text: &str) -> &str {
    let (mut in_command, mut brackets) = (false, 0i32);
    let end = text.char_indices().find(|(at, c)| {
        match c {
            '`' => in_command = !in_command,
            '(' => brackets += 1,
            ')' => brackets -= 1,
            _ => {}
        }
        let next = text[at + c.len_utf8()..].strip_prefix(' ').and_then(|rest| rest.chars().next());
        *c == '.' && !in_command && brackets <= 0 && next.is_some_and(|next| next.is_uppercase() || next == '`')
    });
    end.map_or(text, |(at, _)| &text[..=at])
}

/// Shows a bar per node: its share of one core.
fn shares(ui: &mut Ui, nodes: &[NodeView], counters: &Counters, requests: &mut Vec<OverviewRequest>) {
    let mut rows: Vec<(&NodeView, f64, f64)> = nodes
        .iter()
        .filter_map(|n| counters.nodes.get(n.id()).map(|c| (n, c.p50_ms, c.p50_ms * c.fps / 1e3)))
        .collect();
    rows.sort_by(|a, b| b.2.total_cmp(&a.2));
    if rows.is_empty() {
        ui.label(RichText::new(text!("overview-nothing")).color(theme::muted()));
        return;
    }
    let most = rows.first().map_or(1.0, |r| r.2.max(1e-6));
    for (node, p50_ms, share) in rows.into_iter().take(MAX_ROWS) {
        let caption = text!("overview-share", time = format_time(p50_ms), percent = decimal(share * 100.0, 0));
        let bar = Some(((share / most) as f32, theme::family(node.family())));
        if row(ui, node.id(), &caption, bar, text!("go-to", node = node.id())) {
            requests.push(OverviewRequest::Go(node.id().to_owned()));
        }
    }
}

/// Shows how old the packets are at the end of each path.
fn ages(ui: &mut Ui, view: &GraphView, counters: &Counters, requests: &mut Vec<OverviewRequest>) {
    let mut ends = vec![true; view.nodes.len()];
    view.wires.iter().filter(|wire| !wire.delayed).for_each(|wire| ends[wire.from] = false);
    let last = view.nodes.iter().zip(ends).filter(|(_, end)| *end).map(|(node, _)| node);
    let aged = last.filter_map(|node| {
        let counts = counters.nodes.get(node.id())?;
        Some((node.id(), counts.age_p50_ms.filter(|age| *age > 0.0)?, counts.age_p99_ms?))
    });
    let aged: Vec<(&str, f64, f64)> = aged.take(MAX_ROWS).collect();
    if aged.is_empty() {
        return;
    }
    section(ui, text!("overview-ages"));
    for (id, p50_ms, p99_ms) in aged {
        let caption = text!("overview-age", median = format_time(p50_ms), slow = format_time(p99_ms));
        if row(ui, id, &caption, None, text!("go-to-end", node = id)) {
            requests.push(OverviewRequest::Go(id.to_owned()));
        }
    }
}

/// Shows a row: a name, a caption at the right, and a bar of this share and colour; returns whether it was clicked.
fn row(ui: &mut Ui, name: &str, caption: &str, bar: Option<(f32, Color32)>, label: String) -> bool {
    ui.spacing_mut().item_spacing.y = 2.0;
    let width = ui.available_width();
    let (rect, row) = ui.allocate_exact_size(vec2(width, 24.0), Sense::click());
    row.widget_info(|| WidgetInfo::labeled(WidgetType::Link, true, label.clone()));
    if !ui.is_rect_visible(rect) {
        return row.clicked();
    }
    let painter = ui.painter();
    if row.hovered() || row.has_focus() {
        painter.rect_filled(rect, 4.0, theme::raised());
    }
    if let Some((share, color)) = bar {
        let bar = Rect::from_min_size(rect.left_bottom() - vec2(0.0, 3.0), vec2(width * share, 2.0));
        painter.rect_filled(bar, 1.0, color);
    }
    let font = FontId::proportional(12.0);
    let middle = rect.center().y - 1.0;
    painter.text(pos2(rect.left(), middle), Align2::LEFT_CENTER, name, font.clone(), theme::text());
    painter.text(pos2(rect.right(), middle), Align2::RIGHT_CENTER, caption, font, theme::muted());
    row.clicked()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_sentence_ends_outside_of_commands() {
        assert_eq!(first_sentence("One. Two."), "One.");
        assert_eq!(first_sentence("Run `a. b` first. Then."), "Run `a. b` first.");
        assert_eq!(first_sentence("No end"), "No end");
        assert_eq!(first_sentence("Wide (thesis, fig. 2.3. And 4). More."), "Wide (thesis, fig. 2.3. And 4).");
        assert_eq!(first_sentence("Version 1.2 of it. More"), "Version 1.2 of it.");
    }
}
