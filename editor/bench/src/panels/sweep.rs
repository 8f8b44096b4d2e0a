//! The panel of a parameter sweep: its settings, and a plot of the measure over the parameter. The graph in the window keeps running.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::{
    Align, Button, ComboBox, Id, Label, Layout, PopupCloseBehavior, ProgressBar, Response, RichText, ScrollArea,
    TextEdit, Ui, WidgetInfo, WidgetType, vec2,
};
use egui_plot::{Corner, Legend, Line, Plot, PlotPoints, Points};
use panoscope_base::packet::has_numbers;
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::numbers::drag_value;
use panoscope_eval::sweep::{COUNTERS, MAX_STEPS, Point, Request, can_sweep, csv};
use panoscope_graph::ParamKind;
use panoscope_host::loader::Loader;

use super::cutout::Cutout;
use super::plots::Export;
use panoscope_editor_model::content::Content;
use panoscope_editor_model::document::Document;
use panoscope_editor_model::observe::{Counters, Output};
use panoscope_editor_model::picture::short;
use panoscope_editor_model::sweeping::{Job, Progress};
use panoscope_editor_widgets::OutputCache;
use panoscope_editor_widgets::theme;
use panoscope_editor_widgets::unit_suffix;

/// Width of the settings, in points.
const SETTINGS_WIDTH: f32 = 320.0;
/// Number of threads of a sweep; the others are left to the graph in the window.
const THREADS: usize = 1;

/// A request of this panel.
pub enum SweepRequest {
    /// Start a sweep over a recording; an empty path for the graph's own sources.
    Start(Request, PathBuf),
    /// Export the result.
    Export(Export),
    /// Pick a recording.
    Browse,
}

/// The state of the panel.
pub struct SweepPanel {
    /// `node.param`.
    param: String,
    from: f64,
    to: f64,
    steps: usize,
    frames: u64,
    measure: String,
    /// A recording's file; empty for the graph's own sources.
    pub recording: String,
    job: Option<Job>,
    wrong: Option<String>,
    cutout: Cutout,
    /// What the lists of parameters and of measures are filtered by.
    filters: [String; 2],
}

impl Default for SweepPanel {
    fn default() -> Self {
        Self {
            param: String::new(),
            from: 0.0,
            to: 1.0,
            steps: 9,
            frames: 100,
            measure: String::new(),
            recording: String::new(),
            job: None,
            wrong: None,
            cutout: Cutout::default(),
            filters: [String::new(), String::new()],
        }
    }
}

impl SweepPanel {
    /// The progress of the last sweep.
    pub fn progress(&self) -> Option<Progress> {
        self.job.as_ref().map(Job::progress)
    }

    /// Starts a sweep and ends a running one.
    pub fn start(
        &mut self,
        request: Request,
        recording: PathBuf,
        loader: Arc<Loader>,
        wake: impl Fn() + Send + 'static,
    ) {
        self.job = None;
        match Job::start(request, recording, loader, wake) {
            Ok(job) => (self.job, self.wrong) = (Some(job), None),
            Err(error) => self.wrong = Some(text!("sweep-no-thread", reason = error.to_string())),
        }
    }

    /// Selects a parameter and its whole range for the next sweep.
    pub fn choose(&mut self, document: &Document, node: &str, param: &str) {
        // The sweep runs the flat graph.
        self.param = document.resolve_param(&format!("{node}.{param}"));
        let (node, param) = self.param.split_once('.').unwrap_or((node, param));
        let view = document.view().flat();
        let kind = view.node(node).and_then(|n| {
            let node_type = view.nodes[n].node_type.as_ref()?;
            node_type.params.iter().find(|p| p.name == param).map(|p| p.kind.clone())
        });
        let ends = |default: f64, min: Option<f64>, max: Option<f64>| {
            let reach = default.abs().max(1.0);
            (min.unwrap_or(default - reach), max.unwrap_or(default + reach))
        };
        (self.from, self.to) = match kind {
            Some(ParamKind::Int { default, min, max, .. }) => {
                ends(default as f64, min.map(|m| m as f64), max.map(|m| m as f64))
            }
            Some(ParamKind::Float { default, min, max, .. }) => ends(default, min, max),
            _ => (0.0, 1.0),
        };
    }

