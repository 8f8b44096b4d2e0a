//! Cost of a call of an isolated node, permissions of its process, and where a source continues after its process died.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use panoscope_engine::fault::Cause;
use panoscope_engine::{Engine, Options, Outcome};
use panoscope_host::isolate::kernel;
use panoscope_tests::{DisturbedRun, isolated_processes, run_disturbed, scratch};

/// Runs one test at a time: they kill processes of this one.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A filter that forwards, one that makes frames, one that writes to its input's pixels, one that asks for ages, and a source with a clock.
const FILTERS: &str = r#"
mode = "batch"
plugins = ["flow", "phantom", "stereo", "overlay", "fixtures"]
[nodes.scope]
type = "phantom"
isolate = "renders"
params = { width = 160, height = 120 }
[nodes.passes]
type = "pass"
isolate = "forwards"
inputs = { image = "scope.left" }
[nodes.rectify]
type = "rectify"
isolate = "makes"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
[nodes.marks]
type = "overlay"
isolate = "writes"
inputs = { image = "scope.left", detections = "scope.detections" }
[nodes.old]
type = "ages"
isolate = "asks"
inputs = { image = "passes.image" }
[nodes.end]
type = "drain"
inputs = { image = "marks.image" }
[nodes.end_left]
type = "drain"
inputs = { image = "rectify.left" }
"#;

