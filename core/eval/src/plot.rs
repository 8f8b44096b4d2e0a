//! Charts as PNG images, drawn with the project's own lines and font.

use std::path::Path;

use crate::canvas::Canvas;
use crate::error::Result;
use panoscope_imaging::ViewMut;
use panoscope_imaging::draw::{self, Color};

/// Width and height of one chart, px.
const SIZE: (usize, usize) = (640, 360);
/// Free space around the field of a chart: left, top, right, bottom, px.
const MARGIN: [f32; 4] = [64.0, 52.0, 16.0, 46.0];
// Letters have a dark rim, made for pictures: they want dark ground.
const BACK: Color = [26, 24, 22];
const INK: Color = [232, 232, 232];
const GRID: Color = [62, 58, 56];
/// Colours that people with colour blindness can distinguish (Okabe and Ito), BGR.
const COLORS: [Color; 6] =
    [[233, 180, 86], [0, 159, 230], [115, 158, 0], [167, 121, 204], [66, 228, 240], [0, 94, 213]];

/// Style of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A line with gaps at missing values.
    Line,
    /// A dot for each point.
    Dots,
    /// Thin vertical bars from a low to a high value; each pair of points is a bar.
    Bars,
}

/// A series of points.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Drawing style.
    pub style: Style,
    /// Index of its colour.
    pub color: usize,
    /// Positions; values that are not finite count as missing.
    pub points: Vec<(f64, f64)>,
}

impl Series {
    /// A series of these points.
    pub fn new(name: impl Into<String>, style: Style, color: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), style, color, points }
    }
}

/// One chart.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// Title of the chart.
    pub title: String,
    /// Label of the horizontal axis, with unit.
    pub x_label: String,
    /// Label of the vertical axis, with unit.
    pub y_label: String,
    /// The drawn series.
    pub series: Vec<Series>,
    /// The vertical axis includes 0.
    pub from_zero: bool,
    /// The vertical axis is logarithmic; values of 0 and less are missing.
    pub log: bool,
    /// Labelled positions on the horizontal axis; if there are any, the axis has no numbers.
    pub words: Vec<(f64, String)>,
}

/// Round steps that divide a range into four to nine parts.
fn steps(low: f64, high: f64) -> (f64, f64, f64) {
    let range = (high - low).max(1e-9);
    let magnitude = 10f64.powf((range / 5.0).log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * magnitude).into_iter().find(|s| range / s <= 8.0).unwrap_or(magnitude);
    ((low / step).floor() * step, (high / step).ceil() * step, step)
}

fn number(value: f64, step: f64) -> String {
    let places = (-step.log10().floor()).clamp(0.0, 6.0) as usize;
    // No "-0".
    format!("{:.places$}", if value.abs() < step * 1e-6 { 0.0 } else { value })
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.filter(|v| v.is_finite()).fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
    match () {
        () if low > high => (0.0, 1.0),
        () if high - low < 1e-12 => (low - 0.5, high + 0.5),
        () => (low, high),
    }
}

fn parts(low: f64, high: f64, step: f64) -> impl Iterator<Item = f64> {
    (0..=((high - low) / step).round() as usize).map(move |i| low + i as f64 * step)
}

/// An axis: its ends, and positions with their labels.
#[derive(Debug, PartialEq)]
struct Axis {
    ends: (f64, f64),
    marks: Vec<(f64, String)>,
}

/// The vertical axis; on a logarithmic one, marks are powers of ten.
fn upward(chart: &Chart) -> Axis {
    let values = chart.series.iter().flat_map(|s| s.points.iter().map(|p| p.1));
    if !chart.log {
        let (low, high) = range(values);
        let (low, high, step) = steps(if chart.from_zero { low.min(0.0) } else { low }, high);
        return Axis { ends: (low, high), marks: parts(low, high, step).map(|y| (y, number(y, step))).collect() };
    }
    let (low, high) = range(values.filter(|v| *v > 0.0).map(f64::log10));
    // 1, 2, 5 and so on, from the last one below all values to the first one above them.
    let ladder =
        |index: i32| f64::from(index.div_euclid(3)) + [0.0, 2f64.log10(), 5f64.log10()][index.rem_euclid(3) as usize];
    let mut first = (3.0 * low).floor() as i32 - 3;
    while ladder(first + 1) <= low + 1e-9 {
        first += 1;
    }
    let mut last = first + 1;
    while ladder(last) < high - 1e-9 {
        last += 1;
    }
    let wanted = |index: &i32| last - first <= 8 || index.rem_euclid(3) == 0;
    let words = |index: i32| number(10f64.powf(ladder(index)), 10f64.powi(index.div_euclid(3)));
    let marks = (first..=last).filter(wanted).map(|index| (ladder(index), words(index))).collect();
    Axis { ends: (ladder(first), ladder(last)), marks }
}

fn along(chart: &Chart) -> Axis {
    if !chart.words.is_empty() {
        let (low, high) = range(chart.words.iter().map(|(at, _)| *at));
        // Half a place on both sides, so that the first and last word have room.
        return Axis { ends: (low - 0.5, high + 0.5), marks: chart.words.clone() };
    }
    let (low, high) = range(chart.series.iter().flat_map(|s| s.points.iter().map(|p| p.0)));
    let (low, high, step) = steps(low, high);
    Axis { ends: (low, high), marks: parts(low, high, step).map(|x| (x, number(x, step))).collect() }
}

