//! The mosaic: one frame after the other.

use super::adjust::Adjust;
use super::canvas::{Canvas, Source};
use super::coverage::own_area;
use super::graph::{Edge, Graph, MAX_PAIRS};
use super::keyframe::{Keyframe, index_of};
use super::outline::{Outline, distance, union};
use super::params::*;
use super::picture::Picture;
use super::rim::{Lit, Rim};
use super::shown;
use super::track::{Link, Test, Tracker};
use crate::features::{Features, Surf};
use crate::geometry::Homography;
use crate::{Parallel, View, ViewMut, draw};

/// Other keyframes that a frame is compared with when it does not match the expected one.
const TRIES: usize = 3;
/// Minimum additional overlap of a keyframe before it replaces the one in use.
const HANDOVER: f64 = 0.08;
/// Cool-down after a rejected handover, frames.
const REFUSED_FRAMES: u32 = 5;
/// Number of neighbours, and of keyframes of earlier passes, that a new keyframe is compared with.
const NEIGHBOURS: usize = 2;
const EARLIER: usize = 3;
/// Search radius for earlier keyframes: the first factor times a frame's side plus the second share of the loop's
/// length.
const SEARCH: (f64, f64) = (0.9, 0.05);
/// Maximum movement of the newest keyframe by a loop: the first factor times a frame's side plus the second share of
/// the loop's length.
const BELIEVED: (f64, f64) = (0.4, 0.15);
/// Number of newest keyframes against which frames are registered without loop closure.
const NEWEST: usize = 2;
/// Minimum and maximum area of a frame in the mosaic, in frames.
const AREAS: (f64, f64) = (0.05, 20.0);
/// Error above which neighbours of a new keyframe are adjusted, in pixels.
const SETTLE_PX: f64 = 0.5;

/// A frame with fewer inliers than this multiple of the minimum becomes a keyframe early, before the camera may be
/// lost.
const WEAK_INLIERS: usize = 3;
const WEAK_OVERLAP: f64 = 0.9;

const LIVE: draw::Color = [240, 240, 240];
const RED: draw::Color = [40, 40, 230];

/// A mosaic that grows with the frames of one moving camera.
///
/// Nothing is allocated per frame once `max_keyframes` are held, but for a graph of overlaps that is denser than usual.
#[derive(Clone, Debug)]
pub struct Mosaic {
    params: MosaicParams,
    size: (usize, usize),
    surf: Surf,
    features: Features,
    live: Picture,
    rim: Rim,
    live_gain: [f32; 3],
    keyframes: Vec<Keyframe>,
    graph: Graph,
    adjust: Adjust,
    tracker: Tracker,
    canvas: Canvas,
    is_shown: bool,
    /// Whether all edges agree with the positions.
    is_settled: bool,
    /// Keyframe that the newest frame was registered to.
    active: u64,
    next_id: u64,
    /// Next keyframe to compare a lost frame with.
    cursor: usize,
    /// Keyframe whose handover was rejected, and frames until the next attempt.
    refused: (u64, u32),
    near: Vec<(f64, u64)>,
    outline: Option<Outline>,
    /// Corners of the drawn border of the newest frame.
    border: Vec<(f32, f32)>,
    report: MosaicReport,
}

impl Mosaic {
    /// An empty mosaic.
    pub fn new(params: MosaicParams) -> Self {
        let mut tracker = Tracker::default();
        tracker.reserve(params.surf.max_points);
        Self {
            params,
            size: (0, 0),
            surf: Surf::new(params.surf),
            features: Features::default(),
            live: Picture::default(),
            rim: Rim::default(),
            live_gain: [1.0; 3],
            keyframes: Vec::with_capacity(params.max_keyframes),
            graph: Graph::default(),
            adjust: Adjust::default(),
            tracker,
            canvas: Canvas::new(params.width, params.height),
            is_shown: false,
            is_settled: true,
            active: 0,
            next_id: 0,
            cursor: 0,
            refused: (0, 0),
            near: Vec::with_capacity(params.max_keyframes),
            outline: None,
            border: Vec::new(),
            report: MosaicReport { drift_px: f64::NAN, drift_pct: f64::NAN, ..MosaicReport::default() },
        }
    }

    /// The parameters that were last set.
    pub fn params(&self) -> &MosaicParams {
        &self.params
    }

