//! Evaluates a graph's screen: share of the main image, empty share, share of the known surface that is cut off, and
//! whether the colours of depth cover the depths. On rendered scenes also whether the panorama shows instruments as in
//! one of its views.

mod instruments;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use image::RgbImage;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::{Listener, NumberListener};
use panoscope_graph::GraphOptions;
use panoscope_host::loader::graph_file;
use toml::{Table, Value};

use crate::error::{Context, EvalError, FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::inputs::references::{from, node_of, upstream};
use crate::packets;
use crate::run::{self, Pace, Plan, Watchers};
use crate::session::Session;

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Graph with a `screen`.
    pub graph: PathBuf,
    /// Overlays, arguments and settings.
    pub given: GraphOptions,
    /// Number of ticks.
    pub frames: u64,
    /// Folder for the screen of each tick.
    pub pictures: Option<PathBuf>,
}

/// Evaluated metrics, by the type of the node: name, and whether less is better.
const METRICS: [(&str, &str, bool); 6] = [
    ("screen", "main_pct", false),
    ("screen", "dead_pct", true),
    ("turntable", "cut_pct", true),
    ("colorize", "beyond_pct", true),
    ("composite", "view_gain_pct", false),
    ("composite_mesh", "view_gain_pct", false),
];
/// Limits of the metrics, %, beyond which a tick counts as faulty: share of the main image, dead area, cut surface,
/// depths beyond the colours.
const LIMITS: [(&str, f64); 6] = [
    ("main_pct", 60.0),
    ("dead_pct", 8.0),
    ("cut_pct", 2.0),
    ("beyond_pct", 5.0),
    ("instrument_px", MAX_DEVIATION_PX),
    ("instrument_jump_px", MAX_DEVIATION_PX),
];
/// Maximum brightness of an empty pixel of the screen.
const UNLIT: u8 = 24;

/// Maximum deviation of an instrument in the panorama from the view that shows it, px.
const MAX_DEVIATION_PX: f64 = 1.0;

/// Values of a metric over the ticks.
type Heard = Arc<Mutex<BTreeMap<String, Vec<f64>>>>;

fn hear(heard: &Heard, name: &str, value: f64) {
    let mut all = heard.lock().unwrap_or_else(PoisonError::into_inner);
    all.entry(name.to_owned()).or_default().push(value);
}

/// Share of empty pixels, %, and the image.
fn seen(frame: &FrameRef) -> Option<(f64, RgbImage)> {
    let mut pixels = packets::bytes(frame, 3)?;
    let all = pixels.as_chunks_mut::<3>().0;
    all.iter_mut().for_each(|pixel| pixel.reverse());
    let unlit = all.iter().filter(|pixel| pixel.iter().all(|v| *v <= UNLIT)).count();
    let share = 100.0 * unlit as f64 / all.len().max(1) as f64;
    Some((share, RgbImage::from_raw(frame.frame().width, frame.frame().height, pixels)?))
}

