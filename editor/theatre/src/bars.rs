//! The top bar with state and notices, and the bottom bar with buttons and settings.

use std::sync::Arc;
use std::time::Instant;

use eframe::egui::text::{LayoutJob, TextWrapping};
use eframe::egui::{
    Align2, Color32, CornerRadius, FontId, Galley, Key, Painter, Pos2, Rect, Sense, Shape, Stroke, StrokeKind, Ui,
    WidgetInfo, WidgetType, pos2, vec2,
};

use super::alarms::Urgency;
use super::arm::{STOP_RED, is_pressed};
use super::notices::{Facts, OLD_MS};
use super::{Action, EDGE, HOLD, Outage, OutageStage, REMARK, Theatre, key_name, settings, time};
use panoscope_editor_model::session::{Phase, Status};
use panoscope_editor_model::texts::{bytes, text};
use panoscope_editor_widgets::theme;

/// Width of a setting.
const SETTING: f32 = 216.0;
/// Distance between two settings.
const SETTING_GAP: f32 = 24.0;
/// Size of the caption of a button.
const BUTTON_TEXT: f32 = 20.0;
/// Size of the letters of states in the bar above.
const CHIP: f32 = 26.0;
/// Height of the upper row, which has the most urgent notice and the states.
const ROW: f32 = 60.0;
/// Size of the letters of the most urgent notice: on a screen of 1080 rows its capitals are 40 px high, which 3 m away are 17 minutes of arc on a
/// monitor of 32 inches.
const HEADLINE: f32 = 52.0;
/// Size of its letters where a longer one is made to fit.
const MIN_HEADLINE: f32 = 26.0;
/// Size of the letters of what stands below it.
const DETAIL: f32 = 20.0;
const MIN_DETAIL: f32 = 14.0;
/// Side of the button that ends the theatre.
const END: f32 = 48.0;
/// Width of the button for the next page of settings.
const MORE: f32 = 84.0;

fn format_clock(since: Instant) -> String {
    let seconds = time::since(since).as_secs();
    format!("{}:{:02}", seconds / 60, seconds % 60)
}

/// A short text on a coloured ground.
pub(super) struct Chip {
    message: String,
    fill: Color32,
    color: Color32,
    /// What it says to a screen reader, where that is more.
    name: Option<String>,
}

impl Chip {
    fn new(message: impl Into<String>, fill: Color32, color: Color32) -> Self {
        Self { message: message.into(), fill, color, name: None }
    }

    /// Draws it in letters of a size; `right` is the middle of its right edge. Returns its rectangle.
    pub(super) fn show(&self, ui: &mut Ui, right: Pos2, letters: f32) -> Rect {
        let font = FontId::proportional(theme::legible(ui.ctx(), letters));
        let text = ui.painter().layout_no_wrap(self.message.clone(), font, self.color);
        let edge = vec2(letters * 0.75, letters * 0.3);
        let size = text.size() + 2.0 * edge;
        let rect = Rect::from_min_size(pos2(right.x - size.x, right.y - size.y / 2.0), size);
        ui.painter().rect_filled(rect, CornerRadius::same(8), self.fill);
        ui.painter().galley(rect.min + edge, text, self.color);
        if let Some(name) = &self.name {
            let response = ui.interact(rect, ui.id().with(("chip", name)), Sense::hover());
            response.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, name));
        }
        rect
    }
}

