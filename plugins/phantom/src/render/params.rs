//! Parameters of a phantom: the scene, the sensor's faults, the cameras.

use panoscope_imaging::stereo::Equidistant;
use thiserror::Error;

use super::kinds::{BoardPrint, SceneKind, ToolKind};
use super::scenario::ToolMotion;

/// Why a phantom cannot be built, or an image cannot be drawn.
#[derive(Clone, Debug, Error, PartialEq)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum PhantomError {
    /// No scene has this name.
    #[error("there is no scene {name:?}; known scenes: liver, bowel, cavity, box and board")]
    UnknownScene { name: String },
    /// A parameter is outside its range.
    #[error("{name} is {value}; expected {low} to {high}")]
    OutOfRange { name: &'static str, value: f64, low: f64, high: f64 },
    /// An image has the wrong size.
    #[error("view {view} is {width}x{height}x{channels}, expected {want_width}x{want_height}x{want_channels}")]
    WrongSize {
        view: usize,
        width: usize,
        height: usize,
        channels: usize,
        want_width: usize,
        want_height: usize,
        want_channels: usize,
    },
    /// The number of images differs from the number of cameras.
    #[error("{got} views were given, but the rig has {want} cameras")]
    WrongViewCount { got: usize, want: usize },
    /// A pose with a NaN or an infinity.
    #[error("the camera pose holds a number that is not finite")]
    BadPose,
    /// The distortion is not invertible inside the image.
    #[error("the lens distortion of camera {camera} folds the image over itself at pixel ({u}, {v}); reduce it")]
    BadDistortion {
        /// Index of the camera in the rig.
        camera: usize,
        u: usize,
        v: usize,
    },
}

impl std::str::FromStr for SceneKind {
    type Err = PhantomError;

    fn from_str(name: &str) -> Result<Self, PhantomError> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.name() == name)
            .ok_or_else(|| PhantomError::UnknownScene { name: name.to_owned() })
    }
}

/// Parameters of the scene, its motion, the light and the sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneParams {
    /// Which scene.
    pub scene: SceneKind,
    /// Seed of everything random.
    pub seed: u64,
    /// Mean distance from the resting left camera to the tissue, 15 to 150 mm.
    pub distance_mm: f64,
    /// Frames per second of the motion script, 1 to 1000.
    pub fps: f64,
    /// Height of the tissue's relief, 0 (a plane) to 1; ignored by the scenes `box` and `board`.
    pub relief: f64,
    /// How the scripted camera moves.
    pub camera_path: CameraPath,
    /// Diameter of [`CameraPath::Ring`], 1 to 100 mm.
    pub path_mm: f64,
    /// Top speed of the scripted camera, 0 (still) to 200 mm/s.
    pub camera_speed_mm_s: f64,
    /// Amplitude of breathing, 0 to 5 mm.
    pub breathing_mm: f64,
    /// Length of a breath, 0.5 to 20 s.
    pub breathing_period_s: f64,
    /// Strength of specular highlights; with 0 the surface's colour does not depend on the view.
    pub specular: f32,
    /// Strength of vessels, mottling, flecks and grain; 1 is normal, 0 a smooth surface of one colour per tissue.
    pub texture: f32,
    /// Light that reaches the sensors; 1 is a well-lit scene. The noise does not change, so a darker image is noisier.
    pub light: f32,
    /// Strength of shot and read noise; 1 is a good small sensor, 0 none.
    pub noise: f32,
    /// Density of smoke, 0 to 1.
    pub smoke: f32,
    /// Number of blood drops on each lens, 0 to 32.
    pub blood_drops: u32,
    /// Pattern of the board in [`SceneKind::Board`].
    pub board: BoardPrint,
    /// Number of instruments in the scene, 0 to 7.
    pub tools: u32,
    /// Kinds of the instruments in order; when empty, all kinds in a seeded order.
    pub tool_kinds: Vec<ToolKind>,
    /// Movement of the first instrument.
    pub tool_motion: ToolMotion,
    /// Number of sub-frames averaged for motion blur, 1 (none) to 16.
    pub motion_blur: u32,
    /// Share of the frame time for which the shutter is open, 0 to 1; used with `motion_blur`.
    pub shutter: f64,
    /// Camera and frames `first..end` for which that camera's image is black.
    pub black: Option<BlackOut>,
    /// An incident for a range of frames.
    pub incident: Option<Incident>,
}

