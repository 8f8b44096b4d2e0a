//! The seam between the images joined so far and the next view, on a grid of cells (thesis Alg. 2.3).

use std::ops::RangeInclusive;

use super::graph_cut::GridCut;
use super::mesh::{Keep, Kept, Mesh};
use super::params::{Canvas, CompositeParams, SeamCost, SeamMethod};
use crate::geometry::length;

/// Coverage of a cell: bit 0 the previous images, bit 1 the new view.
pub const BASE: u8 = 1;
/// Bit of the new view in the coverage of a cell.
pub const NEW: u8 = 2;
/// Covered by both.
pub const BOTH: u8 = 3;

/// Capacities are levels times this.
const UNIT: f32 = 64.0;
/// Additional cost per cell boundary, levels; keeps seams short in uniform areas.
const LENGTH_LEVELS: f32 = 1.0;
/// Levels that a pixel of doubt about where the views match adds to the cost of a cell.
const DOUBT_LEVELS: f32 = 4.0;
/// Doubt per pixel by which the reference view is moved.
const MOVED_DOUBT: f32 = 1.0;
/// Cost in levels of a cell that does not show the required view, more than any seam around it; lower where an
/// instrument is only likely.
const KEPT_LEVELS: f32 = 2000.0;
const LIKELY_LEVELS: f32 = 6.0;
/// Cost factor of a seam on the rim of the overlap, where there is no space to blend.
const RIM: f32 = 3.0;

/// Reach of a transition on each side of the seam, px.
const BESIDE_PX: f64 = 16.0;

/// Displacement of the reference view at a position, or within a transition's reach of it.
fn moved_px(reference: &Mesh, [low, high]: [[f64; 2]; 2], at: [f64; 2]) -> f64 {
    let mut most = 0.0f64;
    for step in [[0.0, 0.0], [BESIDE_PX, 0.0], [-BESIDE_PX, 0.0], [0.0, BESIDE_PX], [0.0, -BESIDE_PX]] {
        let near = [at[0] + step[0], at[1] + step[1]];
        if (0..2).all(|k| near[k] > low[k] && near[k] < high[k])
            && let Some(shown) = reference.map(near)
        {
            most = most.max(length([shown[0] - near[0], shown[1] - near[1]]));
        }
    }
    most
}

/// Whether a cell must be shown by the new view or by the previous ones, and the cost if it is not, levels; `None` if
/// both are allowed.
fn must_take(kept: &[Keep], cell: usize) -> Option<(bool, f32)> {
    let Keep { view, is_sure } = *kept.get(cell)?;
    let levels = if is_sure { KEPT_LEVELS } else { LIKELY_LEVELS };
    match view {
        Kept::Reference => Some((false, levels)),
        Kept::Other => Some((true, levels)),
        Kept::Free => None,
    }
}

/// Which cells show the new view instead of the previous ones.
#[derive(Debug, Default)]
pub struct Seam {
    /// Cells per row.
    pub columns: usize,
    /// Rows of cells.
    pub rows: usize,
    /// Coverage of each cell.
    pub class: Vec<u8>,
    /// Colour difference per cell, levels.
    pub cost: Vec<f32>,
    /// Gradient per cell, levels.
    pub gradient: Vec<f32>,
    /// Additional cost per cell for the uncertainty of the views' match, levels.
    doubt: Vec<f32>,
    /// The view that must show each cell; empty where all are free.
    kept: Vec<Keep>,
    /// 1 where the new view is shown.
    pub take: Vec<u8>,
    known: bool,
    age_frames: u32,
    cost_found: f32,
    weight: Vec<f32>,
    path_cost: Vec<f32>,
    path_from: Vec<u32>,
    path: Vec<u32>,
    /// Per crossing of a line: the minimum cost of a path to it from the previous line, and its predecessor.
    arrivals: Vec<(f32, u32)>,
    /// Per row of cells: first column, one past the last column and one past the last row of the label changes.
    changes: Vec<(usize, usize, usize)>,
}