impl Theatre {
    /// The state of the run and what is recorded, from the right.
    pub(super) fn chips(&self, status: &Status, facts: &Facts) -> Vec<Chip> {
        let state = match (&status.phase, self.frozen) {
            _ if facts.is_dark() => Chip::new(text!("state-restarting"), theme::fault(), theme::BLACK),
            _ if facts.unreached().is_some() => Chip::new(text!("state-unreached"), theme::fault(), theme::BLACK),
            _ if facts.why_dark.is_some() => Chip::new(text!("state-no-picture"), theme::fault(), theme::BLACK),
            (Phase::Starting | Phase::Idle, _) => Chip::new(text!("state-starting"), theme::raised(), theme::muted()),
            (Phase::Ended | Phase::Failed(_), _) => Chip::new(text!("state-stopped"), theme::fault(), theme::BLACK),
            (_, Some(since)) => {
                let message = format!("{}  {}", text!("state-frozen"), format_clock(since));
                Chip::new(message, theme::accent(), theme::BLACK)
            }
            // No image is none that lives, and delayed images must not be called live.
            _ if !facts.has_main => Chip::new(text!("state-starting"), theme::raised(), theme::muted()),
            _ if facts.is_old || !facts.stopped.is_empty() || facts.age_ms.is_some_and(|age| age > OLD_MS) => {
                Chip::new(text!("state-delayed"), theme::warn(), theme::BLACK)
            }
            _ => Chip::new(text!("state-live"), theme::raised(), theme::live()),
        };
        let mut chips = vec![state];
        if let Some(clip) = &self.clip {
            let message = format!("{}  {}", text!("state-recording"), format_clock(clip.since));
            chips.push(Chip::new(message, STOP_RED, Color32::WHITE));
        }
        if let Some(written) = facts.written_bytes {
            // Sizes of files on another machine are not known here.
            let size = if self.machine.is_none() { bytes(written) } else { String::new() };
            let message = format!("{}  {size}", text!("state-recording"));
            let nodes: Vec<&str> = self.plan.written.iter().map(|written| written.node.as_str()).collect();
            let name = text!("state-recording.name", nodes = nodes.join(", "), size = size);
            chips.push(Chip { name: Some(name), ..Chip::new(message.trim_end(), STOP_RED, Color32::WHITE) });
        }
        chips
    }

    pub(super) fn top_bar(&mut self, ui: &mut Ui, bar: Rect, status: &Status, facts: &Facts) {
        let inner = bar.shrink2(vec2(EDGE, 10.0));
        let mut right = self.end_button(ui, pos2(inner.right(), inner.top() + ROW / 2.0)).left() - 14.0;
        // Beside the most urgent notice: what is below it needs the whole width.
        let middle = inner.top() + ROW / 2.0;
        for chip in self.chips(status, facts) {
            right = chip.show(ui, pos2(right, middle), CHIP).left() - 10.0;
        }
        if self.clip.is_some() {
            let free = facts.free_bytes.map(|free| text!("disk-free", size = bytes(free))).unwrap_or_default();
            let font = FontId::proportional(theme::legible(ui.ctx(), 14.0));
            let rect = ui.painter().text(pos2(right, middle), Align2::RIGHT_CENTER, free, font, theme::muted());
            right = rect.left() - 16.0;
        }
        if let Some(mark) = self.verified.mark() {
            right = unverified(ui, pos2(right, middle), mark).left() - 10.0;
        }
        let row = Rect::from_min_max(inner.min, pos2(right - 10.0, inner.top() + ROW));
        self.show_message(ui, row, inner.with_min_y(row.bottom()));
    }

