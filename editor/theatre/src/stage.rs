//! Draws the images, each with a title above it; nothing is drawn on an image except the live image in a corner of a frozen one.

use eframe::egui::text::LayoutJob;
use eframe::egui::{
    Align2, Color32, EventFilter, FontId, Id, Painter, Rect, Sense, Stroke, StrokeKind, TextureId, Ui, Vec2,
    WidgetInfo, WidgetType, pos2, vec2,
};

use super::arrange::{GAP, TITLE, fit, inset};
use super::marks::{fitting, focus_frame};
use super::notices::{Facts, NoPicture, OLD_MS, STOPPED_MS};
use super::{Layout, Pane, Theatre};
use panoscope_editor_model::surface::Viewpoint;
use panoscope_editor_model::texts::{decimal, number, text};
use panoscope_editor_widgets::surface;
use panoscope_editor_widgets::theme;

/// Share of the width for the live image beside the one being measured.
const LIVE_SHARE: f32 = 0.22;
/// Maximum width of a message in place of an image, points.
const NO_PICTURE_WIDTH: f32 = 820.0;
/// Rotation of a surface per point of a drag, radians.
const TURN: f32 = 0.008;

impl Theatre {
    pub(super) fn stage(&mut self, ui: &mut Ui, room: Rect, facts: &Facts) {
        if let Some((held, output)) = self.measure.picture() {
            // Nothing may cover the measured image: without free space it is made narrower.
            let size = held.texture(output).map_or(vec2(4.0, 3.0), |(_, size)| size);
            let below_title = |room: Rect| Rect::from_min_max(room.min + vec2(0.0, TITLE), room.max);
            let mut rect = room;
            let mut side = inset(room, self.live_size(), &[with_title(fit(below_title(room), size))]);
            if side.intersects(fit(below_title(room), size)) {
                let width = (room.width() * LIVE_SHARE).round();
                rect.max.x -= width + GAP;
                let height = (TITLE + width * 0.75).min(room.height());
                side = Rect::from_min_size(pos2(room.right() - width, room.top()), vec2(width, height));
            }
            self.measured(ui, rect);
            return self.live_beside(ui, side, facts);
        }
        if self.shows_raw() {
            match self.raw().cloned() {
                Some(raw) => {
                    self.picture(ui, room, &raw, None, true, facts);
                }
                None => no_picture(ui, room, &facts.no_picture("", false)),
            }
            return;
        }
        let views = self.plan.views.clone();
        // A surface is drawn in the proportions of its rectangle.
        let shape =
            |view: &Pane| self.shown.texture(&view.output).map(|(_, size)| size).filter(|_| view.packet != "cloud");
        let shapes: Vec<_> = views.iter().map(shape).collect();
        let rects = self.layout.rects(&mut self.composition, &shapes, room);
        // While the images are frozen, a live image is shown in a corner.
        let live = self.frozen.is_some().then(|| {
            let occupied = |(n, rect): &(usize, Rect)| {
                let below_title = Rect::from_min_max(rect.min + vec2(0.0, TITLE), rect.max);
                let size = self.shown.texture(&views[*n].output).map(|(_, size)| size);
                with_title(size.map_or(below_title, |size| fit(below_title, size)))
            };
            inset(room, self.live_size(), &rects.iter().map(occupied).collect::<Vec<_>>())
        });
        for (n, rect) in rects {
            let pane = &views[n];
            let raw = self.raw().filter(|_| self.replaced(pane, facts) && n == self.layout.main());
            let raw = raw.filter(|raw| self.live.texture(&raw.output).is_some()).cloned();
            let clicked = match raw {
                Some(raw) => {
                    let title = text!("view-in-place", camera = raw.title(), view = pane.title());
                    self.picture(ui, rect, &raw, Some(&title), true, facts)
                }
                None if pane.packet == "cloud" => {
                    let alone = views.len() == 1 || self.layout == Layout::One(n);
                    self.turn(ui, rect, pane, alone);
                    self.picture(ui, rect, pane, None, false, facts);
                    false
                }
                None => self.picture(ui, rect, pane, None, false, facts),
            };
            if clicked && views.len() > 1 {
                self.layout = if self.layout == Layout::One(n) { Layout::All } else { Layout::One(n) };
            }
        }
        if let Some(side) = live {
            self.live_beside(ui, side, facts);
        } else {
            self.corner(ui, room, facts);
        }
    }

