//! Points of a printed board in a picture, by OpenCV's detectors.

use std::collections::BTreeMap;

use opencv::aruco;
use opencv::calib3d;
use opencv::core::{Mat, Point2f, Ptr, Size, TermCriteria, TermCriteria_COUNT, TermCriteria_EPS, ToInputArray, Vector};
use opencv::features2d::{Feature2D, SimpleBlobDetector};
use opencv::imgproc;
use panoscope_data::calibration::Board;
use panoscope_imaging::features::checker;
use panoscope_node::View;

use super::grid::{self, Points};
use super::part::{self, Part};
use crate::mats::borrowed;

/// Half the window of the sub-pixel search in OpenCV's sample, px.
const SAMPLE_WINDOW_PX: i32 = 11;

enum Kind {
    Chessboard { corners: Size, is_sample: bool },
    Circles { circles: Size, flags: i32, blobs: Ptr<Feature2D> },
    Charuco { board: Ptr<aruco::CharucoBoard>, dictionary: Ptr<aruco::Dictionary> },
}

/// Finds one board.
pub struct Detector(Kind);

// SAFETY: OpenCV's objects hold no thread's state; one thread at a time uses a node.
unsafe impl Send for Detector {}

impl Detector {
    /// A detector; `is_sample` keeps to the steps of OpenCV's sample `stereo_calib`.
    pub fn new(board: &Board, is_sample: bool) -> opencv::Result<Self> {
        let size = |(x, y): (u32, u32)| Size::new(x as i32, y as i32);
        let blobs = || -> opencv::Result<Ptr<Feature2D>> { Ok(SimpleBlobDetector::create_def()?.into()) };
        Ok(Self(match *board {
            Board::Chessboard { corners, .. } => Kind::Chessboard { corners: size(corners), is_sample },
            Board::Circles { circles, .. } => {
                Kind::Circles { circles: size(circles), flags: calib3d::CALIB_CB_ASYMMETRIC_GRID, blobs: blobs()? }
            }
            Board::CircleGrid { circles, .. } => {
                Kind::Circles { circles: size(circles), flags: calib3d::CALIB_CB_SYMMETRIC_GRID, blobs: blobs()? }
            }
            Board::Charuco { squares, square_mm, marker_mm, dictionary: (side, markers) } => {
                let place = [50, 100, 250, 1000].iter().position(|size| *size == markers).unwrap_or(0);
                let dictionary = aruco::get_predefined_dictionary_i32((side as i32 - 4) * 4 + place as i32)?;
                let (x, y) = (squares.0 as i32, squares.1 as i32);
                let board = aruco::CharucoBoard::create(x, y, square_mm as f32, marker_mm as f32, &dictionary)?;
                Kind::Charuco { board, dictionary }
            }
        }))
    }

    /// The points in a gray picture; none where there is no board. Of a chessboard all that are not covered, as long as its extent is seen; what is
    /// seen of a ChArUco board; all of a grid of circles.
    pub fn find(&self, view: View<'_, u8>) -> opencv::Result<Points> {
        Ok(self.look(view)?.points)
    }

    /// As [`Self::find`], and what is seen of a chessboard whose extent is not.
    pub fn look(&self, view: View<'_, u8>) -> opencv::Result<Seen> {
        let gray = &borrowed(view)?;
        let points = match &self.0 {
            Kind::Chessboard { corners, is_sample: true } => as_in_sample(gray, *corners)?,
            Kind::Chessboard { corners, .. } => return chessboard(view, *corners),
            Kind::Circles { circles, flags, blobs } => {
                let mut places = Vector::<Point2f>::new();
                let mut find = |flags| calib3d::find_circles_grid(gray, *circles, &mut places, flags, Some(blobs));
                let is_found = find(*flags)? || find(*flags | calib3d::CALIB_CB_CLUSTERING)?;
                if is_found { numbered(&places) } else { Points::new() }
            }
            Kind::Charuco { board, dictionary } => {
                let (mut corners, mut ids) = (Vector::<Vector<Point2f>>::new(), Vector::<i32>::new());
                aruco::detect_markers_def(gray, dictionary, &mut corners, &mut ids)?;
                let (mut places, mut found) = (Vector::<Point2f>::new(), Vector::<i32>::new());
                if !ids.is_empty() {
                    aruco::interpolate_corners_charuco_def(&corners, &ids, gray, board, &mut places, &mut found)?;
                }
                found.iter().zip(places.iter()).map(|(id, p)| (id as usize, [p.x, p.y])).collect()
            }
        };
        Ok(Seen { points, part: None })
    }
}

/// What is seen of a board.
#[derive(Default)]
pub struct Seen {
    /// Points whose place on the board is known.
    pub points: Points,
    /// Without them, corners of a chessboard of which it is not known which they are, to a part of a pixel.
    pub part: Option<Part>,
}

fn numbered(places: &Vector<Point2f>) -> Points {
    places.iter().map(|p| [p.x, p.y]).enumerate().collect()
}

/// Corners of a chessboard by the steps of OpenCV's sample.
fn as_in_sample(gray: &impl ToInputArray, corners: Size) -> opencv::Result<Points> {
    let mut places = Vector::<Point2f>::new();
    if !find_whole(gray, corners, &mut places)? && !find_enlarged(gray, corners, &mut places)? {
        return Ok(Points::new());
    }
    let end = TermCriteria::new(TermCriteria_COUNT | TermCriteria_EPS, 30, 0.01)?;
    let (side, none) = (Size::new(SAMPLE_WINDOW_PX, SAMPLE_WINDOW_PX), Size::new(-1, -1));
    imgproc::corner_sub_pix(gray, &mut places, side, none, end)?;
    Ok(numbered(&places))
}