    /// Draws the most urgent notice in `room` with the others in `below`; without notices, the remark or the graph's name.
    fn show_message(&self, ui: &mut Ui, room: Rect, below: Rect) {
        let painter = ui.painter_at(room.union(below).expand(2.0));
        if let Some(since) = self.leaving.filter(|since| time::since(*since) > HOLD / 8) {
            let share = (time::since(since).as_secs_f32() / HOLD.as_secs_f32()).min(1.0);
            let text = FontId::proportional(22.0);
            let message = text!("leave-hold");
            let rect = painter.text(room.left_center(), Align2::LEFT_CENTER, message, text, theme::text());
            let rail = Rect::from_min_size(pos2(rect.right() + 20.0, rect.center().y - 3.0), vec2(160.0, 6.0));
            painter.rect_filled(rail, 3.0, theme::raised());
            let done = Rect::from_min_size(rail.min, vec2(rail.width() * share, rail.height()));
            painter.rect_filled(done, 3.0, theme::accent());
            return;
        }
        let label = |message: &str| WidgetInfo::labeled(WidgetType::Label, true, message.to_owned());
        for (k, notice) in self.notices.iter().enumerate() {
            let response = ui.interact(room, ui.id().with(("notice", k)), Sense::hover());
            response.widget_info(|| label(&text!("notice-name", notice = &notice.message)));
            let action = notice.action;
            ui.ctx().accesskit_node_builder(response.id, |node| {
                node.set_description(text!("notice-action", action = action))
            });
        }
        let remark = self.remark.as_ref().filter(|(.., at)| time::since(*at) < REMARK);
        if let Some((message, ..)) = remark {
            let response = ui.interact(room, ui.id().with("remark"), Sense::hover());
            response.widget_info(|| label(&text!("remark-name", remark = message)));
        }
        let Some(first) = self.notices.first() else {
            let (message, color) = match remark {
                Some((message, wrong, _)) => (message.clone(), if *wrong { theme::warn() } else { theme::text() }),
                None => (self.plan.name.clone(), theme::muted()),
            };
            let galley = line(&painter, &message, [26.0, MIN_DETAIL], room.width(), color);
            painter.galley(pos2(room.left(), room.center().y - galley.size().y / 2.0), galley, color);
            return;
        };
        let color = match first.urgency {
            Urgency::Alarm => theme::fault(),
            Urgency::Warning => theme::warn(),
            Urgency::Note => theme::muted(),
        };
        // A sign and the font size show the urgency without relying on colour.
        let is_note = first.urgency == Urgency::Note;
        let middle = room.center().y;
        if !is_note {
            sign(&painter, pos2(room.left() + 24.0, middle), 24.0, color);
        }
        let (headline, detail) = first.parts();
        let others = self.notices.iter().skip(1).map(|n| n.message.as_str());
        let said = remark.iter().map(|(message, ..)| message.as_str()).chain(others);
        let rest: Vec<&str> = std::iter::once(detail).filter(|detail| !detail.is_empty()).chain(said).collect();
        let left = room.left() + if is_note { 0.0 } else { 66.0 };
        let sizes = if is_note { [DETAIL + 2.0, DETAIL] } else { [HEADLINE, MIN_HEADLINE] };
        let galley = line(&painter, headline, sizes, (room.right() - left).max(40.0), color);
        painter.galley(pos2(left, middle - galley.size().y / 2.0), galley, color);
        let color = theme::text().gamma_multiply(0.8);
        let rest_of = |rest: &[&str]| {
            line(&painter, &rest.join("   ·   "), [DETAIL, MIN_DETAIL], (below.right() - left).max(40.0), color)
        };
        let mut galley = rest_of(&rest);
        // What to do, where there is room for it.
        let action = text!("notice-action", action = first.action);
        let with_action = rest_of(&[&rest[..], &[&action]].concat());
        if !with_action.elided {
            galley = with_action;
        }
        painter.galley(pos2(left, below.center().y - galley.size().y / 2.0), galley, color);
    }

    /// The button that ends the theatre when it is held, for touch. `right` is the middle of its right edge; returns its rectangle.
    fn end_button(&mut self, ui: &mut Ui, right: Pos2) -> Rect {
        let rect = Rect::from_min_size(pos2(right.x - END, right.y - END / 2.0), vec2(END, END));
        let response = ui.interact(rect, ui.id().with("end"), Sense::click_and_drag());
        response.widget_info(|| WidgetInfo::labeled(WidgetType::Button, true, text!("leave-name")));
        let by_key = response.has_focus() && ui.input(|i| i.key_down(Key::Space) || i.key_down(Key::Enter));
        self.end_held = is_pressed(&response) || by_key;
        let edge = if response.has_focus() { theme::accent() } else { Color32::TRANSPARENT };
        let painter = ui.painter();
        painter.rect(rect, 8.0, theme::raised(), Stroke::new(2.0, edge), StrokeKind::Inside);
        let (c, arm) = (rect.center(), END * 0.18);
        for across in [vec2(arm, arm), vec2(arm, -arm)] {
            painter.line_segment([c - across, c + across], Stroke::new(3.0, theme::muted()));
        }
        rect
    }

