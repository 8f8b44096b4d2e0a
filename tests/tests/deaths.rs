//! A campaign of crashes: processes of real nodes die in every way, at random ticks, and no frame is wrong.
//!
//! `PANOSCOPE_DEATH_CASES` sets the number of cases, `PANOSCOPE_DEATH_SEED` selects others. A case that fails is named with its number: the same seed
//! repeats it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use panoscope_base::random::SplitMix64;
use panoscope_engine::fault::{Cause, Fault};
use panoscope_engine::{Options, Outcome, Report};
use panoscope_record::{RecordOptions, Recorder, head};
use panoscope_tests::{isolated_processes, ready, scratch};

const FRAMES: u64 = 40;
const MAX_RUN: Duration = Duration::from_secs(120);
/// Maximum number of ticks that a crash may cost its own group: that of the call, and those during the pause before the node reopens.
const MAX_LOST: u64 = 4;

/// How a process dies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Death {
    /// Misbehaviour of the test node `chaos`, and the cause of the fault.
    Harm(&'static str, Cause),
    /// SIGKILL from outside, at any moment.
    Killed,
}

const DEATHS: [Death; 10] = [
    Death::Harm("segv", Cause::Crash),
    Death::Harm("segv_in_loop", Cause::Crash),
    Death::Harm("abort", Cause::Crash),
    Death::Harm("stack_overflow", Cause::Crash),
    Death::Harm("exit", Cause::Crash),
    Death::Harm("exit_at_once", Cause::Crash),
    Death::Harm("wild_write", Cause::Crash),
    Death::Harm("out_of_memory", Cause::Crash),
    Death::Harm("hang", Cause::Hang),
    Death::Killed,
];

#[derive(Clone, Debug)]
struct Case {
    number: u64,
    death: Death,
    /// Tick at which it dies.
    first: u64,
    threads: usize,
    /// Nodes that share the process of the one that dies.
    with: Vec<&'static str>,
}

/// Nodes that may share its process. Their output does not depend on earlier ticks.
const SHARING: [&str; 5] = ["scope", "rectify", "match", "marks", "passes"];
/// Nodes of the graph's own process and of another group: they lose nothing.
const OTHERS: [&str; 2] = ["twin", "apart"];

impl Case {
    fn new(number: u64, seed: u64) -> Self {
        let mut random = SplitMix64(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ number);
        // Every kind comes as often as any other.
        let death = DEATHS[(number % DEATHS.len() as u64) as usize];
        let with = SHARING.into_iter().filter(|_| random.bits().is_multiple_of(2)).collect();
        let latest = if death == Death::Killed { FRAMES / 2 } else { FRAMES - 4 };
        let (first, threads) = (4 + random.bits() % (latest - 4), 1 + (random.bits() % 3) as usize);
        Self { number, death, first, threads, with }
    }

    fn text(&self, dies: bool) -> String {
        let isolate = |node: &str| match node {
            "bad" => "isolate = \"doomed\"",
            "apart" => "isolate = \"apart\"",
            _ if self.with.contains(&node) => "isolate = \"doomed\"",
            _ => "",
        };
        // A run that is killed from outside takes long enough for that.
        let (harm, first, ticks) = match self.death {
            Death::Harm(harm, _) if dies => (harm, self.first, 1),
            Death::Harm(..) => ("never", 0, 0),
            Death::Killed => ("slow", 0, FRAMES),
        };
        format!(
            r#"
mode = "batch"
plugins = ["phantom", "stereo", "overlay", "flow", "fixtures"]
[nodes.frames]
type = "frames"
params = {{ width_px = 160, height_px = 120, format = "gray8", pattern = "ramp", rate_hz = 100.0 }}
[nodes.bad]
type = "chaos"
{bad}
inputs = {{ image = "frames.image" }}
params = {{ harm = "{harm}", first = {first}, ticks = {ticks}, hang_ms = 600000.0, slow_ms = 5.0 }}
[nodes.scope]
type = "phantom"
{scope}
params = {{ width = 160, height = 120, rate_hz = 100.0 }}
[nodes.rectify]
type = "rectify"
{rectify}
inputs = {{ left = "scope.left", right = "scope.right", calibration = "scope.calibration" }}
[nodes.match]
type = "stereo_bm"
{matching}
inputs = {{ left = "rectify.left", right = "rectify.right" }}
[nodes.marks]
type = "overlay"
{marks}
inputs = {{ image = "scope.left", detections = "scope.detections" }}
[nodes.passes]
type = "pass"
{passes}
inputs = {{ image = "marks.image" }}
[nodes.twin]
type = "pass"
inputs = {{ image = "frames.image" }}
[nodes.apart]
type = "pass"
{apart}
inputs = {{ image = "frames.image" }}
[nodes.end]
type = "drain"
inputs = {{ image = "passes.image" }}
[nodes.colours]
type = "colorize"
inputs = {{ disparity = "match.disparity" }}
# Otherwise the range follows the pictures before.
params = {{ low = 0.0, high = 60.0 }}
[nodes.end_match]
type = "drain"
inputs = {{ image = "colours.image" }}
[nodes.end_twin]
type = "drain"
inputs = {{ image = "twin.image" }}
[nodes.end_apart]
type = "drain"
inputs = {{ image = "apart.image" }}
[nodes.end_bad]
type = "drain"
inputs = {{ image = "bad.image" }}
"#,
            bad = isolate("bad"),
            scope = isolate("scope"),
            rectify = isolate("rectify"),
            matching = isolate("match"),
            marks = isolate("marks"),
            passes = isolate("passes"),
            apart = isolate("apart"),
        )
    }
}

