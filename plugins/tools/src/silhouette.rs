//! Segments an instrument inside its box: pixels in front of the tissue that are less red than it.
//!
//! A detector's box says where an instrument's working end is, not where it ends. Two cues identify its pixels: it is nearer to the camera than the
//! surface around it, and it is gray, black or blue where tissue is red to yellow. A first guess from both cues is used to learn the colours of this
//! instrument and of this tissue, as in GrabCut (Rother, Kolmogorov, Blake 2004) with histograms instead of mixtures and without a cut; the largest
//! connected part in the box is the instrument.

use panoscope_node::pick::Grid;

mod beyond;
mod cells;
mod plane;

use crate::shaft::{End, Mask, TipPixel};
use cells::{COLOURS, Cells, MIN_CELLS, Region, class_of, shade};
pub use cells::{Cues, Nearness};
use plane::{Sums, positions, solve};

/// Limits of a single cue, against and for an instrument, in standard deviations.
const MAX_FOR: f32 = 5.0;
const MAX_AGAINST: f32 = -2.0;
/// Sum of both cues from which a cell is instrument in the first guess.
const FIRST_GUESS: f32 = 3.0;
/// Standard deviations in front of the surface from which a cell is certainly in front of it.
const BEFORE: f32 = 2.0;
/// Minimum size of a part that may be a jaw, as a share of the largest part's cells, and the share of its own cells that must be gray then.
const JAW_SHARE: f32 = 0.3;
const MAX_OF: f32 = 0.7;
/// Standard deviations less red than tissue from which a cell is certainly gray.
const GRAY: f32 = 1.5;
/// Log-likelihood ratio of the learned colours from which a cell next to the instrument is added to it.
const GROWS: f32 = 1.0;
/// Weight of redness, and maximum log ratio of a colour's share in the box to its share around it, if nearness is unknown.
const ALONE: f32 = 2.0;
const MAX_SHARE: f32 = 2.0;
/// Brightness from which a gray cell may be glare on wet tissue.
const GLARE: f32 = 0.75;
/// Minimum standard deviation of the surface's nearness, as a share of it, and of its redness: the errors of matching and noise.
const NEARNESS_FLOOR: f32 = 0.006;
const REDNESS_FLOOR: f32 = 0.02;
/// Number of pixels whose classes are computed at once.
const PIXELS_AT_ONCE: usize = 64;
/// Limit of the final log-likelihood ratio of colour or nearness.
const LOG_RATIO_LIMIT: f32 = 3.0;
/// Class of a cell while colours are learned: an instrument, one that is gray, one that is gray and near; tissue.
const TOOL: u8 = 1;
const GRAY_TOOL: u8 = 2;
const NEAR_TOOL: u8 = 4;
const TISSUE: u8 = 8;
/// Minimum and maximum share of the box's cells that an instrument covers.
const COVERS: (f32, f32) = (0.04, 0.9);

/// Segments instruments; reuses its buffers.
#[derive(Debug, Default)]
pub struct Silhouette {
    cells: Cells,
    /// For each cell, whether it is in the box.
    is_in_box: Vec<bool>,
    /// Whether colours alone distinguish the instrument, because nearness is unknown.
    is_by_colour: bool,
    /// Redness of the tissue around the box: median and standard deviation.
    tissue: Option<(f32, f32)>,
    /// Score for an instrument, and the score before colours were learned.
    score: Vec<f32>,
    first: Vec<f32>,
    /// Score of redness alone, in standard deviations; log-likelihood ratio of the learned colours.
    gray: Vec<f32>,
    colour: Vec<f32>,
    /// Log-likelihood ratio of each class of colours; empty before any were learned.
    log_ratios: Vec<f32>,
    /// Work memory.
    sorted: Vec<f32>,
    columns: Vec<f64>,
    blurred: Vec<f32>,
    /// For each cell, its class while colours are learned.
    kind: Vec<u8>,
    part: Vec<u32>,
    /// Parts and their number of cells in the box.
    others: Vec<(u32, usize)>,
    queue: Vec<u32>,
    bits: Vec<u8>,
}

/// Median, and the standard deviation of a normal distribution with the same median distance from it. `None` for too few values.
fn median(sorted: &mut Vec<f32>, values: impl Iterator<Item = f32>) -> Option<(f32, f32)> {
    sorted.clear();
    sorted.extend(values.filter(|v| v.is_finite()));
    if sorted.len() < MIN_CELLS / 4 {
        return None;
    }
    let middle = sorted.len() / 2;
    let (_, centre, _) = sorted.select_nth_unstable_by(middle, f32::total_cmp);
    let centre = *centre;
    sorted.iter_mut().for_each(|v| *v = (*v - centre).abs());
    let (_, distance, _) = sorted.select_nth_unstable_by(middle, f32::total_cmp);
    Some((centre, 1.4826 * *distance))
}

