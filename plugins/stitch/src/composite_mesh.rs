//! `composite_mesh`: two views, their homography and their disparity in, one wide picture without parallax at the seam out.

use panoscope_imaging::geometry;
use panoscope_imaging::stitch::{
    self, Compositor, GeometryState, Mesh, MeshFollower, MeshParams, MeshReport, RectifiedView, warped_corners,
};
use panoscope_node::abi::{self, Calibration, Homography, Roi};
use panoscope_node::{
    Bgr8, Context, Disparity, Gray8, Image, Mask, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData,
    Validation, Value, error,
};

use crate::composite::{CompositeNodeParams, OnLost, Slots, draw};
use crate::register_grid;

/// Columns of the table of vertices.
pub const VERTEX_COLUMNS: [&str; 4] = ["x_px", "y_px", "right_x_px", "right_y_px"];

/// Parameters of the composite. Lengths of the mesh are for views 640 px wide and grow with the views.
#[derive(Params, Clone, PartialEq)]
pub struct CompositeMeshParams {
    /// Side of a cell of the mesh.
    #[param(default = 20, range = 12..=96, unit = "px")]
    cell: u32,
    /// Smoothness of the mesh: weight of its bends beside what is observed in a cell.
    #[param(default = 0.05, range = 0.01..=100.0, step = 0.01, unit = "ratio")]
    bend: f64,
    /// How soon the mesh fades into the homography where only one camera sees: weight of its slopes.
    #[param(default = 0.02, range = 0.0..=10.0, step = 0.01, unit = "ratio")]
    fade: f64,
    /// Distance from the mesh at which an observation counts half: those of an instrument in front of the tissue count little.
    #[param(default = 6.0, range = 0.2..=50.0, step = 0.1, unit = "px")]
    outlier_px: f64,
    /// Weight of the mesh of the frame before while nothing moves; 0 fits each frame anew.
    #[param(default = 10.0, range = 0.0..=1000.0, step = 1.0, unit = "ratio")]
    steady: f64,
    #[param(flatten)]
    composite: CompositeNodeParams,
}

impl CompositeMeshParams {
    fn mesh(&self) -> MeshParams {
        MeshParams {
            cell_px: f64::from(self.cell),
            bend: self.bend,
            slope: self.fade,
            outlier_px: self.outlier_px,
            hold_still: self.steady,
            ..MeshParams::default()
        }
    }
}

/// Inputs of the composite.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view; the panorama lies in its plane.
    left: Image<'f, Bgr8>,
    /// Right view of the same instant.
    right: Image<'f, Bgr8>,
    /// Maps right-view pixels to left-view pixels: where only the right camera sees.
    homography: Option<Value<'f, Homography>>,
    /// Disparity of the left rectified view, full size: where both cameras see. Without it the homography places the right view alone.
    disparity: Option<Image<'f, Disparity>>,
    /// Calibration of the views. Unconnected, they are taken as rectified.
    calibration: Option<Value<'f, Calibration>>,
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
    /// Vertices of the mesh: where each point of the left view's plane lies in the right view. Empty before the first mesh.
    mesh: Slot<'f, TableData>,
}

/// See the module.
pub struct CompositeMesh {
    kernel: Compositor,
    follower: MeshFollower,
    seams: u64,
}

/// A view that is rectified already.
fn rectified(size: (usize, usize)) -> RectifiedView {
    RectifiedView {
        size,
        focal_px: [1.0; 2],
        centre_px: [0.0; 2],
        distortion: [0.0; 12],
        rectified_from_camera: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        rectified_focal_px: [1.0; 2],
        rectified_centre_px: [0.0; 2],
    }
}

/// Writes the vertices, row after row.
fn set_vertices(slot: &mut Slot<'_, TableData>, mesh: &Mesh) -> Result<()> {
    let lattice = mesh.lattice();
    let mut rows = Vec::with_capacity(lattice.len() * VERTEX_COLUMNS.len());
    for (index, source) in mesh.source().iter().enumerate() {
        rows.extend(lattice.position(index % lattice.columns, index / lattice.columns));
        rows.extend(source.map(f64::from));
    }
    slot.set_table(&VERTEX_COLUMNS, &rows)
}

