//! The panel of plots: times, rates and queues of nodes, and values of scalar and table outputs. Exports CSV and PNG.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;

use eframe::egui::{Align, Align2, Button, FontId, Layout, RichText, Ui, WidgetInfo, WidgetType};
use egui_plot::{Corner, Legend, Line, Plot, PlotPoints};

use super::cutout::Cutout;
use super::distribution::{self, Cell, Spread};
use panoscope_editor_model::content::Content;
use panoscope_editor_model::graph_view::GraphView;
use panoscope_editor_model::observe::{Counters, Output, Point};
use panoscope_editor_model::picture::short;
use panoscope_editor_model::texts::{number, text};
use panoscope_editor_widgets::OutputCache;
use panoscope_editor_widgets::theme;

/// Maximum number of curves.
const MAX_CURVES: usize = 8;
/// Maximum number of points of a value's curve.
const HISTORY: usize = 1200;

/// What the curves show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// Median time of a call, ms.
    #[default]
    Times,
    /// 99th percentile of the time of a call, ms.
    Slowest,
    /// Calls per second.
    Rate,
    /// Maximum queue length of a wire.
    Queues,
    /// Values of scalar and table outputs.
    Values,
    /// One such value over another.
    Scatter,
    /// How one such value spreads over time.
    Histogram,
}

impl Kind {
    const ALL: [Self; 7] =
        [Self::Times, Self::Slowest, Self::Rate, Self::Queues, Self::Values, Self::Scatter, Self::Histogram];

    fn label(self) -> &'static str {
        match self {
            Self::Times => text!("plot-times"),
            Self::Slowest => text!("plot-slowest"),
            Self::Rate => text!("plot-rate"),
            Self::Queues => text!("plot-queues"),
            Self::Values => text!("plot-values"),
            Self::Scatter => text!("plot-scatter"),
            Self::Histogram => text!("plot-histogram"),
        }
    }

    fn axis(self) -> &'static str {
        match self {
            Self::Times | Self::Slowest => text!("plot-times.axis"),
            Self::Rate => text!("plot-rate.axis"),
            Self::Queues => text!("plot-queues.axis"),
            Self::Values | Self::Scatter | Self::Histogram => text!("plot-values.axis"),
        }
    }

    /// The name of the values in a file, in every language.
    fn column(self) -> &'static str {
        match self {
            Self::Times | Self::Slowest => "ms_per_call",
            Self::Rate => "calls_per_second",
            Self::Queues => "packets_waiting",
            Self::Values | Self::Scatter | Self::Histogram => "value",
        }
    }

    fn of(self, point: &Point) -> f64 {
        match self {
            Self::Slowest => point.p99_ms,
            Self::Rate => point.fps,
            _ => point.p50_ms,
        }
    }
}

/// A curve: its name, and its points as [seconds before now, value].
type Curve = (String, Vec<[f64; 2]>);

/// The state of the panel.
#[derive(Default)]
pub struct Plots {
    kind: Kind,
    values: BTreeMap<String, VecDeque<[f64; 2]>>,
    seen: BTreeMap<Output, u64>,
    /// The values that are set against each other; the second one also for its histogram.
    x: String,
    y: String,
    cutout: Cutout,
}

/// The contents of an exported file.
pub enum Export {
    /// A table of all curves.
    Csv(String),
    /// An image of the plot.
    Picture(image::RgbImage),
}

impl Plots {
    /// Whether values of outputs are shown.
    pub fn wants_values(&self) -> bool {
        matches!(self.kind, Kind::Values | Kind::Scatter | Kind::Histogram)
    }

    /// Sets what the curves show.
    pub fn set_kind(&mut self, kind: Kind) {
        self.kind = kind;
    }

