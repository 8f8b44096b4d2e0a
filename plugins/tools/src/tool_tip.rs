//! `tool_tip`: the leading tool's tip, in the image and, if depth is known, in space (thesis, chapter 6).

use std::collections::VecDeque;

use panoscope_node::abi::{Calibration, Detection, Tip};
use panoscope_node::{
    AnyImage, Bgr8, Context, Depth, Detections, Disparity, Image, Instances, Node, NodeInfo, Open, Params, Ports,
    Result, Slot, Table, Validation, Value, error,
};

use panoscope_arm_core::tracking::real_time::RealTime;
use panoscope_arm_core::tracking::tracker::UNKNOWN_CLASS;

use crate::candidates::iou;
use crate::keypoints::tip_in_table;
use crate::shaft::{End, Mask, TipFinder, TipPixel, direction_of_box, tip_of_box};
use crate::silhouette::{Cues, Nearness, Silhouette};
use crate::tip_position::{self, Position, Scene, TipPosition};
use crate::views::{ViewMemory, Views};
use crate::yolo::UNKNOWN;

/// Input ports of `tool_tip`.
#[derive(Ports)]
pub struct In<'f> {
    /// Boxes of tools in the left rectified view. Boxes of a detector that is slower than the camera (wired with `align = "latest"`) are moved along
    /// with the tip, and the tool is segmented in the image of this tick: a tip is as new as `image`, not as its box.
    detections: Option<Detections<'f>>,
    /// Tools with masks; used instead of boxes.
    instances: Option<Instances<'f>>,
    /// Keypoints of the boxes, from the output `keypoints` of the same `yolo`, with the same `align`. The first keypoint of a box is its tip where the
    /// tool's end in the image is missing or far from it (`keypoint_score`). Unused with masks.
    keypoints: Option<Table<'f>>,
    /// Image in which tools were found, bgr8. With it, or with depth, the tool is segmented inside its box and its end is the tip. Without both, the
    /// tip is the end of the box, wrong by up to half the box's width. The image also shows on which side the shaft of a box or mask goes on or leaves
    /// the view: the tip is on the other one.
    image: Option<AnyImage<'f>>,
    /// Right rectified view of the same tick, bgr8. With it the depth of a segmented tool end is found by comparing both views. Tool ends are often
    /// thinner than a matcher's window, which returns the depth of the tissue there.
    right: Option<AnyImage<'f>>,
    /// Depth of the left rectified view, mm, for the position in space.
    depth: Option<Image<'f, Depth>>,
    /// Disparity of the left rectified view, px, used if no depth is connected. Connect the matcher's map: filters fill unmatched pixels and so mix a
    /// thin tool end with the tissue behind it.
    disparity: Option<Image<'f, Disparity>>,
    /// Calibration of the rectified views, for the position in space.
    calibration: Option<Value<'f, Calibration>>,
}

/// Output ports of `tool_tip`.
#[derive(Ports)]
pub struct Out<'f> {
    /// Tip of the leading tool; between open jaws the middle of both ends. Where masks and depth show that another tool hides one of two jaws, the
    /// tip is computed from the other jaw and the shaft's axis, for 10 s after both were seen. Empty when no tool is found, or when another tool
    /// hides its complete end.
    tip: Slot<'f, Tip>,
    /// Apparent end of the leading tool while another tool hides its complete end: px, without a position in space. Otherwise empty. `tip_track`
    /// keeps following a tool that is reported here.
    hidden: Slot<'f, Tip>,
}

/// Parameters of `tool_tip`.
#[derive(Params)]
pub struct ToolTipParams {
    /// Name of the class to follow; empty takes any.
    #[param(default = "")]
    class: String,
    /// Minimum score of a tool. Without a given class, the scores of overlapping boxes of several classes are added.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f32,
    /// Minimum score of a box that overlaps the previous box of the leading tool: a weak box at the position of a certain tool is that tool (after
    /// Zhang et al. 2022, ByteTrack).
    #[param(default = 0.1, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    keep_score: f32,
    /// Minimum score of a keypoint that replaces the end of the segmented tool. 1: keypoints are not used.
    #[param(default = 0.35, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    keypoint_score: f64,
    /// Minimum distance of such a keypoint from the end of the segmented tool, as a share of the diagonal of the box: nearer, the end is used. 0 always
    /// uses the keypoint, which is more accurate in real images without depth and less accurate in rendered ones.
    #[param(default = 0.35, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    keypoint_distance: f64,
    /// Radius around the tip within which depth is read.
    #[param(default = 6, range = 1..=64, unit = "px")]
    radius_px: usize,
    /// Maximum age of a box that is used, and time for which the last box is used while the detector finds none.
    #[param(default = 300.0, range = 0.0..=1000.0, step = 10.0, unit = "ms")]
    max_age_ms: f64,
}

