//! `tool_tip`: the leading tool's tip, in the picture and, where depth is known, in space (thesis, chapter 6).

use std::collections::VecDeque;

use panoscope_node::abi::{Calibration, Detection, Tip};
use panoscope_node::{
    AnyImage, Bgr8, Context, Depth, Detections, Disparity, Image, Instances, Node, NodeInfo, Open, Params, Ports,
    Result, Slot, Validation, Value, View, error,
};

use crate::candidates::iou;
use crate::second_view::SecondView;
use crate::shaft::{End, Mask, TipFinder, TipPixel, tip_of_box};
use crate::silhouette::{Cues, Silhouette};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Boxes of tools in the left rectified view. Those of a detector that is slower than the camera, wired with `align = "latest"`, are moved with
    /// the tip, and the tool is cut out of them in the picture of this tick: a tip is as new as `image`, not as its box.
    detections: Option<Detections<'f>>,
    /// Tools with masks: preferred to boxes.
    instances: Option<Instances<'f>>,
    /// The picture that boxes were found in, bgr8: with it, or with depth, the tool is cut out of its box and its end found there; without both the
    /// tip is where the box ends, off by half the box's width.
    image: Option<AnyImage<'f>>,
    /// The right rectified view of the same tick, bgr8: an end that is cut out of its box has the depth at which both views show it. Ends are
    /// often thinner than a matcher's window, whose depth there is the tissue's.
    right: Option<AnyImage<'f>>,
    /// Depth of the left rectified view, for the place in space.
    depth: Option<Image<'f, Depth>>,
    /// Disparity of the left rectified view, where no depth is connected. Best as a matcher gives it: filters fill what was not matched, and so mix
    /// a thin end with the tissue behind it.
    disparity: Option<Image<'f, Disparity>>,
    /// Calibration of the rectified views, for the place in space.
    calibration: Option<Value<'f, Calibration>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// The leading tool's tip; empty when no tool is found, or when masks and depth show that another tool stands before its end.
    tip: Slot<'f, Tip>,
}

/// Parameters.
#[derive(Params)]
pub struct ToolTipParams {
    /// Name of the class to follow; empty takes any.
    #[param(default = "")]
    class: String,
    /// Lowest score of a tool. Where any class will do, boxes of several classes around one tool count together: they say what it may be, and
    /// their sum how sure it is that it is one.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f32,
    /// The same of the tool that led before, while boxes overlap: a weak box where a tool was sure to be is of that tool (after Zhang et al. 2022,
    /// ByteTrack).
    #[param(default = 0.1, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    keep_score: f32,
    /// Radius around the tip in which depth is looked for.
    #[param(default = 6, range = 1..=64, unit = "px")]
    radius_px: usize,
    /// Oldest boxes in which a tool is looked for, and how long one is remembered where the detector finds none.
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
    kept: Option<Kept>,
    /// How far both ends of open jaws lie from the middle between them, mm, and when that was seen.
    half: Option<(f64, i64)>,
    /// Place of the last tip from the camera, mm, and when it was there.
    last: Option<([f64; 3], i64)>,
    /// Capture times and places of the last tips, px.
    sights: VecDeque<(i64, [f64; 2])>,
}

/// The tool that led last.
struct Leading {
    /// The number that it is called by, and the one that the detector gave it last.
    called: i64,
    number: i64,
    corners: [f32; 4],
    /// Numbers of other tools that were seen beside it then.
    others: [i64; 16],
    /// Ticks since.
    missed: u32,
}

/// The box of the tool that led last.
struct Kept {
    item: Detection,
    /// Capture time of the picture that it was found in.
    found_ns: i64,
    /// How sure the tool was, and when.
    score: f32,
    scored_ns: i64,
}

impl Kept {
    /// How sure the tool still is.
    fn score_at(&self, now_ns: i64) -> f32 {
        self.score * 0.5_f32.powf(now_ns.saturating_sub(self.scored_ns).max(0) as f32 * 1e-9 / HALF_S)
    }
}

/// Time in which a tool that is cut out of weak boxes is half as sure, s.
const HALF_S: f32 = 0.5;
/// Overlap from which on boxes of different classes are thought to be of one tool.
const SAME_TOOL_IOU: f32 = 0.5;
/// The same for a box and the one that led before.
const STILL_IOU: f32 = 0.35;
/// A tip nearer to the picture's border than this share of its width is where a tool leaves it, and a box at the border that is no thicker than the
/// other share shows a shaft that crosses it.
const BORDER_SHARE: f64 = 0.01;
const STRIP_SHARE: f32 = 0.06;
/// Boxes that are tried until one has its tip in the picture.
const MOST_TRIES: usize = 4;
/// Ticks for which a tool that led may come back under another number.
const MEMORY_TICKS: u32 = 15;

