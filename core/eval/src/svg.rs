//! Plots as SVG, and the style of the pages that hold them.

use std::fmt::Write;

/// Colours that people with colour blindness can distinguish (Okabe and Ito).
pub const COLORS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// Style sheet of pages with tables and plots.
pub const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#1a1a1a;background:#fff}\
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}table{border-collapse:collapse;margin:.6em 0}\
td,th{padding:.2em .9em .2em 0;text-align:right;border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}\
svg{width:100%;height:auto;margin:.4em 0}svg text{font:11px system-ui,sans-serif;fill:#333}.mid{text-anchor:middle}.end{text-anchor:end}\
.grid{stroke:#e4e4e4;fill:none}.line{fill:none;stroke-width:1.3;stroke-linejoin:round}.flag{stroke:#888;stroke-dasharray:4 3;fill:none}\
.two{display:grid;grid-template-columns:1fr 1fr;gap:1em}dt{font-weight:600}dd{margin:0 0 .5em}.key{display:inline-block;width:.9em;height:.9em;margin:0 .3em 0 1em}";

/// Width of plots over time, px.
pub const WIDTH: f64 = 960.0;
const LEFT: f64 = 56.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 24.0;
const BOTTOM: f64 = 34.0;

/// Axis of a plot.
#[derive(Clone, Debug)]
pub struct Axis {
    pub low: f64,
    pub high: f64,
    step: f64,
    /// Labels at 0, 1, 2, ... instead of numbers.
    words: Vec<String>,
}

impl Axis {
    /// Round numbers around a range.
    pub fn around(low: f64, high: f64) -> Self {
        let (low, high) = match (low.is_finite() && high.is_finite(), high - low > 1e-9) {
            (false, _) => (0.0, 1.0),
            (true, false) => (low - 0.5, high + 0.5),
            (true, true) => (low, high),
        };
        let size = 10f64.powf(((high - low) / 5.0).log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * size).into_iter().find(|s| (high - low) / s <= 6.0);
        let step = step.unwrap_or(size);
        Self { low: (low / step).floor() * step, high: (high / step).ceil() * step, step, words: Vec::new() }
    }

    /// An axis with a position for each label: 0, 1, 2, ...
    pub fn of_words(words: &[&str]) -> Self {
        let words: Vec<String> = words.iter().map(|&word| word.to_owned()).collect();
        Self { low: -0.5, high: words.len() as f64 - 0.5, step: 1.0, words }
    }

    /// Positions with their labels.
    fn marks(&self) -> Vec<(f64, String)> {
        if !self.words.is_empty() {
            return self.words.iter().enumerate().map(|(at, word)| (at as f64, escaped(word))).collect();
        }
        let places =
            (0..=((self.high - self.low) / self.step).round() as usize).map(|k| self.low + self.step * k as f64);
        places.map(|at| (at, self.number(at))).collect()
    }

    fn number(&self, value: f64) -> String {
        let places = (-self.step.log10().floor()).clamp(0.0, 4.0) as usize;
        format!("{:.places$}", if value.abs() < 1e-9 * self.step { 0.0 } else { value })
    }
}

/// Escapes text for HTML.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A plot under construction.
pub struct Plot {
    out: String,
    x: Axis,
    y: Axis,
    size: (f64, f64),
}

impl Plot {
    /// An empty plot with axes. `title` describes it for screen readers.
    pub fn new(title: &str, size: (f64, f64), x: Axis, y: Axis, x_label: &str, y_label: &str) -> Self {
        let (w, h) = size;
        let (across, upward) = (x.marks(), y.marks());
        let mut plot = Self { out: String::new(), x, y, size };
        let title = escaped(title);
        let _ = write!(
            plot.out,
            "<svg viewBox=\"0 0 {w:.0} {h:.0}\" role=\"img\" aria-label=\"{title}\"><title>{title}</title>"
        );
        for (mark, label) in across {
            let (at, bottom) = (plot.across(mark), h - BOTTOM);
            let _ = write!(
                plot.out,
                "<path class=\"grid\" d=\"M{at:.1} {TOP}V{bottom:.1}\"/><text x=\"{at:.1}\" y=\"{:.1}\" class=\"mid\">{label}</text>",
                bottom + 14.0
            );
        }
        for (mark, label) in upward {
            let (at, right) = (plot.up(mark), w - RIGHT);
            let _ = write!(
                plot.out,
                "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{right:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" class=\"end\">{label}</text>",
                LEFT - 5.0,
                at + 4.0
            );
        }
        let (x_label, y_label) = (escaped(x_label), escaped(y_label));
        let _ = write!(
            plot.out,
            "<text x=\"{:.1}\" y=\"{:.1}\" class=\"mid\">{x_label}</text><text x=\"4\" y=\"10\">{y_label}</text>",
            w / 2.0,
            h - 4.0
        );
        plot
    }

    fn across(&self, value: f64) -> f64 {
        LEFT + (value - self.x.low) / (self.x.high - self.x.low) * (self.size.0 - LEFT - RIGHT)
    }

    fn up(&self, value: f64) -> f64 {
        self.size.1 - BOTTOM - (value - self.y.low) / (self.y.high - self.y.low) * (self.size.1 - TOP - BOTTOM)
    }

    /// A line; a point that is not joined begins a new line.
    pub fn line(&mut self, color: usize, points: impl Iterator<Item = ((f64, f64), bool)>) {
        let mut path = String::new();
        let mut has_pen = false;
        for ((x, y), is_joined) in points {
            if !(x.is_finite() && y.is_finite()) {
                has_pen = false;
                continue;
            }
            let word = if has_pen && is_joined { 'L' } else { 'M' };
            let _ = write!(path, "{word}{:.1} {:.1}", self.across(x), self.up(y));
            has_pen = true;
        }
        let _ = write!(self.out, "<path class=\"line\" stroke=\"{}\" d=\"{path}\"/>", COLORS[color % COLORS.len()]);
    }

    /// Dots.
    pub fn dots(&mut self, color: usize, points: impl Iterator<Item = (f64, f64)>) {
        let color = COLORS[color % COLORS.len()];
        for (x, y) in points.filter(|(x, y)| x.is_finite() && y.is_finite()) {
            let (x, y) = (self.across(x), self.up(y));
            let _ = write!(self.out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.4\" fill=\"{color}\"/>");
        }
    }

    /// A filled rectangle between two horizontal and two vertical values.
    pub fn bar(&mut self, color: usize, across: (f64, f64), up: (f64, f64), opacity: f64) {
        let (x, y) = (self.across(across.0), self.up(up.1));
        let (w, h) = ((self.across(across.1) - x).max(0.2), (self.up(up.0) - y).max(0.2));
        let color = COLORS[color % COLORS.len()];
        let _ = write!(
            self.out,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.2}\" height=\"{h:.1}\" fill=\"{color}\" fill-opacity=\"{opacity:.2}\"/>"
        );
    }

    /// A vertical line with a label, such as the beginning of a phase.
    pub fn flag(&mut self, at: f64, word: &str) {
        let (x, bottom, word) = (self.across(at), self.size.1 - BOTTOM, escaped(word));
        let _ = write!(
            self.out,
            "<path class=\"flag\" d=\"M{x:.1} {TOP}V{bottom:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\">{word}</text>",
            x + 3.0,
            TOP + 10.0
        );
    }

    /// A label to the left of a vertical value.
    pub fn word(&mut self, up: f64, word: &str) {
        let _ =
            write!(self.out, "<text x=\"{:.1}\" y=\"{:.1}\">{}</text>", LEFT + 4.0, self.up(up) + 4.0, escaped(word));
    }

    /// The plot as SVG text.
    pub fn end(mut self) -> String {
        self.out.push_str("</svg>\n");
        self.out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_round_and_words_cannot_leave_their_text() {
        for (low, high) in [(0.0, 7.3), (-3.0, 250.0), (5.0, 5.0), (f64::NAN, 1.0)] {
            let axis = Axis::around(low, high);
            assert!((2..=9).contains(&axis.marks().len()), "{axis:?}");
            assert!(low.is_nan() || (axis.low <= low && axis.high >= high));
        }
        let plot = Plot::new("<b>\"", (300.0, 200.0), Axis::around(0.0, 1.0), Axis::around(0.0, 1.0), "x", "y").end();
        assert!(!plot.contains("<b>") && plot.contains("&lt;b&gt;&quot;"));
        let marks = Axis::of_words(&["a<b", "c"]).marks();
        assert_eq!(marks, [(0.0, "a&lt;b".to_owned()), (1.0, "c".to_owned())]);
    }
}
