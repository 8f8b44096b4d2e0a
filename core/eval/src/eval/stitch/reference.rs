//! The reference method of [`apap`](super::apap) on the images of a case, evaluated like a composite.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use panoscope_abi as abi;
use panoscope_base::packet;
use panoscope_base::parallel::Serial;
use panoscope_engine::Listener;
use panoscope_engine::memory::FrameRef;
use panoscope_imaging::features::{RegisterParams, RegisterSurf};
use panoscope_imaging::geometry::{Homography, Point};
use panoscope_imaging::stitch::evaluate::{RegionSimilarity, TruePairs};
use panoscope_imaging::stitch::judge::{DrawnPanorama, PictureMarks, WideTruth, compare_pictures, correlated};
use panoscope_imaging::stitch::placement::Placement;
use panoscope_imaging::stitch::{BlendMethod, CompositeParams, Compositor, GeometryState, IDENTITY, Mesh, SeamMethod};
use panoscope_imaging::{Rect, View, ViewMut};

use super::apap::{self, MovingDlt};
use super::{Marks, SETTLE};
use crate::canvas::Canvas;
use crate::error::{Context, Result};
use crate::inputs::wiring::Wiring;
use crate::packets::{self, Table};
use crate::registration::{FRESH, registration};
use crate::run::{self, Plan, Watchers};
use crate::session::{Session, check_cancelled};
use crate::statistics::rms;

/// One of this many ticks is evaluated, as often as the evaluating node compares images.
const EVERY: u64 = 3;
/// Half the width of the band along the seam that is compared, px.
const BAND_PX: usize = 16;
/// Spacing of the true correspondences, px.
const STEP_PX: usize = 8;
/// Number of the further view in a compositor's map of shown views.
const VIEW: u8 = 2;

/// Packets of one tick, by the input of the evaluating node that they are for.
type Packets = HashMap<&'static str, FrameRef>;

/// One warp and its panorama.
struct Stitched {
    placed: Placement,
    left_from_right: Homography,
    size: (usize, usize),
    left_at: (i32, i32),
    picture: Vec<u8>,
    shown: Vec<u8>,
}

/// Columns of a tick's measures, named as the evaluating node names them.
const COLUMNS: [&str; 14] = [
    "state",
    "align_px",
    "floor_px",
    "psnr_overlap_db",
    "ssim_overlap",
    "psnr_seam_db",
    "ssim_seam",
    "seam_break_px",
    "seam_break_p95_px",
    "ghost_pct",
    "stretch_pct",
    "fov_pct",
    "cropped_pct",
    "move_px",
];
/// State of a tick without a warp, and its position among the columns.
const LOST: (f64, usize) = (2.0, 0);
/// Measures of one tick, in the order of [`COLUMNS`]; NaN without ground truth.
type Row = [f64; COLUMNS.len()];

/// View of an image or map in its packet.
fn view(frame: &FrameRef, channels: usize) -> Option<View<'_, u8>> {
    let (described, bytes) = (frame.frame(), frame.bytes());
    let (width, height, stride) =
        (described.width as usize, described.height as usize, described.stride_bytes as usize);
    let fits = stride >= width * channels && bytes.len() >= stride * height.saturating_sub(1) + width * channels;
    fits.then_some(View { data: bytes, width, height, channels, stride })
}

/// Registers with the matches of our SURF and draws with our seam and blending, so that only the warp differs.
fn stitch(surf: &mut RegisterSurf, left: View<'_, u8>, right: View<'_, u8>) -> Result<Option<Stitched>> {
    surf.reset();
    surf.register(left, right, &Serial);
    let (features, (matches, _)) = (surf.features(), surf.matches());
    let pairs = matches
        .iter()
        .map(|m| (features.0.keypoints.position(m.left as usize), features.1.keypoints.position(m.right as usize)));
    let (reference, other): (Vec<Point>, Vec<Point>) = pairs.unzip();
    let Some(moving) = apap::inliers(&reference, &other).and_then(|(r, o)| MovingDlt::new(&r, &o)) else {
        return Ok(None);
    };
    let Some(left_from_right) = moving.whole().inverse() else { return Ok(None) };
    let Some(mesh) = moving.mesh((right.width, right.height)) else { return Ok(None) };
    draw(left, right, left_from_right, mesh)
}

