//! `evaluate_stitch`: registration and panorama compared with the ground truth, one row per tick.

use panoscope_imaging::Rect;
use panoscope_imaging::geometry::Homography as Map;
use panoscope_imaging::stitch::evaluate::TruePairs;
use panoscope_imaging::stitch::judge::{DrawnPanorama, PictureMarks, WideTruth, compare_pictures, correlated};
use panoscope_imaging::stitch::placement::Placement;
use panoscope_imaging::stitch::{Lattice, Mesh};
use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::{
    Bgr8, Context, Disparity, Gray8, Image, Mask, Node, NodeInfo, Open, Params, Ports, Result, Slot, Table, TableData,
    Value, View, error,
};

use crate::composite_mesh::{VERTEX_COLUMNS, VIEW_VERTEX_COLUMNS};

/// Columns of the table.
const COLUMNS: [&str; 21] = [
    "tick",
    "state",
    "inliers",
    "align_px",
    "floor_px",
    "points",
    "move_px",
    "psnr_overlap_db",
    "ssim_overlap",
    "psnr_seam_db",
    "ssim_seam",
    "fov_pct",
    "cropped_pct",
    "canvas_width_px",
    "canvas_height_px",
    "fov_truth_pct",
    "fov_right_pct",
    "seam_break_px",
    "seam_break_p95_px",
    "ghost_pct",
    "stretch_pct",
];
/// Value of `state` for a tick without a homography.
const STATE_NONE: f64 = 3.0;

/// Parameters of the evaluation.
#[derive(Params, Clone, PartialEq)]
pub struct EvaluateParams {
    /// Column of the left view's origin in the wide ground truth; -1: as in the phantom, an eighth of the extra width.
    #[param(default = -1, range = -1..=8192, unit = "px")]
    wide_x: i32,
    /// Row of the left view's origin in the wide ground truth; -1: as in the phantom, an eighth of the extra height.
    #[param(default = -1, range = -1..=8192, unit = "px")]
    wide_y: i32,
    /// Half the width of the band along the seam that is compared.
    #[param(default = 16, range = 1..=256, unit = "px")]
    seam_band: u32,
    /// Spacing of the true correspondences.
    #[param(default = 8, range = 1..=64, unit = "px")]
    step: u32,
    /// Number of ticks between comparisons of images, which take longer than stitching.
    #[param(default = 3, range = 1..=1000, unit = "frames")]
    every: u32,
    /// If no ground truth is connected, evaluates the alignment by correspondences found by correlation, on the same ticks.
    #[param(default = false)]
    correlate: bool,
    /// Horizontal displacement of the right view, in units of the true disparity.
    #[param(default = 1.0, range = -8.0..=8.0, unit = "ratio")]
    along_x: f64,
    /// Vertical displacement of the right view: 1 for a camera one baseline below the left one.
    #[param(default = 0.0, range = -8.0..=8.0, unit = "ratio")]
    along_y: f64,
    /// Number of the right view in `shown`.
    #[param(default = 2, range = 2..=8)]
    view: u32,
}

/// Inputs of the evaluation.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view.
    left: Image<'f, Bgr8>,
    /// Right view.
    right: Image<'f, Bgr8>,
    /// The registration to evaluate.
    homography: Option<Value<'f, Homography>>,
    /// Mesh that places the right view instead of the homography, as `composite_mesh` writes it.
    mesh: Option<Table<'f>>,
    /// The panorama to evaluate.
    panorama: Option<Image<'f, Bgr8>>,
    /// Rectangle of the left view in the panorama, px.
    canvas: Option<Value<'f, Roi>>,
    /// View that each pixel of the panorama shows.
    shown: Option<Image<'f, Gray8>>,
    /// True disparity of the left view, px.
    disparity: Option<Image<'f, Disparity>>,
    /// 255 where the right camera sees the same point.
    visible: Option<Image<'f, Mask>>,
    /// True homography, or the best available.
    truth: Option<Value<'f, Homography>>,
    /// Image of one wide camera at the left camera's position.
    wide: Option<Image<'f, Bgr8>>,
    /// 255 in each pixel of `wide` that at least one camera shows.
    footprint: Option<Image<'f, Mask>>,
    /// Rectangle of the left view in `wide`, px; overrides the parameters.
    left_in_wide: Option<Value<'f, Roi>>,
}

