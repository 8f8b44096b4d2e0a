//! Draws a node, by distance: from afar its name, light and picture, near its ports and values too.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use eframe::egui::emath::GuiRounding as _;
use eframe::egui::text::{LayoutJob, TextFormat};
use eframe::egui::{
    Align2, Color32, CornerRadius, FontId, Galley, Mesh, Painter, Pos2, Rect, Shape as Drawn, Stroke, StrokeKind, Ui,
    Vec2, pos2, vec2,
};

use super::paint::MIN_TEXT;
use super::shape::{DETAIL, HEADER, PAD, PICTURES, PORTS, Pin};
use super::{Canvas, Scene};
use panoscope_editor_model::content::{Content, DetectedBox};
use panoscope_editor_model::document::default_value;
use panoscope_editor_model::graph_view::{GraphView, without_name};
use panoscope_editor_model::texts::{decimal, text};
use panoscope_editor_model::timeline::Held;
use panoscope_editor_widgets::format_time;
use panoscope_editor_widgets::theme::{self, PinShape};
use panoscope_engine::fault::{Cause, Fault};

/// How long a fault is shown as new.
const NEW_FAULT_MS: u64 = 3000;
/// Height of a line of the smallest text.
const LINE: f32 = 15.0;
/// Below this zoom times and rates are not shown.
const FOOTERS: f32 = 0.5;

/// The header of a node that is drawn in `rect`: never lower than a line of text.
fn header(rect: Rect, scale: f32) -> Rect {
    let height = (HEADER * scale).max(LINE).min(rect.height());
    Rect::from_min_size(rect.min, vec2(rect.width(), height))
}

impl Canvas {
    /// Draws a node into `rect`; from afar its box becomes a part of `far`.
    pub(super) fn paint_node(
        &self,
        ui: &Ui,
        scene: &Scene<'_>,
        node: usize,
        rect: Rect,
        hovered: bool,
        far: &mut Mesh,
    ) {
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
        let fill = if scene.heat { theme::heat(share) } else { theme::raised() };
        let problem = problem_of(scene, node);
        let stroke = edge(problem.as_ref().map(|(_, color)| *color), selected, hovered);
        if scale < PICTURES {
            plain_node(far, rect.round_to_pixels(painter.pixels_per_point()), fill, stroke, family);
            if rect.height() > LINE && rect.width() > 2.5 * MIN_TEXT {
                let font = FontId::proportional(MIN_TEXT);
                let name = elided(painter, title, font, theme::text(), rect.width() - 6.0);
                painter.galley(rect.min + vec2(4.0, (rect.height() - name.size().y) / 2.0), name, theme::text());
            }
            return;
        }
        if this.is_part {
            // A second edge behind the first: there is more inside.
            let behind = rect.translate(vec2(4.0, 4.0) * scale);
            painter.rect(behind, radius, theme::panel(), Stroke::new(1.0, theme::line()), StrokeKind::Outside);
        }
        painter.rect(rect, radius, fill, stroke, StrokeKind::Outside);
        let bar = Rect::from_min_size(rect.min, vec2(4.0 * scale, HEADER * scale));
        let left = CornerRadius { nw: radius.nw, ne: 0, sw: 0, se: 0 };
        painter.rect_filled(bar, left, family);
        let header = header(rect, scale);
        let line = header.center().y;
        let light = pos2(rect.right() - (14.0 * scale).max(8.0), line);
        self.paint_light(ui, scene, node, light);
        let near = scale >= PORTS;
        // Far away the name gets the whole width, near the type or the button of a part is beside it.
        let inset = (14.0 * scale).max(6.0);
        let room = light.x - 8.0 - rect.left() - inset;
        let name = elided(painter, title, self.font(14.0), theme::text(), room);
        let room = room - name.size().x - 12.0 * scale;
        painter.galley(pos2(rect.left() + inset, line - name.size().y / 2.0), name, theme::text());
        if this.is_part && room > 30.0 {
            painter.text(
                // Clear of the ring of a fault.
                pos2(light.x - (12.0 * scale).max(10.0), line),
                Align2::RIGHT_CENTER,
                text!("canvas-open"),
                self.font(11.0),
                theme::accent(),
            );
        } else if near && !this.is_part && room > 30.0 * scale {
            let caption = elided(painter, &this.outline.type_name, self.font(11.0), theme::muted(), room);
            let at = pos2(light.x - 12.0 * scale - caption.size().x, line - caption.size().y / 2.0);
            painter.galley(at, caption, theme::muted());
        }
        if let Some(frame) = self.picture_rect(node, rect) {
            match &problem {
                Some((words, color)) => self.paint_problem(painter, frame, words, *color),
                None => self.paint_picture(painter, scene, node, frame),
            }
        }
        if scale >= DETAIL {
            self.paint_pins(painter, node, near);
        }
        if let Some(footer) = self.footer_rect(node, rect) {
            self.paint_footer(painter, scene, node, footer);
        }
    }