    /// Appends the newest values of the outputs to their curves.
    pub fn follow(&mut self, shown: &OutputCache, outputs: &[Output]) {
        for output in outputs {
            let Some(packet) = shown.packet(output) else { continue };
            let Content::Numbers(numbers) = &packet.content else { continue };
            let last = self.seen.insert(output.clone(), packet.seq);
            if last == Some(packet.seq) {
                continue;
            }
            let restarted = last.is_some_and(|last| packet.seq < last);
            for (name, value) in numbers.iter().filter(|(_, value)| value.is_finite()) {
                let curve = self.values.entry(format!("{output} {name}")).or_default();
                if restarted {
                    curve.clear();
                }
                if curve.len() >= HISTORY {
                    curve.pop_front();
                }
                curve.push_back([packet.capture_ms / 1e3, *value]);
            }
        }
        self.values.retain(|name, _| outputs.iter().any(|o| name.starts_with(&format!("{o} "))));
    }

    fn curves(&self, view: &GraphView, counters: &Counters, selected: &[String]) -> Vec<Curve> {
        let chosen = |id: &str| selected.is_empty() || selected.iter().any(|s| s == id);
        if self.kind == Kind::Queues {
            // Wires whose queue was not always empty; the longest queue first.
            let most = |points: &VecDeque<[f64; 2]>| points.iter().map(|p| p[1]).fold(0.0, f64::max);
            let end = counters.queues.values().filter_map(|q| q.back()).map(|p| p[0]).fold(0.0, f64::max);
            let mut wires: Vec<_> =
                counters.queues.iter().filter(|(wire, q)| chosen(&wire.node) && most(q) > 0.0).collect();
            wires.sort_by(|a, b| most(b.1).total_cmp(&most(a.1)).then_with(|| a.0.cmp(b.0)));
            let curve = |(wire, q): (&panoscope_editor_model::observe::WireEnd, &VecDeque<[f64; 2]>)| {
                (view.wire_name(wire), q.iter().map(|p| [p[0] - end, p[1]]).collect())
            };
            return wires.into_iter().take(MAX_CURVES).map(curve).collect();
        }
        if self.kind == Kind::Values {
            let of_node = |name: &str| name.split('.').next().is_some_and(chosen);
            let curves = self.values.iter().filter(|(name, _)| of_node(name)).take(MAX_CURVES);
            let end = self.values.values().filter_map(|c| c.back()).map(|p| p[0]).fold(0.0, f64::max);
            return curves.map(|(name, c)| (name.clone(), c.iter().map(|p| [p[0] - end, p[1]]).collect())).collect();
        }
        let mut nodes: Vec<(&String, f64)> =
            counters.nodes.iter().filter(|(id, _)| chosen(id)).map(|(id, n)| (id, n.p50_ms)).collect();
        nodes.sort_by(|a, b| b.1.total_cmp(&a.1));
        let end = counters.history.values().filter_map(|h| h.back()).map(|p| p.at_s).fold(0.0, f64::max);
        let curve = |(id, _): (&String, f64)| {
            let history = counters.history.get(id)?;
            Some((id.clone(), history.iter().map(|p| [p.at_s - end, self.kind.of(p)]).collect()))
        };
        nodes.into_iter().take(MAX_CURVES).filter_map(curve).collect()
    }