    pub(super) fn bottom_bar(&mut self, ui: &mut Ui, bar: Rect) {
        let inner = bar.shrink2(vec2(EDGE, 16.0));
        let mut left = inner.left();
        let mut right = inner.right();
        if !self.plan.stops.is_empty() {
            let width = 230.0;
            let rect = Rect::from_min_max(pos2(right - width, inner.top()), inner.max);
            self.stop_button(ui, rect);
            right = rect.left() - 24.0;
        }
        let is_waiting = matches!(self.runner.outage(), Some(Outage { stage: OutageStage::Cameras(_), .. }));
        let is_here = self.machine.is_none();
        let over = is_waiting
            || self.raw_only.is_some()
            || matches!(self.runner.status().phase, Phase::Ended | Phase::Failed(_));
        let frozen = self.frozen.is_some() && !self.measure.is_on();
        let whole = !self.shows_raw();
        let buttons = [
            (Action::Next, text!("button-layout"), false, whole && self.plan.views.len() > 1),
            (Action::Freeze, if frozen { text!("button-continue") } else { text!("button-freeze") }, frozen, whole),
            (Action::Still, text!("button-still"), false, true),
            (
                Action::Record,
                if self.clip.is_some() { text!("button-end-clip") } else { text!("button-record") },
                self.clip.is_some(),
                whole && is_here,
            ),
            (Action::Measure, text!("button-measure"), self.measure.is_on(), whole && self.plan.cloud.is_some()),
            (Action::Again, text!("button-again"), true, over && is_here),
        ];
        for (action, caption, on, there) in buttons {
            if !there {
                continue;
            }
            let width = button_width(ui, caption);
            let rect = Rect::from_min_size(pos2(left, inner.top()), vec2(width, inner.height()));
            if button(ui, rect, caption, key_name(action), on) {
                self.perform(action);
            }
            left = rect.right() + 10.0;
        }
        self.settings(ui, Rect::from_min_max(pos2(left + 14.0, inner.top()), pos2(right, inner.bottom())));
    }

    /// Draws the pinned settings; when there is no room for all, with a button for the next page.
    fn settings(&mut self, ui: &mut Ui, room: Rect) {
        // While only the sources run, there is nothing to set.
        let settings = if self.shows_raw() { Vec::new() } else { self.plan.settings.clone() };
        let across = |width: f32| (((width + SETTING_GAP) / (SETTING + SETTING_GAP)).max(0.0) as usize).max(1);
        let mut room = room;
        let mut fit = across(room.width());
        if settings.len() > fit {
            let rect = Rect::from_min_max(pos2(room.right() - MORE, room.top()), room.max);
            room.max.x = rect.left() - SETTING_GAP;
            fit = across(room.width());
            let pages = settings.len().div_ceil(fit);
            self.page %= pages;
            let caption = text!("button-page", page = self.page + 1, pages = pages);
            if button_named(ui, rect, text!("button-more"), &caption, key_name(Action::More), false) {
                self.perform(Action::More);
            }
        } else {
            self.page = 0;
        }
        let shown = settings.iter().skip(self.page * fit).take(fit);
        // A single one is narrower where the window has less room.
        let width = SETTING.min(room.width());
        let mut at = room.right() - shown.len() as f32 * (width + SETTING_GAP) + SETTING_GAP;
        for setting in shown {
            let rect = Rect::from_min_size(pos2(at, room.top() + 4.0), vec2(width, room.height() - 8.0));
            let value = self.value(setting);
            if let Some(new) = settings::show(ui, rect, setting, value.as_ref()) {
                self.choose(&setting.node, &setting.param.name, new);
            }
            at = rect.right() + SETTING_GAP;
        }
    }
}

/// A text on one line, in letters as large as fit in `width` and of a size from `max` to `min`; cut where even the smallest do not.
pub(super) fn line(painter: &Painter, message: &str, [max, min]: [f32; 2], width: f32, color: Color32) -> Arc<Galley> {
    let message = message.lines().next().unwrap_or_default();
    let lay = |size: f32| {
        let font = FontId::proportional(theme::legible(painter.ctx(), size));
        let mut job = LayoutJob::simple_singleline(message.to_owned(), font, color);
        job.wrap = TextWrapping::truncate_at_width(if size > min { f32::INFINITY } else { width });
        painter.layout_job(job)
    };
    let galley = lay(max);
    let wide = galley.size().x;
    if wide <= width {
        return galley;
    }
    // Widths are not quite proportional to sizes, because letters stand on whole pixels.
    let size = max * width / wide * 0.98;
    if size <= min { lay(min) } else { lay(size) }
}