    /// The rectangle of a node's preview, where the node is drawn in `rect`. Far away it takes the space of the names of ports.
    pub(super) fn picture_rect(&self, node: usize, rect: Rect) -> Option<Rect> {
        let scale = self.scale();
        let picture = self.shapes[node].picture.filter(|_| scale >= PICTURES)?;
        if scale >= PORTS {
            return Some(Rect::from_min_size(rect.min + picture.min.to_vec2() * scale, picture.size() * scale));
        }
        let bottom = self.footer_rect(node, rect).map_or(rect.bottom() - (PAD * scale).min(3.0), |footer| footer.top());
        let aside = PAD * scale;
        let top = header(rect, scale).bottom();
        Some(Rect::from_min_max(pos2(rect.left() + aside, top), pos2(rect.right() - aside, bottom)))
    }

    /// The rectangle of times and rates, where there is space for them.
    fn footer_rect(&self, node: usize, rect: Rect) -> Option<Rect> {
        let scale = self.scale();
        if scale < FOOTERS {
            return None;
        }
        let footer = self.shapes[node].footer;
        let height = (footer.height() * scale).max(LINE);
        let at = pos2(rect.left() + footer.left() * scale, rect.bottom() - height);
        Some(Rect::from_min_size(at, vec2(footer.width() * scale, height)))
    }

    /// Draws the ports, and near their names.
    fn paint_pins(&self, painter: &Painter, node: usize, near: bool) {
        let (shape, transform, scale) = (&self.shapes[node], self.transform(), self.scale());
        let position = self.places[node];
        for pin in &shape.pins {
            let at = transform * (position + pin.at.to_vec2());
            self.paint_pin(painter, pin, at);
            if near {
                let (align, shift) =
                    if pin.input { (Align2::LEFT_CENTER, 10.0) } else { (Align2::RIGHT_CENTER, -10.0) };
                let color = if pin.missing { theme::text() } else { theme::muted() };
                painter.text(at + vec2(shift * scale, 0.0), align, &pin.name, self.font(11.5), color);
            }
        }
        if let Some(fold) = shape.fold.filter(|_| near) {
            let rect = transform * fold.translate(position.to_vec2());
            let caption = match shape.folded {
                0 => text!("canvas-fewer").to_owned(),
                count => text!("canvas-more", count = count),
            };
            let at = rect.right_center() - vec2(2.0 * scale, 0.0);
            painter.text(at, Align2::RIGHT_CENTER, caption, self.font(11.0), theme::accent());
        }
    }

