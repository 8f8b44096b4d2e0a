//! Calls on images of full size that are made on images shrunk by a whole factor.

use panoscope_imaging::Rect;
use panoscope_imaging::stereo::Tile;

/// The factor that a parameter `scale` stands for, for views of a width in px. 0 becomes a factor whose shrunk views have a pixel count
/// that grows with the width instead of with its square: 2 from 640 px on, 3 from 1440, 4 from 2560.
pub fn factor(scale: usize, width: usize) -> usize {
    if scale > 0 { scale } else { (width / 160).isqrt().max(1) }
}

/// Disparities that a kernel searches at once.
const SEARCH_STEP_PX: usize = 32;

/// Images of one size and their shrunk copies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shrinking {
    /// Pixels per shrunk pixel, each way.
    pub factor: usize,
    /// Columns and rows of the shrunk images: whole blocks only.
    pub size: (usize, usize),
}

impl Shrinking {
    /// By `factor`; `None` where images of this size stay as they are.
    pub fn new(factor: usize, (width, height): (usize, usize)) -> Option<Self> {
        let size = (width / factor.max(1), height / factor.max(1));
        (factor > 1 && size.0 > 0 && size.1 > 0).then_some(Self { factor, size })
    }

    /// The shrunk pixels that a rectangle touches.
    pub fn roi(&self, roi: Rect) -> Rect {
        let end = |start: usize, size: usize| (start + size).div_ceil(self.factor);
        let (x, y) = (roi.x / self.factor, roi.y / self.factor);
        let (width, height) = (end(roi.x, roi.width) - x, end(roi.y, roi.height) - y);
        Rect { x, y, width, height }.clamped(self.size.0, self.size.1)
    }

    /// A range of disparities, first and number, in shrunk px.
    pub fn range(&self, (first_px, search_px): (i32, usize)) -> (i32, usize) {
        let scale = self.factor as i32;
        // Rounded down: a range that exceeds the end by less than a shrunk pixel costs a whole block of disparities.
        let first = first_px.div_euclid(scale);
        let end = (first_px + search_px as i32).div_euclid(scale) + 1;
        let search = (end - first).max(2) as usize - 1;
        (first, search.next_multiple_of(SEARCH_STEP_PX))
    }

    /// Tiles in shrunk px.
    pub fn tiles<'a>(&'a self, tiles: &'a [Tile]) -> impl Iterator<Item = Tile> + 'a {
        tiles.iter().map(|tile| {
            // Both ends are rounded alike, so that neighbours still touch.
            let cut =
                |start: usize, size: usize| (start / self.factor, (start + size) / self.factor - start / self.factor);
            let ((x, width), (y, height)) = (cut(tile.area.x, tile.area.width), cut(tile.area.y, tile.area.height));
            let (first_px, search_px) = self.range((tile.first_px, tile.search_px));
            Tile { area: Rect { x, y, width, height }, first_px, search_px }
        })
    }

    /// A difference of disparities in shrunk px.
    pub fn px(&self, px: Option<f32>) -> Option<f32> {
        px.map(|px| px / self.factor as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factor_follows_the_width() {
        let found = [160, 320, 640, 720, 1280, 1440, 1920, 2560, 3840].map(|width| factor(0, width));
        assert_eq!(found, [1, 1, 2, 2, 2, 3, 3, 4, 4]);
        assert_eq!((factor(1, 1920), factor(5, 64)), (1, 5));
    }

    #[test]
    fn rectangles_ranges_and_tiles_are_those_of_the_shrunk_images() {
        assert_eq!([0, 1].map(|factor| Shrinking::new(factor, (30, 20))), [None; 2]);
        assert_eq!(Shrinking::new(4, (30, 3)), None);
        let by_three = Shrinking::new(3, (31, 20)).expect("shrunk");
        assert_eq!(by_three.size, (10, 6));
        assert_eq!(by_three.roi(Rect::new(4, 2, 27, 18)), Rect::new(1, 0, 9, 6));
        assert!(by_three.roi(Rect::default()).is_empty());
        assert_eq!([(-1, 64), (30, 128), (7, 0)].map(|range| by_three.range(range)), [(-1, 32), (10, 64), (2, 32)]);
        let tile = |x, width| Tile { area: Rect::new(x, 0, width, 20), first_px: 30, search_px: 90 };
        let areas: Vec<Rect> = by_three.tiles(&[tile(0, 16), tile(16, 15)]).map(|tile| tile.area).collect();
        assert_eq!(areas, [Rect::new(0, 0, 5, 6), Rect::new(5, 0, 5, 6)]);
        assert_eq!(by_three.px(Some(1.5)), Some(0.5));
    }
}
