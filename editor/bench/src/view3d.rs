//! The 3D view of the viewer: a point cloud to rotate, clip and measure, with the trajectories of tools and the camera.

use std::collections::{BTreeMap, VecDeque};

use eframe::egui::{
    Align2, Color32, FontId, Painter, Pos2, Rect, RichText, Sense, Stroke, Ui, WidgetInfo, WidgetType, pos2, vec2,
};

use panoscope_editor_model::content::{Content, moved, moved_back};
use panoscope_editor_model::observe::{Counters, Output};
use panoscope_editor_model::surface::{DepthBuffer, Viewpoint, distance_mm};
use panoscope_editor_model::texts::{number, text};
use panoscope_editor_widgets::OutputCache;
use panoscope_editor_widgets::crosshair::Crosshair;
use panoscope_editor_widgets::numbers::drag_value;
use panoscope_editor_widgets::surface::{steer, steer_by_key, zoom_by};
use panoscope_editor_widgets::theme;

/// Maximum number of points of a trajectory.
const MAX_POINTS: usize = 600;
/// Minimum distance between two points of a trajectory, mm.
const MIN_MOVE_MM: f64 = 0.2;
/// Rotation per point of a drag, radians.
const TURN: f32 = 0.008;
/// Length of the axes that show a camera's orientation, mm.
const AXIS_MM: f64 = 6.0;

/// The trajectory of a tip or a pose.
#[derive(Clone, Debug, Default)]
struct Trajectory {
    seq: u64,
    /// Points in the frame of the packets, mm; newest last.
    points_mm: VecDeque<[f64; 3]>,
    /// For poses: the newest rotation and translation.
    now: Option<([f64; 4], [f64; 3])>,
}

/// The state of the 3D view.
#[derive(Default)]
pub struct View3d {
    viewpoint: Viewpoint,
    measuring: bool,
    points: Vec<[f32; 3]>,
    crosshair: Crosshair,
    trajectories: BTreeMap<Output, Trajectory>,
    /// Joint positions of arms, in the frame of their pose, mm.
    arms: BTreeMap<Output, Vec<[f64; 3]>>,
}

impl View3d {
    /// The viewpoint to render the cloud from.
    pub fn viewpoint(&self) -> Viewpoint {
        self.viewpoint
    }

    /// Takes from the counters whether the calibration fits the views: while it does not, no length is right. It holds until a node says otherwise.
    pub fn check_calibration(&mut self, counters: &Counters) {
        if let Some(is_drifted) = counters.metric_is_on("drifted") {
            self.viewpoint.has_ruler = !is_drifted;
        }
    }

    /// Distance between the two clicked points, mm; `None` while the calibration does not fit.
    pub fn distance_mm(&self) -> Option<f32> {
        match self.points[..] {
            [a, b] if self.viewpoint.has_ruler => Some(distance_mm(a, b)),
            _ => None,
        }
    }

    /// Starts or ends measuring.
    pub fn toggle_measuring(&mut self) {
        self.measuring ^= true;
        self.points.clear();
        self.crosshair = Crosshair::default();
    }

    /// Sets the viewpoint: rotation about both axes in rad, and zoom.
    pub fn look_from(&mut self, yaw: f32, pitch: f32, zoom: f32) {
        self.viewpoint = Viewpoint { yaw, pitch, zoom, ..self.viewpoint };
    }

    /// Zooms in by a number of steps, or out when it is negative.
    pub fn zoom_by(&mut self, steps: f32) {
        zoom_by(&mut self.viewpoint, steps);
    }

    /// Adds a point to measure, at fractions of the image's width and height. A third point starts a new measurement.
    fn tap(&mut self, depth_buffer: &DepthBuffer, [x, y]: [f32; 2]) {
        let [width, height] = depth_buffer.viewpoint.size_px.map(|n| n as f32);
        if let Some(place) = depth_buffer.pick(x * width, y * height) {
            if self.points.len() >= 2 {
                self.points.clear();
            }
            self.points.push(place);
        }
    }

    /// Updates the trajectories and arms from the newest packets.
    fn follow(&mut self, shown: &OutputCache, trajectories: &[Output]) {
        self.trajectories.retain(|output, _| trajectories.contains(output));
        self.arms.retain(|output, _| trajectories.contains(output));
        for output in trajectories {
            let Some(packet) = shown.packet(output) else { continue };
            if let Content::Links(joints) = &packet.content {
                self.arms.insert(output.clone(), joints.clone());
                continue;
            }
            let trajectory = self.trajectories.entry(output.clone()).or_default();
            if packet.seq == trajectory.seq && !trajectory.points_mm.is_empty() {
                continue;
            }
            // The run was restarted, so the trajectory starts again.
            if packet.seq < trajectory.seq {
                trajectory.points_mm.clear();
            }
            trajectory.seq = packet.seq;
            let place = match &packet.content {
                Content::Tip(mm) => *mm,
                Content::Pose { wxyz, mm, .. } => {
                    trajectory.now = Some((*wxyz, *mm));
                    *mm
                }
                _ => continue,
            };
            let far = |last: &[f64; 3]| last.iter().zip(place).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            let new = place.iter().all(|v| v.is_finite())
                && trajectory.points_mm.back().is_none_or(|l| far(l) > MIN_MOVE_MM.powi(2));
            if new {
                if trajectory.points_mm.len() >= MAX_POINTS {
                    trajectory.points_mm.pop_front();
                }
                trajectory.points_mm.push_back(place);
            }
        }
    }