/// How the scripted camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraPath {
    /// Seeded swings about its resting position.
    Sway,
    /// Circles parallel to the tissue, with rotations and changes of height that close with each lap.
    Ring,
    /// Along the tissue, alternately nearer and farther, always at top speed.
    Glide,
}

/// Kind of incident.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IncidentKind {
    /// Dense smoke before both cameras.
    Smoke,
    /// The scope shakes: each image is blurred over about 40 px.
    Blur,
    /// The scope jumps to another position at the first frame and stays there.
    Jump,
    /// Tissue covers the lens of the last camera.
    Covered,
}

/// An incident in the frames `first..end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Incident {
    /// Kind of the incident.
    pub kind: IncidentKind,
    /// First frame of the incident.
    pub first: u64,
    /// First frame after the incident.
    pub end: u64,
}

impl Incident {
    /// Whether the incident `kind` is active in frame `frame`.
    pub fn at(&self, kind: IncidentKind, frame: u64) -> bool {
        self.kind == kind && (self.first..self.end).contains(&frame)
    }
}

/// A camera whose image is black for a range of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlackOut {
    /// Camera of the rig.
    pub camera: usize,
    /// First black frame.
    pub first: u64,
    /// First frame after the black ones.
    pub end: u64,
}

impl Default for SceneParams {
    fn default() -> Self {
        Self {
            scene: SceneKind::Liver,
            seed: 7,
            distance_mm: 50.0,
            fps: 30.0,
            relief: 1.0,
            camera_path: CameraPath::Sway,
            path_mm: 40.0,
            camera_speed_mm_s: 10.0,
            breathing_mm: 1.0,
            breathing_period_s: 4.0,
            specular: 1.0,
            texture: 1.0,
            light: 1.0,
            noise: 1.0,
            smoke: 0.0,
            blood_drops: 0,
            board: BoardPrint::Chessboard,
            tools: 0,
            tool_kinds: Vec::new(),
            tool_motion: ToolMotion::Sway,
            motion_blur: 1,
            shutter: 0.5,
            black: None,
            incident: None,
        }
    }
}

impl SceneParams {
    /// Refuses values outside the documented ranges.
    ///
    /// # Errors
    /// [`PhantomError::OutOfRange`] names the parameter.
    pub fn check(&self) -> Result<(), PhantomError> {
        let ranges = [
            ("distance_mm", self.distance_mm, 15.0, 150.0),
            ("fps", self.fps, 1.0, 1000.0),
            ("relief", self.relief, 0.0, 1.0),
            ("path_mm", self.path_mm, 1.0, 100.0),
            ("camera_speed_mm_s", self.camera_speed_mm_s, 0.0, 200.0),
            ("breathing_mm", self.breathing_mm, 0.0, 5.0),
            ("breathing_period_s", self.breathing_period_s, 0.5, 20.0),
            ("specular", f64::from(self.specular), 0.0, 4.0),
            ("texture", f64::from(self.texture), 0.0, 1.0),
            ("light", f64::from(self.light), 0.01, 4.0),
            ("noise", f64::from(self.noise), 0.0, 8.0),
            ("smoke", f64::from(self.smoke), 0.0, 1.0),
            ("blood_drops", f64::from(self.blood_drops), 0.0, 32.0),
            ("tools", f64::from(self.tools), 0.0, 7.0),
            ("motion_blur", f64::from(self.motion_blur), 1.0, 16.0),
            ("shutter", self.shutter, 0.0, 1.0),
        ];
        for (name, value, low, high) in ranges {
            if !(low..=high).contains(&value) {
                return Err(PhantomError::OutOfRange { name, value, low, high });
            }
        }
        Ok(())
    }
}

/// One camera: a pinhole with OpenCV's distortion `k1 k2 p1 p2 k3`, or a fisheye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Column of the principal point, px; the centre of the first pixel is 0.
    pub cx: f64,
    /// Row of the principal point, px.
    pub cy: f64,
    /// `k1, k2, p1, p2, k3`.
    pub distortion: [f64; 5],
    /// An equidistant lens, in place of `distortion`.
    pub equidistant: Option<Equidistant>,
    /// Centre of projection in the first camera's frame, mm. All cameras look along the same axis.
    pub offset_mm: [f64; 3],
    /// Exposure relative to the first camera.
    pub exposure: f32,
    /// Factors on blue, green and red.
    pub white_balance: [f32; 3],
}