    /// The request for a short sweep of the selected parameter.
    pub fn quick(&mut self, document: &Document, path: &Path, measure: &str) -> SweepRequest {
        measure.clone_into(&mut self.measure);
        self.frames = 6;
        self.request(document, path)
    }

    /// Shows the panel; returns the user's request.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        document: &Document,
        counters: &Counters,
        shown: &OutputCache,
        selected: Option<&str>,
        path: &Path,
    ) -> Option<SweepRequest> {
        let mut request = self.cutout.taken(ui.ctx()).map(|picture| SweepRequest::Export(Export::Picture(picture)));
        let progress = self.progress();
        if !sweepable(document).contains(&self.param) {
            let all = sweepable(document);
            let of_selected = selected.and_then(|id| all.iter().find(|p| p.split('.').next() == Some(id)));
            match of_selected.or(all.first()).and_then(|p| p.split_once('.')) {
                Some((node, param)) => self.choose(document, node, param),
                None => self.param.clear(),
            }
        }
        ui.horizontal_top(|ui| {
            ui.allocate_ui_with_layout(
                vec2(SETTINGS_WIDTH, ui.available_height()),
                Layout::top_down(Align::Min),
                |ui| {
                    ui.set_width(SETTINGS_WIDTH);
                    ScrollArea::vertical().id_salt("sweep settings").auto_shrink([false, false]).show(ui, |ui| {
                        let requested = self.settings(ui, document, counters, shown, path, progress.as_ref());
                        request = requested.or(request.take());
                    });
                },
            );
            ui.separator();
            ui.vertical(|ui| {
                let export = self.result(ui, progress.as_ref());
                request = export.map(SweepRequest::Export).or(request.take());
            });
        });
        request
    }

    fn settings(
        &mut self,
        ui: &mut Ui,
        document: &Document,
        counters: &Counters,
        shown: &OutputCache,
        path: &Path,
        progress: Option<&Progress>,
    ) -> Option<SweepRequest> {
        let mut request = None;
        let runs = progress.is_some_and(|p| !p.done);
        ui.spacing_mut().item_spacing.y = theme::STEP;
        row(ui, text!("sweep-parameter"), |ui| {
            let now = self.param.clone();
            let names = ("sweep param", now.as_str(), text!("sweep-parameter.name"), text!("sweep-parameter.filter"));
            let chosen = list(ui, names, &mut self.filters[0], &now, || sweepable(document));
            if let Some((node, name)) = chosen.as_ref().and_then(|param| param.split_once('.')) {
                self.choose(document, node, name);
            }
        });
        let (numbers, unit, step) = kind_of(document, &self.param);
        if numbers {
            row(ui, text!("sweep-range"), |ui| self.range(ui, &unit, step));
        }
        row(ui, text!("sweep-measure"), |ui| {
            let width = ui.available_width() - 8.0;
            let field =
                ui.add(TextEdit::singleline(&mut self.measure).hint_text("node.port.column").desired_width(width));
            name(ui, field.id, text!("sweep-measure.name"));
        });
        row(ui, "", |ui| {
            let names = (
                "sweep measures",
                text!("sweep-measures"),
                text!("sweep-measures.name"),
                text!("sweep-measures.filter"),
            );
            let now = self.measure.clone();
            let chosen = list(ui, names, &mut self.filters[1], &now, || measures(document, counters, shown));
            self.measure = chosen.unwrap_or(now);
        });
        row(ui, text!("sweep-pictures"), |ui| {
            let width = ui.available_width() - 72.0;
            let hint = text!("sweep-pictures.hint");
            let field = ui.add(TextEdit::singleline(&mut self.recording).hint_text(hint).desired_width(width));
            name(ui, field.id, text!("sweep-pictures.name"));
            if ui.button(text!("sweep-pictures.file")).on_hover_text(text!("sweep-pictures.file-hint")).clicked() {
                request = Some(SweepRequest::Browse);
            }
        });
        row(ui, text!("sweep-frames"), |ui| {
            let frames = ui.add(
                drag_value(&mut self.frames).range(1..=1_000_000).suffix(format!(" {}", text!("sweep-frames.suffix"))),
            );
            name(ui, frames.id, text!("sweep-frames.name"));
        });
        row(ui, "", |ui| {
            if runs {
                if ui.button(text!("sweep-cancel")).on_hover_text(text!("sweep-cancel.hint")).clicked()
                    && let Some(job) = &self.job
                {
                    job.cancel();
                }
            } else if ui
                .add_enabled(self.lacks(document).is_none(), Button::new(text!("sweep-start")))
                .on_hover_text(text!("sweep-start.hint"))
                .clicked()
            {
                request = Some(self.request(document, path));
            }
        });
        if let Some(lacks) = self.lacks(document).filter(|_| !runs) {
            ui.add(Label::new(RichText::new(lacks).size(12.0).color(theme::warn())).wrap());
        }
        request
    }

    /// Draws the range of a number and the steps in it.
    fn range(&mut self, ui: &mut Ui, unit: &str, step: Option<f64>) {
        let speed = step.unwrap_or((self.to - self.from).abs() / 100.0).max(1e-6);
        for (value, label) in [(&mut self.from, text!("sweep-range.from")), (&mut self.to, text!("sweep-range.to"))] {
            let drag = ui.add(drag_value(value).speed(speed).max_decimals(4).suffix(unit));
            name(ui, drag.id, label);
        }
        let suffix = format!(" {}", text!("sweep-steps.suffix"));
        let steps = ui.add(drag_value(&mut self.steps).range(2..=MAX_STEPS).suffix(suffix));
        name(ui, steps.id, text!("sweep-steps"));
    }

    /// Why the sweep cannot start.
    fn lacks(&self, document: &Document) -> Option<&'static str> {
        match () {
            () if !document.view().valid => Some(text!("sweep-lacks-graph")),
            () if self.param.is_empty() => Some(text!("sweep-lacks-parameter")),
            () if self.measure.trim().is_empty() => Some(text!("sweep-lacks-measure")),
            () => None,
        }
    }

    fn request(&self, document: &Document, path: &Path) -> SweepRequest {
        let recording = self.recording.trim();
        let recording = match recording.is_empty() {
            true => PathBuf::new(),
            false => path.parent().unwrap_or(Path::new("")).join(recording),
        };
        let request = Request {
            path: path.to_owned(),
            text: document.whole().to_string(),
            settings: Vec::new(),
            param: self.param.clone(),
            from: Some(self.from),
            to: Some(self.to),
            steps: self.steps,
            measure: self.measure.trim().to_owned(),
            frames: self.frames,
            recording: None,
            threads: THREADS,
        };
        SweepRequest::Start(request, recording)
    }

    /// Shows the progress and the plot, or why there is none; returns what to export.
    fn result(&mut self, ui: &mut Ui, progress: Option<&Progress>) -> Option<Export> {
        let wrong = self.wrong.as_ref().or(progress.and_then(|p| p.failed.as_ref()));
        let words = wrong.map(|error| Label::new(RichText::new(error).color(theme::fault())).wrap());
        let Some(progress) = progress else {
            if let Some(words) = words {
                ui.add(words);
                return None;
            }
            let caption = text!("sweep-about");
            ui.label(RichText::new(caption).color(theme::muted()));
            return None;
        };
        let mut export = None;
        let mut requested = false;
        ui.horizontal(|ui| {
            ui.label(text!("sweep-title", measure = &progress.measure, param = &progress.param));
            let caption = match (progress.total, progress.points.len()) {
                _ if progress.failed.is_some() => text!("sweep-not-started").to_owned(),
                (0, _) => text!("sweep-preparing").to_owned(),
                (total, done) if progress.cancelled => text!("sweep-cancelled", count = done, total = total),
                (total, done) if progress.done => text!("sweep-done", count = done, total = total),
                (total, done) => {
                    ui.add(ProgressBar::new(done as f32 / total as f32).desired_width(120.0));
                    text!("sweep-progress", count = done, total = total)
                }
            };
            ui.label(RichText::new(caption).color(theme::muted()));
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                let some = !progress.points.is_empty();
                let png = ui.add_enabled(some, Button::new("PNG")).on_hover_text(text!("export-png-hint"));
                requested = png.clicked();
                let table = ui.add_enabled(some, Button::new("CSV")).on_hover_text(text!("export-csv-hint"));
                if table.clicked() {
                    export = Some(Export::Csv(csv(&progress.param, &progress.measure, &progress.points)));
                }
            });
        });
        if let Some(words) = words {
            ui.add(words);
            return None;
        }
        let failed = progress.points.iter().find_map(|p| Some((&p.value, p.result.as_ref().err()?)));
        if let Some((value, why)) = failed {
            let caption = text!(
                "sweep-failed",
                value = value.to_string(),
                reason = why.reason.lines().next().unwrap_or_default()
            );
            ui.add(Label::new(RichText::new(caption).size(12.0).color(theme::fault())).truncate());
        }
        let response = plot(ui, progress);
        if requested {
            self.cutout.request(ui.ctx(), response.rect);
        }
        export
    }
}