fn draw(left: View<'_, u8>, right: View<'_, u8>, left_from_right: Homography, mesh: Mesh) -> Result<Option<Stitched>> {
    let params = CompositeParams {
        seam: SeamMethod::DynamicProgramming,
        blend: BlendMethod::Feather,
        blend_px: 24,
        ..CompositeParams::default()
    };
    let (mut kernel, views, maps) = (Compositor::new(params), [left, right], [IDENTITY, left_from_right.0]);
    kernel.set_mesh(1, Some(&mesh));
    if !kernel.accepts(&views, &maps, GeometryState::Fresh)? {
        return Ok(None);
    }
    let canvas = kernel.canvas(&views, &maps, GeometryState::Fresh)?;
    let size = (canvas.width, canvas.height);
    let (mut picture, mut shown) = (vec![0; size.0 * size.1 * 3], vec![0; size.0 * size.1]);
    let out = &mut ViewMut::new(&mut picture, size.0, size.1, 3);
    kernel.compose(&views, &maps, GeometryState::Fresh, &Serial, out, None)?;
    kernel.shown(&mut ViewMut::new(&mut shown, size.0, size.1, 1))?;
    let Some(placed) = Placement::new(left_from_right, Some(mesh)) else { return Ok(None) };
    Ok(Some(Stitched { placed, left_from_right, size, left_at: (canvas.left, canvas.top), picture, shown }))
}

