//! A small picture of the whole graph, shown while a part of it is outside of the view. A click or drag moves the view.

use eframe::egui::{Id, Mesh, Pos2, Rect, Sense, Stroke, StrokeKind, Ui, Vec2, WidgetInfo, WidgetType, vec2};

use super::{Canvas, Scene};
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::theme;

/// Greatest size of the map, in points of the window.
const SIZE: Vec2 = vec2(200.0, 132.0);
/// Distance between the map and the edges of the canvas.
const MARGIN: f32 = 12.0;
/// Distance between the graph and the edge of the map.
const PAD: f32 = 6.0;

impl Canvas {
    /// Draws the map and handles input on it.
    pub(super) fn show_minimap(&mut self, ui: &mut Ui, scene: &Scene<'_>) {
        let Some(extent) = self.extent(scene.view) else { return };
        let seen = self.transform().inverse() * self.rect;
        if seen.expand(1.0).contains_rect(extent) || self.rect.width() < 2.0 * SIZE.x {
            return;
        }
        // Also where the view is, so that it can be found again.
        let whole = extent.union(seen);
        let room = SIZE - Vec2::splat(2.0 * PAD);
        let scale = (room.x / whole.width()).min(room.y / whole.height());
        let size = whole.size() * scale + Vec2::splat(2.0 * PAD);
        let map = Rect::from_min_size(self.rect.max - size - Vec2::splat(MARGIN), size);
        let to_map = |at: Pos2| map.min + Vec2::splat(PAD) + (at - whole.min) * scale;
        let rect_of = |rect: Rect| Rect::from_min_max(to_map(rect.min), to_map(rect.max));
        let response = ui.interact(map, Id::new("minimap"), Sense::click_and_drag());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Other, true, text!("canvas-map")));
        let painter = ui.painter();
        painter.rect(
            map,
            4.0,
            theme::panel().gamma_multiply(0.94),
            Stroke::new(1.0, theme::line()),
            StrokeKind::Inside,
        );
        let mut mesh = Mesh::default();
        for ((node, shape), at) in scene.view.nodes.iter().zip(&self.shapes).zip(&self.places) {
            let faulty = scene.counters.faults.contains_key(node.id()) || !node.mistakes.is_empty();
            let color = match (self.selected.contains(node.id()), faulty) {
                (true, _) => theme::accent(),
                (_, true) => theme::fault(),
                _ => theme::family(node.family()).gamma_multiply(0.7),
            };
            let rect = rect_of(Rect::from_min_size(*at, shape.size));
            mesh.add_colored_rect(rect.expand2((vec2(2.0, 2.0) - rect.size()).max(Vec2::ZERO) / 2.0), color);
        }
        painter.add(mesh);
        painter.rect_stroke(rect_of(seen).intersect(map), 2.0, Stroke::new(1.5, theme::text()), StrokeKind::Inside);
        if (response.clicked() || response.dragged())
            && let Some(pointer) = response.interact_pointer_pos()
        {
            let at = whole.min + (pointer - map.min - Vec2::splat(PAD)) / scale;
            self.fit = false;
            self.offset = -at.to_vec2() * self.scale();
        }
    }
}