/// Finds the tip of the leading tool.
pub struct ToolTip {
    leading: Option<Leading>,
    finder: TipFinder,
    silhouette: Silhouette,
    position: TipPosition,
    kept: Option<LastBox>,
    /// Capture times, ns, and positions, px, of the last tips.
    observations: VecDeque<(i64, [f64; 2])>,
    time: RealTime,
    memory: ViewMemory,
}

/// The last leading tool.
struct Leading {
    /// Its number in the output, and the newest one from the detector.
    called: i64,
    number: i64,
    corners: [f32; 4],
    /// Numbers of other tools seen in the same tick.
    others: [i64; 16],
    /// Ticks since it was seen.
    missed: u32,
}

/// The last box of the leading tool.
struct LastBox {
    item: Detection,
    /// Capture time of the image in which it was found, ns.
    found_ns: i64,
    /// Score of the tool, and when it was found, ns.
    score: f32,
    scored_ns: i64,
}

impl LastBox {
    /// Score of the tool at `now_ns`.
    fn score_at(&self, now_ns: i64) -> f32 {
        self.score * 0.5_f32.powf(now_ns.saturating_sub(self.scored_ns).max(0) as f32 * 1e-9 / HALF_S)
    }
}

/// Time in which the score of a tool that is found only in weak boxes halves, s.
const HALF_S: f32 = 0.5;
/// Minimum overlap of boxes of different classes that count as one tool.
const SAME_TOOL_IOU: f32 = 0.5;
/// Minimum overlap of a box with the last leading box to count as the same tool.
const STILL_IOU: f32 = 0.35;
/// Shares of the image's width: a tip nearer to the border than the first is where a tool leaves the image; a box at the border thinner than the
/// second shows a shaft that crosses it.
const BORDER_SHARE: f64 = 0.01;
const STRIP_SHARE: f32 = 0.06;
/// Maximum number of boxes that are tried until one has its tip in the image.
const MAX_TRIES: usize = 4;
/// Maximum number of ticks within which the leading tool may return with another number.
const MEMORY_TICKS: u32 = 15;

fn corners_of(d: &Detection) -> [f32; 4] {
    [d.x_px, d.y_px, d.x_px + d.width_px, d.y_px + d.height_px]
}

fn moved([x0, y0, x1, y1]: [f32; 4], [dx, dy]: [f32; 2]) -> [f32; 4] {
    [x0 + dx, y0 + dy, x1 + dx, y1 + dy]
}

impl Leading {
    /// The same tool, missed for one more tick.
    fn missed_again(self) -> Self {
        Self { missed: self.missed + 1, ..self }
    }

    /// Score that a box is this tool: it has the tool's number, or is at the tool's position and was not another tool then. Detectors that change a
    /// tool's class give it a new number each time.
    fn claims(&self, item: &Detection) -> u8 {
        if item.track_id >= 0 && item.track_id == self.number {
            return 2;
        }
        let is_other = self.others.contains(&item.track_id);
        u8::from(item.track_id >= 0 && !is_other && iou(&corners_of(item), &self.corners) >= STILL_IOU)
    }
}

/// Score that a box is a tool of any class.
fn sureness(item: &Detection, items: &[Detection]) -> f32 {
    let own = corners_of(item);
    let mut sum = item.score;
    for (index, other) in items.iter().enumerate() {
        let is_same = |d: &Detection| iou(&corners_of(d), &own) >= SAME_TOOL_IOU;
        let is_first = || {
            let before = items[..index].iter();
            !before.filter(|d| d.class_index == other.class_index).any(is_same)
        };
        // Best first: one score per class.
        if other.class_index != item.class_index && is_same(other) && is_first() {
            sum += other.score;
        }
    }
    sum.min(1.0)
}

/// Maximum number of tips stored for late boxes.
const MAX_OBSERVATIONS: usize = 16;
/// The tools that a detector found in an image.
struct Tools<'a, 'f> {
    found: &'a Detections<'f>,
    masks: Option<Instances<'f>>,
    keypoints: Option<Table<'f>>,
    /// Columns and rows of the image.
    size: (usize, usize),
    /// Name of the class to follow; empty for any.
    class: &'a str,
}

