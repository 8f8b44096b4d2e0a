//! Arrangement of the images on a screen: the main one as large as possible, the others in a column next to it and a row below it.

/// A rectangle on the screen, px.
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

/// A screen to fill, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Width.
    pub width: usize,
    /// Height.
    pub height: usize,
    /// Margin around images.
    pub gap: usize,
    /// Width of the column as a share of the screen's; 0 finds the best arrangement.
    pub side_share: f32,
}

/// Minimum width of a smaller image as a share of the screen's; the second value applies to many images.
const MIN_SIDE_SHARE: f64 = 0.16;
const SIDE_SHARES: f64 = 0.72;
/// Minimum area of the main image and maximum uncovered area, as shares of the screen's.
const MAIN_SHARE: f64 = 0.605;
const DEAD_SHARE: f64 = 0.075;
/// Penalties of an arrangement for a smaller image that is narrower, a main image that is smaller, and an uncovered area that is larger than these
/// shares; and the weight of the main image's area relative to the others.
const NARROW: f64 = 40.0;
const SMALL: f64 = 20.0;
const DEAD: f64 = 4.0;
const IMPORTANCE: f64 = 1.5;
/// Penalty for smaller images on both sides of the main one.
const SCATTERED: f64 = 0.05;
/// Number of widths of the main image that are tried.
const STEPS: usize = 96;

/// Width by height of an image.
pub type Size = (usize, usize);

/// Content of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Size that gives the proportions of the image.
    pub size: Size,
    /// Height of the strip below it for its title, px; 0 without a title.
    pub caption: usize,
}

/// An area of the screen, px.
#[derive(Clone, Copy, Debug, Default)]
struct Area {
    x: f64,
    y: f64,
    width: f64,
    height: f64,
}

/// One or more images that fill a rectangle except for the margins between them: its height is `slope` times its width plus `offset`.
#[derive(Clone, Copy, Debug)]
struct Block {
    slope: f64,
    offset: f64,
}

impl Block {
    fn of(tile: &Tile) -> Self {
        let [width, height] = [tile.size.0, tile.size.1].map(|length| length.max(1) as f64);
        Self { slope: height / width, offset: tile.caption as f64 }
    }

    /// Stacks blocks of one width vertically.
    fn stack(blocks: impl Iterator<Item = Self>, gap: f64) -> Self {
        let below = |above: Self, next: Self| Self {
            slope: above.slope + next.slope,
            offset: above.offset + gap + next.offset,
        };
        blocks.fold(Self { slope: 0.0, offset: -gap }, below)
    }

    /// Puts blocks of one height next to each other.
    fn row(blocks: impl Iterator<Item = Self>, gap: f64) -> Self {
        Self::stack(blocks.map(Self::turned), gap).turned()
    }

    /// Exchanges width and height.
    fn turned(self) -> Self {
        Self { slope: 1.0 / self.slope, offset: -self.offset / self.slope }
    }

    fn height(self, width: f64) -> f64 {
        (self.slope * width + self.offset).max(0.0)
    }

    fn width(self, height: f64) -> f64 {
        ((height - self.offset) / self.slope).max(0.0)
    }

    /// Maximum size inside an area.
    fn fit(self, (width, height): (f64, f64)) -> (f64, f64) {
        let width = self.width(height).min(width.max(0.0));
        (width, if width > 0.0 { self.height(width) } else { 0.0 })
    }
}

/// How images share an area: in rows or in columns, the first line with `first` images, each other one with up to `others`.
#[derive(Clone, Copy, Debug)]
struct Lines {
    are_columns: bool,
    first: usize,
    others: usize,
}

impl Lines {
    const STACK: Self = Self { are_columns: false, first: 1, others: 1 };

    /// All divisions of `count` images into lines.
    fn all(count: usize) -> impl Iterator<Item = Self> {
        let counts = (1..=count).flat_map(move |first| (1..=(count - first).max(1)).map(move |others| (first, others)));
        counts.flat_map(|(first, others)| [false, true].map(|are_columns| Self { are_columns, first, others }))
    }

