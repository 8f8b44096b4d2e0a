//! Instruments: shapes and joints of the seven kinds, their movement, their ground truth in an image.

use super::kinds::ToolKind;
use super::math::{Pose, Stream, sin_turns};
use super::params::SceneParams;
use super::scenario::Script;
use super::solid::{Paint, Part, Solid, add, dot};

/// Ground truth of one instrument in the first camera's ideal view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolTruth {
    /// Kind.
    pub kind: ToolKind,
    /// Value of its pixels in the plane of identities.
    pub id: u8,
    /// Number of visible pixels.
    pub pixels: usize,
    /// Bounding box of the visible pixels: x, y, width, height, px; all zero if none is visible.
    pub bounds_px: [usize; 4],
    /// The tip in the first camera's frame, mm.
    pub tip_mm: [f64; 3],
    /// Projection of the tip, px; NaN behind the camera.
    pub tip_px: [f64; 2],
    /// Whether the tip is inside the image with nothing in front of it.
    pub tip_visible: bool,
}

const STEEL: Paint = Paint { albedo: [0.52, 0.51, 0.50], metal: 1.0 };
const SHAFT: Paint = Paint { albedo: [0.30, 0.29, 0.28], metal: 0.8 };
const BLACK: Paint = Paint { albedo: [0.035, 0.03, 0.03], metal: 0.15 };
const BLUE: Paint = Paint { albedo: [0.55, 0.22, 0.08], metal: 0.1 };
const IVORY: Paint = Paint { albedo: [0.50, 0.62, 0.66], metal: 0.1 };
const BAG: Paint = Paint { albedo: [0.26, 0.31, 0.33], metal: 0.05 };

/// One instrument of a scene.
#[derive(Clone, Debug)]
pub struct Tool {
    kind: ToolKind,
    id: u8,
    /// Where it passes the abdominal wall, scene, mm.
    trocar: [f64; 3],
    /// Mean position of the tip, scene, mm.
    home: [f64; 3],
    /// Movement of the tip along x, y, z: amplitude (mm), frequency (Hz), phase (turns).
    sway: [[f64; 3]; 3],
    roll: [f64; 3],
    open: [f64; 3],
    /// Script of the leading instrument, or of the second one that passes in front of it.
    script: Option<Script>,
}

/// Depth of the tip of a scripted leading instrument, as a share of the distance to the tissue.
const SCRIPTED_DEPTH: f64 = 0.78;

/// Share of its roll that a scripted instrument keeps.
const HELD_ROLL: f64 = 0.25;

/// An instrument's parts and tip in the scene.
#[derive(Clone, Debug)]
pub struct Posed {
    /// Kind.
    pub kind: ToolKind,
    /// Identity, from 1.
    pub id: u8,
    /// Tip, mm.
    pub tip: [f64; 3],
    parts: [Part; 6],
    count: usize,
}

impl Posed {
    /// The parts.
    pub fn parts(&self) -> &[Part] {
        &self.parts[..self.count]
    }

    fn push(&mut self, part: Part) {
        if let Some(slot) = self.parts.get_mut(self.count) {
            *slot = part;
            self.count += 1;
        }
    }
}

/// The `params.tools` instruments of a scene.
pub fn cast_of(params: &SceneParams) -> Vec<Tool> {
    let mut stream = Stream::new(params.seed, 400);
    let first = stream.bits() as usize;
    let distance = params.distance_mm;
    let kind = |i: usize| match params.tool_kinds.len() {
        0 => ToolKind::ALL[(first + i) % 7],
        count => params.tool_kinds[i % count],
    };
    (0..params.tools as usize)
        .map(|i| {
            let mut wave = |low: f32, high: f32| {
                let frequency = f64::from(stream.range(0.05, 0.22));
                [f64::from(stream.range(low, high)), frequency, f64::from(stream.range(0.0, 1.0))]
            };
            let sway = [wave(3.0, 8.0), wave(2.0, 6.0), wave(1.0, 2.5)];
            let (roll, open) = (wave(0.05, 0.2), wave(0.02, 0.05));
            // Trocars stand in turn right, left, above and below, well outside the picture.
            let side = [[1.0, 0.25], [-1.0, 0.35], [0.35, -1.0], [-0.3, 1.0]][i % 4];
            let across = f64::from(stream.range(1.1, 1.6)) * distance;
            let trocar = [7.5 + side[0] * across, side[1] * across, distance * f64::from(stream.range(0.15, 0.4))];
            let home = [
                7.5 + side[0] * 4.0 + f64::from(stream.range(-3.0, 3.0)),
                side[1] * 3.0 + f64::from(stream.range(-3.0, 3.0)),
                distance * f64::from(stream.range(0.68, 0.80)),
            ];
            let mut tool = Tool { kind: kind(i), id: i as u8 + 1, trocar, home, sway, roll, open, script: None };
            if i < 2 {
                tool.follow(Script::new(params.tool_motion, params.seed), distance);
            }
            tool
        })
        .collect()
}

