//! Draws the graph: background, wires, nodes, drags.

use std::time::{SystemTime, UNIX_EPOCH};

use eframe::egui::emath::GuiRounding as _;
use eframe::egui::epaint::CubicBezierShape;
use eframe::egui::text::{LayoutJob, TextFormat};
use eframe::egui::{
    Align2, Color32, CornerRadius, FontFamily, FontId, Mesh, Painter, Pos2, Rect, Shape as Drawn, Stroke, StrokeKind,
    Ui, pos2, vec2,
};

use super::curve::{bow, flattened, on_curve, rounded};
use super::interaction::{Drag, check_wire};
use super::shape::{DETAIL, HEADER, PAD, PICTURES, Pin};
use super::{Canvas, Scene};
use panoscope_editor_model::content::{Content, DetectedBox};
use panoscope_editor_model::graph_view::{GraphView, Wire};
use panoscope_editor_widgets::format_time;
use panoscope_editor_widgets::theme::{self, PinShape};

/// Distance between a backward wire and the nodes above it, points at zoom 1.
const BELOW: f32 = 20.0;
/// How long a fault is shown as new.
const NEW_FAULT_MS: u64 = 3000;

impl Canvas {
    fn font(&self, size: f32) -> FontId {
        // Rounded to half points, so that the font texture needs fewer sizes.
        FontId::new(((size * self.scale()) * 2.0).round() / 2.0, FontFamily::Proportional)
    }

    /// Draws the grid points. The background is the window's clear colour, because filling pixels is slow with software rendering.
    pub(super) fn paint_ground(&self, painter: &Painter) {
        let step = 32.0 * self.scale();
        if step < 14.0 {
            return;
        }
        let origin = self.transform() * Pos2::ZERO;
        let start = |o: f32, low: f32| low + (o - low).rem_euclid(step);
        let color = theme::LINE.gamma_multiply(0.55);
        let mut y = start(origin.y, self.rect.top());
        while y < self.rect.bottom() {
            let mut x = start(origin.x, self.rect.left());
            while x < self.rect.right() {
                painter.rect_filled(Rect::from_center_size(pos2(x, y), vec2(1.5, 1.5)), 0.0, color);
                x += step;
            }
            y += step;
        }
    }

    /// Position of a pin in the window, and its packet type.
    fn pin_at(&self, view: &GraphView, node: usize, port: &str, input: bool) -> Option<(Pos2, String)> {
        let shape = self.shapes.get(node)?;
        let position = self.positions.get(view.nodes[node].id())?;
        let (at, packet) = match shape.pin(port, input) {
            Some(pin) => (pin.at, pin.packet.clone()),
            // A port that the type does not have is drawn at the header.
            None => (pos2(if input { 0.0 } else { shape.size.x }, HEADER / 2.0), String::new()),
        };
        Some((self.transform() * (*position + at.to_vec2()), packet))
    }

    /// The curves that a wire consists of.
    pub(super) fn curves(&self, view: &GraphView, wire: &Wire) -> Vec<[Pos2; 4]> {
        let ends = (self.pin_at(view, wire.from, &wire.output, false), self.pin_at(view, wire.to, &wire.input, true));
        let (Some((from, _)), Some((to, _))) = ends else { return Vec::new() };
        let Some(lane) = self.lanes.get(&(wire.from, wire.to)) else {
            return if to.x > from.x { vec![bow(from, to, self.scale())] } else { self.around(view, wire, from, to) };
        };
        // Wires of one lane are drawn beside each other.
        let mut beside = view.wires.iter().filter(|w| w.from == wire.from && w.to == wire.to);
        let shift = vec2(0.0, beside.position(|w| w == wire).unwrap_or(0) as f32 * 7.0 - 3.0);
        let (transform, mut at, mut curves) = (self.transform(), from, Vec::new());
        for [left, right] in lane {
            let (left, right) = (transform * (*left + shift), transform * (*right + shift));
            curves.push(bow(at, left, self.scale()));
            let third = (right - left) / 3.0;
            curves.push([left, left + third, right - third, right]);
            at = right;
        }
        curves.push(bow(at, to, self.scale()));
        curves
    }