fn plot(ui: &mut Ui, progress: &Progress) -> Response {
    let known = |points: &[Point]| -> Vec<(f64, panoscope_eval::sweep::Summary)> {
        points.iter().filter_map(|p| Some((p.at, *p.result.as_ref().ok()?))).collect()
    };
    let known = known(&progress.points);
    let labels: Vec<(f64, String)> = progress.points.iter().map(|p| (p.at, p.value.clone())).collect();
    let is_text = progress.is_text;
    let axis = match progress.unit.is_empty() {
        true => progress.param.clone(),
        false => format!("{} [{}]", progress.param, progress.unit),
    };
    ui.visuals_mut().override_text_color = Some(theme::muted().gamma_multiply(0.8));
    let shown = Plot::new("sweep")
        .legend(Legend::default().position(Corner::LeftTop))
        .x_axis_label(axis)
        .y_axis_label(&progress.measure)
        .allow_scroll(false)
        .x_axis_formatter(move |mark, _| {
            let near = |(at, _): &&(f64, String)| (at - mark.value).abs() < 1e-9 && at.fract() == 0.0;
            // Words have no labels between them.
            let between = || if is_text { String::new() } else { short(mark.value) };
            labels.iter().find(near).map_or_else(between, |(_, word)| word.clone())
        })
        .show(ui, |plot| {
            for (at, s) in &known {
                let ends: PlotPoints<'_> = vec![[*at, s.min], [*at, s.max]].into();
                plot.line(Line::new(text!("sweep-ends"), ends).color(theme::class(1).gamma_multiply(0.7)).width(2.0));
            }
            let means: PlotPoints<'_> = known.iter().map(|(at, s)| [*at, s.mean]).collect();
            if !is_text {
                plot.line(Line::new(text!("sweep-mean"), means).color(theme::class(0)).width(1.8));
            }
            let dots: PlotPoints<'_> = known.iter().map(|(at, s)| [*at, s.mean]).collect();
            plot.points(Points::new(text!("sweep-mean"), dots).color(theme::class(0)).radius(3.0));
        });
    let place = |at: f64| {
        let word = progress.points.iter().find(|p| is_text && p.at == at);
        word.map_or_else(|| short(at), |p| p.value.clone())
    };
    let description =
        known.iter().map(|(at, s)| format!("{}: {}", place(*at), short(s.mean))).collect::<Vec<_>>().join(", ");
    shown
        .response
        .widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, text!("sweep-name", values = &description)));
    shown.response
}

