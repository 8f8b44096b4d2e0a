//! The dark rim of a view: what its optics or its rectification leave black.

use crate::View;

/// Brightest level of a rim; noise and compression lift it off 0.
const DARK_LEVELS: u8 = 16;
/// Samples of a block, each way.
const SAMPLES: usize = 3;
/// Dark samples of a block that belongs to the rim for itself.
const DARK_SAMPLES: usize = 5;
/// Looks that a block's state remembers at most.
const MOST_LOOKS: u8 = 40;
/// State from which on a block is lit.
const LIT_LOOKS: u8 = 3;
/// What a look that finds a block dark takes off its state. A rim needs more evidence than light: tissue in the shade moves, a rim does not.
const DARK_STEP: u8 = 2;
/// A rim of more than this share of a view, in percent, is no rim: the light is off.
const MOST_RIM_PERCENT: usize = 60;

/// Which blocks of a view are lit, found a few times a second.
#[derive(Debug, Default)]
pub(super) struct Rim {
    block_px: usize,
    columns: usize,
    rows: usize,
    /// Evidence that a block is lit, 0..=[`MOST_LOOKS`].
    state: Vec<u8>,
    is_rim: Vec<bool>,
    open: Vec<usize>,
}

/// How much of a block is dark.
#[derive(Clone, Copy, PartialEq)]
enum Dark {
    Not,
    Partly,
    Mostly,
}

impl Rim {
    /// Forgets the view.
    pub fn forget(&mut self) {
        self.columns = 0;
    }