/// How a seam crosses the overlap: lines are rows if the views are side by side, else columns.
struct Lines {
    upright: bool,
    columns: usize,
    /// Cells of a line.
    cells: usize,
}

impl Lines {
    fn index(&self, line: usize, cell: usize) -> usize {
        if self.upright { line * self.columns + cell } else { cell * self.columns + line }
    }
}

impl Seam {
    /// Clears the seam; the next frame finds a new one.
    pub fn forget(&mut self) {
        self.known = false;
    }

    /// Reserves memory for a grid of this size, the solver's included.
    pub fn reserve(&mut self, columns: usize, rows: usize, cut: &mut GridCut) {
        let path = columns.max(rows) * (columns.min(rows) + 1) + columns.max(rows);
        self.path_cost.reserve(path.saturating_sub(self.path_cost.len()));
        self.path_from.reserve(path.saturating_sub(self.path_from.len()));
        self.path.reserve(columns.max(rows).saturating_sub(self.path.len()));
        self.arrivals.reserve((columns.max(rows) + 1).saturating_sub(self.arrivals.len()));
        self.changes.reserve(rows.saturating_sub(self.changes.len()));
        self.kept.reserve((columns * rows).saturating_sub(self.kept.len()));
        cut.reserve(columns * rows);
    }

    /// Sets the size of the grid; a change of size forgets the seam.
    pub fn resize(&mut self, columns: usize, rows: usize) {
        let n = columns * rows;
        if (columns, rows) != (self.columns, self.rows) {
            self.known = false;
            self.take.clear();
        }
        (self.columns, self.rows) = (columns, rows);
        self.take.resize(n, 0);
        for f in [&mut self.cost, &mut self.gradient, &mut self.weight, &mut self.doubt, &mut self.path_cost] {
            f.resize(n.max(columns + 1), 0.0);
        }
        self.class.resize(n, 0);
    }

    /// Sets the uncertainty of a mesh; `None` for a view that is placed by a homography. Must be called after
    /// [`Seam::resize`].
    ///
    /// `reference`: the mesh of the reference view. Where it moves that view, the panorama shows neither camera's
    /// perspective, so the seam avoids these regions.
    pub fn doubt(&mut self, mesh: Option<&Mesh>, reference: Option<&Mesh>, canvas: Canvas, scale: usize) {
        let Some(mesh) = mesh else { return self.doubt.fill(0.0) };
        let moved = reference.and_then(|mesh| Some((mesh, mesh.moved()?)));
        for y in 0..self.rows {
            for x in 0..self.columns {
                // A seam runs between cells that both views cover.
                if self.class[y * self.columns + x] != BOTH {
                    self.doubt[y * self.columns + x] = 0.0;
                    continue;
                }
                let middle = |cell: usize, origin: i32| (cell as f32 + 0.5) * scale as f32 - origin as f32;
                let at = [middle(x, canvas.left), middle(y, canvas.top)];
                let mut doubt_px = mesh.doubt_px(at);
                if let Some((reference, bounds)) = moved {
                    doubt_px += MOVED_DOUBT * moved_px(reference, bounds, at.map(f64::from)) as f32;
                }
                self.doubt[y * self.columns + x] = DOUBT_LEVELS * doubt_px;
            }
        }
    }

    /// Sets the view that must show each cell, so that instruments are shown completely. Must be called after
    /// [`Seam::resize`].
    pub fn keep(&mut self, mesh: Option<&Mesh>, canvas: Canvas, scale: usize) {
        self.kept.clear();
        let Some(mesh) = mesh.filter(|mesh| mesh.keeps_any()) else { return };
        for y in 0..self.rows {
            let middle = |cell: usize, origin: i32| (cell as f32 + 0.5) * scale as f32 - origin as f32;
            let row = middle(y, canvas.top);
            self.kept.extend((0..self.columns).map(|x| mesh.kept_at([middle(x, canvas.left), row])));
        }
    }