fn corners_of(d: &Detection) -> [f32; 4] {
    [d.x_px, d.y_px, d.x_px + d.width_px, d.y_px + d.height_px]
}

fn moved([x0, y0, x1, y1]: [f32; 4], [dx, dy]: [f32; 2]) -> [f32; 4] {
    [x0 + dx, y0 + dy, x1 + dx, y1 + dy]
}

impl Leading {
    /// How surely a box is of this tool: it has its number, or stands where it stood, and was no other tool then. Detectors that are in two minds
    /// about a tool's class give it a new number whenever they change it.
    fn claims(&self, item: &Detection) -> u8 {
        if item.track_id >= 0 && item.track_id == self.number {
            return 2;
        }
        let is_other = self.others.contains(&item.track_id);
        u8::from(item.track_id >= 0 && !is_other && iou(&corners_of(item), &self.corners) >= STILL_IOU)
    }
}

/// How sure it is that a box is of a tool, of whatever class.
fn sureness(item: &Detection, items: &[Detection]) -> f32 {
    let own = corners_of(item);
    let mut sum = item.score;
    for (index, other) in items.iter().enumerate() {
        let is_same = |d: &Detection| iou(&corners_of(d), &own) >= SAME_TOOL_IOU;
        let is_first = || {
            let before = items[..index].iter();
            !before.filter(|d| d.class_index == other.class_index).any(is_same)
        };
        // Best first: one word per class.
        if other.class_index != item.class_index && is_same(other) && is_first() {
            sum += other.score;
        }
    }
    sum.min(1.0)
}

/// Depth values needed around the tip for a place to be trusted.
const MIN_VALUES: usize = 6;

/// Times the radius within which a mask's own depth is looked for at most.
const WIDER: usize = 8;
/// Tips that are remembered for boxes that come late.
const MOST_SIGHTS: usize = 16;
/// Between these distances an end is looked for in the other view, mm.
const REACH_MM: (f64, f64) = (20.0, 250.0);
/// Most that the depths of two jaws of one instrument differ, mm.
const JAWS_MM: f64 = 10.0;
/// How far the ends of open jaws may lie from their middle, mm, and for how long that is remembered while one jaw hides the other, ns.
const MOST_HALF_MM: f64 = 12.0;
const HALF_NS: i64 = 2_000_000_000;
/// Time in which jaws that are seen nearer together are thought to have closed by half, ns.
const HALF_FADES_NS: f64 = 0.7e9;
/// How old the last tip may be that tells which jaw is in view, ns.
const LAST_NS: i64 = 200_000_000;
/// How much nearer than a tip something has to stand to hide it, mm.
const BEFORE_MM: f32 = 1.0;
/// Share of the pixels around a tip that another instrument has to take, to be what hides it.
const HIDING_SHARE: f32 = 0.12;

/// Whether another instrument, of which `other` tells the pixels, stands around a tip and before it.
fn is_behind(
    at: (f64, f64),
    z_mm: f32,
    radius: usize,
    size: (usize, usize),
    depth_of: impl Fn(usize, usize) -> f32,
    other: &dyn Fn(usize, usize) -> bool,
) -> bool {
    let (u, v, r) = (at.0.round() as isize, at.1.round() as isize, radius as isize);
    let (mut all, mut before) = (0.0, 0.0);
    for y in (v - r).max(0)..=(v + r).min(size.1 as isize - 1) {
        for x in (u - r).max(0)..=(u + r).min(size.0 as isize - 1) {
            if (x - u).pow(2) + (y - v).pow(2) <= r * r {
                let (x, y) = (x as usize, y as usize);
                all += 1.0;
                before += f32::from(u8::from(depth_of(x, y) < z_mm - BEFORE_MM && other(x, y)));
            }
        }
    }
    before > HIDING_SHARE * all
}

/// What is known of depth.
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

    /// mm; NaN where unknown.
    fn depth_mm(&self, x: usize, y: usize) -> f32 {
        match (&self.depth, &self.disparity) {
            (Some(view), _) => view.row(y)[x],
            (None, Some(view)) => (self.focal_baseline / f64::from(view.row(y)[x])) as f32,
            (None, None) => f32::NAN,
        }
    }

    /// Grows as 1/depth does, in whatever unit.
    fn nearness(&self, x: usize, y: usize) -> f32 {
        match (&self.depth, &self.disparity) {
            (_, Some(view)) => view.row(y)[x],
            (Some(view), None) => 1.0 / view.row(y)[x],
            (None, None) => f32::NAN,
        }
    }
}

