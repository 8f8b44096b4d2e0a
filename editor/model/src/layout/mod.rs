//! Positions for nodes without a position in the file: layers along the data flow, wrapped into rows that have the shape of the window.

mod layers;
mod router;
mod rows;

use std::collections::HashMap;

pub use router::{Ends, Obstacles};
pub use rows::fitted;

/// Distance between layers and between the nodes of a layer, in points at zoom 1.
const GAP: [f32; 2] = [64.0, 32.0];
/// The same at most, where the window has more space than the nodes need.
const MAX_GAP: [f32; 2] = [144.0, 112.0];

/// Height reserved for the wires of a node that pass a layer.
const LANE: f32 = 20.0;
/// Distance between such wires and the nodes of the layer.
const LANE_GAP: f32 = 14.0;

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

/// Positions of nodes, and the paths of wires that pass nodes between their ends.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// Upper left corners of the nodes.
    pub positions: Vec<[f32; 2]>,
    /// For pairs of nodes of one row, more than a layer apart: a segment (left and right end) for each layer that the wires pass.
    pub lanes: HashMap<(usize, usize), Vec<[[f32; 2]; 2]>>,
    /// For pairs of nodes of different rows: the corners of the path. The wires leave the producer horizontally as far as the first corner and
    /// reach the consumer horizontally from the last one; the corners between are joined by vertical and horizontal lines.
    pub routes: HashMap<(usize, usize), Vec<[f32; 2]>>,
}