impl<'f> Tools<'_, 'f> {
    fn items(&self) -> &[Detection] {
        self.found.items()
    }

    /// An input, which must have the size of the image; `what` says what to wire.
    fn view(&self, input: &str, image: Option<AnyImage<'f>>, what: &str) -> Result<Option<Image<'f, Bgr8>>> {
        let image = image.and_then(|image| image.as_plane::<Bgr8>());
        match &image {
            Some(image) if (image.width(), image.height()) != self.size => Err(error!(
                "`{input}` is {}x{}, but tools were found in an image of {}x{}: connect {what}",
                image.width(),
                image.height(),
                self.size.0,
                self.size.1
            )),
            _ => Ok(image),
        }
    }

    fn class_of(&self, item: &Detection) -> u32 {
        if self.found.label(item.class_index) == UNKNOWN { UNKNOWN_CLASS } else { item.class_index }
    }

    fn is_wanted(&self, item: &Detection) -> bool {
        self.class.is_empty() || self.found.label(item.class_index) == self.class
    }

    fn score(&self, item: &Detection) -> f32 {
        if self.class.is_empty() { sureness(item, self.items()) } else { item.score }
    }

    fn mask(&self, item: usize) -> Option<Mask<'_>> {
        self.masks.as_ref().map(|masks| Mask::new(masks.mask(item), self.size.0, self.size.1))
    }

    /// The keypoint of box `index`, moved with it by `shift` px, if its score is at least `min_score`. It points away from the middle of the box.
    fn keypoint(&self, index: usize, shift: [f32; 2], min_score: f64) -> Option<TipPixel> {
        let table = self.keypoints.as_ref().filter(|_| self.masks.is_none() && min_score < 1.0)?;
        let [x, y, _] = tip_in_table(table, index).filter(|[.., score]| *score >= min_score)?;
        let (u_px, v_px) = (x + f64::from(shift[0]), y + f64::from(shift[1]));
        let [x0, y0, x1, y1] = moved(corners_of(self.items().get(index)?), shift).map(f64::from);
        let (dx, dy) = (u_px - (x0 + x1) / 2.0, v_px - (y0 + y1) / 2.0);
        let length = dx.hypot(dy);
        let direction = if length > 1e-9 { [dx / length, dy / length] } else { [1.0, 0.0] };
        Some(TipPixel { tip: End { u_px, v_px, direction }, jaws: None })
    }

    /// Whether a tip is away from the border of the image; at the border tools only leave it.
    fn is_inside(&self, tip: &End) -> bool {
        let (width, height) = (self.size.0 as f64, self.size.1 as f64);
        let (x, y) = (tip.u_px.min(width - 1.0 - tip.u_px), tip.v_px.min(height - 1.0 - tip.v_px));
        x.min(y) >= BORDER_SHARE * width
    }

    /// Whether a box is a thin strip along the border of the image: a shaft that crosses it.
    fn is_strip(&self, item: &Detection) -> bool {
        let [x0, y0, x1, y1] = corners_of(item);
        let (width, height) = (self.size.0 as f32, self.size.1 as f32);
        let thin = STRIP_SHARE * width;
        (x1 - x0 < thin && (x0 < 2.0 || x1 > width - 2.0)) || (y1 - y0 < thin && (y0 < 2.0 || y1 > height - 2.0))
    }
}

/// The time of a call, and the age of the boxes, ns.
struct Now<'a> {
    now_ns: i64,
    age_ns: i64,
    params: &'a ToolTipParams,
}

/// The leading tool with its tip.
struct Candidate {
    /// Its index among the boxes; `usize::MAX` if the detector misses it.
    index: usize,
    item: Detection,
    tip: TipPixel,
    /// Whether the tip comes from the silhouette in the image.
    is_cut: bool,
}

impl Candidate {
    fn is_found(&self) -> bool {
        self.index != usize::MAX
    }
}

/// Score of a box for being the leading tool, see [`Leading::claims`].
fn claim(leading: Option<&Leading>, item: &Detection) -> u8 {
    leading.map_or(0, |leading| leading.claims(item))
}