    /// Draws the status light.
    fn paint_light(&self, ui: &Ui, scene: &Scene<'_>, node: usize, at: Pos2) {
        let id = scene.view.nodes[node].id();
        // The graph that runs is not what a recording shows.
        let is_live = scene.recorded.is_none();
        let fault = scene.counters.faults.get(id).filter(|_| is_live);
        let color = match fault {
            Some(fault) => fault_color(fault),
            None if !is_live => theme::line(),
            None if scene.running && scene.counters.nodes.get(id).is_some_and(|c| c.fps > 0.0) => {
                theme::family("source")
            }
            None => theme::line(),
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
                painter.rect_filled(frame, 4.0 * scale, theme::sunk());
                let fit = (frame.width() / size.x).min(frame.height() / size.y);
                let inner = Rect::from_center_size(frame.center(), size * fit);
                let whole = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
                // A recording that stands still shows no old pictures.
                let stale = scene.shown.stale(output).filter(|_| scene.recorded.is_none());
                painter.image(
                    texture,
                    inner,
                    whole,
                    if stale.is_some() { Color32::from_gray(96) } else { Color32::WHITE },
                );
                if let Some(Content::Boxes(found)) = scene.shown.packet(output).map(|l| &l.content) {
                    let least = min_score(scene.view, &[scene.view.nodes[node].id(), &output.node]);
                    let shown = found.iter().filter(|detected| detected.score >= least);
                    paint_boxes(painter, inner, shown, (scale >= PORTS).then(|| self.font(11.0)));
                }
                if let Some(age) = stale.filter(|_| scene.running && scale >= DETAIL) {
                    let caption = text!("canvas-old", seconds = age.as_secs());
                    painter.text(frame.center(), Align2::CENTER_CENTER, caption, self.font(13.0), theme::warn());
                }
            }
            None if frame.width() < 72.0 || frame.height() < 2.0 * LINE => {
                let counters = scene.counters.nodes.get(scene.view.nodes[node].id());
                if let Some(counters) = counters.filter(|c| c.fps > 0.0) {
                    let caption = format_time(counters.p50_ms);
                    painter.text(
                        frame.center(),
                        Align2::CENTER_CENTER,
                        caption,
                        FontId::proportional(MIN_TEXT),
                        theme::muted(),
                    );
                }
            }
            None => {
                painter.rect_filled(frame, 4.0 * scale, theme::sunk());
                let held = scene.recorded.map(|held| held(below));
                // Only what a packet says is bright: the type of a packet that has not come is not.
                let (caption, color) = match held {
                    Some(held @ (Held::Lacking | Held::Computing(_))) => (held_in_words(held), theme::muted()),
                    _ => match scene.shown.text(output) {
                        Some(text) => (text.to_owned(), theme::text()),
                        None => (packet.clone(), theme::muted()),
                    },
                };
                let galley =
                    self.rows(painter, caption, color, vec2(frame.width() - 16.0 * scale, frame.height() - 8.0));
                let clipped = painter.with_clip_rect(frame.intersect(self.rect));
                let at = frame.left_center() + vec2(8.0 * scale, -galley.size().y / 2.0);
                clipped.galley(pos2(at.x, at.y.max(frame.top() + 4.0)), galley, color);
            }
        }
    }

    fn paint_pin(&self, painter: &Painter, pin: &Pin, at: Pos2) {
        let r = 5.0 * self.scale();
        let color = theme::packet(&pin.packet);
        let (fill, stroke) = if pin.missing {
            (theme::raised(), Stroke::new(1.5, theme::muted()))
        } else {
            (color, Stroke::new(1.5, theme::ground()))
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

    /// Draws why a node does not run, in the place of its picture.
    fn paint_problem(&self, painter: &Painter, frame: Rect, words: &str, color: Color32) {
        let scale = self.scale();
        painter.rect_filled(frame, 4.0 * scale, theme::sunk());
        let inside = frame.shrink2(vec2(8.0 * scale, 3.0));
        let galley = self.rows(painter, words.to_owned(), color, inside.size());
        let at = pos2(inside.left(), (inside.center().y - galley.size().y / 2.0).max(inside.top()));
        painter.with_clip_rect(frame.intersect(self.rect)).galley(at, galley, color);
    }

    /// Lays out as many rows of a text as `room` is high; what follows is an ellipsis.
    fn rows(&self, painter: &Painter, text: String, color: Color32, room: Vec2) -> Arc<Galley> {
        let font = self.font(11.0);
        let row = painter.fonts_mut(|fonts| fonts.row_height(&font));
        let mut job = LayoutJob::simple(text, font, color, room.x.max(8.0));
        job.wrap.max_rows = (room.y / row).max(1.0) as usize;
        painter.layout_job(job)
    }

    /// Draws times and rates, or the node's first error.
    fn paint_footer(&self, painter: &Painter, scene: &Scene<'_>, node: usize, rect: Rect) {
        let this = &scene.view.nodes[node];
        let font = self.font(11.0);
        if let Some((caption, color)) = problem_of(scene, node).filter(|_| self.shapes[node].picture.is_none()) {
            return self.paint_problem(painter, rect, &caption, color);
        }
        let line = |caption: &str, color| {
            let galley = elided(painter, caption, font.clone(), color, rect.width());
            painter.galley(pos2(rect.left(), rect.center().y - galley.size().y / 2.0), galley, color);
        };
        if let Some((_, color)) = problem_of(scene, node) {
            // The words are in the place of the picture.
            let kind = if color == theme::muted() { text!("canvas-unfinished") } else { text!("canvas-mistake") };
            return line(kind, color);
        }
        if let (Some(held), Some((output, _))) = (scene.recorded, &self.shapes[node].output) {
            return line(&held_in_words(held(output)), theme::muted());
        }
        let Some(c) = scene.counters.nodes.get(this.id()) else { return };
        let plain = |color| TextFormat { font_id: font.clone(), color, ..TextFormat::default() };
        let rate = match scene.counters.over {
            Some(_) => text!("canvas-ticks", count = c.count),
            None => text!("canvas-rate", rate = decimal(c.fps, 0)),
        };
        let mut right = LayoutJob::default();
        if let Some(fault) = scene.counters.faults.get(this.id()) {
            right.append(&format!("{}  ", faults_in_words(fault, c.faults.max(1))), 0.0, plain(fault_color(fault)));
        }
        if c.dropped > 0 {
            right.append(&format!("{}  ", text!("state-drops", count = c.dropped)), 0.0, plain(theme::warn()));
        }
        if let Some(age) = c.age_p50_ms.filter(|a| *a > 0.0) {
            let mut with_age = right.clone();
            with_age.append(&format!("{}  ", text!("canvas-age", age = format_time(age))), 0.0, plain(theme::muted()));
            let mut whole = with_age.clone();
            whole.append(&rate, 0.0, plain(theme::text()));
            // Only where there is room for it.
            if painter.layout_job(whole).size().x <= rect.width() {
                right = with_age;
            }
        }
        right.append(&rate, 0.0, plain(theme::text()));
        let right = painter.layout_job(right);
        let middle = rect.center().y;
        painter.galley(
            pos2(rect.right() - right.size().x, middle - right.size().y / 2.0),
            right.clone(),
            theme::text(),
        );
        // The longest text that fits.
        let p50 = format_time(c.p50_ms);
        let lefts = match c.fps > 0.0 || scene.counters.over.is_some() && c.count > 0 {
            true => vec![text!("canvas-median", median = &p50, slow = format_time(c.p99_ms)), p50],
            false => vec![text!("canvas-rest").to_owned()],
        };
        let room = rect.width() - right.size().x - 8.0 * self.scale();
        let galleys = lefts.into_iter().map(|caption| painter.layout_no_wrap(caption, font.clone(), theme::muted()));
        if let Some(left) = galleys.into_iter().find(|g| g.size().x <= room) {
            painter.galley(pos2(rect.left(), middle - left.size().y / 2.0), left, theme::muted());
        }
    }
}

/// A small node as a few rectangles: with hundreds of nodes in view, round and antialiased edges would dominate the drawing time.
fn plain_node(mesh: &mut Mesh, rect: Rect, fill: Color32, edge: Stroke, bar: Color32) {
    // A thin edge that says nothing is left out: filling pixels is slow with software rendering.
    if edge.color != theme::line() {
        mesh.add_colored_rect(rect.expand(edge.width), edge.color);
    }
    mesh.add_colored_rect(rect, fill);
    mesh.add_colored_rect(Rect::from_min_size(rect.min, vec2(2.0, rect.height())), bar);
}

/// Colour of a fault, the same for the light and for the words beside it.
fn fault_color(fault: &Fault) -> Color32 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_millis() as u64);
    if now.saturating_sub(fault.unix_ms) < NEW_FAULT_MS { theme::fault() } else { theme::warn() }
}

