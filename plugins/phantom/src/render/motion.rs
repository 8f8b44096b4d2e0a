//! The scripted camera, and breathing.

use super::boards;
use super::kinds::SceneKind;
use super::math::{Pose, Stream, cos_turns, sin_turns};
use super::params::{CameraPath, IncidentKind, SceneParams};

/// Offset of a jump, mm: sideways by a third of the field of view, and nearer.
const JUMP_MM: [f64; 3] = [12.0, -7.0, 8.0];

/// Height of the two rises of a ring path, mm, for tissue 50 mm away or more.
const RING_RISE_MM: f64 = 1.5;
/// Rotation along a ring path about x, y and z: amplitude in degrees, and periods per lap.
const RING_TURN: [(f64, f64); 3] = [(2.0, 1.0), (2.0, 2.0), (8.0, 1.0)];

/// Direction of a glide: along the tissue (x, y), and the share of its speed along z; the squares add up to 1.
const GLIDE: [f64; 3] = [0.8, 0.48, 0.36];
/// Distance that a glide moves to either side of the first distance, mm at 50 mm.
const GLIDE_DEPTH_MM: f64 = 4.0;

/// Sines of one axis: amplitude, frequency in Hz, phase in turns.
#[derive(Clone, Copy, Debug)]
struct Sway([[f64; 3]; 2]);

impl Sway {
    /// Two sines whose maximum speeds add up to `speed`, neither amplitude above `limit`.
    fn new(stream: &mut Stream, speed: f64, limit: f64, slow_hz: f32, fast_hz: f32) -> Self {
        let mut wave = |share: f64, low: f32, high: f32, limit: f64| {
            let wanted = f64::from(stream.range(low, high));
            let phase = f64::from(stream.range(0.0, 1.0));
            let speed = speed * share;
            let frequency = wanted.max(speed / (std::f64::consts::TAU * limit));
            [speed / (std::f64::consts::TAU * frequency), frequency, phase]
        };
        let mean = 0.5 * (slow_hz + fast_hz);
        Self([wave(0.65, slow_hz, mean, limit * 0.7), wave(0.35, mean, fast_hz, limit * 0.3)])
    }

    /// Offset from the position at time 0.
    fn at(&self, seconds: f64) -> f64 {
        let wave = |[amplitude, frequency, phase]: [f64; 3]| {
            amplitude * (sin_turns(frequency * seconds + phase) - sin_turns(phase))
        };
        wave(self.0[0]) + wave(self.0[1])
    }
}

/// Movement at a constant speed. The scene is periodic, so the movement never ends.
#[derive(Clone, Copy, Debug)]
struct Glide {
    /// Speed, mm/s.
    speed: f64,
    /// Maximum change of distance to either side, mm.
    depth_mm: f64,
}

impl Glide {
    /// Offset from the position at time 0.
    fn at(&self, seconds: f64) -> [f64; 3] {
        let distance_mm = self.speed * seconds;
        // A triangle wave: nearer and away at one speed.
        let turns = GLIDE[2] * distance_mm / (4.0 * self.depth_mm) + 0.25;
        let saw = turns - turns.floor();
        let triangle = if saw < 0.5 { 4.0 * saw - 1.0 } else { 3.0 - 4.0 * saw };
        [GLIDE[0] * distance_mm, GLIDE[1] * distance_mm, self.depth_mm * triangle]
    }
}

/// Smooth seeded motion of the first camera.
#[derive(Clone, Debug)]
pub struct Script {
    place: [Sway; 3],
    turn: [Sway; 3],
    glide: Option<Glide>,
    breath_hz: f64,
    breath_mm: f64,
    fps: f64,
    /// Frame of the jump.
    jump: Option<u64>,
    /// Radius (mm), rise (mm) and laps per second of a camera on a ring.
    ring: Option<[f64; 3]>,
    /// Parameters of a scene with a board, which is shown in a new pose in each frame.
    board: Option<SceneParams>,
}