/// Runs the graph up to its screens and evaluates each tick.
///
/// # Errors
/// The graph has mistakes or no screen, the run fails, an image cannot be written, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let ready =
        graph_file::open(&options.graph, &options.given).map_err(|diagnostics| EvalError::Check { diagnostics })?;
    let mut graph: Table = ready.text.settled(&ready.catalog).context("the settings")?.parse()?;
    graph.remove("preset");
    graph.remove("editor");
    graph.insert("mode".to_owned(), "batch".into());
    let is_screen = |node: &&panoscope_graph::Node| node.type_name == "screen";
    let screens: Vec<String> = ready.graph.nodes.iter().filter(is_screen).map(|node| node.id.clone()).collect();
    let images: Vec<String> = screens.iter().map(|id| format!("{id}.image")).collect();
    if images.is_empty() {
        let reason = format!("{}: it has no node of type `screen` to judge", options.graph.display());
        return Err(EvalError::Options { reason });
    }
    // What only sinks read is left out, so nothing is written.
    let shown: Vec<&str> = images.iter().map(String::as_str).collect();
    let nodes = graph.get_mut("nodes").and_then(Value::as_table_mut).context("the graph's nodes")?;
    let needed = upstream(nodes, &shown, None);
    nodes.retain(|id, _| needed.contains(id));

    let heard = Heard::default();
    let mut numbers = Vec::new();
    for node in ready.graph.nodes.iter().filter(|node| needed.contains(&node.id)) {
        let of_node = METRICS.iter().filter(|(kind, ..)| *kind == node.type_name);
        let metrics: Vec<&str> = of_node.map(|(_, metric, _)| *metric).collect();
        if metrics.is_empty() {
            continue;
        }
        let (heard, id) = (Arc::clone(&heard), node.id.clone());
        let record = move |_: &panoscope_abi::Tick, name: &str, value: f64| {
            if metrics.contains(&name) {
                hear(&heard, &format!("{name}/{id}"), value);
            }
        };
        numbers.push(NumberListener { node: node.id.clone(), hear: Arc::new(record) });
    }
    if let Some(folder) = &options.pictures {
        std::fs::create_dir_all(folder).on_file(FileAction::Create, folder)?;
    }
    let failed: Arc<Mutex<Option<(PathBuf, image::ImageError)>>> = Arc::default();
    let mut listen = listen_to_instruments(nodes, &heard);
    listen.extend(screens.iter().map(|node| {
        let (heard, key) = (Arc::clone(&heard), format!("unlit_pct/{node}"));
        let (failed, folder, name) = (Arc::clone(&failed), options.pictures.clone(), node.replace('/', "_"));
        let look = move |packet: &FrameRef| {
            let Some((unlit, picture)) = seen(packet) else { return };
            hear(&heard, &key, unlit);
            let Some(folder) = &folder else { return };
            let file = folder.join(format!("{name}_{:06}.png", packet.tick().seq));
            if let Err(error) = picture.save(&file) {
                failed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert((file, error));
            }
        };
        Listener { node: node.clone(), output: "image".to_owned(), hear: Arc::new(look) }
    }));
    let text = graph.to_string();
    let path = std::path::absolute(&options.graph).unwrap_or_else(|_| options.graph.clone());
    let plan =
        Plan { text: &text, path: &path, frames: Some(options.frames), threads: 0, ports: &[], pace: Pace::Alone };
    run::run_watched(session, &plan, Watchers { listen, numbers, tracer: None })?;
    if let Some((file, error)) = failed.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(error).with_context(|| format!("cannot write {}", file.display()));
    }
    let heard = heard.lock().unwrap_or_else(PoisonError::into_inner);
    Ok(heard.iter().flat_map(|(name, values)| figures(name, values, &options.graph)).collect())
}

/// Listeners that compare the instruments of each panorama with those of its two views, if the views are rendered.
fn listen_to_instruments(nodes: &Table, heard: &Heard) -> Vec<Listener> {
    if !nodes.values().any(|node| node.get("type").and_then(Value::as_str) == Some("phantom")) {
        return Vec::new();
    }
    let mut all = Vec::new();
    for (id, node) in nodes {
        let is_composite = node.get("type").and_then(Value::as_str).is_some_and(|t| t.starts_with("composite"));
        let input = |name: &str| node.get("inputs").and_then(|inputs| inputs.get(name)).and_then(from);
        let (true, Some(left), Some(right)) = (is_composite, input("left"), input("right")) else { continue };
        let panorama = format!("{id}.panorama");
        let watch =
            Arc::new(Mutex::new(InstrumentWatch { id: id.clone(), heard: Arc::clone(heard), ..Default::default() }));
        for (index, output) in [&panorama, left, right].into_iter().enumerate() {
            let watch = Arc::clone(&watch);
            let hear = move |packet: &FrameRef| {
                watch.lock().unwrap_or_else(PoisonError::into_inner).take(index, packet);
            };
            let port = output.split_once('.').map_or("", |(_, port)| port);
            all.push(Listener { node: node_of(output).to_owned(), output: port.to_owned(), hear: Arc::new(hear) });
        }
    }
    all
}