/// Outputs of the evaluation.
#[derive(Ports)]
pub struct Out<'f> {
    /// A row for every tick so far; NaN where there is no ground truth. `state`: 0 fresh, 1 held, 2 lost, 3 none. Areas relative to that of the left
    /// view: `fov_pct` is covered by the panorama, `fov_truth_pct` by the footprint of all cameras, `fov_right_pct` by both.
    table: Slot<'f, TableData>,
}

/// The `evaluate_stitch` node.
pub struct EvaluateStitch {
    rows: Vec<f64>,
    previous: Option<Placement>,
    ticks: u64,
}

/// Reads the meshes of view `view` and of the left view from a table of `composite_mesh`: vertices row after row, at multiples of the cell's side.
fn mesh_of(table: &Table<'_>, view: u32) -> Result<Option<(Mesh, Option<Mesh>)>> {
    let bad = || error!("the table at `mesh` is not a mesh: connect the output `mesh` of a `composite_mesh`");
    let rows: Vec<&[f64]> = if table.names().eq(VERTEX_COLUMNS) {
        table.rows().collect()
    } else if table.names().eq(VIEW_VERTEX_COLUMNS) {
        table.rows().filter(|row| row[0] == f64::from(view)).map(|row| &row[1..]).collect()
    } else {
        return Err(bad());
    };
    let (Some(first), Some(second)) = (rows.first(), rows.get(1)) else { return Ok(None) };
    let columns = rows.iter().take_while(|row| row[1] == first[1]).count();
    let cell_px = second[0] - first[0];
    if !rows.len().is_multiple_of(columns) || cell_px.is_nan() || cell_px < 1.0 {
        return Err(bad());
    }
    let lattice = Lattice {
        cell_px: cell_px as usize,
        first: [first[0], first[1]].map(|at| (at / cell_px).round() as i32),
        columns,
        rows: rows.len() / columns,
    };
    let of = |column: usize| {
        let source = rows.iter().map(|row| [row[column] as f32, row[column + 1] as f32]).collect();
        Mesh::of_vertices(lattice, source).ok_or_else(bad)
    };
    let has_left = table.names().eq(VERTEX_COLUMNS);
    Ok(Some((of(2)?, has_left.then(|| of(4)).transpose()?)))
}

/// Root mean square distance of two maps over the points of the right view that the true one maps into the left view, and the number of these points.
fn between(map: &Map, truth: &Map, left: (usize, usize), right: (usize, usize), step: u32) -> Option<(f64, usize)> {
    let (mut squares, mut count) = (0.0, 0usize);
    for y in (0..right.1).step_by(step.max(1) as usize) {
        for x in (0..right.0).step_by(step.max(1) as usize) {
            let point = [x as f64, y as f64];
            let [u, v] = truth.map(point);
            if u >= 0.0 && v >= 0.0 && u <= left.0 as f64 - 1.0 && v <= left.1 as f64 - 1.0 {
                squares += map.squared_error(point, [u, v]);
                count += 1;
            }
        }
    }
    (count > 0).then(|| ((squares / count as f64).sqrt(), count))
}

/// Share of the right view that is mapped outside the panorama, percent.
fn cropped_pct(map: &Map, right: (usize, usize), canvas: &Roi, panorama: (usize, usize)) -> f64 {
    let mut outside = 0;
    for i in 0..32 * 32 {
        let point = [(i % 32) as f64 / 31.0 * (right.0 as f64 - 1.0), (i / 32) as f64 / 31.0 * (right.1 as f64 - 1.0)];
        let [u, v] = map.map(point);
        let (x, y) = (u + f64::from(canvas.x), v + f64::from(canvas.y));
        let inside = x > -1.0 && y > -1.0 && x < panorama.0 as f64 && y < panorama.1 as f64;
        outside += i32::from(!inside);
    }
    f64::from(outside) * 100.0 / 1024.0
}

/// Column and row of the left view's origin in the wide ground truth.
fn left_in_wide(input: &In<'_>, wide: (usize, usize), params: &EvaluateParams) -> (i32, i32) {
    let auto = |given: i32, wide: usize, left: usize| if given >= 0 { given } else { (wide as i32 - left as i32) / 8 };
    match &input.left_in_wide {
        Some(at) => (at.x, at.y),
        None => (auto(params.wide_x, wide.0, input.left.width()), auto(params.wide_y, wide.1, input.left.height())),
    }
}