impl CameraModel {
    /// Whether the lens has no distortion.
    pub fn is_pinhole(&self) -> bool {
        self.distortion == [0.0; 5] && self.equidistant.is_none()
    }

    /// An ideal camera of the thesis's scope: 640 columns at fx = fy = 750 px, wider ones in proportion.
    pub fn ideal(width: usize, height: usize) -> Self {
        let focal = 750.0 * width as f64 / 640.0;
        Self {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: (width as f64 - 1.0) / 2.0,
            cy: (height as f64 - 1.0) / 2.0,
            distortion: [0.0; 5],
            equidistant: None,
            offset_mm: [0.0; 3],
            exposure: 1.0,
            white_balance: [1.0; 3],
        }
    }
}

/// The cameras of the scope, and its light.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// The cameras; the first is the reference (left, or top left).
    pub cameras: Vec<CameraModel>,
    /// Position of the light in the first camera's frame, mm.
    pub light_mm: [f64; 3],
}

impl Rig {
    /// Two parallel cameras, the right one `baseline_mm` along x, a little darker and warmer than the left.
    pub fn stereo(width: usize, height: usize, baseline_mm: f64) -> Self {
        let left = CameraModel::ideal(width, height);
        let right = CameraModel {
            offset_mm: [baseline_mm, 0.0, 0.0],
            exposure: 0.93,
            white_balance: [0.97, 1.0, 1.03],
            ..left
        };
        Self { cameras: vec![left, right], light_mm: [baseline_mm / 2.0, -3.0, 0.0] }
    }

    /// Four parallel cameras, `view0 view1` above `view2 view3`, `baseline_mm` apart both ways.
    pub fn quad(width: usize, height: usize, baseline_mm: f64) -> Self {
        let ideal = CameraModel::ideal(width, height);
        let tints = [(1.0, 1.0, 1.0), (0.93, 0.97, 1.03), (1.05, 1.02, 0.99), (0.97, 1.01, 0.98)];
        let cameras = (0..4).map(|i| {
            let (exposure, blue, red) = tints[i];
            CameraModel {
                offset_mm: [(i % 2) as f64 * baseline_mm, (i / 2) as f64 * baseline_mm, 0.0],
                exposure,
                white_balance: [blue, 1.0, red],
                ..ideal
            }
        });
        Self { cameras: cameras.collect(), light_mm: [baseline_mm / 2.0, baseline_mm / 2.0, 0.0] }
    }

    /// Refuses sizes, focal lengths and offsets with which no image can be drawn.
    ///
    /// # Errors
    /// [`PhantomError::OutOfRange`] names the field.
    pub fn check(&self) -> Result<(), PhantomError> {
        let within = |name, value: f64, low, high| {
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                Err(PhantomError::OutOfRange { name, value, low, high })
            }
        };
        within("number of cameras", self.cameras.len() as f64, 1.0, 8.0)?;
        for camera in &self.cameras {
            within("camera width", camera.width as f64, 8.0, 4096.0)?;
            within("camera height", camera.height as f64, 8.0, 4096.0)?;
            within("fx", camera.fx, 16.0, 65536.0)?;
            within("fy", camera.fy, 16.0, 65536.0)?;
            within("cx", camera.cx, -65536.0, 65536.0)?;
            within("cy", camera.cy, -65536.0, 65536.0)?;
            within("exposure", f64::from(camera.exposure), 0.0, 16.0)?;
            for (&offset, &gain) in camera.offset_mm.iter().zip(&camera.white_balance) {
                within("offset_mm", offset, -200.0, 200.0)?;
                within("white_balance", f64::from(gain), 0.0, 16.0)?;
            }
            let fisheye = camera.equidistant.map_or([0.0; 4], |lens| lens.coefficients());
            for k in camera.distortion.into_iter().chain(fisheye) {
                within("distortion", k, -100.0, 100.0)?;
            }
        }
        self.light_mm.iter().try_for_each(|&v| within("light_mm", v, -200.0, 200.0))
    }
}