    /// Whether a cell of the overlap with a certain instrument shows the wrong view.
    fn is_cut(&self) -> bool {
        let must = |cell: usize| must_take(&self.kept, cell).filter(|_| self.kept[cell].is_sure);
        let is_wrong = |cell: usize| must(cell).is_some_and(|(new, _)| new != (self.take[cell] == 1));
        (0..self.kept.len()).any(|cell| self.class[cell] == BOTH && is_wrong(cell))
    }

    /// Mean colour difference at the cells on both sides of the seam inside the overlap, levels.
    pub fn cost_along(&self) -> f32 {
        let (mut sum, mut count) = (0.0f64, 0u32);
        let mut add = |p: usize, q: usize| {
            if self.class[p] == BOTH && self.class[q] == BOTH && self.take[p] != self.take[q] {
                sum += f64::from(self.cost[p] + self.cost[q]);
                count += 2;
            }
        };
        for y in 0..self.rows {
            for x in 0..self.columns {
                let p = y * self.columns + x;
                if x + 1 < self.columns {
                    add(p, p + 1);
                }
                if y + 1 < self.rows {
                    add(p, p + self.columns);
                }
            }
        }
        if count == 0 { 0.0 } else { (sum / f64::from(count)) as f32 }
    }

    /// Updates the labels of cells with sides of `cell_px`: finds a new seam if due and `may_find`, else keeps the old
    /// one. Returns whether it found one.
    pub fn update(
        &mut self,
        params: &CompositeParams,
        cell_px: usize,
        strip: bool,
        may_find: bool,
        cut: &mut GridCut,
    ) -> bool {
        let found = self.label(params, cell_px, strip, may_find, cut);
        self.find_changes();
        found
    }

    /// Whether [`Seam::update`] finds a new seam in this frame, whose costs are known: only then it reads what
    /// [`Seam::doubt`] sets.
    pub fn is_due(&self, params: &CompositeParams, may_find: bool) -> bool {
        let is_old = self.age_frames.saturating_add(1) >= params.seam_interval_frames.max(1)
            || self.cost_along() > self.cost_found * params.seam_cost_growth.max(1.0) + 2.0;
        !self.known || (may_find && (is_old || self.is_cut()))
    }

    fn label(
        &mut self,
        params: &CompositeParams,
        cell_px: usize,
        strip: bool,
        may_find: bool,
        cut: &mut GridCut,
    ) -> bool {
        for (take, class) in self.take.iter_mut().zip(&self.class) {
            match *class {
                BASE => *take = 0,
                NEW => *take = 1,
                BOTH if params.seam == SeamMethod::None => *take = 1,
                _ => {}
            }
        }
        if params.seam == SeamMethod::None {
            return !std::mem::replace(&mut self.known, true);
        }
        if !self.is_due(params, may_find) {
            self.age_frames = self.age_frames.saturating_add(1);
            return false;
        }
        if params.seam_cost == SeamCost::Transition {
            self.gather(params.blend_px / 2 / cell_px);
        }
        for i in 0..self.columns * self.rows {
            self.weight[i] = match params.seam_cost {
                SeamCost::Color => self.cost[i],
                SeamCost::ColorGradient => self.cost[i] / (1.0 + self.gradient[i] / 32.0),
                SeamCost::Transition => self.cost[i].max(self.weight[i]),
            } + self.doubt[i];
        }
        let hold = if self.known { params.seam_hold_levels.clamp(0.0, 255.0) } else { 0.0 };
        if params.seam == SeamMethod::DynamicProgramming && strip {
            self.shortest_path(hold);
        } else {
            self.minimum_cut(hold, cut);
        }
        self.known = true;
        self.age_frames = 0;
        self.cost_found = self.cost_along();
        true
    }

