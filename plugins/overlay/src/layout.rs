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
    /// Width of the column as a share of the screen's; 0 finds the best arrangement.
    pub side_share: f32,
}

/// How much more an area of the main picture counts than one of the others.
const IMPORTANCE: f64 = 4.0;
/// The least width of a smaller picture as a share of the screen's; the second where the first leaves the main picture too little.
const MIN_SHARES: [f64; 2] = [0.2, 0.16];
/// The least area of the main picture as a share of the screen's.
const MAIN_SHARE: f64 = 0.62;
/// How much a missing pixel of a smaller picture's width counts, in screens' widths.
const SMALLNESS: f64 = 12.0;
/// Widths of the main picture that are tried.
const STEPS: usize = 96;

/// Width by height of a picture.
pub type Size = (usize, usize);

/// What stands in a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Proportions of the picture.
    pub size: Size,
    /// Height of the strip below it for its title, px; 0 without one.
    pub caption: usize,
}

impl Tile {
    fn aspect(&self) -> f64 {
        aspect(self.size)
    }

    fn strip(&self) -> f64 {
        self.caption as f64
    }
}

fn aspect(size: Size) -> f64 {
    size.0.max(1) as f64 / size.1.max(1) as f64
}

/// The cells of the main picture and of the smaller ones, each with its picture's proportions above a strip for its title, inside the frame and
/// apart from each other.
/// Earlier pictures come first: down the column, then along the row.
pub fn arrange(frame: &Frame, main: Tile, sides: &[Tile], cells: &mut Vec<Cell>) {
    let whole = (frame.width * frame.height) as f64;
    for least_share in MIN_SHARES {
        best_plan(frame, main, sides, least_share, cells).place(frame, main, sides, cells);
        if cells[0].area() >= MAIN_SHARE * whole {
            return;
        }
    }
}

fn best_plan(frame: &Frame, main: Tile, sides: &[Tile], least_share: f64, cells: &mut Vec<Cell>) -> Plan {
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
            let score = score(frame, least_share, cells);
            if score > best.0 {
                best = (score, plan);
            }
        }
    }
    best.1
}

