//! Layers wrapped into rows: of all ways to break them, the one at which the graph is largest in the window.

use std::collections::{BTreeMap, HashMap};

use super::layers::{self, Neighbours, distance};
use super::{GAP, LANE, Layout, MAX_GAP};

/// Distance between two rows without wires between them, points at zoom 1.
const CHANNEL: f32 = 40.0;
/// Distance between wires that run beside each other.
const TRACK: f32 = 6.0;
/// Number of wires beside each other before they begin to share tracks.
const TRACKS: usize = 6;
/// Distance between a node and the vertical lines beside it.
const ASIDE: [f32; 2] = [16.0, 15.0];
/// Distance between the rows and wires that pass several of them.
const TRUNK: f32 = 56.0;
/// A larger scale than this is no reason for another row.
const LARGE: f32 = 1.5;
/// What a row more must gain in scale.
const ROW_COST: f32 = 0.96;
/// What the graph must gain if layers are limited in height, which bends the wires of chains.
const CAP_COST: f32 = 0.88;
/// What the graph would have to gain if all its wires went between rows.
const ROUTE_COST: f32 = 0.2;
/// The share of the window that the nodes should be spread over.
const FILLED: f32 = 0.65;
/// Number of plans that are laid out before one is chosen.
const TRIALS: usize = 12;
/// From this number of nodes on only the best plan is laid out.
const MANY: usize = 200;

/// What is laid out.
struct Input<'a> {
    sizes: &'a [[f32; 2]],
    /// Edges that close no loop, each once.
    edges: Vec<(usize, usize)>,
    /// Other pairs of nodes with wires.
    others: Vec<(usize, usize)>,
    window: [f32; 2],
}

/// Which layer each node is in, and the first layer of each row.
#[derive(Clone, PartialEq)]
struct Plan {
    layer: Vec<usize>,
    rows: Vec<usize>,
    /// Whether the height of layers is limited.
    capped: bool,
}

/// A finished layout with the size of everything in it.
struct Laid {
    layout: Layout,
    extent: [f32; 2],
}

impl Laid {
    fn scale(&self, window: [f32; 2]) -> f32 {
        (window[0] / self.extent[0].max(1.0)).min(window[1] / self.extent[1].max(1.0))
    }

    /// Share of the window inside the bounding box of the nodes.
    fn used(&self, sizes: &[[f32; 2]], window: [f32; 2]) -> f32 {
        let scale = self.scale(window).min(LARGE);
        let share = |k: usize| {
            let ends = self.layout.positions.iter().zip(sizes).map(|(at, size)| (at[k], at[k] + size[k]));
            let (low, high) = ends.fold((f32::MAX, f32::MIN), |(low, high), (a, b)| (low.min(a), high.max(b)));
            (high - low) * scale / window[k].max(1.0)
        };
        share(0) * share(1)
    }
}

/// Lays out nodes of the given sizes for a window (width and height that are free for the graph). `edges` go from producer to consumer; those that
/// close a loop, and `delayed` ones, do not determine the order of the nodes.
pub fn fitted(sizes: &[[f32; 2]], edges: &[(usize, usize)], delayed: &[(usize, usize)], window: [f32; 2]) -> Layout {
    if sizes.is_empty() {
        return Layout::default();
    }
    let unique = |edges: Vec<(usize, usize)>| {
        let mut edges: Vec<(usize, usize)> = edges.into_iter().filter(|(from, to)| from != to).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    };
    let forward = unique(layers::forward(sizes.len(), edges));
    let mut others = unique(edges.iter().chain(delayed).copied().collect());
    others.retain(|edge| forward.binary_search(edge).is_err());
    let input = Input { sizes, edges: forward, others, window };
    let trials = if sizes.len() > MANY { 1 } else { TRIALS };
    let laid = plans(&input).into_iter().take(trials).map(|plan| {
        let laid = lay(&input, &plan, GAP);
        let routes = laid.layout.routes.len() as f32 / (input.edges.len() + input.others.len()).max(1) as f32;
        let scale = laid.scale(window).min(LARGE);
        let laid = spread(&input, &plan, &laid);
        // A few nodes that are larger than designed need no more of the window.
        let fill = if scale < 1.0 { (laid.used(input.sizes, window) / FILLED).min(1.0) } else { 1.0 };
        (scale * plan.factor() * (1.0 - ROUTE_COST * routes) * fill, laid)
    });
    laid.max_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(Layout::default, |(_, laid)| laid.layout)
}

