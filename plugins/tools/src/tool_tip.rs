//! `tool_tip`: the leading tool's tip, in the picture and, where depth is known, in space (thesis, chapter 6).

use panoscope_node::abi::{Calibration, Detection, Tip};
use panoscope_node::{
    Context, Depth, Detections, Disparity, Image, Instances, Node, NodeInfo, Open, Params, Ports, Result, Slot, Value,
};

use crate::shaft::{TipPixel, tip_of_box, tip_of_mask};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Boxes of tools in the left rectified view.
    detections: Option<Detections<'f>>,
    /// Tools with masks: preferred to boxes.
    instances: Option<Instances<'f>>,
    /// Depth of the left rectified view, for the place in space.
    depth: Option<Image<'f, Depth>>,
    /// Disparity of the left rectified view, where no depth is connected.
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
    /// Lowest score of a tool.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f32,
    /// Radius around the tip in which depth is looked for.
    #[param(default = 6, range = 1..=64, unit = "px")]
    radius_px: usize,
}

/// Finds the tip of the leading tool.
pub struct ToolTip {
    near: Vec<f32>,
    leading: i64,
}

/// Depth values needed around the tip for a place to be trusted.
const MIN_VALUES: usize = 6;

/// Times the radius within which a mask's own depth is looked for at most.
const WIDER: usize = 8;
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

impl ToolTip {
    /// Median depth of what lies around the tip on the tool: the nearer surface, since a tool stands before the tissue.
    fn depth_at(
        &mut self,
        at: (f64, f64),
        radius: usize,
        size: (usize, usize),
        depth_of: impl Fn(usize, usize) -> f32,
    ) -> Option<f32> {
        let (u, v, r) = (at.0.round() as isize, at.1.round() as isize, radius as isize);
        self.near.clear();
        for y in (v - r).max(0)..=(v + r).min(size.1 as isize - 1) {
            for x in (u - r).max(0)..=(u + r).min(size.0 as isize - 1) {
                let z = depth_of(x as usize, y as usize);
                if (x - u).pow(2) + (y - v).pow(2) <= r * r && z.is_finite() && z > 0.0 {
                    self.near.push(z);
                }
            }
        }
        if self.near.len() < MIN_VALUES {
            return None;
        }
        self.near.sort_unstable_by(f32::total_cmp);
        Some(self.near[self.near.len() / 4])
    }
}

impl Node for ToolTip {
    const INFO: NodeInfo = NodeInfo::compute("tool_tip", "tools", "Finds the leading tool's tip, in px and in mm.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ToolTipParams;

    fn open(_: &Open<'_>, _: &ToolTipParams) -> Result<Self> {
        Ok(Self { near: Vec::new(), leading: -1 })
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &ToolTipParams) -> Result<()> {
        let masks = input.instances;
        // Empty on ticks that the detector, slower than the camera, left out.
        let Some(found) = masks.map(|m| m.detections()).or(input.detections) else { return Ok(()) };
        let size = found.image_size();
        let wanted = |d: &Detection| {
            d.score >= params.min_score && (params.class.is_empty() || found.label(d.class_index) == params.class)
        };
        // The tool that led before goes on leading while it is seen; else the surest one.
        let best = found.items().iter().enumerate().filter(|(_, d)| wanted(d)).max_by(|(_, a), (_, b)| {
            let leads = |d: &Detection| d.track_id >= 0 && d.track_id == self.leading;
            leads(a).cmp(&leads(b)).then(a.score.total_cmp(&b.score))
        });
        let Some((index, item)) = best else { return Ok(()) };
        self.leading = item.track_id;
        let corners = [item.x_px, item.y_px, item.x_px + item.width_px, item.y_px + item.height_px];
        let tip = masks.and_then(|m| tip_of_mask(m.mask(index), size.0, size.1));
        let TipPixel { u_px, v_px, direction } = tip.unwrap_or_else(|| tip_of_box(corners, size.0, size.1));
        let mut xyz_mm = [f64::NAN; 3];
        let mut valid = false;
        if let Some(calibration) = &input.calibration {
            // Looked for a little inside the tool: at its very end half of the pixels are tissue.
            let inside = (
                u_px - direction[0] * params.radius_px as f64 / 2.0,
                v_px - direction[1] * params.radius_px as f64 / 2.0,
            );
            let p = &calibration.left_projection;
            let (focal, baseline) = (p[0], calibration.baseline_mm);
            let depths = input.depth.as_ref().map(|plane| plane.view());
            let disparities = input.disparity.as_ref().map(|plane| plane.view());
            let place = depths.as_ref().map(|v| (v.width, v.height));
            let place = place.or(disparities.as_ref().map(|v| (v.width, v.height)));
            let depth_of = |x: usize, y: usize| match (&depths, &disparities) {
                (Some(view), _) => view.row(y)[x],
                (None, Some(view)) => (focal * baseline / f64::from(view.row(y)[x])) as f32,
                (None, None) => f32::NAN,
            };
            let masks = masks.filter(|_| place == Some(size));
            let of = |item: usize, x: usize, y: usize| {
                masks.is_some_and(|m| m.mask(item)[y * size.0.div_ceil(8) + x / 8] & (0x80 >> (x % 8)) != 0)
            };
            // Where masks tell, no other surface counts.
            let own_depth = |x: usize, y: usize| {
                if masks.is_none() || of(index, x, y) { depth_of(x, y) } else { f32::NAN }
            };
            // The tip of open jaws lies between them, where the tool is not: its nearest parts count.
            let widest = if masks.is_some() { WIDER } else { 1 };
            let mut radii = (1..=widest).map(|times| times * params.radius_px);
            let z = place.and_then(|place| radii.find_map(|radius| self.depth_at(inside, radius, place, own_depth)));
            // What seems its end is where another instrument hides it: no tip is better than a wrong one.
            let others = |x: usize, y: usize| (0..found.items().len()).any(|other| other != index && of(other, x, y));
            if z.is_some_and(|z| is_behind((u_px, v_px), z, params.radius_px, size, depth_of, &others)) {
                return Ok(());
            }
            if let Some(z) = z.map(f64::from) {
                xyz_mm = [(u_px - p[2]) / p[0] * z, (v_px - p[6]) / p[5] * z, z];
                valid = xyz_mm.iter().all(|v| v.is_finite());
            }
        }
        out.tip.set(Tip {
            u_px,
            v_px,
            xyz_mm,
            score: f64::from(item.score),
            class_index: item.class_index,
            xyz_valid: u32::from(valid),
            track_id: item.track_id,
        })
    }
}
