//! Smallest disparity to search: the window as wide as the search that covers most of the surveyed matches.

/// Follows the surveys without flicker. Uses integers only, so that every machine gives the same result.
#[derive(Debug, Default)]
pub struct Offset {
    /// Decaying sums of the surveys' counts.
    mass: Vec<u32>,
    bin_px: usize,
    current_px: Option<i32>,
}

/// Offsets are multiples of this, px.
const STEP_PX: i32 = 8;
/// Share of the best window's matches, in per mille, above which the present window stays.
const KEEP_PER_MILLE: u64 = 985;
/// Windows with this share of the best one's matches, in per mille, count as equal. The one with the largest disparities is chosen: there is
/// nothing behind the farthest surface, and what enters the picture (a tool) is nearer.
const EQUAL_PER_MILLE: u64 = 997;
/// Smallest share of matched coarse pixels, in per mille, at which a survey is used.
const MIN_PER_MILLE: usize = 5;

impl Offset {
    /// The present offset; `None` before the first usable survey.
    pub fn current_px(&self) -> Option<i32> {
        self.current_px
    }

    /// Whether a survey has matched too few pixels to be used.
    pub fn says_nothing(&self, matched: usize, pixels: usize) -> bool {
        matched * 1000 < pixels * MIN_PER_MILLE
    }

    /// Adds a survey's `counts` (of `pixels` coarse pixels, in bins of `bin_px`) and returns the offset for a search over `search_px`.
    pub fn update(&mut self, counts: &[u32], bin_px: usize, pixels: usize, search_px: usize) -> Option<i32> {
        if self.mass.len() != counts.len() || self.bin_px != bin_px {
            self.mass.clear();
            self.mass.resize(counts.len(), 0);
            self.bin_px = bin_px;
            self.current_px = None;
        }
        let matched: usize = counts.iter().map(|count| *count as usize).sum();
        if self.says_nothing(matched, pixels) {
            // Dark or blurred pictures give no estimate: the old one stays.
            return self.current_px;
        }
        let first = self.current_px.is_none();
        for (mass, count) in self.mass.iter_mut().zip(counts) {
            // The first survey counts whole, later ones a quarter.
            *mass = if first { 64 * count } else { *mass - *mass / 4 + 16 * count };
        }

        // A bin's disparities reach half a bin to both sides.
        let bins = (search_px / bin_px).saturating_sub(1).max(1);
        let windows = self.mass.len().saturating_sub(bins) + 1;
        let within = |start: usize| -> u64 { self.mass.iter().skip(start).take(bins).map(|m| u64::from(*m)).sum() };
        let best = (0..windows).map(within).max().unwrap_or(0);
        if best == 0 {
            return self.current_px;
        }
        if let Some(current) = self.current_px {
            let start = (current as usize + bin_px / 2).div_ceil(bin_px);
            if within(start) * 1000 >= best * KEEP_PER_MILLE {
                return self.current_px;
            }
        }
        let equal = |start: &usize| within(*start) * 1000 >= best * EQUAL_PER_MILLE;
        let start = (0..windows).rev().find(equal).unwrap_or(0);
        // One bin and a half of room below.
        let below_px = (start * bin_px) as i32 - (3 * bin_px / 2) as i32;
        self.current_px = Some((below_px.div_euclid(STEP_PX) * STEP_PX).max(0));
        self.current_px
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(range: std::ops::Range<usize>) -> Vec<u32> {
        (0..160).map(|bin| if range.contains(&bin) { 50 } else { 0 }).collect()
    }

    #[test]
    fn the_window_holds_what_the_survey_found() {
        let mut offset = Offset::default();
        // 160 to 240 px, searched over 128 px: 24 px of room on both sides.
        let found = offset.update(&counts(40..60), 4, 160 * 120, 128);
        assert!(found.is_some_and(|px| (112..=160).contains(&px) && px + 128 >= 240), "{found:?}");
        // A small motion does not move the offset.
        assert_eq!(offset.update(&counts(42..61), 4, 160 * 120, 128), found);
        // A cut to another depth is followed within a few surveys.
        let mut last = found;
        for _ in 0..12 {
            last = offset.update(&counts(80..100), 4, 160 * 120, 128);
        }
        assert!(last.is_some_and(|px| px <= 320 && px + 128 >= 400), "{last:?}");
    }

    #[test]
    fn pictures_that_say_nothing_change_nothing() {
        let mut offset = Offset::default();
        assert_eq!(offset.update(&counts(0..0), 4, 160 * 120, 64), None);
        let found = offset.update(&counts(40..44), 4, 160 * 120, 64);
        assert!(found.is_some());
        assert_eq!(offset.update(&counts(0..0), 4, 160 * 120, 64), found);
    }

    #[test]
    fn more_range_than_the_search_keeps_the_most() {
        let mut offset = Offset::default();
        let mut both = counts(10..20);
        both[100..130].fill(60);
        let found = offset.update(&both, 4, 160 * 120, 128);
        assert!(found.is_some_and(|px| px <= 400 && px + 128 >= 516), "{found:?}");
    }
}
