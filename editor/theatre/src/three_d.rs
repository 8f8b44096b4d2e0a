//! The stereo pair for 3-D displays: side by side, top and bottom, or in alternate rows. Both images are always of one instant.
//!
//! The notices, states and marks, and the stop of an arm, are drawn for both eyes at the same place, above and below the images.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use eframe::egui::{
    Align2, Color32, ColorImage, Context, FontId, Rect, Sense, TextureHandle, TextureOptions, Ui, Vec2, WidgetInfo,
    WidgetType, pos2, vec2,
};
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::session::Status;
use panoscope_editor_model::texts::text;
use panoscope_editor_widgets::{image_of, theme};

use super::alarms::Urgency;
use super::arrange::fit;
use super::bars;
use super::notices::{Facts, STOPPED};
use super::stage::{stale_frame, tint};
use super::{Theatre, time};

/// Height of the line of text above each image as it is seen, points.
const LINE: f32 = 76.0;
/// Size of the letters of the most urgent notice as it is seen.
const LETTERS: f32 = 52.0;
/// Height of the stop of an arm below each image as it is seen, points.
const STOP: f32 = 84.0;

/// How a pair is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ThreeD {
    /// Not at all: the usual views.
    #[default]
    Off,
    /// The left eye in the left half of the screen, each image half as wide.
    SideBySide,
    /// The left eye in the upper half of the screen, each image half as high.
    TopBottom,
    /// The left eye in the even rows of the screen, counted from 0 at the top.
    Rows,
}

impl ThreeD {
    /// The next one.
    pub fn next(self) -> Self {
        match self {
            Self::Off => Self::SideBySide,
            Self::SideBySide => Self::TopBottom,
            Self::TopBottom => Self::Rows,
            Self::Rows => Self::Off,
        }
    }

    /// Its name.
    pub fn words(self) -> &'static str {
        match self {
            Self::Off => text!("three-d-off"),
            Self::SideBySide => text!("three-d-side-by-side"),
            Self::TopBottom => text!("three-d-top-bottom"),
            Self::Rows => text!("three-d-rows"),
        }
    }

    /// The parts of the screen for the left and the right eye.
    fn halves(self, whole: Rect) -> [Rect; 2] {
        let middle = whole.center();
        match self {
            Self::SideBySide => [whole.with_max_x(middle.x), whole.with_min_x(middle.x)],
            Self::TopBottom => [whole.with_max_y(middle.y), whole.with_min_y(middle.y)],
            Self::Off | Self::Rows => [whole, whole],
        }
    }

    /// How much the display stretches each part.
    fn stretch(self) -> Vec2 {
        match self {
            Self::SideBySide => vec2(2.0, 1.0),
            Self::TopBottom => vec2(1.0, 2.0),
            Self::Off | Self::Rows => vec2(1.0, 1.0),
        }
    }
}

/// One eye's image and when its light arrived, until that of the other eye has come.
type Waiting = (u32, u64, Pixels, Option<i64>);

/// The newest pair of one instant.
#[derive(Default)]
pub(super) struct Pair {
    waiting: [Option<Waiting>; 2],
    /// The images of both eyes, and the number of their tick.
    shown: Option<([Pixels; 2], u64)>,
    /// When the oldest light of the shown pair arrived.
    paired: Option<Instant>,
    /// Incremented with every new pair.
    count: u64,
    textures: Option<([TextureHandle; 2], u64)>,
    rows: Option<(TextureHandle, (u64, Rect))>,
}

impl Pair {
    /// Takes the images of both eyes; they are shown once both are of one tick. `arrived_ns` is when the light of an output's image arrived, also
    /// where its camera repeats an old one.
    pub fn take(
        &mut self,
        outputs: &[Output; 2],
        previews: &HashMap<Output, RenderedPacket>,
        arrived_ns: impl Fn(&Output) -> Option<i64>,
    ) {
        for (waiting, output) in self.waiting.iter_mut().zip(outputs) {
            if let Some(packet) = previews.get(output)
                && let Some(pixels) = &packet.pixels
            {
                *waiting = Some((packet.tick.source, packet.tick.seq, pixels.clone(), arrived_ns(output)));
            }
        }
        if let [Some((source, seq, ..)), Some((other_source, other_seq, ..))] = &self.waiting
            && (source, seq) == (other_source, other_seq)
            && let [Some((_, seq, left, left_ns)), Some((_, _, right, right_ns))] = std::mem::take(&mut self.waiting)
        {
            self.shown = Some(([left, right], seq));
            self.paired = Some(time::instant_of(left_ns.into_iter().chain(right_ns).min()));
            self.count += 1;
        }
    }

