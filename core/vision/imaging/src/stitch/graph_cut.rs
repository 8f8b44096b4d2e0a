//! Exact minimum cut on a 4-connected grid (Boykov and Kolmogorov 2004: two search trees that are
//! kept and repaired between augmentations).

const NONE: u8 = 4;
const TERMINAL: u8 = 5;
const ORPHAN: u8 = 6;

const FREE: u8 = 0;
const SOURCE: u8 = 1;
const SINK: u8 = 2;

/// Minimum cut of a `width` x `height` grid; capacities are whole numbers, so the result is exact.
///
/// Set capacities with [`GridCut::reset`], [`GridCut::add_terminal`] and [`GridCut::add_edge`], then
/// [`GridCut::solve`].
#[derive(Debug, Default)]
pub struct GridCut {
    width: usize,
    height: usize,
    /// Residual capacity to the neighbour right, down, left, up.
    residual: [Vec<i32>; 4],
    /// Residual to the terminals: positive from the source, negative to the sink.
    terminal: Vec<i64>,
    tree: Vec<u8>,
    /// Direction of the parent, or `NONE`, `TERMINAL`, `ORPHAN`.
    parent: Vec<u8>,
    distance: Vec<u32>,
    stamp: Vec<u32>,
    clock: u32,
    active: std::collections::VecDeque<u32>,
    queued: Vec<bool>,
    orphans: std::collections::VecDeque<u32>,
    flow: i64,
}

impl GridCut {
    /// Reserves memory for grids of up to `count` nodes.
    pub fn reserve(&mut self, count: usize) {
        fn room<T>(v: &mut Vec<T>, count: usize) {
            v.reserve(count.saturating_sub(v.len()));
        }
        self.residual.iter_mut().for_each(|r| room(r, count));
        room(&mut self.terminal, count);
        room(&mut self.tree, count);
        room(&mut self.parent, count);
        room(&mut self.distance, count);
        room(&mut self.stamp, count);
        room(&mut self.queued, count);
        self.active.reserve(count.saturating_sub(self.active.len()));
        self.orphans.reserve(count.saturating_sub(self.orphans.len()));
    }

    /// Starts a grid without any capacity.
    pub fn reset(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        let count = width * height;
        for r in &mut self.residual {
            r.clear();
            r.resize(count, 0);
        }
        self.terminal.clear();
        self.terminal.resize(count, 0);
        self.tree.clear();
        self.tree.resize(count, FREE);
        self.parent.clear();
        self.parent.resize(count, NONE);
        self.distance.clear();
        self.distance.resize(count, 0);
        self.stamp.clear();
        self.stamp.resize(count, 0);
        self.queued.clear();
        self.queued.resize(count, false);
        self.active.clear();
        self.active.reserve(count);
        self.orphans.clear();
        self.orphans.reserve(count);
        self.clock = 0;
        self.flow = 0;
    }

    /// Adds the cost of `node` on the sink's side (`source`) and on the source's side (`sink`).
    pub fn add_terminal(&mut self, node: usize, source: i32, sink: i32) {
        let (source, sink) = (i64::from(source.max(0)), i64::from(sink.max(0)));
        let have = self.terminal[node];
        let (s, t) = (source + have.max(0), sink + (-have).max(0));
        self.flow += s.min(t);
        self.terminal[node] = s - t;
    }

    /// Adds the cost of separating `node` from its right (`down == false`) or lower neighbour, the same both ways.
    pub fn add_edge(&mut self, node: usize, down: bool, capacity: i32) {
        let (direction, back, other) = if down { (1, 3, node + self.width) } else { (0, 2, node + 1) };
        self.residual[direction][node] += capacity.max(0);
        self.residual[back][other] += capacity.max(0);
    }

    /// Finds the minimum cut and returns its cost.
    pub fn solve(&mut self) -> i64 {
        for node in 0..self.terminal.len() {
            if self.terminal[node] != 0 {
                self.tree[node] = if self.terminal[node] > 0 { SOURCE } else { SINK };
                self.parent[node] = TERMINAL;
                self.distance[node] = 1;
                self.activate(node);
            }
        }
        while let Some(&front) = self.active.front() {
            let node = front as usize;
            if self.tree[node] == FREE {
                self.active.pop_front();
                self.queued[node] = false;
                continue;
            }
            match self.grow(node) {
                Some((from, direction)) => {
                    self.clock += 1;
                    self.augment(from, direction);
                    while let Some(orphan) = self.orphans.pop_front() {
                        self.adopt(orphan as usize);
                    }
                }
                None => {
                    self.active.pop_front();
                    self.queued[node] = false;
                }
            }
        }
        self.flow
    }

