//! Exact ground truth of a frame: depth, disparity, visibility, the best plane homography, the wide view.
//!
//! Ground truth refers to the ideal pinhole cameras: those that a perfect rectification would make of the real ones (same focal length, principal
//! point and position, no distortion).

use panoscope_imaging::{Parallel, SharedMut, ViewMut};

use super::camera_buffers::{CameraBuffers, check_size, equip, station_at};
use super::canvas::Canvas;
use super::cast::{Coarse, FAR_MM, Station};
use super::fit::{PlaneFit, homography};
use super::lanes::LANES;
use super::lens::TILE;
use super::math::Pose;
use super::params::{CameraModel, PhantomError};
use super::phantom::Phantom;
use super::scratch::TruthScratch;
use super::shade::{self, Sensor, portable};
use super::tools::{ToolTruth, to_camera};

/// Rows of one chunk.
const CHUNK_ROWS: usize = 16;
/// A point is visible when the other camera's first hit is within this distance along its axis, mm.
const SEEN_MM: f32 = 0.05;
/// Depth of an instrument's own parts that may be in front of a visible tip, mm.
const TIP_DEPTH_MM: f64 = 2.0;

/// The planes to compute. Each has the size of the first camera and one channel.
#[derive(Debug, Default)]
pub struct TruthMut<'a> {
    /// Depth along the first camera's axis, mm; NaN where its ray meets nothing.
    pub depth_mm: Option<ViewMut<'a, f32>>,
    /// `fx * baseline / depth`, px: the point is at `(u - disparity, v)` in the second view. Set wherever the first camera's ray hits, whether the
    /// second camera sees the point or not.
    pub disparity_px: Option<ViewMut<'a, f32>>,
    /// 255 where the second camera sees the same point: inside its image and not hidden.
    pub visible: Option<ViewMut<'a, u8>>,
}

impl Phantom {
    /// Computes the planes in `out`. Allocates nothing after the first call.
    ///
    /// # Errors
    /// Planes of the wrong size, a pose that is not finite; disparity or visibility of a rig of one camera.
    pub fn truth(
        &mut self,
        frame: u64,
        pose: Option<Pose>,
        pool: &dyn Parallel,
        mut out: TruthMut,
    ) -> Result<(), PhantomError> {
        let (width, height) = (self.camera_buffers[0].lens.width, self.camera_buffers[0].lens.height);
        for (i, plane) in [&out.depth_mm, &out.disparity_px].into_iter().enumerate() {
            plane.as_ref().map_or(Ok(()), |plane| check_size(i, plane, width, height, 1))?;
        }
        out.visible.as_ref().map_or(Ok(()), |plane| check_size(2, plane, width, height, 1))?;
        if self.camera_buffers.len() < 2 && (out.disparity_px.is_some() || out.visible.is_some()) {
            return Err(PhantomError::WrongViewCount { got: self.camera_buffers.len(), want: 2 });
        }
        let mut work = self.solve_depth(frame, pose, pool)?;
        if let Some(plane) = &mut out.depth_mm {
            for (y, depth) in work.depth_mm.chunks_exact(width).enumerate() {
                plane.row_mut(y).copy_from_slice(depth);
            }
        }
        if let Some(plane) = &mut out.disparity_px {
            let (left, right) = (&work.camera_buffers[0].model, &work.camera_buffers[1].model);
            let scale = (left.fx * (right.offset_mm[0] - left.offset_mm[0])) as f32;
            for (y, depth) in work.depth_mm.chunks_exact(width).enumerate() {
                plane.row_mut(y).iter_mut().zip(depth).for_each(|(out, depth)| *out = scale / depth);
            }
        }
        if let Some(plane) = &mut out.visible {
            self.see(&mut work, pool, plane);
        }
        self.truth = work;
        Ok(())
    }

    /// Depth of the first camera, in the work memory, which the caller must return.
    fn solve_depth(
        &mut self,
        frame: u64,
        pose: Option<Pose>,
        pool: &dyn Parallel,
    ) -> Result<TruthScratch, PhantomError> {
        let pose = pose.unwrap_or_else(|| self.pose(frame));
        if !pose.is_finite() {
            return Err(PhantomError::BadPose);
        }
        self.breathe(frame, pool);
        let mut work = std::mem::take(&mut self.truth);
        let period = f64::from(self.relief.period_mm);
        for buffers in &mut work.camera_buffers {
            let (station, coarse) = &mut buffers.stations[0];
            *station = station_at(&pose, buffers.model.offset_mm, self.rig.light_mm, period);
            let seconds = frame as f64 / self.params.fps;
            equip(&self.tools, seconds, &pose, buffers.model.offset_mm, self.rig.light_mm, &buffers.lens, coarse);
            self.coarse(&buffers.lens, station, coarse, pool);
        }
        let TruthScratch { camera_buffers, depth_mm, .. } = &mut work;
        self.depth_of(&camera_buffers[0], pool, depth_mm);
        Ok(work)
    }

