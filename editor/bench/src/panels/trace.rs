//! The panel of tick paths: dropped and late ticks, and for the chosen one when each node worked and what it waited for.

use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{Align2, Button, FontId, Rect, RichText, ScrollArea, Sense, Ui, WidgetInfo, WidgetType, pos2, vec2};

use super::inspector::section;
use panoscope_editor_model::graph_view::GraphView;
use panoscope_editor_model::texts::text;
use panoscope_editor_model::trace::{Path, Step, TickEntry, Trace};
use panoscope_editor_widgets::{format_time, theme};

/// Time between two readings of the list.
const INTERVAL: Duration = Duration::from_secs(1);
/// Width of the list, points.
const LIST_WIDTH: f32 = 330.0;
/// Width of the names of nodes, points.
const NAMES: f32 = 150.0;
/// Width of the words behind the bars, points.
const WORDS: f32 = 210.0;
const ROW: f32 = 22.0;

/// The state of the panel.
#[derive(Default)]
pub struct TracePanel {
    list: Vec<TickEntry>,
    read: Option<Instant>,
    chosen: Option<(TickEntry, Path)>,
    /// A source whose newest dropped tick is to be chosen.
    wanted: Option<String>,
}

impl TracePanel {
    /// Chooses the newest dropped tick of a source.
    pub fn choose_drop_of(&mut self, source: &str) {
        (self.wanted, self.read) = (Some(source.to_owned()), None);
    }

    /// The path that is shown.
    pub fn path(&self) -> Option<&Path> {
        self.chosen.as_ref().map(|(_, path)| path)
    }

    /// The dropped and late ticks that are listed.
    pub fn list(&self) -> &[TickEntry] {
        &self.list
    }

    /// Shows the panel; returns the node that was clicked. `machine` is where the graph runs, if that is not here.
    pub fn show(&mut self, ui: &mut Ui, view: &GraphView, trace: &Arc<Trace>, machine: Option<&str>) -> Option<String> {
        if let Some(machine) = machine {
            section(ui, text!("trace-heading"));
            let words = text!("trace-elsewhere", machine = machine);
            ui.label(RichText::new(words).color(theme::muted()));
            return None;
        }
        if self.read.is_none_or(|read| read.elapsed() > INTERVAL) {
            self.list = trace.notable(view);
            self.read = Some(Instant::now());
            let wanted = self.wanted.take_if(|_| !self.list.is_empty());
            let drop_of =
                |source: String| self.list.iter().find(|e| e.source == source && e.dropped.is_some()).cloned();
            if let Some(entry) = wanted.and_then(drop_of) {
                self.choose(view, trace, entry);
            }
        }
        ui.ctx().request_repaint_after(INTERVAL);
        let mut go = None;
        ui.horizontal_top(|ui| {
            ui.vertical(|ui| {
                ui.set_width(LIST_WIDTH);
                section(ui, text!("trace-heading"));
                ScrollArea::vertical().id_salt("ticks").auto_shrink([false, false]).show(ui, |ui| {
                    if self.list.is_empty() {
                        ui.label(RichText::new(text!("trace-heading.none")).color(theme::muted()));
                    }
                    for entry in self.list.clone() {
                        if entry_row(ui, &entry, self.chosen.as_ref().is_some_and(|(chosen, _)| *chosen == entry)) {
                            self.choose(view, trace, entry);
                        }
                    }
                });
            });
            ui.vertical(|ui| match &self.chosen {
                Some((entry, path)) => go = path_of(ui, view, entry, path),
                None => {
                    section(ui, text!("trace-path"));
                    let caption = text!("trace-path.about");
                    ui.label(RichText::new(caption).color(theme::muted()));
                }
            });
        });
        go
    }

    fn choose(&mut self, view: &GraphView, trace: &Arc<Trace>, entry: TickEntry) {
        // One that is not remembered any more leaves the shown one.
        if let Some(path) = trace.path(view, &entry) {
            self.chosen = Some((entry, path));
        }
    }
}

fn words_of(entry: &TickEntry) -> String {
    match &entry.dropped {
        Some(reason) => {
            let at = match reason.at.is_empty() {
                true => text!("trace-on-its-way").to_owned(),
                false => reason.at.join(", "),
            };
            text!("trace-dropped", tick = entry.seq, source = &entry.source, behind = reason.behind, nodes = at)
        }
        None => text!("trace-late", tick = entry.seq, source = &entry.source, time = format_time(entry.total_ms)),
    }
}