    fn split(self, tiles: &[Tile]) -> impl Iterator<Item = &[Tile]> {
        let (first, others) = tiles.split_at(self.first.min(tiles.len()));
        std::iter::once(first).chain(others.chunks(self.others))
    }

    /// The block of one line.
    fn line(self, tiles: &[Tile], gap: f64) -> Block {
        let blocks = tiles.iter().map(Block::of);
        if self.are_columns { Block::stack(blocks, gap) } else { Block::row(blocks, gap) }
    }

    fn block(self, tiles: &[Tile], gap: f64) -> Block {
        let lines = self.split(tiles).map(|line| self.line(line, gap));
        if self.are_columns { Block::row(lines, gap) } else { Block::stack(lines, gap) }
    }

    /// Areas of the images, whose block fills `area`.
    fn place(self, tiles: &[Tile], area: Area, gap: f64, mut put: impl FnMut(Area)) {
        let (mut x, mut y) = (area.x, area.y);
        for line in self.split(tiles) {
            let block = self.line(line, gap);
            if self.are_columns {
                let width = block.width(area.height);
                let mut top = y;
                for tile in line {
                    let height = Block::of(tile).height(width);
                    put(Area { x, y: top, width, height });
                    top += height + gap;
                }
                x += width + gap;
            } else {
                let height = block.height(area.width);
                let mut left = x;
                for tile in line {
                    let width = Block::of(tile).width(height);
                    put(Area { x: left, y, width, height });
                    left += width + gap;
                }
                y += height + gap;
            }
        }
    }
}

/// Images and their total size.
struct Group<'t> {
    tiles: &'t [Tile],
    lines: Lines,
    width: f64,
    height: f64,
}

impl<'t> Group<'t> {
    fn new(tiles: &'t [Tile], lines: Lines, room: (f64, f64), gap: f64) -> Self {
        let (width, height) = if tiles.is_empty() { (0.0, 0.0) } else { lines.block(tiles, gap).fit(room) };
        Self { tiles, lines, width, height }
    }

    /// The lines in which the images cover most of an area.
    fn best(frame: &Frame, tiles: &'t [Tile], room: (f64, f64), min_px: f64) -> Self {
        let gap = frame.gap as f64;
        let groups = Lines::all(tiles.len()).map(|lines| Self::new(tiles, lines, room, gap));
        let worth = |group: &Self| {
            let mut worth = 0.0;
            group.place(gap, (0.0, 0.0), |area| worth += frame.worth(area.width, area.height, min_px));
            worth
        };
        let best = groups.map(|group| (worth(&group), group)).max_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or_else(|| Self::new(tiles, Lines::STACK, room, gap), |(_, group)| group)
    }

    fn place(&self, gap: f64, (x, y): (f64, f64), put: impl FnMut(Area)) {
        if self.width > 0.0 {
            self.lines.place(self.tiles, Area { x, y, width: self.width, height: self.height }, gap, put);
        } else {
            std::iter::repeat_n(Area { x, y, ..Area::default() }, self.tiles.len()).for_each(put);
        }
    }
}

/// A candidate arrangement.
#[derive(Clone, Copy)]
struct Plan {
    /// Width of the main image, px.
    main_px: f64,
    /// Number of images in the column; the others are in the row.
    in_column: usize,
    /// Whether the column has the height of the screen, next to the main image and the row; otherwise the row has the width of the screen.
    is_column_whole: bool,
}