    /// The path of a backward wire, below the nodes between its ends.
    fn around(&self, view: &GraphView, wire: &Wire, from: Pos2, to: Pos2) -> Vec<[Pos2; 4]> {
        let transform = self.transform();
        let (from, to) = (transform.inverse() * from, transform.inverse() * to);
        let rects: Vec<Rect> = (view.nodes.iter().zip(&self.shapes))
            .map(|(node, shape)| {
                Rect::from_min_size(self.positions.get(node.id()).copied().unwrap_or_default(), shape.size)
            })
            .collect();
        let bottom = |n: usize| rects.get(n).map_or(f32::MIN, Rect::bottom);
        // Backward wires are drawn beside each other.
        let beside = view.wires.iter().filter(|w| w.delayed).position(|w| w == wire).unwrap_or(0);
        let room = BELOW + (beside % 4) as f32 * 7.0;
        let mut low = bottom(wire.from).max(bottom(wire.to)) + room;
        for _ in 0..rects.len() {
            let between = rects.iter().filter(|r| r.right() > to.x - BELOW && r.left() < from.x + BELOW);
            let met = between.filter(|r| r.top() - BELOW < low && low < r.bottom() + BELOW);
            match met.map(Rect::bottom).reduce(f32::max) {
                Some(bottom) => low = bottom + room,
                None => break,
            }
        }
        // Down and up between the columns.
        let (right, left) = (from.x + room, to.x - room);
        let corners = [from, pos2(right, from.y), pos2(right, low), pos2(left, low), pos2(left, to.y), to];
        rounded(&corners).into_iter().map(|curve| curve.map(|at| transform * at)).collect()
    }

    pub(super) fn paint_wires(&self, painter: &Painter, scene: &Scene<'_>) {
        let view = scene.view;
        let pulled = match &self.drag {
            Drag::Wire { moved: Some((input, index)), .. } => Some((input, *index)),
            _ => None,
        };
        for wire in &view.wires {
            let to = view.nodes[wire.to].id();
            let is_pulled = pulled
                .is_some_and(|(input, index)| input.node == to && input.port == wire.input && index == wire.index);
            if is_pulled {
                continue;
            }
            let curves = self.curves(view, wire);
            let packet = view.packet(wire.from, &wire.output).map_or("", |p| p.name.as_str());
            let selected =
                self.selected_wire.as_ref().is_some_and(|w| w.0 == to && w.1 == wire.input && w.2 == wire.index);
            let near = self.selected.contains(to) || self.selected.contains(view.nodes[wire.from].id());
            let (color, width) = match (selected, near) {
                (true, _) => (theme::ACCENT, 3.0),
                (_, true) => (theme::packet(packet), 2.5),
                _ if wire.delayed => (theme::packet(packet).gamma_multiply(0.45), 1.5),
                _ => (theme::packet(packet).gamma_multiply(0.6), 2.0),
            };
            let stroke = Stroke::new((width * self.scale()).max(1.0), color);
            for curve in curves.into_iter().filter(|c| Rect::from_points(c).expand(8.0).intersects(self.rect)) {
                if wire.delayed {
                    let points: Vec<Pos2> = (0..=32).map(|i| on_curve(&curve, i as f32 / 32.0)).collect();
                    painter.extend(Drawn::dashed_line(&points, stroke, 8.0 * self.scale(), 5.0 * self.scale()));
                } else {
                    match &flattened(&curve)[..] {
                        [from, to] => painter.line_segment([*from, *to], stroke),
                        points => painter.line(points.to_vec(), stroke),
                    };
                }
            }
        }
    }