    /// True when `node` ended on the sink's side. Undetermined nodes go to the source's side.
    pub fn is_sink(&self, node: usize) -> bool {
        self.tree[node] == SINK
    }

    fn neighbour(&self, node: usize, direction: usize) -> Option<usize> {
        let x = node % self.width;
        match direction {
            0 => (x + 1 < self.width).then_some(node + 1),
            1 => (node + self.width < self.width * self.height).then_some(node + self.width),
            2 => (x > 0).then(|| node - 1),
            _ => (node >= self.width).then(|| node - self.width),
        }
    }

    fn activate(&mut self, node: usize) {
        if !self.queued[node] {
            self.queued[node] = true;
            self.active.push_back(node as u32);
        }
    }

    /// Residual capacity of the edge along which flow would pass between `node` (in `tree`) and its child `other`.
    fn open(&self, tree: u8, node: usize, direction: usize, other: usize) -> i32 {
        if tree == SOURCE { self.residual[direction][node] } else { self.residual[direction ^ 2][other] }
    }

    /// Grows the tree at `node`; an edge from the source's tree to the sink's is given as (node, direction).
    fn grow(&mut self, node: usize) -> Option<(usize, usize)> {
        let tree = self.tree[node];
        for direction in 0..4 {
            let Some(other) = self.neighbour(node, direction) else { continue };
            if self.open(tree, node, direction, other) == 0 {
                continue;
            }
            if self.tree[other] == FREE {
                self.tree[other] = tree;
                self.parent[other] = (direction ^ 2) as u8;
                self.distance[other] = self.distance[node] + 1;
                self.stamp[other] = self.stamp[node];
                self.activate(other);
            } else if self.tree[other] != tree {
                return Some(if tree == SOURCE { (node, direction) } else { (other, direction ^ 2) });
            } else if self.stamp[other] <= self.stamp[node] && self.distance[other] > self.distance[node] + 1 {
                self.parent[other] = (direction ^ 2) as u8;
                self.distance[other] = self.distance[node] + 1;
                self.stamp[other] = self.stamp[node];
            }
        }
        None
    }

    fn augment(&mut self, from: usize, direction: usize) {
        let Some(to) = self.neighbour(from, direction) else { return };
        let mut push = i64::from(self.residual[direction][from]);
        let mut node = from;
        while self.parent[node] != TERMINAL {
            let p = self.parent[node] as usize;
            let Some(up) = self.neighbour(node, p) else { return };
            push = push.min(i64::from(self.residual[p ^ 2][up]));
            node = up;
        }
        push = push.min(self.terminal[node]);
        node = to;
        while self.parent[node] != TERMINAL {
            let p = self.parent[node] as usize;
            let Some(up) = self.neighbour(node, p) else { return };
            push = push.min(i64::from(self.residual[p][node]));
            node = up;
        }
        push = push.min(-self.terminal[node]);
        // `push` is at most one edge's residual, which is an i32.
        let step = push as i32;
        self.residual[direction][from] -= step;
        self.residual[direction ^ 2][to] += step;
        node = from;
        while self.parent[node] != TERMINAL {
            let p = self.parent[node] as usize;
            let Some(up) = self.neighbour(node, p) else { return };
            self.residual[p ^ 2][up] -= step;
            self.residual[p][node] += step;
            if self.residual[p ^ 2][up] == 0 {
                self.parent[node] = ORPHAN;
                self.orphans.push_front(node as u32);
            }
            node = up;
        }
        self.terminal[node] -= push;
        if self.terminal[node] == 0 {
            self.parent[node] = ORPHAN;
            self.orphans.push_front(node as u32);
        }
        node = to;
        while self.parent[node] != TERMINAL {
            let p = self.parent[node] as usize;
            let Some(up) = self.neighbour(node, p) else { return };
            self.residual[p][node] -= step;
            self.residual[p ^ 2][up] += step;
            if self.residual[p][node] == 0 {
                self.parent[node] = ORPHAN;
                self.orphans.push_front(node as u32);
            }
            node = up;
        }
        self.terminal[node] += push;
        if self.terminal[node] == 0 {
            self.parent[node] = ORPHAN;
            self.orphans.push_front(node as u32);
        }
        self.flow += push;
    }

