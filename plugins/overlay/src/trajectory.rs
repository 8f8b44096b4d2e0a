//! `trajectory`: the trajectory of a tool's tip in space, on the picture and in a small box (thesis, fig. 6.5).

use std::collections::VecDeque;
use std::fmt::Write;

use panoscope_imaging::draw::{self, Color};
use panoscope_node::abi::{Calibration, Pose, Tip};
use panoscope_node::{Bgr8, Context, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, Value, ViewMut, error};

/// Inputs.
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
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// The picture with the trajectory drawn.
    image: Slot<'f, Bgr8>,
}

/// Parameters.
#[derive(Params)]
pub struct Settings {
    /// Length of the trajectory.
    #[param(default = 240, range = 2..=3000, unit = "frames", reopen)]
    length: usize,
    /// Marks the centre of the picture that both cameras share, at this distance from the left camera; 0 draws no mark.
    #[param(default = 66.0, range = 0.0..=200.0, step = 1.0, unit = "mm")]
    goal_mm: f64,
    /// Draws the trajectory in a box too, seen in perspective.
    #[param(default = true)]
    show_box: bool,
    /// Width of the box, as a share of the picture's width.
    #[param(default = 0.3, range = 0.1..=1.0, step = 0.05, unit = "ratio")]
    box_share: f32,
    /// Width of lines.
    #[param(default = 2.0, range = 0.5..=20.0, step = 0.5, unit = "px")]
    line_px: f32,
    /// Size of text: capital letters are six times as many px high.
    #[param(default = 1.5, range = 0.5..=20.0, step = 0.5)]
    text_scale: f32,
}

type Point = [f64; 3];

/// Draws the trajectory of a tip.
pub struct Trajectory {
    /// Positions in the scene, mm, oldest first; none where the tip was lost.
    positions: VecDeque<Option<Point>>,
    words: String,
}

/// A pose as rows of a rotation, and a translation, mm.
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

/// Colours from blue (oldest) to yellow (newest).
fn color(age: f32) -> Color {
    let new = 1.0 - age.clamp(0.0, 1.0);
    [(230.0 * (1.0 - new)) as u8 + 20, (90.0 + 140.0 * new) as u8, (40.0 + 210.0 * new) as u8]
}

/// Projects a position in the camera's frame to the picture, px; none behind the camera.
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

    /// The trajectory in a box of whole centimetres, seen from above and from the side, with its shadow on the floor.
    fn draw_box(&mut self, out: &mut ViewMut<'_, u8>, settings: &Settings) {
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
        let size = out.width as f32 * settings.box_share;
        let (left, top) = (out.width as f32 - size - 6.0, out.height as f32 - size - 6.0);
        if top < 0.0 {
            return;
        }
        draw::fill_rectangle(out, left as i32, top as i32, size as i32, size as i32, [0; 3], 0.55);
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
                draw::line(out, place(corner(bits)), place(corner(bits | 1 << axis)), 1.0, [110; 3]);
            }
        }
        for (a, b, age) in self.steps() {
            let floor = |p: Point| [p[0], middle[1] + half, p[2]];
            draw::line(out, place(floor(a)), place(floor(b)), 1.0, [90; 3]);
            draw::line(out, place(a), place(b), settings.line_px * 0.75, color(age));
        }
        self.words.clear();
        let _ = write!(self.words, "{side_mm:.0} mm");
        draw::text(out, left + 5.0, top + 5.0, &self.words, settings.text_scale, [220; 3]);
    }
}

impl Node for Trajectory {
    const INFO: NodeInfo =
        NodeInfo::compute("trajectory", "overlay", "Draws the trajectory of a tool's tip on the picture and in a box.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn open(_: &Open<'_>, settings: &Settings) -> Result<Self> {
        Ok(Self { positions: VecDeque::with_capacity(settings.length), words: String::with_capacity(64) })
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, settings: &Settings) -> Result<()> {
        let frame = match &input.camera_pose {
            Some(pose) => Frame::of(pose).ok_or_else(|| error!("the camera pose holds numbers that are no pose"))?,
            None => Frame::NONE,
        };
        let tip = input.tip.filter(|tip| tip.xyz_valid == 1 && tip.xyz_mm.iter().all(|v| v.is_finite()));
        if self.positions.len() == settings.length {
            self.positions.pop_front();
        }
        self.positions.push_back(tip.map(|tip| frame.outward(tip.xyz_mm)));
        let mut picture = out.image.alloc_copy(&input.image)?;
        if let Some(calibration) = &input.calibration {
            let projection = &calibration.left_projection;
            for (a, b, age) in self.steps() {
                let ends = pixel(projection, frame.inward(a)).zip(pixel(projection, frame.inward(b)));
                if let Some((a, b)) = ends {
                    draw::line(&mut picture, a, b, settings.line_px, color(age));
                }
            }
            let x = calibration.baseline_mm / 2.0;
            let goal = [x, 0.0, (settings.goal_mm * settings.goal_mm - x * x).max(0.0).sqrt()];
            if settings.goal_mm > 0.0
                && let Some((u, v)) = pixel(projection, goal)
            {
                draw::circle(&mut picture, u, v, 14.0, settings.line_px, [255, 255, 255]);
                draw::cross(&mut picture, u, v, 6.0, 1.0, [255, 255, 255]);
            }
        }
        if settings.show_box {
            self.draw_box(&mut picture, settings);
        }
        Ok(())
    }
}