    /// Size of the raw view's image; 4:3 before the first one.
    fn live_size(&self) -> Vec2 {
        let texture = self.raw().and_then(|raw| self.live.texture(&raw.output));
        texture.map_or(vec2(4.0, 3.0), |(_, size)| size)
    }

    /// Draws the live image beside a frozen one.
    fn live_beside(&mut self, ui: &mut Ui, side: Rect, facts: &Facts) {
        if let Some(raw) = self.raw().cloned() {
            // A background and border distinguish it from an image that it may cover.
            ui.painter().rect_filled(side.expand(4.0), 6.0, theme::BLACK);
            ui.painter().rect_stroke(side.expand(4.0), 6.0, Stroke::new(1.5, theme::live()), StrokeKind::Inside);
            self.picture(ui, side, &raw, Some(&text!("view-live", camera = raw.title())), true, facts);
        }
    }

    /// Whether a view is the one that zooming applies to: the main one, not a live image in a corner, and no surface, which has a viewpoint.
    fn is_zoomed(&self, pane: &Pane, live: bool) -> bool {
        let is_inset = live && self.frozen.is_some();
        let main = if self.shows_raw() { self.raw() } else { self.plan.views.get(self.layout.main()) };
        !is_inset && pane.packet != "cloud" && main.is_some_and(|main| main.output == pane.output)
    }

    /// Zooms the main view by a step, a picture as well as a surface.
    pub(super) fn zoom_by(&mut self, closer: bool) {
        if self.measure.is_on() {
            return self.notify(text!("view-not-zoomed"), false);
        }
        let main = if self.shows_raw() { self.raw() } else { self.plan.views.get(self.layout.main()) };
        match main.filter(|main| main.packet == "cloud") {
            Some(surface) => {
                let viewpoint = self.viewpoints.entry(surface.output.clone()).or_default();
                surface::zoom_by(viewpoint, if closer { 1.0 } else { -1.0 });
            }
            None => self.zoom.step(closer),
        }
    }

    /// The viewpoint on the surface of an output such as `points.cloud`; `None` for one that was not shown yet.
    pub fn viewpoint(&self, output: &str) -> Option<Viewpoint> {
        self.viewpoints.iter().find(|(known, _)| known.to_string() == output).map(|(_, viewpoint)| *viewpoint)
    }

    /// Magnification of the main view.
    pub fn zoom(&self) -> f32 {
        self.zoom.scale()
    }