/// Draws the mark of an unverified graph, which is visible as long as it runs. `right` is the middle of its right edge; returns its rectangle.
fn unverified(ui: &mut Ui, right: Pos2, [heading, line, name]: [&str; 3]) -> Rect {
    let painter = ui.painter();
    let font = |size: f32| FontId::proportional(theme::legible(ui.ctx(), size));
    let heading_text = painter.layout_no_wrap(heading.to_owned(), font(22.0), theme::warn());
    let line_text = painter.layout_no_wrap(line.to_owned(), font(14.0), theme::text());
    let text = vec2(heading_text.size().x.max(line_text.size().x), heading_text.size().y + line_text.size().y);
    let size = text + vec2(28.0, 8.0);
    let rect = Rect::from_min_size(pos2(right.x - size.x, right.y - size.y / 2.0), size);
    painter.rect_stroke(rect, CornerRadius::same(8), Stroke::new(1.5, theme::warn()), StrokeKind::Inside);
    let at = rect.min + vec2(14.0, 4.0);
    let below = at + vec2(0.0, heading_text.size().y);
    painter.galley(at, heading_text, theme::warn());
    painter.galley(below, line_text, theme::text());
    let response = ui.interact(rect, ui.id().with("verified"), Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, name));
    rect
}

/// Width of a button with this caption: one of two, or what a longer caption needs.
fn button_width(ui: &Ui, caption: &str) -> f32 {
    let font = FontId::proportional(BUTTON_TEXT);
    let needed = ui.painter().layout_no_wrap(caption.to_owned(), font, Color32::WHITE).size().x + 28.0;
    [108.0, 132.0].into_iter().find(|width| *width >= needed).unwrap_or(needed.ceil())
}

/// Draws a large button with its key below its caption; returns whether it was clicked.
fn button(ui: &mut Ui, rect: Rect, caption: &str, key: &str, on: bool) -> bool {
    button_named(ui, rect, caption, caption, key, on)
}

/// As [`button`], with an accessible name that differs from the caption.
fn button_named(ui: &mut Ui, rect: Rect, name: &str, caption: &str, key: &str, on: bool) -> bool {
    let response = ui.interact(rect, ui.id().with(("button", key)), Sense::click());
    response.widget_info(|| WidgetInfo::selected(WidgetType::Button, true, on, name.to_owned()));
    let fill = match () {
        () if on => theme::accent().gamma_multiply(0.32),
        () if response.is_pointer_button_down_on() => theme::line(),
        () if response.hovered() => theme::raised().gamma_multiply(1.25),
        () => theme::raised(),
    };
    let edge = if response.has_focus() || on { theme::accent() } else { Color32::TRANSPARENT };
    let painter = ui.painter();
    painter.rect(rect, 12.0, fill, Stroke::new(2.0, edge), StrokeKind::Inside);
    let c = rect.center();
    painter.text(c - vec2(0.0, 9.0), Align2::CENTER_CENTER, caption, FontId::proportional(BUTTON_TEXT), theme::text());
    painter.text(
        c + vec2(0.0, 17.0),
        Align2::CENTER_CENTER,
        key,
        FontId::proportional(theme::legible(ui.ctx(), 13.0)),
        theme::muted(),
    );
    response.clicked()
}

/// Draws a warning sign.
pub(super) fn sign(painter: &Painter, at: Pos2, size: f32, color: Color32) {
    let corners = vec![at + vec2(0.0, -size), at + vec2(size, size * 0.8), at + vec2(-size, size * 0.8)];
    painter.add(Shape::convex_polygon(corners, color, Stroke::NONE));
    let bar = Stroke::new(size * 0.22, theme::BLACK);
    painter.line_segment([at + vec2(0.0, -size * 0.4), at + vec2(0.0, size * 0.25)], bar);
    painter.circle_filled(at + vec2(0.0, size * 0.52), size * 0.13, theme::BLACK);
}
