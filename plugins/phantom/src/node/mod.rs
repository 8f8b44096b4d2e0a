//! `phantom`: a rendered scene seen by two or four cameras, with exact ground truth.

mod calibration;
mod params;
mod ports;

use panoscope_node::abi::{self, Calibration, Detection};
use panoscope_node::{Context, Node, NodeInfo, Open, Result, Validation, ViewMut, detections, name16};

use crate::render::canvas::MAX_WIDE_PX;
use crate::render::lens::Lens;
use crate::render::{self, Canvas, Phantom, Pose, ToolKind, ToolTruth, TruthMut};
use calibration::calibration;
use params::{DropViews, Layout, PhantomParams};
use ports::{In, Out};

/// Columns of `clearance`: positions are in the left camera's frame; distances below 0 are inside the tissue; NaN where there is no other tip.
const CLEARANCE: [&str; 8] = ["track_id", "class_index", "seen", "x_mm", "y_mm", "z_mm", "tissue_mm", "tip_mm"];

/// The `phantom` node.
pub struct PhantomNode {
    phantom: Phantom,
    frame: u64,
    calibration: Calibration,
    canvas: Canvas,
    labels: String,
    tools: ToolBuffers,
    /// Buffer for a view that is dropped.
    unseen: Vec<u8>,
}

/// Buffers of the instruments' ground truth, reused from tick to tick.
#[derive(Default)]
struct ToolBuffers {
    ids: Vec<u8>,
    truth: Vec<ToolTruth>,
    items: Vec<Detection>,
    masks: Vec<u8>,
    clearances_mm: Vec<f64>,
    rows: Vec<f64>,
}

impl Node for PhantomNode {
    const INFO: NodeInfo = NodeInfo::compute(
        "phantom",
        "source",
        "Renders a tissue-like scene for two or four parallel cameras at a scope's tip, with exact ground truth.",
    )
    .source();
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = PhantomParams;

    fn validate(params: &PhantomParams, check: &mut Validation<'_>) {
        if let Err(error) = params.tool_kinds() {
            check.error("tool_kinds", error.message(), "");
        }
        for (index, model) in params.rig().cameras.iter().enumerate() {
            if let Err(error) = Lens::check(model, index) {
                let help = "set `distortion_k1` and `distortion_k2` nearer to 0, or increase `zoom`";
                check.error("distortion_k1", error.to_string(), help);
                break;
            }
        }
        let canvas = params.canvas();
        let is_read = ["wide", "footprint"].map(|port| check.is_read(port) == Some(true));
        if is_read.contains(&true) && canvas.width.max(canvas.height) > MAX_WIDE_PX {
            let message = format!(
                "the `wide` image would have {}x{} px, which exceeds the limit of {MAX_WIDE_PX} px a side",
                canvas.width, canvas.height
            );
            check.error("wide_factor", message, "lower `wide_factor`, or the size of the views");
        }
    }