fn chart(out: &mut ViewMut<'_, u8>, origin: (f32, f32), chart: &Chart) {
    let (along, upward) = (along(chart), upward(chart));
    let ((x0, x1), (y0, y1)) = (along.ends, upward.ends);
    let (left, top) = (origin.0 + MARGIN[0], origin.1 + MARGIN[1]);
    let (right, bottom) = (origin.0 + SIZE.0 as f32 - MARGIN[2], origin.1 + SIZE.1 as f32 - MARGIN[3]);
    let across = |x: f64| left + ((x - x0) / (x1 - x0)) as f32 * (right - left);
    let up = |y: f64| bottom - ((y - y0) / (y1 - y0)) as f32 * (bottom - top);
    let centred = |out: &mut ViewMut<'_, u8>, x: f32, y: f32, words: &str| {
        draw::text(out, x - draw::text_size(words, 1.2).0 / 2.0, y, words, 1.2, INK);
    };
    for (x, words) in &along.marks {
        draw::line(out, (across(*x), top), (across(*x), bottom), 1.0, GRID);
        centred(out, across(*x), bottom + 7.0, words);
    }
    for (y, words) in &upward.marks {
        draw::line(out, (left, up(*y)), (right, up(*y)), 1.0, GRID);
        let (width, height) = draw::text_size(words, 1.2);
        draw::text(out, left - 7.0 - width, up(*y) - height / 2.0, words, 1.2, INK);
    }
    draw::rectangle(out, left, top, right - left, bottom - top, 1.0, INK);
    draw::text(out, origin.0 + 8.0, origin.1 + 7.0, &chart.title, 1.5, INK);
    centred(out, (left + right) / 2.0, bottom + 24.0, &chart.x_label);
    draw::text(out, origin.0 + 8.0, origin.1 + 26.0, &chart.y_label, 1.2, INK);
    let mut legend = right - 6.0;
    for series in &chart.series {
        let color = COLORS[series.color % COLORS.len()];
        let place = |p: &(f64, f64)| {
            let y = if chart.log { p.1.log10() } else { p.1 };
            (p.0.is_finite() && y.is_finite()).then(|| (across(p.0), up(y)))
        };
        match series.style {
            Style::Line => {
                for pair in series.points.windows(2) {
                    if let (Some(a), Some(b)) = (place(&pair[0]), place(&pair[1])) {
                        draw::line(out, a, b, 1.6, color);
                    }
                }
            }
            Style::Dots => {
                for (x, y) in series.points.iter().filter_map(place) {
                    draw::fill_circle(out, x, y, 2.4, color, 0.8);
                }
            }
            Style::Bars => {
                for pair in series.points.as_chunks::<2>().0 {
                    if let (Some(a), Some(b)) = (place(&pair[0]), place(&pair[1])) {
                        draw::line(out, a, b, 1.0, color);
                    }
                }
            }
        }
        if series.name.is_empty() {
            continue;
        }
        let (width, height) = draw::text_size(&series.name, 1.2);
        legend -= width;
        draw::text(out, legend, top - height - 5.0, &series.name, 1.2, color);
        legend -= 14.0;
    }
}

/// Writes charts in two columns.
pub fn save(path: &Path, charts: &[Chart]) -> Result<()> {
    let columns = charts.len().clamp(1, 2);
    let (width, height) = (SIZE.0 * columns, SIZE.1 * charts.len().max(1).div_ceil(columns));
    let mut canvas = Canvas::new(width, height, BACK);
    for (index, one) in charts.iter().enumerate() {
        let origin = ((index % columns * SIZE.0) as f32, (index / columns * SIZE.1) as f32);
        chart(&mut canvas.view(), origin, one);
    }
    canvas.save(path)
}

#[cfg(test)]
mod tests {
    use super::{Chart, Series, Style, along, number, steps, upward};

    #[test]
    fn words_stand_where_numbers_would_and_no_number_between_them() {
        let series = Series::new("", Style::Dots, 0, vec![(0.0, 3.0), (1.0, 4.0)]);
        let words = vec![(0.0, "census".to_owned()), (1.0, "absolute".to_owned())];
        let of_words = along(&Chart { series: vec![series.clone()], words: words.clone(), ..Chart::default() });
        assert_eq!((of_words.ends, of_words.marks), ((-0.5, 1.5), words));
        let of_numbers = along(&Chart { series: vec![series], ..Chart::default() });
        assert!(of_numbers.marks.iter().any(|(_, words)| words == "0.4"), "{:?}", of_numbers.marks);
    }

    #[test]
    fn a_logarithmic_axis_has_its_marks_at_ones_twos_and_fives_or_at_powers_of_ten() {
        let chart = |values: &[f64]| {
            let points = values.iter().map(|v| (0.0, *v)).collect();
            let series = vec![Series::new("", Style::Line, 0, points)];
            upward(&Chart { series, log: true, ..Chart::default() })
        };
        let words = |values: &[f64]| chart(values).marks.into_iter().map(|(_, words)| words).collect::<Vec<_>>();
        assert_eq!(words(&[3.0, 70.0, f64::NAN, 0.0]), ["2", "5", "10", "20", "50", "100"]);
        assert_eq!(words(&[0.3, 0.9]), ["0.2", "0.5", "1"]);
        assert_eq!(words(&[0.9, 0.5, 900.0]), ["1", "10", "100", "1000"]);
        let (low, high) = chart(&[0.9, 0.5, 900.0]).ends;
        assert!((low - 0.5f64.log10()).abs() < 1e-9 && (high - 3.0).abs() < 1e-9);
    }

    #[test]
    fn axes_have_round_steps_around_the_data() {
        for (low, high) in [(0.0, 7.3), (-3.0, 250.0), (0.701, 0.734), (12.0, 12.5)] {
            let (from, to, step) = steps(low, high);
            assert!(from <= low && to >= high && (3.0..=10.0).contains(&((to - from) / step)), "{from} {to} {step}");
        }
        assert_eq!((number(0.30000000000000004, 0.1), number(-1e-12, 0.5)), ("0.3".to_owned(), "0.0".to_owned()));
    }
}