/// Cells of the main image and of the smaller ones, inside the frame and not overlapping. Each has its image's proportions above a strip for its
/// title. Earlier images come first: in the column, then in the row.
fn arrange(frame: &Frame, main: Tile, sides: &[Tile], cells: &mut Vec<Cell>) {
    let room = frame.room();
    let given = (frame.side_share > 0.0 && !sides.is_empty())
        .then(|| room.0 - (frame.width as f64 * f64::from(frame.side_share)) - frame.gap as f64);
    if let Some(main_px) = given {
        return Plan { main_px, in_column: sides.len(), is_column_whole: true }.place(frame, main, sides, cells);
    }
    let widths = (0..=STEPS).map(|step| room.0 * (0.4 + 0.6 * step as f64 / STEPS as f64));
    let plans = widths.flat_map(|main_px| {
        let counts = (0..=sides.len()).map(move |in_column| (main_px, in_column));
        counts.flat_map(|(main_px, in_column)| {
            [true, false].map(|is_column_whole| Plan { main_px, in_column, is_column_whole })
        })
    });
    let mut best: Option<(f64, Plan)> = None;
    for plan in plans {
        plan.place(frame, main, sides, cells);
        let is_scattered = (1..sides.len()).contains(&plan.in_column);
        let score = frame.score(cells) - if is_scattered { SCATTERED } else { 0.0 };
        if best.is_none_or(|(highest, _)| score > highest) {
            best = Some((score, plan));
        }
    }
    if let Some((_, plan)) = best {
        plan.place(frame, main, sides, cells);
    }
}

/// Proportions of an image that has not arrived.
pub const USUAL: Size = (4, 3);
/// An image whose proportions change by less than this share does not move the others.
const MIN_CHANGE: f64 = 0.03;

/// An arrangement that stays as it is while the screen and the proportions of the images do.
#[derive(Clone, Debug, Default)]
pub struct Composition {
    frame: Option<Frame>,
    tiles: Vec<Tile>,
    cells: Vec<Cell>,
}

impl Composition {
    /// Arranges images, the main one first, each with its size and the height of the strip for its title, px.
    ///
    /// An image without a size keeps the proportions it had, 4:3 at first.
    pub fn update(&mut self, frame: Frame, images: impl Iterator<Item = (Option<Size>, usize)>) {
        let mut has_changed = self.frame.replace(frame) != Some(frame);
        let mut count = 0;
        for (size, caption) in images {
            if count == self.tiles.len() {
                self.tiles.push(Tile { size: USUAL, caption });
                has_changed = true;
            }
            let tile = &mut self.tiles[count];
            count += 1;
            has_changed |= caption != tile.caption;
            tile.caption = caption;
            let Some(size) = size else { continue };
            let ratio = (size.0 * tile.size.1) as f64 / (size.1 * tile.size.0).max(1) as f64;
            if (ratio - 1.0).abs() > MIN_CHANGE {
                (tile.size, has_changed) = (size, true);
            }
        }
        has_changed |= count != self.tiles.len();
        self.tiles.truncate(count);
        if has_changed {
            self.cells.clear();
            if let Some((main, others)) = self.tiles.split_first() {
                arrange(&frame, *main, others, &mut self.cells);
            }
        }
    }

    /// The rectangles of the images, strips for titles included.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// The images as they were arranged, one for each of [`Self::cells`].
    pub fn tiles(&self) -> &[Tile] {
        &self.tiles
    }
}

impl Plan {
    fn place(&self, frame: &Frame, main: Tile, sides: &[Tile], cells: &mut Vec<Cell>) {
        cells.clear();
        let gap = frame.gap as f64;
        let (width, height) = frame.room();
        let (column, row) = sides.split_at(self.in_column);
        let main = Group::new(std::slice::from_ref(&main), Lines::STACK, (self.main_px, height), gap);
        let min_px = frame.min_side_px(sides.len());
        let group = |tiles, room| match frame.side_share > 0.0 {
            true => Group::new(tiles, Lines::STACK, room, gap),
            false => Group::best(frame, tiles, room, min_px),
        };
        // A group and the margin between it and the main picture.
        let with_gap = |length: f64| if length > 0.0 { length + gap } else { 0.0 };
        let right = width - main.width - gap;
        let below = height - main.height - gap;
        let (column, row) = if self.is_column_whole {
            let column = group(column, (right, height));
            let row = group(row, (width - with_gap(column.width), below));
            (column, row)
        } else {
            let row = group(row, (width, below));
            let column = group(column, (right, height - with_gap(row.height)));
            (column, row)
        };
        let left_width = if self.is_column_whole { main.width.max(row.width) } else { main.width };
        let left_height = main.height + if self.is_column_whole { with_gap(row.height) } else { 0.0 };
        let span = left_height.max(column.height);
        let upper_width = left_width + with_gap(column.width);
        let (whole_width, whole_height) = match self.is_column_whole {
            true => (upper_width, span),
            false => (upper_width.max(row.width), span + with_gap(row.height)),
        };
        // Pictures stand together in the middle of the screen; what is left over lies around all of them.
        let (left, top) = (gap + (width - whole_width) / 2.0, gap + (height - whole_height) / 2.0);
        let x = left + (whole_width - upper_width) / 2.0;
        let y = top + (span - left_height) / 2.0;
        let mut put = |area: Area| cells.push(frame.cell(area));
        main.place(gap, (x + (left_width - main.width) / 2.0, y), &mut put);
        column.place(gap, (x + left_width + gap, top + (span - column.height) / 2.0), &mut put);
        let row_y = if self.is_column_whole { y + main.height } else { top + span };
        let row_x = if self.is_column_whole {
            x + (left_width - row.width) / 2.0
        } else {
            left + (whole_width - row.width) / 2.0
        };
        row.place(gap, (row_x, row_y + gap), &mut put);
    }
}

