//! `phantom`: a rendered scene in, or rather out of, two or four cameras, with exact truth.

use panoscope_node::abi::{self, Calibration, Camera, Detection};
use panoscope_node::{
    Bgr8, Choice, Context, Depth, Disparity, LabeledDetections, LabeledInstances, Mask, Node, NodeError, NodeInfo,
    Open, Params, Ports, Result, Slot, TableData, Validation, Value, ViewMut, detections, name16,
};

use crate::render::lens::Lens;
use crate::render::truth::MOST_WIDE_PX;
use crate::render::{
    self, BlackOut, BoardPrint, CameraModel, CameraPath, Canvas, Incident, IncidentKind, Phantom, Pose, Rig, SceneKind,
    SceneParams, ToolKind, ToolMotion, ToolTruth, TruthMut,
};

/// Which scene is rendered.
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
    /// A flat calibration board, in another pose each tick while `speed_mm_s` is not 0; from about 85 mm both cameras see all
    /// of it.
    Board,
}

/// What the board shows.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Board {
    /// `chessboard:9x6:3mm`.
    Chessboard,
    /// `circles:4x11:3mm`.
    Circles,
    /// `charuco:10x7:3mm:2.25mm:4x4_50`.
    Charuco,
}

/// Which views a dropped tick leaves out.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum DropViews {
    /// All outputs.
    All,
    /// The left view.
    Left,
    /// The right view.
    Right,
}

/// How the cameras stand.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Layout {
    /// Left and right.
    Stereo,
    /// Two above two: view0, view1, view2, view3.
    Quad,
}

/// Which camera goes black.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum BlackCamera {
    /// None.
    None,
    /// The left one.
    Left,
    /// The right one.
    Right,
}

/// What goes wrong for a while.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum IncidentChoice {
    /// Nothing.
    None,
    /// Dense smoke before both cameras.
    Smoke,
    /// The scope is shaken, and every picture drawn out by some 40 px.
    Blur,
    /// The scope jumps to another place, and stays there.
    Jump,
    /// Tissue lies on the lens of the last camera.
    Covered,
}

/// How the scripted camera moves.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum PathChoice {
    /// Seeded swings about the place where it rests.
    Sway,
    /// Along a circle parallel to the tissue, lap after lap, back where it began after each.
    Ring,
    /// On along the tissue, and nearer and away in turn, at `speed_mm_s` all the time.
    Glide,
}

/// How the leading instrument moves.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Slow swings about a home of the seed's choice, as all others.
    Sway,
    /// Not at all, before the middle of the shared picture.
    Still,
    /// 12 mm aside and back at up to 25 mm/s, every 4 s.
    Step,
    /// To and fro over 36 mm at 12 mm/s.
    Ramp,
    /// A circle of 12 mm radius in 5 s.
    Circle,
    /// Strokes of a surgeon at up to 25 mm/s.
    Strokes,
    /// Is drawn out of the picture at up to 150 mm/s and comes back at 40 mm/s, every 12 s.
    Leave,
    /// Rests while the second instrument passes before it.
    Cross,
}