    /// Changes the parameters and keeps the mosaic; with fewer keyframes allowed than held, the oldest are dropped.
    pub fn set_params(&mut self, params: MosaicParams, pool: &dyn Parallel) {
        let is_resized = (params.width, params.height) != (self.params.width, self.params.height);
        let is_aimed = (params.view, params.zoom) == (self.params.view, self.params.zoom);
        self.params = params;
        self.surf.set_params(params.surf);
        if is_resized {
            self.canvas = Canvas::new(params.width, params.height);
        }
        self.is_shown &= is_aimed && !is_resized;
        while self.keyframes.len() > params.max_keyframes.max(1) {
            self.drop_oldest(pool);
        }
    }

    /// Clears everything except the parameters.
    pub fn reset(&mut self) {
        let whole = self.canvas.whole();
        self.canvas.clear(whole);
        self.keyframes.clear();
        self.rim.forget();
        self.graph = Graph::default();
        (self.is_shown, self.is_settled) = (false, true);
        self.outline = None;
        self.report = MosaicReport { drift_px: f64::NAN, drift_pct: f64::NAN, ..MosaicReport::default() };
    }

    /// Maps each keyframe's pixels to the mosaic, oldest first.
    pub fn poses(&self) -> impl Iterator<Item = Homography> + '_ {
        self.keyframes.iter().map(|keyframe| keyframe.mosaic_from_frame)
    }

    /// Registers a BGR frame and adds its new parts.
    ///
    /// A frame without a position is a state in the report, not an error, and changes only counters.
    ///
    /// # Errors
    /// A frame that is not BGR, too small, or of another size than the keyframes.
    pub fn add(&mut self, frame: View<'_, u8>, pool: &dyn Parallel) -> Result<MosaicReport, MosaicError> {
        let (width, height) = (frame.width, frame.height);
        if frame.channels != 3 {
            return Err(MosaicError::Channels { channels: frame.channels });
        }
        if width < MIN_SIDE_PX || height < MIN_SIDE_PX {
            return Err(MosaicError::TooSmall { width, height });
        }
        if !self.keyframes.is_empty() && (width, height) != self.size {
            let (want_width, want_height) = self.size;
            return Err(MosaicError::SizeChanged { width, height, want_width, want_height });
        }
        self.size = (width, height);
        self.live.fill(frame, pool);
        if self.rim.look(frame) && self.is_shown {
            self.redraw(pool);
        }
        self.surf.detect_and_describe(frame, None, self.params.shrink, pool, &mut self.features);
        self.rim.clean(&mut self.features);
        self.refused.1 = self.refused.1.saturating_sub(1);
        let is_registered = if self.keyframes.is_empty() { self.begin(pool) } else { self.register_frame(pool) };
        if !is_registered {
            self.report.state = MosaicState::Lost;
            (self.report.inliers, self.report.rms_px) = (0, 0.0);
            self.report.lost_frames += 1;
            self.outline = None;
        }
        self.report.keyframes = self.keyframes.len();
        self.aim(pool);
        Ok(self.report)
    }

    /// Draws the mosaic: black where nothing was seen.
    ///
    /// # Errors
    /// A view that is not BGR of the size in the parameters.
    pub fn draw(&mut self, out: &mut ViewMut<'_, u8>, pool: &dyn Parallel) -> Result<(), MosaicError> {
        let (want_width, want_height) = (self.params.width, self.params.height);
        if (out.width, out.height, out.channels) != (want_width, want_height, 3) {
            let (width, height, channels) = (out.width, out.height, out.channels);
            return Err(MosaicError::WrongPicture { width, height, channels, want_width, want_height });
        }
        self.canvas.copy(out);
        let unit = (want_width.min(want_height) as f32 / 120.0).clamp(2.0, 12.0);
        match self.outline.filter(|_| self.params.live) {
            Some(outline) => {
                let (mosaic_from_frame, gain) = (self.report.mosaic_from_frame, self.live_gain);
                let lit = self.rim.lit();
                let source = Source { picture: &self.live, mosaic_from_frame, size: self.size, gain, lit };
                self.canvas.draw_over(&source, out, pool);
                let corner = |p| {
                    let [x, y] = self.canvas.picture_from_mosaic.map(p);
                    (x as f32, y as f32)
                };
                self.border.clear();
                match lit.map(Lit::border) {
                    Some(border) => self.border.extend(border.iter().map(|p| corner(mosaic_from_frame.map(*p)))),
                    None => self.border.extend(outline.corners.map(corner)),
                }
                draw::polygon(out, &self.border, (unit * 0.25).max(1.0), LIVE);
            }
            None if self.report.state == MosaicState::Lost && self.params.mark_lost => {
                let (w, h, t) = (want_width as i32, want_height as i32, unit as i32);
                for (x, y, w, h) in [(0, 0, w, t), (0, h - t, w, t), (0, 0, t, h), (w - t, 0, t, h)] {
                    draw::fill_rectangle(out, x, y, w, h, RED, 1.0);
                }
                draw::text(out, 3.0 * unit, 3.0 * unit, "CAMERA LOST", unit / 2.0, RED);
            }
            None => {}
        }
        Ok(())
    }

    /// Makes the frame the first keyframe if it has enough features to find it again.
    fn begin(&mut self, pool: &dyn Parallel) -> bool {
        let identity = Homography::identity();
        let Some(outline) = Outline::of(&identity, self.size) else { return false };
        if self.features.len() < 2 * self.params.min_inliers {
            return false;
        }
        self.graph.reserve(self.params.max_keyframes);
        self.adjust.reserve(self.params.max_keyframes);
        self.live_gain = [1.0; 3];
        self.outline = Some(outline);
        self.report.mosaic_from_frame = identity;
        self.report.state = MosaicState::Fresh;
        (self.report.inliers, self.report.rms_px) = (self.features.len(), 0.0);
        self.aim(pool);
        self.keep(outline, pool);
        true
    }

    /// Finds the frame's position, and makes it a keyframe if it adds enough area.
    fn register_frame(&mut self, pool: &dyn Parallel) -> bool {
        let was_fresh = self.report.state == MosaicState::Fresh;
        let before = self.outline.map(|outline| outline.centre);
        let Some((index, link)) = self.find_keyframe(was_fresh, pool) else { return false };
        let Some(outline) = self.locate(index, &link) else { return false };
        let link = self.hand_over(link, &outline, pool);
        let Some(outline) = self.active_index().and_then(|index| self.locate(index, &link)) else { return false };
        self.report.state = MosaicState::Fresh;
        (self.report.inliers, self.report.rms_px) = (link.inliers, link.rms_px);
        self.outline = Some(outline);
        match before {
            Some(before) => self.report.path_px += distance(before, outline.centre),
            None => self.report.relocalised += 1,
        }
        self.live_gain = [1.0; 3];
        if self.params.exposure {
            let mosaic_from_frame = self.report.mosaic_from_frame;
            let (gain, lit) = (self.live_gain, self.rim.lit());
            let source = Source { picture: &self.live, mosaic_from_frame, size: self.size, gain, lit };
            self.live_gain = self.canvas.gain_of(&source);
        }
        let shared = |keyframe: &Keyframe| keyframe.outline.overlap(&outline);
        let most = self.keyframes[self.eligible()..].iter().map(shared).fold(0.0, f64::max);
        let is_weak = link.inliers < WEAK_INLIERS * self.params.min_inliers && most < WEAK_OVERLAP;
        if most < self.params.keyframe_overlap || is_weak {
            self.add_keyframe(&link, pool);
        }
        true
    }

    fn active_index(&self) -> Option<usize> {
        index_of(&self.keyframes, self.active)
    }

    /// First keyframe that frames may be registered to.
    fn eligible(&self) -> usize {
        if self.params.loop_closure { 0 } else { self.keyframes.len().saturating_sub(NEWEST) }
    }

    /// Finds a keyframe that contains the frame.
    fn find_keyframe(&mut self, was_fresh: bool, pool: &dyn Parallel) -> Option<(usize, Link)> {
        let first = self.eligible();
        let active = self.active_index()?;
        if was_fresh {
            let expected = self.keyframes[active].mosaic_from_frame.inverse()?.compose(&self.report.mosaic_from_frame);
            if let Some(link) = self.register(active, Some(expected), Test::Usual, pool) {
                return Some((active, link));
            }
        }
        if let Some(link) = self.register(active, None, Test::Strict, pool) {
            return Some((active, link));
        }
        // Where it was last first; a frame that stays lost is compared with all of them in turn.
        self.near.clear();
        if was_fresh {
            let centre = self.report.mosaic_from_frame.map([self.size.0 as f64 / 2.0, self.size.1 as f64 / 2.0]);
            let others = self.keyframes[first..].iter().filter(|k| k.id != self.active);
            self.near.extend(others.map(|k| (distance(k.outline.centre, centre), k.id)));
            self.near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            self.near.truncate(TRIES);
        } else {
            let count = self.keyframes.len() - first;
            for _ in 0..TRIES.min(count) {
                self.cursor = (self.cursor + 1) % count;
                self.near.push((0.0, self.keyframes[self.keyframes.len() - 1 - self.cursor].id));
            }
        }
        for position in 0..self.near.len() {
            let index = index_of(&self.keyframes, self.near[position].1)?;
            if let Some(link) = self.register(index, None, Test::Strict, pool) {
                self.active = self.keyframes[index].id;
                return Some((index, link));
            }
        }
        None
    }

    fn register(
        &mut self,
        index: usize,
        expected: Option<Homography>,
        test: Test,
        pool: &dyn Parallel,
    ) -> Option<Link> {
        let keyframe = &self.keyframes[index].features;
        self.tracker.register(keyframe, &self.features, expected, test, self.size, &self.params, pool)
    }

    /// Pose of the frame in the mosaic; `None` if it is implausible.
    fn locate(&mut self, index: usize, link: &Link) -> Option<Outline> {
        let pose = self.keyframes[index].mosaic_from_frame.compose(&link.keyframe_from_frame);
        let outline = Outline::of(&pose, self.size)?;
        let frame = (self.size.0 * self.size.1) as f64;
        (AREAS.0..AREAS.1).contains(&(outline.area / frame)).then(|| {
            self.report.mosaic_from_frame = pose;
            outline
        })
    }

    /// Changes to the keyframe that shares most with the frame, which is registered to both: so that no step between
    /// them is missed.
    fn hand_over(&mut self, link: Link, outline: &Outline, pool: &dyn Parallel) -> Link {
        let Some(active) = self.active_index() else { return link };
        let shared = |k: &Keyframe| k.outline.overlap(outline);
        let first = self.eligible();
        let own = shared(&self.keyframes[active]);
        let others = self.keyframes[first..].iter().filter(|k| k.id != self.active);
        let Some((most, best)) = others.map(|k| (shared(k), k.id)).max_by(|a, b| a.0.total_cmp(&b.0)) else {
            return link;
        };
        if most < own + HANDOVER || self.refused == (best, self.refused.1.max(1)) {
            return link;
        }
        let route = self.graph.route(&self.keyframes, self.active, best);
        let is_near = route.is_some_and(|route| !route.is_long());
        let (Some(index), Some(back)) = (
            index_of(&self.keyframes, best),
            index_of(&self.keyframes, best).and_then(|index| self.keyframes[index].mosaic_from_frame.inverse()),
        ) else {
            return link;
        };
        let expected = is_near.then(|| back.compose(&self.report.mosaic_from_frame));
        let test = if is_near { Test::Usual } else { Test::Strict };
        let Some(other) = self.register(index, expected, test, pool) else {
            self.refused = (best, REFUSED_FRAMES);
            return link;
        };
        if !self.graph.is_edge(self.active, best) {
            let both = |p: [f64; 2]| (link.keyframe_from_frame.map(p), other.keyframe_from_frame.map(p));
            let edge = edge_between(self.active, best, &other, both);
            if !self.connect(edge) {
                self.refused = (best, REFUSED_FRAMES);
                return link;
            }
            self.settle(pool);
        }
        self.active = best;
        other
    }

    /// Adds an edge between keyframes; an edge that disagrees with their positions marks them for adjustment. Returns
    /// false for a rejected edge.
    fn connect(&mut self, edge: Edge) -> bool {
        let (Some(from), Some(to)) = (index_of(&self.keyframes, edge.from), index_of(&self.keyframes, edge.to)) else {
            return false;
        };
        let route = self.graph.route(&self.keyframes, edge.from, edge.to);
        let Some(error_px) = edge.error_px(&self.keyframes[from], &self.keyframes[to]) else { return false };
        let side = (self.size.0 * self.size.1) as f64;
        let believed = BELIEVED.0 * side.sqrt() + BELIEVED.1 * route.map_or(0.0, |route| route.length_px);
        if error_px > believed && route.is_some() {
            return false;
        }
        self.graph.add(edge);
        if let Some(route) = route.filter(|route| route.is_long()) {
            self.report.closures += 1;
            self.report.drift_px = error_px;
            self.report.drift_pct = 100.0 * error_px / route.length_px.max(1.0);
        }
        self.is_settled &= error_px <= SETTLE_PX;
        true
    }

    /// Adjusts all positions when an edge disagrees with them, and redraws the mosaic if they moved noticeably.
    fn settle(&mut self, pool: &dyn Parallel) {
        if std::mem::replace(&mut self.is_settled, true) {
            return;
        }
        let moved = self.adjust.adjust(&mut self.keyframes, &self.graph, self.size, self.params.model);
        self.report.spread_px = moved.unwrap_or(self.report.spread_px);
        let shown = self.canvas.picture_from_mosaic;
        let moved = self.keyframes.iter().any(|keyframe| {
            let now = shown.compose(&keyframe.mosaic_from_frame).map_corners(self.size.0, self.size.1);
            let drawn = shown.compose(&keyframe.drawn).map_corners(self.size.0, self.size.1);
            let (Some(now), Some(drawn)) = (now, drawn) else { return true };
            now.iter().zip(drawn).any(|(a, b)| distance(*a, b) > self.params.redraw_px)
        });
        if moved && self.is_shown {
            self.redraw(pool);
        }
    }

    /// Makes the newest frame a keyframe and connects it with overlapping keyframes.
    fn add_keyframe(&mut self, link: &Link, pool: &dyn Parallel) {
        let Some(outline) = self.outline else { return };
        let mut links: [Option<(u64, Link)>; NEIGHBOURS + EARLIER] = [None; NEIGHBOURS + EARLIER];
        let mut count = 0;
        self.near.clear();
        let others = self.keyframes[self.eligible()..].iter().filter(|k| k.id != self.active);
        self.near.extend(others.map(|k| (distance(k.outline.centre, outline.centre), k.id)));
        self.near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let side = outline.area.sqrt();
        let (mut neighbours, mut earlier) = (0, 0);
        for position in 0..self.near.len() {
            let (away, id) = self.near[position];
            let Some(index) = index_of(&self.keyframes, id) else { continue };
            let route = self.graph.route(&self.keyframes, self.active, id);
            let is_near = route.is_some_and(|route| !route.is_long());
            let length_px = route.map_or(0.0, |route| route.length_px);
            let reach = SEARCH.0 * side + if is_near { 0.0 } else { SEARCH.1 * length_px };
            let (taken, most) = if is_near { (&mut neighbours, NEIGHBOURS) } else { (&mut earlier, EARLIER) };
            if away > reach || *taken == most {
                continue;
            }
            *taken += 1;
            let back = self.keyframes[index].mosaic_from_frame.inverse();
            let expected = back.filter(|_| is_near).map(|back| back.compose(&self.report.mosaic_from_frame));
            let test = if is_near { Test::Usual } else { Test::Strict };
            if let Some(link) = self.register(index, expected, test, pool) {
                links[count] = Some((id, link));
                count += 1;
            }
        }
        let active = self.active;
        let id = self.keep(outline, pool);
        let connect = |mosaic: &mut Self, to: u64, link: &Link| {
            if index_of(&mosaic.keyframes, to).is_some() {
                mosaic.connect(edge_between(id, to, link, |p| (p, link.keyframe_from_frame.map(p))));
            }
        };
        connect(self, active, link);
        for (to, link) in links.iter().flatten() {
            connect(self, *to, link);
        }
        self.settle(pool);
        // A closed loop has moved the new keyframe, and with it the frame.
        if let Some(newest) = self.keyframes.last() {
            self.report.mosaic_from_frame = newest.mosaic_from_frame;
            self.outline = Some(newest.outline);
        }
        self.count_area();
    }

    /// Stores the newest frame as a keyframe, replacing the oldest at the limit, and draws it.
    fn keep(&mut self, outline: Outline, pool: &dyn Parallel) -> u64 {
        let slot = if self.keyframes.len() >= self.params.max_keyframes.max(1) { self.drop_oldest(pool) } else { None };
        let pose = self.report.mosaic_from_frame;
        let mut keyframe = slot.unwrap_or_else(|| Keyframe {
            id: 0,
            picture: Picture::default(),
            features: Features::default(),
            mosaic_from_frame: pose,
            outline,
            drawn: pose,
            gain: [1.0; 3],
            own_area: 0.0,
        });
        keyframe.id = self.next_id;
        self.next_id += 1;
        keyframe.picture.copy_from(&self.live);
        std::mem::swap(&mut keyframe.features, &mut self.features);
        (keyframe.mosaic_from_frame, keyframe.drawn, keyframe.outline) = (pose, pose, outline);
        keyframe.gain = self.live_gain;
        self.active = keyframe.id;
        self.keyframes.push(keyframe);
        let newest = self.keyframes.len() - 1;
        self.keyframes[newest].own_area = own_area(&self.keyframes, newest, self.size, self.rim.lit());
        if self.is_shown {
            let part = self.canvas.rect_of(outline.bounds());
            let source = source_of(&self.keyframes[newest], self.size, self.rim.lit());
            self.canvas.add(&source, part, pool);
            self.canvas.finish(part, pool);
        }
        self.count_area();
        self.active
    }

    /// Drops the oldest keyframe that is not in use, with its part of the image. Returns its memory.
    fn drop_oldest(&mut self, pool: &dyn Parallel) -> Option<Keyframe> {
        let is_free = |k: &Keyframe| k.id != self.active;
        let index = self.keyframes.iter().position(is_free).unwrap_or(0);
        if self.keyframes.is_empty() {
            return None;
        }
        let dropped = self.keyframes.remove(index);
        self.graph.forget(dropped.id);
        self.report.dropped += 1;
        let reach = |k: &Keyframe| 2.0 * (k.outline.area.sqrt() + dropped.outline.area.sqrt());
        for other in 0..self.keyframes.len() {
            if distance(self.keyframes[other].outline.centre, dropped.outline.centre) < reach(&self.keyframes[other]) {
                self.keyframes[other].own_area = own_area(&self.keyframes, other, self.size, self.rim.lit());
            }
        }
        if self.is_shown
            && let Some(drawn) = Outline::of(&dropped.drawn, self.size)
        {
            let part = self.canvas.rect_of(drawn.bounds());
            self.canvas.clear(part);
            for keyframe in &self.keyframes {
                let source =
                    Source { mosaic_from_frame: keyframe.drawn, ..source_of(keyframe, self.size, self.rim.lit()) };
                self.canvas.add(&source, part, pool);
            }
            self.canvas.finish(part, pool);
        }
        Some(dropped)
    }

    fn count_area(&mut self) {
        let frame = (self.size.0 as f64 - 1.0) * (self.size.1 as f64 - 1.0);
        self.report.coverage_pct = 100.0 * self.keyframes.iter().map(|k| k.own_area).sum::<f64>() / frame;
    }

    /// Chooses the shown part and redraws the image if it changed.
    fn aim(&mut self, pool: &dyn Parallel) {
        let newest = self.outline.or_else(|| self.keyframes.last().map(|k| k.outline));
        let Some(newest) = newest else { return };
        let bounds = self.keyframes.iter().fold(newest.bounds(), |bounds, k| union(bounds, k.outline.bounds()));
        let now = Some(self.canvas.picture_from_mosaic).filter(|_| self.is_shown);
        let wanted = shown::choose(now, bounds, &newest, &self.params);
        if now != Some(wanted) {
            self.canvas.picture_from_mosaic = wanted;
            self.is_shown = true;
            self.redraw(pool);
        }
        self.report.picture_from_mosaic = self.canvas.picture_from_mosaic;
    }

    fn redraw(&mut self, pool: &dyn Parallel) {
        self.report.redraws += 1;
        let whole = self.canvas.whole();
        self.canvas.clear(whole);
        for index in 0..self.keyframes.len() {
            self.keyframes[index].drawn = self.keyframes[index].mosaic_from_frame;
            self.keyframes[index].own_area = own_area(&self.keyframes, index, self.size, self.rim.lit());
            let source = source_of(&self.keyframes[index], self.size, self.rim.lit());
            self.canvas.add(&source, whole, pool);
        }
        self.canvas.finish(whole, pool);
        self.count_area();
    }
}

fn source_of<'a>(keyframe: &'a Keyframe, size: (usize, usize), lit: Option<&'a Lit>) -> Source<'a> {
    let Keyframe { picture, mosaic_from_frame, gain, .. } = keyframe;
    Source { picture, mosaic_from_frame: *mosaic_from_frame, size, gain: *gain, lit }
}

/// An edge of a registration: where both keyframes see its points.
fn edge_between(from: u64, to: u64, link: &Link, both: impl Fn([f64; 2]) -> ([f64; 2], [f64; 2])) -> Edge {
    let mut pairs = [([0.0; 2], [0.0; 2]); MAX_PAIRS];
    for (pair, point) in pairs.iter_mut().zip(link.points()) {
        *pair = both(*point);
    }
    // Each pair lies on the registration and so stands for several inliers.
    let weight = (link.inliers as f64 / link.count.max(1) as f64).clamp(1.0, 8.0);
    Edge { from, to, pairs, count: link.count, weight }
}
