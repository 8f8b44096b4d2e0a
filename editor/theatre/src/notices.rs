//! What a surgeon must know now, in plain words, the most urgent first. No egui here.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use panoscope_editor_model::disk::is_full;
use panoscope_engine::fault::{Action, Cause, Fault};

use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::session::Phase;

/// A picture older than this is told.
pub const OLD_MS: f64 = 200.0;
/// A camera, or a view, without a new picture for so long has stopped.
pub const STOPPED: Duration = Duration::from_millis(1000);
/// For how long a stage's fault is told after its last one.
const FAULT_TOLD: Duration = Duration::from_secs(4);
/// With less room left, recording is short of its end.
pub const LOW_BYTES: u64 = 2 << 30;
/// With less room left, nothing more is recorded.
pub const FULL_BYTES: u64 = 64 << 20;

/// How urgent a notice is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// Good to know.
    Note,
    /// Look at it soon.
    Warning,
    /// Look at it now.
    Alarm,
}

/// One thing to know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// How urgent it is.
    pub urgency: Urgency,
    /// In plain words.
    pub words: String,
}

/// How things stand.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// The run.
    pub phase: Phase,
    /// Why the graph did not start, or a change was refused.
    pub trouble: Option<String>,
    /// Only the sources run, for this reason.
    pub raw_only: Option<String>,
    /// Nothing runs, for this reason: there is no picture at all.
    pub why_dark: Option<String>,
    /// What sources said when they failed last, by the node's name.
    pub source_faults: HashMap<String, String>,
    /// The arm was stopped.
    pub emergency: bool,
    /// Cameras without a picture, with the time since the last one; `None` when there never was one.
    pub lost: Vec<(String, Option<Duration>)>,
    /// Views that have stopped while their camera goes on.
    pub stopped: Vec<String>,
    /// Age of the main picture, ms.
    pub age_ms: Option<f64>,
    /// Stages that failed, in words.
    pub stages: Vec<String>,
    /// Room left where recordings go, in bytes.
    pub free_bytes: Option<u64>,
    /// Something is being recorded.
    pub recording: bool,
    /// The calibration does not fit the views any more.
    pub drifted: bool,
    /// Left and right are swapped.
    pub swapped: bool,
    /// The preset runs although it differs from its lock.
    pub unlocked: Option<String>,
}

/// What stands in place of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoPicture {
    /// Nothing is wrong, or it is told elsewhere.
    Plain(&'static str),
    /// Something does not open.
    Because {
        /// What it said, in full.
        why: String,
        /// What can be done.
        remedy: &'static str,
    },
}

impl Facts {
    /// What stands in place of the picture of `node`, which was never seen.
    pub fn no_picture(&self, node: &str, stopped: bool) -> NoPicture {
        const AGAIN: &str = "Correct this, then press Enter to start again. For a camera: check its cable and power, and close other programs that use it.";
        const BY_ITSELF: &str = "It is tried again by itself. For a camera: check its cable and power, and close other programs that use it.";
        let fault = self.source_faults.get(node).filter(|words| !words.is_empty());
        match (&self.why_dark, fault) {
            (Some(why), _) => NoPicture::Because { why: why.clone(), remedy: AGAIN },
            (None, Some(why)) => NoPicture::Because { why: why.clone(), remedy: BY_ITSELF },
            (None, None) => NoPicture::Plain(if stopped { "no picture" } else { "starting" }),
        }
    }
}

/// Room in words.
pub fn bytes_words(bytes: u64) -> String {
    let mb = bytes as f64 / 1e6;
    if mb >= 1000.0 { format!("{:.1} GB", mb / 1000.0) } else { format!("{mb:.0} MB") }
}

