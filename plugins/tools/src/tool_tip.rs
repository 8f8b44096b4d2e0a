//! `tool_tip`: the leading tool's tip, in the picture and, where depth is known, in space (thesis, chapter 6).

use std::collections::VecDeque;
use std::ops::Range;

use nalgebra::Vector3;
use panoscope_node::abi::{Calibration, Detection, Tip};
use panoscope_node::{
    AnyImage, Bgr8, Context, Depth, Detections, Disparity, Image, Instances, Node, NodeInfo, Open, Params, Ports,
    Result, Slot, Validation, Value, View, error,
};

use panoscope_tracking::real_time::RealTime;
use panoscope_tracking::tracker::UNKNOWN_CLASS;

use crate::candidates::iou;
use crate::hidden_jaw::{HiddenJaw, KnownEnd, Lens, Pixels};
use crate::second_view::SecondView;
use crate::shaft::{End, Mask, TipFinder, TipPixel, direction_of_box, tip_of_box};
use crate::silhouette::{Cues, Nearness, Silhouette};
use crate::yolo::UNKNOWN;

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Boxes of tools in the left rectified view. Boxes of a detector that is slower than the camera (wired with `align = "latest"`) are moved along
    /// with the tip, and the tool is segmented in the picture of this tick: a tip is as new as `image`, not as its box.
    detections: Option<Detections<'f>>,
    /// Tools with masks; used instead of boxes.
    instances: Option<Instances<'f>>,
    /// The picture in which boxes were found, bgr8. With it, or with depth, the tool is segmented inside its box and its end is the tip. Without both
    /// the tip is the end of the box, wrong by up to half the box's width.
    image: Option<AnyImage<'f>>,
    /// Right rectified view of the same tick, bgr8. With it the depth of a segmented tool end is found by comparing both views. Tool ends are often
    /// thinner than a matcher's window, which returns the depth of the tissue there.
    right: Option<AnyImage<'f>>,
    /// Depth of the left rectified view, mm, for the position in space.
    depth: Option<Image<'f, Depth>>,
    /// Disparity of the left rectified view, px, used where no depth is connected. Connect the matcher's map: filters fill unmatched pixels and so
    /// mix a thin tool end with the tissue behind it.
    disparity: Option<Image<'f, Disparity>>,
    /// Calibration of the rectified views, for the position in space.
    calibration: Option<Value<'f, Calibration>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// Tip of the leading tool; between open jaws the middle of both ends. Where masks and depth show that another tool hides one of two jaws, the tip is
    /// found from the other jaw and the shaft's axis, for 10 s after both were seen. Empty when no tool is found, or when another tool hides its whole end.
    tip: Slot<'f, Tip>,
    /// Where the leading tool seems to end while another tool hides its whole end: px, without a position in space. Empty otherwise. `tip_track` keeps
    /// following a tool that is reported here.
    hidden: Slot<'f, Tip>,
}

/// Parameters.
#[derive(Params)]
pub struct ToolTipParams {
    /// Name of the class to follow; empty takes any.
    #[param(default = "")]
    class: String,
    /// Lowest score of a tool. Without a given class, the scores of overlapping boxes of several classes are added.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f32,
    /// Lowest score of a box that overlaps the previous box of the leading tool: a weak box at the position of a certain tool is that tool (after Zhang
    /// et al. 2022, ByteTrack).
    #[param(default = 0.1, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    keep_score: f32,
    /// Radius around the tip within which depth is read.
    #[param(default = 6, range = 1..=64, unit = "px")]
    radius_px: usize,
    /// Age up to which a box is used, and time for which the last box is used while the detector finds none.
    #[param(default = 300.0, range = 0.0..=1000.0, step = 10.0, unit = "ms")]
    max_age_ms: f64,
}

/// Finds the tip of the leading tool.
pub struct ToolTip {
    near: Vec<f32>,
    leading: Option<Leading>,
    finder: TipFinder,
    silhouette: Silhouette,
    second: SecondView,
    kept: Option<LastBox>,
    /// Distance of both ends of open jaws from the middle between them, mm, and when it was seen, ns.
    half: Option<(f64, i64)>,
    /// Jaws of which another instrument hides one.
    hidden: HiddenJaw,
    /// Depth of the last tip, mm, and its capture time, ns.
    last: Option<([f64; 3], i64)>,
    /// Capture times, ns, and positions, px, of the last tips.
    observations: VecDeque<(i64, [f64; 2])>,
    time: RealTime,
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
    /// Capture time of the picture in which it was found, ns.
    found_ns: i64,
    /// Score of the tool, and when it was found, ns.
    score: f32,
    scored_ns: i64,
}

