//! Parameters of `phantom`, and their conversion to a scene.

use panoscope_imaging::stereo::Equidistant;
use panoscope_node::{Choice, NodeError, Params, Result};

use crate::render::{
    BlackOut, BoardPrint, CameraPath, Canvas, Incident, IncidentKind, Rig, SceneKind, SceneParams, ToolKind, ToolMotion,
};

/// Scene to render.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Scene {
    /// Smooth lobes with thin vessels.
    Liver,
    /// Loops of bowel, branching vessels, fat.
    Bowel,
    /// A deep pocket, 20 mm to more than 70 mm away.
    Cavity,
    /// A phantom box with rulers and blocks of known size.
    Box,
    /// A flat calibration board, in another pose each tick while `speed_mm_s` is not 0. From about 85 mm on both cameras see the complete board.
    Board,
}

/// Pattern of the board.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Board {
    /// `chessboard:9x6:3mm`.
    Chessboard,
    /// `circles:4x11:3mm`.
    Circles,
    /// `charuco:10x7:3mm:2.25mm:4x4_50`.
    Charuco,
}

/// Views that are missing in a dropped tick.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum DropViews {
    /// All views.
    All,
    /// The left view.
    Left,
    /// The right view.
    Right,
}

/// Arrangement of the cameras.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Layout {
    /// Left and right.
    Stereo,
    /// Two above two: view0, view1, view2, view3.
    Quad,
}

/// Lens model of the cameras.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum LensChoice {
    /// Pinhole with OpenCV's radial distortion.
    Pinhole,
    /// A fisheye (Kannala and Brandt; OpenCV's `fisheye`).
    Equidistant,
}

/// Camera whose image goes black.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum BlackCamera {
    /// No camera.
    None,
    /// The left camera.
    Left,
    /// The right camera.
    Right,
}

/// Kind of incident.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum IncidentChoice {
    /// No incident.
    None,
    /// Dense smoke before both cameras.
    Smoke,
    /// The scope shakes: each image is blurred over about 40 px.
    Blur,
    /// The scope jumps to another position and stays there.
    Jump,
    /// Tissue covers the lens of the last camera.
    Covered,
}

/// How the scripted camera moves.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum PathChoice {
    /// Seeded swings about its resting position.
    Sway,
    /// Circles parallel to the tissue; each ends where it began.
    Ring,
    /// Along the tissue, alternately nearer and farther, always at `speed_mm_s`.
    Glide,
}

/// Movement of the first instrument.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Slow swings about a seeded position, like all other instruments.
    Sway,
    /// At rest in front of the centre of the image region that both cameras share.
    Still,
    /// Steps of 12 mm to the side and back at up to 25 mm/s, every 4 s.
    Step,
    /// To and fro over 36 mm at 12 mm/s.
    Ramp,
    /// A circle of 12 mm radius in 5 s.
    Circle,
    /// Strokes like a surgeon's at up to 25 mm/s.
    Strokes,
    /// Leaves the image at up to 150 mm/s and returns at 40 mm/s, every 12 s.
    Leave,
    /// Rests while the second instrument passes in front of it.
    Cross,
}