/// Parameters of the phantom.
#[derive(Params, Clone, PartialEq)]
pub struct PhantomParams {
    /// Scene that is rendered.
    #[param(default = "bowel", reopen)]
    scene: Scene,
    /// What the board of the scene `board` shows.
    #[param(default = "chessboard", reopen)]
    board: Board,
    /// Seed of everything random: the same seed gives the same pictures on every machine.
    #[param(default = 7, range = 0..=1_000_000_000, reopen)]
    seed: u64,
    /// How the cameras stand.
    #[param(default = "stereo", reopen)]
    layout: Layout,
    /// Picture width of each camera.
    #[param(default = 640, range = 64..=3840, unit = "px", reopen)]
    width: u32,
    /// Picture height of each camera.
    #[param(default = 480, range = 48..=2160, unit = "px", reopen)]
    height: u32,
    /// Distance of neighbouring cameras.
    #[param(default = 15.0, range = 1.0..=40.0, step = 0.5, unit = "mm", reopen)]
    baseline_mm: f64,
    /// Mean distance from the resting left camera to the tissue.
    #[param(default = 50.0, range = 15.0..=150.0, step = 1.0, unit = "mm", reopen)]
    distance_mm: f64,
    /// Pictures per second of media time.
    #[param(default = 30.0, range = 1.0..=240.0, step = 1.0, unit = "Hz", reopen)]
    rate_hz: f64,
    /// Height of the tissue's relief; 0 is a plane. Without effect on `box` and `board`.
    #[param(default = 1.0, range = 0.0..=1.0, step = 0.05, unit = "ratio", reopen)]
    relief: f64,
    /// How the scripted camera moves.
    #[param(default = "sway", reopen)]
    camera_path: PathChoice,
    /// Diameter of the path `ring`.
    #[param(default = 40.0, range = 1.0..=100.0, step = 1.0, unit = "mm", reopen)]
    path_mm: f64,
    /// Top speed of the scripted camera; 0 stands still.
    #[param(default = 10.0, range = 0.0..=200.0, step = 0.5, unit = "mm/s", reopen)]
    speed_mm_s: f64,
    /// Amplitude of breathing.
    #[param(default = 1.0, range = 0.0..=5.0, step = 0.1, unit = "mm", reopen)]
    breathing_mm: f64,
    /// Strength of highlights.
    #[param(default = 1.0, range = 0.0..=4.0, step = 0.1, unit = "ratio", reopen)]
    specular: f32,
    /// Strength of vessels, mottling, flecks and grain; 0 leaves smooth tissue of one colour.
    #[param(default = 1.0, range = 0.0..=1.0, step = 0.05, unit = "ratio", reopen)]
    texture: f32,
    /// Light that reaches the sensors; less is darker and, with the same noise, noisier.
    #[param(default = 1.0, range = 0.01..=4.0, step = 0.01, unit = "ratio", reopen)]
    light: f32,
    /// Sensor noise; 1 is a good small sensor.
    #[param(default = 1.0, range = 0.0..=8.0, step = 0.1, unit = "ratio", reopen)]
    noise: f32,
    /// Density of smoke.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.05, unit = "ratio", reopen)]
    smoke: f32,
    /// Blood drops on each lens.
    #[param(default = 0, range = 0..=32, reopen)]
    blood_drops: u32,
    /// Sub-frames of motion blur; 1 is none.
    #[param(default = 1, range = 1..=16, unit = "frames", reopen)]
    motion_blur: u32,
    /// Share of the frame time that the shutter is open; for `motion_blur` above 1.
    #[param(default = 0.5, range = 0.0..=1.0, step = 0.05, unit = "ratio", reopen)]
    shutter: f64,
    /// Exposure of the right camera relative to the left one.
    #[param(default = 0.93, range = 0.25..=4.0, step = 0.01, unit = "ratio", reopen)]
    right_exposure: f32,
    /// Radial distortion k1 of every camera.
    #[param(default = 0.0, range = -0.5..=0.5, step = 0.01, reopen)]
    distortion_k1: f64,
    /// Radial distortion k2 of every camera.
    #[param(default = 0.0, range = -0.5..=0.5, step = 0.01, reopen)]
    distortion_k2: f64,
    /// Camera that goes black from `black_first` on.
    #[param(default = "none", reopen)]
    black_camera: BlackCamera,
    /// First black picture.
    #[param(default = 0, range = 0..=1_000_000_000, unit = "frames", reopen)]
    black_first: u64,
    /// Number of black pictures.
    #[param(default = 10, range = 0..=1_000_000_000, unit = "frames", reopen)]
    black_count: u64,
    /// What goes wrong from `incident_first` on.
    #[param(default = "none", reopen)]
    incident: IncidentChoice,
    /// First picture that suffers.
    #[param(default = 20, range = 0..=1_000_000_000, unit = "frames", reopen)]
    incident_first: u64,
    /// Number of pictures that suffer.
    #[param(default = 10, range = 1..=1_000_000_000, unit = "frames", reopen)]
    incident_count: u64,
    /// Instruments in the scene.
    #[param(default = 0, range = 0..=7, reopen)]
    tools: u32,
    /// Their kinds in turn, separated by commas: grasper, bipolar, hook, scissors, clipper, irrigator, specimen_bag; when empty,
    /// the seed's own order of all.
    #[param(default = "", reopen)]
    tool_kinds: String,
    /// How the first of them moves; all but `sway` start before the middle of the shared picture, at 0.78 of `distance_mm`.
    #[param(default = "sway", reopen)]
    tool_motion: Motion,
    /// Share of ticks that are dropped, chosen by the seed.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    drop_share: f64,
    /// What a dropped tick leaves out.
    #[param(default = "all")]
    drop_views: DropViews,
    /// Share of ticks that are delivered late, chosen by the seed; in live mode only.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    late_share: f64,
    /// By how much they are late; their capture time stays what it is.
    #[param(default = 20.0, range = 0.0..=1000.0, step = 1.0, unit = "ms")]
    late_ms: f64,
    /// How much wider than one picture the `wide` view is.
    #[param(default = 2.0, range = 1.0..=4.0, step = 0.1, unit = "ratio", reopen)]
    wide_factor: f64,
}