fn faults_in_words(fault: &Fault, count: u64) -> String {
    match fault.cause {
        Cause::Panic => text!("canvas-panics", count = count),
        Cause::Hang => text!("canvas-hangs", count = count),
        Cause::Slow => text!("canvas-slow", count = count),
        Cause::Leak => text!("canvas-leaks", count = count),
        _ => text!("canvas-faults", count = count),
    }
}

/// Draws boxes with their labels in the colours of their classes.
fn paint_boxes<'b>(
    painter: &Painter,
    picture: Rect,
    boxes: impl Iterator<Item = &'b DetectedBox>,
    font: Option<FontId>,
) {
    for detected in boxes {
        let [x, y, w, h] = detected.share;
        let at = picture.min + vec2(x * picture.width(), y * picture.height());
        let rect = Rect::from_min_size(at, vec2(w * picture.width(), h * picture.height())).intersect(picture);
        let color = theme::class(detected.class);
        painter.rect_stroke(rect, 1.0, Stroke::new(1.5, color), StrokeKind::Inside);
        if let Some(font) = font.clone() {
            let galley = elided(painter, &detected.label, font, theme::on(color), picture.width() - 6.0);
            let size = galley.size() + vec2(6.0, 0.0);
            let at = label_at(rect, size, picture);
            painter.rect_filled(Rect::from_min_size(at, size), 1.0, color);
            painter.galley(at + vec2(3.0, 0.0), galley, theme::on(color));
        }
    }
}

/// Where the label of a box stands: above the box, else inside it, and never outside of the picture.
fn label_at(rect: Rect, size: Vec2, picture: Rect) -> Pos2 {
    let above = rect.top() - size.y;
    let y = if above >= picture.top() { above } else { rect.top() };
    let last = picture.max - size;
    pos2(rect.left().min(last.x).max(picture.left()), y.min(last.y).max(picture.top()))
}

/// What there is of an output of a recording, as text.
fn held_in_words(held: Held) -> String {
    match held {
        Held::Recorded => text!("canvas-recorded").to_owned(),
        Held::Computed => text!("canvas-computed").to_owned(),
        Held::Computing(percent) => text!("canvas-computing", percent = usize::from(percent)),
        Held::Lacking => text!("canvas-not-recorded").to_owned(),
    }
}