/// Corners of a chessboard: whole, covered in places, or in part.
fn chessboard(view: View<'_, u8>, corners: Size) -> opencv::Result<Seen> {
    let gray = &borrowed(view)?;
    let columns = corners.width as usize;
    let placed = |points: Points| Ok(Seen { points: refined(gray, points, columns)?, part: None });
    let mut places = Vector::<Point2f>::new();
    if find_whole(gray, corners, &mut places)? {
        return placed(numbered(&places));
    }
    // A fitted template is finer than a search around each corner, above all in blur.
    if find_hard(gray, corners, &mut places)? {
        return Ok(Seen { points: numbered(&places), part: None });
    }
    // OpenCV's detectors find boards with all corners only.
    let grid = checker::find(&view);
    if let Some(points) = grid.as_ref().and_then(|grid| grid::on_chessboard(grid, corners)) {
        return placed(points);
    }
    if find_enlarged(gray, corners, &mut places)? {
        return placed(numbered(&places));
    }
    let Some(grid) = grid.filter(|grid| grid::is_part(grid, corners)) else { return Ok(Seen::default()) };
    let stride = grid.size[0];
    let points = grid.corners.iter().map(|([x, y], at)| (*y as usize * stride + *x as usize, at.map(|v| v as f32)));
    let part = part::of_points(&refined(gray, points.collect(), stride)?, stride);
    Ok(Seen { points: Points::new(), part: Some(part) })
}

/// All inner corners of a chessboard, to about a pixel, as OpenCV's sample finds them.
fn find_whole(gray: &impl ToInputArray, corners: Size, places: &mut Vector<Point2f>) -> opencv::Result<bool> {
    let flags = calib3d::CALIB_CB_ADAPTIVE_THRESH | calib3d::CALIB_CB_NORMALIZE_IMAGE;
    calib3d::find_chessboard_corners(gray, corners, places, flags)
}

/// All inner corners of a blurred, noisy or badly lit chessboard, to a part of a pixel (Duda and Frese, "Accurate detection and localization of
/// checkerboard corners for calibration", 2018). Takes longer.
fn find_hard(gray: &impl ToInputArray, corners: Size, places: &mut Vector<Point2f>) -> opencv::Result<bool> {
    let flags = calib3d::CALIB_CB_NORMALIZE_IMAGE | calib3d::CALIB_CB_EXHAUSTIVE | calib3d::CALIB_CB_ACCURACY;
    calib3d::find_chessboard_corners_sb(gray, corners, places, flags)
}

/// As [`find_whole`] in twice the size, as the sample does last.
fn find_enlarged(gray: &impl ToInputArray, corners: Size, places: &mut Vector<Point2f>) -> opencv::Result<bool> {
    let mut large = Mat::default();
    imgproc::resize(gray, &mut large, Size::default(), 2.0, 2.0, imgproc::INTER_LINEAR_EXACT)?;
    let is_found = find_whole(&large, corners, places)?;
    *places = places.iter().map(|p| Point2f::new(p.x / 2.0, p.y / 2.0)).collect();
    Ok(is_found)
}

/// The points to a part of a pixel.
fn refined(gray: &impl ToInputArray, mut points: Points, columns: usize) -> opencv::Result<Points> {
    if points.is_empty() {
        return Ok(points);
    }
    let mut places: Vector<Point2f> = points.iter().map(|(_, [x, y])| Point2f::new(*x, *y)).collect();
    let half = window(&points, columns);
    let end = TermCriteria::new(TermCriteria_COUNT | TermCriteria_EPS, 40, 0.001)?;
    imgproc::corner_sub_pix(gray, &mut places, Size::new(half, half), Size::new(-1, -1), end)?;
    points.iter_mut().zip(places.iter()).for_each(|(point, place)| point.1 = [place.x, place.y]);
    Ok(points)
}

/// Half the window of the sub-pixel search: within the squares around a corner, so that no other corner pulls.
fn window(points: &Points, columns: usize) -> i32 {
    let places: BTreeMap<usize, [f32; 2]> = points.iter().copied().collect();
    let gap = |index: usize, other: usize| {
        let (a, b) = (places.get(&index)?, places.get(&other)?);
        Some((a[0] - b[0]).hypot(a[1] - b[1]))
    };
    let beside = |index: &usize| {
        let across = (!(index + 1).is_multiple_of(columns)).then(|| gap(*index, index + 1)).flatten();
        [across, gap(*index, index + columns)]
    };
    let least = places.keys().flat_map(beside).flatten().fold(f32::MAX, f32::min);
    ((least * 0.45) as i32).clamp(2, SAMPLE_WINDOW_PX)
}

/// Turns the right view's points around where its board was read from the other end: boards with two symmetric ends are
/// found either way round, and the order must be the same in both views. `count` is that of all points of the board.
pub fn same_order(board: &Board, count: usize, left: &Points, right: &mut Points) {
    if matches!(board, Board::Charuco { .. }) || left.len() < 2 || right.len() < 2 {
        return;
    }
    // The way of the points by their numbers.
    let direction = |points: &Points| {
        let share = 1.0 / points.len() as f32;
        let middle = points.iter().map(|(index, _)| *index as f32 * share).sum::<f32>();
        [0, 1]
            .map(|axis: usize| points.iter().map(|(index, place)| (*index as f32 - middle) * place[axis]).sum::<f32>())
    };
    let (a, b) = (direction(left), direction(right));
    if a[0] * b[0] + a[1] * b[1] < 0.0 {
        right.iter_mut().for_each(|(index, _)| *index = (count - 1).saturating_sub(*index));
        right.reverse();
    }
}