/// Parameters of the phantom.
#[derive(Params, Clone, PartialEq)]
pub struct PhantomParams {
    /// Scene to render.
    #[param(default = "bowel", reopen)]
    pub scene: Scene,
    /// Pattern of the board in the scene `board`.
    #[param(default = "chessboard", reopen)]
    pub board: Board,
    /// Seed of all random numbers: the same seed gives the same images on every machine.
    #[param(default = 7, range = 0..=1_000_000_000, reopen)]
    pub seed: u64,
    /// Arrangement of the cameras.
    #[param(default = "stereo", reopen)]
    pub layout: Layout,
    /// Image width of each camera.
    #[param(default = 640, range = 64..=3840, unit = "px", reopen)]
    pub width: u32,
    /// Image height of each camera.
    #[param(default = 480, range = 48..=2160, unit = "px", reopen)]
    pub height: u32,
    /// Distance between neighbouring cameras.
    #[param(default = 15.0, range = 1.0..=40.0, step = 0.5, unit = "mm", reopen)]
    pub baseline_mm: f64,
    /// Mean distance from the resting left camera to the tissue.
    #[param(default = 50.0, range = 15.0..=150.0, step = 1.0, unit = "mm", reopen)]
    pub distance_mm: f64,
    /// Frames per second of media time.
    #[param(default = 30.0, range = 1.0..=240.0, step = 1.0, unit = "Hz", reopen)]
    pub rate_hz: f64,
    /// Height of the tissue's relief; 0 is a plane. No effect on `box` and `board`.
    #[param(default = 1.0, range = 0.0..=1.0, step = 0.05, unit = "ratio", reopen)]
    pub relief: f64,
    /// How the scripted camera moves.
    #[param(default = "sway", reopen)]
    pub camera_path: PathChoice,
    /// Diameter of the path `ring`.
    #[param(default = 40.0, range = 1.0..=100.0, step = 1.0, unit = "mm", reopen)]
    pub path_mm: f64,
    /// Maximum speed of the scripted camera; 0 keeps it still.
    #[param(default = 10.0, range = 0.0..=200.0, step = 0.5, unit = "mm/s", reopen)]
    pub speed_mm_s: f64,
    /// Amplitude of breathing.
    #[param(default = 1.0, range = 0.0..=5.0, step = 0.1, unit = "mm", reopen)]
    pub breathing_mm: f64,
    /// Strength of specular highlights.
    #[param(default = 1.0, range = 0.0..=4.0, step = 0.1, unit = "ratio", reopen)]
    pub specular: f32,
    /// Strength of vessels, mottling, flecks and grain; 0 is smooth tissue of one colour.
    #[param(default = 1.0, range = 0.0..=1.0, step = 0.05, unit = "ratio", reopen)]
    pub texture: f32,
    /// Light that reaches the sensors. Less light gives a darker and, with the same noise, noisier image.
    #[param(default = 1.0, range = 0.01..=4.0, step = 0.01, unit = "ratio", reopen)]
    pub light: f32,
    /// Strength of sensor noise; 1 is a good small sensor.
    #[param(default = 1.0, range = 0.0..=8.0, step = 0.1, unit = "ratio", reopen)]
    pub noise: f32,
    /// Density of smoke.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.05, unit = "ratio", reopen)]
    pub smoke: f32,
    /// Number of blood drops on each lens.
    #[param(default = 0, range = 0..=32, reopen)]
    pub blood_drops: u32,
    /// Number of sub-frames averaged for motion blur; 1 is none.
    #[param(default = 1, range = 1..=16, unit = "frames", reopen)]
    pub motion_blur: u32,
    /// Share of the frame time for which the shutter is open; used if `motion_blur` is above 1.
    #[param(default = 0.5, range = 0.0..=1.0, step = 0.05, unit = "ratio", reopen)]
    pub shutter: f64,
    /// Exposure of the right camera relative to the left one.
    #[param(default = 0.93, range = 0.25..=4.0, step = 0.01, unit = "ratio", reopen)]
    pub right_exposure: f32,
    /// Focal length relative to that of the thesis's scope, which is 750 px at 640 columns. Smaller values widen the view: 0.45 with `lens =
    /// "equidistant"` is a field of view of 109 degrees.
    #[param(default = 1.0, range = 0.3..=2.0, step = 0.05, unit = "ratio", reopen)]
    pub zoom: f64,
    /// Lens model of every camera. Ground truth and `calibration` describe the views after rectification to pinholes of the same focal length.
    #[param(default = "pinhole", reopen)]
    pub lens: LensChoice,
    /// First radial distortion coefficient, k1, of every camera's lens.
    #[param(default = 0.0, range = -0.5..=0.5, step = 0.01, reopen)]
    pub distortion_k1: f64,
    /// Second radial distortion coefficient, k2, of every camera's lens.
    #[param(default = 0.0, range = -0.5..=0.5, step = 0.01, reopen)]
    pub distortion_k2: f64,
    /// Camera whose image is black from `black_first` on.
    #[param(default = "none", reopen)]
    pub black_camera: BlackCamera,
    /// First black frame.
    #[param(default = 0, range = 0..=1_000_000_000, unit = "frames", reopen)]
    pub black_first: u64,
    /// Number of black frames.
    #[param(default = 10, range = 0..=1_000_000_000, unit = "frames", reopen)]
    pub black_count: u64,
    /// Incident that begins at `incident_first`.
    #[param(default = "none", reopen)]
    pub incident: IncidentChoice,
    /// First frame of the incident.
    #[param(default = 20, range = 0..=1_000_000_000, unit = "frames", reopen)]
    pub incident_first: u64,
    /// Number of frames of the incident.
    #[param(default = 10, range = 1..=1_000_000_000, unit = "frames", reopen)]
    pub incident_count: u64,
    /// Number of instruments in the scene.
    #[param(default = 0, range = 0..=7, reopen)]
    pub tools: u32,
    /// Kinds of the instruments in order, separated by commas: grasper, bipolar, hook, scissors, clipper, irrigator, specimen_bag. Empty: all kinds
    /// in a seeded order.
    #[param(default = "", reopen)]
    pub tool_kinds: String,
    /// Movement of the first instrument. All but `sway` start in front of the centre of the image region that both cameras share, at 0.78 of
    /// `distance_mm`.
    #[param(default = "sway", reopen)]
    pub tool_motion: Motion,
    /// Share of ticks that are dropped, chosen by the seed.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    pub drop_share: f64,
    /// Views that are missing in a dropped tick.
    #[param(default = "all")]
    pub drop_views: DropViews,
    /// Share of ticks that are delivered late, chosen by the seed; in live mode only.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    pub late_share: f64,
    /// Delay of late ticks. Their capture time does not change.
    #[param(default = 20.0, range = 0.0..=1000.0, step = 1.0, unit = "ms")]
    pub late_ms: f64,
    /// Width of the `wide` view relative to one image.
    #[param(default = 2.0, range = 1.0..=4.0, step = 0.1, unit = "ratio", reopen)]
    pub wide_factor: f64,
}