fn row(ui: &mut Ui, label: &str, add: impl FnOnce(&mut Ui)) {
    ui.horizontal(|ui| {
        ui.allocate_ui_with_layout(vec2(72.0, 24.0), Layout::left_to_right(Align::Center), |ui| {
            ui.set_min_width(72.0);
            ui.label(RichText::new(label).size(12.0).color(theme::muted()));
        });
        add(ui);
    });
}

/// Shows a list that opens, with a field that filters it; `(id, caption, name, name of the filter)`. Returns what was chosen.
fn list(
    ui: &mut Ui,
    (id, caption, label, filter_name): (&str, &str, &str, &str),
    filter: &mut String,
    now: &str,
    all: impl FnOnce() -> Vec<String>,
) -> Option<String> {
    let combo = ComboBox::from_id_salt(id).selected_text(caption).width(ui.available_width() - 8.0);
    let combo = combo.close_behavior(PopupCloseBehavior::CloseOnClickOutside);
    let response = combo.show_ui(ui, |ui| {
        let field = ui.add(TextEdit::singleline(filter).hint_text(filter_name).desired_width(f32::INFINITY));
        name(ui, field.id, filter_name);
        let wanted: Vec<String> = filter.split_whitespace().map(str::to_lowercase).collect();
        let fits = |entry: &String| wanted.iter().all(|word| entry.to_lowercase().contains(word));
        let mut chosen = None;
        for entry in all().into_iter().filter(fits) {
            if ui.selectable_label(entry == now, &entry).clicked() {
                chosen = Some(entry);
                ui.close();
            }
        }
        chosen
    });
    name(ui, response.response.id, label);
    response.inner.flatten()
}