/// What an arrangement is worth: the areas of its pictures. Pictures that are too small make it worth less.
fn score(frame: &Frame, least_share: f64, cells: &[Cell]) -> f64 {
    let Some((main, sides)) = cells.split_first() else { return 0.0 };
    // Many pictures cannot all be wide.
    let least = least_share.min(0.72 / sides.len().max(1) as f64) * frame.width as f64;
    let small = sides.iter().map(|cell| (least - cell.width as f64).max(0.0)).sum::<f64>();
    IMPORTANCE * main.area() + sides.iter().map(Cell::area).sum::<f64>() - SMALLNESS * small * frame.width as f64
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
    fn place(&self, frame: &Frame, main: Tile, sides: &[Tile], cells: &mut Vec<Cell>) {
        cells.clear();
        let gap = frame.gap as f64;
        let (width, height) = frame.room();
        let (column, row) = sides.split_at(self.in_column);
        let column_px = if column.is_empty() { 0.0 } else { (width - self.main_px - gap).max(0.0) };
        let left_px = if column.is_empty() { width } else { self.main_px };
        // The row is as high as its pictures need to fill the width, and the main picture leaves it room.
        let aspects: f64 = row.iter().map(Tile::aspect).sum();
        let row_strip = row.iter().map(Tile::strip).fold(0.0, f64::max);
        let wide = left_px.min(self.main_px);
        let main_height = (wide / main.aspect() + main.strip()).min(height);
        let row_height = if row.is_empty() {
            0.0
        } else {
            let full = ((left_px - gap * (row.len() - 1) as f64) / aspects + row_strip).max(0.0);
            full.min((height - main_height - gap).max(0.0))
        };
        let main_width = (main_height - main.strip()).max(0.0) * main.aspect();
        let upright: f64 = column.iter().map(|tile| 1.0 / tile.aspect()).sum();
        let strips: f64 = column.iter().map(Tile::strip).sum();
        let room = (height - gap * column.len().saturating_sub(1) as f64 - strips).max(0.0);
        let column_width = if column.is_empty() { 0.0 } else { column_px.min(room / upright) };
        let row_picture = (row_height - row_strip).max(0.0);
        let row_width = row_picture * aspects + gap * row.len().saturating_sub(1) as f64;
        // Pictures stand together in the middle of the screen; what is left over lies around all of them.
        let block = main_width.max(row_width) + if column.is_empty() { 0.0 } else { gap + column_width };
        let left = gap + (width - block).max(0.0) / 2.0;
        let left_px = block - if column.is_empty() { 0.0 } else { gap + column_width };
        let used = main_height + if row.is_empty() { 0.0 } else { row_height + gap };
        let top = gap + (height - used).max(0.0) / 2.0;
        cells.push(frame.cell(left + (left_px - main_width).max(0.0) / 2.0, top, main_width, main_height));
        let tall = |tile: &Tile| column_width / tile.aspect() + tile.strip();
        let stacked: f64 = column.iter().map(tall).sum();
        // The column begins and ends with what stands beside it, where it can.
        let span = used.max(stacked + gap * column.len().saturating_sub(1) as f64).min(height);
        let between = match column.len() {
            0 | 1 => gap,
            more => (span - stacked) / (more - 1) as f64,
        };
        let mut y = match column.len() {
            1 => gap + (height - stacked) / 2.0,
            _ => gap + (height - span) / 2.0,
        };
        for tile in column {
            cells.push(frame.cell(left + left_px + gap, y, column_width, tall(tile)));
            y += tall(tile) + between;
        }
        let mut x = left + (left_px - row_width).max(0.0) / 2.0;
        for tile in row {
            let long = row_picture * tile.aspect();
            cells.push(frame.cell(x, top + main_height + gap, long, row_picture + tile.strip()));
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

    const HD: Frame = Frame { width: 1280, height: 720, gap: 6, side_share: 0.0 };
    const FULL_HD: Frame = Frame { width: 1920, height: 1080, gap: 9, side_share: 0.0 };

    fn tile(size: Size, caption: usize) -> Tile {
        Tile { size, caption }
    }

    fn arranged(frame: &Frame, main: Tile, sides: &[Tile]) -> Vec<Cell> {
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

    /// Shares of the screen: of the main cell, and of all.
    fn shares(frame: &Frame, cells: &[Cell]) -> (f64, f64) {
        let whole = (frame.width * frame.height) as f64;
        (cells[0].area() / whole, cells.iter().map(Cell::area).sum::<f64>() / whole)
    }

    /// The surgeon's screen for views of a size: panorama and instruments with a bar of words, surface and depth with titles.
    fn surgeon(frame: &Frame, (width, height): Size, wider: f64) -> Vec<Cell> {
        let caption = frame.height / 30;
        let main = tile(((width as f64 * wider) as usize, height + height / 16), 0);
        let sides = [
            tile((width, height + height / 12), 0),
            tile((480, 300), caption),
            tile((width + height / 3, height), caption),
        ];
        arranged(frame, main, &sides)
    }

    #[test]
    fn the_main_picture_has_three_fifths_of_the_screen() {
        for frame in [HD, FULL_HD] {
            for (size, wider, least_used) in [
                ((640, 480), 1.06, 0.92),
                ((640, 480), 1.3, 0.8),
                ((720, 576), 1.1, 0.92),
                ((1920, 1080), 1.15, 0.72),
                ((1920, 1080), 1.0, 0.7),
                ((500, 500), 1.25, 0.8),
            ] {
                let cells = surgeon(&frame, size, wider);
                let (main, used) = shares(&frame, &cells);
                assert!(main >= 0.6 && used >= least_used, "{size:?} x {wider}: {main:.3} {used:.3} {cells:?}");
            }
        }
        // A square one is as high as the screen.
        let cells = surgeon(&HD, (500, 500), 1.0);
        assert!(cells[0].height >= HD.height - 2 * HD.gap - 1, "{cells:?}");
        // Alone, it takes what its proportions let it.
        let alone = arranged(&HD, tile((640, 480), 24), &[]);
        assert!(shares(&HD, &alone).0 > 0.7, "{alone:?}");
    }

    #[test]
    fn the_main_picture_is_the_largest_and_the_others_are_not_tiny() {
        for main in [(640, 480), (870, 500), (960, 480), (1100, 420), (1920, 1080)] {
            for count in 0..=5 {
                let cells = arranged(&HD, tile(main, 0), &vec![tile((640, 480), 0); count]);
                let (_, used) = shares(&HD, &cells);
                assert!(used > 0.6, "{main:?} with {count}: {used:.2}");
                assert!(
                    cells[1..].iter().all(|side| side.area() < cells[0].area()),
                    "{main:?} with {count}: {cells:?}"
                );
                assert!(cells[1..].iter().all(|side| side.width >= 150), "{main:?} with {count}: {cells:?}");
            }
        }
    }

    #[test]
    fn a_given_share_is_that_of_the_column() {
        let frame = Frame { side_share: 0.28, ..HD };
        let cells = arranged(&frame, tile((640, 480), 0), &[tile((640, 480), 0); 2]);
        assert!(cells[1..].iter().all(|side| side.width.abs_diff(358) <= 1), "{cells:?}");
    }

    #[test]
    fn pictures_keep_their_proportions_above_their_titles() {
        for count in 0..=5 {
            // Every other picture has a title.
            let sides: Vec<Tile> = (0..count).map(|k| tile((640, 480), 20 * (k % 2))).collect();
            let main = tile((870, 553), 20);
            let cells = arranged(&HD, main, &sides);
            for (cell, tile) in cells.iter().zip(std::iter::once(&main).chain(&sides)) {
                let high = (cell.height - tile.caption) as f64;
                assert!((high * tile.aspect() - cell.width as f64).abs() < 4.0, "{count}: {cell:?} of {tile:?}");
            }
        }
    }

    #[test]
    fn screens_that_are_too_small_overlap_nothing() {
        for (width, height) in [(64, 64), (64, 400), (400, 64)] {
            let frame = Frame { width, height, gap: 8, side_share: 0.0 };
            let sides = [tile((640, 480), 20); 4];
            arranged(&frame, tile((640, 480), 20), &sides);
            arranged(&Frame { gap: 64, side_share: 0.5, ..frame }, tile((640, 480), 20), &sides);
        }
    }
}
