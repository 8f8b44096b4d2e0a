//! The 3-D view of the viewer: a cloud to turn, cut and measure, with the ways that tools and the camera took.

use std::collections::{BTreeMap, VecDeque};

use eframe::egui::{
    Align2, Color32, DragValue, FontId, Painter, Pos2, Rect, RichText, Sense, Stroke, Ui, WidgetInfo, WidgetType, pos2,
    vec2,
};

use panoscope_editor_model::content::{Content, moved, moved_back};
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::surface::{Painted, Sight, distance_mm};
use panoscope_editor_widgets::Shown;
use panoscope_editor_widgets::crosshair::Crosshair;
use panoscope_editor_widgets::surface::{steer, steer_by_key, zoom_by};
use panoscope_editor_widgets::theme;

/// Places of a way that are remembered.
const MOST_STEPS: usize = 600;
/// A way goes on only where it moved by this, mm.
const LEAST_MM: f64 = 0.2;
/// Radians per point of a drag.
const TURN: f32 = 0.008;
/// Length of the lines that show how a camera stands, mm.
const AXIS_MM: f64 = 6.0;

/// Where something was, newest last.
#[derive(Clone, Debug, Default)]
struct Way {
    seq: u64,
    /// Places in the frame they were told in, mm.
    steps: VecDeque<[f64; 3]>,
    /// How that frame is turned and moved now, for poses.
    now: Option<([f64; 4], [f64; 3])>,
}

/// The 3-D view's own state.
#[derive(Default)]
pub struct Space {
    sight: Sight,
    measuring: bool,
    points: Vec<[f32; 3]>,
    crosshair: Crosshair,
    ways: BTreeMap<Output, Way>,
    /// Where the links of arms join, in the frame of their pose.
    arms: BTreeMap<Output, Vec<[f64; 3]>>,
}

impl Space {
    /// From where the cloud is to be painted.
    pub fn sight(&self) -> Sight {
        self.sight
    }

    /// Distance between the two points that were clicked, mm.
    pub fn distance_mm(&self) -> Option<f32> {
        match self.points[..] {
            [a, b] => Some(distance_mm(a, b)),
            _ => None,
        }
    }

    /// Begins to measure by clicks, or ends it.
    pub fn toggle_measuring(&mut self) {
        self.measuring ^= true;
        self.points.clear();
        self.crosshair = Crosshair::default();
    }

    /// Looks at the cloud from elsewhere: turned about both axes, rad, and as large.
    pub fn look_from(&mut self, yaw: f32, pitch: f32, zoom: f32) {
        self.sight = Sight { yaw, pitch, zoom, ..self.sight };
    }

    /// Enlarges by steps, or makes smaller.
    pub fn zoom_by(&mut self, steps: f32) {
        zoom_by(&mut self.sight, steps);
    }

    /// A point to measure from, at parts of the picture's width and height.
    fn tap(&mut self, painted: &Painted, [x, y]: [f32; 2]) {
        let [width, height] = painted.sight.size_px.map(|n| n as f32);
        if let Some(place) = painted.pick(x * width, y * height) {
            if self.points.len() >= 2 {
                self.points.clear();
            }
            self.points.push(place);
        }
    }

    /// Takes what tips and poses tell.
    fn follow(&mut self, shown: &Shown, ways: &[Output]) {
        self.ways.retain(|output, _| ways.contains(output));
        self.arms.retain(|output, _| ways.contains(output));
        for output in ways {
            let Some(look) = shown.look(output) else { continue };
            if let Content::Links(joints) = &look.content {
                self.arms.insert(output.clone(), joints.clone());
                continue;
            }
            let way = self.ways.entry(output.clone()).or_default();
            if look.seq == way.seq && !way.steps.is_empty() {
                continue;
            }
            // A run that began anew has another way.
            if look.seq < way.seq {
                way.steps.clear();
            }
            way.seq = look.seq;
            let place = match &look.content {
                Content::Tip(mm) => *mm,
                Content::Pose { wxyz, mm, .. } => {
                    way.now = Some((*wxyz, *mm));
                    *mm
                }
                _ => continue,
            };
            let far = |last: &[f64; 3]| last.iter().zip(place).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            let new = place.iter().all(|v| v.is_finite()) && way.steps.back().is_none_or(|l| far(l) > LEAST_MM.powi(2));
            if new {
                if way.steps.len() >= MOST_STEPS {
                    way.steps.pop_front();
                }
                way.steps.push_back(place);
            }
        }
    }

