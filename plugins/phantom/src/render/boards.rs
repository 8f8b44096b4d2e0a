//! Calibration boards printed on a flat card, with exact positions in mm, and the poses in which they are shown.

use super::kinds::BoardPrint;
use super::marks::{BOARD_CENTRE_MM, SQUARE_MM, board_ink, edge};
use super::math::{Pose, Stream, cos_turns, sin_turns};
use super::params::SceneParams;

/// Columns and rows of squares.
const SQUARES: [i32; 2] = [10, 7];
const CIRCLES: [i32; 2] = [4, 11];
const CIRCLE_SPACING_MM: f32 = 3.0;
const CIRCLE_RADIUS_MM: f32 = 1.05;
const MARKER_MM: f32 = 2.25;
/// Cells along a marker's side, including its black border of one cell.
const MARKER_CELLS: i32 = 6;
/// White margin of the card around the print, mm.
const MARGIN_MM: f32 = 2.0;

/// The first markers of OpenCV's dictionary `DICT_4X4_50`: four rows of four bits, the first row in the highest bits; 1 is white.
const MARKERS: [u16; 35] = [
    0xb532, 0x0f9a, 0x332d, 0x9946, 0x549e, 0x79cd, 0x9e2e, 0xc4f2, 0xfeda, 0xcf56, 0xf991, 0x11a7, 0x0eb7, 0x2a0f,
    0x24b1, 0x263e, 0x4665, 0x6600, 0x6c5e, 0x76af, 0x868b, 0xb02b, 0xccd5, 0xdd82, 0xfe47, 0x9471, 0xace4, 0xa554,
    0x2123, 0x346f, 0x4415, 0x57b2, 0x9ecf, 0xf0cb, 0x08ae,
];

/// Black share of the card at `(x, y)`, anti-aliased over `texel_mm`; `None` off the card.
pub fn ink(print: BoardPrint, x: f32, y: f32, texel_mm: f32) -> Option<f32> {
    match print {
        BoardPrint::Chessboard => board_ink(x, y, texel_mm),
        BoardPrint::Circles => circles_ink(x - BOARD_CENTRE_MM[0], y - BOARD_CENTRE_MM[1], texel_mm),
        BoardPrint::Charuco => charuco_ink(x, y, texel_mm),
    }
}

fn circles_ink(x: f32, y: f32, texel_mm: f32) -> Option<f32> {
    let half =
        [(2 * CIRCLES[0] - 1) as f32 * 0.5 * CIRCLE_SPACING_MM, (CIRCLES[1] - 1) as f32 * 0.5 * CIRCLE_SPACING_MM];
    let rim = CIRCLE_RADIUS_MM + MARGIN_MM;
    if x.abs() > half[0] + rim || y.abs() > half[1] + rim {
        return None;
    }
    let row = ((y + half[1]) / CIRCLE_SPACING_MM).round().clamp(0.0, (CIRCLES[1] - 1) as f32);
    let shift = (row as i32 & 1) as f32;
    let column = (((x + half[0]) / CIRCLE_SPACING_MM - shift) * 0.5).round().clamp(0.0, (CIRCLES[0] - 1) as f32);
    let (dx, dy) = (x + half[0] - (2.0 * column + shift) * CIRCLE_SPACING_MM, y + half[1] - row * CIRCLE_SPACING_MM);
    let distance = CIRCLE_RADIUS_MM - (dx * dx + dy * dy).sqrt();
    Some((distance / texel_mm + 0.5).clamp(0.0, 1.0))
}

fn charuco_ink(x: f32, y: f32, texel_mm: f32) -> Option<f32> {
    // Black and white are exchanged: the top left square is black.
    let (u, v) = ((x - BOARD_CENTRE_MM[0]) / SQUARE_MM, (y - BOARD_CENTRE_MM[1]) / SQUARE_MM);
    let inside = edge((5.0 - u.abs()).min(3.5 - v.abs()) * SQUARE_MM, texel_mm);
    let chess = inside - board_ink(x, y, texel_mm)?;
    let (u, v) = (u + 5.0, v + 3.5);
    let (column, row) = (u.floor() as i32, v.floor() as i32);
    if !(0..SQUARES[0]).contains(&column) || !(0..SQUARES[1]).contains(&row) || !holds_marker(column, row) {
        return Some(chess);
    }
    // Markers count along the rows, from the top.
    let number = (0..row * SQUARES[0] + column).filter(|i| holds_marker(i % SQUARES[0], i / SQUARES[0])).count();
    let cell_mm = MARKER_MM / MARKER_CELLS as f32;
    let place = |t: f32| ((t - t.floor()) * SQUARE_MM - 0.5 * (SQUARE_MM - MARKER_MM)) / cell_mm;
    let marker = area_share(number, place(u), place(v), texel_mm / cell_mm);
    Some(chess.max(marker))
}

/// Whether a square contains a marker (the white ones); the top left square is black.
fn holds_marker(column: i32, row: i32) -> bool {
    (column + row) & 1 == 1
}

/// Black share of a texel of `texel` cells at `(u, v)` cells from a marker's corner.
fn area_share(number: usize, u: f32, v: f32, texel: f32) -> f32 {
    let black = |column: i32, row: i32| -> bool {
        if !(0..MARKER_CELLS).contains(&column) || !(0..MARKER_CELLS).contains(&row) {
            return false;
        }
        let (c, r) = (column - 1, row - 1);
        let inside = (0..4).contains(&c) && (0..4).contains(&r);
        !inside || MARKERS[number % MARKERS.len()] >> (15 - (4 * r + c)) & 1 == 0
    };
    let mut share = 0.0;
    let half = 0.5 * texel;
    for row in (v - half).floor() as i32..=(v + half).floor() as i32 {
        for column in (u - half).floor() as i32..=(u + half).floor() as i32 {
            if black(column, row) {
                let overlap =
                    |at: f32, cell: i32| ((at + half).min(cell as f32 + 1.0) - (at - half).max(cell as f32)).max(0.0);
                share += overlap(u, column) * overlap(v, row);
            }
        }
    }
    share / (texel * texel)
}

