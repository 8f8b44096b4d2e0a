//! `proximity`: distances of tips to tissue and to each other, and warnings of both (thesis, section 1.2.3).

use std::fmt::Write;
use std::ops::Range;
use std::time::Duration;

use panoscope_arm_core::tracking::proximity::{Hysteresis, Lens, Rule, Surface};
use panoscope_arm_core::tracking::real_time::RealTime;
use panoscope_node::abi::{Calibration, Tip};
use panoscope_node::{
    AnyImage, Bgr8, Cloud, Context, Depth, Detections, Image, Instances, List, Mask, Node, NodeInfo, Open, Params,
    Ports, Result, Slot, TableData, TextPacket, Value, error,
};

use crate::silhouette::{Cues, Nearness, Silhouette};

/// Input ports of `proximity`.
#[derive(Ports)]
pub struct In<'f> {
    /// Tips in the left rectified camera's frame, mm, one per tool: two detections of one tip would count as two touching tips. Warnings follow the
    /// tool's number if it has one, otherwise the input.
    tip: List<'f, Value<'f, Tip>>,
    /// Depth of the left rectified view, mm. Without it `cloud` is used.
    depth: Option<Image<'f, Depth>>,
    /// Points of the left rectified view, mm, one per pixel.
    cloud: Option<Cloud<'f>>,
    /// Calibration of the rectified views.
    calibration: Value<'f, Calibration>,
    /// Masks of the instruments. Connect one of `instances`, `detections` and `mask`.
    instances: Option<Instances<'f>>,
    /// Boxes around instruments, which are segmented by depth, and by colour where `image` is connected.
    detections: Option<Detections<'f>>,
    /// One mask of all instruments.
    mask: Option<Image<'f, Mask>>,
    /// Image in which boxes were found, bgr8.
    image: Option<AnyImage<'f>>,
}

/// Output ports of `proximity`.
#[derive(Ports)]
pub struct Out<'f> {
    /// One row per tip: number and class; pixel and position (mm); distance to the tissue (mm) and pixel of the nearest point; whether that point is
    /// visible or hidden behind an instrument; state: -1 unknown, 0 clear, 1 near, 2 contact; distance to the nearest other tip (mm), its number, and
    /// the state: 0 clear, 1 near; age of the surface (ms). `overlay` draws it.
    table: Slot<'f, TableData>,
    /// The warnings, one per line; empty when there is none.
    text: Slot<'f, TextPacket>,
}

/// Parameters of `proximity`.
#[derive(Params)]
pub struct ProximityParams {
    /// Distance to the tissue below which a tip counts as near.
    #[param(default = 5.0, range = 0.1..=50.0, step = 0.1, unit = "mm")]
    warn_mm: f64,
    /// Distance to the tissue below which a tip counts as touching it.
    #[param(default = 1.0, range = -20.0..=50.0, step = 0.1, unit = "mm")]
    contact_mm: f64,
    /// Distance between tips below which they count as near.
    #[param(default = 8.0, range = 0.1..=100.0, step = 0.1, unit = "mm")]
    tips_mm: f64,
    /// Hysteresis: a warning ends at a distance larger by this than where it begins.
    #[param(default = 1.0, range = 0.0..=20.0, step = 0.1, unit = "mm")]
    release_mm: f64,
    /// Time for which a distance must stay beyond a threshold before a warning begins or ends.
    #[param(default = 60.0, range = 0.0..=5000.0, step = 10.0, unit = "ms")]
    min_ms: f64,
    /// Width of the border around instruments that is not used as tissue, because matchers mix both depths there.
    #[param(default = 6, range = 0..=64, unit = "px")]
    rim_px: usize,
    /// Age after which a surface, or a tip, counts as unknown.
    #[param(default = 300.0, range = 0.0..=10000.0, step = 10.0, unit = "ms")]
    max_age_ms: f64,
}

/// Columns of the table.
pub const COLUMNS: [&str; 16] = [
    "track_id",
    "class_index",
    "u_px",
    "v_px",
    "x_mm",
    "y_mm",
    "z_mm",
    "tissue_mm",
    "tissue_u_px",
    "tissue_v_px",
    "tissue_seen",
    "tissue_state",
    "tip_mm",
    "tip_track_id",
    "tip_state",
    "age_ms",
];

/// Maximum number of tips of one tick that are used.
const MAX_TIPS: usize = 16;
/// Time after which the warnings of a lost tip are dropped, ns.
const MEMORY_NS: i64 = 1_000_000_000;