    /// Draws the view into `rect`; `ways` are outputs of tips and poses.
    pub fn show(&mut self, ui: &mut Ui, rect: Rect, shown: &Shown, output: &Output, ways: &[Output]) {
        self.follow(shown, ways);
        let response = ui.interact(rect, ui.id().with("space"), Sense::click_and_drag());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, format!("Surface of {output}")));
        steer(ui, &response, &mut self.sight, TURN);
        let points = ui.ctx().pixels_per_point();
        let size = [rect.width(), rect.height()].map(|n| ((n * points) as usize / 16 * 16).clamp(160, 1280));
        self.sight.size_px = size;
        let painter = ui.painter_at(rect);
        let (Some((texture, size)), Some(look)) = (shown.texture(output), shown.look(output)) else {
            painter.text(rect.center(), Align2::CENTER_CENTER, "nothing yet", FontId::proportional(16.0), theme::MUTED);
            return;
        };
        let scale = (rect.width() / size.x).min(rect.height() / size.y);
        let inner = Rect::from_center_size(rect.center(), size * scale);
        let uv = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        painter.image(texture, inner, uv, Color32::WHITE);
        let Some(painted) = look.painted.clone() else {
            let words = "nothing of the cloud is known, or all is cut away";
            painter.text(rect.center(), Align2::CENTER_CENTER, words, FontId::proportional(15.0), theme::MUTED);
            return;
        };
        let view = View { painted: &painted, inner, scale };
        if let Some(at) = response.interact_pointer_pos().filter(|_| self.measuring && response.clicked()) {
            self.tap(&painted, [(at.x - inner.left()) / inner.width(), (at.y - inner.top()) / inner.height()]);
        }
        // Fields and buttons that have the focus have the keys, too.
        if ui.memory(|m| m.focused().is_none_or(|id| id == response.id)) {
            let chosen = ui.input_mut(|i| match self.measuring {
                true => self.crosshair.steer(i, inner.aspect_ratio()),
                false => {
                    steer_by_key(i, &mut self.sight);
                    None
                }
            });
            chosen.into_iter().for_each(|at| self.tap(&painted, at));
        }
        self.draw_arms(&painter, &view);
        self.draw_ways(&painter, &view);
        self.draw_points(&painter, &view);
        self.crosshair.draw(&painter, inner);
    }

    /// Arms as lines with a dot at each joint: the thinner, the farther out.
    fn draw_arms(&self, painter: &Painter, view: &View<'_>) {
        for (output, joints) in &self.arms {
            let pose = self.ways.iter().filter(|(way, _)| way.node == output.node).find_map(|(_, way)| way.now);
            let here: Vec<[f64; 3]> = match pose {
                Some((wxyz, mm)) => joints.iter().map(|joint| moved_back(wxyz, mm, *joint)).collect(),
                None => joints.clone(),
            };
            for (k, pair) in here.windows(2).enumerate() {
                let width = (7.0 - 0.7 * k as f32).max(1.5);
                if let Some([a, b]) = view.line(pair[0], pair[1]) {
                    painter.line_segment([a, b], Stroke::new(width + 2.0, theme::SUNK.gamma_multiply(0.8)));
                    painter.line_segment([a, b], Stroke::new(width, theme::family("arm")));
                }
            }
            for at in here.iter().filter_map(|joint| view.at(*joint)) {
                painter.circle(at, 3.5, theme::SUNK, Stroke::new(1.5, theme::family("arm")));
            }
            if let Some(at) = here.first().and_then(|foot| view.at(*foot)) {
                let words = format!("{} (foot)", output.node);
                let at = at + vec2(8.0, -8.0);
                painter.text(at, Align2::LEFT_BOTTOM, words, FontId::proportional(12.0), theme::family("arm"));
            }
        }
    }

    fn draw_ways(&self, painter: &Painter, view: &View<'_>) {
        let mut names: Vec<Pos2> = Vec::new();
        for (output, way) in &self.ways {
            // What a pose tells is seen from where the camera is now; what a tip tells is in the camera's frame already.
            let here = |place: &[f64; 3]| match way.now {
                Some((wxyz, mm)) => moved_back(wxyz, mm, *place),
                None => *place,
            };
            let color = if way.now.is_some() { theme::LIVE } else { theme::WARN };
            let line: Vec<Pos2> = way.steps.iter().filter_map(|p| view.at(here(p))).collect();
            for pair in line.windows(2) {
                painter.line_segment([pair[0], pair[1]], Stroke::new(2.0, color.gamma_multiply(0.9)));
            }
            let Some(last) = way.steps.back().map(here) else { continue };
            let Some(at) = view.at(last) else { continue };
            painter.circle_filled(at, 4.0, color);
            // Names of what is at one place stand below each other.
            let mut name = at + vec2(8.0, -8.0);
            while names.iter().any(|n| (n.y - name.y).abs() < 13.0 && (n.x - name.x).abs() < 110.0) {
                name.y += 14.0;
            }
            names.push(name);
            painter.text(name, Align2::LEFT_BOTTOM, output.to_string(), FontId::proportional(12.0), color);
            if way.now.is_some() {
                let still = [1.0, 0.0, 0.0, 0.0];
                for (axis, color) in
                    [([1.0, 0.0, 0.0], theme::FAULT), ([0.0, 1.0, 0.0], theme::WARN), ([0.0, 0.0, 1.0], theme::ACCENT)]
                {
                    let end = moved(still, last, axis.map(|a: f64| a * AXIS_MM));
                    if let Some(end) = view.at(end) {
                        painter.line_segment([at, end], Stroke::new(2.0, color));
                    }
                }
            }
        }
    }

    fn draw_points(&self, painter: &Painter, view: &View<'_>) {
        let places: Vec<Pos2> = self.points.iter().filter_map(|p| view.at(p.map(f64::from))).collect();
        if let [a, b] = places[..] {
            painter.line_segment([a, b], Stroke::new(4.0, Color32::from_black_alpha(150)));
            painter.line_segment([a, b], Stroke::new(2.0, theme::ACCENT));
            if let Some(mm) = self.distance_mm() {
                let middle = a + (b - a) / 2.0 + vec2(10.0, 10.0);
                painter.text(
                    middle,
                    Align2::LEFT_TOP,
                    format!("{mm:.2} mm"),
                    FontId::proportional(16.0),
                    theme::ACCENT,
                );
            }
        }
        for at in places {
            painter.circle(at, 5.0, theme::SUNK, Stroke::new(2.0, theme::ACCENT));
        }
    }

    /// What can be set: measuring, and what is cut away.
    pub fn controls(&mut self, ui: &mut Ui) {
        let words = if self.measuring { "Measuring: click two points" } else { "Measure" };
        let button = ui.add(eframe::egui::Button::new(words).selected(self.measuring));
        if button.on_hover_text("Distance of two points in mm, by clicks, or by arrow keys and Enter").clicked() {
            self.toggle_measuring();
        }
        ui.label(RichText::new("depth from").color(theme::MUTED));
        let [near, far] = &mut self.sight.clip_mm;
        let first = ui.add(DragValue::new(near).range(0.0..=*far - 1.0).speed(0.5).suffix(" mm").max_decimals(0));
        ui.ctx().accesskit_node_builder(first.id, |n| n.set_label("Nearest depth shown"));
        ui.label(RichText::new("to").color(theme::MUTED));
        let second =
            ui.add(DragValue::new(far).range(*near + 1.0..=Sight::FAR_MM).speed(0.5).suffix(" mm").max_decimals(0));
        ui.ctx().accesskit_node_builder(second.id, |n| n.set_label("Farthest depth shown"));
    }
}