/// Pose of the board in frame `frame`. Each frame has another pose, tilted by up to 30 degrees, so that all frames together can calibrate. From about
/// 85 mm on the complete board is in both views.
pub fn shown_pose(params: &SceneParams, frame: u64) -> Pose {
    let mut stream = Stream::new(params.seed, 500 + frame as u32);
    let mut range = |low: f32, high: f32| f64::from(stream.range(low, high));
    // Degrees. An even spread of tilts in all directions determines the focal length best.
    let (lean, turns) = (range(12.0, 30.0), range(0.0, 1.0));
    let tilt = [lean * sin_turns(turns), lean * cos_turns(turns), range(-20.0, 20.0)];
    let away = params.distance_mm * range(0.90, 1.15);
    let slack = 0.10 * params.distance_mm;
    let seen = [f64::from(BOARD_CENTRE_MM[0]) + slack * range(-1.0, 1.0), slack * range(-1.0, 1.0), away];
    let half = tilt.map(|degrees| degrees / 720.0);
    let (s, c) = (half.map(sin_turns), half.map(cos_turns));
    let quaternion = [
        c[0] * c[1] * c[2] - s[0] * s[1] * s[2],
        s[0] * c[1] * c[2] + c[0] * s[1] * s[2],
        c[0] * s[1] * c[2] - s[0] * c[1] * s[2],
        c[0] * c[1] * s[2] + s[0] * s[1] * c[2],
    ];
    let turned = Pose { quaternion, translation_mm: [0.0; 3] }.apply(seen);
    let centre = [f64::from(BOARD_CENTRE_MM[0]), f64::from(BOARD_CENTRE_MM[1]), params.distance_mm];
    Pose { quaternion, translation_mm: std::array::from_fn(|i| centre[i] - turned[i]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXEL_MM: f32 = 0.0625;

    /// Whether the card is there with this share of black; positions on an edge are rounded.
    fn is(found: Option<f32>, share: f32) -> bool {
        found.is_some_and(|found| (found - share).abs() < 1e-3)
    }

    #[test]
    fn circles_lie_where_opencv_expects_them() {
        let at = |column: i32, row: i32, dx: f32| {
            let x = BOARD_CENTRE_MM[0] - 10.5 + (2 * column + row % 2) as f32 * CIRCLE_SPACING_MM + dx;
            let y = BOARD_CENTRE_MM[1] - 15.0 + row as f32 * CIRCLE_SPACING_MM;
            ink(BoardPrint::Circles, x, y, TEXEL_MM)
        };
        for (column, row) in [(0, 0), (3, 0), (0, 1), (3, 9), (2, 10)] {
            assert!(is(at(column, row, 0.0), 1.0), "{column} {row}");
            assert!(is(at(column, row, CIRCLE_RADIUS_MM), 0.5), "{column} {row}");
            assert!(is(at(column, row, CIRCLE_SPACING_MM), 0.0), "{column} {row}");
        }
        assert_eq!(ink(BoardPrint::Circles, BOARD_CENTRE_MM[0] + 30.0, BOARD_CENTRE_MM[1], TEXEL_MM), None);
    }

    #[test]
    fn the_first_marker_stands_beside_the_black_corner() {
        let at = |u: f32, v: f32| {
            let x = BOARD_CENTRE_MM[0] + (u - 5.0) * SQUARE_MM;
            let y = BOARD_CENTRE_MM[1] + (v - 3.5) * SQUARE_MM;
            ink(BoardPrint::Charuco, x, y, TEXEL_MM)
        };
        assert!(is(at(0.5, 0.5), 1.0), "{:?}", at(0.5, 0.5));
        // White rim, black rim, then the bits 1011 of the first row.
        assert!(is(at(1.06, 0.5), 0.0) && is(at(1.18, 0.5), 1.0), "{:?} {:?}", at(1.06, 0.5), at(1.18, 0.5));
        let cell = |c: i32, r: i32| at(1.125 + 0.125 * (c as f32 + 1.5), 0.125 + 0.125 * (r as f32 + 1.5));
        for (c, black) in [0.0, 1.0, 0.0, 0.0].into_iter().enumerate() {
            assert!(is(cell(c as i32, 0), black), "{c}: {:?}", cell(c as i32, 0));
        }
        // Half of a texel on an edge is black.
        assert!(is(at(1.125, 0.5), 0.5), "{:?}", at(1.125, 0.5));
    }

    #[test]
    fn each_frame_shows_the_board_in_front_of_the_camera_and_tilted() {
        let params = SceneParams { distance_mm: 85.0, ..SceneParams::default() };
        let mut last = None;
        for frame in 0..50 {
            let pose = shown_pose(&params, frame);
            assert!(last != Some(pose));
            last = Some(pose);
            let r = pose.rotation();
            // The card's normal against the camera's axis.
            assert!((0.8..0.98).contains(&r[2][2]), "{}", r[2][2]);
            let centre = [BOARD_CENTRE_MM[0].into(), BOARD_CENTRE_MM[1].into(), params.distance_mm];
            let q: [f64; 3] = std::array::from_fn(|i| centre[i] - pose.translation_mm[i]);
            let z: f64 = (0..3).map(|i| r[i][2] * q[i]).sum();
            assert!((75.0..100.0).contains(&z), "{z}");
        }
    }
}
