//! Cost of a tick by number of nodes.

use super::graph::{self, Pace};
use crate::error::Result;
use crate::figures::Figure;
use crate::session::{Session, note};
use crate::statistics as fit;

const NODES: [usize; 7] = [10, 20, 50, 100, 200, 500, 1_000];

/// Time of a tick in chains of 10 to 1,000 nodes: number of nodes and ns.
pub(super) fn ticks(session: &dyn Session, quick: bool) -> Result<Vec<(f64, f64)>> {
    let (ticks, rounds) = if quick { (200_000, 1) } else { (2_000_000, 3) };
    let mut points: Vec<(f64, f64)> = Vec::new();
    for &nodes in &NODES {
        let text = graph::chain("pass", nodes - 2, None, Pace::Saturated);
        let mut best = f64::INFINITY;
        for _ in 0..rounds {
            let frames = (ticks / nodes as u64).max(500);
            best = best.min(graph::run(session, &text, frames)?.ns_per_tick());
        }
        points.push((nodes as f64, best));
    }
    Ok(points)
}

/// Measures chains of 10 to 1,000 nodes: linear cost means the same per node at both ends.
pub fn measure(session: &dyn Session, quick: bool) -> Result<Vec<Figure>> {
    let points = ticks(session, quick)?;
    let of_chain =
        |&(nodes, ns): &(f64, f64)| Figure::new(&format!("tick/{nodes}"), ns, "ns", &format!("chain of {nodes} nodes"));
    let mut figures: Vec<Figure> = points.iter().map(of_chain).collect();
    let (slope, offset) = fit::line(&points);
    note!(session, "time per tick = {slope:.1} ns x nodes {offset:+.0} ns");
    let per_node = |i: usize| (points[i].1 - offset) / points[i].0;
    let last = points.len() - 1;
    figures.push(Figure::new("tick_per_node", slope, "ns", "chains of 10 to 1,000 nodes"));
    figures.push(Figure::new(
        "tick_linearity",
        fit::r_squared(&points),
        "r2",
        "line through chains of 10 to 1,000 nodes",
    ));
    figures.push(Figure::new(
        "tick_per_node/1000_to_100",
        per_node(last) / per_node(3),
        "1",
        "1 = the same cost per node",
    ));
    Ok(figures)
}