/// Compares the instruments of a panorama with those of its views, tick by tick.
#[derive(Default)]
struct InstrumentWatch {
    /// The composite.
    id: String,
    heard: Heard,
    /// Panorama, left and right view of ticks that are not complete.
    waiting: BTreeMap<u64, [Option<instruments::Image>; 3]>,
    /// View that showed the largest instrument in the previous tick, and its offset there.
    before: Option<(usize, [f64; 2])>,
}

impl InstrumentWatch {
    fn take(&mut self, index: usize, packet: &FrameRef) {
        let (width, height) = (packet.frame().width as usize, packet.frame().height as usize);
        let Some(pixels) = packets::bytes(packet, 3) else { return };
        let seq = packet.tick().seq;
        let images = self.waiting.entry(seq).or_default();
        images[index] = Some(instruments::Image { width, height, pixels });
        let [Some(panorama), Some(left), Some(right)] = images else { return };
        let found = instruments::compare(panorama, [left, right]);
        // Ticks without a panorama never become complete.
        self.waiting.retain(|other, _| *other > seq);
        if let Some(worst) = found.deviations_px.iter().copied().reduce(f64::max) {
            hear(&self.heard, &format!("instrument_px/{}", self.id), worst);
        }
        // Against the view of the previous tick, so that a change of the view counts.
        if let Some((view, before)) = self.before
            && let Some(now) = found.offsets[view]
        {
            let moved = (now[0] - before[0]).hypot(now[1] - before[1]);
            hear(&self.heard, &format!("instrument_jump_px/{}", self.id), moved);
        }
        self.before = found.view.and_then(|view| Some((view, found.offsets[view]?)));
    }
}

/// Median and worst value of a metric, and the number of ticks beyond its limit.
fn figures(name: &str, values: &[f64], graph: &Path) -> Vec<Figure> {
    let metric = name.split('/').next().unwrap_or(name);
    let more_is_better = METRICS.iter().any(|(_, known, less)| *known == metric && !less);
    let unit = if metric.ends_with("_px") { "px" } else { "%" };
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let input = format!("{}, {} pictures", graph.display(), values.len());
    let at = |index: usize| sorted.get(index).copied().unwrap_or(f64::NAN);
    let worst = if more_is_better { at(0) } else { at(sorted.len().saturating_sub(1)) };
    let mut found = vec![
        Figure::new(&format!("{name}/median"), at(sorted.len() / 2), unit, &input),
        Figure::new(&format!("{name}/worst"), worst, unit, &input),
    ];
    if let Some((_, limit)) = LIMITS.iter().find(|(known, _)| *known == metric) {
        let misses = |v: &&f64| if more_is_better { **v < *limit } else { **v > *limit };
        let count = sorted.iter().filter(misses).count() as f64;
        let side = if more_is_better { "below" } else { "above" };
        found.push(Figure::new(
            &format!("{name}/{side}_{limit}_{}", if unit == "%" { "pct" } else { unit }),
            count,
            "pictures",
            &input,
        ));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metric_has_its_median_its_worst_and_its_misses() {
        let of = |name: &str, values: &[f64]| -> Vec<(String, f64)> {
            figures(name, values, Path::new("g.toml")).into_iter().map(|f| (f.name, f.value)).collect()
        };
        let named = |name: &str, value: f64| (name.to_owned(), value);
        let main = of("main_pct/screen", &[70.0, 59.0, 65.0]);
        assert_eq!(main[..2], [named("main_pct/screen/median", 65.0), named("main_pct/screen/worst", 59.0)]);
        assert_eq!(main[2], named("main_pct/screen/below_60_pct", 1.0));
        let cut = of("cut_pct/turn", &[0.5, 3.0, 0.1]);
        assert_eq!(cut[1..], [named("cut_pct/turn/worst", 3.0), named("cut_pct/turn/above_2_pct", 1.0)]);
        assert_eq!(of("unlit_pct/screen", &[12.0]).len(), 2, "no limit");
    }
}
