//! Evaluates the arm: tracking error in the real graph and without images, violations of its limits, time of the
//! control.

mod graph;
mod plots;
mod preset;

use std::path::PathBuf;
use std::time::Instant;

use panoscope_arm_core::control::{CameraGeometry, Controller, SeenTip, goal_mm};
use panoscope_arm_core::interlock::Evidence;
use panoscope_arm_core::rehearsal::{self, Measures, Scenario, measure};
use panoscope_arm_core::{Chain, Interlock, JointVector, campaign};

use crate::error::{EvalError, Result};
use crate::figures::Figure;
use crate::inputs::{create, shipped_model, wants};
use crate::session::{Session, check_cancelled, note};
use crate::statistics::percentile;

/// AutoCam on the dVRK (arXiv 2505.10398): error of the tool in the image, and share of time in view.
const PEER: &str = "AutoCam on dVRK, published";
const PEER_ERROR_MM: f64 = 1.95;
const PEER_VIEW_PCT: f64 = 99.84;

/// Options of [`judge`].
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Parts to run; repeatable. Default: all.
    #[arg(long = "part", value_name = "PART", value_parser = PARTS)]
    pub parts: Vec<String>,
    /// Scenarios to run; repeatable. Default: all.
    #[arg(long = "scenario", value_name = "SCENARIO")]
    pub scenarios: Vec<String>,
    /// Length of each run, s of media time.
    #[arg(long, default_value_t = Self::default().seconds, value_parser = clap::value_parser!(u32).range(8..=3600))]
    pub seconds: u32,
    /// Width of the phantom's images in the graph's runs, px.
    #[arg(long, default_value_t = Self::default().width, value_parser = clap::value_parser!(u32).range(64..=1920))]
    pub width: u32,
    /// Inputs of the campaign against the limits.
    #[arg(long = "cases", value_name = "CASES", default_value_t = Self::default().hostile_inputs)]
    pub hostile_inputs: u64,
    /// Seed of strokes and campaign.
    #[arg(long, default_value_t = Self::default().seed)]
    pub seed: u64,
    /// Folder for the plots of each scenario.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
}

/// Names of the parts.
pub const PARTS: [&str; 5] = ["rehearsal", "graph", "age", "limits", "time"];

impl Default for Options {
    fn default() -> Self {
        Self {
            parts: Vec::new(),
            scenarios: Vec::new(),
            seconds: 60,
            width: 320,
            hostile_inputs: 1_000_000,
            seed: 7,
            pictures: None,
        }
    }
}

/// Error of the tip, share of time in view, limits and time of the control, for the wanted parts and scenarios.
///
/// # Errors
/// A scenario is not known, a run fails, a file cannot be written, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let known: Vec<&str> =
        Scenario::ALL.iter().map(|s| s.name()).chain(graph::SCENARIOS).chain(preset::names()).collect();
    if let Some(wrong) = options.scenarios.iter().find(|name| !known.contains(&name.as_str())) {
        let mut known = known;
        known.sort_unstable();
        known.dedup();
        let reason = format!("no scenario is called `{wrong}`; there are {}", known.join(", "));
        return Err(EvalError::Options { reason });
    }
    let chain = Chain::shipped()?;
    create(options.pictures.as_deref())?;
    let mut figures = Vec::new();
    if wants(&options.parts, "rehearsal") {
        for scenario in Scenario::ALL.into_iter().filter(|s| wants(&options.scenarios, s.name())) {
            let goals = rehearsal::shipped_goals();
            let rows = rehearsal::play(&chain, scenario, options.seed, f64::from(options.seconds), 30.0, &goals);
            let input = format!("tips by script, {} s at 30 Hz, no pictures", options.seconds);
            listed(session, scenario.name(), &measure(&rows), scenario == Scenario::Rest, &input, &mut figures);
            if let Some(folder) = &options.pictures {
                plots::draw(&folder.join(format!("{}.png", scenario.name())), scenario.name(), &rows)?;
            }
            check_cancelled(session)?;
        }
    }
    if wants(&options.parts, "graph") {
        for name in graph::SCENARIOS.into_iter().filter(|name| wants(&options.scenarios, name)) {
            if name == graph::DETECTOR && shipped_model("instruments.onnx").is_none() {
                note!(session, "skipped: {name}: there is no plugins/tools/models/instruments.onnx");
                continue;
            }
            let run = graph::run(session, name, options.seed, options.seconds, options.width)?;
            let input = format!("graph on the phantom {}x{}, {} s at 30 Hz", run.size.0, run.size.1, options.seconds);
            listed(session, &format!("graph_{name}"), &measure(&run.rows), name == "still", &input, &mut figures);
            if let Some(folder) = &options.pictures {
                plots::draw(&folder.join(format!("graph_{name}.png")), &format!("graph {name}"), &run.rows)?;
            }
            check_cancelled(session)?;
        }
        for name in preset::names().filter(|name| wants(&options.scenarios, name)) {
            let Some(file) = preset::file(name) else {
                note!(session, "skipped: {name}: there is no graphs folder in this one, nor beside the program");
                continue;
            };
            let run = graph::run_preset(session, name, options.seed, options.seconds, file)?;
            let input = format!("as it ships, phantom {}x{}, {} s at 30 Hz", run.size.0, run.size.1, options.seconds);
            listed(session, &format!("graph_{name}"), &measure(&run.rows), false, &input, &mut figures);
            if let Some(folder) = &options.pictures {
                plots::draw(&folder.join(format!("graph_{name}.png")), &format!("graph {name}"), &run.rows)?;
            }
            check_cancelled(session)?;
        }
    }
    if wants(&options.parts, "age") {
        let seconds = options.seconds.min(20);
        let (p50, p99) = graph::set_point_age(session, options.seed, seconds, options.width)?;
        let input = format!("graph live at 30 Hz, rendering {} px included, {seconds} s", options.width);
        figures.push(Figure::new("setpoint_age_p50", p50, "ms", &input));
        figures.push(Figure::new("setpoint_age_p99", p99, "ms", &input));
    }
    if wants(&options.parts, "limits") {
        limits(session, &chain, options, &mut figures)?;
    }
    if wants(&options.parts, "time") {
        time(&chain, &mut figures);
    }
    Ok(figures)
}