    /// Number of the tick of the shown pair.
    pub fn tick(&self) -> Option<u64> {
        self.shown.as_ref().map(|(_, seq)| *seq)
    }

    /// Time since the oldest light of the shown pair arrived.
    pub fn age(&self) -> Option<Duration> {
        self.paired.map(time::since)
    }

    /// Size of an image, px.
    fn size(&self) -> Option<Vec2> {
        self.shown.as_ref().map(|([left, _], _)| vec2(left.width as f32, left.height as f32))
    }

    fn textures(&mut self, ctx: &Context) -> Option<&[TextureHandle; 2]> {
        let (pixels, _) = self.shown.as_ref()?;
        if self.textures.as_ref().is_none_or(|(_, count)| *count != self.count) {
            let load = |k: usize| ctx.load_texture("eye", image_of(&pixels[k]), TextureOptions::LINEAR);
            self.textures = Some(([load(0), load(1)], self.count));
        }
        self.textures.as_ref().map(|(textures, _)| textures)
    }

    /// The picture of alternate rows for a part of the screen, in px of the screen.
    fn rows(&mut self, ctx: &Context, place_px: Rect) -> Option<&TextureHandle> {
        let ([left, right], _) = self.shown.as_ref()?;
        let key = (self.count, place_px);
        if self.rows.as_ref().is_none_or(|(_, known)| *known != key) {
            let size = [place_px.width() as usize, place_px.height() as usize];
            let image = interleaved(left, right, size, place_px.top() as usize);
            self.rows = Some((ctx.load_texture("rows", image, TextureOptions::NEAREST), key));
        }
        self.rows.as_ref().map(|(texture, _)| texture)
    }
}

/// A picture whose rows are of the left and the right image in turn. `top` is the row of the screen where it begins: even rows of the screen are
/// the left eye's.
fn interleaved(left: &Pixels, right: &Pixels, [width, height]: [usize; 2], top: usize) -> ColorImage {
    let mut colors = Vec::with_capacity(width * height);
    for y in 0..height {
        let eye = if (top + y).is_multiple_of(2) { left } else { right };
        let row = y * eye.height / height.max(1) * eye.width;
        colors.extend((0..width).map(|x| {
            let at = (row + x * eye.width / width.max(1)) * 4;
            eye.rgba.get(at..at + 3).map_or(Color32::BLACK, |p| Color32::from_rgb(p[0], p[1], p[2]))
        }));
    }
    ColorImage::new([width, height], colors)
}

impl Theatre {
    /// How the stereo pair is shown.
    pub fn three_d(&self) -> ThreeD {
        self.three_d
    }

    /// Number of the tick of the shown stereo pair.
    pub fn pair_tick(&self) -> Option<u64> {
        self.pair.tick()
    }

    /// Whether the pair can be shown now: the graph has one, and it runs.
    pub(super) fn has_pair(&self) -> bool {
        self.plan.pair.as_ref().is_some_and(|[left, _]| !self.shows_raw() || self.plan.is_source(&left.node))
    }

    /// Whether the pair is shown instead of the views.
    pub(super) fn shows_pair(&self) -> bool {
        self.three_d != ThreeD::Off && self.has_pair() && !self.measure.is_on() && !self.checking
    }

    /// Switches to the next way of showing the pair.
    pub(super) fn next_three_d(&mut self) {
        if !self.has_pair() {
            return self.notify(text!("three-d-none"), true);
        }
        self.three_d = self.three_d.next();
        self.pair = Pair::default();
        self.notify(self.three_d.words(), false);
    }

