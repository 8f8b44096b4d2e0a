//! Where to search: tiles whose ranges a coarse match has found, for scenes with more range than one search.

use super::survey::Survey;
use super::tile::Tile;
use crate::Rect;

/// Side of a tile that the view is cut into, px; tiles share what is left over.
const TILE_PX: usize = 128;
/// Disparities this far around a tile count for its range, px: surfaces move between surveys, and a survey sees no edge exactly.
const AROUND_PX: usize = 24;
/// Room on both sides of a tile's surveyed range, px.
const ROOM_PX: i32 = 6;
/// Coarse pixels that a disparity needs to count for a range, itself and its neighbours together: fewer are wrong matches.
const MIN_PIXELS: u32 = 3;
/// Widest search of a tile, px.
const MAX_SEARCH_PX: usize = 512;
/// Searches are multiples of this, px.
const STEP_PX: usize = 32;

/// Tiles of a view with their ranges. Reuses its memory.
#[derive(Debug, Default)]
pub struct RangePlan {
    tiles: Vec<Tile>,
    /// First and last surveyed disparity of each tile, in bins.
    ranges: Vec<Option<(usize, usize)>>,
    others: Vec<Option<(usize, usize)>>,
    counts: Vec<u32>,
    is_cut: bool,
}

impl RangePlan {
    /// The tiles of the last plan; none before the first.
    pub fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    /// Smallest and largest disparity that tiles search, px.
    pub fn range_px(&self) -> (i32, i32) {
        let low = self.tiles.iter().map(|tile| tile.first_px).min().unwrap_or(0);
        let high = self.tiles.iter().map(|tile| tile.first_px + tile.search_px as i32).max().unwrap_or(0);
        (low, high)
    }

    /// Whether a tile holds more range than its search.
    pub fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// Cuts `roi` into tiles and gives each the range that `survey` has found there. A tile without a match takes the ranges of its neighbours.
    pub fn update(&mut self, survey: &Survey, roi: Rect) {
        self.tiles.clear();
        self.ranges.clear();
        self.is_cut = false;
        if roi.is_empty() {
            return;
        }
        let (columns, rows) = (roi.width.div_ceil(TILE_PX), roi.height.div_ceil(TILE_PX));
        let cut = |start: usize, size: usize, parts: usize, index: usize| {
            let at = |index: usize| start + size * index / parts;
            (at(index), at(index + 1) - at(index))
        };
        for row in 0..rows {
            for column in 0..columns {
                let ((x, width), (y, height)) =
                    (cut(roi.x, roi.width, columns, column), cut(roi.y, roi.height, rows, row));
                self.tiles.push(Tile { area: Rect { x, y, width, height }, first_px: 0, search_px: STEP_PX });
                self.ranges.push(surveyed(survey, Rect { x, y, width, height }, &mut self.counts));
            }
        }
        self.spread(columns, rows);
        let bin_px = survey.bin_px();
        for (tile, range) in self.tiles.iter_mut().zip(&self.ranges) {
            let Some((first, last)) = *range else { continue };
            // A bin's disparities reach half a bin to both sides.
            let low = ((first * bin_px) as i32 - (bin_px / 2) as i32 - ROOM_PX).max(0);
            let high = (last * bin_px + bin_px / 2) as i32 + ROOM_PX;
            let wanted = ((high - low) as usize + 1).next_multiple_of(STEP_PX);
            tile.search_px = wanted.min(MAX_SEARCH_PX);
            self.is_cut |= wanted > MAX_SEARCH_PX;
            // The farthest surface has nothing behind it, what enters the picture is nearer: what is cut off is far, what is left over is near.
            tile.first_px = if wanted > MAX_SEARCH_PX { high + 1 - MAX_SEARCH_PX as i32 } else { low };
        }
        // Without any match there is nothing to search for.
        if self.ranges.iter().all(Option::is_none) {
            self.tiles.clear();
        }
    }

    /// Gives tiles without a range those of their neighbours, ring by ring.
    fn spread(&mut self, columns: usize, rows: usize) {
        for _ in 0..columns.max(rows) {
            if self.ranges.iter().all(Option::is_some) {
                return;
            }
            self.others.clone_from(&self.ranges);
            for row in 0..rows {
                for column in 0..columns {
                    if self.others[row * columns + column].is_some() {
                        continue;
                    }
                    let near = (row.saturating_sub(1)..(row + 2).min(rows)).flat_map(|row| {
                        (column.saturating_sub(1)..(column + 2).min(columns)).map(move |column| row * columns + column)
                    });
                    let joined =
                        near.filter_map(|index| self.others[index]).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
                    self.ranges[row * columns + column] = joined;
                }
            }
        }
    }
}

/// First and last bin of the surveyed disparities in and around `area`.
fn surveyed(survey: &Survey, area: Rect, counts: &mut Vec<u32>) -> Option<(usize, usize)> {
    let (map, (width, height)) = survey.map();
    let bin_px = survey.bin_px();
    counts.clear();
    counts.resize(survey.counts().len(), 0);
    let span = |start: usize, size: usize, limit: usize| {
        (start.saturating_sub(AROUND_PX) / bin_px).min(limit)..(start + size + AROUND_PX).div_ceil(bin_px).min(limit)
    };
    for y in span(area.y, area.height, height) {
        let row = &map[y * width..(y + 1) * width];
        for disparity in row[span(area.x, area.width, width)].iter().filter(|disparity| disparity.is_finite()) {
            let bin = ((disparity + 0.5).max(0.0) as usize).min(counts.len().saturating_sub(1));
            counts[bin] += 1;
        }
    }
    let near = |bin: &usize| {
        let around = bin.saturating_sub(1)..(bin + 2).min(counts.len());
        counts[*bin] > 0 && counts[around].iter().sum::<u32>() >= MIN_PIXELS
    };
    Some(((0..counts.len()).find(near)?, (0..counts.len()).rfind(near)?))
}
