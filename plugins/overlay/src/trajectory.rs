//! `trajectory`: the trajectory of a tool's tip in space, on the image and in a small box (thesis, fig. 6.5).

use std::collections::VecDeque;
use std::fmt::Write;

use panoscope_imaging::draw::{Area, Color};
use panoscope_node::abi::{Calibration, Pose, Tip};
use panoscope_node::device::{Device, Gpu, OnDevice, Steps};
use panoscope_node::{
    Bgr8, Context, Detections, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, TextPacket, Value, error,
};

use crate::gpu::draw::DeviceDrawing;
use crate::gpu::fit::DeviceFit;
use crate::shapes::Shapes;

/// Input ports of `trajectory`.
#[derive(Ports)]
pub struct In<'f> {
    /// The left rectified view.
    image: Image<'f, Bgr8>,
    /// The tip in the left rectified camera's frame, mm.
    tip: Option<Value<'f, Tip>>,
    /// Pose of the left camera in the scene. Without it the trajectory is drawn relative to the camera.
    camera_pose: Option<Value<'f, Pose>>,
    /// Calibration of the rectified views, to project positions to pixels.
    calibration: Option<Value<'f, Calibration>>,
    /// Instruments that the box does not cover.
    detections: Option<Detections<'f>>,
}

/// Output ports of `trajectory`.
#[derive(Ports)]
pub struct Out<'f> {
    /// The image with the trajectory drawn on it.
    image: Slot<'f, Bgr8>,
    /// Size of the box as text. If this is connected, the text is not drawn on the image.
    text: Slot<'f, TextPacket>,
}

/// Parameters of `trajectory`.
#[derive(Params)]
pub struct Settings {
    /// Length of the trajectory.
    #[param(default = 240, range = 2..=3000, unit = "frames", reopen)]
    length: usize,
    /// Marks the position at which an arm keeps the tip: the middle of what both cameras see, at this distance from the left camera. Without
    /// `camera_pose` there is no arm and no mark; 0 draws none.
    #[param(default = 66.0, range = 0.0..=200.0, step = 1.0, unit = "mm")]
    goal_mm: f64,
    /// Also draws the trajectory in a box, in perspective.
    #[param(default = true)]
    show_box: bool,
    /// Width of the box, as a share of the image's width.
    #[param(default = 0.3, range = 0.1..=1.0, step = 0.05, unit = "ratio")]
    box_share: f32,
    /// Width of lines in images up to 640 px wide; in wider ones it grows with the image.
    #[param(default = 2.0, range = 0.5..=20.0, step = 0.5, unit = "px")]
    line_px: f32,
    /// Scale of text: capital letters are six times as many px high.
    #[param(default = 1.5, range = 0.5..=20.0, step = 0.5)]
    text_scale: f32,
    /// Where it is drawn. A GPU draws on images that were made there: only the parts with lines come to the processor, and go back. Without a GPU the
    /// processor does it, with a warning.
    #[param(default = "cpu")]
    device: Device,
}

type Point = [f64; 3];

/// Draws the trajectory of a tip.
pub struct Trajectory {
    /// Positions in the scene, mm, oldest first; `None` where the tip was lost.
    positions: VecDeque<Option<Point>>,
    words: String,
    /// Corner that contains the box.
    corner: usize,
    shapes: Shapes,
    on_device: OnDevice<(DeviceDrawing, DeviceFit)>,
}

fn open_device(gpu: Gpu) -> Result<(DeviceDrawing, DeviceFit)> {
    Ok((DeviceDrawing::new(gpu), DeviceFit::new(gpu)?))
}

/// Corners for the box, best first: whether it is at the right, and at the bottom. Text is in the other corners.
const CORNERS: [(bool, bool); 3] = [(true, true), (false, true), (true, false)];
/// Width of the box in an image of 640 px.
const USUAL_BOX_PX: f32 = 192.0;
/// Width of images at which lines have the width of the parameter.
const USUAL_WIDTH: f32 = 640.0;
/// Minimum distance between a tip and the box, px.
const TIP_ROOM_PX: f32 = 24.0;