impl ToolTip {
    /// How far the tip has moved since boxes of this age were found, px; nothing where that is not known.
    fn shift(&mut self, now_ns: i64, age_ns: i64) -> [f32; 2] {
        if self.sights.back().is_some_and(|(newest_ns, _)| *newest_ns > now_ns) {
            // Time went back.
            self.sights.clear();
        }
        let seen_ns = now_ns.saturating_sub(age_ns);
        let then = self.sights.iter().min_by_key(|(sight_ns, _)| sight_ns.abs_diff(seen_ns));
        match (then, self.sights.back()) {
            (Some((_, then)), Some((_, last))) if age_ns > 0 => {
                [(last[0] - then[0]) as f32, (last[1] - then[1]) as f32]
            }
            _ => [0.0; 2],
        }
    }

    /// Depth of the middle of open jaws of which one end is seen at `z_mm`: jaws that open along the line of sight hide each other, and the tip seems
    /// to jump to the nearer one. Of both depths the one counts that is nearer to the last tip's; mm.
    fn middle_mm(&self, z_mm: f64, now_ns: i64) -> f64 {
        let is_recent = |at_ns: i64, longest_ns: i64| (0..=longest_ns).contains(&now_ns.saturating_sub(at_ns));
        let half = self.half.filter(|(_, at_ns)| is_recent(*at_ns, HALF_NS));
        let last = self.last.filter(|(_, at_ns)| is_recent(*at_ns, LAST_NS));
        match (half, last) {
            (Some((half, _)), Some((last, _))) if (z_mm + half - last[2]).abs() < (z_mm - last[2]).abs() => z_mm + half,
            _ => z_mm,
        }
    }

    /// The tip of the instrument in a box, if it can be told from what surrounds it.
    fn cut_tip(&mut self, corners: [f32; 4], cues: &Cues<'_>) -> Option<TipPixel> {
        let is_cut = self.silhouette.cut(corners, cues);
        let tip = is_cut.then(|| self.finder.of_mask(self.silhouette.mask())).flatten();
        tip.map(|tip| self.silhouette.place(tip))
    }

