//! One value over another, and how the values of one spread over time: the pictures of the panel of plots for relations and distributions.

use std::collections::VecDeque;

use eframe::egui::{Color32, ComboBox, Ui};
use egui_plot::{Bar, BarChart, PlotPoints, PlotUi, Points};

use panoscope_editor_model::texts::{decimal, text};
use panoscope_editor_widgets::theme;

/// Columns and rows of a histogram over time.
const COLUMNS: usize = 40;
const ROWS: usize = 24;

/// Pairs of two values that belong to one moment of media time.
pub fn pairs(x: &VecDeque<[f64; 2]>, y: &VecDeque<[f64; 2]>) -> Vec<[f64; 2]> {
    let (mut at, mut found) = (0, Vec::new());
    for [time, value] in x {
        while y.get(at).is_some_and(|other| other[0] < *time) {
            at += 1;
        }
        found.extend(y.get(at).filter(|other| other[0] == *time).map(|other| [*value, other[1]]));
    }
    found
}

/// Pearson's correlation of pairs, -1..=1; `None` where one of the values does not change.
pub fn correlation(pairs: &[[f64; 2]]) -> Option<f64> {
    let count = pairs.len() as f64;
    let mean = |k: usize| pairs.iter().map(|pair| pair[k]).sum::<f64>() / count;
    let means = [mean(0), mean(1)];
    let sum = |i: usize, k: usize| pairs.iter().map(|pair| (pair[i] - means[i]) * (pair[k] - means[k])).sum::<f64>();
    let scale = (sum(0, 0) * sum(1, 1)).sqrt();
    (scale > 1e-12).then(|| sum(0, 1) / scale)
}

/// A part of time and of the values, and how many of the values of that time are in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Its beginning and end, s before now.
    pub time_s: [f64; 2],
    /// Its lowest and highest value.
    pub value: [f64; 2],
    /// Number of values in it.
    pub count: usize,
    /// The same as a share of those of its time, 0..=1.
    pub share: f64,
}

/// How values spread over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spread {
    /// The parts that have values.
    pub cells: Vec<Cell>,
    /// Mean of all values.
    pub mean: f64,
    /// Standard deviation of all values.
    pub deviation: f64,
}

impl Spread {
    /// Of values with their times, s; oldest first.
    pub fn of(values: &VecDeque<[f64; 2]>) -> Self {
        let (Some([begin, _]), Some([end, _])) = (values.front().copied(), values.back().copied()) else {
            return Self::default();
        };
        let (low, high) = values
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), [_, value]| (low.min(*value), high.max(*value)));
        let (column_s, row) = (((end - begin) / COLUMNS as f64).max(1e-6), ((high - low) / ROWS as f64).max(1e-9));
        let mut counts = vec![[0usize; ROWS]; COLUMNS];
        for [time, value] in values {
            let column = (((time - begin) / column_s) as usize).min(COLUMNS - 1);
            counts[column][(((value - low) / row) as usize).min(ROWS - 1)] += 1;
        }
        let cell = |column: usize, at: usize, count: usize, all: usize| Cell {
            time_s: [column, column + 1].map(|column| begin + column as f64 * column_s - end),
            value: [at, at + 1].map(|at| low + at as f64 * row),
            count,
            share: count as f64 / all as f64,
        };
        let cells = counts.iter().enumerate().flat_map(|(column, rows)| {
            let all = rows.iter().sum();
            let counts = rows.iter().enumerate().filter(|(_, count)| **count > 0);
            counts.map(move |(at, count)| cell(column, at, *count, all))
        });
        let count = values.len() as f64;
        let mean = values.iter().map(|[_, value]| value).sum::<f64>() / count;
        let square = values.iter().map(|[_, value]| (value - mean).powi(2)).sum::<f64>() / count;
        Self { cells: cells.collect(), mean, deviation: square.sqrt() }
    }
}