    fn open(open: &Open<'_>, params: &PhantomParams) -> Result<Self> {
        let scene = params.scene()?;
        let rig = params.rig();
        let canvas = params.canvas();
        let calibration = calibration(&rig);
        let labels: Vec<&str> = ToolKind::ALL.iter().map(|kind| kind.name()).collect();
        Ok(Self {
            phantom: Phantom::new(scene, rig, open.pool())?,
            frame: 0,
            calibration,
            canvas,
            labels: labels.join("\n"),
            tools: ToolBuffers::default(),
            unseen: Vec::new(),
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &PhantomParams) -> Result<()> {
        let frame = self.frame;
        self.frame += 1;
        cx.set_capture_ns((frame as f64 * 1e9 / params.rate_hz) as i64);
        // One random number for each fault and tick, the same in every run.
        let chance = |purpose: u32| f64::from(render::chance(params.seed, purpose, frame));
        let is_dropped = chance(0) < params.drop_share;
        if is_dropped && params.drop_views == DropViews::All {
            return Ok(());
        }
        if chance(1) < params.late_share && !cx.is_batch() {
            std::thread::sleep(std::time::Duration::from_secs_f64(params.late_ms * 1e-3));
        }
        let pose = input.camera_pose.map(|p| Pose { quaternion: p.a_from_b_wxyz, translation_mm: p.a_from_b_mm });
        let dropped = is_dropped.then_some(params.drop_views);
        self.render(cx, frame, pose, &mut out, params, dropped)?;
        self.truth(cx, frame, pose, &mut out)?;
        self.tools(cx, frame, pose, &mut out)?;
        out.calibration.set(self.calibration)?;
        let camera = pose.unwrap_or_else(|| self.phantom.pose(frame));
        out.pose.set(abi::Pose {
            a_from_b_wxyz: camera.quaternion,
            a_from_b_mm: camera.translation_mm,
            a: name16("scene"),
            b: name16("left_camera"),
        })?;
        Ok(())
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        Some(self.frame.to_le_bytes().to_vec())
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        self.frame = u64::from_le_bytes(state.try_into()?);
        Ok(())
    }
}

impl PhantomNode {
    fn render(
        &mut self,
        cx: &Context<'_>,
        frame: u64,
        pose: Option<Pose>,
        out: &mut Out<'_>,
        params: &PhantomParams,
        dropped: Option<DropViews>,
    ) -> Result<()> {
        let (width, height) = (params.width as usize, params.height as usize);
        let (no_left, no_right) = (dropped == Some(DropViews::Left), dropped == Some(DropViews::Right));
        if dropped.is_some() {
            self.unseen.resize(width * height * 3, 0);
        }
        // A dropped view is drawn to a buffer of this node.
        let unseen = &mut self.unseen;
        let (left, right) = match (no_left, no_right) {
            (true, _) => (ViewMut::new(unseen, width, height, 3), out.right.alloc(width, height)?),
            (_, true) => (out.left.alloc(width, height)?, ViewMut::new(unseen, width, height, 3)),
            _ => (out.left.alloc(width, height)?, out.right.alloc(width, height)?),
        };
        if params.layout == Layout::Stereo {
            self.phantom.render(frame, pose, cx.pool(), &mut [left, right])?;
        } else {
            let mut views = [left, right, out.view2.alloc(width, height)?, out.view3.alloc(width, height)?];
            self.phantom.render(frame, pose, cx.pool(), &mut views)?;
        }
        if out.view0.is_read() && !no_left {
            out.view0.forward_from(&out.left)?;
        }
        if out.view1.is_read() && !no_right {
            out.view1.forward_from(&out.right)?;
        }
        Ok(())
    }

    fn truth(&mut self, cx: &Context<'_>, frame: u64, pose: Option<Pose>, out: &mut Out<'_>) -> Result<()> {
        let (width, height) = (self.calibration.left.width as usize, self.calibration.left.height as usize);
        if out.depth.is_read() || out.disparity.is_read() || out.visible.is_read() {
            let depth_mm = if out.depth.is_read() { Some(out.depth.alloc(width, height)?) } else { None };
            let disparity_px = if out.disparity.is_read() { Some(out.disparity.alloc(width, height)?) } else { None };
            let visible = if out.visible.is_read() { Some(out.visible.alloc(width, height)?) } else { None };
            self.phantom.truth(frame, pose, cx.pool(), TruthMut { depth_mm, disparity_px, visible })?;
        }
        if out.homography.is_read()
            && let Some(fit) = self.phantom.homography(frame, pose, cx.pool())?
        {
            out.homography.set(abi::Homography {
                left_from_right: fit.left_from_right,
                rms_px: fit.rms_px,
                inliers: fit.points as u32,
                state: abi::STATE_FRESH,
            })?;
        }
        if out.wide.is_read() {
            let canvas = self.canvas;
            let mut view: ViewMut<'_, u8> = out.wide.alloc(canvas.width, canvas.height)?;
            self.phantom.wide(frame, pose, canvas, cx.pool(), &mut view)?;
        }
        if out.footprint.is_read() {
            let canvas = self.canvas;
            let mut plane: ViewMut<'_, u8> = out.footprint.alloc(canvas.width, canvas.height)?;
            self.phantom.footprint(frame, pose, canvas, cx.pool(), &mut plane)?;
        }
        Ok(())
    }

    /// Writes boxes, masks and tips of the instruments.
    fn tools(&mut self, cx: &Context<'_>, frame: u64, pose: Option<Pose>, out: &mut Out<'_>) -> Result<()> {
        let read = [out.detections.is_read(), out.instances.is_read(), out.tip.is_read(), out.lead.is_read()];
        if !read.contains(&true) && !out.second.is_read() && !out.clearance.is_read() {
            return Ok(());
        }
        let (width, height) = (self.calibration.left.width as usize, self.calibration.left.height as usize);
        let ToolBuffers { ids, truth, items, masks, clearances_mm, rows } = &mut self.tools;
        ids.resize(width * height, 0);
        self.phantom.tools(frame, pose, cx.pool(), &mut ViewMut::new(ids, width, height, 1), truth)?;
        let class_of = |kind: ToolKind| ToolKind::ALL.iter().position(|k| *k == kind).unwrap_or(0) as u32;
        let seen = || truth.iter().filter(|tool| tool.pixels > 0);
        items.clear();
        items.extend(seen().map(|tool| {
            let [x_px, y_px, width_px, height_px] = tool.bounds_px.map(|v| v as f32);
            let (class_index, track_id) = (class_of(tool.kind), i64::from(tool.id));
            Detection { x_px, y_px, width_px, height_px, score: 1.0, class_index, track_id }
        }));
        if out.detections.is_read() {
            out.detections.set_detections(items, &self.labels, (width, height))?;
        }
        if out.instances.is_read() {
            let (row_len, len) = (width.div_ceil(8), detections::mask_len(width, height));
            masks.clear();
            masks.resize(items.len() * len, 0);
            for (tool, mask) in seen().zip(masks.chunks_exact_mut(len.max(1))) {
                for (row, bits) in ids.chunks_exact(width).zip(mask.chunks_exact_mut(row_len)) {
                    for (x, _) in row.iter().enumerate().filter(|(_, id)| **id == tool.id) {
                        bits[x / 8] |= 0x80 >> (x % 8);
                    }
                }
            }
            out.instances.set_instances(items, &self.labels, (width, height), masks)?;
        }
        let tip_of = |tool: &ToolTruth| abi::Tip {
            u_px: tool.tip_px[0],
            v_px: tool.tip_px[1],
            xyz_mm: tool.tip_mm,
            score: f64::from(u8::from(tool.tip_visible)),
            class_index: class_of(tool.kind),
            xyz_valid: 1,
            track_id: i64::from(tool.id),
        };
        if let Some(tool) = truth.iter().filter(|tool| tool.tip_visible).max_by_key(|tool| tool.pixels) {
            out.tip.set(tip_of(tool))?;
        }
        if let Some(tool) = truth.iter().find(|tool| tool.id == 1 && tool.tip_mm[2] > 0.0) {
            out.lead.set(tip_of(tool))?;
        }
        if let Some(tool) = truth.iter().find(|tool| tool.id == 2 && tool.tip_mm[2] > 0.0) {
            out.second.set(tip_of(tool))?;
        }
        if out.clearance.is_read() {
            self.phantom.clearances(frame, cx.pool(), clearances_mm);
            rows.clear();
            for (tool, tissue_mm) in truth.iter().zip(clearances_mm) {
                let others = truth.iter().filter(|other| other.id != tool.id);
                let distance = |other: &ToolTruth| {
                    tool.tip_mm.iter().zip(other.tip_mm).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
                };
                let tip_mm = others.map(distance).fold(f64::NAN, f64::min);
                let [x, y, z] = tool.tip_mm;
                let seen = f64::from(u8::from(tool.tip_visible));
                rows.extend([f64::from(tool.id), f64::from(class_of(tool.kind)), seen, x, y, z, *tissue_mm, tip_mm]);
            }
            out.clearance.set_table(&CLEARANCE, rows)?;
        }
        Ok(())
    }
}