/// All that is to be told, the most urgent first.
pub fn notices(facts: &Facts) -> Vec<Notice> {
    use Urgency::{Alarm, Note, Warning};
    let mut all = Vec::new();
    let mut tell = |urgency, words: String| all.push(Notice { urgency, words });
    if facts.emergency {
        tell(Alarm, "Emergency stop: the arm stands still".to_owned());
    }
    if let Some(why) = &facts.why_dark {
        tell(Alarm, format!("No picture: {why}"));
    } else if let Some(why) = &facts.raw_only {
        tell(Alarm, format!("Camera picture only: {why}"));
    } else if let Phase::Failed(why) = &facts.phase {
        tell(Alarm, format!("The system stopped: {why}"));
    }
    if facts.phase == Phase::Ended {
        tell(Warning, "The source has ended".to_owned());
    }
    for (camera, since) in &facts.lost {
        tell(
            Alarm,
            match since {
                Some(since) => format!("{camera} lost: no picture for {} s", since.as_secs().max(1)),
                None => format!("{camera} gives no picture"),
            },
        );
    }
    for view in &facts.stopped {
        tell(Alarm, format!("{view} has stopped"));
    }
    for words in &facts.stages {
        tell(Alarm, words.clone());
    }
    if let Some(trouble) = facts.trouble.as_ref().filter(|_| facts.why_dark.is_none()) {
        tell(Warning, trouble.clone());
    }
    if let Some(age) = facts.age_ms.filter(|age| *age > OLD_MS && facts.stopped.is_empty()) {
        tell(Warning, format!("Picture is {:.1} s old", age / 1e3));
    }
    match facts.free_bytes {
        Some(free) if free < FULL_BYTES => tell(Alarm, "The disk is full: nothing can be recorded".to_owned()),
        Some(free) if free < LOW_BYTES && facts.recording => {
            tell(Warning, format!("The disk is nearly full: {} left", bytes_words(free)));
        }
        _ => {}
    }
    if facts.drifted {
        tell(Warning, "The calibration has drifted: distances may be wrong, calibrate again".to_owned());
    }
    if facts.swapped {
        tell(Alarm, "Left and right cameras are swapped".to_owned());
    }
    if let Some(difference) = &facts.unlocked {
        tell(Note, format!("Runs unlocked: {difference}"));
    }
    all.sort_by_key(|n| std::cmp::Reverse(n.urgency));
    all
}

/// Which stages are in fault, seen from one look at the counters to the next.
#[derive(Default)]
pub struct Stages {
    counts: HashMap<String, u64>,
    /// Last new fault of each node.
    at: HashMap<String, Instant>,
}

/// What a fault means for whoever looks at the picture; `None` for what changes nothing there.
fn fault_words(node: &str, fault: &Fault) -> Option<String> {
    if is_full(&fault.words) {
        return Some(format!("The disk is full: `{node}` cannot write"));
    }
    let what = match fault.cause {
        Cause::Hang => "does not answer",
        Cause::Open => "cannot start again",
        Cause::Exhausted => "has no memory left",
        Cause::Slow | Cause::Leak | Cause::Size if fault.done == Action::Note => return None,
        Cause::Recording => return Some(format!("Recording has gaps: {}", fault.words)),
        _ => "is in fault",
    };
    Some(match fault.done {
        Action::Bypass => format!("Stage `{node}` is switched off after a fault"),
        _ => format!("Stage `{node}` {what}"),
    })
}

impl Stages {
    /// Takes new counters; answers what to tell.
    pub fn look(&mut self, counters: &Counters, now: Instant) -> Vec<String> {
        for (id, node) in &counters.nodes {
            let count = node.faults + node.restarts;
            let before = self.counts.insert(id.clone(), count).unwrap_or(0);
            if count > before {
                self.at.insert(id.clone(), now);
            }
        }
        self.at.retain(|id, at| counters.nodes.contains_key(id) && now.duration_since(*at) < FAULT_TOLD);
        let off = counters.switched_off().map(|f| f.node.clone());
        let mut nodes: Vec<String> = self.at.keys().cloned().chain(off).collect();
        nodes.retain(|id| counters.nodes.contains_key(id));
        nodes.sort();
        nodes.dedup();
        let words = |id: &String| match counters.faults.get(id) {
            Some(fault) => fault_words(id, fault),
            None => Some(format!("Stage `{id}` is in fault")),
        };
        nodes.iter().filter_map(words).collect()
    }
}