/// Shows a list of values to choose from; the first one where `chosen` is not there.
pub fn choose<'n>(ui: &mut Ui, label: &str, chosen: &mut String, names: impl Iterator<Item = &'n String> + Clone) {
    if !names.clone().any(|name| name == chosen) {
        *chosen = names.clone().next().cloned().unwrap_or_default();
    }
    ui.label(label);
    let combo = ComboBox::from_id_salt(label).selected_text(chosen.as_str()).width(220.0).show_ui(ui, |ui| {
        for name in names {
            ui.selectable_value(chosen, name.clone(), name);
        }
    });
    ui.ctx().accesskit_node_builder(combo.response.id, |node| node.set_label(label));
}

/// Draws one value over another.
pub fn scatter(plot: &mut PlotUi<'_>, pairs: &[[f64; 2]]) {
    let points: PlotPoints<'_> = pairs.iter().copied().collect();
    plot.points(Points::new("", points).radius(2.5).color(theme::class(0)));
}

/// What the pairs say as a whole.
pub fn scatter_words(pairs: &[[f64; 2]]) -> String {
    match correlation(pairs) {
        Some(r) => text!("plot-scatter-about", count = pairs.len(), correlation = decimal(r, 3)),
        None => text!("plot-scatter-count", count = pairs.len()),
    }
}

/// Draws how values spread over time: darker where more of them are.
pub fn histogram(plot: &mut PlotUi<'_>, spread: &Spread) {
    let color = theme::class(0);
    let bar = |cell: &Cell| {
        let ([from_s, to_s], [low, high]) = (cell.time_s, cell.value);
        // The square root keeps rare values in view.
        let fill: Color32 = color.gamma_multiply(cell.share.sqrt().clamp(0.1, 1.0) as f32);
        let bar = Bar::new((from_s + to_s) / 2.0, high - low).base_offset(low).width(to_s - from_s);
        bar.fill(fill).stroke((0.0, color))
    };
    plot.bar_chart(BarChart::new("", spread.cells.iter().map(bar).collect()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_one_moment_are_paired() {
        let x = VecDeque::from([[0.0, 1.0], [0.1, 2.0], [0.3, 4.0]]);
        let y = VecDeque::from([[0.1, 20.0], [0.2, 30.0], [0.3, 40.0]]);
        assert_eq!(pairs(&x, &y), [[2.0, 20.0], [4.0, 40.0]]);
        assert_eq!(correlation(&[[0.0, 1.0], [1.0, 3.0], [2.0, 5.0]]), Some(1.0));
        assert_eq!(correlation(&[[0.0, 1.0], [1.0, 1.0]]), None);
        let falls = correlation(&[[0.0, 5.0], [1.0, 1.0], [2.0, 0.0]]).expect("both change");
        assert!((-1.0..-0.9).contains(&falls), "{falls}");
    }

    #[test]
    fn a_spread_counts_every_value_once() {
        let values: VecDeque<[f64; 2]> = (0..400).map(|at| [f64::from(at) / 10.0, f64::from(at % 10)]).collect();
        let spread = Spread::of(&values);
        assert_eq!(spread.cells.iter().map(|cell| cell.count).sum::<usize>(), 400);
        assert_eq!((spread.mean, (spread.deviation * 100.0).round()), (4.5, 287.0));
        let [first, last] = [spread.cells.first(), spread.cells.last()].map(|cell| cell.expect("cells").time_s);
        assert!((first[0] + 39.9).abs() < 1e-6 && last[1].abs() < 1e-6, "{first:?} {last:?}");
        assert!(spread.cells.iter().all(|cell| cell.share > 0.0 && cell.share <= 1.0));
        // One value, again and again.
        let same = Spread::of(&VecDeque::from([[0.0, 3.0], [0.0, 3.0]]));
        assert_eq!((same.mean, same.deviation, same.cells[0].count), (3.0, 0.0, 2));
        assert_eq!(Spread::of(&VecDeque::new()), Spread::default());
    }
}