    /// Draws a picture in a corner of the view that is shown alone: another view if that is wanted, else the whole picture while it is zoomed.
    fn corner(&mut self, ui: &mut Ui, room: Rect, facts: &Facts) {
        let Layout::One(n) = self.layout else { return };
        let Some(main) = self.plan.views.get(n).cloned() else { return };
        let below_title = Rect::from_min_max(room.min + vec2(0.0, TITLE), room.max);
        let size_of = |this: &Self, pane: &Pane| this.shown.texture(&pane.output).map(|(_, size)| size);
        let Some(size) = size_of(self, &main) else { return };
        let count = self.plan.views.len();
        let other = self.plan.views.get((n + 1) % count.max(1)).filter(|_| self.inset && count > 1).cloned();
        if let Some(other) = other {
            let shape = size_of(self, &other).unwrap_or(vec2(4.0, 3.0));
            let side = inset(room, shape, &[with_title(fit(below_title, size))]);
            ui.painter().rect_filled(side.expand(4.0), 6.0, theme::BLACK);
            ui.painter().rect_stroke(side.expand(4.0), 6.0, Stroke::new(1.5, theme::line()), StrokeKind::Inside);
            if self.picture(ui, side, &other, None, false, facts) {
                self.perform(super::Action::Next);
            }
        } else if let Some((texture, _)) =
            self.shown.texture(&main.output).filter(|_| self.zoom.is_on() && main.packet != "cloud")
        {
            let side = inset(room, size, &[with_title(fit(below_title, size))]);
            let inner = fit(Rect::from_min_max(side.min + vec2(0.0, TITLE), side.max), size);
            ui.painter().rect_filled(inner.expand(4.0), 6.0, theme::BLACK);
            image(ui, texture, inner, tint(self.is_picture_stale(&main.output, false)));
            ui.painter().rect_stroke(
                self.zoom.frame_in(inner),
                0.0,
                Stroke::new(2.0, theme::accent()),
                StrokeKind::Inside,
            );
            let response = ui.interact(inner, ui.id().with("whole"), Sense::hover());
            response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, text!("view-whole")));
        }
    }

    /// Draws a view with its title; returns whether it was tapped.
    fn picture(
        &mut self,
        ui: &mut Ui,
        rect: Rect,
        pane: &Pane,
        title: Option<&str>,
        live: bool,
        facts: &Facts,
    ) -> bool {
        let is_zoomed = self.is_zoomed(pane, live);
        let mut title = title.map_or_else(|| pane.title(), str::to_owned);
        if is_zoomed && self.zoom.is_on() {
            title = text!("view-zoomed", title = title, factor = decimal(self.zoom.scale().into(), 1));
        }
        // A tap changes the layout, except on a live inset or when there is only one view.
        let idle = pane.packet == "cloud" || self.plan.views.len() < 2 || live && self.frozen.is_some();
        let tap = if idle { Sense::hover() } else { Sense::click() };
        let tap = if is_zoomed && self.zoom.is_on() { tap.union(Sense::drag()) } else { tap };
        let shown = if live { &self.live } else { &self.shown };
        let texture = shown.texture(&pane.output);
        let room = Rect::from_min_max(pos2(rect.left(), rect.top() + TITLE), rect.max);
        let inner = texture.map_or(room, |(_, size)| fit(room, size));
        // The title is directly above the image.
        let rect = Rect::from_min_max(inner.min - vec2(0.0, TITLE), inner.max);
        let response = ui.interact(rect, ui.id().with(("view", &pane.output, live)), tap);
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, text!("view-name", title = &title)));
        if response.has_focus() {
            focus_frame(ui, rect);
        }
        let is_frozen = !live && self.frozen.is_some();
        let age = self.shown_age_ms(&pane.output).filter(|_| live || !is_frozen && !self.lags(&pane.output));
        let is_stale = age.is_some_and(|age| age > STOPPED_MS);
        let stopped = is_stale || !live && facts.stopped.contains(&pane.label) || facts.unreached().is_some();
        // Also one that was hidden or frozen, until its next image.
        let is_old = self.is_picture_stale(&pane.output, live);
        let is_dim = stopped || is_old;
        let painter = ui.painter_at(rect);
        let (message, size, color) = age_label(age, stopped);
        let middle = rect.top() + TITLE / 2.0;
        let font = FontId::proportional(theme::legible(ui.ctx(), size));
        let age = painter.text(pos2(rect.right(), middle), Align2::RIGHT_CENTER, message, font, color);
        // The age stays whole: the title is made smaller where both do not fit.
        let width = age.left() - 8.0 - rect.left();
        let title = fitting(&painter, &title, 16.0, width, theme::text().gamma_multiply(0.85));
        painter.galley(pos2(rect.left(), middle - title.size().y / 2.0), title, theme::text());
        match texture {
            // Numbers that a stage has drawn into an image go with it.
            Some(_) if is_old && !live && pane.packet == "image" && !self.plan.is_source(&pane.output.node) => {
                painter.rect_filled(inner, 0.0, theme::sunk());
                stale_frame(&painter, inner);
                // At the edge, because the image comes back.
                let at = inner.center_top() + vec2(0.0, 6.0);
                painter.text(
                    at,
                    Align2::CENTER_TOP,
                    text!("view-withdrawn"),
                    FontId::proportional(16.0),
                    theme::muted(),
                );
            }
            Some((texture, _)) => {
                if is_zoomed {
                    self.zoom.steer(ui, &response, inner);
                    if response.has_focus() || ui.memory(|m| m.focused().is_none()) {
                        ui.input_mut(|i| self.zoom.steer_by_key(i));
                    }
                }
                let part = if is_zoomed { self.zoom.visible() } else { WHOLE };
                ui.painter().image(texture, inner, part, tint(is_dim));
                if stopped || is_frozen && is_dim {
                    stale_frame(&painter, inner);
                }
            }
            None => {
                no_picture(ui, room, &facts.no_picture(&pane.output.node, stopped));
            }
        }
        response.clicked()
    }

    /// Handles drags, the wheel and keys on a surface; keys work if it has the focus or is `alone`.
    fn turn(&mut self, ui: &Ui, rect: Rect, pane: &Pane, alone: bool) {
        let response = ui.interact(rect, ui.id().with(("turn", &pane.output)), Sense::click_and_drag());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, text!("view-turn", view = pane.title())));
        let viewpoint = self.viewpoints.entry(pane.output.clone()).or_default();
        surface::steer(ui, &response, viewpoint, TURN);
        if response.has_focus() {
            capture_arrows(ui, response.id);
            focus_frame(ui, rect);
        }
        if response.has_focus() || alone && ui.memory(|m| m.focused().is_none()) {
            ui.input_mut(|i| surface::steer_by_key(i, viewpoint));
        }
        let points = ui.ctx().pixels_per_point();
        let size = [rect.width(), rect.height() - TITLE].map(|n| ((n * points) as usize / 16 * 16).clamp(160, 1280));
        viewpoint.size_px = size;
    }

    /// Draws the image being measured, and the measurement.
    fn measured(&mut self, ui: &mut Ui, rect: Rect) {
        let Some((held, output)) = self.measure.picture() else { return };
        let Some((texture, size)) = held.texture(output) else { return };
        let room = Rect::from_min_max(pos2(rect.left(), rect.top() + TITLE), rect.max);
        let inner = fit(room, size);
        let line = Rect::from_min_max(inner.min - vec2(0.0, TITLE), inner.right_top());
        let painter = ui.painter_at(rect);
        let hint = self.measure.hint();
        painter.text(line.left_center(), Align2::LEFT_CENTER, hint, FontId::proportional(18.0), theme::accent());
        image(ui, texture, inner, Color32::WHITE);
        let response = ui.interact(inner, ui.id().with("measure"), Sense::click());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, text!("measure-name")));
        if response.has_focus() {
            capture_arrows(ui, response.id);
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
        let points: Vec<_> = self.measure.points().iter().map(|p| (on_screen(p.at_px), p.position)).collect();
        if let [(a, _), (b, _)] = points[..] {
            painter.line_segment([a, b], Stroke::new(5.0, Color32::from_black_alpha(160)));
            painter.line_segment([a, b], Stroke::new(2.5, theme::accent()));
        }
        for (at, position) in &points {
            let color = if position.is_some() { theme::accent() } else { theme::fault() };
            painter.circle_stroke(*at, 9.0, Stroke::new(5.0, Color32::from_black_alpha(160)));
            painter.circle_stroke(*at, 9.0, Stroke::new(2.5, color));
            painter.circle_filled(*at, 2.0, color);
        }
        self.measure.crosshair().draw(&painter, inner);
        let result = match (self.measure.distance(), self.measure.depth()) {
            (Some(length), _) => Some(length.words()),
            (None, Some(depth)) => Some(depth.depth_words()),
            _ => None,
        };
        if let Some(message) = result {
            // Beside the title, where it covers nothing.
            painter.text(line.right_center(), Align2::RIGHT_CENTER, message, FontId::proportional(26.0), theme::text());
        }
    }
}