/// Whether any node tells a metric of that name that is on.
pub fn told(counters: &Counters, metric: &str) -> bool {
    counters.nodes.values().flat_map(|n| &n.metrics).any(|(name, value)| name == metric && *value > 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_engine::NodeWindow;

    fn words(facts: &Facts) -> Vec<String> {
        notices(facts).into_iter().map(|n| n.words).collect()
    }

    #[test]
    fn nothing_wrong_is_nothing_told() {
        let facts = Facts { age_ms: Some(80.0), free_bytes: Some(u64::MAX), ..Facts::default() };
        assert_eq!(words(&facts), Vec::<String>::new());
    }

    #[test]
    fn everything_has_its_plain_words_and_alarms_stand_first() {
        let facts = Facts {
            age_ms: Some(430.0),
            lost: vec![("Left camera".to_owned(), Some(Duration::from_secs(3)))],
            free_bytes: Some(1),
            drifted: true,
            emergency: true,
            unlocked: Some("plugin `stitch` has changed".to_owned()),
            ..Facts::default()
        };
        let told = notices(&facts);
        assert!(told.is_sorted_by_key(|n| std::cmp::Reverse(n.urgency)));
        let words = words(&facts);
        for part in ["Emergency stop", "Left camera lost: no picture for 3 s", "Picture is 0.4 s old", "disk is full"] {
            assert!(words.iter().any(|w| w.contains(part)), "{part}: {words:?}");
        }
        assert!(words.last().is_some_and(|w| w.starts_with("Runs unlocked")));
        let stopped = Facts { age_ms: Some(5000.0), stopped: vec!["Wide".to_owned()], ..Facts::default() };
        assert_eq!(self::words(&stopped), ["Wide has stopped"], "said once");
    }

    #[test]
    fn a_pane_without_a_picture_says_why_and_what_to_do() {
        let why = "node `scope` (capture) did not open: camera 2 does not open: it may be in use by another program"
            .to_owned();
        let dark = Facts { why_dark: Some(why.clone()), trouble: Some(why.clone()), ..Facts::default() };
        assert_eq!(words(&dark), [format!("No picture: {why}")], "said once");
        match dark.no_picture("scope", false) {
            NoPicture::Because { why: told, remedy } => {
                assert_eq!(told, why);
                assert!(remedy.contains("Enter") && remedy.contains("cable"), "{remedy}");
            }
            other => panic!("{other:?}"),
        }
        let faults = HashMap::from([("scope".to_owned(), "camera 2 is gone".to_owned())]);
        let retried = Facts { source_faults: faults, ..Facts::default() };
        assert!(
            matches!(retried.no_picture("scope", false), NoPicture::Because { remedy, .. } if remedy.contains("by itself"))
        );
        assert_eq!(retried.no_picture("wide", false), NoPicture::Plain("starting"));
        assert_eq!(Facts::default().no_picture("wide", true), NoPicture::Plain("no picture"));
    }

    #[test]
    fn a_fault_is_told_for_a_while_and_a_stage_that_is_off_stays_told() {
        let mut stages = Stages::default();
        let mut counters = Counters::default();
        counters.nodes.insert("match".to_owned(), NodeWindow { faults: 1, ..NodeWindow::default() });
        let fault = |done, cause, words: &str| Fault {
            unix_ms: 0,
            run_ms: 0.0,
            node: "match".to_owned(),
            cause,
            words: words.to_owned(),
            done,
            seq: None,
            late_ms: None,
            count: 1,
        };
        counters.faults.insert("match".to_owned(), fault(Action::Restart, Cause::Hang, ""));
        let start = Instant::now();
        assert_eq!(stages.look(&counters, start), ["Stage `match` does not answer"]);
        assert!(stages.look(&counters, start + Duration::from_secs(5)).is_empty());
        counters.faults.insert("match".to_owned(), fault(Action::Bypass, Cause::Panic, ""));
        assert_eq!(
            stages.look(&counters, start + Duration::from_secs(9)),
            ["Stage `match` is switched off after a fault"]
        );
        let full = fault(Action::Restart, Cause::Error, "x.mkv: No space left on device (os error 28)");
        counters.faults.insert("match".to_owned(), full);
        counters.nodes.insert("match".to_owned(), NodeWindow { faults: 2, ..NodeWindow::default() });
        assert!(stages.look(&counters, start + Duration::from_secs(10))[0].starts_with("The disk is full"));
    }
}