/// Log of the ratio of each colour class's frequency among the `own` cells to that among the `other` ones, limited to `most` either way.
fn log_ratios(own: &[f32; COLOURS], other: &[f32; COLOURS], most: f32) -> [f32; COLOURS] {
    let [owns, others] = [own, other].map(|counts| counts.iter().sum::<f32>());
    std::array::from_fn(|of| ((own[of] / owns) / (other[of] / others)).ln().clamp(-most, most))
}

impl Silhouette {
    /// The pixels of an image of `size` that [`Silhouette::cut`] reads for a box; none where it reads none.
    pub fn pixels(corners: [f32; 4], size: (usize, usize)) -> Vec<Grid> {
        Region::around(corners, size).iter().map(Region::pixels).collect()
    }

    /// Segments the instrument in a box (left, top, right, bottom, px). Returns whether it can be distinguished from its surroundings.
    pub fn cut(&mut self, corners: [f32; 4], cues: &Cues<'_>) -> bool {
        self.bits.clear();
        let Some(region) = Region::around(corners, cues.size) else { return false };
        self.cells.sample(region, cues);
        let [left, top, right, bottom] = region.own;
        self.is_in_box.clear();
        self.is_in_box.resize(region.width * region.height, false);
        for row in self.is_in_box.chunks_exact_mut(region.width).take(bottom + 1).skip(top) {
            row[left..=right].fill(true);
        }
        self.score.clear();
        self.score.resize(region.width * region.height, 0.0);
        let is_known = [self.judge_redness(), self.judge_nearness()];
        if !is_known[1] {
            self.cells.near.fill(f32::NAN);
        }
        if !is_known.contains(&true) {
            return false;
        }
        self.is_by_colour = !is_known[1];
        if self.is_by_colour {
            self.judge_colours_alone();
        }
        self.colour.clear();
        self.log_ratios.clear();
        self.first.clone_from(&self.score);
        for _ in 0..2 {
            if is_known[0] {
                self.learn_colours();
            }
            self.blur();
        }
        self.largest()
    }