/// A pose: rows of a rotation matrix, and a translation, mm.
struct Frame {
    rows: [Point; 3],
    at: Point,
}

impl Frame {
    const NONE: Self = Self { rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], at: [0.0; 3] };

    fn of(pose: &Pose) -> Option<Self> {
        let q = pose.a_from_b_wxyz;
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        if !(norm > 1e-9 && norm.is_finite() && pose.a_from_b_mm.iter().all(|v| v.is_finite())) {
            return None;
        }
        let [w, x, y, z] = q.map(|v| v / norm);
        let rows = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        Some(Self { rows, at: pose.a_from_b_mm })
    }

    fn outward(&self, p: Point) -> Point {
        std::array::from_fn(|i| (0..3).map(|k| self.rows[i][k] * p[k]).sum::<f64>() + self.at[i])
    }

    fn inward(&self, p: Point) -> Point {
        std::array::from_fn(|i| (0..3).map(|k| self.rows[k][i] * (p[k] - self.at[k])).sum())
    }
}

/// Upper left corner of a box of `size` px in a corner of an image of `frame`.
fn place_of(corner: usize, frame: (f32, f32), size: f32) -> (f32, f32) {
    let (is_right, is_below) = CORNERS[corner % CORNERS.len()];
    let at = |is_far: bool, length: f32| if is_far { length - size - 6.0 } else { 6.0 };
    (at(is_right, frame.0), at(is_below, frame.1))
}

/// Colours from blue (oldest) to yellow (newest).
fn color(age: f32) -> Color {
    let new = 1.0 - age.clamp(0.0, 1.0);
    [(230.0 * (1.0 - new)) as u8 + 20, (90.0 + 140.0 * new) as u8, (40.0 + 210.0 * new) as u8]
}

/// Projects a position in the camera's frame to the image, px; `None` behind the camera.
fn pixel(projection: &[f64; 12], p: Point) -> Option<(f32, f32)> {
    (p[2] > 1.0).then(|| {
        let (u, v) = (projection[0] * p[0] / p[2] + projection[2], projection[5] * p[1] / p[2] + projection[6]);
        (u as f32, v as f32)
    })
}