impl LastBox {
    /// Score of the tool now.
    fn score_at(&self, now_ns: i64) -> f32 {
        self.score * 0.5_f32.powf(now_ns.saturating_sub(self.scored_ns).max(0) as f32 * 1e-9 / HALF_S)
    }
}

/// Time in which the score of a tool that is found in weak boxes only halves, s.
const HALF_S: f32 = 0.5;
/// Overlap from which boxes of different classes count as one tool.
const SAME_TOOL_IOU: f32 = 0.5;
/// Overlap from which a box counts as the last leading box's tool.
const STILL_IOU: f32 = 0.35;
/// Shares of the picture's width: a tip nearer to the border than the first is where a tool leaves the picture; a box at the border thinner than the
/// second shows a shaft that crosses it.
const BORDER_SHARE: f64 = 0.01;
const STRIP_SHARE: f32 = 0.06;
/// Most boxes that are tried until one has its tip in the picture.
const MAX_TRIES: usize = 4;
/// Ticks within which the leading tool may return with another number.
const MEMORY_TICKS: u32 = 15;

fn corners_of(d: &Detection) -> [f32; 4] {
    [d.x_px, d.y_px, d.x_px + d.width_px, d.y_px + d.height_px]
}

fn moved([x0, y0, x1, y1]: [f32; 4], [dx, dy]: [f32; 2]) -> [f32; 4] {
    [x0 + dx, y0 + dy, x1 + dx, y1 + dy]
}

impl Leading {
    /// Score that a box is this tool: it has the tool's number, or is where the tool was and was not another tool then. Detectors that change a
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

/// Fewest depth values around the tip for a position in space.
const MIN_VALUES: usize = 6;

/// Largest multiple of the radius within which a mask's own depth is searched.
const WIDER: usize = 8;
/// Number of tips stored for late boxes.
const MAX_OBSERVATIONS: usize = 16;
/// Range of depths in which an end is searched in the other view, mm.
const REACH_MM: (f64, f64) = (20.0, 250.0);
/// Largest difference of depth between two jaws of one instrument, mm.
const JAWS_MM: f64 = 10.0;
/// Largest distance of the ends of open jaws from their middle, mm, and time for which it is stored while one jaw hides the other, ns.
const MAX_HALF_MM: f64 = 12.0;
const HALF_NS: i64 = 2_000_000_000;
/// Time in which the stored opening halves while the jaws are seen nearer together, ns.
const HALF_FADES_NS: f64 = 0.7e9;
/// Largest age of the last tip that decides which jaw is in view, ns.
const LAST_NS: i64 = 200_000_000;

/// Depth or disparity of the left view.
struct Space<'a> {
    depth: Option<View<'a, f32>>,
    disparity: Option<View<'a, f32>>,
    /// Disparity times depth, px mm; NaN without calibration.
    focal_baseline: f64,
}

impl Space<'_> {
    /// Columns and rows.
    fn size(&self) -> Option<(usize, usize)> {
        self.depth.as_ref().or(self.disparity.as_ref()).map(|view| (view.width, view.height))
    }

    /// Depth at a pixel, mm; NaN where unknown.
    fn depth_mm(&self, x: usize, y: usize) -> f32 {
        match (&self.depth, &self.disparity) {
            (Some(view), _) => view.row(y)[x],
            (None, Some(view)) => (self.focal_baseline / f64::from(view.row(y)[x])) as f32,
            (None, None) => f32::NAN,
        }
    }
}

impl Nearness for Space<'_> {
    fn extend_row(&self, y: usize, columns: Range<usize>, values: &mut Vec<f32>) {
        match (&self.depth, &self.disparity) {
            (_, Some(view)) => values.extend_from_slice(&view.row(y)[columns]),
            (Some(view), None) => values.extend(view.row(y)[columns].iter().map(|depth_mm| 1.0 / depth_mm)),
            (None, None) => values.extend(columns.map(|_| f32::NAN)),
        }
    }
}