    /// Draws the pair on the whole screen.
    pub(super) fn show_pair(&mut self, ui: &mut Ui, whole: Rect, status: &Status, facts: &Facts) {
        let three_d = self.three_d;
        ui.painter().rect_filled(whole, 0.0, theme::BLACK);
        let stretch = three_d.stretch();
        let has_arm = !self.plan.stops.is_empty();
        let place = |half: Rect| {
            let below = if has_arm { STOP / stretch.y } else { 0.0 };
            Rect::from_min_max(half.min + vec2(0.0, LINE / stretch.y), half.max - vec2(0.0, below))
        };
        let size = self.pair.size().unwrap_or(vec2(4.0, 3.0));
        // As it will be seen, then pressed together.
        let pressed = |room: Rect| {
            let seen = fit(Rect::from_min_size(room.min, room.size() * stretch), size);
            Rect::from_center_size(room.center(), seen.size() / stretch)
        };
        let halves = three_d.halves(whole);
        let images = halves.map(|half| pressed(place(half)));
        let uv = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        let eyes_are_stale = self.plan.pair.iter().flatten().any(|eye| self.is_picture_stale(eye, false));
        // Images of two instants are no pair: then an older one is shown although both eyes deliver.
        let frozen_for = self.frozen.map_or(Duration::ZERO, time::since);
        let pair_is_stale = self.pair.age().is_some_and(|age| age > STOPPED + frozen_for);
        let is_unreached = facts.unreached().is_some() && self.frozen.is_none();
        let is_stale = eyes_are_stale || pair_is_stale || is_unreached;
        let tint = tint(is_stale);
        if three_d == ThreeD::Rows {
            // On whole rows of the screen.
            let points = ui.ctx().pixels_per_point();
            let px = |at: f32| (at * points).round();
            let image = images[0];
            let place_px = Rect::from_min_max(
                pos2(px(image.left()), px(image.top())),
                pos2(px(image.right()), px(image.bottom())),
            );
            if let Some(texture) = self.pair.rows(&ui.ctx().clone(), place_px) {
                let id = texture.id();
                ui.painter().image(id, place_px / points, uv, tint);
            }
        } else if let Some(textures) = self.pair.textures(&ui.ctx().clone()) {
            let ids = textures.each_ref().map(TextureHandle::id);
            for (id, image) in ids.into_iter().zip(images) {
                ui.painter().image(id, image, uv, tint);
            }
        }
        if is_stale {
            let painter = ui.painter();
            images.iter().for_each(|image| stale_frame(painter, *image));
        }
        let eyes = match three_d {
            ThreeD::Rows => vec![text!("eye-both")],
            _ => vec![text!("eye-left"), text!("eye-right")],
        };
        for (eye, (half, image)) in eyes.iter().zip(halves.into_iter().zip(images)) {
            ui.push_id(eye, |ui| {
                let response = ui.interact(image, ui.id().with("eye"), Sense::hover());
                let name = text!("eye-name", eye = *eye, way = three_d.words());
                response.widget_info(|| WidgetInfo::labeled(WidgetType::Image, true, name.clone()));
                self.line_of_pair(ui, half.with_max_y(half.top() + LINE / stretch.y), status, facts);
                if has_arm {
                    // A low one is wide: its texts are beside each other.
                    let size = vec2(230.0 * stretch.y, STOP / stretch.y - 12.0).min(vec2(half.width() - 24.0, STOP));
                    let at = half.right_bottom() - size - vec2(12.0, 6.0);
                    self.stop_button(ui, Rect::from_min_size(at, size));
                }
            });
        }
    }

