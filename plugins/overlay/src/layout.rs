//! Where the pictures of a screen stand: the main one as large as possible, the others in a column beside it and a row below it.

/// A place on the screen, px.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cell {
    /// Left edge.
    pub x: usize,
    /// Upper edge.
    pub y: usize,
    /// Width.
    pub width: usize,
    /// Height.
    pub height: usize,
}

impl Cell {
    fn area(&self) -> f64 {
        self.width as f64 * self.height as f64
    }
}

/// A screen to be filled, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Width.
    pub width: usize,
    /// Height.
    pub height: usize,
    /// Margin around pictures.
    pub gap: usize,
    /// Height of the strip above each picture, for its title.
    pub caption: usize,
    /// Width of the column as a share of the screen's; 0 finds the best arrangement.
    pub side_share: f32,
}

/// How much more an area of the main picture counts than one of the others.
const IMPORTANCE: f64 = 2.0;
/// The least width of a smaller picture as a share of the screen's.
const LEAST_SHARE: f64 = 0.24;
/// Widths of the main picture that are tried.
const STEPS: usize = 64;

/// Width by height of a picture.
pub type Size = (usize, usize);

fn aspect(size: Size) -> f64 {
    size.0.max(1) as f64 / size.1.max(1) as f64
}

/// The cells of the main picture and of the smaller ones, each with its picture's proportions below a strip for its title, inside the frame and
/// apart from each other.
/// Earlier pictures come first: down the column, then along the row.
pub fn arrange(frame: &Frame, main: Size, sides: &[Size], cells: &mut Vec<Cell>) {
    let mut best = (f64::NEG_INFINITY, Plan { main_px: 0.0, in_column: sides.len() });
    let room = frame.room();
    for in_column in 0..=sides.len() {
        // A given share is that of a column with everything.
        if frame.side_share > 0.0 && in_column != sides.len() {
            continue;
        }
        for step in 0..=STEPS {
            let main_px = if frame.side_share > 0.0 {
                let column = frame.width as f64 * f64::from(frame.side_share);
                room.0 - if sides.is_empty() { 0.0 } else { column + frame.gap as f64 }
            } else {
                room.0 * (0.4 + 0.6 * step as f64 / STEPS as f64)
            };
            let plan = Plan { main_px, in_column };
            plan.place(frame, main, sides, cells);
            let score = score(frame, cells);
            if score > best.0 {
                best = (score, plan);
            }
        }
    }
    best.1.place(frame, main, sides, cells);
}

/// What an arrangement is worth: the areas of its pictures. Pictures that are too small make it worth less.
fn score(frame: &Frame, cells: &[Cell]) -> f64 {
    let Some((main, sides)) = cells.split_first() else { return 0.0 };
    // Many pictures cannot all be wide.
    let least = LEAST_SHARE.min(0.72 / sides.len().max(1) as f64) * frame.width as f64;
    let small = sides.iter().map(|cell| (least - cell.width as f64).max(0.0)).sum::<f64>();
    IMPORTANCE * main.area() + sides.iter().map(Cell::area).sum::<f64>() - 4.0 * small * frame.width as f64
}

impl Frame {
    /// Width and height inside the margins.
    fn room(&self) -> (f64, f64) {
        let inside = |length: usize| length.saturating_sub(2 * self.gap) as f64;
        (inside(self.width), inside(self.height))
    }
}

/// An arrangement.
#[derive(Clone, Copy)]
struct Plan {
    /// Width for the main picture and the row below it.
    main_px: f64,
    /// Number of pictures in the column; the others stand in the row.
    in_column: usize,
}

impl Plan {
    fn place(&self, frame: &Frame, main: Size, sides: &[Size], cells: &mut Vec<Cell>) {
        cells.clear();
        let (gap, caption) = (frame.gap as f64, frame.caption as f64);
        let (width, height) = frame.room();
        let (column, row) = sides.split_at(self.in_column);
        let column_px = if column.is_empty() { 0.0 } else { (width - self.main_px - gap).max(0.0) };
        let left_px = if column.is_empty() { width } else { self.main_px };
        // The row is as high as its pictures need to fill the width, and the main picture leaves it room.
        let aspects: f64 = row.iter().map(|size| aspect(*size)).sum();
        let wide = left_px.min(self.main_px);
        let main_height = (wide / aspect(main) + caption).min(height);
        let (main_height, row_height) = if row.is_empty() {
            (main_height, 0.0)
        } else {
            let full = ((left_px - gap * (row.len() - 1) as f64) / aspects + caption).max(0.0);
            (main_height, full.min((height - main_height - gap).max(0.0)))
        };
        let main_width = (main_height - caption).max(0.0) * aspect(main);
        // What is left over lies around the pictures evenly.
        let used = main_height + if row.is_empty() { 0.0 } else { row_height + gap };
        let top = gap + (height - used).max(0.0) / 2.0;
        cells.push(frame.cell(gap + (left_px - main_width).max(0.0) / 2.0, top, main_width, main_height));
        let upright: f64 = column.iter().map(|size| 1.0 / aspect(*size)).sum();
        let strips = caption * column.len() as f64;
        let room = (height - gap * column.len().saturating_sub(1) as f64 - strips).max(0.0);
        let column_width = if column.is_empty() { 0.0 } else { column_px.min(room / upright) };
        let spare = (room - column_width * upright).max(0.0) / column.len().max(1) as f64;
        let mut y = gap + spare / 2.0;
        for size in column {
            let tall = column_width / aspect(*size) + caption;
            cells.push(frame.cell(gap + left_px + gap + (column_px - column_width) / 2.0, y, column_width, tall));
            y += tall + gap + spare;
        }
        let row_picture = (row_height - caption).max(0.0);
        let row_width = row_picture * aspects + gap * row.len().saturating_sub(1) as f64;
        let mut x = gap + (left_px - row_width).max(0.0) / 2.0;
        for size in row {
            let long = row_picture * aspect(*size);
            cells.push(frame.cell(x, top + main_height + gap, long, row_height));
            x += long + gap;
        }
    }
}