/// Where places stand on the screen.
struct View<'a> {
    painted: &'a Painted,
    inner: Rect,
    scale: f32,
}

impl View<'_> {
    /// `None` for what stands behind the viewer.
    fn at(&self, place_mm: [f64; 3]) -> Option<Pos2> {
        let place = place_mm.map(|v| v as f32);
        let [x, y, depth] = self.painted.projection.project(place);
        let seen = x.is_finite() && y.is_finite() && depth > self.painted.projection.nearest_mm();
        seen.then(|| self.inner.min + vec2(x, y) * self.scale)
    }

    /// The part of a line before the viewer.
    fn line(&self, a_mm: [f64; 3], b_mm: [f64; 3]) -> Option<[Pos2; 2]> {
        let depth = |place: [f64; 3]| f64::from(self.painted.projection.project(place.map(|v| v as f32))[2]);
        let nearest = f64::from(self.painted.projection.nearest_mm()) * 0.999;
        let (from, to) = (depth(a_mm), depth(b_mm));
        let cut = |near: [f64; 3], far: [f64; 3], near_mm: f64, far_mm: f64| {
            let share = ((nearest - near_mm) / (far_mm - near_mm)).clamp(0.0, 1.0);
            [0, 1, 2].map(|k| near[k] + (far[k] - near[k]) * share)
        };
        let [a, b] = match (from > nearest, to > nearest) {
            (true, true) => [a_mm, b_mm],
            (false, true) => [cut(a_mm, b_mm, from, to), b_mm],
            (true, false) => [a_mm, cut(b_mm, a_mm, to, from)],
            (false, false) => return None,
        };
        Some([self.at(a)?, self.at(b)?])
    }
}
