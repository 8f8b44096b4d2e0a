//! Places for nodes that the file gives none: layers along the flow, few crossings, even distances.

use std::collections::HashMap;

/// Distance between layers and between the nodes of one, in points at zoom 1.
const GAP: [f32; 2] = [64.0, 32.0];

/// Height kept free where wires pass a layer.
const LANE: f32 = 24.0;

/// Least distance between a node that is put on free ground and the others, and the grid that it is put on.
const MARGIN: f32 = 24.0;
const GRID: f32 = 8.0;
/// How far free ground is looked for, in steps of two grid lines.
const MOST_RINGS: i32 = 1024;

/// A rectangle by its upper left corner and its size.
pub type Ground = ([f32; 2], [f32; 2]);

/// The place nearest to `wanted`, on the grid, where something of `size` keeps its distance from all that is `taken`.
pub fn free(wanted: [f32; 2], size: [f32; 2], taken: &[Ground]) -> [f32; 2] {
    let near = |a: f32, a_size: f32, b: f32, b_size: f32| a < b + b_size + MARGIN && b < a + a_size + MARGIN;
    let is_free = |at: [f32; 2]| {
        !taken
            .iter()
            .any(|(place, other)| near(at[0], size[0], place[0], other[0]) && near(at[1], size[1], place[1], other[1]))
    };
    let start = wanted.map(|v| (v / GRID).round() * GRID);
    for ring in 0..=MOST_RINGS {
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
    // All around is full: to the right of everything.
    let right = taken.iter().map(|(place, size)| place[0] + size[0]).filter(|x| x.is_finite()).fold(start[0], f32::max);
    [((right + MARGIN) / GRID).ceil() * GRID, start[1]]
}

/// The place itself where it is free, else as [`free`].
pub fn clear_of(at: [f32; 2], size: [f32; 2], taken: &[Ground]) -> [f32; 2] {
    let within = |a: f32, a_size: f32, b: f32, b_size: f32| a < b + b_size && b < a + a_size;
    let lies_on = |(place, other): &Ground| {
        within(at[0], size[0], place[0], other[0]) && within(at[1], size[1], place[1], other[1])
    };
    if taken.iter().any(lies_on) { free(at, size, taken) } else { at }
}

/// Where nodes go, and how wires get past the layers between their ends.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// Upper left corners of the nodes.
    pub places: Vec<[f32; 2]>,
    /// For pairs of nodes more than a layer apart: a segment (left and right end) per layer that the wires pass.
    pub lanes: HashMap<(usize, usize), Vec<[[f32; 2]; 2]>>,
}

/// Places for nodes of the given sizes. `edges` go from producer to consumer; those that close a loop are ignored.
pub fn layered(sizes: &[[f32; 2]], edges: &[(usize, usize)]) -> Layout {
    let mut layer = layers(sizes.len(), edges);
    let count = layer.iter().max().map_or(0, |m| m + 1);
    // Wires that pass layers take a lane in each, as if there were nodes.
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
    let mut places = vec![[0.0; 2]; sizes.len()];
    let mut x = 0.0;
    for column in &columns {
        let width = column.iter().map(|&n| sizes[n][0]).fold(0.0, f32::max);
        let height: f32 = column.iter().map(|&n| sizes[n][1] + GAP[1]).sum::<f32>() - GAP[1];
        let mut y = -height / 2.0;
        for &node in column {
            if node >= nodes {
                sizes[node][0] = width;
            }
            places[node] = [x, y];
            y += sizes[node][1] + GAP[1];
        }
        x += width + GAP[0];
    }
    settle(&mut places, &columns, &sizes, edges);
    let segment = |&lane: &usize| {
        let [x, y] = places[lane];
        let y = y + LANE / 2.0;
        [[x, y], [x + sizes[lane][0], y]]
    };
    let lanes = chains.into_iter().map(|(ends, chain)| (ends, chain.iter().map(segment).collect())).collect();
    places.truncate(nodes);
    Layout { places, lanes }
}

/// As [`layered`], of a part of the nodes; the others have no place that means anything.
pub fn layered_part(sizes: &[[f32; 2]], edges: &[(usize, usize)], part: &[usize]) -> Layout {
    if part.len() == sizes.len() {
        return layered(sizes, edges);
    }
    let among = |n: &usize| part.binary_search(n).ok();
    let part_sizes: Vec<[f32; 2]> = part.iter().map(|n| sizes[*n]).collect();
    let part_edges: Vec<(usize, usize)> = edges.iter().filter_map(|(from, to)| among(from).zip(among(to))).collect();
    let laid = layered(&part_sizes, &part_edges);
    let mut places = vec![[0.0; 2]; sizes.len()];
    part.iter().zip(laid.places).for_each(|(n, place)| places[*n] = place);
    let lanes = laid.lanes.into_iter().map(|((from, to), lane)| ((part[from], part[to]), lane)).collect();
    Layout { places, lanes }
}