impl ToolTip {
    /// The first tool whose tip is in the image: the leading one, else the one with the highest score.
    fn candidate(
        &mut self,
        tools: &Tools<'_, '_>,
        views: &mut Views<'_, '_>,
        leading: Option<&Leading>,
        has_kept: bool,
        &Now { now_ns, age_ns, params }: &Now<'_>,
    ) -> Option<Candidate> {
        let shift = self.shift(now_ns, age_ns);
        let (items, (width, height)) = (tools.items(), tools.size);
        // The leading tool keeps leading while it is seen; otherwise the one with the highest score leads.
        let order = |(_, a): &(usize, &Detection), (_, b): &(usize, &Detection)| {
            let claims = claim(leading, a).cmp(&claim(leading, b));
            claims.then(tools.score(a).total_cmp(&tools.score(b))).then(a.score.total_cmp(&b.score))
        };
        let min_score = |d: &Detection| {
            if claim(leading, d) > 0 && has_kept { params.keep_score.min(params.min_score) } else { params.min_score }
        };
        let may_lead = |d: &Detection| tools.is_wanted(d) && !tools.is_strip(d) && tools.score(d) >= min_score(d);
        // A tool that ends at the picture's border has its tip outside, as boxes of shafts at the border do.
        let mut tried = [usize::MAX; MAX_TRIES];
        for try_number in 0..MAX_TRIES {
            let wanted = items.iter().enumerate().filter(|(index, _)| !tried.contains(index));
            let (index, item) = wanted.filter(|(_, d)| may_lead(d)).max_by(order)?;
            tried[try_number] = index;
            let corners = moved(corners_of(item), shift);
            let mut tip = tools.mask(index).and_then(|mask| {
                let is_shown = !mask.touches_border() && self.cut(corners, views);
                let towards = is_shown.then(|| self.away_from_shaft(views)).flatten();
                self.finder.of_mask_towards(mask, towards)
            });
            let mut is_cut = false;
            if tip.is_none() {
                tip = self.cut_tip(corners, views);
                is_cut = tip.is_some();
                let far_px =
                    params.keypoint_distance * f64::from((corners[2] - corners[0]).hypot(corners[3] - corners[1]));
                let keypoint = tools.keypoint(index, shift, params.keypoint_score).filter(|keypoint| {
                    let off_px =
                        |cut: &TipPixel| (cut.tip.u_px - keypoint.tip.u_px).hypot(cut.tip.v_px - keypoint.tip.v_px);
                    tip.as_ref().is_none_or(|cut| off_px(cut) > far_px)
                });
                if keypoint.is_some() {
                    (tip, is_cut) = (keypoint, false);
                }
            }
            // Only an old box: it shows where the tool was.
            let tip = tip.or_else(|| (age_ns == 0).then(|| tip_of_box(corners, width, height)));
            if let Some(tip) = tip.filter(|tip| tools.is_inside(&tip.tip)) {
                return Some(Candidate { index, item: *item, tip, is_cut });
            }
        }
        None
    }

    /// The leading tool at its last box: the detector misses it, but it may be visible in the image.
    fn missed(
        &mut self,
        tools: &Tools<'_, '_>,
        views: &mut Views<'_, '_>,
        leading: Option<&Leading>,
        kept: &LastBox,
        now_ns: i64,
    ) -> Option<Candidate> {
        // Where the detector finds another tool now, the picture would show that one.
        let own = corners_of(&kept.item);
        let is_other = |d: &Detection| claim(leading, d) == 0 && iou(&corners_of(d), &own) >= STILL_IOU;
        if tools.masks.is_some() || tools.items().iter().any(is_other) {
            return None;
        }
        let shift = self.shift(now_ns, now_ns - kept.found_ns);
        let tip = self.cut_tip(moved(own, shift), views).filter(|tip| tools.is_inside(&tip.tip))?;
        Some(Candidate { index: usize::MAX, item: kept.item, tip, is_cut: true })
    }

    /// Stores the leading tool and its box for the next tick. Returns its number in the output, and its score.
    fn remember(
        &mut self,
        tools: &Tools<'_, '_>,
        best: &Candidate,
        leading: Option<Leading>,
        kept: Option<LastBox>,
        &Now { now_ns, params, .. }: &Now<'_>,
    ) -> (i64, f32) {
        let (item, is_found) = (best.item, best.is_found());
        let is_same = claim(leading.as_ref(), &item) > 0;
        let called = leading.as_ref().filter(|_| is_same).map_or(item.track_id, |leading| leading.called);
        let box_score = if is_found { tools.score(&item) } else { 0.0 };
        let lasts = best.is_cut && (is_same || !is_found);
        let before = kept.as_ref().filter(|_| lasts).map_or(0.0, |kept| kept.score_at(now_ns));
        let score = if box_score >= params.min_score { box_score } else { box_score.max(before) };
        let found_ns = if is_found { tools.found.tick().capture_ns } else { kept.map_or(now_ns, |kept| kept.found_ns) };
        self.kept = Some(LastBox { item, found_ns, score, scored_ns: now_ns });
        self.leading = if is_found {
            let corners = corners_of(&item);
            let mut others = [-1; 16];
            let beside = tools.items().iter().filter(|d| d.track_id >= 0 && iou(&corners_of(d), &corners) < STILL_IOU);
            others.iter_mut().zip(beside).for_each(|(other, d)| *other = d.track_id);
            Some(Leading { called, number: item.track_id, corners, others, missed: 0 })
        } else {
            leading.map(Leading::missed_again)
        };
        (called, score)
    }