/// Numbers of pixels covered by the panorama, by the footprint of all cameras, and by both.
fn areas(shown: View<'_, u8>, footprint: Option<View<'_, u8>>, canvas: Roi, offset: (i32, i32)) -> [usize; 3] {
    let covered = (0..shown.height).map(|y| shown.row(y).iter().filter(|v| **v != 0).count()).sum();
    let Some(footprint) = footprint else { return [covered, 0, 0] };
    let (mut truth, mut both) = (0, 0);
    for v in 0..footprint.height {
        let line = footprint.row(v);
        truth += line.iter().filter(|seen| **seen != 0).count();
        let y = v as i64 - i64::from(offset.1) + i64::from(canvas.y);
        if y < 0 || y >= shown.height as i64 {
            continue;
        }
        let shown_line = shown.row(y as usize);
        for (u, _) in line.iter().enumerate().filter(|(_, seen)| **seen != 0) {
            let x = u as i64 - i64::from(offset.0) + i64::from(canvas.x);
            let shown = usize::try_from(x).ok().and_then(|x| shown_line.get(x));
            both += usize::from(shown.is_some_and(|view| *view != 0));
        }
    }
    [covered, truth, both]
}

/// Compares the panorama with the wide ground truth, if both are connected.
fn pictures(input: &In<'_>, map: &Map, params: &EvaluateParams) -> PictureMarks {
    let (Some(panorama), Some(canvas), Some(wide)) = (&input.panorama, &input.canvas, &input.wide) else {
        return PictureMarks::default();
    };
    let sizes = [&input.left, &input.right].map(|view| (view.width(), view.height()));
    let shown = input.shown.as_ref().map(Image::view);
    let panorama = DrawnPanorama { picture: panorama.view(), left_at: (canvas.x, canvas.y), shown };
    let left_at = left_in_wide(input, (wide.width(), wide.height()), params);
    let wide = WideTruth { picture: wide.view(), left_at };
    compare_pictures(&panorama, &wide, sizes, map, params.seam_band as usize)
}

/// Alignment error, its floor (both px), and number of correspondences: with the true disparity, else with the true homography, else, on the ticks of
/// `every`, by correlation. NaN where nothing is known.
fn alignment(
    input: &In<'_>,
    map: &Map,
    placed: &Placement,
    params: &EvaluateParams,
    is_compared: bool,
    cx: &Context<'_>,
) -> [f64; 3] {
    let mut marks = [f64::NAN; 3];
    if let Some(disparity) = &input.disparity {
        let (along, step) = ([params.along_x, params.along_y], params.step as usize);
        let visible = input.visible.as_ref().map(Image::view);
        let pairs = TruePairs { disparity: disparity.view(), visible, along, step };
        if let Some((align, count)) = placed.alignment(&pairs) {
            (marks[0], marks[2]) = (align, count as f64);
        }
        let floor = match &input.truth {
            Some(truth) => pairs.alignment(&Map(truth.left_from_right)).map(|(rms, _)| rms),
            None => pairs.floor_px(),
        };
        marks[1] = floor.unwrap_or(f64::NAN);
    } else if let Some(truth) = &input.truth {
        let left = (input.left.width(), input.left.height());
        let right = (input.right.width(), input.right.height());
        if let Some((align, count)) = between(map, &Map(truth.left_from_right), left, right, params.step) {
            marks = [align, 0.0, count as f64];
        }
    } else if params.correlate && is_compared {
        let found = correlated(placed, input.left.view(), input.right.view(), cx.pool());
        marks = [found.align_px, found.floor_px, found.points as f64];
    }
    marks
}

/// Break across the seam (median and maximum, as [`Placement::seam_break`] returns them) and stretch, percent; NaN where nothing is known.
fn seam_marks(
    input: &In<'_>,
    placed: &Placement,
    shown: View<'_, u8>,
    canvas: &Roi,
    params: &EvaluateParams,
) -> [f64; 3] {
    let (view, left_at) = (params.view as u8, (canvas.x, canvas.y));
    let mut marks = [f64::NAN; 3];
    if let Some(disparity) = &input.disparity {
        let along = [params.along_x, params.along_y];
        let visible = input.visible.as_ref().map(Image::view);
        let pairs = TruePairs { disparity: disparity.view(), visible, along, step: 1 };
        (marks[0], marks[1]) = placed.seam_break(&pairs, shown, view, left_at).unwrap_or((f64::NAN, f64::NAN));
    }
    let whole = Rect::whole(input.left.width(), input.left.height());
    marks[2] = placed.stretch_pct(shown, view, whole, left_at).unwrap_or(f64::NAN);
    marks
}