impl ToolTip {
    /// Movement of the tip since boxes of this age were found, px; 0 where it is unknown.
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

    /// Depth of the middle of open jaws of which one end is seen at `z_mm`, mm. Jaws that open along the viewing direction hide each other, and the
    /// tip would jump to the nearer one. Returns the depth nearer to the last tip's.
    fn middle_mm(&self, z_mm: f64, now_ns: i64) -> f64 {
        let is_recent = |at_ns: i64, longest_ns: i64| (0..=longest_ns).contains(&now_ns.saturating_sub(at_ns));
        let half = self.half.filter(|(_, at_ns)| is_recent(*at_ns, HALF_NS));
        let last = self.last.filter(|(_, at_ns)| is_recent(*at_ns, LAST_NS));
        match (half, last) {
            (Some((half, _)), Some((last, _))) if (z_mm + half - last[2]).abs() < (z_mm - last[2]).abs() => z_mm + half,
            _ => z_mm,
        }
    }

    /// The tip of the instrument in a box, if it can be segmented.
    fn cut_tip(&mut self, corners: [f32; 4], cues: &Cues<'_>) -> Option<TipPixel> {
        let is_cut = self.silhouette.cut(corners, cues);
        let (width, height) = cues.size;
        let towards = self.silhouette.is_by_colour().then(|| direction_of_box(corners, width, height));
        let tip = is_cut.then(|| self.finder.of_mask_towards(self.silhouette.mask(), towards)).flatten();
        tip.map(|tip| self.silhouette.place(tip))
    }