/// Text, size in points and colour of a view's age.
fn age_label(age_ms: Option<f64>, has_stopped: bool) -> (String, f32, Color32) {
    match age_ms {
        Some(age) if has_stopped => (text!("view-old", seconds = seconds(age)), 20.0, theme::fault()),
        None if has_stopped => (text!("view-no-new-image").to_owned(), 20.0, theme::fault()),
        Some(age) if age > OLD_MS => (text!("view-old", seconds = seconds(age)), 14.0, theme::warn()),
        // In steps of 10 ms, so that the number does not flicker.
        Some(age) => (format!("{:.0} ms", (age / 10.0).ceil() * 10.0), 14.0, theme::muted()),
        None => (String::new(), 14.0, theme::muted()),
    }
}

/// An age, s, with one digit after the point while it is small.
fn seconds(age_ms: f64) -> String {
    number(age_ms / 1e3, u8::from(age_ms < 9950.0))
}

/// The colour that an image is multiplied with: one that is not live is darkened, so that it is not mistaken for one that is.
pub(super) fn tint(stopped: bool) -> Color32 {
    if stopped { Color32::from_gray(90) } else { Color32::WHITE }
}

/// Draws the frame of an image that is not live.
pub(super) fn stale_frame(painter: &Painter, image: Rect) {
    painter.rect_stroke(image, 0.0, Stroke::new(4.0, theme::fault()), StrokeKind::Inside);
}