    /// Movement of the tip since boxes of this age were found, px; 0 if it is unknown.
    fn shift(&mut self, now_ns: i64, age_ns: i64) -> [f32; 2] {
        if self.observations.back().is_some_and(|(newest_ns, _)| *newest_ns > now_ns) {
            // Time went backwards.
            self.observations.clear();
        }
        let seen_ns = now_ns.saturating_sub(age_ns);
        let then = self.observations.iter().min_by_key(|(observed_ns, _)| observed_ns.abs_diff(seen_ns));
        match (then, self.observations.back()) {
            (Some((_, then)), Some((_, last))) if age_ns > 0 => {
                [(last[0] - then[0]) as f32, (last[1] - then[1]) as f32]
            }
            _ => [0.0; 2],
        }
    }

    /// Direction of the instrument that was segmented last, away from the side on which its shaft goes on or leaves the view, if the image shows it.
    fn away_from_shaft(&self, views: &Views<'_, '_>) -> Option<[f64; 2]> {
        // Rare, and far beyond the box: the whole view.
        self.silhouette.shaft_direction(&views.left?.view()).map(|[x, y]| [-x, -y])
    }

    /// Segments the instrument in a box, see [`Silhouette::cut`].
    fn cut(&mut self, corners: [f32; 4], views: &mut Views<'_, '_>) -> bool {
        let size = views.size;
        let pixels = if views.are_parts() { Silhouette::pixels(corners, size) } else { Vec::new() };
        let near = (views.depth_size() == Some(size)).then_some(&pixels[..]);
        let seen = views.parts([Some(&pixels), None, near]);
        let nearness = near.map(|_| &seen.space as &dyn Nearness);
        self.silhouette.cut(corners, &Cues { size, picture: seen.left, nearness })
    }

    /// The tip of the instrument in a box, if it can be segmented.
    fn cut_tip(&mut self, corners: [f32; 4], views: &mut Views<'_, '_>) -> Option<TipPixel> {
        let is_cut = self.cut(corners, views);
        let (width, height) = views.size;
        let of_box = || direction_of_box(corners, width, height);
        let towards =
            (is_cut && self.silhouette.is_by_colour()).then(|| self.away_from_shaft(views).unwrap_or_else(of_box));
        let tip = is_cut.then(|| self.finder.of_mask_towards(self.silhouette.mask(), towards)).flatten();
        tip.map(|tip| self.silhouette.place(tip))
    }

