//! `composite_mesh`: combines views, their homographies and their disparity into one wide image without parallax at the seam.

use panoscope_imaging::geometry;
use panoscope_imaging::stitch::{Mesh, MeshFollower, MeshParams, MeshReport, RectifiedView, warped_corners};
use panoscope_node::abi::{self, Calibration, Camera, Homography, Roi, Scalar};
use panoscope_node::pick::{Grid, Parts};
use panoscope_node::{
    Bgr8, Context, Detections, Disparity, Gray8, Image, List, Mask, Node, NodeInfo, Open, Params, Ports, Result, Slot,
    TableData, TextPacket, Validation, Value, View, error,
};

use crate::calibrated_views::{CalibratedViews, check_map};
use crate::composite::{CompositeNodeParams, Drawer, OnLost, Scene, SceneInputs, Slots, check_views, draw};

/// Columns of the table of vertices: position in the panorama relative to the left view's origin, and the pixel of each view shown there.
pub const VERTEX_COLUMNS: [&str; 6] = ["x_px", "y_px", "right_x_px", "right_y_px", "left_x_px", "left_y_px"];
/// Columns of the table of vertices for more than two views: the number of the view as in `shown`, then the same.
pub const VIEW_VERTEX_COLUMNS: [&str; 5] = ["view", "x_px", "y_px", "right_x_px", "right_y_px"];

/// Parameters of the composite. Lengths of the mesh are for views 640 px wide and grow with the views.
#[derive(Params, Clone, PartialEq)]
pub struct CompositeMeshParams {
    /// Side of a mesh cell.
    #[param(default = 20, range = 12..=96, unit = "px")]
    cell: u32,
    /// Smoothness of the mesh: weight of its bending relative to the observations in a cell.
    #[param(default = 0.01, range = 0.001..=100.0, step = 0.001, unit = "ratio")]
    bend: f64,
    /// Speed with which the mesh approaches the homography where nothing is observed: weight of its slopes.
    #[param(default = 0.005, range = 0.0..=10.0, step = 0.001, unit = "ratio")]
    fade: f64,
    /// Maximum change of a length, relative to the homography, where only the other camera sees.
    #[param(default = 4.5, range = 0.0..=100.0, step = 0.5, unit = "%")]
    most_stretch: f64,
    /// Width of the zone before the left view's border in which the mesh departs from the disparity to limit that change. A wide zone is smooth; a
    /// narrow one keeps more of the overlap exact. With 0 the mesh follows the disparity up to the border and stretches what is beyond.
    #[param(default = 60.0, range = 0.0..=400.0, step = 5.0, unit = "px")]
    zone_px: f64,
    /// Distance from the mesh at which an observation has a quarter of its weight. Observations on an instrument in front of the tissue are further
    /// away and do not count.
    #[param(default = 12.0, range = 0.2..=50.0, step = 0.1, unit = "px")]
    outlier_px: f64,
    /// Weight of the previous frame's mesh while nothing moves; 0 fits each frame independently.
    #[param(default = 10.0, range = 0.0..=1000.0, step = 1.0, unit = "ratio")]
    steady: f64,
    /// Shows each instrument in front of the tissue completely and unbent, from one of the views; for `left` and `right`.
    #[param(default = true)]
    instruments: bool,
    /// Minimum score of a box at `detections`.
    #[param(default = 0.3, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_score: f32,
    /// Number of `views` per row of cameras, which are one baseline apart with parallel axes.
    #[param(default = 2, range = 1..=8)]
    camera_columns: u32,
    #[param(flatten)]
    composite: CompositeNodeParams,
}

impl CompositeMeshParams {
    /// Settings of the mesh for the camera `along` baselines right of and below the first; `is_pair` when there is no third one.
    fn mesh(&self, along: [f64; 2], is_pair: bool) -> MeshParams {
        MeshParams {
            along,
            moves_reference: is_pair,
            max_stretch: self.most_stretch / 100.0,
            zone_px: self.zone_px,
            cell_px: f64::from(self.cell),
            bend: self.bend,
            slope: self.fade,
            outlier_px: self.outlier_px,
            hold_still: self.steady,
            keeps_instruments: is_pair && self.instruments,
            ..MeshParams::default()
        }
    }
}