#[test]
fn a_call_of_a_filter_is_one_message_there_and_one_back() {
    let _alone = alone();
    const FRAMES: u64 = 60;
    let folder = scratch("isolated-messages");
    let DisturbedRun { report, outcome, faults, .. } =
        run_disturbed(&folder, FILTERS, Options { frames: Some(FRAMES), ..Options::default() }, |_| ());
    assert_eq!(outcome, Outcome::Done, "{faults:?}");
    assert!(faults.is_empty(), "{faults:?}");
    for (group, learns) in [("renders", 12), ("forwards", 0), ("makes", 4), ("writes", 2), ("asks", 6)] {
        let counts = &report.groups[group];
        assert_eq!((counts.processes, counts.calls), (1, FRAMES), "{group}");
        let more = counts.round_trips.checked_sub(FRAMES).expect("at least one for each call");
        assert!(more <= learns, "group `{group}`: {more} messages more than calls, after it learned what they need");
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn what_is_sent_with_a_call_does_not_change_a_byte() {
    let _alone = alone();
    let folder = scratch("isolated-sent");
    let options = || Options { frames: Some(12), ..Options::default() };
    let plain: String = FILTERS.lines().filter(|line| !line.starts_with("isolate")).map(|l| format!("{l}\n")).collect();
    let isolated = run_disturbed(&folder, FILTERS, options(), |_| ());
    let plain = run_disturbed(&folder, &plain, options(), |_| ());
    assert!(isolated.packets.values().map(BTreeMap::len).sum::<usize>() > 12 * 5);
    assert_eq!(isolated.packets, plain.packets);
    let copies = |run: &DisturbedRun| run.report.nodes["marks"].copies;
    assert_eq!(copies(&isolated), copies(&plain), "copies are counted where they are made");
    let _ = std::fs::remove_dir_all(&folder);
}

fn confined(folder: &Path, harm: &str, deny: &str) -> String {
    let file = folder.join("new");
    format!(
        r#"
mode = "batch"
plugins = ["flow", "fixtures"]
{deny}
[nodes.source]
type = "frames"
params = {{ width_px = 64, height_px = 48, format = "gray8", pattern = "ramp" }}
[nodes.bad]
type = "chaos"
isolate = "foreign"
inputs = {{ image = "source.image" }}
params = {{ harm = "{harm}", first = 10, ticks = 1, file = "{}" }}
[nodes.sink]
type = "drain"
inputs = {{ image = "bad.image" }}
"#,
        file.display()
    )
}

#[test]
fn what_a_group_is_denied_fails_and_the_run_goes_on() {
    let _alone = alone();
    const FRAMES: u64 = 30;
    let kernel = kernel();
    let cases = [
        (
            "new_file",
            "deny = { foreign = [\"new_files\"] }",
            kernel.landlock.is_some(),
            "cannot be written: Permission",
        ),
        ("socket", "deny = { foreign = [\"network\"] }", kernel.seccomp, "cannot be opened: Permission"),
    ];
    for (harm, deny, is_enforced, words) in cases {
        let folder = scratch(&format!("isolated-{harm}"));
        let options = || Options { frames: Some(FRAMES), ..Options::default() };
        // A table that stands before all others.
        let text = |deny: &str| confined(&folder, harm, "").replacen("mode = ", &format!("{deny}\nmode = "), 1);
        let DisturbedRun { faults, .. } = run_disturbed(&folder, &text(""), options(), |_| ());
        assert!(faults.is_empty(), "{harm} is possible where nothing is denied: {faults:?}");
        let _ = std::fs::remove_file(folder.join("new"));
        if !is_enforced {
            panoscope_testing::skipped!("this kernel has {kernel:?}: it cannot refuse `{harm}`");
            continue;
        }
        let DisturbedRun { report, outcome, faults, .. } = run_disturbed(&folder, &text(deny), options(), |_| ());
        assert_eq!(outcome, Outcome::Done, "{harm}");
        let told: Vec<_> = faults.iter().map(|f| (f.node.as_str(), f.cause, f.seq)).collect();
        assert_eq!(told, [("bad", Cause::Error, Some(10))], "{harm}: {faults:?}");
        assert!(faults[0].words.contains(words), "{harm}: {}", faults[0].words);
        assert_eq!(report.nodes["sink"].count, FRAMES - 1, "{harm}");
        assert!(!folder.join("new").exists(), "{harm}");
        let _ = std::fs::remove_dir_all(&folder);
    }
}

/// Kills the process of isolated nodes once a source has made this many ticks.
fn kill_once(source: &'static str, at: u64) -> impl FnMut(&Engine) {
    let mut is_done = false;
    move |engine| {
        if is_done || engine.report().nodes[source].count < at {
            return;
        }
        for process in isolated_processes() {
            // SAFETY: plain system call; a process that this one started.
            unsafe { libc::kill(process, libc::SIGKILL) };
            is_done = true;
        }
    }
}

/// Writes images with different content.
fn pictures(folder: &Path, count: u8) -> PathBuf {
    let pictures = folder.join("pictures");
    std::fs::create_dir_all(&pictures).expect("a folder");
    for index in 0..count {
        let picture = image::GrayImage::from_pixel(64, 48, image::Luma([index]));
        picture.save(pictures.join(format!("{index:03}.png"))).expect("a picture");
    }
    pictures
}

#[test]
fn a_source_goes_on_where_it_was_when_its_process_died() {
    let _alone = alone();
    let folder = scratch("isolated-position");
    let pictures = pictures(&folder, 120);
    let phantom = "type = \"phantom\"\nparams = { width = 64, height = 48, rate_hz = 100.0 }".to_owned();
    let files = format!(
        "type = \"capture\"\nparams = {{ left = \"{}/*.png\", pace = \"off\", fps = 100.0 }}",
        pictures.display()
    );
    for (name, source, plugin) in [("phantom", &phantom, "phantom"), ("files", &files, "capture")] {
        // Slow enough that a process can be killed in the middle.
        let text = format!(
            r#"
mode = "batch"
plugins = ["{plugin}", "fixtures", "flow"]
[nodes.scope]
isolate = "sources"
{source}
[nodes.slow]
type = "chaos"
inputs = {{ image = "scope.left" }}
params = {{ harm = "slow", slow_ms = 3.0, first = 0, ticks = 1000 }}
[nodes.sink]
type = "drain"
inputs = {{ image = "slow.image" }}
"#
        );
        let options = || Options { frames: Some(100), ..Options::default() };
        let whole = run_disturbed(&folder, &text, options(), |_| ());
        assert!(whole.faults.is_empty(), "{name}: {:?}", whole.faults);
        let cut = run_disturbed(&folder, &text, options(), kill_once("slow", 30));
        let told: Vec<_> = cut.faults.iter().map(|f| (f.node.as_str(), f.cause)).collect();
        assert_eq!(told, [("scope", Cause::Crash)], "{name}: {:?}", cut.faults);
        let contents = |run: &DisturbedRun| run.packets["slow.image"].values().copied().collect::<Vec<u64>>();
        let (whole, cut) = (contents(&whole), contents(&cut));
        assert!(cut.len() >= 98, "{name}: {} pictures", cut.len());
        // Neither a picture twice, nor one left out, nor the beginning again: as in the whole run, only each one tick later.
        assert!(cut.iter().eq(&whole[..cut.len()]), "{name}: the pictures differ from those of a run without a fault");
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn a_node_whose_process_died_before_its_first_tick_opens_again() {
    let _alone = alone();
    const FRAMES: u64 = 20;
    let folder = scratch("isolated-early");
    // `late` gets its first picture, of a size that its process does not know yet, long after `bad` has ended that process.
    let text = r#"
mode = "batch"
plugins = ["flow", "fixtures"]
[nodes.soon]
type = "frames"
params = { width_px = 160, height_px = 120, format = "gray8" }
[nodes.bad]
type = "chaos"
isolate = "doomed"
inputs = { image = "soon.image" }
params = { harm = "segv", first = 0, ticks = 1 }
[nodes.slow]
type = "chaos_source"
params = { harm = "slow", first = 0, ticks = 1, slow_ms = 500.0 }
[nodes.late]
type = "pass"
isolate = "doomed"
inputs = { image = "slow.image" }
[nodes.end]
type = "drain"
inputs = { image = "late.image" }
[nodes.end_bad]
type = "drain"
inputs = { image = "bad.image" }
"#;
    let options = Options { frames: Some(FRAMES), ..Options::default() };
    let DisturbedRun { report, outcome, faults, .. } = run_disturbed(&folder, text, options, |_| ());
    assert_eq!(outcome, Outcome::Done, "{faults:?}");
    assert!(faults.iter().all(|fault| fault.cause == Cause::Crash), "{faults:?}");
    assert_eq!((report.nodes["late"].restarts, report.nodes["late"].dropped), (1, 0), "{faults:?}");
    assert_eq!(report.nodes["end"].count, FRAMES - 1, "one tick is lost");
    let _ = std::fs::remove_dir_all(&folder);
}
