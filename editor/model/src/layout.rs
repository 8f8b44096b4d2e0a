//! Positions for nodes without a position in the file: layers along the data flow, few crossings, even distances.

use std::collections::HashMap;

/// Distance between layers and between the nodes of a layer, in points at zoom 1.
const GAP: [f32; 2] = [64.0, 32.0];

/// Height reserved for a wire that passes a layer.
const LANE: f32 = 24.0;

/// Minimum distance between a newly placed node and the others, in points.
const MARGIN: f32 = 24.0;
/// Grid that newly placed nodes snap to, in points.
const GRID: f32 = 8.0;
/// How far to search for a free position, in steps of two grid lines.
const MAX_RINGS: i32 = 1024;

/// A rectangle: upper left corner and size.
pub type Rectangle = ([f32; 2], [f32; 2]);

/// The position on the grid nearest to `wanted` where a rectangle of `size` keeps its distance from all `taken` ones.
pub fn free(wanted: [f32; 2], size: [f32; 2], taken: &[Rectangle]) -> [f32; 2] {
    let near = |a: f32, a_size: f32, b: f32, b_size: f32| a < b + b_size + MARGIN && b < a + a_size + MARGIN;
    let is_free = |at: [f32; 2]| {
        !taken
            .iter()
            .any(|(place, other)| near(at[0], size[0], place[0], other[0]) && near(at[1], size[1], place[1], other[1]))
    };
    let start = wanted.map(|v| (v / GRID).round() * GRID);
    for ring in 0..=MAX_RINGS {
        let step = 2.0 * GRID;
        let mut best: Option<(f32, [f32; 2])> = None;
        for k in -ring..=ring {
            for (dx, dy) in [(ring, k), (-ring, k), (k, ring), (k, -ring)] {
                let (dx, dy) = (dx as f32 * step, dy as f32 * step);
                let (at, far) = ([start[0] + dx, start[1] + dy], dx * dx + dy * dy);
                if best.is_none_or(|(least, _)| far < least) && is_free(at) {
                    best = Some((far, at));
                }
            }
        }
        if let Some((_, at)) = best {
            return at;
        }
    }
    // No free position nearby: to the right of everything.
    let right = taken.iter().map(|(place, size)| place[0] + size[0]).filter(|x| x.is_finite()).fold(start[0], f32::max);
    [((right + MARGIN) / GRID).ceil() * GRID, start[1]]
}

/// `at` if a rectangle of `size` overlaps nothing there, else the position that [`free`] finds.
pub fn clear_of(at: [f32; 2], size: [f32; 2], taken: &[Rectangle]) -> [f32; 2] {
    let within = |a: f32, a_size: f32, b: f32, b_size: f32| a < b + b_size && b < a + a_size;
    let lies_on = |(place, other): &Rectangle| {
        within(at[0], size[0], place[0], other[0]) && within(at[1], size[1], place[1], other[1])
    };
    if taken.iter().any(lies_on) { free(at, size, taken) } else { at }
}

/// Positions of nodes, and the paths of wires that pass layers between their ends.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// Upper left corners of the nodes.
    pub positions: Vec<[f32; 2]>,
    /// For pairs of nodes more than a layer apart: a segment (left and right end) for each layer that the wires pass.
    pub lanes: HashMap<(usize, usize), Vec<[[f32; 2]; 2]>>,
}

/// Lays out nodes of the given sizes. `edges` go from producer to consumer; those that close a loop are ignored.
pub fn layered(sizes: &[[f32; 2]], edges: &[(usize, usize)]) -> Layout {
    let mut layer = layers(sizes.len(), edges);
    let count = layer.iter().max().map_or(0, |m| m + 1);
    // A wire that passes layers gets a placeholder node in each of them.
    let (mut sizes, mut short) = (sizes.to_vec(), Vec::new());
    let nodes = sizes.len();
    let mut chains: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
    for &(from, to) in edges {
        if layer[from] >= layer[to] {
            continue;
        }
        if layer[to] == layer[from] + 1 || chains.contains_key(&(from, to)) {
            short.push((from, to));
            continue;
        }
        let mut chain = Vec::new();
        for between in layer[from] + 1..layer[to] {
            short.push((chain.last().copied().unwrap_or(from), sizes.len()));
            chain.push(sizes.len());
            sizes.push([0.0, LANE]);
            layer.push(between);
        }
        short.push((chain.last().copied().unwrap_or(from), to));
        chains.insert((from, to), chain);
    }
    short.retain(|(from, to)| layer[*to] == layer[*from] + 1);
    let edges = &short;
    let mut columns: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (node, &layer) in layer.iter().enumerate() {
        columns[layer].push(node);
    }
    order(&mut columns, edges, sizes.len());
    let mut positions = vec![[0.0; 2]; sizes.len()];
    let mut x = 0.0;
    for column in &columns {
        let width = column.iter().map(|&n| sizes[n][0]).fold(0.0, f32::max);
        let height: f32 = column.iter().map(|&n| sizes[n][1] + GAP[1]).sum::<f32>() - GAP[1];
        let mut y = -height / 2.0;
        for &node in column {
            if node >= nodes {
                sizes[node][0] = width;
            }
            positions[node] = [x, y];
            y += sizes[node][1] + GAP[1];
        }
        x += width + GAP[0];
    }
    align(&mut positions, &columns, &sizes, edges);
    let segment = |&lane: &usize| {
        let [x, y] = positions[lane];
        let y = y + LANE / 2.0;
        [[x, y], [x + sizes[lane][0], y]]
    };
    let lanes = chains.into_iter().map(|(ends, chain)| (ends, chain.iter().map(segment).collect())).collect();
    positions.truncate(nodes);
    Layout { positions, lanes }
}