impl Tool {
    /// Replaces swinging by a script: always for the first instrument, for the second only if the script lets it pass.
    fn follow(&mut self, script: Script, distance_mm: f64) {
        let leads = self.id == 1;
        if script.is_sway() || !(leads || script.crossing(0.0).is_some()) {
            return;
        }
        // Before the middle of the picture that two cameras share.
        self.home = [7.5, 0.0, SCRIPTED_DEPTH * distance_mm];
        self.script = Some(script);
    }

    /// Position of the tip at a time, scene, mm.
    fn tip(&self, seconds: f64) -> [f64; 3] {
        let swing = |[amplitude, hz, phase]: [f64; 3]| amplitude * sin_turns(hz * seconds + phase);
        let Some(script) = &self.script else { return [0, 1, 2].map(|k| self.home[k] + swing(self.sway[k])) };
        let offset = if self.id == 1 {
            let out = add(self.trocar, self.home, -1.0);
            let long = dot(out, out).sqrt().max(1e-6);
            script.at(seconds, out.map(|v| v / long))
        } else {
            script.crossing(seconds).unwrap_or([0.0; 3])
        };
        add(self.home, offset, 1.0)
    }

    /// Pose of the instrument at a time.
    pub fn at(&self, seconds: f64) -> Posed {
        let tip = self.tip(seconds);
        let toward = add(tip, self.trocar, -1.0);
        let long = dot(toward, toward).sqrt().max(1e-6);
        let z = toward.map(|v| v / long);
        let (x, y) = self.across(z, seconds);
        // Half the angle between the jaws, turns.
        let half = 0.055 + swing(self.open, seconds);
        let (js, jc) = (sin_turns(half), sin_turns(half + 0.25));
        let reach = match self.kind {
            ToolKind::Grasper | ToolKind::Scissors => 17.0 * jc,
            ToolKind::Bipolar => 19.0 * jc,
            ToolKind::Hook => 13.0,
            ToolKind::Clipper => 13.0 * jc,
            ToolKind::Irrigator => 10.0,
            ToolKind::SpecimenBag => 24.0,
        };
        // The joint is where the tip's position along the shaft leads back to.
        let joint = add(tip, z, -reach);
        let frame = JointFrame { joint, axes: [x, y, z], jaw: [js, jc], id: self.id };
        let blank = frame.part(joint, 0.1, joint, 0.1, STEEL);
        let mut tool = Posed { kind: self.kind, id: self.id, tip, parts: [blank; 6], count: 0 };
        self.assemble(&frame, &mut tool);
        tool
    }

    /// Two unit vectors across the shaft `z`, rolled about it. A scripted instrument is held so that what is bent or opens is across the line of
    /// sight: no part of it is ever in front of its tip.
    fn across(&self, z: [f64; 3], seconds: f64) -> ([f64; 3], [f64; 3]) {
        let held = self.script.is_some() && z[2].abs() < 0.9;
        let seed = match z {
            _ if held => [0.0, 0.0, 1.0],
            [_, y, _] if y.abs() < 0.8 => [0.0, 1.0, 0.0],
            _ => [1.0, 0.0, 0.0],
        };
        let x0 = cross(seed, z);
        let inv = 1.0 / dot(x0, x0).sqrt();
        let x0 = x0.map(|v| v * inv);
        let y0 = cross(z, x0);
        let turn = swing(self.roll, seconds) * if held { HELD_ROLL } else { 1.0 };
        let (s, c) = (sin_turns(turn), sin_turns(turn + 0.25));
        let x = add(x0.map(|v| v * c), y0, s);
        (x, cross(z, x))
    }

