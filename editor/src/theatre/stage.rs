//! The pictures: each with a line above it, and nothing on it.

use eframe::egui::{
    Align2, Color32, EventFilter, FontId, Id, Rect, Sense, Stroke, StrokeKind, TextureId, Ui, WidgetInfo, WidgetType,
    pos2, vec2,
};

use super::arrange::{GAP, TITLE, fit, level};
use super::notices::{Facts, OLD_MS};
use super::{Layout, Place, Theatre};
use crate::panels::surface;
use crate::theme;

/// Share of the width for the live picture beside a frozen one.
const LIVE_SHARE: f32 = 0.22;
/// How fast a drag turns a surface, radians per point.
const TURN: f32 = 0.008;

impl Theatre {
    pub(super) fn stage(&mut self, ui: &mut Ui, room: Rect, facts: &Facts) {
        let mut room = room;
        // While anything is held still, a live picture stays beside it.
        if self.frozen.is_some()
            && let Some(raw) = self.plan.raw.clone()
        {
            let width = (room.width() * LIVE_SHARE).round();
            let side = Rect::from_min_max(pos2(room.right() - width, room.top()), room.max);
            room.max.x -= width + GAP;
            let height = TITLE + width * 0.75;
            let side = Rect::from_min_size(side.min, vec2(width, height.min(side.height())));
            self.picture(ui, side, &raw, Some(&format!("Live: {}", raw.label)), true, facts);
        }
        if self.measure.picture().is_some() {
            return self.measured(ui, room);
        }
        if self.raw_only.is_some() {
            if let Some(raw) = self.plan.raw.clone() {
                self.picture(ui, room, &raw, None, true, facts);
            }
            return;
        }
        let views = self.plan.views.clone();
        let mut places = self.layout.places(views.len(), room);
        if let [(first, a), (second, b)] = &mut places[..] {
            let size = |n: usize| self.shown.texture(&views[n].output).map(|(_, size)| size);
            if let (Some(one), Some(other)) = (size(*first), size(*second)) {
                [*a, *b] = level([*a, *b], [one, other]);
            }
        }
        for (n, rect) in places {
            let place = &views[n];
            let raw = self.plan.raw.clone().filter(|_| self.replaced(place, facts) && n == self.layout.main());
            let clicked = match raw {
                Some(raw) => {
                    let title = format!("{} (in place of {})", raw.label, place.label);
                    self.picture(ui, rect, &raw, Some(&title), true, facts)
                }
                None if place.packet == "cloud" => {
                    let alone = views.len() == 1 || self.layout == Layout::One(n);
                    self.turn(ui, rect, place, alone);
                    self.picture(ui, rect, place, None, false, facts);
                    false
                }
                None => self.picture(ui, rect, place, None, false, facts),
            };
            if clicked && views.len() > 1 {
                self.layout = if self.layout == Layout::One(n) { Layout::All } else { Layout::One(n) };
            }
        }
    }

