//! Draws the wires: bundles along lanes and between rows, and the names of those under the pointer.

use eframe::egui::{Mesh, Painter, Pos2, Rect, Response, Shape as Drawn, Stroke, Ui, Vec2, pos2, vec2};

use super::curve::{bow, distance, on_curve, rounded};
use super::interaction::Drag;
use super::paths::Path;
use super::shape::{HEADER, PICTURES};
use super::{Canvas, Scene};
use panoscope_editor_model::graph_view::{GraphView, Wire};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Distance between the wires of a bundle, and its greatest width, in points at zoom 1.
const BESIDE: f32 = 5.0;
const BUNDLE: f32 = 15.0;
/// Distance from the pointer within which wires are named, in points of the window.
const NEAR: f32 = 6.0;
/// Maximum number of wires that are named at once.
const NAMED: usize = 12;

impl Canvas {
    /// Position of a pin in points of the graph, and its packet type.
    fn pin_of(&self, node: usize, port: &str, input: bool) -> Option<(Pos2, &str)> {
        let shape = self.shapes.get(node)?;
        let (at, packet) = match shape.pin(port, input) {
            Some(pin) => (pin.at, pin.packet.as_str()),
            // A port that the type does not have is drawn at the header.
            None => (pos2(if input { 0.0 } else { shape.size.x }, HEADER / 2.0), ""),
        };
        Some((*self.places.get(node)? + at.to_vec2(), packet))
    }

    /// Position of a pin in the window, and its packet type.
    pub(super) fn pin_at(&self, node: usize, port: &str, input: bool) -> Option<(Pos2, &str)> {
        let (at, packet) = self.pin_of(node, port, input)?;
        Some((self.transform() * at, packet))
    }

    /// The pins at the ends of a wire, in points of the graph.
    pub(super) fn ends(&self, wire: &Wire) -> Option<(Pos2, Pos2)> {
        let ends = self.pin_of(wire.from, &wire.output, false).zip(self.pin_of(wire.to, &wire.input, true));
        ends.map(|((from, _), (to, _))| (from, to))
    }

    /// The curves of a wire as the layout has them, in points of the graph; none for a backward wire that the layout gives no path.
    pub(super) fn curves(&self, wire: &Wire) -> Vec<[Pos2; 4]> {
        let Some((from, to)) = self.ends(wire) else { return Vec::new() };
        let ends = (wire.from, wire.to);
        let Some(lane) = self.lanes.get(&ends) else {
            return match self.routes.get(&ends) {
                Some(corners) => self.routed(wire, from, to, corners),
                None if to.x > from.x => vec![bow(from, to, 1.0)],
                None => Vec::new(),
            };
        };
        let shift = vec2(0.0, self.beside(wire, BESIDE));
        let (mut at, mut curves) = (from, Vec::new());
        for [left, right] in lane {
            let (left, right) = (*left + shift, *right + shift);
            curves.push(bow(at, left, 1.0));
            let third = (right - left) / 3.0;
            curves.push([left, left + third, right - third, right]);
            at = right;
        }
        curves.push(bow(at, to, 1.0));
        curves
    }

    /// The number of the output that a wire leaves among all outputs that are read: the same for all its wires.
    pub(super) fn net(&self, wire: &Wire) -> usize {
        let before: usize = self.outputs.iter().take(wire.from).map(Vec::len).sum();
        let outputs = self.outputs.get(wire.from);
        before + outputs.and_then(|outputs| outputs.iter().position(|o| *o == wire.output)).unwrap_or(0)
    }

    /// Distance of a wire from the middle of the bundle that the wires of its node form.
    fn beside(&self, wire: &Wire, distance: f32) -> f32 {
        let Some(outputs) = self.outputs.get(wire.from) else { return 0.0 };
        let at = outputs.iter().position(|output| *output == wire.output).unwrap_or(0) as f32;
        let last = outputs.len().saturating_sub(1) as f32;
        (at - last / 2.0) * distance.min(BUNDLE / last.max(1.0))
    }

    /// The path of a wire to another row: along the corners that the layout gives.
    fn routed(&self, wire: &Wire, from: Pos2, to: Pos2, corners: &[Pos2]) -> Vec<[Pos2; 4]> {
        let shift = Vec2::splat(self.beside(wire, BESIDE / 2.0));
        let mut path = vec![from];
        if let (Some(first), Some(last)) = (corners.first(), corners.last()) {
            path.push(pos2(first.x + shift.x, from.y));
            path.extend(corners.iter().map(|corner| *corner + shift));
            path.push(pos2(last.x + shift.x, to.y));
        }
        path.push(to);
        rounded(&path)
    }