    /// Takes a frame (BGR) over. Only the rim and its inner edge are read.
    pub fn look(&mut self, view: &View<u8>, block_px: usize) {
        let (columns, rows) = (view.width.div_ceil(block_px), view.height.div_ceil(block_px));
        let is_first = (self.block_px, self.columns, self.rows) != (block_px, columns, rows);
        (self.block_px, self.columns, self.rows) = (block_px, columns, rows);
        self.is_rim.clear();
        self.is_rim.resize(columns * rows, false);
        self.open.clear();
        self.open.reserve(columns * rows);
        for block in 0..columns * rows {
            let (x, y) = (block % columns, block / columns);
            let at_border = x == 0 || y == 0 || x + 1 == columns || y + 1 == rows;
            if at_border && (self.dark(view, x, y) == Dark::Mostly || self.has_dark_edge(view, x, y)) {
                self.is_rim[block] = true;
                self.open.push(block);
            }
        }
        while let Some(block) = self.open.pop() {
            let (x, y) = (block % columns, block / columns);
            for (u, v) in (y.saturating_sub(1)..(y + 2).min(rows))
                .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(columns)).map(move |u| (u, v)))
            {
                let next = v * columns + u;
                if self.is_rim[next] {
                    continue;
                }
                let dark = self.dark(view, u, v);
                self.is_rim[next] = dark != Dark::Not;
                if dark == Dark::Mostly {
                    self.open.push(next);
                }
            }
        }
        let count = self.is_rim.iter().filter(|is_rim| **is_rim).count();
        if count * 100 > columns * rows * MOST_RIM_PERCENT {
            self.is_rim.fill(false);
        }
        if is_first {
            self.state.clear();
            self.state.extend(self.is_rim.iter().map(|is_rim| if *is_rim { 0 } else { MOST_LOOKS }));
            return;
        }
        for (state, is_rim) in self.state.iter_mut().zip(&self.is_rim) {
            *state = if *is_rim { state.saturating_sub(DARK_STEP) } else { (*state + 1).min(MOST_LOOKS) };
        }
    }

    fn is_dark(view: &View<u8>, x: usize, y: usize) -> bool {
        let at = y.min(view.height - 1) * view.stride + x.min(view.width - 1) * 3;
        view.data[at..at + 3].iter().all(|level| *level <= DARK_LEVELS)
    }

    /// Positions of the samples along a side of a block.
    fn along(&self, block: usize) -> [usize; SAMPLES] {
        let (first, last) = (block * self.block_px, (block + 1) * self.block_px - 1);
        [first, first.midpoint(last), last]
    }

    fn dark(&self, view: &View<u8>, column: usize, row: usize) -> Dark {
        let (xs, ys) = (self.along(column), self.along(row));
        let count =
            ys.iter().flat_map(|y| xs.iter().map(|x| (*x, *y))).filter(|(x, y)| Self::is_dark(view, *x, *y)).count();
        match count {
            0 => Dark::Not,
            1..DARK_SAMPLES => Dark::Partly,
            _ => Dark::Mostly,
        }
    }

    /// Whether the outermost pixels of a block at the border are dark: a rim of a few columns.
    fn has_dark_edge(&self, view: &View<u8>, column: usize, row: usize) -> bool {
        let (xs, ys) = (self.along(column), self.along(row));
        let (right, bottom) = (view.width - 1, view.height - 1);
        let down = |x: usize| ys.iter().all(|y| Self::is_dark(view, x, *y));
        let across = |y: usize| xs.iter().all(|x| Self::is_dark(view, *x, y));
        (column == 0 && down(0))
            || (row == 0 && across(0))
            || (column + 1 == self.columns && down(right))
            || (row + 1 == self.rows && across(bottom))
    }

    /// Whether the view is lit at a pixel; everywhere before the first look.
    pub fn is_lit(&self, x: usize, y: usize) -> bool {
        if self.columns == 0 {
            return true;
        }
        let (column, row) = ((x / self.block_px).min(self.columns - 1), (y / self.block_px).min(self.rows - 1));
        self.state[row * self.columns + column] >= LIT_LOOKS
    }

    /// Area of the lit blocks of a view of this size, px.
    pub fn lit_px(&self, (width, height): (usize, usize)) -> f64 {
        let lit = self.state.iter().filter(|state| **state >= LIT_LOOKS).count();
        match self.columns * self.rows {
            0 => (width * height) as f64,
            blocks => (width * height) as f64 * lit as f64 / blocks as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (160, 120);

    fn look(rim: &mut Rim, level: impl Fn(usize, usize) -> u8) {
        let data: Vec<u8> = (0..SIZE.0 * SIZE.1).flat_map(|i| [level(i % SIZE.0, i / SIZE.0); 3]).collect();
        rim.look(&View::new(&data, SIZE.0, SIZE.1, 3), 8);
    }

    #[test]
    fn a_black_border_is_the_rim_and_a_dark_instrument_inside_is_not() {
        let mut rim = Rim::default();
        assert!(rim.is_lit(0, 0) && rim.lit_px(SIZE) == 19200.0);
        let level = |x: usize, y: usize| match () {
            () if x < 30 || y >= 110 => (x * 7 % 9) as u8,
            () if (80..110).contains(&x) && (40..70).contains(&y) => 3,
            () => 120,
        };
        look(&mut rim, level);
        assert!(!rim.is_lit(3, 60) && !rim.is_lit(29, 60) && !rim.is_lit(80, 115));
        assert!(rim.is_lit(40, 60) && rim.is_lit(95, 55) && rim.is_lit(159, 0));
        // The blocks that hold a part of the rim belong to it.
        assert!((rim.lit_px(SIZE) - 128.0 * 104.0).abs() < 1.0, "{}", rim.lit_px(SIZE));
    }

    #[test]
    fn a_rim_of_two_columns_is_found() {
        let mut rim = Rim::default();
        look(&mut rim, |x, _| if x < 2 { 0 } else { 120 });
        assert!(!rim.is_lit(1, 60) && rim.is_lit(10, 60));
    }

    #[test]
    fn what_was_lit_stays_lit_in_a_passing_shade_and_light_ends_a_rim() {
        let mut rim = Rim::default();
        look(&mut rim, |x, _| if x < 40 { 0 } else { 120 });
        for _ in 0..8 {
            look(&mut rim, |x, _| if !(40..130).contains(&x) { 0 } else { 120 });
        }
        assert!(rim.is_lit(150, 60) && !rim.is_lit(10, 60), "two seconds of shade");
        look(&mut rim, |_, _| 120);
        assert!(!rim.is_lit(10, 60), "one flash is no light");
        (0..4).for_each(|_| look(&mut rim, |_, _| 120));
        assert!(rim.is_lit(10, 60));
        for _ in 0..40 {
            look(&mut rim, |x, _| if x < 40 { 0 } else { 120 });
        }
        assert!(!rim.is_lit(10, 60));
        // The light goes out: nothing is known about the rim then.
        (0..40).for_each(|_| look(&mut rim, |_, _| 0));
        assert!(rim.is_lit(150, 60));
    }
}