    /// Draws the view into `rect`; `trajectories` are outputs of tips, poses and arm links.
    pub fn show(&mut self, ui: &mut Ui, rect: Rect, shown: &OutputCache, output: &Output, trajectories: &[Output]) {
        self.follow(shown, trajectories);
        let response = ui.interact(rect, ui.id().with("space"), Sense::click_and_drag());
        response.widget_info(|| {
            WidgetInfo::labeled(WidgetType::Image, true, text!("surface-name", output = output.to_string()))
        });
        steer(ui, &response, &mut self.viewpoint, TURN);
        let points = ui.ctx().pixels_per_point();
        let size = [rect.width(), rect.height()].map(|n| ((n * points) as usize / 16 * 16).clamp(160, 1280));
        self.viewpoint.size_px = size;
        let painter = ui.painter_at(rect);
        let (Some((texture, size)), Some(packet)) = (shown.texture(output), shown.packet(output)) else {
            painter.text(
                rect.center(),
                Align2::CENTER_CENTER,
                text!("viewer-nothing"),
                FontId::proportional(16.0),
                theme::muted(),
            );
            return;
        };
        let scale = (rect.width() / size.x).min(rect.height() / size.y);
        let inner = Rect::from_center_size(rect.center(), size * scale);
        let uv = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        painter.image(texture, inner, uv, Color32::WHITE);
        let Some(depth_buffer) = packet.depth_buffer.clone() else {
            let caption = text!("surface-no-points");
            painter.text(rect.center(), Align2::CENTER_CENTER, caption, FontId::proportional(15.0), theme::muted());
            return;
        };
        let view = Projector { depth_buffer: &depth_buffer, inner, scale };
        if let Some(at) = response.interact_pointer_pos().filter(|_| self.measuring && response.clicked()) {
            self.tap(&depth_buffer, [(at.x - inner.left()) / inner.width(), (at.y - inner.top()) / inner.height()]);
        }
        // A focused field or button gets the keys.
        if ui.memory(|m| m.focused().is_none_or(|id| id == response.id)) {
            let chosen = ui.input_mut(|i| match self.measuring {
                true => self.crosshair.steer(i, inner.aspect_ratio()),
                false => {
                    steer_by_key(i, &mut self.viewpoint);
                    None
                }
            });
            chosen.into_iter().for_each(|at| self.tap(&depth_buffer, at));
        }
        self.draw_arms(&painter, &view);
        self.draw_trajectories(&painter, &view);
        self.draw_points(&painter, &view);
        self.crosshair.draw(&painter, inner);
    }

    /// Draws arms as lines with a dot at each joint; outer links are thinner.
    fn draw_arms(&self, painter: &Painter, view: &Projector<'_>) {
        for (output, joints) in &self.arms {
            let pose = self
                .trajectories
                .iter()
                .filter(|(trajectory, _)| trajectory.node == output.node)
                .find_map(|(_, trajectory)| trajectory.now);
            let here: Vec<[f64; 3]> = match pose {
                Some((wxyz, mm)) => joints.iter().map(|joint| moved_back(wxyz, mm, *joint)).collect(),
                None => joints.clone(),
            };
            for (k, pair) in here.windows(2).enumerate() {
                let width = (7.0 - 0.7 * k as f32).max(1.5);
                if let Some([a, b]) = view.line(pair[0], pair[1]) {
                    painter.line_segment([a, b], Stroke::new(width + 2.0, theme::sunk().gamma_multiply(0.8)));
                    painter.line_segment([a, b], Stroke::new(width, theme::family("arm")));
                }
            }
            for at in here.iter().filter_map(|joint| view.at(*joint)) {
                painter.circle(at, 3.5, theme::sunk(), Stroke::new(1.5, theme::family("arm")));
            }
            if let Some(at) = here.first().and_then(|foot| view.at(*foot)) {
                let caption = text!("surface-foot", node = &output.node);
                let at = at + vec2(8.0, -8.0);
                painter.text(at, Align2::LEFT_BOTTOM, caption, FontId::proportional(12.0), theme::family("arm"));
            }
        }
    }