/// State of the warnings of one tip.
#[derive(Clone, Copy)]
struct Watch {
    key: i64,
    seen_ns: i64,
    near: Hysteresis,
    contact: Hysteresis,
    other: Hysteresis,
}

/// The `proximity` node.
#[derive(Default)]
pub struct Proximity {
    surface: Surface,
    /// Capture time of the depth from which the surface was built, ns.
    surface_ns: Option<i64>,
    time: RealTime,
    silhouette: Silhouette,
    tool: Vec<bool>,
    watches: Vec<Watch>,
    names: String,
    rows: Vec<f64>,
    words: String,
}

/// A tip with known position.
#[derive(Clone, Copy)]
struct Known {
    tip: Tip,
    key: i64,
}

/// Depth by column and row, mm.
struct Depths<'a>(&'a dyn Fn(usize, usize) -> f32);

impl Nearness for Depths<'_> {
    fn extend_row(&self, y: usize, columns: Range<usize>, values: &mut Vec<f32>) {
        values.extend(columns.map(|x| 1.0 / (self.0)(x, y)));
    }
}

fn distance(a: &Tip, b: &Tip) -> f64 {
    a.xyz_mm.iter().zip(b.xyz_mm).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

impl Proximity {
    /// Marks the pixels of instruments; returns false when they are unknown.
    fn mark_tools(
        &mut self,
        input: &In<'_>,
        size: (usize, usize),
        depth_mm: &dyn Fn(usize, usize) -> f32,
    ) -> Result<bool> {
        let check = |what: &str, (width, height): (usize, usize)| {
            if (width, height) == size {
                return Ok(());
            }
            Err(error!(
                "`{what}` belongs to an image of {width}x{height}, but depth is {}x{}: connect both of one view",
                size.0, size.1
            ))
        };
        self.tool.clear();
        self.tool.resize(size.0 * size.1, false);
        let tool = &mut self.tool;
        if let Some(mask) = &input.mask {
            let view = mask.view();
            check("mask", (view.width, view.height))?;
            for (y, row) in tool.chunks_exact_mut(size.0).enumerate() {
                row.iter_mut().zip(view.row(y)).for_each(|(tool, mask)| *tool |= *mask != 0);
            }
        }
        if let Some(instances) = &input.instances {
            let found = instances.detections();
            check("instances", found.image_size())?;
            for index in 0..found.items().len() {
                let mask = instances.mask(index).chunks_exact(size.0.div_ceil(8));
                for (row, bits) in tool.chunks_exact_mut(size.0).zip(mask) {
                    for (at, byte) in bits.iter().enumerate().filter(|(_, byte)| **byte != 0) {
                        for bit in (0..8).filter(|bit| byte >> (7 - bit) & 1 == 1 && at * 8 + bit < size.0) {
                            row[at * 8 + bit] = true;
                        }
                    }
                }
            }
        } else if let Some(found) = &input.detections {
            check("detections", found.image_size())?;
            let picture = input.image.and_then(|image| image.as_plane::<Bgr8>()).map(|image| image.view());
            let picture = picture.filter(|view| (view.width, view.height) == size);
            let cues = Cues { size, picture, nearness: Some(&Depths(depth_mm)) };
            for item in found.items() {
                let corners = [item.x_px, item.y_px, item.x_px + item.width_px, item.y_px + item.height_px];
                let is_cut = self.silhouette.cut(corners, &cues);
                let clip = |v: f32, most: usize| v.clamp(0.0, most as f32) as usize;
                // Without a segmentation the whole box is excluded.
                for y in clip(corners[1], size.1)..clip(corners[3].ceil(), size.1) {
                    for x in clip(corners[0], size.0)..clip(corners[2].ceil(), size.0) {
                        tool[y * size.0 + x] |= !is_cut || self.silhouette.contains(x, y);
                    }
                }
            }
        }
        Ok(input.mask.is_some() || input.instances.is_some() || input.detections.is_some())
    }

    /// Rebuilds the surface when a newer depth has arrived and the instruments' pixels are known.
    fn renew(&mut self, input: &In<'_>, rim_px: usize) -> Result<()> {
        let c = &input.calibration;
        let p = &c.left_projection;
        if !(p[0] > 0.0 && p[5] > 0.0 && (p[0] + p[5] + p[2] + p[6]).is_finite()) {
            return Err(error!("the calibration has focal lengths {}, {} px", p[0], p[5]));
        }
        let lens = Lens { fx: p[0], fy: p[5], cx: p[2], cy: p[6] };
        let mut make = |size: (usize, usize), taken_ns: i64, depth_mm: &dyn Fn(usize, usize) -> f32| -> Result<()> {
            if self.surface_ns == Some(taken_ns) || !self.mark_tools(input, size, depth_mm)? {
                return Ok(());
            }
            let tool = &self.tool;
            self.surface.build(size, lens, rim_px, depth_mm, |x, y| tool[y * size.0 + x]);
            self.surface_ns = Some(taken_ns);
            Ok(())
        };
        if let Some(depth) = &input.depth {
            let view = depth.view();
            make((view.width, view.height), depth.frame().tick.capture_ns, &|x, y| view.row(y)[x])
        } else if let Some(cloud) = &input.cloud {
            let (points, width) = (cloud.points(), cloud.width());
            let depth_mm = |x: usize, y: usize| {
                let point = &points[y * width + x];
                if point.is_measured() { point.z_mm } else { f32::NAN }
            };
            make((width, cloud.height()), cloud.tick().capture_ns, &depth_mm)
        } else {
            Ok(())
        }
    }

    /// Drops what a step back in time makes invalid, and takes the names of new labels.
    fn begin_tick(&mut self, now_ns: i64, input: &In<'_>) {
        if self.surface_ns.is_some_and(|made| made > now_ns) || self.watches.iter().any(|watch| watch.seen_ns > now_ns)
        {
            // Time went backwards.
            self.surface_ns = None;
            self.watches.clear();
        }
        self.watches.retain(|watch| now_ns - watch.seen_ns <= MEMORY_NS);
        self.rows.clear();
        self.words.clear();
        if let Some(found) = input.instances.as_ref().map(|i| i.detections()).or(input.detections) {
            self.names.clear();
            for label in found.labels() {
                self.names.push_str(label);
                self.names.push('\n');
            }
        }
    }

    /// Appends the warnings of a tip: its state at the tissue, and another tip that is near.
    fn describe(&mut self, Known { tip, .. }: &Known, state: f64, tissue_mm: f64, near: Option<(&Tip, f64)>) {
        if state != 0.0 {
            call(&mut self.words, &self.names, tip);
            let _ = match state {
                2.0 => writeln!(self.words, " touches tissue"),
                1.0 => writeln!(self.words, " is {tissue_mm:.1} mm from tissue"),
                _ => writeln!(self.words, ": distance to tissue unknown"),
            };
        }
        if let Some((other, tip_mm)) = near {
            call(&mut self.words, &self.names, tip);
            self.words.push_str(" and ");
            call(&mut self.words, &self.names, other);
            let _ = writeln!(self.words, " are {tip_mm:.1} mm apart");
        }
    }

    fn watch(&mut self, key: i64, now_ns: i64) -> &mut Watch {
        let index = match self.watches.iter().position(|watch| watch.key == key) {
            Some(index) => index,
            None => {
                let fresh = Hysteresis::default();
                self.watches.push(Watch { key, seen_ns: now_ns, near: fresh, contact: fresh, other: fresh });
                self.watches.len() - 1
            }
        };
        &mut self.watches[index]
    }
}

/// The tips of a tick that have a position and are new enough, one for each number.
fn known_tips(cx: &Context<'_>, input: &In<'_>, max_age_ns: i64) -> [Option<Known>; MAX_TIPS] {
    let mut known: [Option<Known>; MAX_TIPS] = [None; MAX_TIPS];
    let mut count = 0;
    for (index, tip) in input.tip.iter().enumerate().filter_map(|(index, tip)| Some((index, tip?))) {
        let age_ns = nanoseconds(cx.age(&tip));
        let is_place = tip.xyz_valid == 1 && tip.xyz_mm.iter().all(|v| v.is_finite()) && tip.xyz_mm[2] > 0.0;
        let key = if tip.track_id >= 0 { tip.track_id } else { -2 - index as i64 };
        let is_known = known[..count].iter().flatten().any(|other| other.key == key);
        if is_place && age_ns <= max_age_ns && !is_known && count < MAX_TIPS {
            known[count] = Some(Known { tip: *tip, key });
            count += 1;
        }
    }
    known
}

/// Appends the name of a tip: the name of its class if it has one, and its number.
fn call(words: &mut String, names: &str, tip: &Tip) {
    let class = names.lines().nth(tip.class_index as usize).filter(|name| !name.is_empty()).unwrap_or("tip");
    words.push_str(class);
    if tip.track_id >= 0 {
        let _ = write!(words, " {}", tip.track_id);
    }
}

/// Converts a time to ns; saturates at the maximum.
fn nanoseconds(time: Duration) -> i64 {
    i64::try_from(time.as_nanos()).unwrap_or(i64::MAX)
}

impl Node for Proximity {
    const INFO: NodeInfo =
        NodeInfo::compute("proximity", "tools", "Measures how near tips are to tissue and to each other, and warns.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ProximityParams;

    fn open(_: &Open<'_>, _: &ProximityParams) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &ProximityParams,
    ) -> Result<()> {
        let now_ns = cx.tick().capture_ns;
        let max_age_ns = (params.max_age_ms * 1e6) as i64;
        self.begin_tick(now_ns, &input);
        self.renew(&input, params.rim_px)?;
        let real_ns = self.time.step(now_ns, cx.tick_arrived_ns());
        let tick_age_ns = nanoseconds(cx.tick_age());
        let age_of = |made_ns: i64| self.time.real(now_ns.saturating_sub(made_ns)).saturating_add(tick_age_ns);
        let age_ns = self.surface_ns.map_or(i64::MAX, age_of);
        let is_surface_known = age_ns <= max_age_ns;
        let age_ms = if self.surface_ns.is_some() { age_ns as f64 * 1e-6 } else { f64::NAN };
        let known = known_tips(cx, &input, max_age_ns);
        let rule = |on_mm: f64| Rule { on_mm, off_mm: on_mm + params.release_mm, min_s: params.min_ms * 1e-3 };
        let now_s = real_ns as f64 * 1e-9;
        let (mut nearest_mm, mut warnings) = (f64::NAN, 0);
        for this in known.iter().flatten() {
            let Known { tip, key } = this;
            let nearest = if is_surface_known { self.surface.nearest(tip.xyz_mm) } else { None };
            // Where the surface ahead of the tip is unknown, the known surface gives only an upper bound of the distance.
            let nearest = nearest.filter(|nearest| nearest.is_known_ahead || nearest.distance_mm <= params.warn_mm);
            let tissue_mm = nearest.map_or(f64::NAN, |nearest| nearest.distance_mm);
            let others = known.iter().flatten().filter(|other| other.key != *key);
            let other = others.min_by(|a, b| distance(tip, &a.tip).total_cmp(&distance(tip, &b.tip)));
            let tip_mm = other.map_or(f64::NAN, |other| distance(tip, &other.tip));
            let watch = self.watch(*key, now_ns);
            watch.seen_ns = now_ns;
            let is_near = watch.near.step(now_s, tissue_mm, &rule(params.warn_mm));
            let is_contact = watch.contact.step(now_s, tissue_mm, &rule(params.contact_mm));
            // Without another tip there is no distance between tips.
            let is_close =
                watch.other.step(now_s, if other.is_some() { tip_mm } else { f64::INFINITY }, &rule(params.tips_mm));
            let state = match () {
                () if tissue_mm.is_nan() => -1.0,
                () if is_contact => 2.0,
                () => f64::from(u8::from(is_near)),
            };
            nearest_mm = f64::min(nearest_mm, tissue_mm);
            warnings += usize::from(state != 0.0) + usize::from(is_close);
            let near = other.filter(|other| is_close && *key < other.key).map(|other| (&other.tip, tip_mm));
            self.describe(this, state, tissue_mm, near);
            let [u, v] = nearest.map_or([f64::NAN; 2], |nearest| nearest.pixel);
            let seen = nearest.map_or(f64::NAN, |nearest| f64::from(u8::from(nearest.is_seen)));
            let other_id = other.map_or(f64::NAN, |other| other.tip.track_id as f64);
            let row: [f64; COLUMNS.len()] = [
                tip.track_id as f64,
                f64::from(tip.class_index),
                tip.u_px,
                tip.v_px,
                tip.xyz_mm[0],
                tip.xyz_mm[1],
                tip.xyz_mm[2],
                tissue_mm,
                u,
                v,
                seen,
                state,
                tip_mm,
                other_id,
                f64::from(u8::from(is_close)),
                age_ms,
            ];
            self.rows.extend(row);
        }
        cx.metric("nearest_mm", nearest_mm);
        cx.metric("warnings", warnings as f64);
        if !self.words.is_empty() {
            out.text.set_text(self.words.trim_end())?;
        }
        if self.rows.is_empty() { Ok(()) } else { out.table.set_table(&COLUMNS, &self.rows) }
    }
}