    pub(super) fn paint_node(&self, ui: &Ui, scene: &Scene<'_>, node: usize, rect: Rect, hovered: bool) {
        let painter = ui.painter();
        let this = &scene.view.nodes[node];
        let (id, scale) = (this.id(), self.scale());
        // Inside a frame the part's name is on the frame.
        let title = id.rsplit('/').next().unwrap_or(id);
        let counters = scene.counters.nodes.get(id);
        let selected = self.selected.contains(id);
        let family = theme::family(this.family());
        let radius = CornerRadius::same((8.0 * scale).clamp(2.0, 12.0) as u8);
        let share = counters.map_or(0.0, |c| (c.p50_ms * c.fps / 1e3) as f32);
        let fill = if scene.heat { theme::heat(share) } else { theme::RAISED };
        let wrong = !this.mistakes.is_empty() || scene.problem.is_some_and(|(n, _)| n == id);
        let stroke = match (wrong, selected, hovered) {
            (true, ..) => Stroke::new(2.0, theme::FAULT),
            (_, true, _) => Stroke::new(2.0, theme::ACCENT),
            (_, _, true) => Stroke::new(1.0, theme::MUTED),
            _ => Stroke::new(1.0, theme::LINE),
        };
        if scale < PICTURES {
            painter.add(plain_node(rect.round_to_pixels(painter.pixels_per_point()), fill, stroke, family));
            let name = elided(painter, title, FontId::proportional(9.0), theme::TEXT, rect.width() - 8.0 * scale);
            painter.galley(pos2(rect.left() + 6.0 * scale, rect.top() + 4.0 * scale), name, theme::TEXT);
            return;
        }
        if this.is_part {
            // A second edge behind the first: there is more inside.
            let behind = rect.translate(vec2(4.0, 4.0) * scale);
            painter.rect(behind, radius, theme::PANEL, Stroke::new(1.0, theme::LINE), StrokeKind::Outside);
        }
        painter.rect(rect, radius, fill, stroke, StrokeKind::Outside);
        let bar = Rect::from_min_size(rect.min, vec2(4.0 * scale, HEADER * scale));
        let left = CornerRadius { nw: radius.nw, ne: 0, sw: 0, se: 0 };
        painter.rect_filled(bar, left, family);
        let line = rect.top() + HEADER * scale / 2.0;
        if scale < DETAIL {
            // The name is drawn above the box, where it has more width.
            let font = FontId::proportional(11.0);
            let name = elided(painter, title, font, theme::TEXT, rect.width() + 48.0 * scale);
            let at = pos2(rect.left(), rect.top() - name.size().y - 1.0);
            painter.galley(at, name, theme::TEXT);
            self.paint_light(ui, scene, node, pos2(rect.right() - 14.0 * scale, line));
            // Without pins and numbers the preview gets all the space.
            let room = rect.shrink(PAD * scale);
            let room = Rect::from_min_max(pos2(room.left(), rect.top() + HEADER * scale), room.max);
            self.paint_picture(painter, scene, node, room);
            return;
        }
        let name = elided(painter, title, self.font(14.0), theme::TEXT, rect.width() - (28.0 + 16.0) * scale);
        let name_width = name.size().x;
        painter.galley(pos2(rect.left() + 14.0 * scale, line - name.size().y / 2.0), name, theme::TEXT);
        self.paint_light(ui, scene, node, pos2(rect.right() - 14.0 * scale, line));
        let room = rect.width() - name_width - 52.0 * scale;
        if this.is_part {
            let at = pos2(rect.right() - 26.0 * scale, line);
            painter.text(at, Align2::RIGHT_CENTER, "open", self.font(11.0), theme::ACCENT);
        } else if room > 30.0 * scale {
            let caption = elided(painter, &this.outline.type_name, self.font(11.0), theme::MUTED, room);
            let at = pos2(rect.right() - 26.0 * scale - caption.size().x, line - caption.size().y / 2.0);
            painter.galley(at, caption, theme::MUTED);
        }
        let shape = &self.shapes[node];
        if let Some(picture) = shape.picture {
            let frame = Rect::from_min_size(rect.min + picture.min.to_vec2() * scale, picture.size() * scale);
            self.paint_picture(painter, scene, node, frame);
        }
        let transform = self.transform();
        let position = self.positions.get(id).copied().unwrap_or_default();
        for pin in &shape.pins {
            let at = transform * (position + pin.at.to_vec2());
            self.paint_pin(painter, pin, at);
            let (align, shift) = if pin.input { (Align2::LEFT_CENTER, 10.0) } else { (Align2::RIGHT_CENTER, -10.0) };
            let color = if pin.missing { theme::FAULT } else { theme::MUTED };
            painter.text(at + vec2(shift * scale, 0.0), align, &pin.name, self.font(11.5), color);
        }
        if let Some(fold) = shape.fold {
            let rect = transform * fold.translate(position.to_vec2());
            let caption = if shape.folded > 0 { format!("{} more", shape.folded) } else { "fewer".to_owned() };
            painter.text(
                rect.right_center() - vec2(2.0 * scale, 0.0),
                Align2::RIGHT_CENTER,
                caption,
                self.font(11.0),
                theme::ACCENT,
            );
        }
        self.paint_footer(painter, scene, node, transform * shape.footer.translate(position.to_vec2()));
    }