/// An image's rectangle with its title.
fn with_title(picture: Rect) -> Rect {
    Rect::from_min_max(picture.min - vec2(0.0, TITLE), picture.max)
}

/// Draws the full reason for a missing image and what to do.
fn no_picture(ui: &mut Ui, room: Rect, why: &NoPicture) {
    ui.painter().rect_filled(room, 4.0, theme::sunk());
    let (why, remedy) = match why {
        NoPicture::Because { why, remedy } => (why.as_str(), *remedy),
        NoPicture::Plain(message) => {
            let font = FontId::proportional(20.0);
            ui.painter().text(room.center(), Align2::CENTER_CENTER, message, font, theme::muted());
            return;
        }
    };
    let width = (room.width() - 48.0).min(NO_PICTURE_WIDTH);
    let inner = Rect::from_center_size(room.center(), vec2(width, room.height() - 32.0));
    let lay = |message: &str, size: f32, color: Color32| {
        let job = LayoutJob::simple(message.to_owned(), FontId::proportional(size), color, width);
        ui.painter().layout_job(job)
    };
    let parts = [
        (text!("no-image"), 26.0, theme::fault(), 12.0),
        (why, 18.0, theme::text(), 20.0),
        (remedy, 18.0, theme::accent(), 0.0),
    ];
    // In a small rectangle the text is made smaller instead of cut off.
    let (mut scale, mut laid) = (1.0, Vec::new());
    while scale > 0.5 {
        laid = parts
            .map(|(message, size, color, gap)| {
                (lay(message, theme::legible(ui.ctx(), size * scale), color), gap * scale, message)
            })
            .to_vec();
        let high: f32 = laid.iter().map(|(galley, gap, _)| galley.size().y + gap).sum();
        if high <= inner.height() {
            break;
        }
        scale -= 0.1;
    }
    let high: f32 = laid.iter().map(|(galley, gap, _)| galley.size().y + gap).sum();
    let mut at = pos2(inner.left(), inner.center().y - (high / 2.0).min(inner.height() / 2.0));
    for (galley, gap, message) in laid {
        let pane = Rect::from_min_size(at, galley.size());
        let response = ui.interact(pane, ui.id().with(("no image", message)), Sense::hover());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, message));
        at.y += galley.size().y + gap;
        ui.painter_at(room).galley(pane.min, galley, theme::text());
    }
}

/// Gives the arrow keys to the focused widget instead of moving the focus.
pub(super) fn capture_arrows(ui: &Ui, id: Id) {
    let filter = EventFilter { horizontal_arrows: true, vertical_arrows: true, ..EventFilter::default() };
    ui.memory_mut(|m| m.set_focus_lock_filter(id, filter));
}

/// All of a picture, for its texture.
const WHOLE: Rect = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));

fn image(ui: &Ui, texture: TextureId, rect: Rect, tint: Color32) {
    ui.painter().image(texture, rect, WHOLE, tint);
}