/// Figures of one run.
fn listed(session: &dyn Session, name: &str, m: &Measures, rests: bool, input: &str, figures: &mut Vec<Figure>) {
    if !m.rms_mm.is_finite() {
        note!(session, "{name}: no tick with a known tip to judge; give it more --seconds");
        return;
    }
    let mut add = |measure: &str, value: f64, unit| {
        figures.push(Figure::new(&format!("{measure}/{name}"), value, unit, input));
    };
    add("tip_error_mm", m.rms_mm, "mm");
    add("in_view_pct", m.in_view_pct, "%");
    add("hidden_pct", m.hidden_pct, "%");
    add("tip_seen_pct", m.tip_seen_pct, "%");
    if m.track_off_mm.is_finite() {
        add("track_off_mm", m.track_off_mm, "mm");
    }
    add("pivot_mm", m.pivot_mm, "mm");
    add("tip_error_max_mm", m.max_mm, "mm");
    add("shake_mm_s2", m.shake_mm_s2, "mm/s^2");
    if rests {
        add("rest_pct", m.rest_pct, "%");
        add("rest_mm", m.rest_mm, "mm");
    }
    if name.ends_with("step") && m.settling_s.is_finite() {
        add("settling_s", m.settling_s, "s");
        add("overshoot_pct", m.overshoot_pct, "%");
    }
    if name.ends_with("strokes") {
        for figure in figures.iter_mut().filter(|f| f.name.ends_with(&format!("/{name}"))) {
            let (peer, more) = match figure.name.split('/').next() {
                Some("tip_error_mm") => (PEER_ERROR_MM, false),
                Some("in_view_pct") => (PEER_VIEW_PCT, true),
                _ => continue,
            };
            figure.peer = Some(PEER.to_owned());
            figure.peer_value = Some(peer);
            figure.ratio = Some(if more { figure.value / peer } else { peer / figure.value });
        }
    }
}

/// The campaign against the interlock.
fn limits(session: &dyn Session, chain: &Chain, options: &Options, figures: &mut Vec<Figure>) -> Result<()> {
    let mut out = campaign::Outcome::default();
    let mut part = 0;
    while out.cases < options.hostile_inputs {
        let cases = (options.hostile_inputs - out.cases).min(20_000);
        out.add(campaign::run(chain, options.seed.wrapping_mul(1_000_003).wrapping_add(part), cases));
        part += 1;
        check_cancelled(session)?;
    }
    if let Some(first) = &out.first {
        note!(session, "a limit was passed: {first}");
    }
    let input = format!("{} hostile inputs, {} set-points checked", out.cases, out.set_points);
    figures.push(Figure::new("limit_escapes", out.escapes as f64, "set-points", &input));
    let names = ["angle", "speed", "acceleration", "jerk", "camera_speed", "pivot", "tilt"];
    for (name, most) in names.into_iter().zip(out.most) {
        figures.push(Figure::new(&format!("limit_share/{name}"), 100.0 * most, "%", &input));
    }
    Ok(())
}

/// Time of one tick of controller and interlock, 33 ms of set-points included.
fn time(chain: &Chain, figures: &mut Vec<Figure>) {
    let cameras = CameraGeometry { focal_px: (750.0, 750.0), baseline_mm: 15.0 };
    let goals = rehearsal::shipped_goals();
    let mut controller = Controller::new(chain.clone());
    let mut lock = Interlock::new(chain.clone(), JointVector::zeros(), 0);
    let mut micros = Vec::with_capacity(3000);
    for tick in 0..3000_i64 {
        let now_ns = tick * 33_333_333;
        let angle = tick as f64 * 0.04;
        let off = nalgebra::Vector3::new(4.0 * angle.sin(), 3.0 * angle.cos(), 2.0 * (0.7 * angle).sin());
        let tip = SeenTip { xyz_mm: goal_mm(66.0, 15.0) + off, score: 0.9, age_s: 0.0 };
        let start = Instant::now();
        let at = lock.set_point().position;
        let step = controller.step(now_ns, Some(tip), &at, Some(&at), &cameras, &goals);
        lock.tip(now_ns, Evidence { score: tip.score, in_space: true });
        if let Some(step) = step {
            lock.demand(now_ns, step.velocity.as_slice());
        }
        lock.advance(now_ns + 33_333_333, &mut |_| {});
        micros.push(start.elapsed().as_secs_f64() * 1e6);
        while lock.take_event().is_some() {}
    }
    let input = "controller and interlock, one tick of 33 ms while moving, 3000 ticks";
    figures.push(Figure::new("control_us", percentile(&micros, 0.5), "us", input));
    figures.push(Figure::new("control_us/p99", percentile(&micros, 0.99), "us", input));
}