    /// Sets the weight of each cell of the overlap to the mean cost of those within `reach` cells.
    fn gather(&mut self, reach: usize) {
        let (w, h) = (self.columns, self.rows);
        for y in 0..h {
            for x in 0..w {
                let (mut sum, mut count) = (0.0, 0.0);
                for row in y.saturating_sub(reach)..(y + reach + 1).min(h) {
                    for p in row * w + x.saturating_sub(reach)..row * w + (x + reach + 1).min(w) {
                        let counts = f32::from(u8::from(self.class[p] == BOTH));
                        (sum, count) = (sum + counts * self.cost[p], count + counts);
                    }
                }
                self.weight[y * w + x] = if count > 0.0 { sum / count } else { 0.0 };
            }
        }
    }

    /// Cost of a seam between two neighbouring cells, or `None` if either is outside the overlap and none is needed.
    fn price(&self, p: usize, q: usize) -> Option<f32> {
        match (self.class[p], self.class[q]) {
            (BOTH, BOTH) => Some(self.weight[p] + self.weight[q] + LENGTH_LEVELS),
            (BOTH, BASE | NEW) => Some(RIM * (2.0 * self.weight[p] + LENGTH_LEVELS)),
            (BASE | NEW, BOTH) => Some(RIM * (2.0 * self.weight[q] + LENGTH_LEVELS)),
            _ => None,
        }
    }

    fn minimum_cut(&mut self, hold: f32, cut: &mut GridCut) {
        let (w, h) = (self.columns, self.rows);
        // Only the bounds of the overlap enter the graph.
        let (mut x0, mut x1, mut y0, mut y1) = (w, 0, h, 0);
        for y in 0..h {
            for x in 0..w {
                if self.class[y * w + x] == BOTH {
                    (x0, x1, y0, y1) = (x0.min(x), x1.max(x + 1), y0.min(y), y1.max(y + 1));
                }
            }
        }
        if x0 >= x1 {
            return;
        }
        let (gw, gh) = (x1 - x0, y1 - y0);
        cut.reset(gw, gh);
        for y in y0..y1 {
            for x in x0..x1 {
                let (p, node) = (y * w + x, (y - y0) * gw + x - x0);
                if self.class[p] != BOTH {
                    continue;
                }
                if let Some((is_new, levels)) = must_take(&self.kept, p) {
                    let kept = (levels * UNIT) as i32;
                    let [base, new] = if is_new { [0, kept] } else { [kept, 0] };
                    cut.add_terminal(node, base, new);
                }
                let bias = (hold * UNIT) as i32;
                if self.take[p] == 0 {
                    cut.add_terminal(node, bias, 0);
                } else {
                    cut.add_terminal(node, 0, bias);
                }
                let side = |cut: &mut GridCut, q: usize, node: usize, edge: Option<bool>| {
                    let Some(price) = self.price(p, q) else { return };
                    let price = (price * UNIT) as i32;
                    match (self.class[q], edge) {
                        (BOTH, Some(down)) => cut.add_edge(node, down, price),
                        (BASE, _) => cut.add_terminal(node, price, 0),
                        (NEW, _) => cut.add_terminal(node, 0, price),
                        _ => {}
                    }
                };
                if x + 1 < w {
                    side(cut, p + 1, node, Some(false));
                }
                if y + 1 < h {
                    side(cut, p + w, node, Some(true));
                }
                if x > 0 {
                    side(cut, p - 1, node, None);
                }
                if y > 0 {
                    side(cut, p - w, node, None);
                }
            }
        }
        cut.solve();
        for y in y0..y1 {
            for x in x0..x1 {
                if self.class[y * w + x] == BOTH {
                    self.take[y * w + x] = u8::from(cut.is_sink((y - y0) * gw + x - x0));
                }
            }
        }
    }