    /// Adds the parts of the instrument's kind.
    fn assemble(&self, frame: &JointFrame, tool: &mut Posed) {
        let place = |px: f64, py: f64, pz: f64| frame.place(px, py, pz);
        let part = |a, radius_a, b, radius_b, paint| frame.part(a, radius_a, b, radius_b, paint);
        match self.kind {
            ToolKind::Grasper => {
                tool.push(part(self.trocar, 2.5, place(0.0, 0.0, -5.0), 2.5, SHAFT));
                tool.push(part(place(0.0, 0.0, -5.0), 2.2, place(0.0, 0.0, 0.0), 1.8, STEEL));
                frame.push_jaws(tool, 17.0, 1.5, 1.0, 1.0, STEEL);
            }
            ToolKind::Bipolar => {
                tool.push(part(self.trocar, 2.6, place(0.0, 0.0, -8.0), 2.6, BLACK));
                tool.push(part(place(0.0, 0.0, -8.0), 2.4, place(0.0, 0.0, -1.0), 1.6, BLUE));
                frame.push_jaws(tool, 19.0, 1.2, 0.6, 0.8, STEEL);
            }
            ToolKind::Hook => {
                tool.push(part(self.trocar, 2.5, place(0.0, 0.0, -4.0), 2.5, BLACK));
                tool.push(part(place(0.0, 0.0, -4.0), 2.3, place(0.0, 0.0, 3.0), 1.2, IVORY));
                tool.push(part(place(0.0, 0.0, 3.0), 0.7, place(0.0, 0.0, 12.4), 0.6, STEEL));
                tool.push(part(place(0.0, 0.0, 12.4), 0.6, place(-4.5, 0.0, 12.0), 0.5, STEEL));
            }
            ToolKind::Scissors => {
                tool.push(part(self.trocar, 2.5, place(0.0, 0.0, -4.0), 2.5, BLACK));
                tool.push(part(place(0.0, 0.0, -4.0), 2.1, place(0.0, 0.0, 0.0), 1.7, STEEL));
                frame.push_jaws(tool, 17.0, 1.9, 0.4, 0.35, STEEL);
            }
            ToolKind::Clipper => {
                tool.push(part(self.trocar, 4.6, place(0.0, 0.0, -5.0), 4.6, SHAFT));
                tool.push(part(place(0.0, 0.0, -5.0), 3.4, place(0.0, 0.0, 0.0), 2.4, STEEL));
                frame.push_jaws(tool, 13.0, 1.7, 1.3, 0.7, STEEL);
            }
            ToolKind::Irrigator => {
                tool.push(part(self.trocar, 2.5, place(0.0, 0.0, 7.5), 2.5, STEEL));
                // Side holes, as dark beads sunk into the wall.
                for (k, along) in [0.0, 4.0].into_iter().enumerate() {
                    let side = if k == 0 { 2.0 } else { -2.0 };
                    tool.push(part(place(side, -0.6, along), 0.9, place(side, 0.6, along), 0.9, BLACK));
                }
            }
            ToolKind::SpecimenBag => {
                tool.push(part(self.trocar, 2.5, place(0.0, 0.0, 0.0), 2.5, SHAFT));
                tool.push(Part {
                    flat: (frame.axes[1], 0.6),
                    ..part(place(0.0, 0.0, 4.0), 4.0, place(0.0, 0.0, 16.0), 8.0, BAG)
                });
            }
        }
    }
}

/// Value of an oscillation (amplitude, Hz, phase in turns) at a time.
fn swing([amplitude, hz, phase]: [f64; 3], seconds: f64) -> f64 {
    amplitude * sin_turns(hz * seconds + phase)
}

/// The joint of an instrument, mm, with the axes of its parts: two across the shaft, and one along it towards the tip.
struct JointFrame {
    joint: [f64; 3],
    axes: [[f64; 3]; 3],
    /// Sine and cosine of half the angle between the jaws.
    jaw: [f64; 2],
    id: u8,
}

impl JointFrame {
    /// A point given along the axes from the joint.
    fn place(&self, px: f64, py: f64, pz: f64) -> [f64; 3] {
        let [x, y, z] = self.axes;
        add(add(add(self.joint, x, px), y, py), z, pz)
    }

    fn part(&self, a: [f64; 3], radius_a: f64, b: [f64; 3], radius_b: f64, paint: Paint) -> Part {
        Part { a, radius_a, b, radius_b, flat: (self.axes[1], 1.0), paint, id: self.id }
    }

    fn push_jaws(&self, tool: &mut Posed, length: f64, base: f64, end: f64, thickness: f64, paint: Paint) {
        let [js, jc] = self.jaw;
        for side in [-1.0, 1.0] {
            let tip = self.place(side * js * (length - end), 0.0, jc * (length - end));
            let flat = (self.axes[1], thickness);
            tool.push(Part { flat, ..self.part(self.place(side * 0.6, 0.0, 0.0), base, tip, end, paint) });
        }
    }
}

impl Posed {
    /// Appends the parts in the frame of a camera at `offset_mm` from the first one.
    pub fn place_in_camera(&self, pose: &Pose, offset_mm: [f64; 3], out: &mut Vec<Solid>) {
        for part in self.parts() {
            let (a, b) = (to_camera(pose, offset_mm, part.a), to_camera(pose, offset_mm, part.b));
            let zero = to_camera(pose, offset_mm, [0.0; 3]);
            let n = add(to_camera(pose, offset_mm, part.flat.0), zero, -1.0);
            out.push(Solid::new(Part { a, b, flat: (n, part.flat.1), ..*part }));
        }
    }
}

/// Transforms a point of the scene to a camera's frame, mm.
pub fn to_camera(pose: &Pose, offset_mm: [f64; 3], p: [f64; 3]) -> [f64; 3] {
    let r = pose.rotation();
    let q = add(p, pose.translation_mm, -1.0);
    [0, 1, 2].map(|k| r[0][k] * q[0] + r[1][k] * q[1] + r[2][k] * q[2] - offset_mm[k])
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