    /// Median depth of what lies around the tip on the tool: the nearer surface, since a tool stands before the tissue.
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
            last: None,
            sights: VecDeque::with_capacity(MOST_SIGHTS),
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &ToolTipParams) -> Result<()> {
        let masks = input.instances;
        // Empty on ticks that the detector, slower than the camera, left out.
        let Some(found) = masks.map(|m| m.detections()).or(input.detections) else { return Ok(()) };
        let now_ns = cx.tick().capture_ns;
        let age_ns = now_ns.saturating_sub(found.tick().capture_ns).max(0);
        // Outlines cannot be moved to another picture, and boxes only so far.
        if age_ns > 0 && (masks.is_some() || age_ns as f64 > params.max_age_ms * 1e6) {
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
        let is_wanted = |d: &Detection| params.class.is_empty() || found.label(d.class_index) == params.class;
        let score = |d: &Detection| if params.class.is_empty() { sureness(d, items) } else { d.score };
        let leading = self.leading.take().filter(|leading| leading.missed <= MEMORY_TICKS);
        let claim = |d: &Detection| leading.as_ref().map_or(0, |leading| leading.claims(d));
        // The tool that led before goes on leading while it is seen; else the surest one.
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
        let nearness = |x: usize, y: usize| space.nearness(x, y);
        let has_depth = depth_size == Some(size);
        let cues = Cues { size, picture, nearness: if has_depth { Some(&nearness) } else { None } };
        let kept = self
            .kept
            .take()
            .filter(|kept| (0.0..=params.max_age_ms * 1e6).contains(&((now_ns - kept.found_ns) as f64)));
        // A tool whose end lies at the picture's border has its tip elsewhere: boxes of shafts at the border are of this kind.
        let mut tried = [usize::MAX; MOST_TRIES];
        let (mut is_cut, mut best) = (false, None);
        for try_number in 0..MOST_TRIES {
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
            // An old box alone says where the tool was.
            let Some(tip) = tip.or_else(|| (age_ns == 0).then(|| tip_of_box(corners, size.0, size.1))) else {
                continue;
            };
            if is_inside(&tip.tip) {
                best = Some((index, *item, tip));
                break;
            }
        }
        let is_found = best.is_some();
        // Where the detector sees another tool now, that is what the picture would show.
        let is_taken = |kept: &Kept| {
            let own = corners_of(&kept.item);
            items.iter().any(|d| claim(d) == 0 && iou(&corners_of(d), &own) >= STILL_IOU)
        };
        if let Some(kept) = kept.as_ref().filter(|kept| !is_found && masks.is_none() && !is_taken(kept)) {
            // The detector misses it; the picture may show it all the same.
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
        let is_same = leading.as_ref().is_some_and(|leading| leading.claims(&item) > 0);
        let called = leading.as_ref().filter(|_| is_same).map_or(item.track_id, |l| l.called);
        let box_score = if is_found { score(&item) } else { 0.0 };
        let before =
            kept.as_ref().filter(|_| is_cut && (is_same || !is_found)).map_or(0.0, |kept| kept.score_at(now_ns));
        let sure = if box_score >= params.min_score { box_score } else { box_score.max(before) };
        let found_ns = if is_found { found.tick().capture_ns } else { kept.map_or(now_ns, |kept| kept.found_ns) };
        self.kept = Some(Kept { item, found_ns, score: sure, scored_ns: now_ns });
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
            // Where the tool's pixels are known, no other surface counts.
            let own_depth = |x: usize, y: usize| {
                let own = if is_masked { of(index, x, y) } else { !is_cut || silhouette.contains(x, y) };
                if own { depth_of(x, y) } else { f32::NAN }
            };
            // Nor does what a matcher took from the surface behind a thin end, unless nothing else is known.
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
                // Looked for a little inside the tool: at its very end half of the pixels are tissue.
                let step = params.radius_px as f64 / 2.0;
                let inside = (end.u_px - end.direction[0] * step, end.v_px - end.direction[1] * step);
                let mut within = |depth_of: &dyn Fn(usize, usize) -> f32| {
                    let mut radii = (1..=widest).map(|times| times * params.radius_px);
                    radii.find_map(|radius| Self::depth_at(near, inside, radius, depth_size, depth_of))
                };
                // Where both views were looked at, no place is better than one that may be the tissue's.
                let z = within(&clear_depth).or_else(|| if views.is_none() { within(&own_depth) } else { None });
                let z = z.map(f64::from);
                // A jaw stands near the other one, whose depth both views showed.
                *depth = z.filter(|z| known_mm.is_none_or(|known| (z - known).abs() <= JAWS_MM));
            }
            if let [Some(one), Some(two)] = depths
                && let [a, b] = ends
                && views.is_some()
            {
                let at = |end: &End, z: f64| [(end.u_px - p[2]) / p[0] * z, (end.v_px - p[6]) / p[5] * z, z];
                let apart = at(a, one).iter().zip(at(b, two)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
                // Just before one jaw hides the other both ends are taken for the nearer one: what was seen before fades slowly.
                let faded = self.half.map_or(0.0, |(half, at_ns)| {
                    half * 0.5_f64.powf(now_ns.saturating_sub(at_ns).max(0) as f64 / HALF_FADES_NS)
                });
                self.half = Some(((apart / 2.0).max(faded), now_ns)).filter(|(half, _)| *half <= MOST_HALF_MM);
            }
            let (mut sum, mut count, mut hidden) = ([0.0; 3], 0.0, 0.0);
            for (End { u_px, v_px, .. }, depth) in ends.iter().zip(depths) {
                let Some(z) = depth else { continue };
                hidden += f64::from(u8::from(is_behind(
                    (*u_px, *v_px),
                    z as f32,
                    params.radius_px,
                    depth_size,
                    depth_of,
                    &others,
                )));
                let place = [(u_px - p[2]) / p[0] * z, (v_px - p[6]) / p[5] * z, z];
                sum.iter_mut().zip(place).for_each(|(sum, v)| *sum += v);
                count += 1.0;
            }
            // What seems its end is where another instrument hides it: no tip is better than a wrong one. Of two jaws one still tells about where.
            if count > 0.0 && hidden == count {
                return Ok(());
            }
            if count > 1.0 {
                // Between jaws the middle in space, which is seen a little beside the middle in the picture.
                xyz_mm = sum.map(|v| v / count);
                (u_px, v_px) = (p[0] * xyz_mm[0] / xyz_mm[2] + p[2], p[5] * xyz_mm[1] / xyz_mm[2] + p[6]);
            } else if count > 0.0 {
                let z = if views.is_some() { self.middle_mm(sum[2], now_ns) } else { sum[2] };
                xyz_mm = [(u_px - p[2]) / p[0] * z, (v_px - p[6]) / p[5] * z, z];
            }
            valid = xyz_mm.iter().all(|v| v.is_finite()) && u_px.is_finite() && v_px.is_finite();
        }
        if valid {
            self.last = Some((xyz_mm, now_ns));
        }
        if self.sights.len() == MOST_SIGHTS {
            self.sights.pop_front();
        }
        self.sights.push_back((now_ns, [tip.u_px, tip.v_px]));
        out.tip.set(Tip {
            u_px,
            v_px,
            xyz_mm,
            score: f64::from(sure),
            class_index: item.class_index,
            xyz_valid: u32::from(valid),
            track_id: called,
        })
    }
}