struct Run {
    report: Report,
    outcome: Outcome,
    faults: Vec<Fault>,
    /// Time from a kill to the first fault, ms.
    detection_ms: Option<f64>,
    /// Fingerprint of each packet, by port and tick.
    packets: BTreeMap<String, BTreeMap<u64, u64>>,
}

/// Runs a case; with `dies`, one of its processes dies.
fn run(folder: &Path, case: &Case, dies: bool) -> Result<Run, String> {
    let (path, text) = (folder.join("graph.toml"), case.text(dies));
    let ready = ready(&path, &text)?;
    let record = RecordOptions { digests: true, ..RecordOptions::default() };
    let recorder = Recorder::start(record, head(&ready));
    let recorder = recorder.map_err(|error| error.to_string())?;
    let faults = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&faults);
    let hear = move |fault: &Fault| {
        if let Ok(mut faults) = heard.lock() {
            faults.push((Instant::now(), fault.clone()));
        }
    };
    let before = isolated_processes();
    let options = Options {
        frames: Some(FRAMES),
        threads: case.threads,
        // In batch a call hangs after 30 times this.
        hang: Duration::from_millis(100),
        group_memory_bytes: 1 << 30,
        faults: Some(Box::new(hear)),
        observer: Some(Arc::clone(&recorder) as _),
        ..Options::default()
    };
    let live = ready.start(options).map_err(|error| error.to_string())?;
    let engine = live.engine();
    let end = Instant::now() + MAX_RUN;
    let mut killed_at = None;
    while !engine.wait(Some(Duration::from_millis(1))) {
        if Instant::now() > end {
            return Err(format!("the graph did not end: {:?}", engine.recent_log()));
        }
        let is_due = || engine.report().nodes["bad"].count >= case.first;
        if dies && case.death == Death::Killed && killed_at.is_none() && is_due() {
            killed_at = kill(&before, "doomed");
        }
    }
    let outcome = engine.close(Duration::from_secs(30));
    let report = engine.report();
    drop(live);
    let left = || isolated_processes().difference(&before).count();
    while left() > 0 {
        if Instant::now() > end {
            return Err(format!("{} processes stay behind", left()));
        }
        std::thread::yield_now();
    }
    let ports = recorder.finish().digests.ok_or("no fingerprints")?.ports.into_iter();
    let packets = ports
        .map(|(name, port)| (name, port.packets.iter().map(|packet| (packet.seq, packet.hash)).collect()))
        .collect();
    let faults = faults.lock().map(|faults| faults.clone()).unwrap_or_default();
    let first = killed_at.zip(faults.iter().map(|(at, _)| *at).min());
    let detection_ms = first.map(|(killed, seen)| seen.saturating_duration_since(killed).as_secs_f64() * 1e3);
    let faults = faults.into_iter().map(|(_, fault)| fault).collect();
    Ok(Run { report, outcome, faults, detection_ms, packets })
}

fn read(process: i32, file: &str) -> String {
    std::fs::read_to_string(format!("/proc/{process}/{file}")).unwrap_or_default()
}

/// Kills the process of a group. Returns the time, if there is such a process.
fn kill(before: &BTreeSet<i32>, group: &str) -> Option<Instant> {
    let process = isolated_processes().difference(before).copied().find(|p| read(*p, "cmdline").contains(group))?;
    let now = Instant::now();
    // SAFETY: a plain system call; a process that this one started and has not waited for, or that has just ended by itself.
    (unsafe { libc::kill(process, libc::SIGKILL) } == 0).then_some(now)
}