/// Inputs of the composite: `left`, `right`, `homography` and `disparity`, or `views`, `homographies` and `disparities`.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view; the panorama is in its plane.
    left: Option<Image<'f, Bgr8>>,
    /// Right view of the same instant.
    right: Option<Image<'f, Bgr8>>,
    /// Maps right-view pixels to left-view pixels; used where only the right camera sees.
    homography: Option<Value<'f, Homography>>,
    /// Disparity of the left rectified view, as large as the views or smaller by an integer factor; used where both cameras see. Without it the
    /// homography alone places the right view.
    disparity: Option<Image<'f, Disparity>>,
    /// Calibration of the views. Unconnected: they are assumed to be rectified.
    calibration: Option<Value<'f, Calibration>>,
    /// Boxes of instruments in the left view, from a detector. Inside them, anything in front of the tissue is more readily treated as an instrument.
    /// Boxes of an earlier frame are accepted.
    detections: Option<Detections<'f>>,
    /// Nonzero on instruments in the left view, from a segmenting node.
    mask: Option<Image<'f, Mask>>,
    /// Two to eight views instead of `left` and `right`, row by row, of cameras one baseline apart with parallel axes.
    views: Option<List<'f, Image<'f, Bgr8>>>,
    /// One homography for each further view of `views`, which maps its pixels to the first view's.
    homographies: Option<List<'f, Value<'f, Homography>>>,
    /// Disparities of the first of `views` with cameras one baseline away, each at full size. In each pixel the first known value is used.
    disparities: Option<List<'f, Image<'f, Disparity>>>,
    /// Nonzero where `left` is illuminated: only those pixels are shown, compared and blended. Unconnected: all pixels.
    mask_left: Option<Image<'f, Mask>>,
    /// Nonzero where `right` is illuminated.
    mask_right: Option<Image<'f, Mask>>,
    /// Nonzero where each of `views` is illuminated, in their order. Unconnected: all pixels.
    masks: Option<List<'f, Image<'f, Mask>>>,
}

/// Outputs of the composite.
#[derive(Ports)]
pub struct Out<'f> {
    /// The panorama; black outside both views.
    panorama: Slot<'f, Bgr8>,
    /// 255 inside the views, 0 elsewhere.
    mask: Slot<'f, Mask>,
    /// Rectangle of the left view in the panorama, px.
    canvas: Slot<'f, Roi>,
    /// View that each pixel shows: 0 none, 1 the left, 2 the right one.
    shown: Slot<'f, Gray8>,
    /// Vertices of the mesh: which pixel of the right view, and of the left one, each point of the panorama shows. Empty before the first mesh. With
    /// `views`, those of all further views one after the other, each after the number of the view; the first view is then not bent.
    mesh: Slot<'f, TableData>,
    /// Area of the panorama beyond that of the first view, percent. In a cropped panorama only illuminated pixels count.
    gain: Slot<'f, Scalar>,
    /// The same as text: `+12 % over one view`. It changes rarely.
    gain_text: Slot<'f, TextPacket>,
}

/// Share of the border between two views along which the mesh has no observations: above the first a warning is logged, below the second it ends.
const BLIND: [f64; 2] = [0.2, 0.1];
/// Number of consecutive ticks before the warning, so that a short blur gives none.
const BLIND_TICKS: u32 = 15;

/// Warns when nothing determines the relative position of the views along a part of their border.
#[derive(Default)]
struct BlindWatch {
    ticks: u32,
    is_blind: bool,
}