    /// Mean cell of those that only the base and only the new view covers; `None` where there are none.
    fn centres(&self) -> [Option<(f64, f64)>; 2] {
        let mut sums = [[0.0f64; 3]; 2];
        for (index, class) in self.class.iter().enumerate() {
            let side = match *class {
                BASE => 0,
                NEW => 1,
                _ => continue,
            };
            let at = [(index % self.columns) as f64, (index / self.columns) as f64, 1.0];
            sums[side].iter_mut().zip(at).for_each(|(sum, value)| *sum += value);
        }
        sums.map(|[x, y, count]| (count > 0.0).then_some((x / count, y / count)))
    }

    /// Finds the cheapest way to each crossing of a line from the crossings `reached` of the line above it.
    fn arrive(
        &mut self,
        lines: &Lines,
        [above, line]: [usize; 2],
        (from, to): (usize, usize),
        (low, high): (usize, usize),
    ) {
        let stride = lines.cells + 1;
        // Moving sideways parts each cell passed from the one above it.
        let step = |c: usize| {
            let here = self.weight[lines.index(line, c)];
            let there = if c >= from && c < to { self.weight[lines.index(above, c)] } else { here };
            here + there + LENGTH_LEVELS
        };
        let start = |p: usize| if (from..=to).contains(&p) { self.path_cost[above * stride + p] } else { f32::MAX };
        // From the crossings at `x` and to the right of it.
        let mut best = (f32::MAX, from as u32);
        for x in (low..=high.max(to)).rev() {
            let (straight, along) = (start(x), best.0 + if x < lines.cells { step(x) } else { 0.0 });
            best = if straight <= along { (straight, x as u32) } else { (along, best.1) };
            if x <= high {
                self.arrivals[x - low] = best;
            }
        }
        // And from those to the left of it.
        best = (f32::MAX, from as u32);
        for x in low.min(from) + 1..=high {
            let before = start(x - 1);
            best = if before <= best.0 { (before, x as u32 - 1) } else { best };
            best.0 += step(x - 1);
            if x >= low && best.0 < self.arrivals[x - low].0 {
                self.arrivals[x - low] = best;
            }
        }
    }

