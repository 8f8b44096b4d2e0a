//! Masks as bits, and where they touch the image border.

/// Maximum gap between parts of the border that count as one, px.
pub(super) const BORDER_GAP_PX: usize = 3;

/// A mask as bits: most significant first, rows padded to whole bytes.
#[derive(Clone, Copy, Debug)]
pub struct Mask<'a> {
    bits: &'a [u8],
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
}

impl<'a> Mask<'a> {
    /// Wraps bits as a mask; missing rows are empty.
    pub fn new(bits: &'a [u8], width: usize, height: usize) -> Self {
        let height = bits.len().checked_div(width.div_ceil(8)).map_or(0, |rows| height.min(rows));
        Self { bits, width, height }
    }

    /// Whether a pixel belongs to the mask; false outside it.
    pub fn contains(&self, x: usize, y: usize) -> bool {
        x < self.width && y < self.height && self.bits[y * self.width.div_ceil(8) + x / 8] & (0x80 >> (x % 8)) != 0
    }

    pub(super) fn each(&self, visit: &mut dyn FnMut(f64, f64)) {
        for (y, row) in self.bits.chunks_exact(self.width.div_ceil(8).max(1)).take(self.height).enumerate() {
            for (b, &byte) in row.iter().enumerate().filter(|(_, byte)| **byte != 0) {
                for k in (0..8).filter(|k| byte & (0x80 >> k) != 0) {
                    visit((b * 8 + k) as f64, y as f64);
                }
            }
        }
    }

    /// Pixels of the border, once around.
    fn border(&self) -> impl Iterator<Item = (usize, usize)> + use<'a> {
        let (w, h) = (self.width, self.height);
        let (right, bottom) = (w.saturating_sub(1), h.saturating_sub(1));
        (0..w)
            .map(|x| (x, 0))
            .chain((1..h).map(move |y| (right, y)))
            .chain((0..right).rev().map(move |x| (x, bottom)))
            .chain((1..bottom).rev().map(|y| (0, y)))
    }

    /// Whether any pixel of the border belongs to the mask.
    pub fn touches_border(&self) -> bool {
        self.border().any(|(x, y)| self.contains(x, y))
    }

    /// The two widest parts of the border that the mask touches, the wider one first: where shafts enter.
    pub(super) fn contacts(&self) -> [Option<Contact>; 2] {
        let mut widest: [Option<Contact>; 2] = [None; 2];
        let Some(first_gap) = self.border().position(|(x, y)| !self.contains(x, y)) else { return widest };
        let mut add = |[width, x, y]: [f64; 3]| {
            let is_wider = |than: Option<Contact>| than.is_none_or(|than| width > than.width_px);
            let contact = Contact { width_px: width, centre: [x / width, y / width] };
            if width > 0.0 && is_wider(widest[0]) {
                widest = [Some(contact), widest[0]];
            } else if width > 0.0 && is_wider(widest[1]) {
                widest[1] = Some(contact);
            }
        };
        let (mut part, mut gap) = ([0.0_f64; 3], 0);
        // Once around from a gap.
        for (x, y) in self.border().chain(self.border()).skip(first_gap).take(self.border().count()) {
            if self.contains(x, y) {
                part = [part[0] + 1.0, part[1] + x as f64, part[2] + y as f64];
                gap = 0;
            } else {
                gap += 1;
                if gap > BORDER_GAP_PX {
                    add(std::mem::take(&mut part));
                }
            }
        }
        add(part);
        widest
    }
}

/// A part of the border that a mask touches.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    /// Length of the border, px.
    pub(super) width_px: f64,
    /// Column and row, px.
    pub(super) centre: [f64; 2],
}