    /// Steps from `node` to its tree's terminal, or `None` when the path ends at an orphan.
    fn origin(&mut self, node: usize) -> Option<u32> {
        let mut at = node;
        let mut steps = 0;
        loop {
            if self.stamp[at] == self.clock {
                steps += self.distance[at];
                break;
            }
            steps += 1;
            match self.parent[at] {
                TERMINAL => {
                    self.stamp[at] = self.clock;
                    self.distance[at] = 1;
                    break;
                }
                ORPHAN | NONE => return None,
                p => at = self.neighbour(at, p as usize)?,
            }
        }
        // Marks the path, so that the next search stops early.
        let (mut mark, mut left) = (node, steps);
        while self.stamp[mark] != self.clock {
            self.stamp[mark] = self.clock;
            self.distance[mark] = left;
            left -= 1;
            mark = self.neighbour(mark, self.parent[mark] as usize)?;
        }
        Some(steps)
    }

    fn adopt(&mut self, node: usize) {
        let tree = self.tree[node];
        let mut best: Option<(u32, usize)> = None;
        for direction in 0..4 {
            let Some(other) = self.neighbour(node, direction) else { continue };
            if self.tree[other] != tree || self.open(tree, other, direction ^ 2, node) == 0 {
                continue;
            }
            if let Some(steps) = self.origin(other)
                && best.is_none_or(|(b, _)| steps < b)
            {
                best = Some((steps, direction));
            }
        }
        if let Some((steps, direction)) = best {
            self.parent[node] = direction as u8;
            self.stamp[node] = self.clock;
            self.distance[node] = steps + 1;
            return;
        }
        self.stamp[node] = 0;
        for direction in 0..4 {
            let Some(other) = self.neighbour(node, direction) else { continue };
            if self.tree[other] != tree {
                continue;
            }
            if self.open(tree, other, direction ^ 2, node) > 0 {
                self.activate(other);
            }
            if self.parent[other] == (direction ^ 2) as u8 {
                self.parent[other] = ORPHAN;
                self.orphans.push_back(other as u32);
            }
        }
        self.tree[node] = FREE;
        self.parent[node] = NONE;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::random::SplitMix64;

    /// Cost of the labelling in which bit i says that node i is on the sink's side.
    fn cost(bits: u32, w: usize, h: usize, terminals: &[(i32, i32)], right: &[i32], down: &[i32]) -> i64 {
        let side = |n: usize| bits >> n & 1 == 1;
        let mut sum = 0i64;
        for n in 0..w * h {
            sum += i64::from(if side(n) { terminals[n].0 } else { terminals[n].1 });
            if n % w + 1 < w && side(n) != side(n + 1) {
                sum += i64::from(right[n]);
            }
            if n + w < w * h && side(n) != side(n + w) {
                sum += i64::from(down[n]);
            }
        }
        sum
    }

    #[test]
    fn equals_brute_force_on_small_grids() {
        let mut random = SplitMix64(7);
        let mut cut = GridCut::default();
        for round in 0..400 {
            let (w, h) = [(1, 1), (2, 2), (3, 3), (4, 3), (5, 2), (4, 4), (1, 6)][round % 7];
            let n = w * h;
            let top = [2, 6, 100][round % 3];
            let terminals: Vec<(i32, i32)> = (0..n)
                .map(|_| match random.below(4) {
                    0 => (0, 0),
                    1 => (random.below(300) as i32, 0),
                    2 => (0, random.below(300) as i32),
                    _ => (random.below(9) as i32, random.below(9) as i32),
                })
                .collect();
            let right: Vec<i32> = (0..n).map(|_| random.below(top) as i32).collect();
            let down: Vec<i32> = (0..n).map(|_| random.below(top) as i32).collect();
            cut.reset(w, h);
            for i in 0..n {
                cut.add_terminal(i, terminals[i].0, terminals[i].1);
                if i % w + 1 < w {
                    cut.add_edge(i, false, right[i]);
                }
                if i + w < n {
                    cut.add_edge(i, true, down[i]);
                }
            }
            let flow = cut.solve();
            let best = (0..1u32 << n).map(|b| cost(b, w, h, &terminals, &right, &down)).min().unwrap();
            let found = (0..n).fold(0u32, |b, i| b | u32::from(cut.is_sink(i)) << i);
            assert_eq!(flow, best, "round {round}");
            assert_eq!(cost(found, w, h, &terminals, &right, &down), best, "round {round}");
        }
    }
}