    /// Draws the status light.
    fn paint_light(&self, ui: &Ui, scene: &Scene<'_>, node: usize, at: Pos2) {
        let id = scene.view.nodes[node].id();
        let fault = scene.counters.faults.get(id);
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_millis() as u64);
        let color = match fault {
            Some(fault) if now.saturating_sub(fault.unix_ms) < NEW_FAULT_MS => theme::FAULT,
            Some(_) => theme::WARN,
            None if scene.running && scene.counters.nodes.get(id).is_some_and(|c| c.fps > 0.0) => {
                theme::family("source")
            }
            None => theme::LINE,
        };
        let radius = (4.0 * self.scale()).max(2.5);
        ui.painter().circle_filled(at, radius, color);
        if fault.is_some() {
            // A ring marks a fault without relying on colour.
            ui.painter().circle_stroke(at, radius + 2.5, Stroke::new(1.0, color));
        }
    }

    /// Draws a node's preview in `frame`: its image or text; at a small zoom, the node's time instead of a text.
    fn paint_picture(&self, painter: &Painter, scene: &Scene<'_>, node: usize, frame: Rect) {
        let shape = &self.shapes[node];
        let scale = self.scale();
        let Some((output, packet)) = &shape.output else { return };
        // Boxes are drawn on the image that was searched.
        let below = shape.backdrop.as_ref().map_or(output, |(below, _)| below);
        match scene.shown.texture(below) {
            Some((texture, size)) => {
                painter.rect_filled(frame, 4.0 * scale, theme::SUNK);
                let fit = (frame.width() / size.x).min(frame.height() / size.y);
                let inner = Rect::from_center_size(frame.center(), size * fit);
                let whole = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
                let stale = scene.shown.stale(output);
                painter.image(
                    texture,
                    inner,
                    whole,
                    if stale.is_some() { Color32::from_gray(96) } else { Color32::WHITE },
                );
                if let Some(Content::Boxes(found)) = scene.shown.packet(output).map(|l| &l.content) {
                    paint_boxes(painter, inner, found, (scale >= DETAIL).then(|| self.font(11.0)));
                }
                if let Some(age) = stale.filter(|_| scene.running && scale >= DETAIL) {
                    let caption = format!("{} s old", age.as_secs());
                    painter.text(frame.center(), Align2::CENTER_CENTER, caption, self.font(13.0), theme::WARN);
                }
            }
            None if scale < DETAIL => {
                let counters = scene.counters.nodes.get(scene.view.nodes[node].id());
                if let Some(counters) = counters.filter(|c| c.fps > 0.0) {
                    let caption = format_time(counters.p50_ms);
                    painter.text(
                        frame.center(),
                        Align2::CENTER_CENTER,
                        caption,
                        FontId::proportional(10.0),
                        theme::MUTED,
                    );
                }
            }
            None => {
                painter.rect_filled(frame, 4.0 * scale, theme::SUNK);
                let caption = scene.shown.text(output).unwrap_or(packet);
                let galley =
                    painter.layout(caption.to_owned(), self.font(11.0), theme::TEXT, frame.width() - 16.0 * scale);
                let clipped = painter.with_clip_rect(frame.intersect(self.rect));
                let at = frame.left_center() + vec2(8.0 * scale, -galley.size().y / 2.0);
                clipped.galley(pos2(at.x, at.y.max(frame.top() + 4.0)), galley, theme::TEXT);
            }
        }
    }

    fn paint_pin(&self, painter: &Painter, pin: &Pin, at: Pos2) {
        let r = 5.0 * self.scale();
        let color = theme::packet(&pin.packet);
        let (fill, stroke) = if pin.missing {
            (theme::RAISED, Stroke::new(1.5, theme::FAULT))
        } else {
            (color, Stroke::new(1.5, theme::GROUND))
        };
        match theme::pin_shape(&pin.packet) {
            PinShape::Circle => {
                painter.circle(at, r, fill, stroke);
            }
            PinShape::Square => {
                painter.rect(Rect::from_center_size(at, vec2(r, r) * 1.8), 1.0, fill, stroke, StrokeKind::Middle);
            }
            PinShape::Diamond => {
                let r = r * 1.25;
                let points = vec![at - vec2(0.0, r), at + vec2(r, 0.0), at + vec2(0.0, r), at - vec2(r, 0.0)];
                painter.add(Drawn::convex_polygon(points, fill, stroke));
            }
            PinShape::Triangle => {
                let points = vec![at + vec2(-r, -r * 1.1), at + vec2(r * 1.2, 0.0), at + vec2(-r, r * 1.1)];
                painter.add(Drawn::convex_polygon(points, fill, stroke));
            }
        }
        if pin.list {
            painter.circle_stroke(at, r + 2.5 * self.scale(), Stroke::new(1.0, color));
        }
    }

    /// Draws times and rates, or the node's first error.
    fn paint_footer(&self, painter: &Painter, scene: &Scene<'_>, node: usize, rect: Rect) {
        let this = &scene.view.nodes[node];
        let font = self.font(11.0);
        let problem = scene.problem.filter(|(n, _)| *n == this.id()).map(|(_, caption)| caption.to_owned());
        if let Some(caption) = this.mistakes.first().cloned().or(problem) {
            let galley = elided(painter, &caption, font, theme::FAULT, rect.width());
            painter.galley(pos2(rect.left(), rect.center().y - galley.size().y / 2.0), galley, theme::FAULT);
            return;
        }
        let Some(c) = scene.counters.nodes.get(this.id()) else { return };
        let mut right = LayoutJob::default();
        let plain = |color| TextFormat { font_id: font.clone(), color, ..TextFormat::default() };
        if let Some(fault) = scene.counters.faults.get(this.id()) {
            let (count, word) = (c.faults.max(1), fault_name(fault));
            let plural = if count > 1 { "s" } else { "" };
            right.append(&format!("{count} {word}{plural}  "), 0.0, plain(theme::WARN));
        }
        if c.dropped > 0 {
            let plural = if c.dropped > 1 { "s" } else { "" };
            right.append(&format!("{} drop{plural}  ", c.dropped), 0.0, plain(theme::WARN));
        }
        if let Some(age) = c.age_p50_ms.filter(|a| *a > 0.0) {
            right.append(&format!("age {}  ", format_time(age)), 0.0, plain(theme::MUTED));
        }
        right.append(&format!("{:.0} fps", c.fps), 0.0, plain(theme::TEXT));
        let right = painter.layout_job(right);
        let middle = rect.center().y;
        painter.galley(pos2(rect.right() - right.size().x, middle - right.size().y / 2.0), right.clone(), theme::TEXT);
        // The longest text that fits.
        let p50 = format_time(c.p50_ms);
        let lefts = match c.fps > 0.0 {
            true => vec![format!("{p50} · p99 {}", format_time(c.p99_ms)), p50],
            false => vec!["at rest".to_owned()],
        };
        let room = rect.width() - right.size().x - 8.0 * self.scale();
        let galleys = lefts.into_iter().map(|caption| painter.layout_no_wrap(caption, font.clone(), theme::MUTED));
        if let Some(left) = galleys.into_iter().find(|g| g.size().x <= room) {
            painter.galley(pos2(rect.left(), middle - left.size().y / 2.0), left, theme::MUTED);
        }
    }

    /// Draws the wire or selection frame that is being dragged.
    pub(super) fn paint_drag(&self, ui: &Ui, scene: &Scene<'_>) {
        let Some(pointer) = ui.input(|i| i.pointer.latest_pos()) else { return };
        let painter = ui.painter();
        match &self.drag {
            Drag::Frame(from) => {
                let frame = Rect::from_two_pos(self.transform() * *from, pointer);
                let stroke = Stroke::new(1.0, theme::ACCENT);
                painter.rect(frame, 2.0, theme::ACCENT.gamma_multiply(0.1), stroke, StrokeKind::Inside);
            }
            Drag::Wire { from, .. } => {
                let Some(node) = scene.view.node(&from.node) else { return };
                let Some((start, packet)) = self.pin_at(scene.view, node, &from.port, from.input) else { return };
                let over = self.pin_near(scene.view, from, pointer);
                let verdict = over.as_ref().map(|end| check_wire(scene.view, from, end));
                let end = over.as_ref().and_then(|end| {
                    Some(self.pin_at(scene.view, scene.view.node(&end.node)?, &end.port, end.input)?.0)
                });
                let color = match verdict {
                    Some(Err(_)) => theme::FAULT,
                    Some(Ok(())) => theme::ACCENT,
                    None => theme::packet(&packet),
                };
                let to = end.unwrap_or(pointer);
                let curve = if from.input { bow(to, start, self.scale()) } else { bow(start, to, self.scale()) };
                let stroke = Stroke::new(2.5 * self.scale(), color);
                painter.add(CubicBezierShape::from_points_stroke(curve, false, Color32::TRANSPARENT, stroke));
                if let Some(end) = end {
                    painter.circle_stroke(end, 9.0 * self.scale(), Stroke::new(2.0, color));
                }
                if let Some(Err(why)) = verdict {
                    show_hint(painter, pointer + vec2(16.0, 12.0), &why.to_string());
                }
            }
            Drag::None | Drag::Nodes { .. } => {}
        }
    }
}

