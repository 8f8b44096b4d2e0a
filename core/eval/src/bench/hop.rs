//! Cost of passing a frame from node to node.

use super::copper::{self, Copper};
use super::death;
use super::graph::{self, INPUT, Pace};
use super::gstreamer::GStreamer;
use super::python;
use crate::error::Result;
use crate::figures::Figure;
use crate::session::{Session, note};
use crate::statistics as fit;

const INLINE: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];
const THREADS: [usize; 4] = [1, 2, 4, 8];
const PACED_HZ: f64 = 200.0;
const QUEUE: u32 = 64;
const IDENTITY: &str = "identity silent=true signal-handoffs=false";
// `silent`: it need not signal that it runs full or empty.
const GST_QUEUE: &str = "queue silent=true max-size-buffers=64 max-size-bytes=0 max-size-time=0";

/// Minimum time per chain length over the rounds, ours and the peer's.
struct Series {
    lengths: Vec<usize>,
    ours: Vec<f64>,
    peer: Vec<Option<f64>>,
}

impl Series {
    fn new(lengths: &[usize]) -> Self {
        let n = lengths.len();
        Self { lengths: lengths.to_vec(), ours: vec![f64::INFINITY; n], peer: vec![None; n] }
    }

    fn peer_min(&mut self, index: usize, value: f64) {
        let slot = &mut self.peer[index];
        *slot = Some(slot.map_or(value, |v| v.min(value)));
    }

    fn slope(&self) -> f64 {
        let points: Vec<_> = self.lengths.iter().zip(&self.ours).map(|(&n, &v)| (n as f64, v)).collect();
        fit::line(&points).0
    }

    fn peer_slope(&self) -> Option<f64> {
        let points: Option<Vec<_>> =
            self.lengths.iter().zip(&self.peer).map(|(&n, v)| Some((n as f64, (*v)?))).collect();
        Some(fit::line(&points?).0)
    }

    fn points(&self, session: &dyn Session, title: &str) {
        let text = |v: f64| format!("{v:.0}");
        let ours: Vec<String> =
            self.lengths.iter().zip(&self.ours).map(|(n, v)| format!("{n}: {}", text(*v))).collect();
        note!(session, "{title}, ns by chain length: {}", ours.join(", "));
        let peer: Vec<String> = self.peer.iter().flatten().map(|v| text(*v)).collect();
        if !peer.is_empty() {
            note!(session, "    GStreamer: {}", peer.join(", "));
        }
    }
}

/// Options of [`measure`].
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Fewer frames and rounds: a quick check, not a measurement.
    pub quick: bool,
    /// Builds copper-rs and measures an inline chain of its tasks, too.
    pub copper: bool,
}

/// Measures all cases, alternating with GStreamer if it is installed, and with copper-rs if it is asked for.
///
/// # Errors
/// A graph does not run, or copper-rs was asked for and cannot be built.
pub fn measure(session: &dyn Session, options: Options) -> Result<Vec<Figure>> {
    let quick = options.quick;
    let copper = options.copper.then(|| Copper::build(session, &INLINE)).transpose()?;
    let gst = GStreamer::open();
    if gst.is_none() {
        note!(session, "GStreamer is not installed: measured without a peer");
    }
    let mut figures = inline(session, quick, gst.as_ref(), copper.as_ref())?;
    figures.extend(saturated(session, quick, gst.as_ref())?);
    figures.extend(paced(session, quick, gst.as_ref())?);
    figures.extend(isolated(session, quick)?);
    figures.extend(death::measure(session, quick)?);
    figures.extend(python::measure(session, quick)?);
    figures.extend(copies(session, quick)?);
    Ok(figures)
}