impl Trajectory {
    fn steps(&self) -> impl Iterator<Item = (Point, Point, f32)> + '_ {
        let count = self.positions.len().max(2) as f32;
        let two = self.positions.iter().zip(self.positions.iter().skip(1)).enumerate();
        two.filter_map(move |(index, (a, b))| Some(((*a)?, (*b)?, 1.0 - (index + 1) as f32 / (count - 1.0))))
    }

    /// Chooses the corner in which a box of `size` px covers least of what is `taken` in an image of `frame`. It moves only when it covers something
    /// and another corner has much less of it.
    fn choose_corner(&mut self, frame: (f32, f32), size: f32, taken: &[Area]) {
        let covered = |corner: usize| -> f32 {
            let (x, y) = place_of(corner, frame, size);
            let overlap = |a: f32, length: f32, b: f32, other: f32| ((a + length).min(b + other) - a.max(b)).max(0.0);
            taken.iter().map(|t| overlap(x, size, t.x, t.width) * overlap(y, size, t.y, t.height)).sum()
        };
        let now = covered(self.corner);
        let best = (0..CORNERS.len()).min_by(|a, b| covered(*a).total_cmp(&covered(*b))).unwrap_or(0);
        if now > 0.02 * size * size && covered(best) < 0.5 * now {
            self.corner = best;
        }
    }

    /// Adds the trajectory and the place at which the arm keeps the tip.
    fn draw_way(&mut self, input: &In<'_>, frame: &Frame, frame_px: (f32, f32), settings: &Settings) {
        let Some(calibration) = &input.calibration else { return };
        let grown = (frame_px.0 / USUAL_WIDTH).max(1.0);
        let line_px = settings.line_px * grown;
        let mut shapes = std::mem::take(&mut self.shapes);
        let projection = &calibration.left_projection;
        for (a, b, age) in self.steps() {
            let ends = pixel(projection, frame.inward(a)).zip(pixel(projection, frame.inward(b)));
            if let Some((a, b)) = ends {
                shapes.line(a, b, line_px, color(age));
            }
        }
        let x = calibration.baseline_mm / 2.0;
        let goal = [x, 0.0, (settings.goal_mm * settings.goal_mm - x * x).max(0.0).sqrt()];
        if settings.goal_mm > 0.0
            && input.camera_pose.is_some()
            && let Some(at) = pixel(projection, goal)
        {
            shapes.circle(at, 14.0 * grown, line_px, [255, 255, 255]);
            shapes.cross(at, 6.0 * grown, grown, [255, 255, 255]);
        }
        self.shapes = shapes;
    }

    /// Draws on a copy of an image that was made on the GPU. `false` where the processor has to do it.
    fn draw_there(&mut self, cx: &Context<'_>, image: &Image<'_, Bgr8>, slot: &mut Slot<'_, Bgr8>) -> Result<bool> {
        if !image.is_from_device() {
            return Ok(false);
        }
        let shapes = &self.shapes;
        self.on_device.attempt(cx, |(drawing, fit)| {
            let out = slot.alloc_on_device(image.width(), image.height())?;
            let (mut steps, mut jobs) = (Steps::default(), Vec::new());
            drawing.draw(image, shapes, out, (&mut steps, &mut jobs))?;
            fit.run(steps, &jobs)
        })
    }

    /// Adds the trajectory in a box of integer centimetres, in perspective, with its shadow on the floor. Writes its size to `words` (empty if there
    /// is no box), and into the box if `with_words`.
    fn draw_box(&mut self, frame: (f32, f32), settings: &Settings, with_words: bool) {
        self.words.clear();
        let size = frame.0 * settings.box_share;
        let (left, top) = place_of(self.corner, frame, size);
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in self.positions.iter().flatten() {
            (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
        }
        if !low.iter().chain(&high).all(|v| v.is_finite()) {
            return;
        }
        let side_mm = (0..3).map(|k| high[k] - low[k]).fold(10.0, f64::max);
        let side_mm = (side_mm / 10.0).ceil() * 10.0;
        let middle: Point = std::array::from_fn(|k| (low[k] + high[k]) / 2.0);
        if top < 0.0 || left < 0.0 {
            return;
        }
        let mut shapes = std::mem::take(&mut self.shapes);
        shapes.plate((left as i32, top as i32), size as i32, [0; 3], 0.55);
        let grown = (size / USUAL_BOX_PX).max(1.0);
        // Cabinet view: x to the right, y (down in the picture) down, z away, to the upper right.
        let place = |p: Point| {
            let n: [f32; 3] = std::array::from_fn(|k| ((p[k] - middle[k]) / side_mm) as f32);
            let scale = size * 0.56;
            (left + size * 0.5 + scale * (n[0] + 0.42 * n[2]), top + size * 0.48 + scale * (n[1] - 0.30 * n[2]))
        };
        let half = side_mm / 2.0;
        let corner = |bits: usize| -> Point {
            std::array::from_fn(|k| middle[k] + if bits >> k & 1 == 1 { half } else { -half })
        };
        for bits in 0..8usize {
            for axis in (0..3).filter(|axis| bits >> axis & 1 == 0) {
                shapes.line(place(corner(bits)), place(corner(bits | 1 << axis)), grown, [110; 3]);
            }
        }
        for (a, b, age) in self.steps() {
            let floor = |p: Point| [p[0], middle[1] + half, p[2]];
            shapes.line(place(floor(a)), place(floor(b)), grown, [90; 3]);
            shapes.line(place(a), place(b), settings.line_px * 0.75 * grown, color(age));
        }
        let _ = write!(self.words, "box {side_mm:.0} mm");
        if with_words {
            let room = 5.0 * grown;
            shapes.text((left + room, top + room), &self.words, settings.text_scale * grown, [220; 3]);
        }
        self.shapes = shapes;
    }
}