    /// Draws the most urgent notice or the age of the pair, and the marks and states that the bar above the views has.
    fn line_of_pair(&self, ui: &mut Ui, room: Rect, status: &Status, facts: &Facts) {
        let stretch = self.three_d.stretch();
        let inner = room.shrink2(vec2(16.0, 0.0));
        let (mut right, middle) = (inner.right(), inner.center().y);
        for chip in self.chips(status, facts) {
            right = chip.show(ui, pos2(right, middle), LETTERS / 2.0 / stretch.y).left() - 8.0;
        }
        if let Some([mark, _, name]) = self.verified.mark() {
            let font = FontId::proportional(theme::legible(ui.ctx(), LETTERS / 2.5 / stretch.y));
            let rect = ui.painter().text(pos2(right, middle), Align2::RIGHT_CENTER, mark, font, theme::warn());
            let response = ui.interact(rect, ui.id().with("verified"), Sense::hover());
            response.widget_info(|| WidgetInfo::labeled(WidgetType::Label, true, name));
            right = rect.left() - 16.0;
        }
        let age = facts
            .age_ms
            .map_or_else(|| text!("eye-no-image").to_owned(), |age| format!("{:.0} ms", (age / 10.0).ceil() * 10.0));
        let notice = self.notices.first().filter(|notice| notice.urgency != Urgency::Note);
        let (message, letters, color) = match notice {
            Some(notice) if notice.urgency == Urgency::Alarm => (notice.parts().0, LETTERS, theme::fault()),
            Some(notice) => (notice.parts().0, LETTERS, theme::warn()),
            None if self.frozen.is_some() => ("", LETTERS, theme::muted()),
            None => (age.as_str(), LETTERS / 2.0, theme::muted()),
        };
        let letters = letters / stretch.y;
        let width = (right - inner.left()).max(40.0);
        let galley = bars::line(ui.painter(), message, [letters, letters / 3.0], width, color);
        ui.painter().galley(pos2(inner.left(), middle - galley.size().y / 2.0), galley, color);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_abi::Tick;

    fn packet(seq: u64, value: u8) -> RenderedPacket {
        let pixels = Pixels { width: 2, height: 2, rgba: [value, value, value, 255].repeat(4) };
        let tick = Tick { source: 3, flags: 0, seq, capture_ns: 0 };
        RenderedPacket { pixels: Some(pixels), tick, ..RenderedPacket::default() }
    }

    #[test]
    fn only_images_of_one_instant_are_a_pair() {
        let eyes = ["left", "right"].map(|port| Output::new("scope", port));
        let [left, right] = eyes.clone();
        let mut pair = Pair::default();
        let take = |pair: &mut Pair, previews| pair.take(&eyes, &previews, |_| None);
        take(&mut pair, HashMap::from([(left.clone(), packet(4, 10)), (right.clone(), packet(3, 20))]));
        assert_eq!(pair.tick(), None);
        take(&mut pair, HashMap::from([(right.clone(), packet(4, 20))]));
        assert_eq!(pair.tick(), Some(4));
        take(&mut pair, HashMap::from([(left, packet(5, 10))]));
        assert_eq!(pair.tick(), Some(4), "it stays until both have come");
        take(&mut pair, HashMap::from([(right, packet(5, 20))]));
        assert_eq!(pair.tick(), Some(5));
        let (pixels, _) = pair.shown.expect("a pair");
        assert_eq!((pixels[0].rgba[0], pixels[1].rgba[0]), (10, 20));
    }

    #[test]
    fn even_rows_of_the_screen_are_the_left_eyes() {
        let eye = |value: u8| Pixels { width: 2, height: 2, rgba: [value, value, value, 255].repeat(4) };
        for top in [0, 1, 7] {
            let image = interleaved(&eye(10), &eye(20), [3, 4], top);
            for y in 0..4 {
                let expected = if (top + y) % 2 == 0 { 10 } else { 20 };
                assert!((0..3).all(|x| image[(x, y)] == Color32::from_gray(expected)), "row {y} below {top}");
            }
        }
    }

    #[test]
    fn halves_have_one_size_and_images_their_proportions_when_stretched() {
        let whole = Rect::from_min_size(pos2(0.0, 0.0), vec2(1920.0, 1080.0));
        for three_d in [ThreeD::SideBySide, ThreeD::TopBottom] {
            let [a, b] = three_d.halves(whole);
            assert_eq!(a.size(), b.size());
            assert_eq!(a.size() * three_d.stretch(), whole.size());
        }
        let mut three_d = ThreeD::Off;
        for _ in 0..4 {
            three_d = three_d.next();
        }
        assert_eq!(three_d, ThreeD::Off);
    }
}