    fn draw_trajectories(&self, painter: &Painter, view: &Projector<'_>) {
        let mut names: Vec<Pos2> = Vec::new();
        for (output, trajectory) in &self.trajectories {
            // Poses are transformed to the camera's current frame; tips are in the camera's frame already.
            let here = |place: &[f64; 3]| match trajectory.now {
                Some((wxyz, mm)) => moved_back(wxyz, mm, *place),
                None => *place,
            };
            let color = if trajectory.now.is_some() { theme::live() } else { theme::warn() };
            let line: Vec<Pos2> = trajectory.points_mm.iter().filter_map(|p| view.at(here(p))).collect();
            for pair in line.windows(2) {
                painter.line_segment([pair[0], pair[1]], Stroke::new(2.0, color.gamma_multiply(0.9)));
            }
            let Some(last) = trajectory.points_mm.back().map(here) else { continue };
            let Some(at) = view.at(last) else { continue };
            painter.circle_filled(at, 4.0, color);
            // Names at nearly the same position are drawn below each other.
            let mut name = at + vec2(8.0, -8.0);
            while names.iter().any(|n| (n.y - name.y).abs() < 13.0 && (n.x - name.x).abs() < 110.0) {
                name.y += 14.0;
            }
            names.push(name);
            painter.text(name, Align2::LEFT_BOTTOM, output.to_string(), FontId::proportional(12.0), color);
            if trajectory.now.is_some() {
                let still = [1.0, 0.0, 0.0, 0.0];
                for (axis, color) in [
                    ([1.0, 0.0, 0.0], theme::fault()),
                    ([0.0, 1.0, 0.0], theme::warn()),
                    ([0.0, 0.0, 1.0], theme::accent()),
                ] {
                    let end = moved(still, last, axis.map(|a: f64| a * AXIS_MM));
                    if let Some(end) = view.at(end) {
                        painter.line_segment([at, end], Stroke::new(2.0, color));
                    }
                }
            }
        }
    }

    fn draw_points(&self, painter: &Painter, view: &Projector<'_>) {
        let places: Vec<Pos2> = self.points.iter().filter_map(|p| view.at(p.map(f64::from))).collect();
        if let [a, b] = places[..] {
            painter.line_segment([a, b], Stroke::new(4.0, Color32::from_black_alpha(150)));
            painter.line_segment([a, b], Stroke::new(2.0, theme::accent()));
            if let Some(mm) = self.distance_mm() {
                let middle = a + (b - a) / 2.0 + vec2(10.0, 10.0);
                painter.text(
                    middle,
                    Align2::LEFT_TOP,
                    format!("{} mm", number(mm.into(), 2)),
                    FontId::proportional(16.0),
                    theme::accent(),
                );
            }
        }
        for at in places {
            painter.circle(at, 5.0, theme::sunk(), Stroke::new(2.0, theme::accent()));
        }
    }

    /// The controls: measuring and the depth range.
    pub fn controls(&mut self, ui: &mut Ui) {
        let caption = match (self.measuring, self.viewpoint.has_ruler) {
            (false, _) => text!("surface-measure"),
            (true, true) => text!("surface-measuring"),
            (true, false) => text!("surface-drifted"),
        };
        let button = ui.add(eframe::egui::Button::new(caption).selected(self.measuring));
        if button.on_hover_text(text!("surface-measure.hint")).clicked() {
            self.toggle_measuring();
        }
        ui.label(RichText::new(text!("surface-depth-from")).color(theme::muted()));
        let [near, far] = &mut self.viewpoint.clip_mm;
        let first = ui.add(drag_value(near).range(0.0..=*far - 1.0).speed(0.5).suffix(" mm").max_decimals(0));
        ui.ctx().accesskit_node_builder(first.id, |n| n.set_label(text!("surface-depth-from.name")));
        ui.label(RichText::new(text!("surface-depth-to")).color(theme::muted()));
        let second =
            ui.add(drag_value(far).range(*near + 1.0..=Viewpoint::FAR_MM).speed(0.5).suffix(" mm").max_decimals(0));
        ui.ctx().accesskit_node_builder(second.id, |n| n.set_label(text!("surface-depth-to.name")));
    }
}

/// Projects points to the screen.
struct Projector<'a> {
    depth_buffer: &'a DepthBuffer,
    inner: Rect,
    scale: f32,
}

impl Projector<'_> {
    /// Position of a point on the screen; `None` when it is behind the viewer.
    fn at(&self, place_mm: [f64; 3]) -> Option<Pos2> {
        let place = place_mm.map(|v| v as f32);
        let [x, y, depth] = self.depth_buffer.projection.project(place);
        let seen = x.is_finite() && y.is_finite() && depth > self.depth_buffer.projection.nearest_mm();
        seen.then(|| self.inner.min + vec2(x, y) * self.scale)
    }

    /// The part of a line in front of the viewer, on the screen.
    fn line(&self, a_mm: [f64; 3], b_mm: [f64; 3]) -> Option<[Pos2; 2]> {
        let depth = |place: [f64; 3]| f64::from(self.depth_buffer.projection.project(place.map(|v| v as f32))[2]);
        let nearest = f64::from(self.depth_buffer.projection.nearest_mm()) * 0.999;
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