fn inline(session: &dyn Session, quick: bool, gst: Option<&GStreamer>, copper: Option<&Copper>) -> Result<Vec<Figure>> {
    // Many short runs: the least of them is the one that nothing else disturbed.
    let (calls, rounds) = if quick { (300_000, 4) } else { (1_000_000, 15) };
    // As many calls in a short chain as in a long one: the start of a run, a quarter of a millisecond, is no part of a tick.
    let frames_of = |length: usize| calls / (length as u64 + 2);
    let mut wall = Series::new(&INLINE);
    let mut cpu = Series::new(&INLINE);
    let mut compiled = Series::new(&INLINE);
    let mut allocations = Vec::new();
    for _ in 0..rounds {
        for (index, &length) in INLINE.iter().enumerate() {
            let frames = frames_of(length);
            let run = graph::run(session, &graph::chain("pass", length, Some(QUEUE), Pace::Saturated), frames)?;
            wall.ours[index] = wall.ours[index].min(run.ns_per_tick());
            cpu.ours[index] = cpu.ours[index].min(run.cpu_seconds * 1e9 / frames as f64);
            allocations.extend(run.report.allocations_per_frame);
            if let Some(gst) = gst {
                wall.peer_min(index, gst.run(session, &vec![IDENTITY; length], frames, None)?.ns_per_frame);
            }
            if let Some(copper) = copper {
                compiled.peer_min(index, copper.ns_per_tick(length, frames)?);
            }
        }
    }
    wall.points(session, "inline chain, time per tick");
    cpu.points(session, "inline chain, processor time per tick");
    let peer = "GStreamer identity";
    let mut figures = vec![
        Figure::new("hop_inline", wall.slope(), "ns", INPUT).beside(peer, wall.peer_slope()),
        Figure::new("hop_inline/processor_time", cpu.slope(), "ns", INPUT),
        Figure::new("tick_inline", wall.ours[0], "ns", "640x480 bgr8, source, one node and sink"),
    ];
    if let (Some(hop), [Some(tick), ..]) = (compiled.peer_slope(), &compiled.peer[..]) {
        figures.push(Figure::new("hop_inline/copper", wall.slope(), "ns", INPUT).beside(copper::NAME, Some(hop)));
        let input = "640x480 bgr8, source, one node and sink";
        figures.push(Figure::new("tick_inline/copper", wall.ours[0], "ns", input).beside(copper::NAME, Some(*tick)));
    }
    // The median: a worker that wakes for the first time late in a run sets up its thread-locals then.
    allocations.sort_by(f64::total_cmp);
    if let Some(&median) = allocations.get(allocations.len() / 2) {
        figures.push(Figure::new("allocations_per_frame", median, "1/frame", "inline chains of 1 to 64 nodes"));
    }
    let frames = if quick { 200 } else { 1_000 };
    let run = graph::run(session, &graph::chain("pass", 64, None, Pace::Hz(PACED_HZ)), frames)?;
    let gst_run = gst.map(|gst| gst.run(session, &[IDENTITY; 64], frames, Some(PACED_HZ))).transpose()?;
    if let Some(path) = run.report.paths.get("sink") {
        let input = "640x480 bgr8, 64 nodes at 200 Hz, source to sink";
        for (name, ms, q) in [("p50", path.age_p50_ms, 0.5), ("p99", path.age_p99_ms, 0.99)] {
            let value = gst_run.as_ref().map(|r| r.age_ns(q));
            figures.push(Figure::new(&format!("chain_tick/{name}"), ms * 1e6, "ns", input).beside(peer, value));
        }
    }
    Ok(figures)
}

fn saturated(session: &dyn Session, quick: bool, gst: Option<&GStreamer>) -> Result<Vec<Figure>> {
    let (frames, rounds) = if quick { (5_000, 2) } else { (20_000, 8) };
    let mut series = Series::new(&THREADS);
    for _ in 0..rounds {
        for (index, &length) in THREADS.iter().enumerate() {
            let run =
                graph::run(session, &graph::chain("pass_blocking", length, Some(QUEUE), Pace::Saturated), frames)?;
            series.ours[index] = series.ours[index].min(run.ns_per_tick());
            if let Some(gst) = gst {
                series.peer_min(index, gst.run(session, &vec![GST_QUEUE; length], frames, None)?.ns_per_frame);
            }
        }
    }
    series.points(session, "chain of threads, saturated, time per tick");
    // With fewer threads than make all cores busy a slope would credit idle cores; all hops of the longest chain are paid for.
    let longest = THREADS.len() - 1;
    let per_hop = |ns: f64| ns / THREADS[longest] as f64;
    let (peer, input) = ("GStreamer queue", "640x480 bgr8, queues of 64, saturated");
    let whole = format!("{input}: time per frame through 8 threads / 8");
    Ok(vec![
        Figure::new("hop_thread", per_hop(series.ours[longest]), "ns", &whole)
            .beside(peer, series.peer[longest].map(per_hop)),
        Figure::new("hop_thread/slope", series.slope(), "ns", input).beside(peer, series.peer_slope()),
    ])
}