    /// Depth of each pixel of an ideal camera whose coarse pass is done, mm; NaN where its ray meets nothing.
    pub(super) fn depth_of(&self, buffers: &CameraBuffers, pool: &dyn Parallel, depth_mm: &mut Vec<f32>) {
        let lens = &buffers.lens;
        depth_mm.resize(lens.width * lens.height, 0.0);
        let (station, coarse) = &buffers.stations[0];
        let (field, wide) = (self.field(), self.wide_lanes());
        let shared = SharedMut::new(depth_mm);
        pool.run(lens.height.div_ceil(CHUNK_ROWS), &|chunk| {
            let first = chunk * CHUNK_ROWS;
            let rows = CHUNK_ROWS.min(lens.height - first);
            // SAFETY: each chunk takes its own rows.
            let out = unsafe { shared.part(first * lens.width, rows * lens.width) };
            #[cfg(target_arch = "x86_64")]
            if wide {
                // SAFETY: `wide_lanes` found AVX2.
                return unsafe { shade::avx2::depth(&field, lens, station, coarse, first, out) };
            }
            let _ = wide;
            portable::depth(&field, lens, station, coarse, first, out);
        });
    }

    /// Marks the points that the second camera sees too.
    fn see(&self, work: &mut TruthScratch, pool: &dyn Parallel, plane: &mut ViewMut<u8>) {
        let (left, right) = (&work.camera_buffers[0], &work.camera_buffers[1]);
        let (width, height) = (left.lens.width, left.lens.height);
        let (station, coarse) = &right.stations[0];
        let offset: [f64; 3] = std::array::from_fn(|i| right.model.offset_mm[i] - left.model.offset_mm[i]);
        let offset = offset.map(|v| v as f32);
        let (field, wide) = (self.field(), self.wide_lanes());
        let (depth_mm, stride) = (&work.depth_mm, plane.stride);
        let (fx, fy) = (right.model.fx as f32, right.model.fy as f32);
        let (cx, cy) = (right.model.cx as f32, right.model.cy as f32);
        let shared = SharedMut::new(plane.data);
        pool.run(height, &|row| {
            // SAFETY: each chunk takes its own row.
            let out = unsafe { shared.part(row * stride, width) };
            let y = left.lens.y[row];
            for (packet, out) in out.chunks_mut(LANES).enumerate() {
                let at = packet * LANES;
                let (mut rx, mut ry, mut want) = ([0f32; LANES], [0f32; LANES], [f32::NAN; LANES]);
                let mut before = [f32::MAX; LANES];
                let mut start = f32::MAX;
                for lane in 0..out.len() {
                    let t = depth_mm[row * width + at + lane];
                    let z = t - offset[2];
                    let (x, y) = ((left.lens.x[at + lane] * t - offset[0]) / z, (y * t - offset[1]) / z);
                    let (u, v) = (x * fx + cx, y * fy + cy);
                    // The picture ends half a pixel beyond the last centre. NaN fails too.
                    if u > -0.5 && u < width as f32 - 0.5 && v > -0.5 && v < height as f32 - 0.5 {
                        (rx[lane], ry[lane], want[lane]) = (x, y, z);
                        let tile = |p: f32, limit: usize| (p.max(0.0) as usize / TILE).min(limit);
                        let (column, line) = (tile(u, right.lens.grid_width - 2), tile(v, right.lens.grid_height - 2));
                        let solid = coarse.first_part(line * (right.lens.grid_width - 1) + column, x, y);
                        before[lane] = solid.map_or(f32::MAX, |(entry, _)| entry.t as f32);
                        start = start.min(nearest_around(coarse, right, column, line));
                    }
                }
                if start == f32::MAX {
                    out.fill(0);
                    continue;
                }
                // Idle lanes follow a live one.
                if let Some(live) = (0..LANES).find(|&i| want[i].is_finite()) {
                    for lane in 0..LANES {
                        if want[lane].is_nan() {
                            (rx[lane], ry[lane]) = (rx[live], ry[live]);
                        }
                    }
                }
                let found = first_hits(wide, &field, station, &rx, &ry, start * 0.97);
                for (lane, out) in out.iter_mut().enumerate() {
                    *out = if (found[lane].min(before[lane]) - want[lane]).abs() < SEEN_MM { 255 } else { 0 };
                }
            }
        });
    }