impl Frame {
    /// Width and height inside the margins.
    fn room(&self) -> (f64, f64) {
        let inside = |length: usize| length.saturating_sub(2 * self.gap) as f64;
        (inside(self.width), inside(self.height))
    }

    /// An area as a share of the screen.
    fn share(&self, area_px: f64) -> f64 {
        area_px / (self.width * self.height).max(1) as f64
    }

    /// Minimum width of each of `count` smaller images.
    fn min_side_px(&self, count: usize) -> f64 {
        MIN_SIDE_SHARE.min(SIDE_SHARES / count.max(1) as f64) * self.width as f64
    }

    /// Value of a smaller image: its area, reduced if it is too narrow.
    fn worth(&self, width: f64, height: f64, min_px: f64) -> f64 {
        self.share(width * height) - NARROW * (min_px - width).max(0.0) / self.width.max(1) as f64
    }

    /// Value of an arrangement.
    fn score(&self, cells: &[Cell]) -> f64 {
        let Some((main, sides)) = cells.split_first() else { return 0.0 };
        let (main, min_px) = (self.share(main.area()), self.min_side_px(sides.len()));
        let dead = 1.0 - main - self.share(sides.iter().map(Cell::area).sum());
        let worth: f64 = sides.iter().map(|cell| self.worth(cell.width as f64, cell.height as f64, min_px)).sum();
        IMPORTANCE * main + worth - SMALL * (MAIN_SHARE - main).max(0.0) - DEAD * (dead - DEAD_SHARE).max(0.0)
    }