    /// Finds the tip of the leading tool of a tick.
    fn follow(
        &mut self,
        tools: &Tools<'_, '_>,
        views: &mut Views<'_, '_>,
        calibration: Option<&Calibration>,
        out: &mut Out<'_>,
        now: &Now<'_>,
    ) -> Result<()> {
        let &Now { now_ns, params, .. } = now;
        let max_ns = params.max_age_ms * 1e6;
        let leading = self.leading.take().filter(|leading| leading.missed <= MEMORY_TICKS);
        let kept =
            self.kept.take().filter(|kept| (0.0..=max_ns).contains(&(self.time.real(now_ns - kept.found_ns) as f64)));
        let best = self.candidate(tools, views, leading.as_ref(), kept.is_some(), now);
        let best = best.or_else(|| self.missed(tools, views, leading.as_ref(), kept.as_ref()?, now_ns));
        let Some(best) = best else {
            self.leading = leading.map(Leading::missed_again);
            self.kept = kept;
            return Ok(());
        };
        let TipPixel { tip, jaws } = best.tip;
        let (called, score) = self.remember(tools, &best, leading, kept, now);
        let class_index = tools.class_of(&best.item);
        let tip_at = |(u_px, v_px): (f64, f64), xyz_mm: [f64; 3], is_valid: bool| {
            let (score, xyz_valid) = (f64::from(score), u32::from(is_valid));
            Tip { u_px, v_px, xyz_mm, score, class_index, xyz_valid, track_id: called }
        };
        let mut tip_out = tip_at((tip.u_px, tip.v_px), [f64::NAN; 3], false);
        if let (Some(calibration), Some(depth_size)) = (calibration, views.depth_size()) {
            let ends = jaws.as_ref().map_or(std::slice::from_ref(&tip), |jaws| &jaws[..]);
            let has_views = best.is_cut && views.left.is_some() && views.right.is_some();
            let read = if views.are_parts() { ends } else { &[] };
            let compared = has_views.then(|| tip_position::compared(read, tools.size, views.focal_baseline));
            let near = tip_position::around(read, depth_size, params.radius_px);
            let [left, right] = [0, 1].map(|view| compared.as_ref().map(|parts| &parts[view][..]));
            let seen = views.parts([left, right, Some(&near)]);
            let scene = Scene {
                space: &seen.space,
                size: depth_size,
                projection: &calibration.left_projection,
                masks: tools.masks.filter(|_| depth_size == tools.size),
                item: best.index,
                items: tools.items().len(),
                cut: best.is_cut.then_some(&self.silhouette),
                views: seen.left.as_ref().zip(seen.right.as_ref()),
                radius_px: params.radius_px,
                tool: called,
                now_ns,
            };
            match self.position.find(&scene, &tip, ends, &mut self.finder) {
                // The apparent end is where another instrument hides the tool: no tip is better than a wrong one.
                Position::Hidden => return out.hidden.set(tip_out),
                Position::At { pixel, xyz_mm, is_valid } => tip_out = tip_at(pixel, xyz_mm, is_valid),
            }
        }
        if self.observations.len() == MAX_OBSERVATIONS {
            self.observations.pop_front();
        }
        self.observations.push_back((now_ns, [tip.u_px, tip.v_px]));
        out.tip.set(tip_out)
    }
}

impl Node for ToolTip {
    const INFO: NodeInfo = NodeInfo::compute("tool_tip", "tools", "Finds the leading tool's tip, in px and in mm.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ToolTipParams;

    fn validate(_: &ToolTipParams, check: &mut Validation<'_>) {
        if ["detections", "instances"].iter().all(|name| check.is_connected(name) == Some(false)) {
            let message = "neither `detections` nor `instances` is connected: no tip is found";
            check.node_warning(message, "connect a detector, such as `yolo`");
        }
    }

    fn open(_: &Open<'_>, _: &ToolTipParams) -> Result<Self> {
        Ok(Self {
            leading: None,
            finder: TipFinder::default(),
            silhouette: Silhouette::default(),
            position: TipPosition::default(),
            kept: None,
            observations: VecDeque::with_capacity(MAX_OBSERVATIONS),
            time: RealTime::default(),
            memory: ViewMemory::default(),
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &ToolTipParams) -> Result<()> {
        let masks = input.instances;
        // Empty in ticks that the detector, slower than the camera, skipped.
        let Some(found) = masks.map(|m| m.detections()).or(input.detections) else { return Ok(()) };
        let now_ns = cx.tick().capture_ns;
        let age_ns = now_ns.saturating_sub(found.tick().capture_ns).max(0);
        // Masks cannot be moved to another picture, and boxes only by a limited distance.
        self.time.step(now_ns, cx.tick_arrived_ns());
        let max_ns = params.max_age_ms * 1e6;
        if age_ns > 0 && (masks.is_some() || self.time.real(age_ns) as f64 > max_ns) {
            return Ok(());
        }
        let keypoints = input.keypoints;
        let tools = Tools { found: &found, masks, keypoints, size: found.image_size(), class: &params.class };
        let left = tools.view("image", input.image, "the image that was searched")?;
        let right = tools.view("right", input.right, "the other view of the same pair")?;
        let mut memory = std::mem::take(&mut self.memory);
        let mut views = Views {
            size: tools.size,
            left,
            right,
            depth: input.depth,
            disparity: input.disparity,
            focal_baseline: input.calibration.as_ref().map_or(f64::NAN, |c| c.left_projection[0] * c.baseline_mm),
            is_whole: masks.is_some(),
            memory: &mut memory,
        };
        let now = Now { now_ns, age_ns, params };
        let done = self.follow(&tools, &mut views, input.calibration.as_deref(), &mut out, &now);
        self.memory = memory;
        done
    }
}