/// As [`layered`], for the nodes in `part` only; the positions of the others are 0.
pub fn layered_part(sizes: &[[f32; 2]], edges: &[(usize, usize)], part: &[usize]) -> Layout {
    if part.len() == sizes.len() {
        return layered(sizes, edges);
    }
    let among = |n: &usize| part.binary_search(n).ok();
    let part_sizes: Vec<[f32; 2]> = part.iter().map(|n| sizes[*n]).collect();
    let part_edges: Vec<(usize, usize)> = edges.iter().filter_map(|(from, to)| among(from).zip(among(to))).collect();
    let laid = layered(&part_sizes, &part_edges);
    let mut positions = vec![[0.0; 2]; sizes.len()];
    part.iter().zip(laid.positions).for_each(|(n, place)| positions[*n] = place);
    let lanes = laid.lanes.into_iter().map(|((from, to), lane)| ((part[from], part[to]), lane)).collect();
    Layout { positions, lanes }
}

/// Layer of each node: the longest path from a source, without the edges that close loops.
fn layers(nodes: usize, edges: &[(usize, usize)]) -> Vec<usize> {
    let mut out = vec![Vec::new(); nodes];
    for &(from, to) in edges {
        out[from].push(to);
    }
    // Depth-first search: an edge to a node on the current path closes a loop.
    let (mut state, mut done) = (vec![0u8; nodes], Vec::new());
    let mut forward_edges = vec![Vec::new(); nodes];
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
                        forward_edges[node].push(to);
                        stack.push((to, 0));
                    }
                }
                None => {
                    state[node] = 2;
                    done.push(node);
                }
            }
        }
    }
    let mut layer = vec![0; nodes];
    for &node in done.iter().rev() {
        for &to in &forward_edges[node] {
            layer[to] = layer[to].max(layer[node] + 1);
        }
    }
    layer
}

/// Orders each layer by the mean position of the neighbours, in a few passes forward and back.
fn order(columns: &mut [Vec<usize>], edges: &[(usize, usize)], nodes: usize) {
    let mut place = vec![0.0f32; nodes];
    let put = |columns: &[Vec<usize>], place: &mut Vec<f32>| {
        for column in columns {
            let middle = (column.len() as f32 - 1.0) / 2.0;
            for (i, &node) in column.iter().enumerate() {
                place[node] = i as f32 - middle;
            }
        }
    };
    put(columns, &mut place);
    let count = columns.len();
    for round in 0..8 {
        let forward = round % 2 == 0;
        for step in 0..count {
            let column = if forward { step } else { count - 1 - step };
            let mut keyed: Vec<(f32, usize)> = columns[column]
                .iter()
                .map(|&node| {
                    let near = edges.iter().filter_map(|&(from, to)| match forward {
                        true => (to == node).then_some(place[from]),
                        false => (from == node).then_some(place[to]),
                    });
                    let (sum, n) = near.fold((0.0, 0), |(s, n), p| (s + p, n + 1));
                    (if n == 0 { place[node] } else { sum / n as f32 }, node)
                })
                .collect();
            keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
            columns[column] = keyed.into_iter().map(|(_, node)| node).collect();
            put(columns, &mut place);
        }
    }
}