    /// One crossing per line of the overlap; lines are rows if the views are side by side, else columns.
    fn shortest_path(&mut self, hold: f32) {
        let (w, h) = (self.columns, self.rows);
        let [a, b] = match self.centres() {
            [Some(base), Some(new)] => [base, new],
            [base, _] => {
                // One picture covers the other: a seam gains nothing.
                let inside = u8::from(base.is_none());
                self.take.iter_mut().zip(&self.class).filter(|(_, c)| **c == BOTH).for_each(|(t, _)| *t = inside);
                return;
            }
        };
        let upright = (b.0 - a.0).abs() >= (b.1 - a.1).abs();
        let new_last = if upright { b.0 >= a.0 } else { b.1 >= a.1 };
        let (count, cells) = if upright { (h, w) } else { (w, h) };
        let lines = Lines { upright, columns: w, cells };
        let index = |line: usize, cell: usize| lines.index(line, cell);
        let stride = cells + 1;
        self.path_cost.resize(count * stride, 0.0);
        self.path_from.resize(count * stride, 0);
        self.path.resize(count, 0);
        let range = |class: &[u8], line: usize| {
            let both = |c: &usize| class[index(line, *c)] == BOTH;
            Some(((0..cells).find(both)?, (0..cells).rev().find(both)? + 1))
        };
        let (mut first, mut last): (Option<usize>, Option<usize>) = (None, None);
        for line in 0..count {
            let Some((low, high)) = range(&self.class, line) else {
                if first.is_some() {
                    break;
                }
                continue;
            };
            let above = last.and_then(|l| range(&self.class, l).map(|r| (l, r)));
            first = first.or(Some(line));
            self.arrivals.clear();
            self.arrivals.resize(high + 1 - low, (0.0, 0));
            if let Some((above, reached)) = above {
                self.arrive(&lines, [above, line], reached, (low, high));
            }
            // Levels of the cells that show the wrong view when all lie behind the crossing; then one after the other lies before it.
            let (kept, class) = (&self.kept, &self.class);
            let is_wrong = |c: usize, is_behind: bool| {
                let must = must_take(kept, index(line, c)).filter(|_| class[index(line, c)] == BOTH);
                must.filter(|(new, _)| *new != (is_behind == new_last)).map_or(0.0, |(_, levels)| levels)
            };
            let mut wrong: f32 = if self.kept.is_empty() { 0.0 } else { (low..high).map(|c| is_wrong(c, true)).sum() };
            // Cells that change their view when all lie behind the crossing; then one after the other lies before it.
            let takes = |c: usize| self.take[index(line, c)] == 1;
            let mut changed = (low..high).filter(|c| takes(*c) != new_last).count();
            for x in low..=high {
                if x > low {
                    changed = if takes(x - 1) == new_last { changed + 1 } else { changed - 1 };
                    if !self.kept.is_empty() {
                        wrong += is_wrong(x - 1, false) - is_wrong(x - 1, true);
                    }
                }
                let mut own = match x {
                    x if x == low => RIM * (2.0 * self.weight[index(line, low)] + LENGTH_LEVELS),
                    x if x == high => RIM * (2.0 * self.weight[index(line, high - 1)] + LENGTH_LEVELS),
                    _ => self.weight[index(line, x - 1)] + self.weight[index(line, x)] + LENGTH_LEVELS,
                };
                own += hold * changed as f32 + wrong;
                let (arrived, from) = if above.is_some() { self.arrivals[x - low] } else { (0.0, x as u32) };
                self.path_cost[line * stride + x] = arrived + own;
                self.path_from[line * stride + x] = from;
            }
            last = Some(line);
        }
        let (Some(first), Some(last)) = (first, last) else { return };
        if let Some(ends) = range(&self.class, last) {
            self.trace_back(&lines, first..=last, ends, new_last);
        }
    }

    /// Cuts the overlap along the cheapest path, from its crossing of the last line, which is inside `ends`, back to the first one.
    fn trace_back(
        &mut self,
        lines: &Lines,
        crossed: RangeInclusive<usize>,
        (low, high): (usize, usize),
        new_last: bool,
    ) {
        let stride = lines.cells + 1;
        let last = *crossed.end() * stride;
        let mut at =
            (low..=high).fold(low, |b, x| if self.path_cost[last + x] < self.path_cost[last + b] { x } else { b });
        for line in crossed.clone().rev() {
            self.path[line] = at as u32;
            at = self.path_from[line * stride + at] as usize;
        }
        for line in crossed {
            for cell in 0..lines.cells {
                let index = lines.index(line, cell);
                if self.class[index] == BOTH {
                    self.take[index] = u8::from((cell >= self.path[line] as usize) == new_last);
                }
            }
        }
    }

    /// Finds where labels change, row of cells by row. Must be called after [`Seam::update`].
    fn find_changes(&mut self) {
        let (w, h) = (self.columns, self.rows);
        self.changes.clear();
        let differs = |p: usize, q: usize| self.class[p] != 0 && self.class[q] != 0 && self.take[p] != self.take[q];
        for y in 0..h {
            let (mut x0, mut x1, mut down_any) = (w, 0, false);
            for p in y * w..(y + 1) * w {
                let x = p - y * w;
                let (right, down) = (x + 1 < w && differs(p, p + 1), y + 1 < h && differs(p, p + w));
                if right || down {
                    (x0, x1) = (x0.min(x), x1.max(x + 1 + usize::from(right)));
                    down_any |= down;
                }
            }
            self.changes.push((x0, x1, y + 1 + usize::from(down_any)));
        }
    }

    /// Bounds (x0, y0, x1, y1; ends excluded) of the cells that touch a change of view.
    pub fn bounds(&self) -> Option<(usize, usize, usize, usize)> {
        self.bounds_of(0, self.rows)
    }