fn name(ui: &Ui, id: Id, label: &str) {
    ui.ctx().accesskit_node_builder(id, |node| node.set_label(label.to_owned()));
}

/// The parameters that can be swept, as `node.param`.
fn sweepable(document: &Document) -> Vec<String> {
    let nodes = document.view().flat().nodes.iter();
    let params = nodes.flat_map(|n| n.node_type.iter().flat_map(|t| &t.params).map(move |p| (n.id(), p)));
    params.filter(|(_, p)| can_sweep(&p.kind)).map(|(id, p)| format!("{id}.{}", p.name)).collect()
}

/// Whether a parameter is a number; its unit, to follow a number; its step.
fn kind_of(document: &Document, param: &str) -> (bool, String, Option<f64>) {
    let view = document.view().flat();
    let declared = param.split_once('.').and_then(|(node, param)| {
        let node_type = view.nodes[view.node(node)?].node_type.as_ref()?;
        node_type.params.iter().find(|p| p.name == param)
    });
    let Some(declared) = declared else { return (false, String::new(), None) };
    let unit = unit_suffix(&declared.unit);
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    match &declared.kind {
        ParamKind::Int { step, .. } => (true, unit, Some(step.unwrap_or(1) as f64)),
        ParamKind::Float { step, .. } => (true, unit, *step),
        _ => (false, unit, None),
    }
}

/// Possible measures: scalar outputs, columns of tables received so far, metrics, times.
fn measures(document: &Document, counters: &Counters, shown: &OutputCache) -> Vec<String> {
    let mut found = Vec::new();
    let flat = document.view().flat();
    for node in &flat.nodes {
        let outputs = node.node_type.iter().flat_map(|t| &t.outputs).filter(|p| has_numbers(&p.packet.name));
        for port in outputs {
            let output = Output::new(node.id(), &port.name);
            if port.packet.name == "scalar" {
                found.push(output.to_string());
            } else if let Some(Content::Numbers(numbers)) = shown.packet(&output).map(|l| &l.content) {
                found.extend(numbers.iter().map(|(column, _)| format!("{output}.{column}")));
            }
        }
    }
    let running = || counters.nodes.iter().filter(|(id, _)| flat.node(id).is_some());
    for (id, node) in running() {
        found.extend(node.metrics.iter().map(|(name, _)| format!("{id}.{name}")));
    }
    found.extend(running().map(|(id, _)| id).map(|id| format!("{id}.{}", COUNTERS[0])));
    found
}