/// Moves nodes vertically towards their neighbours as far as the other nodes of the layer allow.
fn align(positions: &mut [[f32; 2]], columns: &[Vec<usize>], sizes: &[[f32; 2]], edges: &[(usize, usize)]) {
    for round in 0..6 {
        let columns: Vec<&Vec<usize>> =
            if round % 2 == 0 { columns.iter().collect() } else { columns.iter().rev().collect() };
        for column in columns {
            for (i, &node) in column.iter().enumerate() {
                let near = edges.iter().filter_map(|&(from, to)| match node {
                    _ if from == node => Some(to),
                    _ if to == node => Some(from),
                    _ => None,
                });
                let (sum, n) = near.fold((0.0, 0), |(s, n), o| (s + positions[o][1] + sizes[o][1] / 2.0, n + 1));
                if n == 0 {
                    continue;
                }
                let target = sum / n as f32 - sizes[node][1] / 2.0;
                let above = i.checked_sub(1).map(|k| positions[column[k]][1] + sizes[column[k]][1] + GAP[1]);
                let below = column.get(i + 1).map(|&k| positions[k][1] - sizes[node][1] - GAP[1]);
                let (low, high) = (above.unwrap_or(f32::MIN), below.unwrap_or(f32::MAX));
                positions[node][1] = target.max(low).min(high.max(low));
            }
        }
    }
    for place in positions {
        *place = place.map(|v| (v / 8.0).round() * 8.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overlaps(positions: &[[f32; 2]], sizes: &[[f32; 2]]) -> bool {
        let apart = |a: usize, b: usize| {
            (0..2).any(|k| {
                positions[a][k] + sizes[a][k] <= positions[b][k] || positions[b][k] + sizes[b][k] <= positions[a][k]
            })
        };
        (0..positions.len()).any(|a| (0..a).any(|b| !apart(a, b)))
    }

    #[test]
    fn free_ground_is_near_and_touches_nothing() {
        assert_eq!(free([3.0, 5.0], [200.0, 100.0], &[]), [0.0, 8.0], "on the grid");
        let mut taken: Vec<Rectangle> = Vec::new();
        for k in 0..60 {
            let size = [208.0, 80.0 + (k * 37 % 90) as f32];
            let at = free([0.0, 0.0], size, &taken);
            let far = at[0].hypot(at[1]);
            assert!(far < 1800.0, "{k}: {at:?}");
            taken.push((at, size));
        }
        let (positions, sizes): (Vec<_>, Vec<_>) = taken.into_iter().unzip();
        assert!(!overlaps(&positions, &sizes));
        // A rectangle without a position takes no space.
        assert_eq!(free([0.0; 2], [10.0; 2], &[([f32::NAN; 2], [10.0; 2])]), [0.0; 2]);
        // A very large obstacle.
        let wall = free([0.0; 2], [10.0; 2], &[([-1e6, -1e6], [2e6, 2e6])]);
        assert!(wall[0] > 1e6, "{wall:?}");
    }

    #[test]
    fn edges_go_right_and_nothing_overlaps() {
        let sizes: Vec<[f32; 2]> = (0..40).map(|i| [200.0, 80.0 + (i * 37 % 90) as f32]).collect();
        let edges: Vec<(usize, usize)> = (1..40).flat_map(|i| [(i / 2, i), (i / 3, i)]).collect();
        let positions = layered(&sizes, &edges).positions;
        assert!(edges.iter().all(|&(a, b)| a == b || positions[a][0] + sizes[a][0] < positions[b][0]));
        assert!(!overlaps(&positions, &sizes));
    }

    #[test]
    fn a_part_is_laid_out_as_if_it_were_all() {
        let sizes = [[200.0, 150.0], [90.0, 90.0], [200.0, 150.0], [200.0, 150.0]];
        let whole = layered(&[sizes[0], sizes[2], sizes[3]], &[(0, 1), (1, 2), (0, 2)]);
        let part = layered_part(&sizes, &[(0, 2), (2, 3), (0, 3)], &[0, 2, 3]);
        assert_eq!([part.positions[0], part.positions[2], part.positions[3]], whole.positions[..]);
        assert_eq!(part.lanes[&(0, 3)], whole.lanes[&(0, 2)]);
    }

    #[test]
    fn loops_and_lone_nodes_have_places() {
        let sizes = [[100.0, 50.0]; 4];
        let positions = layered(&sizes, &[(0, 1), (1, 2), (2, 0)]).positions;
        assert!(!overlaps(&positions, &sizes));
        assert!(layered(&[], &[]).positions.is_empty());
    }

    #[test]
    fn long_wires_pass_beside_nodes() {
        let sizes = [[200.0, 150.0]; 3];
        let layout = layered(&sizes, &[(0, 1), (1, 2), (0, 2), (0, 2)]);
        let lane = layout.lanes[&(0, 2)][0];
        let (y, top) = (lane[0][1], layout.positions[1][1]);
        assert!(y < top || y > top + sizes[1][1], "{y} {top}");
    }
}