/// What a case showed.
#[derive(Default)]
struct Figures {
    detection_ms: Vec<f64>,
    recovery_ms: Vec<f64>,
    pictures: usize,
}

/// Runs a case and compares it with the same graph without a crash.
fn judge(case: &Case, figures: &mut Figures) -> Result<(), String> {
    let folder = scratch(&format!("death-{}", case.number));
    let whole = run(&folder, case, false)?;
    let cut = run(&folder, case, true)?;
    let _ = std::fs::remove_dir_all(&folder);
    if whole.outcome != Outcome::Done || !whole.faults.is_empty() {
        return Err(format!("without a death: {:?}, {:?}", whole.outcome, whole.faults));
    }
    if cut.outcome != Outcome::Done {
        return Err(format!("the run ended: {:?}", cut.outcome));
    }
    let is_doomed = |node: &str| node == "bad" || case.with.contains(&node);
    if let Some(fault) = cut.faults.iter().find(|fault| !is_doomed(&fault.node)) {
        return Err(format!("a fault of a node of another process: {fault:?}"));
    }
    let cause = match case.death {
        Death::Harm(_, cause) => cause,
        Death::Killed => Cause::Crash,
    };
    if !cut.faults.iter().any(|fault| fault.cause == cause) {
        return Err(format!("no fault is a {cause:?}: {:?}", cut.faults));
    }
    if let Death::Harm(..) = case.death
        && !cut.faults.iter().any(|fault| fault.node == "bad" && fault.seq == Some(case.first))
    {
        return Err(format!("the node that died is not named: {:?}", cut.faults));
    }
    let none = BTreeMap::new();
    for (port, expected) in &whole.packets {
        let made = cut.packets.get(port).unwrap_or(&none);
        let node = port.split('.').next().unwrap_or(port);
        let moved = case.with.contains(&"scope") && !["frames", "bad", "twin", "apart"].contains(&node);
        compare(port, expected, made, moved)?;
        figures.pictures += made.len();
        let lost = expected.len() as u64 - made.len() as u64;
        if (OTHERS.contains(&node) || node == "frames") && lost > 0 {
            return Err(format!("`{port}` of another process lost {lost} ticks"));
        }
        if lost > MAX_LOST {
            return Err(format!("`{port}` lost {lost} ticks"));
        }
    }
    figures.detection_ms.extend(cut.detection_ms);
    figures.recovery_ms.extend(cut.report.nodes.values().map(|n| n.recovery_max_ms).filter(|ms| *ms > 0.0));
    Ok(())
}

/// Every packet belongs to its tick; after a source that died (`moved`), it is the next one of the undisturbed run.
fn compare(port: &str, expected: &BTreeMap<u64, u64>, made: &BTreeMap<u64, u64>, moved: bool) -> Result<(), String> {
    let order: Vec<u64> = expected.values().copied().collect();
    let mut at = 0;
    for (seq, hash) in made {
        if expected.get(seq) == Some(hash) && !moved {
            continue;
        }
        // A picture may be missing where a node behind the source died with it.
        let next =
            order[at..].iter().position(|known| known == hash).filter(|ahead| moved && *ahead as u64 <= MAX_LOST);
        match next {
            Some(ahead) => at += ahead + 1,
            None => return Err(format!("`{port}` at tick {seq} has other content than it should")),
        }
    }
    Ok(())
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

fn print(what: &str, mut times_ms: Vec<f64>) {
    times_ms.sort_by(f64::total_cmp);
    let Some(last) = times_ms.last() else { return };
    let at = |q: f64| times_ms[((times_ms.len() as f64 * q) as usize).min(times_ms.len() - 1)];
    println!("{what}: {} times, p50 {:.1} ms, p99 {:.1} ms, longest {last:.1} ms", times_ms.len(), at(0.5), at(0.99));
}

#[test]
fn no_death_of_a_process_costs_another_node_a_tick_or_a_picture_a_byte() {
    let (cases, seed) = (number("PANOSCOPE_DEATH_CASES", 8), number("PANOSCOPE_DEATH_SEED", 1));
    let mut figures = Figures::default();
    let mut failures = Vec::new();
    for index in 0..cases {
        let case = Case::new(index, seed);
        if let Err(reason) = judge(&case, &mut figures) {
            failures.push(format!("{case:?} of seed {seed}: {reason}"));
        }
    }
    println!("{cases} deaths, {} not as they should be, {} packets compared", failures.len(), figures.pictures);
    print("from SIGKILL to the fault", figures.detection_ms);
    print("from a fault to the next good packet", figures.recovery_ms);
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