/// Inputs of the phantom.
#[derive(Ports)]
pub struct In<'f> {
    /// Pose of the left camera in the scene; the scripted motion when unconnected.
    camera_pose: Option<Value<'f, abi::Pose>>,
}

/// Outputs of the phantom.
#[derive(Ports)]
pub struct Out<'f> {
    /// Left view (camera 0).
    left: Slot<'f, Bgr8>,
    /// Right view (camera 1).
    right: Slot<'f, Bgr8>,
    /// Camera 0, upper left of the quad layout; the same buffer as `left`.
    view0: Slot<'f, Bgr8>,
    /// Camera 1, upper right of the quad layout; the same buffer as `right`.
    view1: Slot<'f, Bgr8>,
    /// Camera 2, lower left of the quad layout.
    view2: Slot<'f, Bgr8>,
    /// Camera 3, lower right of the quad layout.
    view3: Slot<'f, Bgr8>,
    /// True calibration of cameras 0 and 1.
    calibration: Slot<'f, abi::Calibration>,
    /// True disparity of the left view.
    disparity: Slot<'f, Disparity>,
    /// True depth of the left view.
    depth: Slot<'f, Depth>,
    /// 255 where the right camera sees the same point as the left one.
    visible: Slot<'f, Mask>,
    /// True pose of the left camera in the scene.
    pose: Slot<'f, abi::Pose>,
    /// Plane homography that fits the true correspondences best.
    homography: Slot<'f, abi::Homography>,
    /// What one ideal camera at the left camera's place with a larger sensor would see.
    wide: Slot<'f, Bgr8>,
    /// 255 in each pixel of `wide` whose tissue lies inside the picture of at least one camera.
    footprint: Slot<'f, Mask>,
    /// True boxes of the instruments seen in the left view.
    detections: Slot<'f, LabeledDetections>,
    /// The same with true masks.
    instances: Slot<'f, LabeledInstances>,
    /// True tip of the instrument whose tip is seen, the largest first; empty when none is.
    tip: Slot<'f, abi::Tip>,
    /// True tip of the first instrument, wherever it is: score 1 while it is seen, 0 while it is hidden or outside the left view. Empty behind the
    /// camera and without instruments.
    lead: Slot<'f, abi::Tip>,
    /// The same of the second instrument.
    second: Slot<'f, abi::Tip>,
    /// One row per instrument: where its tip is, whether it is seen, and how far it is from the tissue and from the nearest other tip.
    clearance: Slot<'f, TableData>,
}

/// Columns of `clearance`: places in the left camera's frame; distances below 0 lie inside the tissue; NaN where there is no other tip.
const CLEARANCE: [&str; 8] = ["track_id", "class_index", "seen", "x_mm", "y_mm", "z_mm", "tissue_mm", "tip_mm"];

/// See the module.
pub struct PhantomNode {
    phantom: Phantom,
    frame: u64,
    calibration: Calibration,
    canvas: Canvas,
    labels: String,
    tools: ToolWork,
    /// Where a view that is dropped is drawn.
    unseen: Vec<u8>,
}