/// A small node as a few rectangles: with hundreds of nodes in view, round and antialiased edges would dominate the drawing time.
fn plain_node(rect: Rect, fill: Color32, edge: Stroke, bar: Color32) -> Mesh {
    let (mut mesh, w) = (Mesh::default(), edge.width);
    let outer = rect.expand(w);
    mesh.add_colored_rect(Rect::from_min_max(outer.min, pos2(outer.right(), rect.top())), edge.color);
    mesh.add_colored_rect(Rect::from_min_max(pos2(outer.left(), rect.bottom()), outer.max), edge.color);
    mesh.add_colored_rect(Rect::from_min_max(pos2(outer.left(), rect.top()), rect.left_bottom()), edge.color);
    mesh.add_colored_rect(Rect::from_min_max(rect.right_top(), pos2(outer.right(), rect.bottom())), edge.color);
    mesh.add_colored_rect(rect, fill);
    mesh.add_colored_rect(Rect::from_min_size(rect.min, vec2(2.0, rect.height())), bar);
    mesh
}

fn fault_name(fault: &panoscope_engine::fault::Fault) -> &'static str {
    use panoscope_engine::fault::Cause;
    match fault.cause {
        Cause::Panic => "panic",
        Cause::Hang => "hang",
        Cause::Slow => "slow call",
        Cause::Leak => "leak",
        _ => "fault",
    }
}