/// Longest way from a source, without the edges that close loops.
fn layers(nodes: usize, edges: &[(usize, usize)]) -> Vec<usize> {
    let mut out = vec![Vec::new(); nodes];
    for &(from, to) in edges {
        out[from].push(to);
    }
    // Depth first: an edge to a node that is still open closes a loop.
    let (mut state, mut done) = (vec![0u8; nodes], Vec::new());
    let mut kept = vec![Vec::new(); nodes];
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
                        kept[node].push(to);
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
        for &to in &kept[node] {
            layer[to] = layer[to].max(layer[node] + 1);
        }
    }
    layer
}

/// Orders each layer by the middle of its neighbours, there and back a few times.
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

/// Moves nodes up and down towards their neighbours as far as the others of their layer allow.
fn settle(places: &mut [[f32; 2]], columns: &[Vec<usize>], sizes: &[[f32; 2]], edges: &[(usize, usize)]) {
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
                let (sum, n) = near.fold((0.0, 0), |(s, n), o| (s + places[o][1] + sizes[o][1] / 2.0, n + 1));
                if n == 0 {
                    continue;
                }
                let wish = sum / n as f32 - sizes[node][1] / 2.0;
                let above = i.checked_sub(1).map(|k| places[column[k]][1] + sizes[column[k]][1] + GAP[1]);
                let below = column.get(i + 1).map(|&k| places[k][1] - sizes[node][1] - GAP[1]);
                let (low, high) = (above.unwrap_or(f32::MIN), below.unwrap_or(f32::MAX));
                places[node][1] = wish.max(low).min(high.max(low));
            }
        }
    }
    for place in places {
        *place = place.map(|v| (v / 8.0).round() * 8.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overlaps(places: &[[f32; 2]], sizes: &[[f32; 2]]) -> bool {
        let apart = |a: usize, b: usize| {
            (0..2).any(|k| places[a][k] + sizes[a][k] <= places[b][k] || places[b][k] + sizes[b][k] <= places[a][k])
        };
        (0..places.len()).any(|a| (0..a).any(|b| !apart(a, b)))
    }

    #[test]
    fn free_ground_is_near_and_touches_nothing() {
        assert_eq!(free([3.0, 5.0], [200.0, 100.0], &[]), [0.0, 8.0], "on the grid");
        let mut taken: Vec<Ground> = Vec::new();
        for k in 0..60 {
            let size = [208.0, 80.0 + (k * 37 % 90) as f32];
            let at = free([0.0, 0.0], size, &taken);
            let far = at[0].hypot(at[1]);
            assert!(far < 1800.0, "{k}: {at:?}");
            taken.push((at, size));
        }
        let (places, sizes): (Vec<_>, Vec<_>) = taken.into_iter().unzip();
        assert!(!overlaps(&places, &sizes));
        // What has no place takes none.
        assert_eq!(free([0.0; 2], [10.0; 2], &[([f32::NAN; 2], [10.0; 2])]), [0.0; 2]);
        // A wall without an end.
        let wall = free([0.0; 2], [10.0; 2], &[([-1e6, -1e6], [2e6, 2e6])]);
        assert!(wall[0] > 1e6, "{wall:?}");
    }

    #[test]
    fn edges_go_right_and_nothing_overlaps() {
        let sizes: Vec<[f32; 2]> = (0..40).map(|i| [200.0, 80.0 + (i * 37 % 90) as f32]).collect();
        let edges: Vec<(usize, usize)> = (1..40).flat_map(|i| [(i / 2, i), (i / 3, i)]).collect();
        let places = layered(&sizes, &edges).places;
        assert!(edges.iter().all(|&(a, b)| a == b || places[a][0] + sizes[a][0] < places[b][0]));
        assert!(!overlaps(&places, &sizes));
    }

    #[test]
    fn a_part_is_laid_out_as_if_it_were_all() {
        let sizes = [[200.0, 150.0], [90.0, 90.0], [200.0, 150.0], [200.0, 150.0]];
        let whole = layered(&[sizes[0], sizes[2], sizes[3]], &[(0, 1), (1, 2), (0, 2)]);
        let part = layered_part(&sizes, &[(0, 2), (2, 3), (0, 3)], &[0, 2, 3]);
        assert_eq!([part.places[0], part.places[2], part.places[3]], whole.places[..]);
        assert_eq!(part.lanes[&(0, 3)], whole.lanes[&(0, 2)]);
    }

    #[test]
    fn loops_and_lone_nodes_have_places() {
        let sizes = [[100.0, 50.0]; 4];
        let places = layered(&sizes, &[(0, 1), (1, 2), (2, 0)]).places;
        assert!(!overlaps(&places, &sizes));
        assert!(layered(&[], &[]).places.is_empty());
    }

    #[test]
    fn long_wires_pass_beside_nodes() {
        let sizes = [[200.0, 150.0]; 3];
        let layout = layered(&sizes, &[(0, 1), (1, 2), (0, 2), (0, 2)]);
        let lane = layout.lanes[&(0, 2)][0];
        let (y, top) = (lane[0][1], layout.places[1][1]);
        assert!(y < top || y > top + sizes[1][1], "{y} {top}");
    }
}