    /// A view with its title; answers whether it was tapped.
    fn picture(
        &mut self,
        ui: &mut Ui,
        rect: Rect,
        place: &Place,
        title: Option<&str>,
        live: bool,
        facts: &Facts,
    ) -> bool {
        let title = title.unwrap_or(&place.label);
        // A tap leads from one layout to another; beside a frozen picture, or where there is one view, to nothing.
        let idle = place.packet == "cloud" || self.plan.views.len() < 2 || live && self.frozen.is_some();
        let tap = if idle { Sense::hover() } else { Sense::click() };
        let shown = if live { &self.live } else { &self.shown };
        let texture = shown.texture(&place.output);
        let room = Rect::from_min_max(pos2(rect.left(), rect.top() + TITLE), rect.max);
        let inner = texture.map_or(room, |(_, size)| fit(room, size));
        // The line stands right above the picture, wherever in its room that is.
        let rect = Rect::from_min_max(inner.min - vec2(0.0, TITLE), inner.max);
        let response = ui.interact(rect, ui.id().with(("view", &place.output, live)), tap);
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, format!("View {title}")));
        if response.has_focus() {
            focus_frame(ui, rect);
        }
        let stopped = !live && facts.stopped.contains(&place.label);
        let painter = ui.painter_at(rect);
        painter.text(
            pos2(rect.left(), rect.top() + TITLE / 2.0),
            Align2::LEFT_CENTER,
            title,
            FontId::proportional(16.0),
            theme::TEXT.gamma_multiply(0.85),
        );
        let age = self.age_ms(&place.output).filter(|_| live || self.frozen.is_none());
        let (words, color) = match age {
            _ if stopped => ("no new picture".to_owned(), theme::FAULT),
            Some(age) if age > 9_999.0 => ("no new picture".to_owned(), theme::FAULT),
            Some(age) if age > OLD_MS => (format!("{:.1} s old", age / 1e3), theme::WARN),
            // A calm number: it moves in steps.
            Some(age) => (format!("{:.0} ms", (age / 10.0).ceil() * 10.0), theme::MUTED),
            None => (String::new(), theme::MUTED),
        };
        painter.text(
            pos2(rect.right(), rect.top() + TITLE / 2.0),
            Align2::RIGHT_CENTER,
            words,
            FontId::proportional(14.0),
            color,
        );
        match texture {
            Some((texture, _)) => {
                // What has stopped must not be taken for live.
                let tint = if stopped { Color32::from_gray(90) } else { Color32::WHITE };
                image(ui, texture, inner, tint);
                if stopped {
                    painter.rect_stroke(inner, 0.0, Stroke::new(3.0, theme::FAULT), StrokeKind::Inside);
                }
            }
            None => {
                painter.rect_filled(room, 4.0, theme::SUNK);
                let words = if stopped { "no picture" } else { "starting" };
                painter.text(room.center(), Align2::CENTER_CENTER, words, FontId::proportional(20.0), theme::MUTED);
            }
        }
        response.clicked()
    }

    /// Drags, the wheel and keys turn, move and enlarge a surface; keys do where it has the focus or stands `alone`.
    fn turn(&mut self, ui: &Ui, rect: Rect, place: &Place, alone: bool) {
        let response = ui.interact(rect, ui.id().with(("turn", &place.output)), Sense::click_and_drag());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, format!("Turn {}", place.label)));
        let sight = self.sights.entry(place.output.clone()).or_default();
        surface::steer(ui, &response, sight, TURN);
        if response.has_focus() {
            keep_arrows(ui, response.id);
            focus_frame(ui, rect);
        }
        if response.has_focus() || alone && ui.memory(|m| m.focused().is_none()) {
            ui.input_mut(|i| surface::steer_by_key(i, sight));
        }
        let points = ui.ctx().pixels_per_point();
        let size = [rect.width(), rect.height() - TITLE].map(|n| ((n * points) as usize / 16 * 16).clamp(160, 1280));
        sight.size_px = size;
    }

    /// The picture that is measured in, and what was measured.
    fn measured(&mut self, ui: &mut Ui, rect: Rect) {
        let Some((held, output)) = self.measure.picture() else { return };
        let Some((texture, size)) = held.texture(output) else { return };
        let room = Rect::from_min_max(pos2(rect.left(), rect.top() + TITLE), rect.max);
        let inner = fit(room, size);
        let line = Rect::from_min_max(inner.min - vec2(0.0, TITLE), inner.right_top());
        let painter = ui.painter_at(rect);
        let hint = self.measure.hint();
        painter.text(line.left_center(), Align2::LEFT_CENTER, hint, FontId::proportional(18.0), theme::ACCENT);
        image(ui, texture, inner, Color32::WHITE);
        let response = ui.interact(inner, ui.id().with("measure"), Sense::click());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, "Measure here"));
        if response.has_focus() {
            keep_arrows(ui, response.id);
            focus_frame(ui, line.union(inner));
        }
        if response.has_focus() || ui.memory(|m| m.focused().is_none()) {
            ui.input_mut(|i| self.measure.tap_by_key(i));
        }
        if let Some(at) = response.interact_pointer_pos().filter(|_| response.clicked()) {
            self.measure.tap((at.x - inner.left()) / inner.width(), (at.y - inner.top()) / inner.height());
        }
        let (width, height) = self.measure.size_px();
        let on_screen = |(x, y): (f32, f32)| {
            inner.min + vec2((x + 0.5) / width as f32 * inner.width(), (y + 0.5) / height as f32 * inner.height())
        };
        let points: Vec<_> = self.measure.points().iter().map(|p| (on_screen(p.at_px), p.place)).collect();
        if let [(a, _), (b, _)] = points[..] {
            painter.line_segment([a, b], Stroke::new(5.0, Color32::from_black_alpha(160)));
            painter.line_segment([a, b], Stroke::new(2.5, theme::ACCENT));
        }
        for (at, place) in &points {
            let color = if place.is_some() { theme::ACCENT } else { theme::FAULT };
            painter.circle_stroke(*at, 9.0, Stroke::new(5.0, Color32::from_black_alpha(160)));
            painter.circle_stroke(*at, 9.0, Stroke::new(2.5, color));
            painter.circle_filled(*at, 2.0, color);
        }
        self.measure.crosshair().draw(&painter, inner);
        let told = match (self.measure.distance(), self.measure.depth()) {
            (Some(length), _) => Some(length.to_string()),
            (None, Some(depth)) => Some(format!("{depth} deep")),
            _ => None,
        };
        if let Some(words) = told {
            // Beside the picture's title, where it covers nothing.
            painter.text(line.right_center(), Align2::RIGHT_CENTER, words, FontId::proportional(26.0), theme::TEXT);
        }
    }
}

/// Arrow keys are for what has the focus, not for leaving it.
pub(super) fn keep_arrows(ui: &Ui, id: Id) {
    let filter = EventFilter { horizontal_arrows: true, vertical_arrows: true, ..EventFilter::default() };
    ui.memory_mut(|m| m.set_focus_lock_filter(id, filter));
}

/// Around the picture that has the focus, not on it.
pub(super) fn focus_frame(ui: &Ui, rect: Rect) {
    ui.painter().rect_stroke(rect.expand(4.0), 6.0, Stroke::new(2.0, theme::ACCENT), StrokeKind::Inside);
}

fn image(ui: &Ui, texture: TextureId, rect: Rect, tint: Color32) {
    ui.painter().image(texture, rect, Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0)), tint);
}