    /// Marks the instruments in `ids` (the first camera's ideal view: 0 tissue, else the instrument's identity) and returns the ground truth of each,
    /// in order of identity.
    ///
    /// # Errors
    /// A plane of the wrong size, a pose that is not finite.
    pub fn tools(
        &mut self,
        frame: u64,
        pose: Option<Pose>,
        pool: &dyn Parallel,
        ids: &mut ViewMut<u8>,
        out: &mut Vec<ToolTruth>,
    ) -> Result<(), PhantomError> {
        check_size(0, ids, self.camera_buffers[0].lens.width, self.camera_buffers[0].lens.height, 1)?;
        let work = self.solve_depth(frame, pose, pool)?;
        let buffers = &work.camera_buffers[0];
        let (lens, coarse) = (&buffers.lens, &buffers.stations[0].1);
        let pose = pose.unwrap_or_else(|| self.pose(frame));
        out.clear();
        for tool in &self.tools {
            let posed = tool.at(frame as f64 / self.params.fps);
            let tip_mm = to_camera(&pose, [0.0; 3], posed.tip);
            let tip_px = if tip_mm[2] > 0.0 {
                let (x, y) = (tip_mm[0] / tip_mm[2], tip_mm[1] / tip_mm[2]);
                [x * buffers.model.fx + buffers.model.cx, y * buffers.model.fy + buffers.model.cy]
            } else {
                [f64::NAN; 2]
            };
            let (u, v) = ((tip_px[0] + 0.5).floor(), (tip_px[1] + 0.5).floor());
            let inside = u >= 0.0 && v >= 0.0 && u < lens.width as f64 && v < lens.height as f64;
            // The tip lies on the jaws' far end: its own instrument may stand a little before it.
            let tip_visible =
                inside && f64::from(work.depth_mm[v as usize * lens.width + u as usize]) > tip_mm[2] - TIP_DEPTH_MM;
            let bounds_px = [usize::MAX, usize::MAX, 0, 0];
            out.push(ToolTruth { kind: posed.kind, id: posed.id, pixels: 0, bounds_px, tip_mm, tip_px, tip_visible });
        }
        for v in 0..lens.height {
            let row = ids.row_mut(v);
            for (u, id) in row.iter_mut().enumerate() {
                *id = 0;
                let [x, y] = lens.ray(u, v);
                // The depth plane already holds the nearer of tissue and instrument.
                if let Some((entry, part)) = coarse.first_part(lens.tile(u, v), x, y)
                    && entry.t as f32 == work.depth_mm[v * lens.width + u]
                {
                    *id = part.id;
                    let tool = &mut out[usize::from(part.id) - 1];
                    let [left, top, right, bottom] = tool.bounds_px;
                    tool.bounds_px = [left.min(u), top.min(v), right.max(u + 1), bottom.max(v + 1)];
                    tool.pixels += 1;
                }
            }
        }
        for tool in out {
            let [left, top, right, bottom] = tool.bounds_px;
            tool.bounds_px = if tool.pixels == 0 { [0; 4] } else { [left, top, right - left, bottom - top] };
        }
        self.truth = work;
        Ok(())
    }

    /// Fits `left_from_right` by least squares to the true correspondences (every eighth pixel of the shared
    /// field that both cameras see). `None` where fewer than 16 points are shared.
    ///
    /// # Errors
    /// As [`Phantom::truth`].
    pub fn homography(
        &mut self,
        frame: u64,
        pose: Option<Pose>,
        pool: &dyn Parallel,
    ) -> Result<Option<PlaneFit>, PhantomError> {
        if self.camera_buffers.len() < 2 {
            return Err(PhantomError::WrongViewCount { got: self.camera_buffers.len(), want: 2 });
        }
        let mut work = self.solve_depth(frame, pose, pool)?;
        let mut pairs = std::mem::take(&mut work.pairs);
        pairs.clear();
        let (left, right) = (&work.camera_buffers[0], &work.camera_buffers[1]);
        let (station, field, wide) = (&right.stations[0].0, self.field(), self.wide_lanes());
        let offset: [f64; 3] = std::array::from_fn(|i| right.model.offset_mm[i] - left.model.offset_mm[i]);
        for v in (4..left.lens.height).step_by(8) {
            for u in (4..left.lens.width).step_by(8) {
                let t = f64::from(work.depth_mm[v * left.lens.width + u]);
                let z = t - offset[2];
                let x = (f64::from(left.lens.x[u]) * t - offset[0]) / z;
                let y = (f64::from(left.lens.y[v]) * t - offset[1]) / z;
                let place = [x * right.model.fx + right.model.cx, y * right.model.fy + right.model.cy];
                let inside = place[0] > -0.5 && place[0] < right.lens.width as f64 - 0.5;
                if inside && place[1] > -0.5 && place[1] < right.lens.height as f64 - 0.5 {
                    let found = first_hits(wide, &field, station, &[x as f32; LANES], &[y as f32; LANES], 0.0)[0];
                    if (found - z as f32).abs() < SEEN_MM {
                        pairs.push([place[0], place[1], u as f64, v as f64]);
                    }
                }
            }
        }
        let fit = homography(&pairs);
        work.pairs = pairs;
        self.truth = work;
        Ok(fit)
    }