/// Lays a plan out once more: what is left of the window becomes distance between the nodes.
fn spread(input: &Input<'_>, plan: &Plan, laid: &Laid) -> Laid {
    let scale = laid.scale(input.window).min(LARGE);
    let spare = |k: usize, gaps: usize| (input.window[k] / scale - laid.extent[k]).max(0.0) / gaps.max(1) as f32;
    let columns = plan.columns(input.sizes.len());
    let across = plan.row_ranges(columns.len()).map(|row| row.len() - 1).max().unwrap_or(0);
    let down = |row: std::ops::Range<usize>| columns[row].iter().map(|c| c.len().saturating_sub(1)).max().unwrap_or(0);
    let down: usize = plan.row_ranges(columns.len()).map(down).sum::<usize>() + plan.rows.len() - 1;
    let gap = [(GAP[0] + spare(0, across)).min(MAX_GAP[0]), (GAP[1] + spare(1, down)).min(MAX_GAP[1])];
    lay(input, plan, gap)
}

impl Plan {
    /// What its rows and bent chains cost.
    fn factor(&self) -> f32 {
        ROW_COST.powi(self.rows.len() as i32 - 1) * if self.capped { CAP_COST } else { 1.0 }
    }

    fn columns(&self, nodes: usize) -> Vec<Vec<usize>> {
        let count = self.layer.iter().max().map_or(0, |m| m + 1);
        let mut columns = vec![Vec::new(); count];
        (0..nodes).for_each(|node| columns[self.layer[node]].push(node));
        columns
    }

    /// The layers of each row.
    fn row_ranges(&self, layers: usize) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        let ends = self.rows.iter().skip(1).copied().chain([layers]);
        self.rows.iter().copied().zip(ends).map(|(from, to)| from..to)
    }

    /// The row of a layer.
    fn row(&self, layer: usize) -> usize {
        self.rows.partition_point(|first| *first <= layer) - 1
    }
}

