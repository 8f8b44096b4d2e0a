//! Data probes: the value under the pointer or a crosshair, the profile along a drawn line, the histogram of a picture.

use eframe::egui::{
    Align2, Color32, FontId, Key, Painter, Pos2, Rect, Response, Sense, Shape, Stroke, Ui, WidgetInfo, WidgetType,
    pos2, vec2,
};

use panoscope_editor_model::picture::short;
use panoscope_editor_model::probe::{Histogram, Probe, ProbeRequest, Profile};
use panoscope_editor_model::texts::{decimal, text, with_decimal_sign};
use panoscope_editor_widgets::crosshair::Crosshair;
use panoscope_editor_widgets::theme;

/// Height of the curve of a profile, points.
pub const PROFILE_HEIGHT: f32 = 132.0;
/// Height of a histogram, points.
const HISTOGRAM_HEIGHT: f32 = 56.0;

/// The point and the line that are probed on the picture in the viewer.
#[derive(Clone, Debug, Default)]
pub struct Probing {
    at: Option<[f32; 2]>,
    line: Option<[[f32; 2]; 2]>,
    /// The first end of a line that is being drawn.
    from: Option<[f32; 2]>,
    /// Whether the pointer is drawing the line.
    draws: bool,
    crosshair: Crosshair,
}

impl Probing {
    /// What is asked about the picture: nothing along a line that the pointer still draws.
    pub fn request(&self) -> ProbeRequest {
        ProbeRequest { at: self.at, line: self.line.filter(|_| !self.draws) }
    }

    /// Whether there is a line whose profile is shown. While the pointer draws it, there is no profile, so that the picture does not get
    /// smaller under the pointer.
    pub fn has_line(&self) -> bool {
        self.line.is_some() && !self.draws
    }

    /// Takes the line away; returns whether there was one.
    pub fn clear(&mut self) -> bool {
        (self.from, self.draws) = (None, false);
        self.line.take().is_some()
    }

    /// Follows pointer and keys on a picture that is drawn at `rect`: hovering probes a point, dragging a line. The arrow keys move a crosshair,
    /// Enter sets the ends of a line there.
    pub fn follow(&mut self, ui: &Ui, ground: &Response, rect: Rect) {
        let share = |at: Pos2| [(at.x - rect.left()) / rect.width(), (at.y - rect.top()) / rect.height()];
        let inside = |at: [f32; 2]| at.map(|share| share.clamp(0.0, 1.0));
        if ground.drag_started() {
            let origin = ui.input(|i| i.pointer.press_origin()).filter(|at| rect.contains(*at));
            (self.from, self.line, self.draws) = (origin.map(share), None, origin.is_some());
        }
        if let (Some(from), Some(to)) = (self.from, ground.interact_pointer_pos().filter(|_| ground.dragged())) {
            self.line = Some([from, inside(share(to))]);
        }
        if ground.drag_stopped() {
            (self.from, self.draws) = (None, false);
        } else if ground.clicked() {
            self.line = None;
        }
        if let Some(pointer) = ground.hover_pos().filter(|_| ui.input(|i| i.pointer.delta().length() > 0.0)) {
            self.at = Some(share(pointer)).filter(|_| rect.contains(pointer));
        }
        if ui.memory(|m| m.focused().is_none_or(|id| id == ground.id)) {
            let moved = ui.input(|i| {
                let arrows = [Key::ArrowLeft, Key::ArrowRight, Key::ArrowUp, Key::ArrowDown];
                arrows.iter().any(|key| i.key_pressed(*key)) && !i.modifiers.command
            });
            let chosen = ui.input_mut(|i| self.crosshair.steer(i, rect.width() / rect.height()));
            if moved {
                self.at = self.crosshair.position();
            }
            if let Some(end) = chosen {
                match self.from.take() {
                    Some(from) => self.line = Some([from, end]),
                    None => (self.from, self.line) = (Some(end), None),
                }
            }
        }
    }

    /// Draws the line, the crosshair and the value of the point.
    pub fn paint(&self, ui: &mut Ui, painter: &Painter, rect: Rect, probe: Option<&Probe>) {
        let place = |[u, v]: [f32; 2]| pos2(rect.left() + u * rect.width(), rect.top() + v * rect.height());
        if let Some(line) = self.line {
            let ends = line.map(place);
            for stroke in [Stroke::new(4.0, Color32::from_black_alpha(170)), Stroke::new(1.5, theme::accent())] {
                painter.line_segment(ends, stroke);
            }
            for end in ends {
                painter.circle_filled(end, 4.0, theme::accent());
            }
        }
        self.crosshair.draw(painter, rect);
        let (Some(at), Some(words)) = (self.at, probe.and_then(Probe::words)) else { return };
        let galley = painter.layout_no_wrap(words.clone(), FontId::proportional(13.0), Color32::WHITE);
        let size = galley.size() + vec2(12.0, 6.0);
        // Beside the point, and inside of the picture.
        let at = place(at) + vec2(16.0, 16.0);
        let corner = pos2(
            at.x.min(rect.right() - size.x).max(rect.left()),
            if at.y + size.y > rect.bottom() { at.y - size.y - 32.0 } else { at.y },
        );
        let shown = Rect::from_min_size(corner, size);
        painter.rect_filled(shown, 4.0, Color32::from_black_alpha(190));
        painter.galley(shown.min + vec2(6.0, 3.0), galley, Color32::WHITE);
        let label = ui.interact(shown, ui.id().with("probe"), Sense::hover());
        label.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, text!("probe-at", found = &words)));
    }
}

