//! Printed patterns by name: `chessboard:9x6:25mm`, `circles:4x11:20mm`, `circle_grid:7x6:10mm`,
//! `charuco:19x26:5mm:4mm:4x4_250`.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

/// A pattern with known points. Counts are columns x rows, lengths mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Board {
    /// Inner corners of a chessboard.
    Chessboard {
        /// Inner corners, columns x rows.
        corners: (u32, u32),
        /// Side of a square.
        square_mm: f64,
    },
    /// OpenCV's asymmetric grid: every other row is shifted by one spacing; columns lie two spacings apart.
    Circles {
        /// Circles, columns x rows.
        circles: (u32, u32),
        /// Half the distance of neighbours of one row, the distance of neighbouring rows.
        spacing_mm: f64,
    },
    /// A grid of circles in rows and columns.
    CircleGrid {
        /// Circles, columns x rows.
        circles: (u32, u32),
        /// Distance of neighbours.
        spacing_mm: f64,
    },
    /// A chessboard with ArUco markers in its white squares; parts of it are enough.
    Charuco {
        /// Squares, columns x rows.
        squares: (u32, u32),
        /// Side of a square.
        square_mm: f64,
        /// Side of a marker.
        marker_mm: f64,
        /// Cells of a marker's side and number of markers of OpenCV's predefined dictionary, as in `DICT_4X4_250`.
        dictionary: (u32, u32),
    },
}

/// Why a text is not the name of a board.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "`{text}` names no board: {reason}. Known are chessboard:9x6:25mm (inner corners), circles:4x11:20mm (asymmetric), circle_grid:7x6:10mm and charuco:19x26:5mm:4mm:4x4_250 (squares, square, marker, dictionary)"
)]
pub struct BoardError {
    /// What was given.
    pub text: String,
    /// What is wrong with it.
    pub reason: String,
}

/// Sizes of OpenCV's predefined dictionaries.
const DICTIONARY_SIZES: [u32; 4] = [50, 100, 250, 1000];

impl FromStr for Board {
    type Err = BoardError;

    fn from_str(text: &str) -> Result<Self, BoardError> {
        let wrong = |reason: String| BoardError { text: text.to_owned(), reason };
        let parts: Vec<&str> = text.trim().split(':').map(str::trim).collect();
        let count = |part: &str, least: u32| -> Result<(u32, u32), BoardError> {
            let pair = part.split_once('x').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
            match pair {
                Some((a, b)) if (least..=100).contains(&a) && (least..=100).contains(&b) => Ok((a, b)),
                _ => Err(wrong(format!("`{part}` is not columns x rows, each from {least} to 100"))),
            }
        };
        let length = |part: &str| -> Result<f64, BoardError> {
            match part.strip_suffix("mm").unwrap_or(part).trim().parse::<f64>() {
                Ok(mm) if mm > 0.0 && mm <= 10_000.0 => Ok(mm),
                _ => Err(wrong(format!("`{part}` is no length in mm"))),
            }
        };
        match parts[..] {
            ["chessboard", corners, square] => {
                Ok(Self::Chessboard { corners: count(corners, 3)?, square_mm: length(square)? })
            }
            ["circles", circles, spacing] => {
                Ok(Self::Circles { circles: count(circles, 2)?, spacing_mm: length(spacing)? })
            }
            ["circle_grid", circles, spacing] => {
                Ok(Self::CircleGrid { circles: count(circles, 2)?, spacing_mm: length(spacing)? })
            }
            ["charuco", squares, square, marker, dictionary] => {
                let (square_mm, marker_mm) = (length(square)?, length(marker)?);
                if marker_mm >= square_mm {
                    return Err(wrong(format!("markers of {marker_mm} mm do not fit into squares of {square_mm} mm")));
                }
                let cells = dictionary.split_once('_').and_then(|(cells, size)| {
                    let (a, b) = cells.split_once('x')?;
                    (a == b).then_some((a.parse::<u32>().ok()?, size.parse::<u32>().ok()?))
                });
                let dictionary = cells
                    .filter(|(side, size)| (4..=7).contains(side) && DICTIONARY_SIZES.contains(size))
                    .ok_or_else(|| wrong(format!("`{dictionary}` is no dictionary such as 4x4_50")))?;
                let squares = count(squares, 3)?;
                if squares.0 * squares.1 / 2 > dictionary.1 {
                    return Err(wrong(format!(
                        "the board has {} markers, the dictionary {}",
                        squares.0 * squares.1 / 2,
                        dictionary.1
                    )));
                }
                Ok(Self::Charuco { squares, square_mm, marker_mm, dictionary })
            }
            [kind @ ("chessboard" | "circles" | "circle_grid" | "charuco"), ..] => {
                Err(wrong(format!("a {kind} has {} parts behind its name", if kind == "charuco" { 4 } else { 2 })))
            }
            _ => Err(wrong("its kind is unknown".into())),
        }
    }
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Chessboard { corners: (x, y), square_mm } => write!(f, "chessboard:{x}x{y}:{square_mm}mm"),
            Self::Circles { circles: (x, y), spacing_mm } => write!(f, "circles:{x}x{y}:{spacing_mm}mm"),
            Self::CircleGrid { circles: (x, y), spacing_mm } => write!(f, "circle_grid:{x}x{y}:{spacing_mm}mm"),
            Self::Charuco { squares: (x, y), square_mm, marker_mm, dictionary: (side, size) } => {
                write!(f, "charuco:{x}x{y}:{square_mm}mm:{marker_mm}mm:{side}x{side}_{size}")
            }
        }
    }
}