impl Script {
    /// The script of a scene; its speed never exceeds `camera_speed_mm_s`.
    pub fn new(params: &SceneParams) -> Self {
        let mut stream = Stream::new(params.seed, 100);
        let speed = params.camera_speed_mm_s;
        let near = (params.distance_mm / 50.0).min(1.0);
        // Shares whose squares add up to at most one, so that the axes together keep the limit.
        let place = [(0.80, 12.0), (0.52, 9.0), (0.28, 5.0 * near)]
            .map(|(share, limit)| Sway::new(&mut stream, speed * share, limit, 0.06, 0.25));
        let turn = [0.9, 0.9, 1.5].map(|share| Sway::new(&mut stream, speed / 10.0 * share, 3.0, 0.05, 0.2));
        let ring = (params.camera_path == CameraPath::Ring).then(|| {
            let (radius, rise) = (params.path_mm / 2.0, RING_RISE_MM * near);
            // Two rises a lap: the speed along z is twice theirs.
            let hz = speed / (std::f64::consts::TAU * (radius * radius + 4.0 * rise * rise).sqrt());
            [radius, rise, hz]
        });
        Self {
            place,
            turn,
            ring,
            glide: (params.camera_path == CameraPath::Glide)
                .then_some(Glide { speed, depth_mm: GLIDE_DEPTH_MM * near }),
            breath_hz: 1.0 / params.breathing_period_s,
            breath_mm: params.breathing_mm,
            fps: params.fps,
            jump: params.incident.filter(|i| i.kind == IncidentKind::Jump).map(|i| i.first),
            board: (params.scene == SceneKind::Board && speed > 0.0).then(|| params.clone()),
        }
    }

    /// `scene_from_camera` of the first camera at frame time `frames` (fractions allowed).
    pub fn pose(&self, frames: f64) -> Pose {
        if let Some(params) = &self.board {
            // Within a frame the board stands still.
            return boards::shown_pose(params, (frames + 0.5).max(0.0) as u64);
        }
        let seconds = frames / self.fps;
        let (mut translation_mm, turn_deg) = match (self.ring, self.glide) {
            (Some([radius, rise, hz]), _) => {
                let laps = hz * seconds;
                let place = [radius * (1.0 - cos_turns(laps)), radius * sin_turns(laps), rise * sin_turns(2.0 * laps)];
                (place, RING_TURN.map(|(degrees, times)| degrees * sin_turns(times * laps)))
            }
            (None, Some(glide)) => (glide.at(seconds), [0, 1, 2].map(|i| self.turn[i].at(seconds))),
            (None, None) => ([0, 1, 2].map(|i| self.place[i].at(seconds)), [0, 1, 2].map(|i| self.turn[i].at(seconds))),
        };
        if self.jump.is_some_and(|first| frames + 0.5 >= first as f64) {
            translation_mm.iter_mut().zip(JUMP_MM).for_each(|(place, jump)| *place += jump);
        }
        // Degrees to turns; small rotations about x, y and z one after the other.
        let half = turn_deg.map(|degrees| degrees / 720.0);
        let (s, c) = (half.map(sin_turns), half.map(cos_turns));
        let quaternion = [
            c[0] * c[1] * c[2] - s[0] * s[1] * s[2],
            s[0] * c[1] * c[2] + c[0] * s[1] * s[2],
            c[0] * s[1] * c[2] - s[0] * c[1] * s[2],
            c[0] * c[1] * s[2] + s[0] * s[1] * c[2],
        ];
        Pose { quaternion, translation_mm }
    }

    /// Displacement of the tissue by breathing, mm.
    pub fn breath_mm(&self, frames: f64) -> f64 {
        let turns = frames / self.fps * self.breath_hz;
        // Breathing out takes longer than in: the second harmonic leans the wave.
        self.breath_mm * (0.85 * sin_turns(turns) + 0.15 * sin_turns(2.0 * turns + 0.1) - 0.15 * sin_turns(0.1))
    }
}