impl Node for Trajectory {
    const INFO: NodeInfo =
        NodeInfo::compute("trajectory", "overlay", "Draws the trajectory of a tool's tip on the image and in a box.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn open(open: &Open<'_>, settings: &Settings) -> Result<Self> {
        let mut on_device = OnDevice::default();
        on_device.choose(settings.device, open, open_device);
        let (positions, words) = (VecDeque::with_capacity(settings.length), String::with_capacity(64));
        Ok(Self { positions, words, corner: 0, shapes: Shapes::default(), on_device })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, settings: &Settings) -> Result<()> {
        self.on_device.choose(settings.device, cx, open_device);
        let frame = match &input.camera_pose {
            Some(pose) => Frame::of(pose).ok_or_else(|| {
                error!("the camera pose is not valid: its numbers are not finite, or its quaternion is 0")
            })?,
            None => Frame::NONE,
        };
        let tip = input.tip.filter(|tip| tip.xyz_valid == 1 && tip.xyz_mm.iter().all(|v| v.is_finite()));
        if self.positions.len() == settings.length {
            self.positions.pop_front();
        }
        self.positions.push_back(tip.map(|tip| frame.outward(tip.xyz_mm)));
        let frame_px = (input.image.width() as f32, input.image.height() as f32);
        self.shapes.clear();
        self.draw_way(&input, &frame, frame_px, settings);
        self.words.clear();
        let is_elsewhere = out.text.is_read();
        if settings.show_box {
            let mut taken = [Area::default(); 17];
            let mut count = 0;
            let tip_px = input.tip.as_ref().map(|tip| (tip.u_px as f32, tip.v_px as f32));
            if let Some((u, v)) = tip_px.filter(|(u, v)| u.is_finite() && v.is_finite()) {
                let (x, y, length) = (u - TIP_ROOM_PX, v - TIP_ROOM_PX, 2.0 * TIP_ROOM_PX);
                taken[0] = Area { x, y, width: length, height: length };
                count = 1;
            }
            let boxes = input.detections.iter().flat_map(|d| d.items());
            for (place, item) in taken[count..].iter_mut().zip(boxes) {
                *place = Area { x: item.x_px, y: item.y_px, width: item.width_px, height: item.height_px };
                count += 1;
            }
            self.choose_corner(frame_px, frame_px.0 * settings.box_share, &taken[..count]);
            self.draw_box(frame_px, settings, !is_elsewhere);
        }
        if !self.draw_there(cx, &input.image, &mut out.image)? {
            self.shapes.draw(&mut out.image.alloc_copy(&input.image)?);
        }
        if is_elsewhere {
            out.text.set_text(&self.words)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_leaves_what_it_covers_and_stays_where_it_covers_nothing() {
        let (positions, words, shapes, on_device) = Default::default();
        let mut drawn = Trajectory { positions, words, corner: 0, shapes, on_device };
        let (frame, size) = ((640.0, 480.0), 192.0);
        let area = |x: f32, y: f32, width: f32, height: f32| Area { x, y, width, height };
        drawn.choose_corner(frame, size, &[area(100.0, 100.0, 200.0, 100.0)]);
        assert_eq!(drawn.corner, 0, "nothing is covered");
        drawn.choose_corner(frame, size, &[area(400.0, 250.0, 240.0, 230.0)]);
        assert_eq!(CORNERS[drawn.corner], (false, true), "an instrument comes from the lower right");
        drawn.choose_corner(frame, size, &[area(100.0, 100.0, 50.0, 50.0)]);
        assert_eq!(CORNERS[drawn.corner], (false, true), "it does not jump back");
        drawn.choose_corner(frame, size, &[area(0.0, 250.0, 640.0, 230.0)]);
        assert_eq!(CORNERS[drawn.corner], (true, false));
        // Not a number.
        drawn.choose_corner(frame, size, &[area(f32::NAN, 0.0, f32::NAN, 9.0)]);
        assert_eq!(CORNERS[drawn.corner], (true, false));
    }
}