    /// Draws the wires. From afar all of them are one mesh of thin lines without smooth edges.
    pub(super) fn paint_wires(&mut self, painter: &Painter, scene: &Scene<'_>) {
        self.follow_scale();
        let view = scene.view;
        let pulled = match &self.drag {
            Drag::Wire { moved: Some((input, index)), .. } => Some((input, *index)),
            _ => None,
        };
        let (transform, scale) = (self.transform(), self.scale());
        let seen = (transform.inverse() * self.rect).expand(8.0 / scale);
        let far = scale < PICTURES;
        let mut thin = Mesh::default();
        let selected: Vec<bool> = match self.selected.is_empty() {
            true => Vec::new(),
            false => self.ids.iter().map(|id| self.selected.contains(id)).collect(),
        };
        let is_selected = |node: usize| selected.get(node).copied().unwrap_or_default();
        for (wire, path) in view.wires.iter().zip(&self.paths.wires).filter(|(_, path)| path.bounds.intersects(seen)) {
            let to = view.nodes[wire.to].id();
            if pulled.is_some_and(|(input, index)| input.node == to && input.port == wire.input && index == wire.index)
            {
                continue;
            }
            let packet = view.packet(wire.from, &wire.output).map_or("", |p| p.name.as_str());
            let chosen =
                self.selected_wire.as_ref().is_some_and(|w| w.0 == to && w.1 == wire.input && w.2 == wire.index);
            let near = is_selected(wire.to) || is_selected(wire.from);
            let (color, width) = match (chosen, near) {
                (true, _) => (theme::accent(), 3.0),
                (_, true) => (theme::packet(packet), 2.5),
                _ if wire.delayed => (theme::packet(packet).gamma_multiply(0.45), 1.5),
                _ => (theme::packet(packet).gamma_multiply(0.6), 2.0),
            };
            let stroke = Stroke::new((width * scale).max(1.0), color);
            if wire.delayed {
                for curve in &path.curves {
                    let points: Vec<Pos2> = (0..=32).map(|i| transform * on_curve(curve, i as f32 / 32.0)).collect();
                    painter.extend(Drawn::dashed_line(&points, stroke, 8.0 * scale, 5.0 * scale));
                }
                continue;
            }
            if far {
                let ends = path.lines.iter().flat_map(|line| line.windows(2));
                let ends = ends.filter(|ends| Rect::from_two_pos(ends[0], ends[1]).intersects(seen));
                ends.for_each(|ends| add_line(&mut thin, transform * ends[0], transform * ends[1], stroke));
                continue;
            }
            let lines = path.curves.iter().zip(&path.lines);
            for (_, line) in lines.filter(|(curve, _)| Rect::from_points(*curve).intersects(seen)) {
                match &line[..] {
                    [from, to] => _ = painter.line_segment([transform * *from, transform * *to], stroke),
                    points => _ = painter.line(points.iter().map(|at| transform * *at).collect(), stroke),
                }
            }
        }
        painter.add(thin);
    }

    /// Names the wires under the pointer, all of a bundle.
    pub(super) fn name_wires(&self, ui: &Ui, ground: &Response, scene: &Scene<'_>) {
        let pointer = ui.input(|i| i.pointer.hover_pos());
        let Some(at) = pointer.filter(|_| ground.hovered() && matches!(self.drag, Drag::None)) else { return };
        let names = self.wires_near(scene.view, at);
        if names.is_empty() {
            return;
        }
        let more = names.len().saturating_sub(NAMED);
        let mut text = names[..names.len() - more].join("\n");
        if more > 0 {
            text += &format!("\n{}", text!("canvas-wires-more", count = more));
        }
        ground.clone().on_hover_text_at_pointer(text);
    }

    /// Names of the wires near a point of the window, such as `scope.left to register.left`.
    fn wires_near(&self, view: &GraphView, at: Pos2) -> Vec<String> {
        let (at, near) = (self.transform().inverse() * at, NEAR / self.scale());
        let is_near = |path: &Path| {
            let lines = path.lines.iter().flat_map(|line| line.windows(2));
            path.bounds.expand(near).contains(at) && lines.into_iter().any(|ends| distance(at, ends[0], ends[1]) < near)
        };
        let name = |wire: &Wire| {
            let (from, to) = (view.nodes[wire.from].id(), view.nodes[wire.to].id());
            let packet = view.packet(wire.from, &wire.output).map_or_else(String::new, |p| format!("  ({})", p.name));
            let output = format!("{from}.{}", wire.output);
            let name = text!("canvas-wire", output = output, input = format!("{to}.{}{packet}", wire.input));
            if wire.delayed { text!("canvas-wire-delayed", wire = name) } else { name }
        };
        let wires = view.wires.iter().zip(&self.paths.wires);
        wires.filter(|(_, path)| is_near(path)).map(|(wire, _)| name(wire)).collect()
    }
}

/// Adds a straight line to a mesh.
fn add_line(mesh: &mut Mesh, from: Pos2, to: Pos2, stroke: Stroke) {
    let along = (to - from).normalized() * (stroke.width / 2.0);
    let aside = vec2(-along.y, along.x);
    let first = mesh.vertices.len() as u32;
    for at in [from + aside, to + aside, to - aside, from - aside] {
        mesh.colored_vertex(at, stroke.color);
    }
    mesh.add_triangle(first, first + 1, first + 2);
    mesh.add_triangle(first, first + 2, first + 3);
}