/// Draws boxes with their labels in the colours of their classes.
fn paint_boxes(painter: &Painter, picture: Rect, boxes: &[DetectedBox], font: Option<FontId>) {
    for detected in boxes {
        let [x, y, w, h] = detected.share;
        let at = picture.min + vec2(x * picture.width(), y * picture.height());
        let rect = Rect::from_min_size(at, vec2(w * picture.width(), h * picture.height())).intersect(picture);
        let color = theme::class(detected.class);
        painter.rect_stroke(rect, 1.0, Stroke::new(1.5, color), StrokeKind::Inside);
        if let Some(font) = font.clone() {
            let galley = painter.layout_no_wrap(detected.label.clone(), font, theme::SUNK);
            let at = pos2(rect.left(), (rect.top() - galley.size().y).max(picture.top()));
            painter.rect_filled(Rect::from_min_size(at, galley.size() + vec2(6.0, 0.0)), 1.0, color);
            painter.galley(at + vec2(3.0, 0.0), galley, theme::SUNK);
        }
    }
}

/// Lays out one line of text, truncated with an ellipsis to `width`.
fn elided(
    painter: &Painter,
    text: &str,
    font: FontId,
    color: Color32,
    width: f32,
) -> std::sync::Arc<eframe::egui::Galley> {
    let mut job = LayoutJob::simple_singleline(text.to_owned(), font, color);
    job.wrap.max_width = width.max(8.0);
    job.wrap.max_rows = 1;
    job.wrap.break_anywhere = true;
    painter.layout_job(job)
}

/// Draws a short message beside the pointer.
fn show_hint(painter: &Painter, at: Pos2, caption: &str) {
    let font = FontId::new(12.0, FontFamily::Proportional);
    let galley = painter.layout(caption.to_owned(), font, theme::TEXT, 280.0);
    let rect = Rect::from_min_size(at, galley.size() + vec2(16.0, 12.0));
    painter.rect(rect, 4.0, theme::PANEL, Stroke::new(1.0, theme::FAULT), StrokeKind::Inside);
    painter.galley(rect.min + vec2(8.0, 6.0), galley, theme::TEXT);
}