    /// Rounds a cell to integer px and clips it to the screen.
    fn cell(&self, Area { x, y, width, height }: Area) -> Cell {
        // A hair more: quotients of whole numbers lose nothing by rounding.
        let px = |v: f64| (v + 0.01) as usize;
        let (x, y) = (px(x).min(self.width), px(y).min(self.height));
        Cell { x, y, width: px(width).min(self.width - x), height: px(height).min(self.height - y) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HD: Frame = Frame { width: 1280, height: 720, gap: 4, side_share: 0.0 };
    const FULL_HD: Frame = Frame { width: 1920, height: 1080, gap: 6, side_share: 0.0 };

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

    /// Shares of the screen: of the main cell, and of all cells.
    fn shares(frame: &Frame, cells: &[Cell]) -> (f64, f64) {
        let whole = (frame.width * frame.height) as f64;
        (cells[0].area() / whole, cells.iter().map(Cell::area).sum::<f64>() / whole)
    }

    /// Images of the surgeon's screen for views of a size: panorama and instruments with a bar of text, surface and depth with titles.
    fn surgeon(frame: &Frame, (width, height): Size, wider: f64) -> (Tile, [Tile; 3]) {
        let caption = frame.height / 30;
        let main = tile(((width as f64 * wider) as usize, height + height / 16), 0);
        let sides = [
            tile((width, height + height / 12), 0),
            tile((480, 300), caption),
            tile((width + height / 3, height), caption),
        ];
        (main, sides)
    }

    /// Upper bounds over all arrangements: the area of the main image, and the total area with three fifths for the main one (or its maximum). An
    /// image that does not overlap the main one is either next to it or above or below it, so it fits into the width or the height that the main one
    /// leaves, wherever both are.
    fn bounds(frame: &Frame, main: &Tile, sides: &[Tile]) -> (f64, f64) {
        let ((width, height), gap) = (frame.room(), frame.gap as f64);
        let largest = Block::of(main).fit((width, height));
        let (mut most, most_main) = (0.0f64, frame.share(largest.0 * largest.1));
        for step in 1..=1000 {
            let (wide, high) = Block::of(main).fit((largest.0 * f64::from(step) / 1000.0, height));
            let beside = |tile: &Tile| Block::of(tile).fit((width - gap - wide, height));
            let below = |tile: &Tile| Block::of(tile).fit((width, height - gap - high));
            let largest = |tile: &Tile| if beside(tile).0 > below(tile).0 { beside(tile) } else { below(tile) };
            let is_wide = sides.iter().all(|tile| largest(tile).0 >= frame.min_side_px(sides.len()));
            if frame.share(wide * high) >= most_main.min(0.6) * 0.999 && is_wide {
                let all = wide * high + sides.iter().map(|tile| largest(tile).0 * largest(tile).1).sum::<f64>();
                most = most.max(frame.share(all));
            }
        }
        (most_main, most)
    }

    #[test]
    fn eight_compositions_reach_their_limits_or_no_arrangement_does() {
        for frame in [HD, FULL_HD] {
            for size in [(640, 480), (1920, 1080), (720, 576), (500, 500)] {
                for wider in [1.1, 1.25] {
                    let (main, sides) = surgeon(&frame, size, wider);
                    for sides in [&sides[..], &[]] {
                        let cells = arranged(&frame, main, sides);
                        let ((main_share, used), (most_main, most)) =
                            (shares(&frame, &cells), bounds(&frame, &main, sides));
                        let what = format!(
                            "{size:?} x {wider}, {} others: main {main_share:.3} of {most_main:.3}, used {used:.3} of {most:.3}",
                            sides.len()
                        );
                        assert!(main_share >= most_main.min(0.602) - 0.002, "{what}");
                        assert!(used >= most.min(0.945) - 0.025, "{what} {cells:?}");
                    }
                }
            }
        }
    }

    /// Upper bound on the share of the screen that three images can cover next to a main one of at least three fifths, none narrower than allowed:
    /// all below each other at their maximum width, or two side by side and one above or below.
    fn most_beside(frame: &Frame, main: &Tile, sides: &[Tile; 3]) -> f64 {
        let ((width, height), gap, min_px) = (frame.room(), frame.gap as f64, frame.min_side_px(3));
        let blocks = sides.each_ref().map(Block::of);
        let area = |block: &Block, width: f64| width * block.height(width);
        let mut most = 0.0f64;
        for step in 0..=400 {
            let (wide, high) = Block::of(main).fit((width * f64::from(step) / 400.0, height));
            if frame.share(wide * high) < 0.6 {
                continue;
            }
            let lowest = blocks.iter().map(|block| block.height(min_px)).fold(f64::INFINITY, f64::min);
            assert!(height - high - gap < lowest, "no picture fits below");
            let room = width - wide - gap;
            let widths: Vec<f64> = (0..=80).map(|k| min_px + (room - min_px).max(0.0) * f64::from(k) / 80.0).collect();
            for (k, last) in blocks.iter().enumerate() {
                let (a, b) = (&blocks[(k + 1) % 3], &blocks[(k + 2) % 3]);
                for (first, second) in widths.iter().flat_map(|a| widths.iter().map(move |b| (*a, *b))) {
                    let is_beside = first + second + gap <= room;
                    let (heights, gaps) = match is_beside {
                        true => (a.height(first).max(b.height(second)), gap),
                        false => (a.height(first) + b.height(second), 2.0 * gap),
                    };
                    let third = last.fit((room, height - heights - gaps)).0;
                    if third >= min_px && first <= room && second <= room {
                        most =
                            most.max(frame.share(wide * high + area(a, first) + area(b, second) + area(last, third)));
                    }
                }
            }
        }
        most
    }

    #[test]
    fn a_panorama_no_wider_than_a_view_of_5_by_4_leaves_more_than_the_limit_in_any_arrangement() {
        for frame in [HD, FULL_HD] {
            let (main, sides) = surgeon(&frame, (720, 576), 1.0);
            let cells = arranged(&frame, main, &sides);
            let ((main_share, used), most) = (shares(&frame, &cells), most_beside(&frame, &main, &sides));
            assert!(most < 0.92 && used >= most - 0.02, "used {used:.4} of {most:.4} {cells:?}");
            // The first of them, the instruments, is the largest: the bound has it as the smallest.
            assert!(main_share >= 0.64 && cells[2..].iter().all(|side| side.area() < 0.5 * cells[1].area()));
        }
    }

    #[test]
    fn a_composition_holds_still_until_proportions_change() {
        let mut composition = Composition::default();
        let mut cells_of = |main: Option<Size>, frame: Frame| {
            composition.update(frame, [(main, 0), (Some((640, 480)), 20)].into_iter());
            composition.cells().to_vec()
        };
        let first = cells_of(None, HD);
        assert_eq!(first, cells_of(Some((640, 480)), HD), "4:3 until it arrives");
        assert_eq!(first, cells_of(Some((645, 480)), HD), "under 3 %");
        let wide = cells_of(Some((900, 480)), HD);
        assert!(wide[0].width * 480 > wide[0].height * 880, "{wide:?}");
        assert_eq!(wide, cells_of(None, HD), "keeps what it had");
        assert_ne!(wide, cells_of(None, FULL_HD));
    }

    #[test]
    fn smaller_pictures_stand_together() {
        for (size, wider) in [((720, 576), 1.0), ((640, 480), 1.1), ((1920, 1080), 1.0), ((500, 500), 1.25)] {
            let (main, sides) = surgeon(&FULL_HD, size, wider);
            let cells = arranged(&FULL_HD, main, &sides);
            // Each of them ends one margin before another one or before the main picture, or begins one behind it.
            let touches = |a: &Cell, b: &Cell| {
                let spans = [(a.x, a.width, b.x, b.width), (a.y, a.height, b.y, b.height)];
                spans.into_iter().any(|(a, a_size, b, b_size)| {
                    (a + a_size + FULL_HD.gap).abs_diff(b) <= 1 || (b + b_size + FULL_HD.gap).abs_diff(a) <= 1
                })
            };
            let sides = &cells[1..];
            for (k, side) in sides.iter().enumerate() {
                let others = sides.iter().enumerate().filter(|(other, _)| *other != k);
                assert!(others.map(|(_, other)| other).any(|other| touches(side, other)), "{size:?} {cells:?}");
            }
        }
    }

    #[test]
    fn the_main_picture_has_three_fifths_of_the_screen() {
        for frame in [HD, FULL_HD] {
            for (size, wider, least_used) in [
                ((640, 480), 1.0, 0.92),
                ((640, 480), 1.06, 0.96),
                ((640, 480), 1.3, 0.84),
                ((720, 576), 1.0, 0.88),
                ((720, 576), 1.06, 0.91),
                ((1920, 1080), 1.15, 0.75),
                ((1920, 1080), 1.0, 0.8),
            ] {
                let (main, sides) = surgeon(&frame, size, wider);
                let cells = arranged(&frame, main, &sides);
                let (main, used) = shares(&frame, &cells);
                assert!(main >= 0.6 && used >= least_used, "{size:?} x {wider}: {main:.3} {used:.3} {cells:?}");
            }
        }
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
                assert!(
                    (high / Block::of(tile).slope - cell.width as f64).abs() < 4.0,
                    "{count}: {cell:?} of {tile:?}"
                );
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