    /// The instrument's pixels, in cells: see [`Silhouette::place`].
    pub fn mask(&self) -> Mask<'_> {
        Mask::new(&self.bits, self.cells.region.width, self.cells.region.height)
    }

    /// Whether colours alone distinguished the last instrument. It is then cut off at its box, and the mask does not show where it enters.
    pub fn is_by_colour(&self) -> bool {
        self.is_by_colour
    }

    /// Whether a pixel of the image belongs to the instrument.
    pub fn contains(&self, x: usize, y: usize) -> bool {
        let r = &self.cells.region;
        // Cells of one pixel need no division.
        let cell = |px: usize| if r.pitch == 1 { px } else { px / r.pitch };
        x >= r.x_px && y >= r.y_px && self.mask().contains(cell(x - r.x_px), cell(y - r.y_px))
    }

    /// Whether a pixel of the instrument is known to have the depth of the surface around it, as a thin end has in a matcher's map.
    pub fn has_surface_depth(&self, x: usize, y: usize) -> bool {
        let r = &self.cells.region;
        if x < r.x_px || y < r.y_px {
            return false;
        }
        let (column, row) = ((x - r.x_px) / r.pitch, (y - r.y_px) / r.pitch);
        column < r.width && row < r.height && self.cells.near[row * r.width + column] < BEFORE
    }

    /// Log-likelihood ratios of the last instrument's learned colours for each pixel of a row (blue, green, red) of either view: above 0 instrument,
    /// below 0 tissue. `None` if no colours were learned.
    pub fn log_ratios(&self, row: &[u8], ratios: &mut Vec<f32>) -> Option<()> {
        if self.log_ratios.is_empty() {
            return None;
        }
        ratios.clear();
        let mut classes = [0; PIXELS_AT_ONCE];
        for pixels in row.as_chunks::<3>().0.chunks(PIXELS_AT_ONCE) {
            // A loop of its own, so that quotients and roots are computed side by side.
            for (class, pixel) in classes.iter_mut().zip(pixels) {
                let (redness, bright) = shade(pixel.map(f32::from));
                *class = class_of(redness, bright);
            }
            let ratio = |class: &i32| self.log_ratios.get(*class as usize).copied().unwrap_or_default();
            ratios.extend(classes.iter().take(pixels.len()).map(ratio));
        }
        Some(())
    }

    /// Converts a tip of [`Silhouette::mask`] to px of the image.
    pub fn place(&self, tip: TipPixel) -> TipPixel {
        let pitch = self.cells.region.pitch as f64;
        let to_px = |cell: f64, from: usize| from as f64 + (cell + 0.5) * pitch - 0.5;
        let end = |e: End| End {
            u_px: to_px(e.u_px, self.cells.region.x_px),
            v_px: to_px(e.v_px, self.cells.region.y_px),
            direction: e.direction,
        };
        TipPixel { tip: end(tip.tip), jaws: tip.jaws.map(|jaws| jaws.map(end)) }
    }

    /// Adds the score of redness: less red than around the box indicates an instrument.
    fn judge_redness(&mut self) -> bool {
        let Self { cells: Cells { redness, .. }, is_in_box, sorted, score, gray, tissue, .. } = self;
        gray.clear();
        gray.resize(redness.len(), f32::NAN);
        let outside =
            || redness.iter().zip(&*is_in_box).filter(|(_, is_in_box)| !**is_in_box).map(|(redness, _)| *redness);
        // A box as large as the picture has nothing around it: then most of it is tissue.
        let around = median(sorted, outside()).or_else(|| median(sorted, redness.iter().copied()));
        *tissue = around.map(|(centre, deviation)| (centre, deviation.max(REDNESS_FLOOR)));
        let Some((centre, deviation)) = *tissue else { return false };
        for ((score, gray), redness) in score.iter_mut().zip(gray).zip(redness.iter()).filter(|(_, r)| r.is_finite()) {
            *gray = (centre - redness) / deviation;
            *score += gray.clamp(MAX_AGAINST, MAX_FOR);
        }
        true
    }

    /// Applies the score of redness twice, and adds how much more often a colour occurs in the box than around it. Steel that mirrors tissue is
    /// hardly less red than pale tissue, but there is more of it in the box.
    fn judge_colours_alone(&mut self) {
        let Self { cells: Cells { redness, class, .. }, is_in_box, score, .. } = self;
        let class = |index: usize| redness[index].is_finite().then(|| usize::from(class[index]));
        // Cells of each colour around the box and in it.
        let mut counts = [[1.0_f32; COLOURS]; 2];
        for index in 0..score.len() {
            if let Some(class) = class(index) {
                counts[usize::from(is_in_box[index])][class] += 1.0;
            }
        }
        let [around, inside] = counts;
        let ratios = log_ratios(&inside, &around, MAX_SHARE);
        for (index, score) in score.iter_mut().enumerate() {
            if let Some(class) = class(index) {
                *score = ALONE * *score + ratios[class];
            }
        }
    }

    /// Adds the score of nearness: in front of the surface, a plane that is fitted after nearer cells are dropped.
    fn judge_nearness(&mut self) -> bool {
        let Self { cells: Cells { region, near, .. }, sorted, columns, score, .. } = self;
        let known = near.iter().filter(|v| v.is_finite()).count();
        if known * 2 < near.len() {
            return false;
        }
        let Some((centre, _)) = median(sorted, near.iter().copied()) else { return false };
        let floor = NEARNESS_FLOOR * centre;
        // Positions of columns and rows, -1 to 1.
        let middle_out = |count: usize| move |at: usize| f64::from(at as f32 / (count as f32 / 2.0) - 1.0);
        let (column, row) = (middle_out(region.width), middle_out(region.height));
        columns.clear();
        columns.extend((0..region.width).map(column));
        let columns = &*columns;
        let mut plane = [f64::from(centre), 0.0, 0.0];
        let over = |plane: &[f64; 3], p: [f64; 3], value: f32| {
            value - (plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2]) as f32
        };
        let mut deviation = f32::INFINITY;
        for round in 0..6 {
            let mut sums = Sums::default();
            for (y, values) in near.chunks_exact(region.width).enumerate() {
                let y = row(y);
                // Nearer things go first, those far behind later: the surface is what most cells lie on.
                sums.add_row(columns, values, y, |x, value| {
                    round == 0 || (-3.0 * deviation..=1.2 * deviation).contains(&over(&plane, [1.0, x, y], value))
                });
            }
            let (m, v) = sums.equations();
            let Some(fitted) = solve(m, v) else { break };
            plane = fitted;
            let rests = positions(near, columns, row).map(|(p, value)| over(&plane, p, value));
            let kept = rests.filter(|rest| round == 0 || (-3.0 * deviation..=1.2 * deviation).contains(rest));
            let Some((_, spread)) = median(sorted, kept) else { break };
            deviation = spread.max(floor);
        }
        if !deviation.is_finite() {
            return false;
        }
        for (y, (scores, values)) in
            score.chunks_exact_mut(region.width).zip(near.chunks_exact_mut(region.width)).enumerate()
        {
            let y = row(y);
            for ((score, value), x) in scores.iter_mut().zip(values).zip(columns).filter(|((_, v), _)| v.is_finite()) {
                // From here on in deviations before the surface.
                *value = over(&plane, [1.0, *x, y], *value) / deviation;
                *score += value.clamp(MAX_AGAINST, MAX_FOR);
            }
        }
        true
    }

    /// Learns the colours of instrument and surroundings from the present score, and computes the score of all cells again.
    fn learn_colours(&mut self) {
        let (mut tool, mut tissue) = ([1.0_f32; COLOURS], [1.0_f32; COLOURS]);
        // Pale tissue looks like steel, and tissue that bulges stands before the surface: where some cells are both gray and near, colours are learned
        // from those, else from gray ones, where there are any.
        let Self { cells: Cells { redness, near, .. }, is_in_box, gray, score, kind, .. } = self;
        kind.clear();
        let cues = redness.iter().zip(gray).zip(near);
        kind.extend(cues.zip(score.iter().zip(is_in_box)).map(|(((redness, gray), near), (score, is_in_box))| {
            let is_known = redness.is_finite();
            let is_tool = is_known & (*score > FIRST_GUESS) & *is_in_box;
            let is_gray = is_tool & (*gray > GRAY);
            let is_tissue = is_known & (*score < FIRST_GUESS / 2.0);
            let flags =
                [(is_tool, TOOL), (is_gray, GRAY_TOOL), (is_gray & (*near > BEFORE), NEAR_TOOL), (is_tissue, TISSUE)];
            flags.iter().map(|(is_set, flag)| u8::from(*is_set) * flag).sum::<u8>()
        }));
        let count = |flag: u8| kind.iter().filter(|kind| **kind & flag != 0).count();
        let (tools, grays, nears) = (count(TOOL), count(GRAY_TOOL), count(NEAR_TOOL));
        let learned = match () {
            () if nears * 4 > tools => NEAR_TOOL,
            () if grays * 4 > tools => GRAY_TOOL,
            () => TOOL,
        };
        for (kind, class) in self.kind.iter().zip(&self.cells.class) {
            if kind & learned != 0 {
                tool[usize::from(*class)] += 1.0;
            } else if kind & TISSUE != 0 {
                tissue[usize::from(*class)] += 1.0;
            }
        }
        self.log_ratios.clear();
        self.log_ratios.extend(log_ratios(&tool, &tissue, LOG_RATIO_LIMIT));
        self.colour.clear();
        self.colour.resize(self.score.len(), f32::NAN);
        for index in 0..self.score.len() {
            let mut log_ratio = 0.0;
            if self.cells.redness[index].is_finite() {
                log_ratio = self.log_ratios[usize::from(self.cells.class[index])];
                self.colour[index] = log_ratio;
            }
            // Both cues together, before anything was learned, say where; the learned colours say how far.
            self.score[index] =
                log_ratio + (self.first[index] - FIRST_GUESS).clamp(-LOG_RATIO_LIMIT, LOG_RATIO_LIMIT) + FIRST_GUESS;
        }
    }

    /// Smooths the score over 3 x 3 cells.
    fn blur(&mut self) {
        let (width, height) = (self.cells.region.width, self.cells.region.height);
        self.blurred.clear();
        self.blurred.resize(self.score.len(), 0.0);
        for (y, out) in self.blurred.chunks_exact_mut(width).enumerate() {
            let (first, last) = (y.saturating_sub(1), (y + 2).min(height));
            let rows = || self.score[first * width..last * width].chunks_exact(width);
            // Columns at either side have fewer neighbours; those between are added up side by side.
            if width >= 3 {
                let inner = &mut out[1..width - 1];
                for row in rows() {
                    for beside in [row, &row[1..], &row[2..]] {
                        inner.iter_mut().zip(beside).for_each(|(sum, score)| *sum += score);
                    }
                }
                let count = (3 * (last - first)) as f32;
                inner.iter_mut().for_each(|sum| *sum /= count);
            }
            for x in [0, width - 1] {
                let beside = x.saturating_sub(1)..(x + 2).min(width);
                let sum = rows().flat_map(|row| &row[beside.clone()]).fold(0.0, |sum, score| sum + score);
                out[x] = sum / (beside.len() * (last - first)) as f32;
            }
        }
        std::mem::swap(&mut self.score, &mut self.blurred);
    }

    /// Keeps the largest connected part, measured by its cells in the box.
    fn largest(&mut self) -> bool {
        let (width, height) = (self.cells.region.width, self.cells.region.height);
        let count = width * height;
        self.part.clear();
        self.part.resize(count, 0);
        let (mut parts, mut best, mut best_cells) = (0_u32, 0_u32, 0_usize);
        self.others.clear();
        for start in 0..count {
            if self.part[start] != 0 || self.score[start] <= FIRST_GUESS {
                continue;
            }
            parts += 1;
            let mut cells = 0;
            self.queue.clear();
            self.queue.push(start as u32);
            self.part[start] = parts;
            while let Some(index) = self.queue.pop() {
                let index = index as usize;
                cells += usize::from(self.is_in_box[index]);
                let (x, y) = (index % width, index / width);
                let beside = [
                    (x > 0).then(|| index - 1),
                    (x + 1 < width).then(|| index + 1),
                    (y > 0).then(|| index - width),
                    (y + 1 < height).then(|| index + width),
                ];
                for next in beside.into_iter().flatten() {
                    if self.part[next] == 0 && self.score[next] > FIRST_GUESS {
                        self.part[next] = parts;
                        self.queue.push(next as u32);
                    }
                }
            }
            self.others.push((parts, cells));
            if cells > best_cells {
                (best, best_cells) = (parts, cells);
            }
        }
        let own = self.cells.region.own;
        let share = best_cells as f32 / ((own[2] - own[0] + 1) * (own[3] - own[1] + 1)) as f32;
        if !(COVERS.0..=COVERS.1).contains(&share) {
            return false;
        }
        let row = width.div_ceil(8);
        self.bits.resize(row * height, 0);
        self.grow(best);
        self.join_jaw(best, best_cells);
        // What hangs together with it by colour outside the box is mostly tissue.
        let is_within = |index: usize| !self.is_by_colour || self.is_in_box[index];
        for (index, _) in self.part.iter().enumerate().filter(|(index, part)| **part == best && is_within(*index)) {
            let (x, y) = (index % width, index / width);
            self.bits[y * row + x / 8] |= 0x80 >> (x % 8);
        }
        true
    }

    /// Adds a second part as the other jaw, if the joint of both is outside the image or the box.
    fn join_jaw(&mut self, best: u32, best_cells: usize) {
        let is_gray = |part: u32| {
            let cells = || (0..self.part.len()).filter(|index| self.part[*index] == part);
            let gray = cells().filter(|index| self.gray.get(*index).is_some_and(|gray| *gray > GRAY)).count();
            gray as f32 > MAX_OF * cells().count() as f32
        };
        let large =
            self.others.iter().filter(|(part, cells)| *part != best && *cells as f32 > JAW_SHARE * best_cells as f32);
        let Some((jaw, _)) = large.max_by_key(|(_, cells)| *cells).copied() else { return };
        if self.colour.len() != self.part.len() || !is_gray(jaw) || !is_gray(best) {
            return;
        }
        self.part.iter_mut().filter(|part| **part == jaw).for_each(|part| *part = best);
        self.grow(best);
    }

    /// Adds connected cells with the instrument's colours: ends that are thinner than a matcher's window have the depth of the tissue behind them,
    /// and smoothing removes them.
    fn grow(&mut self, best: u32) {
        let (width, height) = (self.cells.region.width, self.cells.region.height);
        if self.colour.len() != self.part.len() {
            return;
        }
        self.queue.clear();
        self.queue.extend((0..self.part.len() as u32).filter(|index| self.part[*index as usize] == best));
        while let Some(index) = self.queue.pop() {
            let (x, y) = (index as usize % width, index as usize / width);
            for row in y.saturating_sub(1)..(y + 2).min(height) {
                for next in row * width + x.saturating_sub(1)..row * width + (x + 2).min(width) {
                    let is_glare = self.cells.bright[next] > GLARE;
                    if self.part[next] != best && self.colour[next] >= GROWS && self.gray[next] > GRAY && !is_glare {
                        self.part[next] = best;
                        self.queue.push(next as u32);
                    }
                }
            }
        }
    }
}