    /// Draws the view of one ideal camera with a larger sensor at the first camera's position: no noise, no distortion. Allocates only when the
    /// canvas changes.
    ///
    /// # Errors
    /// A canvas of more than 8192 px a side, a view of another size, a pose that is not finite.
    pub fn wide(
        &mut self,
        frame: u64,
        pose: Option<Pose>,
        canvas: Canvas,
        pool: &dyn Parallel,
        view: &mut ViewMut<u8>,
    ) -> Result<(), PhantomError> {
        canvas.check()?;
        check_size(0, view, canvas.width, canvas.height, 3)?;
        let buffers = self.wide_eye(frame, pose, canvas, pool)?;
        let gain = buffers.model.white_balance.map(|w| w * buffers.model.exposure * self.params.light);
        let sensor = Sensor { gain, noise: 0.0, key: 0, smoke: &[], drops: &[] };
        self.bake(&buffers.lens, &buffers.stations[..1], pool);
        self.draw(&buffers.lens, &buffers.stations[..1], sensor, pool, view);
        self.truth.wide = Some((canvas, buffers));
        Ok(())
    }

    /// The wide camera of `canvas`, positioned and with its coarse pass done; the caller must return it.
    pub(super) fn wide_eye(
        &mut self,
        frame: u64,
        pose: Option<Pose>,
        canvas: Canvas,
        pool: &dyn Parallel,
    ) -> Result<CameraBuffers, PhantomError> {
        let pose = pose.unwrap_or_else(|| self.pose(frame));
        if !pose.is_finite() {
            return Err(PhantomError::BadPose);
        }
        self.breathe(frame, pool);
        let kept = self.truth.wide.take().filter(|(of, _)| *of == canvas);
        let mut buffers = match kept {
            Some((_, buffers)) => buffers,
            None => {
                let model = CameraModel {
                    width: canvas.width,
                    height: canvas.height,
                    cx: self.camera_buffers[0].model.cx + canvas.offset_x,
                    cy: self.camera_buffers[0].model.cy + canvas.offset_y,
                    distortion: [0.0; 5],
                    equidistant: None,
                    ..self.camera_buffers[0].model
                };
                CameraBuffers::new(model, 0, 1)?
            }
        };
        let period = f64::from(self.relief.period_mm);
        let (station, coarse) = &mut buffers.stations[0];
        *station = station_at(&pose, buffers.model.offset_mm, self.rig.light_mm, period);
        let seconds = frame as f64 / self.params.fps;
        equip(&self.tools, seconds, &pose, buffers.model.offset_mm, self.rig.light_mm, &buffers.lens, coarse);
        self.coarse(&buffers.lens, station, coarse, pool);
        Ok(buffers)
    }
}

/// Smallest depth of the corners around a tile, mm.
fn nearest_around(coarse: &Coarse, buffers: &CameraBuffers, column: usize, line: usize) -> f32 {
    let mut nearest = FAR_MM;
    for v in line.saturating_sub(1)..=(line + 2).min(buffers.lens.grid_height - 1) {
        for u in column.saturating_sub(1)..=(column + 2).min(buffers.lens.grid_width - 1) {
            nearest = nearest.min(coarse.depth_mm[v * buffers.lens.grid_padded + u]);
        }
    }
    nearest
}

fn first_hits(
    wide: bool,
    field: &super::cast::Field,
    station: &Station,
    x: &[f32; LANES],
    y: &[f32; LANES],
    start: f32,
) -> [f32; LANES] {
    #[cfg(target_arch = "x86_64")]
    if wide {
        // SAFETY: the caller's `wide` comes from detecting AVX2.
        return unsafe { shade::avx2::first_hits(field, station, x, y, start) };
    }
    let _ = wide;
    portable::first_hits(field, station, x, y, start)
}