/// Areas relative to that of the left view, percent: covered by the panorama, by the footprint of all cameras, and by both; NaN where unknown.
fn area_marks(input: &In<'_>, params: &EvaluateParams) -> [f64; 3] {
    let Some(shown) = &input.shown else { return [f64::NAN; 3] };
    let canvas = input.canvas.as_deref().copied();
    let footprint = input.footprint.as_ref().filter(|_| canvas.is_some()).map(Image::view);
    let offset = footprint.map_or((0, 0), |wide| left_in_wide(input, (wide.width, wide.height), params));
    let areas = areas(shown.view(), footprint, canvas.unwrap_or_default(), offset);
    let one = (input.left.width() * input.left.height()).max(1) as f64;
    let [covered, truth, both] = areas.map(|pixels| 100.0 * pixels as f64 / one);
    if footprint.is_some() { [covered, truth, both] } else { [covered, f64::NAN, f64::NAN] }
}

impl Node for EvaluateStitch {
    const INFO: NodeInfo = NodeInfo::compute(
        "evaluate_stitch",
        "stitch",
        "Compares a registration and its panorama with the ground truth: alignment, similarity in the overlap and along the seam, jitter.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = EvaluateParams;

    fn open(_: &Open<'_>, _: &EvaluateParams) -> Result<Self> {
        Ok(Self { rows: Vec::new(), previous: None, ticks: 0 })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &EvaluateParams,
    ) -> Result<()> {
        const NONE: f64 = f64::NAN;
        let mut row = [NONE; COLUMNS.len()];
        row[0] = self.ticks as f64;
        row[1] = input.homography.as_ref().map_or(STATE_NONE, |h| f64::from(h.state));
        let right = (input.right.width(), input.right.height());
        let map = input.homography.as_ref().filter(|h| h.state != abi::STATE_LOST).map(|h| Map(h.left_from_right));
        let mesh = input.mesh.as_ref().map(|mesh| mesh_of(mesh, params.view)).transpose()?.flatten();
        let (mesh, left_mesh) = mesh.map_or((None, None), |(mesh, left)| (Some(mesh), left));
        let placed = map.and_then(|map| Placement::new(map, mesh)).map(|placed| placed.with_reference(left_mesh));
        let is_compared = self.ticks.is_multiple_of(u64::from(params.every));
        if let (Some(map), Some(placed), Some(given)) = (&map, &placed, &input.homography) {
            row[2] = f64::from(given.inliers);
            [row[3], row[4], row[5]] = alignment(&input, map, placed, params, is_compared, cx);
            row[6] = self.previous.as_ref().and_then(|previous| placed.motion_px(previous, right)).unwrap_or(NONE);
            if let (Some(shown), Some(canvas)) = (&input.shown, &input.canvas) {
                [row[17], row[18], row[20]] = seam_marks(&input, placed, shown.view(), canvas, params);
            }
            if is_compared {
                let PictureMarks { whole, seam, ghost_pct } = pictures(&input, map, params);
                (row[7], row[8]) = whole.map_or((NONE, NONE), |l| (l.psnr_db, l.ssim));
                (row[9], row[10]) = seam.map_or((NONE, NONE), |l| (l.psnr_db, l.ssim));
                row[19] = ghost_pct.unwrap_or(NONE);
            }
            if let (Some(panorama), Some(canvas)) = (&input.panorama, &input.canvas) {
                row[12] = cropped_pct(map, right, canvas, (panorama.width(), panorama.height()));
            }
        }
        [row[11], row[15], row[16]] = area_marks(&input, params);
        if let Some(panorama) = &input.panorama {
            (row[13], row[14]) = (panorama.width() as f64, panorama.height() as f64);
        }
        self.previous = placed;
        self.ticks += 1;
        self.rows.extend(row);
        out.table.set_table(&COLUMNS, &self.rows)
    }
}
