//! Layers along the data flow: which layer a node is in, the order inside a layer, heights that make wires straight.

use super::{GAP, LANE_GAP};

/// Neighbours of each node: producers and consumers.
pub(super) struct Neighbours {
    pub into: Vec<Vec<usize>>,
    pub out: Vec<Vec<usize>>,
}

impl Neighbours {
    pub fn new(nodes: usize, edges: &[(usize, usize)]) -> Self {
        let (mut into, mut out) = (vec![Vec::new(); nodes], vec![Vec::new(); nodes]);
        for &(from, to) in edges {
            out[from].push(to);
            into[to].push(from);
        }
        Self { into, out }
    }
}

/// The edges that close no loop.
pub(super) fn forward(nodes: usize, edges: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let out = Neighbours::new(nodes, edges).out;
    // Depth-first search: an edge to a node on the current path closes a loop.
    let (mut state, mut found) = (vec![0u8; nodes], Vec::with_capacity(edges.len()));
    for start in 0..nodes {
        let mut stack = vec![(start, 0)];
        while let Some((node, next)) = stack.pop() {
            if next == 0 {
                if state[node] != 0 {
                    continue;
                }
                state[node] = 1;
            }
            match out[node].get(next) {
                Some(&to) => {
                    stack.push((node, next + 1));
                    if state[to] != 1 {
                        found.push((node, to));
                        stack.push((to, 0));
                    }
                }
                None => state[node] = 2,
            }
        }
    }
    found
}

/// Layer of each node: the longest path from a source. A source is moved to the layer before its first reader.
pub(super) fn longest(near: &Neighbours) -> Vec<usize> {
    let nodes = near.into.len();
    let mut waits: Vec<usize> = near.into.iter().map(Vec::len).collect();
    let mut ready: Vec<usize> = (0..nodes).filter(|n| waits[*n] == 0).collect();
    let mut layer = vec![0usize; nodes];
    let mut at = 0;
    while let Some(&node) = ready.get(at) {
        at += 1;
        for &to in &near.out[node] {
            layer[to] = layer[to].max(layer[node] + 1);
            waits[to] -= 1;
            if waits[to] == 0 {
                ready.push(to);
            }
        }
    }
    for node in 0..nodes {
        if near.into[node].is_empty()
            && let Some(first) = near.out[node].iter().map(|to| layer[*to]).min()
        {
            layer[node] = first.saturating_sub(1);
        }
    }
    layer
}

/// As `base`, with layers no higher than `cap`: nodes for which a layer has no space go to a later one.
pub(super) fn capped(near: &Neighbours, base: &[usize], heights: &[f32], cap: f32) -> Vec<usize> {
    let mut order: Vec<usize> = (0..base.len()).collect();
    // In the order of the flow; of a layer, nodes that are read before those that are not.
    order.sort_by_key(|&n| (base[n], near.out[n].is_empty()));
    let (mut layer, mut filled) = (vec![0; base.len()], Vec::<f32>::new());
    for node in order {
        let after = near.into[node].iter().map(|from| layer[*from] + 1).max();
        let mut at = after.unwrap_or(base[node]);
        let height = heights[node] + GAP[1];
        while filled.get(at).is_some_and(|used| *used > 0.0 && used + height > cap) {
            at += 1;
        }
        if filled.len() <= at {
            filled.resize(at + 1, 0.0);
        }
        filled[at] += height;
        layer[node] = at;
    }
    layer
}

/// Orders each layer by the mean position of the neighbours, in a few passes forward and back.
pub(super) fn order(columns: &mut [Vec<usize>], near: &Neighbours) {
    let mut place = vec![0.0f32; near.into.len()];
    let put = |column: &[usize], place: &mut [f32]| {
        let middle = (column.len() as f32 - 1.0) / 2.0;
        column.iter().enumerate().for_each(|(i, &node)| place[node] = i as f32 - middle);
    };
    columns.iter().for_each(|column| put(column, &mut place));
    let count = columns.len();
    for round in 0..8 {
        let is_forward = round % 2 == 0;
        let side = if is_forward { &near.into } else { &near.out };
        for step in 0..count {
            let column = &mut columns[if is_forward { step } else { count - 1 - step }];
            let key = |&node: &usize| {
                let (sum, n) = side[node].iter().fold((0.0, 0), |(s, n), o| (s + place[*o], n + 1));
                (if n == 0 { place[node] } else { sum / n as f32 }, node)
            };
            let mut keyed: Vec<(f32, usize)> = column.iter().map(key).collect();
            keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
            *column = keyed.into_iter().map(|(_, node)| node).collect();
            put(column, &mut place);
        }
    }
}

/// Distance between two things of a layer: wires that pass need less than nodes.
pub(super) fn distance(a: usize, b: usize, nodes: usize, gap: f32) -> f32 {
    if a < nodes && b < nodes { gap } else { LANE_GAP }
}

/// Moves things vertically towards their neighbours, as far as the others of the layer and the layer's `bounds` allow.
pub(super) fn align(
    tops: &mut [f32],
    heights: &[f32],
    columns: &[Vec<usize>],
    near: &Neighbours,
    bounds: &[[f32; 2]],
    (nodes, gap): (usize, f32),
) {
    for round in 0..6 {
        for step in 0..columns.len() {
            let index = if round % 2 == 0 { step } else { columns.len() - 1 - step };
            let column = &columns[index];
            for (i, &node) in column.iter().enumerate() {
                let others = near.into[node].iter().chain(&near.out[node]);
                let (sum, n) = others.fold((0.0, 0), |(s, n), o| (s + tops[*o] + heights[*o] / 2.0, n + 1));
                if n == 0 {
                    continue;
                }
                let target = sum / n as f32 - heights[node] / 2.0;
                let above = i.checked_sub(1).map(|k| {
                    let k = column[k];
                    tops[k] + heights[k] + distance(k, node, nodes, gap)
                });
                let below = column.get(i + 1).map(|&k| tops[k] - heights[node] - distance(k, node, nodes, gap));
                let [top, bottom] = bounds[index];
                let (low, high) = (above.unwrap_or(top), below.unwrap_or(bottom - heights[node]));
                tops[node] = target.max(low).min(high.max(low));
            }
        }
    }
}