impl PhantomParams {
    /// Kinds of the instruments; empty for the seeded order.
    ///
    /// # Errors
    /// A name that no instrument has.
    pub fn tool_kinds(&self) -> Result<Vec<ToolKind>> {
        let names = self.tool_kinds.split(',').map(str::trim).filter(|name| !name.is_empty());
        names
            .map(|name| {
                ToolKind::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| {
                    let known: Vec<&str> = ToolKind::ALL.iter().map(|kind| kind.name()).collect();
                    NodeError::new(format!(
                        "`tool_kinds`: there is no instrument `{name}`; known instruments: {}",
                        known.join(", ")
                    ))
                })
            })
            .collect()
    }

    /// Size and position of the `wide` image.
    pub fn canvas(&self) -> Canvas {
        let (width, height) = (self.width as f64, self.height as f64);
        let side = |length: f64| ((length * self.wide_factor / 2.0).ceil() * 2.0) as usize;
        let (wide, high) = (side(width), if self.layout == Layout::Quad { side(height) } else { self.height as usize });
        // The other cameras stand to the right (and below): the room goes there.
        Canvas {
            width: wide,
            height: high,
            offset_x: ((wide as f64 - width) / 8.0).floor(),
            offset_y: ((high as f64 - height) / 8.0).floor(),
        }
    }

    /// The cameras and the light.
    pub fn rig(&self) -> Rig {
        let (width, height) = (self.width as usize, self.height as usize);
        let mut rig = match self.layout {
            Layout::Stereo => Rig::stereo(width, height, self.baseline_mm),
            Layout::Quad => Rig::quad(width, height, self.baseline_mm),
        };
        rig.cameras[1].exposure = self.right_exposure;
        let k = [self.distortion_k1, self.distortion_k2, 0.0, 0.0];
        for camera in &mut rig.cameras {
            (camera.fx, camera.fy) = (camera.fx * self.zoom, camera.fy * self.zoom);
            camera.distortion[..4].copy_from_slice(&k);
            camera.equidistant = (self.lens == LensChoice::Equidistant).then(|| Equidistant::new(k));
        }
        rig
    }

    /// Parameters of the renderer.
    ///
    /// # Errors
    /// As [`Self::tool_kinds`].
    pub fn scene(&self) -> Result<SceneParams> {
        Ok(SceneParams {
            scene: match self.scene {
                Scene::Liver => SceneKind::Liver,
                Scene::Bowel => SceneKind::Bowel,
                Scene::Cavity => SceneKind::Cavity,
                Scene::Box => SceneKind::Box,
                Scene::Board => SceneKind::Board,
            },
            seed: self.seed,
            distance_mm: self.distance_mm,
            fps: self.rate_hz,
            relief: self.relief,
            camera_path: match self.camera_path {
                PathChoice::Sway => CameraPath::Sway,
                PathChoice::Ring => CameraPath::Ring,
                PathChoice::Glide => CameraPath::Glide,
            },
            path_mm: self.path_mm,
            camera_speed_mm_s: self.speed_mm_s,
            breathing_mm: self.breathing_mm,
            specular: self.specular,
            texture: self.texture,
            light: self.light,
            noise: self.noise,
            smoke: self.smoke,
            blood_drops: self.blood_drops,
            motion_blur: self.motion_blur,
            shutter: self.shutter,
            tools: self.tools,
            tool_kinds: self.tool_kinds()?,
            tool_motion: match self.tool_motion {
                Motion::Sway => ToolMotion::Sway,
                Motion::Still => ToolMotion::Still,
                Motion::Step => ToolMotion::Step,
                Motion::Ramp => ToolMotion::Ramp,
                Motion::Circle => ToolMotion::Circle,
                Motion::Strokes => ToolMotion::Strokes,
                Motion::Leave => ToolMotion::Leave,
                Motion::Cross => ToolMotion::Cross,
            },
            board: match self.board {
                Board::Chessboard => BoardPrint::Chessboard,
                Board::Circles => BoardPrint::Circles,
                Board::Charuco => BoardPrint::Charuco,
            },
            black: match self.black_camera {
                BlackCamera::None => None,
                which => Some(BlackOut {
                    camera: usize::from(which == BlackCamera::Right),
                    first: self.black_first,
                    end: self.black_first + self.black_count,
                }),
            },
            incident: match self.incident {
                IncidentChoice::None => None,
                IncidentChoice::Smoke => Some(IncidentKind::Smoke),
                IncidentChoice::Blur => Some(IncidentKind::Blur),
                IncidentChoice::Jump => Some(IncidentKind::Jump),
                IncidentChoice::Covered => Some(IncidentKind::Covered),
            }
            .map(|kind| Incident {
                kind,
                first: self.incident_first,
                end: self.incident_first + self.incident_count,
            }),
            ..SceneParams::default()
        })
    }
}