    /// Shows the panel; returns what to export.
    pub fn show(&mut self, ui: &mut Ui, view: &GraphView, counters: &Counters, selected: &[String]) -> Option<Export> {
        let related = matches!(self.kind, Kind::Scatter | Kind::Histogram);
        let curves = if related { Vec::new() } else { self.curves(view, counters, selected) };
        let mut export = self.cutout.taken(ui.ctx()).map(Export::Picture);
        let empty = if related { self.values.is_empty() } else { curves.is_empty() };
        let mut requested = false;
        ui.horizontal(|ui| {
            for kind in Kind::ALL {
                if ui.add(Button::new(kind.label()).selected(self.kind == kind)).clicked() {
                    self.kind = kind;
                }
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                requested = ui.button("PNG").on_hover_text(text!("export-png-hint")).clicked();
                if ui.button("CSV").on_hover_text(text!("export-curves-hint")).clicked() {
                    export = Some(Export::Csv(self.table(&curves)));
                }
            });
        });
        let related = related.then(|| self.choose(ui));
        let mut plot = Plot::new(("curves", related.is_some())).allow_scroll(false).show_grid(!empty);
        plot = plot.y_axis_formatter(|mark, _| in_steps(mark.value, mark.step_size));
        plot = match (self.kind, &related) {
            (Kind::Scatter, _) => plot.x_axis_label(self.x.as_str()).y_axis_label(self.y.as_str()),
            (_, Some(_)) => {
                plot.y_axis_label(self.y.as_str()).x_axis_formatter(|mark, _| format!("{:.0} s", mark.value))
            }
            (kind, None) => {
                let legend = Legend::default().position(Corner::LeftTop);
                let curves = plot.legend(legend).y_axis_label(kind.axis()).include_x(-30.0).include_x(0.0);
                let curves = curves.x_axis_formatter(|mark, _| format!("{:.0} s", mark.value));
                if kind == Kind::Values { curves } else { curves.include_y(0.0) }
            }
        };
        // The grid uses the text colour.
        ui.visuals_mut().override_text_color = Some(theme::muted().gamma_multiply(0.8));
        let shown = plot.show(ui, |plot| {
            match &related {
                Some(Related::Pairs(pairs)) => distribution::scatter(plot, pairs),
                Some(Related::Spread(spread)) => distribution::histogram(plot, spread),
                None => {}
            }
            for (k, (name, points)) in curves.into_iter().enumerate() {
                let points: PlotPoints<'_> = points.into_iter().collect();
                plot.line(Line::new(name, points).color(theme::class(k as u32)).width(1.8));
            }
        });
        shown.response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, text!("plot-name")));
        if requested {
            self.cutout.request(ui.ctx(), shown.response.rect);
        }
        if empty {
            let caption = match self.kind {
                Kind::Queues => text!("plot-queues.none"),
                Kind::Values | Kind::Scatter | Kind::Histogram => text!("plot-values.none"),
                _ => text!("overview-nothing"),
            };
            let font = FontId::proportional(13.0);
            ui.painter().text(shown.response.rect.center(), Align2::CENTER_CENTER, caption, font, theme::muted());
        }
        export
    }
}

/// What is drawn of values that are related to each other or to time.
enum Related {
    Pairs(Vec<[f64; 2]>),
    Spread(Spread),
}

impl Plots {
    /// Shows which values are related; returns what to draw.
    fn choose(&mut self, ui: &mut Ui) -> Related {
        ui.horizontal(|ui| {
            let Self { kind, values, x, y, .. } = &mut *self;
            if *kind == Kind::Scatter {
                distribution::choose(ui, text!("plot-x"), x, values.keys());
            }
            distribution::choose(ui, text!("plot-y"), y, values.keys());
            let related = self.related();
            let about = match &related {
                Related::Pairs(pairs) => distribution::scatter_words(pairs),
                Related::Spread(Spread { mean, deviation, .. }) => {
                    let (mean, deviation) = (short(*mean), short(*deviation));
                    text!("plot-histogram-about", mean = mean, deviation = deviation)
                }
            };
            ui.label(RichText::new(about).size(12.0).color(theme::muted()));
            related
        })
        .inner
    }

    fn related(&self) -> Related {
        let none = VecDeque::new();
        let of = |name: &String| self.values.get(name).unwrap_or(&none);
        match self.kind {
            Kind::Scatter => Related::Pairs(distribution::pairs(of(&self.x), of(&self.y))),
            _ => Related::Spread(Spread::of(of(&self.y))),
        }
    }