fn judge_tick(
    stitched: &Stitched,
    previous: Option<&Placement>,
    packets: &Packets,
    [left, right]: [View<'_, u8>; 2],
) -> Option<Row> {
    const NONE: f64 = f64::NAN;
    let placed = &stitched.placed;
    let shown = View::new(&stitched.shown, stitched.size.0, stitched.size.1, 1);
    let truth = packets.get("truth").and_then(|frame| packet::decode::<abi::Homography>(frame.bytes()).ok());
    let values = packets.get("disparity").and_then(packets::floats);
    let disparity = values.as_ref().map(|values| View::new(values, left.width, left.height, 1));
    let visible = packets.get("visible").and_then(|frame| view(frame, 1));
    let pairs = |step: usize| disparity.map(|disparity| TruePairs { disparity, visible, along: [1.0, 0.0], step });
    let (align_px, floor_px) = match (pairs(STEP_PX), &truth) {
        (Some(pairs), Some(truth)) => {
            let floor = pairs.alignment(&Homography(truth.left_from_right));
            (placed.alignment(&pairs)?.0, floor.map_or(NONE, |(rms, _)| rms))
        }
        (Some(pairs), None) => (placed.alignment(&pairs)?.0, pairs.floor_px().unwrap_or(NONE)),
        // Cut out of one picture: a plane.
        (None, Some(truth)) => (from_plane(placed, &Homography(truth.left_from_right), [left, right]), 0.0),
        (None, None) => {
            let marks = correlated(placed, left, right, &Serial);
            (marks.align_px, marks.floor_px)
        }
    };
    let sizes = [(left.width, left.height), (right.width, right.height)];
    let wide = packets.get("wide").and_then(|frame| view(frame, 3));
    let left_at = packets.get("left_in_wide").and_then(|frame| packet::decode::<abi::Roi>(frame.bytes()).ok());
    let marks = wide.map_or_else(PictureMarks::default, |wide| {
        // As in the phantom: an eighth of the extra width and height.
        let eighth = |wide: usize, left: usize| (wide as i32 - left as i32) / 8;
        let begin =
            left_at.map_or((eighth(wide.width, left.width), eighth(wide.height, left.height)), |at| (at.x, at.y));
        let panorama = DrawnPanorama {
            picture: View::new(&stitched.picture, stitched.size.0, stitched.size.1, 3),
            left_at: stitched.left_at,
            shown: Some(shown),
        };
        let wide = WideTruth { picture: wide, left_at: begin };
        compare_pictures(&panorama, &wide, sizes, &stitched.left_from_right, BAND_PX)
    });
    let covered = stitched.shown.iter().filter(|view| **view != 0).count();
    let seam_break_px = pairs(1).and_then(|pairs| placed.seam_break(&pairs, shown, VIEW, stitched.left_at));
    let likeness = |of: Option<RegionSimilarity>| of.map_or([NONE; 2], |l| [l.psnr_db, l.ssim]);
    let ([psnr_overlap_db, ssim_overlap], [psnr_seam_db, ssim_seam]) = (likeness(marks.whole), likeness(marks.seam));
    let (median_px, p95_px) = seam_break_px.unwrap_or((NONE, NONE));
    let whole_left = Rect::whole(left.width, left.height);
    Some([
        FRESH,
        align_px,
        floor_px,
        psnr_overlap_db,
        ssim_overlap,
        psnr_seam_db,
        ssim_seam,
        median_px,
        p95_px,
        marks.ghost_pct.unwrap_or(NONE),
        placed.stretch_pct(shown, VIEW, whole_left, stitched.left_at).unwrap_or(NONE),
        100.0 * covered as f64 / (left.width * left.height).max(1) as f64,
        // Its canvas always covers both views.
        NONE,
        previous.and_then(|previous| placed.motion_px(previous, sizes[1])).unwrap_or(NONE),
    ])
}

/// Root mean square distance of a placement from a plane over the points of the right view that the plane maps into the
/// left one.
fn from_plane(placed: &Placement, truth: &Homography, [left, right]: [View<'_, u8>; 2]) -> f64 {
    let at = (0..right.height).step_by(STEP_PX).flat_map(|y| (0..right.width).step_by(STEP_PX).map(move |x| (x, y)));
    let errors = at.filter_map(|(x, y)| {
        let point = [x as f64, y as f64];
        let [u, v] = truth.map(point);
        let is_inside = u >= 0.0 && v >= 0.0 && u < left.width as f64 && v < left.height as f64;
        is_inside.then(|| placed.error_px(point, [u, v])).flatten()
    });
    rms(&errors.collect::<Vec<_>>())
}

/// Collects the packets of these ports, one of [`EVERY`] ticks.
fn collect(
    session: &dyn Session,
    pictures: &Wiring,
    ports: &[(&'static str, String)],
    path: &Path,
    frames: u64,
) -> Result<BTreeMap<u64, Packets>> {
    let kept: Arc<Mutex<BTreeMap<u64, Packets>>> = Arc::default();
    let listen = ports.iter().filter_map(|(input, from)| {
        let (node, output) = from.split_once('.')?;
        let (input, kept) = (*input, Arc::clone(&kept));
        Some(Listener {
            node: node.to_owned(),
            output: output.to_owned(),
            hear: Arc::new(move |frame| {
                let seq = frame.tick().seq;
                if seq.is_multiple_of(EVERY) {
                    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                    kept.entry(seq).or_default().insert(input, frame.clone());
                }
            }),
        })
    });
    let text = pictures.text();
    let plan = Plan { text: &text, path, frames: Some(frames), ..Plan::default() };
    run::run_watched(session, &plan, Watchers { listen: listen.collect(), ..Watchers::default() })?;
    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
    Ok(std::mem::take(&mut *kept))
}

/// A row for each evaluated tick, `None` if there is no warp, and the last panorama.
type Rows = (Vec<Option<Row>>, Option<Canvas>);

fn rows(session: &dyn Session, wiring: &Wiring, path: &Path, frames: u64) -> Result<Option<Rows>> {
    let Some((pictures, ports)) = wiring.pictures() else { return Ok(None) };
    let ticks = collect(session, &pictures, &ports, path, frames)?;
    let mut surf = RegisterSurf::new(RegisterParams { roi: false, ..RegisterParams::default() });
    let (mut rows, mut previous, mut picture) = (Vec::new(), None, None);
    for packets in ticks.values() {
        check_cancelled(session)?;
        let of = |name: &str| packets.get(name).and_then(|frame| view(frame, 3));
        let (Some(left), Some(right)) = (of("left"), of("right")) else { continue };
        let stitched = stitch(&mut surf, left, right)?;
        let row = stitched.as_ref().and_then(|s| judge_tick(s, previous.as_ref(), packets, [left, right]));
        rows.push(row);
        previous = stitched.map(|s| {
            picture = Some(Canvas { width: s.size.0, height: s.size.1, bgr: s.picture });
            s.placed
        });
    }
    Ok(Some((rows, picture)))
}

/// Result of the reference method.
pub(super) struct Reference {
    /// Its measures in all runs.
    pub marks: Marks,
    /// The last panorama.
    pub picture: Option<Canvas>,
}

/// Evaluates the reference method on the images of a graph; `None` for more than two views. `still`: settings for still
/// views.
pub(super) fn judge(
    session: &dyn Session,
    wiring: &Wiring,
    still: Option<&Wiring>,
    path: &Path,
    frames: u64,
) -> Result<Option<Reference>> {
    let Some((rows, picture)) = self::rows(session, wiring, path, frames)? else { return Ok(None) };
    let mut lost = [f64::NAN; COLUMNS.len()];
    lost[LOST.1] = LOST.0;
    let table = Table {
        names: COLUMNS.map(str::to_owned).to_vec(),
        rows: rows.into_iter().map(|row| row.unwrap_or(lost).to_vec()).collect(),
    };
    let mut jitter_px = f64::NAN;
    if let Some(still) = still {
        let (rows, _) = self::rows(session, still, path, frames.min(40))?.context("the views are the same")?;
        let motion_px: Vec<f64> = rows.into_iter().flatten().map(|row| row[COLUMNS.len() - 1]).collect();
        jitter_px = rms(motion_px.get(SETTLE.div_ceil(EVERY as usize)..).unwrap_or_default());
    }
    let marks = Marks { registration: registration(&table)?, jitter_px, recovery: Vec::new() };
    Ok(Some(Reference { marks, picture }))
}