/// The least score of the boxes that nodes show: the greatest `min_score` that one of them has.
fn min_score(view: &GraphView, nodes: &[&str]) -> f32 {
    let of = |id: &&str| {
        let all = if view.node(id).is_some() { view } else { view.flat() };
        let node = &all.nodes[all.node(id)?];
        let param = node.node_type.as_ref()?.params.iter().find(|param| param.name == "min_score")?;
        let value = node.outline.params.get("min_score").cloned().unwrap_or_else(|| default_value(&param.kind));
        value.as_float().or(value.as_integer().map(|v| v as f64)).map(|v| v as f32)
    };
    nodes.iter().filter_map(of).fold(0.0, f32::max)
}

/// The edge of a node: in the colour of its problem, else by whether it is selected or under the pointer.
fn edge(problem: Option<Color32>, selected: bool, hovered: bool) -> Stroke {
    match problem {
        Some(color) => Stroke::new(2.0, color),
        None if selected => Stroke::new(2.0, theme::accent()),
        None if hovered => Stroke::new(1.0, theme::muted()),
        None => Stroke::new(1.0, theme::line()),
    }
}

/// Why a node does not run, without its name, and the colour of that: gray while it only waits to be connected.
fn problem_of(scene: &Scene<'_>, node: usize) -> Option<(String, Color32)> {
    let this = &scene.view.nodes[node];
    let words = this.mistakes.first().map(String::as_str);
    let words = words.or(scene.problem.filter(|(n, _)| *n == this.id()).map(|(_, words)| words))?;
    let color = if scene.view.is_unfinished_at(node) { theme::muted() } else { theme::fault() };
    Some((without_name(words, this.id()), color))
}

/// Lays out one line of text, truncated with an ellipsis to `width`.
fn elided(painter: &Painter, text: &str, font: FontId, color: Color32, width: f32) -> Arc<Galley> {
    let mut job = LayoutJob::simple_singleline(text.to_owned(), font, color);
    // In whole points, so that a text that moves with the graph is not laid out again.
    job.wrap.max_width = (width + 0.01).floor().max(8.0);
    job.wrap.max_rows = 1;
    job.wrap.break_anywhere = true;
    painter.layout_job(job)
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_editor_model::graph_view::NodeView;
    use panoscope_graph::{NodeOutline, NodeType, Param, ParamKind};

    #[test]
    fn labels_of_boxes_stay_inside_the_picture() {
        let picture = Rect::from_min_size(pos2(10.0, 10.0), vec2(100.0, 60.0));
        let size = vec2(40.0, 12.0);
        for (x, y) in [(10.0, 10.0), (90.0, 11.0), (105.0, 40.0), (10.0, 66.0), (60.0, 69.0)] {
            let label =
                Rect::from_min_size(label_at(Rect::from_min_size(pos2(x, y), vec2(5.0, 4.0)), size, picture), size);
            assert!(picture.expand(0.01).contains_rect(label), "{x} {y}: {label:?}");
        }
        let above = label_at(Rect::from_min_size(pos2(30.0, 40.0), vec2(20.0, 20.0)), size, picture);
        assert_eq!(above, pos2(30.0, 28.0), "above the box where there is space");
    }

    #[test]
    fn boxes_below_the_least_score_of_their_nodes_are_not_shown() {
        let node = |id: &str, given: Option<f64>| {
            let kind = ParamKind::Float { default: 0.25, min: None, max: None, step: None };
            let param = toml::from_str::<Param>("name = \"min_score\"\nkind = \"float\"\ndefault = 0.0\n");
            let param = Param { kind, ..param.expect("a parameter") };
            let params = given.map(|value| ("min_score".to_owned(), value.into())).into_iter().collect();
            let (id, type_name, inputs, line) = (id.to_owned(), "yolo".to_owned(), Vec::new(), 1);
            NodeView {
                outline: NodeOutline { id, type_name, inputs, params, line },
                node_type: Some(Arc::new(NodeType { params: vec![param], ..NodeType::default() })),
                position: None,
                mistakes: Vec::new(),
                is_part: false,
            }
        };
        let mut view = GraphView::default();
        view.nodes.extend([node("find", None), node("show", Some(0.5))]);
        assert_eq!(min_score(&view, &["find"]), 0.25, "the default");
        assert_eq!(min_score(&view, &["find", "show"]), 0.5, "the greatest of the two");
        assert_eq!(min_score(&view, &["nobody"]), 0.0);
    }
}