    /// As [`Seam::bounds`], for the changes that start in the rows of cells `first..end`.
    pub fn bounds_of(&self, first: usize, end: usize) -> Option<(usize, usize, usize, usize)> {
        let mut bounds: Option<(usize, usize, usize, usize)> = None;
        for (y, (x0, x1, y1)) in self.changes.iter().enumerate().take(end).skip(first) {
            if x0 < x1 {
                let b = bounds.unwrap_or((*x0, y, *x1, *y1));
                bounds = Some((b.0.min(*x0), b.1, b.2.max(*x1), b.3.max(*y1)));
            }
        }
        bounds
    }

    /// Columns at which canvas row `y` changes view, and whether it starts with the new one. Labels are interpolated
    /// between cell centres and thresholded at one half, so that the enlarged seam has no steps. Only cells
    /// `first..end` are examined: labels must not change elsewhere (see [`Seam::bounds`]).
    pub fn crossings(
        &self,
        y: usize,
        scale: usize,
        (first, end): (usize, usize),
        values: &mut Vec<f32>,
        columns: &mut Vec<u32>,
    ) -> bool {
        let (w, h) = (self.columns, self.rows);
        let at = ((y as f32 + 0.5) / scale as f32 - 0.5).clamp(0.0, (h - 1) as f32);
        let above = (at as usize).min(h - 1);
        let below = (above + 1).min(h - 1);
        let t = at - above as f32;
        values.clear();
        for x in first..end {
            let (p, q) = (above * w + x, below * w + x);
            values.push(match (self.class[p] != 0, self.class[q] != 0) {
                (true, true) => f32::from(self.take[p]) * (1.0 - t) + f32::from(self.take[q]) * t,
                (true, false) => f32::from(self.take[p]),
                (false, true) => f32::from(self.take[q]),
                (false, false) => f32::NAN,
            });
        }
        columns.clear();
        let mut previous: Option<(usize, f32)> = None;
        let mut starts_new = false;
        for x in first..end {
            let v = values[x - first];
            if v.is_nan() {
                continue;
            }
            if let Some((px, pv)) = previous {
                if (pv >= 0.5) != (v >= 0.5) {
                    let cell = px as f32 + (0.5 - pv) / (v - pv) * (x - px) as f32;
                    columns.push(((cell + 0.5) * scale as f32 - 0.5).ceil().max(0.0) as u32);
                }
            } else {
                starts_new = v >= 0.5;
            }
            previous = Some((x, v));
        }
        starts_new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transition_keeps_away_from_a_highlight_that_one_view_has() {
        let (columns, rows) = (20, 12);
        let crossing = |seam_cost: SeamCost, blend_px: usize| {
            let mut seam = Seam::default();
            seam.resize(columns, rows);
            for i in 0..columns * rows {
                let x = i % columns;
                seam.class[i] = match x {
                    0 => BASE,
                    19 => NEW,
                    _ => BOTH,
                };
                // Nothing differs beside the highlight; further off a little does.
                seam.cost[i] = match x {
                    10 | 11 => 100.0,
                    8 | 9 => 0.0,
                    3 | 4 => 2.0,
                    _ => 8.0,
                };
            }
            let params = CompositeParams {
                seam: SeamMethod::DynamicProgramming,
                seam_cost,
                blend_px,
                seam_scale: 10,
                ..CompositeParams::default()
            };
            assert!(seam.update(&params, 10, true, true, &mut GridCut::default()));
            seam.take[..columns].iter().position(|take| *take == 1).expect("a crossing")
        };
        assert_eq!(crossing(SeamCost::Color, 24), 9);
        assert_eq!(crossing(SeamCost::Transition, 24), 4);
        assert_eq!(crossing(SeamCost::Transition, 8), 9, "a narrow transition does not reach it");
    }
}