    /// Median depth of the tool around the tip: the nearer surface, because a tool is in front of the tissue.
    fn depth_at(
        near: &mut Vec<f32>,
        at: (f64, f64),
        radius: usize,
        size: (usize, usize),
        depth_of: &dyn Fn(usize, usize) -> f32,
    ) -> Option<f32> {
        let (u, v, r) = (at.0.round() as isize, at.1.round() as isize, radius as isize);
        near.clear();
        for y in (v - r).max(0)..=(v + r).min(size.1 as isize - 1) {
            for x in (u - r).max(0)..=(u + r).min(size.0 as isize - 1) {
                let z = depth_of(x as usize, y as usize);
                if (x - u).pow(2) + (y - v).pow(2) <= r * r && z.is_finite() && z > 0.0 {
                    near.push(z);
                }
            }
        }
        if near.len() < MIN_VALUES {
            return None;
        }
        near.sort_unstable_by(f32::total_cmp);
        Some(near[near.len() / 4])
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
            near: Vec::new(),
            leading: None,
            finder: TipFinder::default(),
            silhouette: Silhouette::default(),
            second: SecondView::default(),
            kept: None,
            half: None,
            hidden: HiddenJaw::default(),
            last: None,
            observations: VecDeque::with_capacity(MAX_OBSERVATIONS),
            time: RealTime::default(),
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
        let longest_ns = params.max_age_ms * 1e6;
        if age_ns > 0 && (masks.is_some() || self.time.real(age_ns) as f64 > longest_ns) {
            return Ok(());
        }
        let shift = self.shift(now_ns, age_ns);
        let size = found.image_size();
        let picture = input.image.and_then(|image| image.as_plane::<Bgr8>()).map(|image| image.view());
        if let Some(view) = picture.as_ref().filter(|view| (view.width, view.height) != size) {
            return Err(error!(
                "`image` is {}x{}, tools were found in a picture of {}x{}: wire the picture that was searched",
                view.width, view.height, size.0, size.1
            ));
        }
        let right = input.right.and_then(|image| image.as_plane::<Bgr8>()).map(|image| image.view());
        if let Some(view) = right.as_ref().filter(|view| (view.width, view.height) != size) {
            return Err(error!(
                "`right` is {}x{}, tools were found in a picture of {}x{}: wire the other view of the same pair",
                view.width, view.height, size.0, size.1
            ));
        }
        let items = found.items();
        let class_of = |d: &Detection| {
            if found.label(d.class_index) == UNKNOWN { UNKNOWN_CLASS } else { d.class_index }
        };
        let is_wanted = |d: &Detection| params.class.is_empty() || found.label(d.class_index) == params.class;
        let score = |d: &Detection| if params.class.is_empty() { sureness(d, items) } else { d.score };
        let leading = self.leading.take().filter(|leading| leading.missed <= MEMORY_TICKS);
        let claim = |d: &Detection| leading.as_ref().map_or(0, |leading| leading.claims(d));
        // The leading tool keeps leading while it is seen; otherwise the one with the highest score leads.
        let order = |(_, a): &(usize, &Detection), (_, b): &(usize, &Detection)| {
            claim(a).cmp(&claim(b)).then(score(a).total_cmp(&score(b))).then(a.score.total_cmp(&b.score))
        };
        let space = Space {
            depth: input.depth.as_ref().map(|plane| plane.view()),
            disparity: input.disparity.as_ref().map(|plane| plane.view()),
            focal_baseline: input.calibration.as_ref().map_or(f64::NAN, |c| c.left_projection[0] * c.baseline_mm),
        };
        let depth_size = space.size();
        let mask_of = |item: usize| masks.map(|m| Mask::new(m.mask(item), size.0, size.1));
        let is_inside = |tip: &End| {
            let (x, y) = (tip.u_px.min(size.0 as f64 - 1.0 - tip.u_px), tip.v_px.min(size.1 as f64 - 1.0 - tip.v_px));
            x.min(y) >= BORDER_SHARE * size.0 as f64
        };
        let is_strip = |d: &Detection| {
            let [x0, y0, x1, y1] = corners_of(d);
            let (width, height) = (size.0 as f32, size.1 as f32);
            let thin = STRIP_SHARE * width;
            (x1 - x0 < thin && (x0 < 2.0 || x1 > width - 2.0)) || (y1 - y0 < thin && (y0 < 2.0 || y1 > height - 2.0))
        };
        let has_depth = depth_size == Some(size);
        let cues = Cues { size, picture, nearness: has_depth.then_some(&space as &dyn Nearness) };
        let kept = self
            .kept
            .take()
            .filter(|kept| (0.0..=longest_ns).contains(&(self.time.real(now_ns - kept.found_ns) as f64)));
        // A tool that ends at the picture's border has its tip outside, as boxes of shafts at the border do.
        let mut tried = [usize::MAX; MAX_TRIES];
        let (mut is_cut, mut best) = (false, None);
        for try_number in 0..MAX_TRIES {
            let wanted = items.iter().enumerate().filter(|(index, _)| !tried.contains(index));
            let least = |d: &Detection| {
                if claim(d) > 0 && kept.is_some() { params.keep_score.min(params.min_score) } else { params.min_score }
            };
            let next = wanted.filter(|(_, d)| is_wanted(d) && !is_strip(d) && score(d) >= least(d)).max_by(order);
            let Some((index, item)) = next else { break };
            tried[try_number] = index;
            let corners = moved(corners_of(item), shift);
            let mut tip = mask_of(index).and_then(|mask| self.finder.of_mask(mask));
            is_cut = false;
            if tip.is_none() {
                tip = self.cut_tip(corners, &cues);
                is_cut = tip.is_some();
            }
            // Only an old box: it shows where the tool was.
            let Some(tip) = tip.or_else(|| (age_ns == 0).then(|| tip_of_box(corners, size.0, size.1))) else {
                continue;
            };
            if is_inside(&tip.tip) {
                best = Some((index, *item, tip));
                break;
            }
        }
        let is_found = best.is_some();
        // Where the detector finds another tool now, the picture would show that one.
        let is_taken = |kept: &LastBox| {
            let own = corners_of(&kept.item);
            items.iter().any(|d| claim(d) == 0 && iou(&corners_of(d), &own) >= STILL_IOU)
        };
        if let Some(kept) = kept.as_ref().filter(|kept| !is_found && masks.is_none() && !is_taken(kept)) {
            // The detector misses it, but the picture may show it.
            let shift = self.shift(now_ns, now_ns - kept.found_ns);
            best = self.cut_tip(moved(corners_of(&kept.item), shift), &cues).filter(|tip| is_inside(&tip.tip)).map(
                |tip| {
                    is_cut = true;
                    (usize::MAX, kept.item, tip)
                },
            );
        }
        let Some((index, item, TipPixel { tip, jaws })) = best else {
            self.leading = leading.map(|leading| Leading { missed: leading.missed + 1, ..leading });
            self.kept = kept;
            return Ok(());
        };
        let class_index = class_of(&item);
        let is_same = leading.as_ref().is_some_and(|leading| leading.claims(&item) > 0);
        let called = leading.as_ref().filter(|_| is_same).map_or(item.track_id, |l| l.called);
        let box_score = if is_found { score(&item) } else { 0.0 };
        let before =
            kept.as_ref().filter(|_| is_cut && (is_same || !is_found)).map_or(0.0, |kept| kept.score_at(now_ns));
        let sure = if box_score >= params.min_score { box_score } else { box_score.max(before) };
        let found_ns = if is_found { found.tick().capture_ns } else { kept.map_or(now_ns, |kept| kept.found_ns) };
        self.kept = Some(LastBox { item, found_ns, score: sure, scored_ns: now_ns });
        if is_found {
            let corners = corners_of(&item);
            let mut others = [-1; 16];
            let beside = items.iter().filter(|d| d.track_id >= 0 && iou(&corners_of(d), &corners) < STILL_IOU);
            others.iter_mut().zip(beside).for_each(|(other, d)| *other = d.track_id);
            self.leading = Some(Leading { called, number: item.track_id, corners, others, missed: 0 });
        } else {
            self.leading = leading.map(|leading| Leading { missed: leading.missed + 1, ..leading });
        }
        let (mut u_px, mut v_px) = (tip.u_px, tip.v_px);
        let mut xyz_mm = [f64::NAN; 3];
        let mut valid = false;
        if let (Some(calibration), Some(depth_size)) = (&input.calibration, depth_size) {
            let p = &calibration.left_projection;
            let depth_of = |x: usize, y: usize| space.depth_mm(x, y);
            let masks = masks.filter(|_| depth_size == size);
            let of = |item: usize, x: usize, y: usize| {
                masks.is_some_and(|m| Mask::new(m.mask(item), size.0, size.1).contains(x, y))
            };
            let (silhouette, is_masked) = (&self.silhouette, masks.is_some());
            // Where the tool's pixels are known, other surfaces are ignored.
            let own_depth = |x: usize, y: usize| {
                let own = if is_masked { of(index, x, y) } else { !is_cut || silhouette.contains(x, y) };
                if own { depth_of(x, y) } else { f32::NAN }
            };
            // Depth that a matcher took from the surface behind a thin end is ignored too, unless there is no other.
            let clear_depth = |x: usize, y: usize| {
                if is_cut && silhouette.has_surface_depth(x, y) { f32::NAN } else { own_depth(x, y) }
            };
            let others = |x: usize, y: usize| (0..found.items().len()).any(|other| other != index && of(other, x, y));
            let widest = if is_masked || is_cut { WIDER } else { 1 };
            let focal_baseline = p[0] * calibration.baseline_mm;
            let (second, near) = (&mut self.second, &mut self.near);
            let views = picture.as_ref().zip(right.as_ref()).filter(|_| is_cut);
            let ends = jaws.as_ref().map_or(std::slice::from_ref(&tip), |jaws| &jaws[..]);
            let mut depths: [Option<f64>; 2] = [None; 2];
            for (depth, end) in depths.iter_mut().zip(ends) {
                let seen = views.and_then(|(left, right)| {
                    let range = (focal_baseline / REACH_MM.1, focal_baseline / REACH_MM.0);
                    second.disparity(end, silhouette, [left, right], range)
                });
                *depth = seen.map(|disparity| focal_baseline / disparity);
            }
            let known_mm = depths.iter().flatten().copied().next();
            for (depth, end) in depths.iter_mut().zip(ends).filter(|(depth, _)| depth.is_none()) {
                // Searched a little inside the tool: at its end half of the pixels are tissue.
                let step = params.radius_px as f64 / 2.0;
                let inside = (end.u_px - end.direction[0] * step, end.v_px - end.direction[1] * step);
                let mut within = |depth_of: &dyn Fn(usize, usize) -> f32| {
                    let mut radii = (1..=widest).map(|times| times * params.radius_px);
                    radii.find_map(|radius| Self::depth_at(near, inside, radius, depth_size, depth_of))
                };
                // Where both views were compared, no position is better than one that may be the tissue's.
                let z = within(&clear_depth).or_else(|| if views.is_none() { within(&own_depth) } else { None });
                let z = z.map(f64::from);
                // A jaw is near the other one, whose depth was found in both views.
                *depth = z.filter(|z| known_mm.is_none_or(|known| (z - known).abs() <= JAWS_MM));
            }
            if let [Some(one), Some(two)] = depths
                && let [a, b] = ends
                && views.is_some()
            {
                let at = |end: &End, z: f64| [(end.u_px - p[2]) / p[0] * z, (end.v_px - p[6]) / p[5] * z, z];
                let apart = at(a, one).iter().zip(at(b, two)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
                // Just before one jaw hides the other, both ends seem to be the nearer one: the stored opening decays slowly.
                let faded = self.half.map_or(0.0, |(half, at_ns)| {
                    half * 0.5_f64.powf(now_ns.saturating_sub(at_ns).max(0) as f64 / HALF_FADES_NS)
                });
                self.half = Some(((apart / 2.0).max(faded), now_ns)).filter(|(half, _)| *half <= MAX_HALF_MM);
            }
            let lens = Lens { focal_px: [p[0], p[5]], centre_px: [p[2], p[6]] };
            let is_own = |x: usize, y: usize| of(index, x, y);
            let has_others = items.len() > 1;
            let pixels =
                Pixels { size: depth_size, depth_mm: &depth_of, is_own: &is_own, is_other: &others, has_others };
            let known = ends.iter().zip(depths).map(|(end, depth)| {
                let z = depth?;
                let at_mm = Vector3::new((end.u_px - p[2]) / p[0] * z, (end.v_px - p[6]) / p[5] * z, z);
                let is_hidden = pixels.is_hidden((end.u_px, end.v_px), z as f32, params.radius_px);
                Some(KnownEnd { at_mm, is_hidden })
            });
            let mut known_ends = [KnownEnd::default(); 2];
            let mut count = 0;
            for end in known.flatten() {
                known_ends[count] = end;
                count += 1;
            }
            let known_ends = &known_ends[..count];
            // The apparent end is where another instrument hides the tool: no tip is better than a wrong one.
            if count > 0 && known_ends.iter().all(|end| end.is_hidden) {
                return out.hidden.set(Tip {
                    u_px,
                    v_px,
                    xyz_mm,
                    score: f64::from(sure),
                    class_index,
                    xyz_valid: 0,
                    track_id: called,
                });
            }
            let middle = if count == ends.len() && is_masked && !is_cut {
                self.hidden.middle(now_ns, called, known_ends, &mut self.finder, &lens, params.radius_px, &pixels)
            } else {
                None
            };
            if let Some(middle) = middle {
                xyz_mm = middle.into();
                (u_px, v_px) = lens.pixel(&middle);
            } else if count > 1 {
                // Between jaws the middle in space, which is not exactly the middle in the picture.
                let middle = (known_ends[0].at_mm + known_ends[1].at_mm) / 2.0;
                xyz_mm = middle.into();
                (u_px, v_px) = lens.pixel(&middle);
            } else if let [end] = known_ends {
                let z = if views.is_some() { self.middle_mm(end.at_mm.z, now_ns) } else { end.at_mm.z };
                xyz_mm = [(u_px - p[2]) / p[0] * z, (v_px - p[6]) / p[5] * z, z];
            }
            valid = xyz_mm.iter().all(|v| v.is_finite()) && u_px.is_finite() && v_px.is_finite();
        }
        if valid {
            self.last = Some((xyz_mm, now_ns));
        }
        if self.observations.len() == MAX_OBSERVATIONS {
            self.observations.pop_front();
        }
        self.observations.push_back((now_ns, [tip.u_px, tip.v_px]));
        out.tip.set(Tip {
            u_px,
            v_px,
            xyz_mm,
            score: f64::from(sure),
            class_index,
            xyz_valid: u32::from(valid),
            track_id: called,
        })
    }
}
