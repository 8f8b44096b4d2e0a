//! Points of a printed board in a picture, by OpenCV's detectors.

use opencv::aruco;
use opencv::calib3d;
use opencv::core::{Mat, Point2f, Ptr, Size, TermCriteria, TermCriteria_COUNT, TermCriteria_EPS, ToInputArray, Vector};
use opencv::features2d::{Feature2D, SimpleBlobDetector};
use opencv::imgproc;
use panoscope_data::calibration::Board;

/// Points found: index on the board, place in px.
pub type Points = Vec<(usize, [f32; 2])>;

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

    /// The points in a gray picture; none where there is no board. All of a chessboard or grid, what is seen of a ChArUco
    /// board.
    pub fn find(&self, gray: &impl ToInputArray) -> opencv::Result<Points> {
        let mut places = Vector::<Point2f>::new();
        let whole = |places: &Vector<Point2f>| places.iter().map(|p| [p.x, p.y]).enumerate().collect();
        match &self.0 {
            Kind::Chessboard { corners, is_sample } => {
                match find_chessboard(gray, *corners, *is_sample, &mut places)? {
                    Corners::None => return Ok(Points::new()),
                    // A fitted template is finer than a search around each corner, above all in blur.
                    Corners::Fine => return Ok(whole(&places)),
                    Corners::Coarse => {}
                }
                let half = if *is_sample { SAMPLE_WINDOW_PX } else { window(&places, corners.width as usize) };
                let end = TermCriteria::new(TermCriteria_COUNT | TermCriteria_EPS, 40, 0.001)?;
                let sample_end = TermCriteria::new(TermCriteria_COUNT | TermCriteria_EPS, 30, 0.01)?;
                let (side, none) = (Size::new(half, half), Size::new(-1, -1));
                imgproc::corner_sub_pix(gray, &mut places, side, none, if *is_sample { sample_end } else { end })?;
                Ok(whole(&places))
            }
            Kind::Circles { circles, flags, blobs } => {
                let found = calib3d::find_circles_grid(gray, *circles, &mut places, *flags, Some(blobs))?
                    || calib3d::find_circles_grid(
                        gray,
                        *circles,
                        &mut places,
                        *flags | calib3d::CALIB_CB_CLUSTERING,
                        Some(blobs),
                    )?;
                Ok(if found { whole(&places) } else { Points::new() })
            }
            Kind::Charuco { board, dictionary } => {
                let (mut corners, mut ids) = (Vector::<Vector<Point2f>>::new(), Vector::<i32>::new());
                aruco::detect_markers_def(gray, dictionary, &mut corners, &mut ids)?;
                if ids.is_empty() {
                    return Ok(Points::new());
                }
                let mut found = Vector::<i32>::new();
                aruco::interpolate_corners_charuco_def(&corners, &ids, gray, board, &mut places, &mut found)?;
                Ok(found.iter().zip(places.iter()).map(|(id, p)| (id as usize, [p.x, p.y])).collect())
            }
        }
    }
}

/// How well the corners of a chessboard are located.
enum Corners {
    None,
    /// To about a pixel.
    Coarse,
    /// To a part of a pixel.
    Fine,
}

/// Finds all inner corners of a chessboard: by the detector of OpenCV's sample, and where that fails by the one for blurred, noisy and badly lit
/// boards (Duda and Frese, "Accurate detection and localization of checkerboard corners for calibration", 2018), which takes longer; last, as
/// the sample does, in twice the size. `is_sample` leaves out what the sample does not have.
fn find_chessboard(
    gray: &impl ToInputArray,
    corners: Size,
    is_sample: bool,
    places: &mut Vector<Point2f>,
) -> opencv::Result<Corners> {
    let flags = calib3d::CALIB_CB_ADAPTIVE_THRESH | calib3d::CALIB_CB_NORMALIZE_IMAGE;
    let hard = calib3d::CALIB_CB_NORMALIZE_IMAGE | calib3d::CALIB_CB_EXHAUSTIVE | calib3d::CALIB_CB_ACCURACY;
    if calib3d::find_chessboard_corners(gray, corners, places, flags)? {
        return Ok(Corners::Coarse);
    }
    if !is_sample && calib3d::find_chessboard_corners_sb(gray, corners, places, hard)? {
        return Ok(Corners::Fine);
    }
    let mut large = Mat::default();
    imgproc::resize(gray, &mut large, Size::default(), 2.0, 2.0, imgproc::INTER_LINEAR_EXACT)?;
    if !calib3d::find_chessboard_corners(&large, corners, places, flags)? {
        return Ok(Corners::None);
    }
    *places = places.iter().map(|p| Point2f::new(p.x / 2.0, p.y / 2.0)).collect();
    Ok(Corners::Coarse)
}

/// Half the window of the sub-pixel search: within the squares around a corner, so that no other corner pulls.
fn window(places: &Vector<Point2f>, columns: usize) -> i32 {
    let points: Vec<Point2f> = places.iter().collect();
    let gap = |a: &Point2f, b: &Point2f| (a.x - b.x).hypot(a.y - b.y);
    let along = points.chunks_exact(columns).flat_map(|row| row.windows(2).map(|pair| gap(&pair[0], &pair[1])));
    let across = points.iter().zip(points.iter().skip(columns)).map(|(a, b)| gap(a, b));
    let least = along.chain(across).fold(f32::MAX, f32::min);
    ((least * 0.45) as i32).clamp(2, SAMPLE_WINDOW_PX)
}

/// Turns the right view's points around where its board was read from the other end: boards with two symmetric ends are
/// found either way round, and the order must be the same in both views.
pub fn same_order(board: &Board, left: &Points, right: &mut Points) {
    if matches!(board, Board::Charuco { .. }) || left.len() != right.len() || left.len() < 2 {
        return;
    }
    let direction = |points: &Points| {
        let (a, b) = (points[0].1, points[points.len() - 1].1);
        [b[0] - a[0], b[1] - a[1]]
    };
    let (a, b) = (direction(left), direction(right));
    if a[0] * b[0] + a[1] * b[1] < 0.0 {
        let places: Vec<[f32; 2]> = right.iter().rev().map(|(_, place)| *place).collect();
        right.iter_mut().zip(places).for_each(|(point, place)| point.1 = place);
    }
}