impl Board {
    /// Places of all points on the board, mm, in OpenCV's order.
    pub fn points_mm(&self) -> Vec<[f64; 2]> {
        let grid = |(columns, rows): (u32, u32), place: &dyn Fn(f64, f64) -> [f64; 2]| {
            (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))).map(|(x, y)| place(x.into(), y.into())).collect()
        };
        match *self {
            Self::Chessboard { corners, square_mm } => grid(corners, &|x, y| [x * square_mm, y * square_mm]),
            Self::CircleGrid { circles, spacing_mm } => grid(circles, &|x, y| [x * spacing_mm, y * spacing_mm]),
            Self::Circles { circles, spacing_mm } => {
                grid(circles, &|x, y| [(2.0 * x + y % 2.0) * spacing_mm, y * spacing_mm])
            }
            Self::Charuco { squares: (x, y), square_mm, .. } => {
                grid((x - 1, y - 1), &|x, y| [(x + 1.0) * square_mm, (y + 1.0) * square_mm])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Board;

    #[test]
    fn names_lead_back() {
        for name in
            ["chessboard:9x6:25mm", "circles:4x11:20mm", "circle_grid:7x6:10.5mm", "charuco:19x26:5mm:4mm:4x4_250"]
        {
            let board: Board = name.parse().unwrap();
            assert_eq!(board.to_string(), name);
        }
        assert_eq!(
            "chessboard:9x6:25".parse(),
            Ok::<_, super::BoardError>(Board::Chessboard { corners: (9, 6), square_mm: 25.0 })
        );
    }

    #[test]
    fn mistakes_are_named() {
        for (name, words) in [
            ("chess:9x6:25mm", "kind is unknown"),
            ("chessboard:9x6", "2 parts"),
            ("chessboard:9:25mm", "not columns x rows"),
            ("chessboard:9x6:0mm", "no length"),
            ("charuco:5x7:4mm:5mm:4x4_50", "do not fit"),
            ("charuco:5x7:5mm:4mm:4x5_50", "no dictionary"),
            ("charuco:19x26:5mm:4mm:4x4_50", "the dictionary 50"),
        ] {
            let error = name.parse::<Board>().unwrap_err().to_string();
            assert!(error.contains(words), "{name}: {error}");
        }
    }

    #[test]
    fn points_are_where_they_are_printed() {
        let board: Board = "circles:4x11:20mm".parse().unwrap();
        let points = board.points_mm();
        assert_eq!((points.len(), points[1], points[4]), (44, [40.0, 0.0], [20.0, 20.0]));
        let board: Board = "charuco:5x4:3mm:2mm:4x4_50".parse().unwrap();
        assert_eq!((board.points_mm().len(), board.points_mm()[0]), (12, [3.0, 3.0]));
    }
}