/// Ways to lay the graph out, the most promising first.
fn plans(input: &Input<'_>) -> Vec<Plan> {
    let near = Neighbours::new(input.sizes.len(), &input.edges);
    let base = layers::longest(&near);
    let heights: Vec<f32> = input.sizes.iter().map(|s| s[1]).collect();
    let tallest = heights.iter().copied().fold(0.0, f32::max) + GAP[1];
    let mut found: Vec<(f32, Plan)> = Vec::new();
    for cap in [f32::INFINITY].into_iter().chain((1..=10).map(|k| k as f32 * tallest)) {
        let mut layer = layers::capped(&near, &base, &heights, cap);
        close_ranks(&mut layer);
        let capped = found.first().is_some_and(|(_, plan)| plan.layer != layer);
        let count = layer.iter().max().map_or(0, |m| m + 1);
        let (mut widths, mut filled) = (vec![0.0f32; count], vec![0.0f32; count]);
        for (node, size) in input.sizes.iter().enumerate() {
            let at = layer[node];
            widths[at] = widths[at].max(size[0]);
            filled[at] += size[1] + GAP[1];
        }
        let mut last = Vec::new();
        for rows in 1..=count.min(48) {
            let rows = broken(&widths, rows);
            if rows == last {
                continue;
            }
            last.clone_from(&rows);
            let plan = Plan { layer: layer.clone(), rows, capped };
            let (mut width, mut height) = (0.0f32, 0.0f32);
            for row in plan.row_ranges(count) {
                width = width.max(widths[row.clone()].iter().map(|w| w + GAP[0]).sum::<f32>() - GAP[0]);
                height += filled[row].iter().copied().fold(0.0, f32::max) - GAP[1] + CHANNEL;
            }
            let scale = (input.window[0] / width.max(1.0)).min(input.window[1] / (height - CHANNEL).max(1.0));
            found.push((scale.min(LARGE) * plan.factor(), plan));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.dedup_by(|a, b| a.1 == b.1);
    found.into_iter().map(|(_, plan)| plan).collect()
}

/// Renumbers layers so that none is empty.
fn close_ranks(layer: &mut [usize]) {
    let mut used = layer.to_vec();
    used.sort_unstable();
    used.dedup();
    layer.iter_mut().for_each(|l| *l = used.partition_point(|u| u < l));
}

/// First layers of at most `rows` rows whose greatest width is the least.
fn broken(widths: &[f32], rows: usize) -> Vec<usize> {
    let breaks = |most: f32| {
        let (mut starts, mut used) = (vec![0], 0.0);
        for (layer, width) in widths.iter().enumerate() {
            if used > 0.0 && used + GAP[0] + width > most {
                starts.push(layer);
                used = *width;
            } else {
                used += if used > 0.0 { GAP[0] + width } else { *width };
            }
        }
        starts
    };
    let (mut low, mut high) = (0.0f32, widths.iter().map(|w| w + GAP[0]).sum::<f32>());
    for _ in 0..24 {
        let middle = (low + high) / 2.0;
        if breaks(middle).len() <= rows { high = middle } else { low = middle }
    }
    breaks(high)
}

/// Lays a plan out with these distances between columns and between nodes of a column.
fn lay(input: &Input<'_>, plan: &Plan, gap: [f32; 2]) -> Laid {
    let nodes = input.sizes.len();
    let layer = &plan.layer;
    let mut heights: Vec<f32> = input.sizes.iter().map(|s| s[1]).collect();
    let mut columns = plan.columns(nodes);
    let (mut short, mut routed) = (Vec::new(), Vec::new());
    // The wires of a node that pass layers of its row share a placeholder in each of them.
    let mut passing: HashMap<(usize, usize), usize> = HashMap::new();
    let mut chains: Vec<((usize, usize), Vec<usize>)> = Vec::new();
    for &(from, to) in input.edges.iter().chain(&input.others) {
        if plan.row(layer[from]) != plan.row(layer[to]) {
            routed.push((from, to));
            continue;
        }
        if layer[to] <= layer[from] {
            continue;
        }
        let mut chain = Vec::new();
        for between in layer[from] + 1..layer[to] {
            let placeholder = *passing.entry((from, between)).or_insert_with(|| {
                heights.push(LANE);
                columns[between].push(heights.len() - 1);
                heights.len() - 1
            });
            short.push((chain.last().copied().unwrap_or(from), placeholder));
            chain.push(placeholder);
        }
        short.push((chain.last().copied().unwrap_or(from), to));
        if !chain.is_empty() {
            chains.push(((from, to), chain));
        }
    }
    short.sort_unstable();
    short.dedup();
    let near = Neighbours::new(heights.len(), &short);
    layers::order(&mut columns, &near);
    // From the top of each column down, then towards the neighbours.
    let (mut tops, column_heights) = stack(&columns, &heights, (nodes, gap[1]));
    let mut bounds = vec![[0.0; 2]; columns.len()];
    for row in plan.row_ranges(columns.len()) {
        let height = column_heights[row.clone()].iter().copied().fold(0.0, f32::max);
        bounds[row].fill([-height / 2.0, height / 2.0]);
    }
    layers::align(&mut tops, &heights, &columns, &near, &bounds, (nodes, gap[1]));
    let channels = Channels::of(plan, &routed);
    let rows = place_rows(plan, &columns, input.sizes, &bounds, &channels, gap);
    let snapped = |v: f32| (v / 8.0).round() * 8.0;
    let top_of = |thing: usize, layer: usize| snapped(tops[thing] - bounds[layer][0] + rows.tops[plan.row(layer)]);
    let positions: Vec<[f32; 2]> = (0..nodes).map(|n| [rows.left[layer[n]], top_of(n, layer[n])]).collect();
    let lanes = chains.into_iter().map(|((from, to), chain)| {
        let segment = |(thing, layer): (&usize, usize)| {
            let y = top_of(*thing, layer) + LANE / 2.0;
            [[rows.left[layer], y], [rows.left[layer] + rows.width[layer], y]]
        };
        ((from, to), chain.iter().zip(layer[from] + 1..).map(segment).collect())
    });
    let lanes = lanes.collect();
    let routes = route(plan, &rows, &channels, &routed);
    let layout = Layout { positions, lanes, routes };
    Laid { extent: extent(&layout, input.sizes), layout }
}

/// Stacks the things of each column without alignment, centred on 0: the top of each thing, and the height of each column.
fn stack(columns: &[Vec<usize>], heights: &[f32], (nodes, gap): (usize, f32)) -> (Vec<f32>, Vec<f32>) {
    let mut tops = vec![0.0; heights.len()];
    let height_of = |column: &Vec<usize>| {
        let mut y = 0.0;
        for (i, &thing) in column.iter().enumerate() {
            if i > 0 {
                y += distance(column[i - 1], thing, nodes, gap);
            }
            tops[thing] = y;
            y += heights[thing];
        }
        column.iter().for_each(|&thing| tops[thing] -= y / 2.0);
        y
    };
    let column_heights = columns.iter().map(height_of).collect();
    (tops, column_heights)
}

/// Corners of the wires between rows, through the channels between them.
fn route(
    plan: &Plan,
    rows: &Rows,
    channels: &Channels,
    routed: &[(usize, usize)],
) -> HashMap<(usize, usize), Vec<[f32; 2]>> {
    let layer = &plan.layer;
    let corners = |&(from, to): &(usize, usize)| {
        let net = channels.nets[&from] % TRACKS;
        let leaves = rows.left[layer[from]] + rows.width[layer[from]] + ASIDE[0] + net as f32 * TRACK;
        let enters = rows.left[layer[to]] - ASIDE[1] - net as f32 * TRACK;
        let (first, last) = channels.between(plan, layer, from, to);
        let y = |channel: usize| rows.channels[channel] + channels.track(channel, from) * TRACK;
        let mut corners = vec![[leaves, y(first)]];
        if first != last {
            let trunk = -TRUNK - net as f32 * TRACK;
            corners.extend([[trunk, y(first)], [trunk, y(last)]]);
        }
        corners.push([enters, y(last)]);
        ((from, to), corners)
    };
    routed.iter().map(corners).collect()
}

/// Width and height of everything in a layout.
fn extent(layout: &Layout, sizes: &[[f32; 2]]) -> [f32; 2] {
    [0, 1].map(|k| {
        let nodes = layout.positions.iter().zip(sizes).flat_map(|(at, size)| [at[k], at[k] + size[k]]);
        let ends = nodes.chain(layout.routes.values().flatten().map(|corner| corner[k]));
        let (low, high) = ends.fold((f32::MAX, f32::MIN), |(low, high), v| (low.min(v), high.max(v)));
        high - low
    })
}

/// Which wires run between two rows: all wires of a node in one track.
struct Channels {
    /// A number for each node with wires to other rows.
    nets: BTreeMap<usize, usize>,
    /// For each channel, the nodes whose wires are in it.
    users: Vec<Vec<usize>>,
}

impl Channels {
    fn of(plan: &Plan, routed: &[(usize, usize)]) -> Self {
        let mut nets = BTreeMap::new();
        for (from, _) in routed {
            let next = nets.len();
            nets.entry(*from).or_insert(next);
        }
        let mut channels = Self { nets, users: vec![Vec::new(); plan.rows.len()] };
        for (from, to) in routed {
            let (first, last) = channels.between(plan, &plan.layer, *from, *to);
            for channel in [first, last] {
                if !channels.users[channel].contains(from) {
                    channels.users[channel].push(*from);
                }
            }
        }
        channels
    }

    /// The channel that a wire leaves its producer to, and the one from which it reaches its consumer; channel n is below row n.
    fn between(&self, plan: &Plan, layer: &[usize], from: usize, to: usize) -> (usize, usize) {
        let (from, to) = (plan.row(layer[from]), plan.row(layer[to]));
        if to > from { (from, to - 1) } else { (from - 1, to) }
    }

    fn track(&self, channel: usize, from: usize) -> f32 {
        let at = self.users[channel].iter().position(|user| *user == from).unwrap_or(0);
        (at % (2 * TRACKS)) as f32
    }

    /// Height of the tracks of a channel.
    fn height(&self, channel: usize) -> f32 {
        self.users[channel].len().saturating_sub(1).min(2 * TRACKS - 1) as f32 * TRACK
    }
}

/// Where rows, columns and channels are.
struct Rows {
    /// Upper edge of each row.
    tops: Vec<f32>,
    /// First track of the channel below each row.
    channels: Vec<f32>,
    /// Left edge and width of each column.
    left: Vec<f32>,
    width: Vec<f32>,
}

fn place_rows(
    plan: &Plan,
    columns: &[Vec<usize>],
    sizes: &[[f32; 2]],
    bounds: &[[f32; 2]],
    channels: &Channels,
    gap: [f32; 2],
) -> Rows {
    let width_of = |column: &Vec<usize>| column.iter().filter_map(|n| sizes.get(*n)).map(|s| s[0]).fold(0.0, f32::max);
    let width: Vec<f32> = columns.iter().map(width_of).collect();
    let ranges: Vec<std::ops::Range<usize>> = plan.row_ranges(columns.len()).collect();
    let filled = |row: &std::ops::Range<usize>| width[row.clone()].iter().sum::<f32>();
    let widest = ranges.iter().map(|row| filled(row) + (row.len() - 1) as f32 * gap[0]).fold(0.0, f32::max);
    let mut rows = Rows { tops: Vec::new(), channels: Vec::new(), left: vec![0.0; columns.len()], width: Vec::new() };
    let mut y = 0.0;
    for (index, row) in ranges.iter().enumerate() {
        // All rows end at the same edge, where that needs no great distances.
        let even = (widest - filled(row)) / (row.len() - 1).max(1) as f32;
        let between = even.clamp(gap[0], MAX_GAP[0].max(gap[0]));
        let mut x = 0.0f32;
        for layer in row.clone() {
            rows.left[layer] = (x / 8.0).floor() * 8.0;
            x += width[layer] + between;
        }
        rows.tops.push(y);
        let [top, bottom] = bounds[row.start];
        let space = CHANNEL + (gap[1] - GAP[1]);
        y += bottom - top;
        rows.channels.push(y + space / 2.0);
        y = ((y + space + channels.height(index)) / 8.0).ceil() * 8.0;
    }
    rows.width = width;
    rows
}