fn paced(session: &dyn Session, quick: bool, gst: Option<&GStreamer>) -> Result<Vec<Figure>> {
    let (frames, rounds) = if quick { (200, 1) } else { (300, 3) };
    let mut p50 = Series::new(&THREADS);
    let mut p99 = Series::new(&THREADS);
    let (mut cpu_share, mut waits) = (f64::INFINITY, 0.0);
    for _ in 0..rounds {
        for (index, &length) in THREADS.iter().enumerate() {
            let run = graph::run(session, &graph::chain("pass_blocking", length, None, Pace::Hz(PACED_HZ)), frames)?;
            if let Some(path) = run.report.paths.get("sink") {
                p50.ours[index] = p50.ours[index].min(path.age_p50_ms * 1e6);
                p99.ours[index] = p99.ours[index].min(path.age_p99_ms * 1e6);
            }
            if length == 8 {
                cpu_share = f64::min(cpu_share, 100.0 * run.cpu_seconds / run.report.seconds.max(1e-9));
                waits = run.waits as f64 / frames as f64;
            }
            if let Some(gst) = gst {
                let run = gst.run(session, &vec![GST_QUEUE; length], frames, Some(PACED_HZ))?;
                p50.peer_min(index, run.age_ns(0.5));
                p99.peer_min(index, run.age_ns(0.99));
            }
        }
    }
    p50.points(session, "chain of threads at 200 Hz, median age at the sink");
    p99.points(session, "chain of threads at 200 Hz, 99 % age at the sink");
    let (peer, input) = ("GStreamer queue", "640x480 bgr8 at 200 Hz");
    // No slope here: the rare late frames of each length are its own.
    let longest = THREADS.len() - 1;
    let per_hop = |age_ns: f64| age_ns / THREADS[longest] as f64;
    Ok(vec![
        Figure::new("hop_thread_paced", p50.slope(), "ns", input).beside(peer, p50.peer_slope()),
        Figure::new(
            "hop_thread_paced/p99",
            per_hop(p99.ours[longest]),
            "ns",
            "8 threads at 200 Hz, age at the sink / 8",
        )
        .beside(peer, p99.peer[longest].map(per_hop)),
        Figure::new(
            "hop_thread_paced/processor_pct",
            cpu_share,
            "% of one core",
            "8 threads at 200 Hz: waiting does not spin",
        ),
        Figure::new("hop_thread_paced/waits_per_frame", waits, "1/frame", "8 threads at 200 Hz"),
    ])
}

/// Round trip of a frame to a node in another process: one message each way. Pixels are not copied.
fn isolated(session: &dyn Session, quick: bool) -> Result<Vec<Figure>> {
    let (frames, rounds) = if quick { (200, 1) } else { (600, 3) };
    let (mut busy_ns, mut paced_ns, mut late_ns) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
    let mut messages = 0.0_f64;
    for _ in 0..rounds {
        let chain = |pace| graph::isolated(&graph::chain("pass", 1, None, pace), "n0");
        let saturated = graph::run(session, &chain(Pace::Saturated), frames * 20)?;
        let paced = graph::run(session, &chain(Pace::Hz(PACED_HZ)), frames)?;
        if let (Some(busy), Some(paced)) = (saturated.report.nodes.get("n0"), paced.report.nodes.get("n0")) {
            busy_ns = busy_ns.min(busy.p50_ms * 1e6);
            paced_ns = paced_ns.min(paced.p50_ms * 1e6);
            late_ns = late_ns.min(paced.p99_ms * 1e6);
        }
        let groups = saturated.report.groups.values().chain(paced.report.groups.values());
        messages = groups.map(|group| group.round_trips as f64 / group.calls.max(1) as f64).fold(messages, f64::max);
    }
    Ok(vec![
        Figure::new("hop_isolated", busy_ns, "ns", "640x480 bgr8 to another process and back, saturated, p50"),
        Figure::new("hop_isolated/paced", paced_ns, "ns", "640x480 bgr8 to another process and back at 200 Hz, p50"),
        Figure::new("hop_isolated/paced_p99", late_ns, "ns", "640x480 bgr8 to another process and back at 200 Hz, p99"),
        Figure::new("hop_isolated/messages", messages, "1/frame", "messages to another process for each frame"),
    ])
}

fn copies(session: &dyn Session, quick: bool) -> Result<Vec<Figure>> {
    let run = graph::run(session, &graph::fan_out(4), if quick { 1_000 } else { 10_000 })?;
    let copies: u64 = run.report.nodes.values().map(|n| n.copies + n.conversions).sum();
    let mut figures = vec![Figure::new("fan_out_copies", copies as f64, "1", "640x480 bgr8 to 4 readers")];
    if let Some(allocations) = run.report.allocations_per_frame {
        figures.push(Figure::new("allocations_per_frame/fan_out", allocations, "1/frame", "640x480 bgr8 to 4 readers"));
    }
    Ok(figures)
}