fn entry_row(ui: &mut Ui, entry: &TickEntry, chosen: bool) -> bool {
    let words = words_of(entry);
    let color = if entry.dropped.is_some() { theme::warn() } else { theme::text() };
    let button = Button::new(RichText::new(&words).size(12.0).color(color)).selected(chosen).wrap();
    let row = ui.add(button.frame_when_inactive(chosen));
    row.widget_info(|| WidgetInfo::selected(WidgetType::Button, true, chosen, words.clone()));
    row.clicked()
}

/// Draws the path of a tick; returns the node that was clicked.
fn path_of(ui: &mut Ui, view: &GraphView, entry: &TickEntry, path: &Path) -> Option<String> {
    let heading = match &entry.dropped {
        Some(_) => text!("trace-in-the-way", tick = path.seq, source = &path.source, dropped = entry.seq),
        None => text!("trace-path-of", tick = path.seq, source = &path.source),
    };
    section(ui, &heading);
    if let Some(longest) = path.longest() {
        let label = ui.label(RichText::new(&longest).size(13.0).color(theme::warn()));
        label.widget_info(|| {
            WidgetInfo::labeled(
                WidgetType::Label,
                true,
                text!("trace-path-name", heading = &heading, longest = &longest),
            )
        });
    }
    let from = path.steps.iter().map(|step| step.start_ms.min(step.ready_ms)).fold(0.0, f64::min);
    let to = path.steps.iter().map(|step| step.end_ms).fold(0.1, f64::max);
    let mut go = None;
    ScrollArea::vertical().id_salt("path").auto_shrink([false, false]).show(ui, |ui| {
        ui.spacing_mut().item_spacing.y = 2.0;
        for step in &path.steps {
            if step_row(ui, view, step, (from, to)) {
                go = Some(step.node.clone());
            }
        }
    });
    go
}

fn step_row(ui: &mut Ui, view: &GraphView, step: &Step, (from, to): (f64, f64)) -> bool {
    let (rect, row) = ui.allocate_exact_size(vec2(ui.available_width(), ROW), Sense::click());
    let mut words = format_time(step.work_ms());
    if !step.made {
        words = text!("trace-no-output").to_owned();
    }
    if step.wait_ms() >= 0.05 {
        let time = format_time(step.wait_ms());
        words = match &step.after {
            Some(after) => text!("trace-waited-after", work = words, time = time, node = after),
            None => text!("trace-waited", work = words, time = time),
        };
    }
    let name = text!("trace-step", node = &step.node, found = &words);
    row.widget_info(|| WidgetInfo::labeled(WidgetType::Link, true, name.clone()));
    let painter = ui.painter_at(rect);
    if row.hovered() {
        painter.rect_filled(rect, 3.0, theme::raised());
    }
    let font = FontId::proportional(12.0);
    let names = painter.with_clip_rect(rect.with_max_x(rect.left() + NAMES - 6.0));
    names.text(rect.left_center(), Align2::LEFT_CENTER, &step.node, font.clone(), theme::text());
    let bars = Rect::from_min_max(pos2(rect.left() + NAMES, rect.top() + 4.0), rect.max - vec2(WORDS, 4.0));
    let x = |ms: f64| bars.left() + bars.width() * ((ms - from) / (to - from).max(1e-9)) as f32;
    let flat = view.flat();
    let family = flat.node(&step.node).map_or("", |n| flat.nodes[n].family());
    let middle = bars.center().y;
    let wait = Rect::from_min_max(pos2(x(step.ready_ms), middle - 1.5), pos2(x(step.start_ms), middle + 1.5));
    painter.rect_filled(wait, 1.0, theme::warn());
    let mut work = Rect::from_min_max(pos2(x(step.start_ms), bars.top()), pos2(x(step.end_ms), bars.bottom()));
    work.max.x = work.max.x.max(work.min.x + 2.0);
    let color = if step.made { theme::family(family) } else { theme::muted() };
    painter.rect_filled(work, 2.0, color);
    let at = pos2(rect.right() - WORDS + 8.0, rect.center().y);
    painter.text(at, Align2::LEFT_CENTER, words, font, theme::muted());
    row.clicked()
}