/// Colours of the channels.
fn color_of(probe: &Probe, channel: usize) -> Color32 {
    match probe.channels {
        ["red", "green", "blue"] => [
            Color32::from_rgb(0xF0, 0x6A, 0x5B),
            Color32::from_rgb(0x5F, 0xC0, 0x7A),
            Color32::from_rgb(0x5A, 0xA7, 0xF0),
        ][channel.min(2)],
        ["x", "y", "z"] => [theme::family("source"), theme::warn(), theme::accent()][channel.min(2)],
        _ => theme::accent(),
    }
}

fn with_unit(value: f32, unit: &str) -> String {
    let number = with_decimal_sign(&short(value.into()));
    if unit.is_empty() { number } else { format!("{number} {unit}") }
}

/// Shows the histogram of a picture: how often each value occurs, with range, mean, and the share of unknown pixels.
pub fn histogram(ui: &mut Ui, probe: &Probe) {
    if probe.histograms.is_empty() {
        return;
    }
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), HISTOGRAM_HEIGHT), Sense::hover());
    let painter = ui.painter();
    painter.rect_filled(rect, 3.0, theme::sunk());
    let low = probe.histograms.iter().map(|h| h.range.0).fold(f32::INFINITY, f32::min);
    let high = probe.histograms.iter().map(|h| h.range.1).fold(f32::NEG_INFINITY, f32::max);
    for (channel, histogram) in probe.histograms.iter().enumerate() {
        let first = if probe.histograms.len() == 1 && probe.channels.len() == 3 { 2 } else { channel };
        bars(painter, rect.shrink(3.0), histogram, (low, high), color_of(probe, first));
    }
    let unknown = probe.histograms.iter().map(|h| h.unknown).fold(0.0, f32::max);
    let means: Vec<String> = probe.histograms.iter().map(|h| with_unit(h.mean, probe.unit)).collect();
    let mut words = text!(
        "probe-mean",
        low = with_unit(low, probe.unit),
        high = with_unit(high, probe.unit),
        mean = means.join(", ")
    );
    if unknown > 0.0 {
        let percent = decimal(f64::from((unknown * 100.0).max(1.0)), 0);
        words += &format!(", {}", text!("probe-unknown", percent = percent));
    }
    if probe.is_thinned {
        words += &format!(", {}", text!("probe-thinned"));
    }
    response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, text!("probe-histogram", found = &words)));
    ui.label(eframe::egui::RichText::new(words).size(11.0).color(theme::muted()));
}

fn bars(painter: &Painter, rect: Rect, histogram: &Histogram, (low, high): (f32, f32), color: Color32) {
    let most = histogram.bars.iter().copied().max().unwrap_or(0).max(1) as f32;
    let x = |value: f32| rect.left() + rect.width() * ((value - low) / (high - low).max(1e-9)).clamp(0.0, 1.0);
    let (from, to) = (x(histogram.range.0), x(histogram.range.1));
    let width = ((to - from) / histogram.bars.len().max(1) as f32).max(1.0);
    for (n, count) in histogram.bars.iter().enumerate() {
        // By the square root, so that rare values can be seen.
        let height = rect.height() * (*count as f32 / most).sqrt();
        let left = from + n as f32 * width;
        let bar = Rect::from_min_max(pos2(left, rect.bottom() - height), pos2(left + width - 0.5, rect.bottom()));
        painter.rect_filled(bar, 0.0, color.gamma_multiply(0.6));
    }
}

/// Shows the values along the line as curves.
pub fn profile(ui: &mut Ui, rect: Rect, probe: &Probe) {
    let Some(profile) = &probe.profile else { return };
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 4.0, theme::panel());
    let known = || profile.values.iter().flatten().copied().filter(|value| value.is_finite());
    let (low, high) = (known().fold(f32::INFINITY, f32::min), known().fold(f32::NEG_INFINITY, f32::max));
    let words = match low <= high {
        true => text!("probe-range", low = with_unit(low, probe.unit), high = with_unit(high, probe.unit)),
        false => text!("probe-nothing").to_owned(),
    };
    let words = text!("probe-profile", length = with_decimal_sign(&short(profile.length_px.into())), found = words);
    let response = ui.interact(rect, ui.id().with("profile"), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, words.clone()));
    let font = FontId::proportional(12.0);
    painter.text(rect.left_top() + vec2(8.0, 6.0), Align2::LEFT_TOP, words, font, theme::muted());
    let area = Rect::from_min_max(rect.min + vec2(8.0, 26.0), rect.max - vec2(8.0, 8.0));
    for (channel, values) in profile.values.iter().enumerate() {
        curve(&painter, area, profile, values, (low, high), color_of(probe, channel));
    }
}

fn curve(painter: &Painter, area: Rect, profile: &Profile, values: &[f32], (low, high): (f32, f32), color: Color32) {
    let count = profile.values.first().map_or(0, Vec::len).max(2);
    let place = |n: usize, value: f32| {
        let y = (value - low) / (high - low).max(1e-9);
        pos2(area.left() + area.width() * n as f32 / (count - 1) as f32, area.bottom() - area.height() * y)
    };
    // Unknown values are gaps.
    for run in values.iter().enumerate().collect::<Vec<_>>().split(|(_, value)| !value.is_finite()) {
        let points: Vec<Pos2> = run.iter().map(|(n, value)| place(*n, **value)).collect();
        match points[..] {
            [] => {}
            [point] => {
                painter.circle_filled(point, 1.5, color);
            }
            _ => {
                painter.add(Shape::line(points, Stroke::new(1.5, color)));
            }
        }
    }
}
