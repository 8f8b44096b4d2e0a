//! What can stand below the canvas: mistakes and faults; and the file's text beside it.

use eframe::egui::text::LayoutJob;
use eframe::egui::{
    Align, Color32, FontId, Label, Rect, RichText, ScrollArea, Sense, TextFormat, Ui, WidgetInfo, WidgetType, pos2,
    vec2,
};
use panoscope_graph::Severity;

use super::inspector::section;
use panoscope_editor_model::document::Document;
use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::session::Status;
use panoscope_editor_widgets::theme;

/// Where something is wrong.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Spot {
    /// The node, where it is one's.
    pub node: Option<String>,
    /// Line of the file, from 1 on.
    pub line: Option<usize>,
}

/// What is wrong, and what went wrong; answers the place that was clicked.
pub fn problems(ui: &mut Ui, document: &Document, status: &Status, counters: &Counters) -> Option<Spot> {
    let view = document.view();
    let mut go = None;
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        if let Some(trouble) = &status.trouble {
            let place = trouble.node.clone().unwrap_or_else(|| "change refused".to_owned());
            if row(ui, theme::FAULT, &place, &trouble.words) {
                go = Some(Spot { node: trouble.node.clone(), line: None });
            }
        }
        for d in &view.diagnostics {
            let node = view.node_of(d, document.text());
            let color = if d.severity == Severity::Error { theme::FAULT } else { theme::WARN };
            let place = match d.file == view.file {
                true => format!("line {}", d.line),
                false => format!("{}, line {}", d.file, d.line),
            };
            let mut words = d.message.clone();
            for more in [&d.label, &d.help] {
                if !more.is_empty() {
                    words += &format!(" · {more}");
                }
            }
            if row(ui, color, &place, &words) {
                go = Some(Spot { node, line: (d.file == view.file).then_some(d.line) });
            }
        }
        if view.diagnostics.is_empty() && status.trouble.is_none() {
            ui.label(RichText::new("The file has no mistakes.").color(theme::MUTED));
        }
        if !counters.fault_list.is_empty() {
            section(ui, "Faults, newest first");
        }
        for fault in counters.fault_list.iter().rev().take(100) {
            let place = format!("{:.1} s  {}", fault.run_ms / 1e3, fault.node);
            let words = format!("{} ({})", fault.words, format!("{:?}", fault.done).to_lowercase());
            if row(ui, theme::WARN, &place, &words) {
                go = Some(Spot { node: Some(fault.node.clone()), line: None });
            }
        }
    });
    go
}

fn row(ui: &mut Ui, color: Color32, place: &str, words: &str) -> bool {
    let mut job = LayoutJob::default();
    let format = |color, size| TextFormat { font_id: FontId::proportional(size), color, ..TextFormat::default() };
    job.append(&format!("{place}   "), 0.0, format(color, 12.0));
    job.append(words, 0.0, format(theme::TEXT, 12.0));
    let label = ui.add(Label::new(job).sense(Sense::click()).selectable(false));
    let name = format!("{place}: {words}");
    label.widget_info(|| WidgetInfo::labeled(WidgetType::Link, true, name.clone()));
    label.on_hover_cursor(eframe::egui::CursorIcon::PointingHand).clicked()
}

/// The line that the text shows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reading {
    line: Option<usize>,
    /// It is not in view yet.
    go: bool,
}

impl Reading {
    /// Brings a line into view and makes it stand out.
    pub fn go_to(&mut self, line: usize) {
        *self = Self { line: Some(line), go: true };
    }
}

/// The file's text with its line numbers; the lines of `marked` nodes stand out, and the one that was asked for. To read only.
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
            let mark = if wrong.contains(&(number + 1)) { theme::FAULT } else { theme::MUTED.gamma_multiply(0.6) };
            job.append(&format!("{:>4}  ", number + 1), 0.0, plain(mark));
            for (words, color) in coloured(line) {
                let mut format = plain(color);
                if reading.line == Some(number + 1) {
                    format.background = theme::FAULT.gamma_multiply(0.25);
                } else if inside {
                    format.background = theme::ACCENT.gamma_multiply(0.12);
                }
                job.append(words, 0.0, format);
            }
            job.append("\n", 0.0, plain(theme::TEXT));
        }
        let label = ui.add(Label::new(job).extend());
        label.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, "Text of the file"));
        if let Some(line) = reading.line.filter(|_| std::mem::take(&mut reading.go)) {
            // Each line takes the same room; behind the last one is an empty one.
            let height = label.rect.height() / (document.text().lines().count() + 1) as f32;
            let top = label.rect.top() + (line.max(1) - 1) as f32 * height;
            let at = Rect::from_min_size(pos2(label.rect.left(), top), vec2(1.0, height));
            ui.scroll_to_rect(at, Some(Align::Center));
        }
    });
}

/// A line of TOML in parts: comment, header, key, the rest.
fn coloured(line: &str) -> Vec<(&str, Color32)> {
    let mut quoted = false;
    let comment = line.char_indices().find(|&(_, c)| {
        quoted ^= c == '"';
        c == '#' && !quoted
    });
    let (code, comment) = line.split_at(comment.map_or(line.len(), |(at, _)| at));
    let mut parts = if code.starts_with('[') {
        vec![(code, theme::ACCENT)]
    } else if let Some(at) = code.find('=') {
        vec![(&code[..at], theme::MUTED), (&code[at..], theme::TEXT)]
    } else {
        vec![(code, theme::TEXT)]
    };
    parts.push((comment, theme::family("source")));
    parts
}
