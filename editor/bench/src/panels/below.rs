//! The panel of problems below the canvas, and the panel of the file's text beside it.

use eframe::egui::text::LayoutJob;
use eframe::egui::{
    Align, Color32, FontId, Label, Rect, RichText, ScrollArea, Sense, TextFormat, Ui, WidgetInfo, WidgetType, pos2,
    vec2,
};
use panoscope_editor_model::texts::{decimal, text};
use panoscope_graph::Severity;

use super::inspector::section;
use panoscope_editor_model::document::Document;
use panoscope_editor_model::graph_view::without_name;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::problems::action_name;
use panoscope_editor_model::session::Status;
use panoscope_editor_widgets::theme;

/// The location of a problem.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Spot {
    /// The node, if the problem is in one.
    pub node: Option<String>,
    /// Line of the file, from 1.
    pub line: Option<usize>,
}

/// Shows mistakes in the file and recent faults; returns the location of the one that was clicked.
pub fn problems(ui: &mut Ui, document: &Document, status: &Status, counters: &Counters) -> Option<Spot> {
    let view = document.view();
    let mut go = None;
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        if let Some(problem) = &status.problem {
            let place = problem.node.clone().unwrap_or_else(|| text!("mistakes-change").to_owned());
            if row(ui, theme::fault(), &place, &problem.message) {
                go = Some(Spot { node: problem.node.clone(), line: None });
            }
        }
        for d in &view.diagnostics {
            let node = view.node_of(d, document.text());
            let color = if d.severity == Severity::Error { theme::fault() } else { theme::warn() };
            let place = match d.file == view.file {
                true => text!("problem-line", line = d.line),
                false => text!("problem-line-of", file = &d.file, line = d.line),
            };
            let mut message = d.message.clone();
            for more in [&d.label, &d.help] {
                if !more.is_empty() {
                    message += &format!(" · {more}");
                }
            }
            if row(ui, color, &place, &message) {
                go = Some(Spot { node, line: (d.file == view.file).then_some(d.line) });
            }
        }
        if view.diagnostics.is_empty() && status.problem.is_none() {
            ui.label(RichText::new(text!("mistakes-none")).color(theme::muted()));
        }
        if !counters.fault_list.is_empty() {
            section(ui, text!("mistakes-faults"));
        }
        for fault in counters.fault_list.iter().rev().take(100) {
            let known = !counters.faults.contains_key(&fault.node);
            let color = if known { theme::muted() } else { theme::warn() };
            let place = text!("mistakes-at", seconds = decimal(fault.run_ms / 1e3, 1), node = &fault.node);
            let message = format!("{} ({})", without_name(&fault.words, &fault.node), action_name(fault.done));
            if row(ui, color, &place, &message) {
                go = Some(Spot { node: Some(fault.node.clone()), line: None });
            }
        }
    });
    go
}

fn row(ui: &mut Ui, color: Color32, place: &str, message: &str) -> bool {
    let mut job = LayoutJob::default();
    let format = |color, size| TextFormat { font_id: FontId::proportional(size), color, ..TextFormat::default() };
    job.append(&format!("{place}   "), 0.0, format(color, 12.0));
    job.append(message, 0.0, format(theme::text(), 12.0));
    let label = ui.add(Label::new(job).sense(Sense::click()).selectable(false));
    let name = format!("{place}: {message}");
    label.widget_info(|| WidgetInfo::labeled(WidgetType::Link, true, name.clone()));
    label.on_hover_cursor(eframe::egui::CursorIcon::PointingHand).clicked()
}

/// The highlighted line of the text.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reading {
    line: Option<usize>,
    /// Whether to scroll to it.
    go: bool,
}

impl Reading {
    /// Highlights a line and scrolls to it.
    pub fn go_to(&mut self, line: usize) {
        *self = Self { line: Some(line), go: true };
    }
}

/// Shows the file's text, read-only with line numbers. Highlights the lines of `marked` nodes and the line of `reading`.
pub fn text(ui: &mut Ui, document: &Document, marked: &[String], reading: &mut Reading) {
    let font = FontId::monospace(12.0);
    let plain = |color| TextFormat { font_id: font.clone(), color, ..TextFormat::default() };
    let of_file = document.view().diagnostics.iter().filter(|d| d.file == document.view().file);
    let wrong: Vec<usize> = of_file.map(|d| d.line).collect();
    ScrollArea::both().auto_shrink([false, false]).show(ui, |ui| {
        let mut inside = false;
        let mut job = LayoutJob::default();
        for (number, line) in document.text().lines().enumerate() {
            if line.starts_with('[') {
                inside = marked.iter().any(|id| {
                    let rest = line.strip_prefix("[nodes.").and_then(|l| l.strip_prefix(id.as_str()));
                    rest.is_some_and(|r| r.starts_with([']', '.']))
                });
            }
            let mark = if wrong.contains(&(number + 1)) { theme::fault() } else { theme::muted().gamma_multiply(0.6) };
            job.append(&format!("{:>4}  ", number + 1), 0.0, plain(mark));
            for (part, color) in coloured(line) {
                let mut format = plain(color);
                if reading.line == Some(number + 1) {
                    format.background = theme::fault().gamma_multiply(0.25);
                } else if inside {
                    format.background = theme::accent().gamma_multiply(0.12);
                }
                job.append(part, 0.0, format);
            }
            job.append("\n", 0.0, plain(theme::text()));
        }
        let label = ui.add(Label::new(job).extend());
        label.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, text!("text-name")));
        if let Some(line) = reading.line.filter(|_| std::mem::take(&mut reading.go)) {
            // All lines have the same height; the text ends with an empty line.
            let height = label.rect.height() / (document.text().lines().count() + 1) as f32;
            let top = label.rect.top() + (line.max(1) - 1) as f32 * height;
            let at = Rect::from_min_size(pos2(label.rect.left(), top), vec2(1.0, height));
            ui.scroll_to_rect(at, Some(Align::Center));
        }
    });
}

/// Splits a line of TOML into coloured parts: header or key, value, comment.
fn coloured(line: &str) -> Vec<(&str, Color32)> {
    let mut quoted = false;
    let comment = line.char_indices().find(|&(_, c)| {
        quoted ^= c == '"';
        c == '#' && !quoted
    });
    let (code, comment) = line.split_at(comment.map_or(line.len(), |(at, _)| at));
    let mut parts = if code.starts_with('[') {
        vec![(code, theme::accent())]
    } else if let Some(at) = code.find('=') {
        vec![(&code[..at], theme::muted()), (&code[at..], theme::text())]
    } else {
        vec![(code, theme::text())]
    };
    parts.push((comment, theme::family("source")));
    parts
}