/// Memory of the instruments' truth, kept from tick to tick.
#[derive(Default)]
struct ToolWork {
    ids: Vec<u8>,
    truth: Vec<ToolTruth>,
    items: Vec<Detection>,
    masks: Vec<u8>,
    clearances_mm: Vec<f64>,
    rows: Vec<f64>,
}

fn tool_kinds(text: &str) -> Result<Vec<ToolKind>> {
    let names = text.split(',').map(str::trim).filter(|name| !name.is_empty());
    names
        .map(|name| {
            ToolKind::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| {
                let known: Vec<&str> = ToolKind::ALL.iter().map(|kind| kind.name()).collect();
                NodeError::new(format!(
                    "`tool_kinds`: no instrument is called `{name}`; there are {}",
                    known.join(", ")
                ))
            })
        })
        .collect()
}

impl PhantomParams {
    /// Size and place of the `wide` picture.
    fn canvas(&self) -> Canvas {
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
}

fn rig(params: &PhantomParams) -> Rig {
    let (width, height) = (params.width as usize, params.height as usize);
    let mut rig = match params.layout {
        Layout::Stereo => Rig::stereo(width, height, params.baseline_mm),
        Layout::Quad => Rig::quad(width, height, params.baseline_mm),
    };
    rig.cameras[1].exposure = params.right_exposure;
    for camera in &mut rig.cameras {
        camera.distortion[0] = params.distortion_k1;
        camera.distortion[1] = params.distortion_k2;
    }
    rig
}

fn camera(model: &CameraModel) -> Camera {
    let mut distortion = [0.0; 14];
    distortion[..5].copy_from_slice(&model.distortion);
    Camera {
        width: model.width as u32,
        height: model.height as u32,
        fx: model.fx,
        fy: model.fy,
        cx: model.cx,
        cy: model.cy,
        distortion,
    }
}

const EYE3: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

fn calibration(rig: &Rig) -> Calibration {
    let (left, right) = (&rig.cameras[0], &rig.cameras[1]);
    let baseline_mm = right.offset_mm[0] - left.offset_mm[0];
    let projection = |tx: f64| [left.fx, 0.0, left.cx, tx, 0.0, left.fy, left.cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    Calibration {
        left: camera(left),
        right: camera(right),
        right_from_left_rotation: EYE3,
        right_from_left_mm: [
            -baseline_mm,
            left.offset_mm[1] - right.offset_mm[1],
            left.offset_mm[2] - right.offset_mm[2],
        ],
        rectified_from_left: EYE3,
        rectified_from_right: EYE3,
        left_projection: projection(0.0),
        right_projection: projection(-left.fx * baseline_mm),
        baseline_mm,
        rms_px: 0.0,
        is_rectified: u32::from(left.distortion == [0.0; 5] && right.distortion == [0.0; 5]),
        reserved: 0,
    }
}

impl Node for PhantomNode {
    const INFO: NodeInfo = NodeInfo::compute(
        "phantom",
        "source",
        "Renders a tissue-like scene as two parallel cameras at a scope's tip see it, with exact truth.",
    )
    .source();
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = PhantomParams;

    fn validate(params: &PhantomParams, check: &mut Validation<'_>) {
        if let Err(error) = tool_kinds(&params.tool_kinds) {
            check.error("tool_kinds", error.message(), "");
        }
        for (index, model) in rig(params).cameras.iter().enumerate() {
            if let Err(error) = Lens::check(model, index) {
                let help = "bring `distortion_k1` and `distortion_k2` nearer to 0";
                check.error("distortion_k1", error.to_string(), help);
                break;
            }
        }
        let canvas = params.canvas();
        let is_read = ["wide", "footprint"].map(|port| check.is_read(port) == Some(true));
        if is_read.contains(&true) && canvas.width.max(canvas.height) > MOST_WIDE_PX {
            let message = format!(
                "the `wide` picture would have {}x{} px, {MOST_WIDE_PX} are the most",
                canvas.width, canvas.height
            );
            check.error("wide_factor", message, "lower `wide_factor`, or the size of the views");
        }
    }

    fn open(open: &Open<'_>, params: &PhantomParams) -> Result<Self> {
        let scene = SceneParams {
            scene: match params.scene {
                Scene::Liver => SceneKind::Liver,
                Scene::Bowel => SceneKind::Bowel,
                Scene::Cavity => SceneKind::Cavity,
                Scene::Box => SceneKind::Box,
                Scene::Board => SceneKind::Board,
            },
            seed: params.seed,
            distance_mm: params.distance_mm,
            fps: params.rate_hz,
            relief: params.relief,
            camera_path: match params.camera_path {
                PathChoice::Sway => CameraPath::Sway,
                PathChoice::Ring => CameraPath::Ring,
                PathChoice::Glide => CameraPath::Glide,
            },
            path_mm: params.path_mm,
            camera_speed_mm_s: params.speed_mm_s,
            breathing_mm: params.breathing_mm,
            specular: params.specular,
            texture: params.texture,
            light: params.light,
            noise: params.noise,
            smoke: params.smoke,
            blood_drops: params.blood_drops,
            motion_blur: params.motion_blur,
            shutter: params.shutter,
            tools: params.tools,
            tool_kinds: tool_kinds(&params.tool_kinds)?,
            tool_motion: match params.tool_motion {
                Motion::Sway => ToolMotion::Sway,
                Motion::Still => ToolMotion::Still,
                Motion::Step => ToolMotion::Step,
                Motion::Ramp => ToolMotion::Ramp,
                Motion::Circle => ToolMotion::Circle,
                Motion::Strokes => ToolMotion::Strokes,
                Motion::Leave => ToolMotion::Leave,
                Motion::Cross => ToolMotion::Cross,
            },
            board: match params.board {
                Board::Chessboard => BoardPrint::Chessboard,
                Board::Circles => BoardPrint::Circles,
                Board::Charuco => BoardPrint::Charuco,
            },
            black: match params.black_camera {
                BlackCamera::None => None,
                which => Some(BlackOut {
                    camera: usize::from(which == BlackCamera::Right),
                    first: params.black_first,
                    end: params.black_first + params.black_count,
                }),
            },
            incident: match params.incident {
                IncidentChoice::None => None,
                IncidentChoice::Smoke => Some(IncidentKind::Smoke),
                IncidentChoice::Blur => Some(IncidentKind::Blur),
                IncidentChoice::Jump => Some(IncidentKind::Jump),
                IncidentChoice::Covered => Some(IncidentKind::Covered),
            }
            .map(|kind| Incident {
                kind,
                first: params.incident_first,
                end: params.incident_first + params.incident_count,
            }),
            ..SceneParams::default()
        };
        let rig = rig(params);
        let canvas = params.canvas();
        let calibration = calibration(&rig);
        let labels: Vec<&str> = ToolKind::ALL.iter().map(|kind| kind.name()).collect();
        Ok(Self {
            phantom: Phantom::new(scene, rig, open.pool())?,
            frame: 0,
            calibration,
            canvas,
            labels: labels.join("\n"),
            tools: ToolWork::default(),
            unseen: Vec::new(),
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &PhantomParams) -> Result<()> {
        let frame = self.frame;
        self.frame += 1;
        cx.set_capture_ns((frame as f64 * 1e9 / params.rate_hz) as i64);
        // One chance for each fault and tick, the same in every run.
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
        let place = pose.unwrap_or_else(|| self.phantom.pose(frame));
        out.pose.set(abi::Pose {
            a_from_b_wxyz: place.quaternion,
            a_from_b_mm: place.translation_mm,
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
        // A view that is dropped is drawn where nobody looks.
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

    /// Boxes, masks and tip of the instruments.
    fn tools(&mut self, cx: &Context<'_>, frame: u64, pose: Option<Pose>, out: &mut Out<'_>) -> Result<()> {
        let read = [out.detections.is_read(), out.instances.is_read(), out.tip.is_read(), out.lead.is_read()];
        if !read.contains(&true) && !out.second.is_read() && !out.clearance.is_read() {
            return Ok(());
        }
        let (width, height) = (self.calibration.left.width as usize, self.calibration.left.height as usize);
        let ToolWork { ids, truth, items, masks, clearances_mm, rows } = &mut self.tools;
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