impl Frame {
    /// A cell in whole px; what leaves the screen is cut.
    fn cell(&self, x: f64, y: f64, width: f64, height: f64) -> Cell {
        // A hair more: quotients of whole numbers lose nothing by rounding.
        let px = |v: f64| (v + 0.01) as usize;
        let (x, y) = (px(x).min(self.width), px(y).min(self.height));
        Cell { x, y, width: px(width).min(self.width - x), height: px(height).min(self.height - y) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL: Frame = Frame { width: 1280, height: 720, gap: 8, caption: 0, side_share: 0.0 };

    fn arranged(frame: &Frame, main: Size, sides: &[Size]) -> Vec<Cell> {
        let mut cells = Vec::new();
        arrange(frame, main, sides, &mut cells);
        assert_eq!(cells.len(), 1 + sides.len());
        for (k, a) in cells.iter().enumerate() {
            assert!(a.x + a.width <= frame.width && a.y + a.height <= frame.height, "{a:?} leaves the screen");
            for b in &cells[..k] {
                let apart =
                    a.x >= b.x + b.width || b.x >= a.x + a.width || a.y >= b.y + b.height || b.y >= a.y + a.height;
                assert!(apart, "{a:?} and {b:?} overlap");
            }
        }
        cells
    }

    fn used(frame: &Frame, cells: &[Cell]) -> f64 {
        cells.iter().map(Cell::area).sum::<f64>() / (frame.width * frame.height) as f64
    }

    #[test]
    fn a_screen_is_filled_and_the_main_picture_is_the_largest() {
        for main in [(640, 480), (870, 500), (960, 480), (1100, 420), (1920, 1080)] {
            for count in 0..=5 {
                let cells = arranged(&FULL, main, &vec![(640, 480); count]);
                let share = used(&FULL, &cells);
                assert!(share > if count < 3 { 0.5 } else { 0.6 }, "{main:?} with {count}: {share:.2}");
                assert!(
                    cells[1..].iter().all(|side| side.area() < cells[0].area()),
                    "{main:?} with {count}: {cells:?}"
                );
                assert!(cells[1..].iter().all(|side| side.width >= 170), "{main:?} with {count}: {cells:?}");
            }
        }
        // The surgeon's screen.
        let share = used(&FULL, &arranged(&FULL, (870, 500), &[(640, 480), (480, 360), (640, 480)]));
        assert!(share > 0.75, "{share:.2}");
    }

    #[test]
    fn a_given_share_is_that_of_the_column() {
        let frame = Frame { side_share: 0.28, ..FULL };
        let cells = arranged(&frame, (640, 480), &[(640, 480); 2]);
        assert!(cells[1..].iter().all(|side| side.width.abs_diff(358) <= 1), "{cells:?}");
    }

    #[test]
    fn pictures_keep_their_proportions_below_their_titles() {
        let frame = Frame { caption: 20, ..FULL };
        for count in 0..=5 {
            let sizes = vec![(640, 480); count];
            let cells = arranged(&frame, (870, 553), &sizes);
            for (cell, size) in cells.iter().zip(std::iter::once(&(870, 553)).chain(&sizes)) {
                let high = (cell.height - frame.caption) as f64;
                assert!((high * aspect(*size) - cell.width as f64).abs() < 4.0, "{count}: {cell:?} of {size:?}");
            }
            assert!(used(&frame, &cells) > 0.5, "{count}");
        }
    }

    #[test]
    fn screens_that_are_too_small_overlap_nothing() {
        for (width, height) in [(64, 64), (64, 400), (400, 64)] {
            let frame = Frame { width, height, gap: 8, caption: 20, side_share: 0.0 };
            arranged(&frame, (640, 480), &[(640, 480); 4]);
            arranged(&Frame { gap: 64, side_share: 0.5, ..frame }, (640, 480), &[(640, 480); 4]);
        }
    }
}