impl BlindWatch {
    fn look(&mut self, cx: &Context<'_>, report: &MeshReport) {
        let is_blind = !report.is_held && report.blind > BLIND[usize::from(self.is_blind)];
        self.ticks = if is_blind { self.ticks.saturating_add(1) } else { 0 };
        if self.ticks >= BLIND_TICKS && !self.is_blind {
            self.is_blind = true;
            cx.warn(&format!(
                "along {:.0} % of the border between the views nothing matches: they overlap too little there, and the panorama may be wrong by many pixels. Move back from the tissue",
                100.0 * report.blind
            ));
        } else if self.is_blind && !is_blind {
            self.is_blind = false;
            cx.info("the views match again along their whole border");
        }
    }
}

/// The `composite_mesh` node.
pub struct CompositeMesh {
    drawer: Drawer,
    views: CalibratedViews,
    blind: BlindWatch,
    /// One follower for each further view.
    followers: Vec<MeshFollower>,
    /// Disparity merged from several maps.
    joined: Vec<f32>,
    parts: Parts<f32>,
    rows: Vec<f64>,
}

/// Appends the vertices, row after row.
fn push_vertices(rows: &mut Vec<f64>, view: Option<usize>, mesh: &Mesh, reference: Option<&Mesh>) {
    let lattice = mesh.lattice();
    for (index, source) in mesh.source().iter().enumerate() {
        let at = lattice.position(index % lattice.columns, index / lattice.columns);
        rows.extend(view.map(|view| view as f64));
        rows.extend(at);
        rows.extend(source.map(f64::from));
        if view.is_none() {
            rows.extend(reference.and_then(|mesh| mesh.source().get(index)).map_or(at, |left| left.map(f64::from)));
        }
    }
}

/// The first view and a further one as rectified cameras.
fn cameras(
    views: &mut CalibratedViews,
    calibration: Option<&Calibration>,
    sizes: [(usize, usize); 2],
) -> Result<[RectifiedView; 2]> {
    let of = |camera: &Camera| (camera.width as usize, camera.height as usize);
    let known = calibration.map_or(sizes, |c| [of(&c.left), of(&c.right)]);
    if known != sizes {
        let [[(width, height), (right_width, right_height)], [left, right]] = [sizes, known];
        return Err(error!(
            "the views are {width}x{height} and {right_width}x{right_height}, but the calibration is for {}x{} and {}x{}: connect the calibration of these views",
            left.0, left.1, right.0, right.1
        ));
    }
    Ok(views.of(calibration, sizes)?)
}

/// Merges maps: each pixel takes the first map that knows it.
fn join(joined: &mut Vec<f32>, maps: &List<'_, Image<'_, Disparity>>, (width, height): (usize, usize)) -> Result<()> {
    joined.clear();
    joined.resize(width * height, f32::NAN);
    for map in maps.iter().flatten() {
        let map = map.view();
        if (map.width, map.height) != (width, height) {
            return Err(error!(
                "a disparity is {}x{}, but the first view is {width}x{height}: connect disparities of the first view at full size",
                map.width, map.height
            ));
        }
        for (y, row) in joined.chunks_exact_mut(width).enumerate() {
            for (known, new) in row.iter_mut().zip(map.row(y)).filter(|(known, _)| known.is_nan()) {
                *known = *new;
            }
        }
    }
    Ok(())
}

/// Combines the reports of two meshes of a tick: the worse of both.
fn worst(a: MeshReport, b: MeshReport) -> MeshReport {
    MeshReport {
        observations: a.observations.min(b.observations),
        blind: a.blind.max(b.blind),
        residual_px: a.residual_px.max(b.residual_px),
        motion_px: a.motion_px.max(b.motion_px),
        is_held: a.is_held || b.is_held,
        is_new: a.is_new || b.is_new,
    }
}