    /// What is shown as CSV.
    fn table(&self, curves: &[Curve]) -> String {
        let mut out = String::new();
        match self.kind {
            Kind::Scatter | Kind::Histogram => match self.related() {
                Related::Pairs(pairs) => {
                    let _ = writeln!(out, "\"{}\",\"{}\"", self.x.replace('"', "\"\""), self.y.replace('"', "\"\""));
                    pairs.iter().for_each(|[x, y]| _ = writeln!(out, "{x},{y}"));
                }
                Related::Spread(spread) => {
                    out.push_str("from_s,to_s,from,to,count\n");
                    for Cell { time_s: [begin, end], value: [low, high], count, .. } in &spread.cells {
                        let _ = writeln!(out, "{begin:.3},{end:.3},{low},{high},{count}");
                    }
                }
            },
            kind => out = csv(kind, curves),
        }
        out
    }
}

/// A number at an axis whose marks are `step` apart, as the language of the window writes it.
fn in_steps(value: f64, step: f64) -> String {
    let places = (-step.max(1e-9).log10() - 1e-9).ceil().max(0.0);
    number(value, places as u8)
}

/// All points as CSV, one per line.
fn csv(kind: Kind, curves: &[Curve]) -> String {
    let mut out = format!("curve,time_s,{}\n", kind.column());
    for (name, points) in curves {
        let quoted = name.replace('"', "\"\"");
        for [x, y] in points {
            let _ = writeln!(out, "\"{quoted}\",{x:.3},{y}");
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::Context;
    use panoscope_editor_model::picture::RenderedPacket;
    use panoscope_editor_model::texts::{Language, set_language};
    use std::collections::HashMap;

    #[test]
    fn axes_have_the_decimal_sign_of_the_language() {
        assert_eq!(
            (in_steps(0.2, 0.1), in_steps(20.0, 10.0), in_steps(0.25, 0.05)),
            ("0.2".into(), "20".into(), "0.25".into())
        );
        set_language(Language::German);
        assert_eq!(in_steps(0.2, 0.1), "0,2");
    }

    #[test]
    fn values_of_ports_become_curves_and_a_table() {
        let (mut plots, output) = (Plots::default(), Output::new("pid", "errors"));
        plots.set_kind(Kind::Values);
        let mut shown = OutputCache::default();
        for seq in 0..3u64 {
            let content = Content::Numbers(vec![("x mm".to_owned(), seq as f64), ("y".to_owned(), f64::NAN)]);
            let packet = RenderedPacket { seq, capture_ms: seq as f64 * 100.0, content, ..RenderedPacket::default() };
            shown.update(&Context::default(), HashMap::from([(output.clone(), packet)]));
            // The same packet counts once.
            plots.follow(&shown, std::slice::from_ref(&output));
            plots.follow(&shown, std::slice::from_ref(&output));
        }
        let curves = plots.curves(&GraphView::default(), &Counters::default(), &[]);
        assert_eq!(curves, [("pid.errors x mm".to_owned(), vec![[-0.2, 0.0], [-0.1, 1.0], [0.0, 2.0]])]);
        assert_eq!(csv(Kind::Values, &curves).lines().nth(3), Some("\"pid.errors x mm\",0.000,2"));
        assert!(plots.curves(&GraphView::default(), &Counters::default(), &["other".to_owned()]).is_empty());
        // The same value over itself, and its spread.
        (plots.x, plots.y) = ("pid.errors x mm".to_owned(), "pid.errors x mm".to_owned());
        plots.set_kind(Kind::Scatter);
        assert_eq!(plots.table(&[]), "\"pid.errors x mm\",\"pid.errors x mm\"\n0,0\n1,1\n2,2\n");
        plots.set_kind(Kind::Histogram);
        assert_eq!(plots.table(&[]).lines().count(), 4, "{}", plots.table(&[]));
        plots.set_kind(Kind::Values);
        plots.follow(&shown, &[]);
        assert!(
            plots.curves(&GraphView::default(), &Counters::default(), &[]).is_empty(),
            "a node that is gone has no curve"
        );
    }
}