impl CompositeMesh {
    /// Brings the mesh up to this tick, where both the homography and the disparity are good.
    fn follow(&mut self, cx: &Context<'_>, input: &In<'_>, homography: &Homography) -> Result<Option<MeshReport>> {
        let Some(disparity) = &input.disparity else { return Ok(None) };
        let (width, height) = (input.right.width(), input.right.height());
        let plausible = warped_corners(&homography.left_from_right, width, height, 1).is_ok();
        if homography.state != abi::STATE_FRESH || !plausible {
            return Ok(None);
        }
        let [left, right] = match input.calibration.as_deref() {
            Some(c) => {
                let is_rectified = c.is_rectified != 0;
                let left = register_grid::view(&c.left, &c.rectified_from_left, &c.left_projection, is_rectified);
                [left, register_grid::view(&c.right, &c.rectified_from_right, &c.right_projection, is_rectified)]
            }
            None => [(input.left.width(), input.left.height()), (width, height)].map(rectified),
        };
        if left.size != (input.left.width(), input.left.height()) || right.size != (width, height) {
            return Err(error!(
                "the views are {}x{} and {width}x{height}, the calibration is for {}x{} and {}x{}: connect the calibration of these views",
                input.left.width(),
                input.left.height(),
                left.size.0,
                left.size.1,
                right.size.0,
                right.size.1
            ));
        }
        let map = geometry::Homography(homography.left_from_right);
        Ok(Some(self.follower.update(disparity.view(), &left, &right, &map, cx.pool())))
    }
}

impl Node for CompositeMesh {
    const INFO: NodeInfo = NodeInfo::compute(
        "composite_mesh",
        "stitch",
        "Joins two views by a mesh that follows their disparity, so that nothing breaks at the seam, and fades into the homography.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = CompositeMeshParams;

    fn validate(_: &CompositeMeshParams, check: &mut Validation<'_>) {
        if check.is_connected("disparity") == Some(false) {
            check.node_warning(
                "there is no disparity: the homography alone places the right view",
                "connect `disparity`, or use `composite`",
            );
        }
    }

    fn open(_: &Open<'_>, params: &CompositeMeshParams) -> Result<Self> {
        let kernel = Compositor::new(params.composite.kernel());
        Ok(Self { kernel, follower: MeshFollower::new(params.mesh()), seams: 0 })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &CompositeMeshParams,
    ) -> Result<()> {
        let wanted = params.composite.kernel();
        if *self.kernel.params() != wanted {
            self.kernel.set_params(wanted);
        }
        self.follower.set_params(params.mesh());
        let lost = Homography { left_from_right: stitch::IDENTITY, rms_px: 0.0, inliers: 0, state: abi::STATE_LOST };
        let homography = input.homography.as_deref().unwrap_or(&lost);
        let report = self.follow(cx, &input, homography)?;
        self.kernel.set_mesh(1, self.follower.mesh());
        if let Some(report) = report {
            cx.metric("mesh_observations", report.observations as f64);
            cx.metric("mesh_held", f64::from(u8::from(report.is_held)));
            if report.residual_px.is_finite() {
                cx.metric("mesh_residual_px", report.residual_px);
            }
            if report.motion_px.is_finite() {
                cx.metric("mesh_motion_px", report.motion_px);
            }
        }
        let state = match homography.state {
            abi::STATE_LOST => GeometryState::Lost,
            abi::STATE_HELD => GeometryState::Held,
            _ => GeometryState::Fresh,
        };
        let views = [input.left.view(), input.right.view()];
        let maps = [stitch::IDENTITY, homography.left_from_right];
        if params.composite.on_lost == OnLost::Skip && !self.kernel.accepts(&views, &maps, state)? {
            return Ok(());
        }
        if let Some(mesh) = self.follower.mesh().filter(|_| out.mesh.is_read()) {
            set_vertices(&mut out.mesh, mesh)?;
        }
        let Out { panorama, mask, canvas, shown, .. } = &mut out;
        let slots = Slots { panorama, mask, canvas, shown };
        draw(&mut self.kernel, &mut self.seams, cx, (&views, &maps, state), slots)
    }
}