/// As [`fitted`], for the nodes in `part` only (in ascending order); the positions of the others are 0.
pub fn fitted_part(
    sizes: &[[f32; 2]],
    edges: &[(usize, usize)],
    delayed: &[(usize, usize)],
    window: [f32; 2],
    part: &[usize],
) -> Layout {
    if part.len() == sizes.len() {
        return fitted(sizes, edges, delayed, window);
    }
    let among = |n: &usize| part.binary_search(n).ok();
    let part_sizes: Vec<[f32; 2]> = part.iter().map(|n| sizes[*n]).collect();
    let of_part = |edges: &[(usize, usize)]| -> Vec<(usize, usize)> {
        edges.iter().filter_map(|(from, to)| among(from).zip(among(to))).collect()
    };
    let laid = fitted(&part_sizes, &of_part(edges), &of_part(delayed), window);
    let mut positions = vec![[0.0; 2]; sizes.len()];
    part.iter().zip(laid.positions).for_each(|(n, place)| positions[*n] = place);
    let lanes = laid.lanes.into_iter().map(|((from, to), lane)| ((part[from], part[to]), lane)).collect();
    let routes = laid.routes.into_iter().map(|((from, to), route)| ((part[from], part[to]), route)).collect();
    Layout { positions, lanes, routes }
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

    /// Wide enough for one row.
    const WIDE: [f32; 2] = [1e5, 400.0];
    /// The space for the graph in a window of 1440x900.
    const WINDOW: [f32; 2] = [1088.0, 824.0];

    /// Share of the window that the bounding box of the nodes covers when all are in view, and the scale at which they are.
    fn used(layout: &Layout, sizes: &[[f32; 2]], window: [f32; 2]) -> (f32, f32) {
        let bound = |k: usize, far: bool| {
            let ends = layout.positions.iter().zip(sizes).map(|(p, s)| if far { p[k] + s[k] } else { p[k] });
            if far { ends.fold(f32::MIN, f32::max) } else { ends.fold(f32::MAX, f32::min) }
        };
        let extent = [bound(0, true) - bound(0, false), bound(1, true) - bound(1, false)];
        let scale = (window[0] / extent[0]).min(window[1] / extent[1]);
        (extent[0] * extent[1] * scale * scale / (window[0] * window[1]), scale)
    }

    #[test]
    fn edges_go_right_and_nothing_overlaps() {
        let sizes: Vec<[f32; 2]> = (0..40).map(|i| [200.0, 80.0 + (i * 37 % 90) as f32]).collect();
        let edges: Vec<(usize, usize)> = (1..40).flat_map(|i| [(i / 2, i), (i / 3, i)]).collect();
        let positions = fitted(&sizes, &edges, &[], WIDE).positions;
        assert!(edges.iter().all(|&(a, b)| a == b || positions[a][0] + sizes[a][0] < positions[b][0]));
        assert!(!overlaps(&positions, &sizes));
    }

    #[test]
    fn chains_wrap_into_the_shape_of_the_window() {
        for count in [2, 5, 9, 23, 60, 300] {
            let sizes: Vec<[f32; 2]> = (0..count).map(|i| [208.0, 200.0 + (i * 37 % 90) as f32]).collect();
            let edges: Vec<(usize, usize)> = (1..count).map(|i| (i - 1, i)).collect();
            let delayed = [(count - 1, 0)];
            let layout = fitted(&sizes, &edges, &delayed, WINDOW);
            assert!(!overlaps(&layout.positions, &sizes), "{count}");
            let (share, scale) = used(&layout, &sizes, WINDOW);
            assert!(share > 0.55 || count < 3, "{count}: {share}");
            // One row would be this small.
            let row = (WINDOW[0] / (count as f32 * 272.0)).min(1.5);
            assert!(scale >= row * 0.99, "{count}: {scale} {row}");
            eprintln!("{count}: {share} {scale} {row}");
            // A wire to another row has a path, also that of a loop.
            let column = |n: usize| layout.positions[n][0];
            let wraps = (1..count).filter(|n| column(*n) < column(n - 1)).count();
            let forward = layout.routes.keys().filter(|(from, to)| to == &(from + 1)).count();
            assert_eq!(forward, wraps, "{count}");
            assert!(wraps == 0 || layout.routes.contains_key(&(count - 1, 0)), "{count}");
        }
    }

    #[test]
    fn many_readers_of_one_output_are_spread_over_columns() {
        let sizes = vec![[208.0, 240.0]; 25];
        let edges: Vec<(usize, usize)> = (1..25).map(|i| (0, i)).collect();
        let layout = fitted(&sizes, &edges, &[], WINDOW);
        assert!(!overlaps(&layout.positions, &sizes));
        let (share, scale) = used(&layout, &sizes, WINDOW);
        assert!(share > 0.55 && scale > 0.35, "{share} {scale}");
    }

    #[test]
    fn paths_between_rows_pass_no_node() {
        let sizes = vec![[208.0, 240.0]; 23];
        let mut edges: Vec<(usize, usize)> = (1..23).map(|i| (i - 1, i)).collect();
        edges.extend([(0, 20), (3, 17), (5, 22)]);
        let layout = fitted(&sizes, &edges, &[(22, 1)], WINDOW);
        assert!(layout.routes.len() > 4, "{:?}", layout.routes.keys());
        for ((from, to), corners) in &layout.routes {
            let middle = |n: usize| layout.positions[n][1] + sizes[n][1] / 2.0;
            let mut path = vec![[corners[0][0], middle(*from)]];
            path.extend(corners);
            path.push([corners[corners.len() - 1][0], middle(*to)]);
            for ends in path.windows(2) {
                let [a, b] = [ends[0], ends[1]];
                assert!(a[0] == b[0] || a[1] == b[1], "{from} {to}: a line is not straight: {path:?}");
                for (place, size) in layout.positions.iter().zip(&sizes) {
                    let apart = |k: usize| a[k].max(b[k]) <= place[k] || a[k].min(b[k]) >= place[k] + size[k];
                    assert!(apart(0) || apart(1), "{from} to {to} passes {place:?}: {a:?} {b:?}");
                }
            }
        }
    }

    #[test]
    fn a_part_is_laid_out_as_if_it_were_all() {
        let sizes = [[200.0, 150.0], [90.0, 90.0], [200.0, 150.0], [200.0, 150.0]];
        let whole = fitted(&[sizes[0], sizes[2], sizes[3]], &[(0, 1), (1, 2), (0, 2)], &[], WIDE);
        let part = fitted_part(&sizes, &[(0, 2), (2, 3), (0, 3)], &[], WIDE, &[0, 2, 3]);
        assert_eq!([part.positions[0], part.positions[2], part.positions[3]], whole.positions[..]);
        assert_eq!(part.lanes[&(0, 3)], whole.lanes[&(0, 2)]);
    }

    #[test]
    fn loops_and_lone_nodes_have_places() {
        let sizes = [[100.0, 50.0]; 4];
        let positions = fitted(&sizes, &[(0, 1), (1, 2), (2, 0)], &[], WINDOW).positions;
        assert!(!overlaps(&positions, &sizes));
        assert!(fitted(&[], &[], &[], WINDOW).positions.is_empty());
    }

    #[test]
    fn long_wires_pass_beside_nodes() {
        let sizes = [[200.0, 150.0]; 3];
        let layout = fitted(&sizes, &[(0, 1), (1, 2), (0, 2), (0, 2)], &[], WIDE);
        let lane = layout.lanes[&(0, 2)][0];
        let (y, top) = (lane[0][1], layout.positions[1][1]);
        assert!(y < top || y > top + sizes[1][1], "{y} {top}");
    }
}