impl CompositeMesh {
    /// Updates the mesh of a further view for this tick, if both its homography and the disparity are good.
    fn follow(
        &mut self,
        cx: &Context<'_>,
        (scene, view): (&Scene<'_>, usize),
        disparity: Option<View<'_, f32>>,
        calibration: Option<&Calibration>,
    ) -> Result<Option<MeshReport>> {
        let (Some(disparity), map) = (disparity, scene.maps[view]) else { return Ok(None) };
        let sizes = [0, view].map(|view| scene.size(view));
        let plausible = warped_corners(&map, sizes[1].0, sizes[1].1, view).is_ok();
        if scene.states[view] != abi::STATE_FRESH || !plausible {
            return Ok(None);
        }
        let [first, other] = cameras(&mut self.views, calibration, sizes)?;
        check_map((disparity.width, disparity.height), first.size)?;
        let map = geometry::Homography(map);
        Ok(Some(self.followers[view - 1].update(disparity, &first, &other, &map, cx.pool())))
    }

    /// Passes a detector's boxes and mask to the follower of a pair.
    fn hint(&mut self, input: &In<'_>, min_score: f32, (width, height): (usize, usize)) -> Result<()> {
        let hints = self.followers[0].hints_mut();
        hints.clear();
        if let Some(found) = &input.detections {
            let (of_width, of_height) = found.image_size();
            if of_width > 0 && of_height > 0 {
                let grow = [width as f64 / of_width as f64, height as f64 / of_height as f64];
                for item in found.items().iter().filter(|item| item.score >= min_score) {
                    let at = [item.x_px, item.y_px].map(f64::from);
                    let size = [item.width_px, item.height_px].map(f64::from);
                    hints.push_box([0, 1].map(|k| at[k] * grow[k]), [0, 1].map(|k| size[k] * grow[k]));
                }
            }
        }
        if let Some(mask) = &input.mask {
            let mask = mask.view();
            if (mask.width, mask.height) != (width, height) {
                return Err(error!(
                    "`mask` is {}x{}, but the left view is {width}x{height}: connect a mask of the left view",
                    mask.width, mask.height
                ));
            }
            hints.add_mask(mask);
        }
        Ok(())
    }

    /// What the mesh of a pair reads of a map on the GPU; `None` where all of it is to be read.
    fn pixels(
        &mut self,
        map: &Image<'_, Disparity>,
        scene: &Scene<'_>,
        calibration: Option<&Calibration>,
    ) -> Option<Grid> {
        let sizes = [0, 1].map(|view| scene.size(view));
        let [left, right] = map.is_from_device().then(|| cameras(&mut self.views, calibration, sizes).ok())??;
        let [columns, rows] = self.followers[0].pixels((map.width(), map.height()), &left, &right);
        Some(Grid { columns, rows })
    }

    /// Updates all meshes for this tick.
    fn follow_all(
        &mut self,
        cx: &Context<'_>,
        input: &In<'_>,
        scene: &Scene<'_>,
        params: &CompositeMeshParams,
    ) -> Result<Option<MeshReport>> {
        let size = scene.size(0);
        let (mut joined, mut parts) = (std::mem::take(&mut self.joined), std::mem::take(&mut self.parts));
        if let (Some(_), Some(maps)) = (&input.views, &input.disparities) {
            join(&mut joined, maps, size)?;
        }
        while self.followers.len() + 1 < scene.count {
            self.followers.push(MeshFollower::default());
        }
        let mut all: Option<MeshReport> = None;
        for view in 1..scene.count {
            let columns = if input.views.is_some() { params.camera_columns as usize } else { 2 };
            let along = [view % columns, view / columns].map(|steps| steps as f64);
            self.followers[view - 1].set_params(params.mesh(along, input.views.is_none()));
            if view == 1 {
                self.hint(input, params.min_score, size)?;
            }
            let calibration = input.calibration.as_deref();
            let disparity = match (&input.views, &input.disparity) {
                (None, Some(map)) => Some(match self.pixels(map, scene, calibration) {
                    Some(read) => parts.view(*map, &[read]),
                    None => map.view(),
                }),
                (None, None) => None,
                (Some(_), _) => input.disparities.as_ref().map(|_| View::new(&joined, size.0, size.1, 1)),
            };
            if let Some(report) = self.follow(cx, (scene, view), disparity, calibration)? {
                all = Some(all.map_or(report, |others| worst(others, report)));
            }
            self.drawer.kernel.set_mesh(view, self.followers[view - 1].mesh());
        }
        let is_pair = input.views.is_none();
        self.drawer
            .kernel
            .set_mesh(0, self.followers.first().filter(|_| is_pair).and_then(MeshFollower::reference_mesh));
        (self.joined, self.parts) = (joined, parts);
        Ok(all)
    }

    /// Writes the vertices of all meshes; nothing before the first mesh.
    fn set_vertices(&mut self, slot: &mut Slot<'_, TableData>, count: usize, is_list: bool) -> Result<()> {
        self.rows.clear();
        for (index, follower) in self.followers.iter().take(count - 1).enumerate() {
            if let Some(mesh) = follower.mesh() {
                push_vertices(&mut self.rows, is_list.then_some(index + 2), mesh, follower.reference_mesh());
            }
        }
        match () {
            () if self.rows.is_empty() => Ok(()),
            () if is_list => slot.set_table(&VIEW_VERTEX_COLUMNS, &self.rows),
            () => slot.set_table(&VERTEX_COLUMNS, &self.rows),
        }
    }
}

impl Node for CompositeMesh {
    const INFO: NodeInfo = NodeInfo::compute(
        "composite_mesh",
        "stitch",
        "Joins views by meshes that follow their disparity, so that nothing breaks at the seam, and keep lengths beyond.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = CompositeMeshParams;

    fn validate(_: &CompositeMeshParams, check: &mut Validation<'_>) {
        check_views(check);
        let is_list = check.is_connected("views") == Some(true);
        let depth = if is_list { "disparities" } else { "disparity" };
        if check.is_connected(depth) == Some(false) {
            check.node_warning(
                "no disparity is connected: the homography alone places the right view",
                format!("connect `{depth}`, or use `composite`"),
            );
        }
        if is_list && check.is_connected("calibration") == Some(true) {
            check.node_error(
                "a calibration describes two cameras, but `views` must be rectified",
                "leave `calibration` unconnected, or connect `left` and `right` instead of `views`",
            );
        }
    }

    fn open(open: &Open<'_>, params: &CompositeMeshParams) -> Result<Self> {
        Ok(Self {
            drawer: Drawer::new(&params.composite, open),
            views: CalibratedViews::default(),
            blind: BlindWatch::default(),
            followers: Vec::new(),
            joined: Vec::new(),
            parts: Parts::default(),
            rows: Vec::new(),
        })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &CompositeMeshParams,
    ) -> Result<()> {
        self.drawer.set_params(&params.composite, cx);
        let inputs = SceneInputs {
            pair: [input.left.as_ref(), input.right.as_ref()],
            pair_masks: [input.mask_left.as_ref(), input.mask_right.as_ref()],
            homography: input.homography.as_deref(),
            views: input.views.as_ref(),
            homographies: input.homographies.as_ref(),
            masks: input.masks.as_ref(),
        };
        self.drawer.take_masks(&inputs)?;
        let Some(scene) = Scene::of(&inputs)? else { return Ok(()) };
        if let Some(report) = self.follow_all(cx, &input, &scene, params)? {
            cx.metric("mesh_observations", report.observations as f64);
            cx.metric("mesh_held", f64::from(u8::from(report.is_held)));
            cx.metric("mesh_blind_pct", 100.0 * report.blind);
            self.blind.look(cx, &report);
            if report.residual_px.is_finite() {
                cx.metric("mesh_residual_px", report.residual_px);
            }
            if report.motion_px.is_finite() {
                cx.metric("mesh_motion_px", report.motion_px);
            }
        }
        if params.composite.on_lost == OnLost::Skip && !self.drawer.accepts(&scene)? {
            return Ok(());
        }
        if out.mesh.is_read() {
            self.set_vertices(&mut out.mesh, scene.count, input.views.is_some())?;
        }
        let Out { panorama, mask, canvas, shown, gain, gain_text, .. } = &mut out;
        let slots = Slots { panorama, mask, canvas, shown, gain, gain_text };
        draw(&mut self.drawer, cx, &scene, slots)
    }
}
