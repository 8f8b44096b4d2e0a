//! Notices for the surgeon, in plain language, the most urgent first. Independent of egui.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use panoscope_editor_model::disk::is_full;
use panoscope_editor_model::texts::{bytes, decimal, text};
use panoscope_engine::fault::{Action, Cause, Fault};

use panoscope_editor_model::observe::Counters;
use panoscope_editor_model::session::Phase;

use super::alarms::{self, Alarm, Urgency};
use super::attached::MachineFacts;
use super::lost::LostCameras;
use super::outage::OutageFacts;
use super::runner::OutageStage;

/// Age from which an image gets a notice, ms.
pub const OLD_MS: f64 = 200.0;
/// Time without a new image after which a camera or view counts as stopped.
pub const STOPPED: Duration = Duration::from_millis(1000);
/// As [`STOPPED`], ms.
pub const STOPPED_MS: f64 = 1000.0;
/// How long a node's fault is shown.
const FAULT_SHOWN: Duration = Duration::from_secs(4);
/// Free space below which a recording gets a warning.
pub const LOW_BYTES: u64 = 2 << 30;
/// Free space below which nothing is recorded.
pub const FULL_BYTES: u64 = 64 << 20;

/// A notice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// Its urgency.
    pub urgency: Urgency,
    /// Its text, one sentence.
    pub message: String,
    /// What to do.
    pub action: &'static str,
}

impl Notice {
    /// What it is about, which is drawn large, and the rest of the sentence.
    pub fn parts(&self) -> (&str, &str) {
        self.message.split_once(": ").unwrap_or((&self.message, ""))
    }
}

/// The facts that notices are made from.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// Phase of the run.
    pub phase: Phase,
    /// How long nodes have been opening; `None` once they run.
    pub starting: Option<Duration>,
    /// Why the graph did not start or a change failed.
    pub problem: Option<String>,
    /// Why only the sources run.
    pub raw_only: Option<String>,
    /// Whether the camera's own image is there.
    pub has_raw: bool,
    /// The process that runs the graph has ended, and the views are not shown again yet.
    pub outage: Option<OutageFacts>,
    /// The machine that runs the graph, if it is another one.
    pub machine: Option<MachineFacts>,
    /// Why nothing runs, so that there is no image at all.
    pub why_dark: Option<String>,
    /// The last error message of each source, by node.
    pub source_faults: HashMap<String, String>,
    /// Whether the arm was stopped.
    pub emergency: bool,
    /// Cameras without a new image.
    pub lost: Vec<LostCameras>,
    /// Cameras that send the same image again and again, and for how long.
    pub stuck: Vec<(String, Duration)>,
    /// Views that have stopped although their camera works. Their labels, which are as the graph names them.
    pub stopped: Vec<String>,
    /// Age of the main image, ms.
    pub age_ms: Option<f64>,
    /// Whether the main image is older than [`OLD_MS`]; also one that was hidden, until its next image.
    pub is_old: bool,
    /// Whether there is a main image.
    pub has_main: bool,
    /// Messages about failed nodes.
    pub stages: Vec<String>,
    /// Nodes that cannot write, because the disk is full.
    pub full_stages: Vec<String>,
    /// Free space for recordings, in bytes.
    pub free_bytes: Option<u64>,
    /// Why the audit log cannot be written.
    pub audit_problem: Option<String>,
    /// Why the pedal's settings are not used.
    pub pedal_problem: Option<String>,
    /// Whether a clip or a file of the graph is being written.
    pub recording: bool,
    /// Size of the files that the graph writes; `None` while it writes none, or elsewhere.
    pub written_bytes: Option<u64>,
    /// Whether the calibration does not fit the views any more.
    pub drifted: bool,
    /// Whether the pictures are unlike those that a detector learned from.
    pub unlike: bool,
    /// Whether the left and right views are swapped, as far as is known.
    pub swapped: bool,
    /// Whether they are not now, but were when that was last known or for an image that is still on the screen.
    pub was_swapped: bool,
    /// Whether the left and right views are not of one instant.
    pub out_of_step: bool,
    /// The first difference from the lock, if the graph runs in spite of it.
    pub unlocked: Option<String>,
    /// What listens for other machines, in words.
    pub public: Vec<String>,
}

/// What is shown in place of a missing image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoPicture {
    /// A short text, when there is no error or it is shown elsewhere.
    Plain(String),
    /// An error and how to fix it.
    Because {
        /// The full error message.
        why: String,
        /// What can be done.
        remedy: &'static str,
    },
}

impl Facts {
    /// Whether the process that runs the graph has ended, and the cameras are not shown again yet.
    pub fn is_dark(&self) -> bool {
        self.outage.as_ref().is_some_and(|outage| outage.stage == OutageStage::Dark)
    }

    /// Why the machine that runs the graph is not reached.
    pub fn unreached(&self) -> Option<&str> {
        self.machine.as_ref()?.lost.as_deref()
    }

    /// Why no length that is measured now can be relied on.
    pub fn measuring_doubt(&self) -> Option<&'static str> {
        match () {
            () if self.swapped => Some(text!("measure-swapped")),
            () if self.drifted => Some(text!("measure-drifted")),
            () if self.out_of_step => Some(text!("measure-out-of-step")),
            () => None,
        }
    }

    /// What to show in place of the image of `node`, which has not arrived yet.
    pub fn no_picture(&self, node: &str, stopped: bool) -> NoPicture {
        let fault = self.source_faults.get(node).filter(|message| !message.is_empty());
        match (&self.why_dark, fault) {
            (Some(why), _) => NoPicture::Because { why: why.clone(), remedy: text!("no-image-again") },
            (None, Some(why)) => NoPicture::Because { why: why.clone(), remedy: text!("no-image-retried") },
            // Why the whole graph did not start, until the camera alone shows an image.
            (None, None) if self.raw_only.is_some() => NoPicture::Because {
                why: self.raw_only.clone().unwrap_or_default(),
                remedy: text!("no-image-camera-tried"),
            },
            (None, None) if stopped => NoPicture::Plain(text!("no-image-plain").to_owned()),
            // A camera may take long to open: something must be seen to go on.
            (None, None) => NoPicture::Plain(match self.starting.map(|time| time.as_secs()) {
                Some(seconds) if seconds >= 2 => text!("no-image-starting-for", seconds = seconds),
                _ => text!("no-image-starting").to_owned(),
            }),
        }
    }
}

/// All notices for these facts, the most urgent first.
pub fn notices(facts: &Facts) -> Vec<Notice> {
    let mut raised = Raised::default();
    if facts.emergency {
        raised.add(alarms::EMERGENCY, text!("alarm-emergency").to_owned());
    }
    state_of_the_run(facts, &mut raised);
    lost_images(facts, &mut raised);
    for message in &facts.stages {
        raised.add(alarms::STAGE, message.clone());
    }
    if let Some(problem) = facts.problem.as_ref().filter(|_| facts.why_dark.is_none()) {
        raised.add(alarms::NOT_CHANGED, text!("alarm-not-changed", reason = problem));
    }
    old_images(facts, &mut raised);
    storage(facts, &mut raised);
    if let Some(problem) = &facts.pedal_problem {
        raised.add(alarms::PEDAL, text!("alarm-pedal", reason = problem));
    }
    doubts(facts, &mut raised);
    if let Some(difference) = &facts.unlocked {
        raised.add(alarms::UNLOCKED, text!("alarm-unlocked", difference = difference));
    }
    if !facts.public.is_empty() {
        raised.add(alarms::PUBLIC, text!("alarm-public", nodes = facts.public.join(", ")));
    }
    raised.0.sort_by_key(|(rank, _)| *rank);
    raised.0.into_iter().map(|(_, notice)| notice).collect()
}

/// Notices with their ranks.
#[derive(Default)]
struct Raised(Vec<(usize, Notice)>);

impl Raised {
    fn add(&mut self, kind: Alarm, message: String) {
        self.0.push((kind.rank(), Notice { urgency: kind.urgency, message, action: kind.action() }));
    }
}

/// Whether the graph runs, as a whole or in part, here or on another machine.
fn state_of_the_run(facts: &Facts, raised: &mut Raised) {
    if let Some(why) = &facts.why_dark {
        raised.add(alarms::NO_IMAGE, text!("alarm-no-image", reason = why));
    } else if let Some(outage) = &facts.outage {
        raised.add(alarms::RESTARTING, outage.message());
    } else if let Some(why) = facts.raw_only.as_ref().filter(|_| !facts.has_raw) {
        raised.add(alarms::NO_IMAGE, text!("alarm-no-image", reason = why));
    } else if let Some(why) = &facts.raw_only {
        raised.add(alarms::CAMERA_ONLY, text!("alarm-camera-only", reason = why));
    } else if let Phase::Failed(why) = &facts.phase {
        raised.add(alarms::STOPPED, text!("alarm-stopped", reason = why));
    }
    if facts.phase == Phase::Ended {
        raised.add(alarms::ENDED, text!("alarm-ended").to_owned());
    }
    if let Some(machine) = &facts.machine {
        match &machine.lost {
            Some(why) => {
                raised.add(alarms::MACHINE_LOST, text!("alarm-machine-lost", machine = &machine.name, reason = why))
            }
            None => raised.add(alarms::ATTACHED, text!("alarm-attached", machine = &machine.name)),
        }
    }
}

/// Cameras and views that sent nothing new, or the same image again.
fn lost_images(facts: &Facts, raised: &mut Raised) {
    // Without the machine nothing is known of its cameras and views.
    let is_reached = facts.unreached().is_none();
    for LostCameras { titles, since } in facts.lost.iter().filter(|_| is_reached) {
        let seconds = since.map(|since| since.as_secs().max(1));
        let message = match (&titles[..], seconds) {
            ([camera], Some(seconds)) => text!("alarm-camera-lost", camera = camera, seconds = seconds),
            (_, Some(seconds)) => {
                text!("notice-cameras-silent-for", cameras = titles.join(", "), seconds = seconds)
            }
            (_, None) => text!("notice-camera-silent", camera = titles.join(", ")),
        };
        raised.add(alarms::CAMERA_LOST, message);
    }
    for (camera, since) in facts.stuck.iter().filter(|_| is_reached) {
        raised
            .add(alarms::CAMERA_STUCK, text!("alarm-camera-stuck", camera = camera, seconds = since.as_secs().max(1)));
    }
    for view in facts.stopped.iter().filter(|_| is_reached) {
        raised.add(alarms::VIEW_STOPPED, text!("alarm-view-stopped", view = view));
    }
}

/// The age of the main image.
fn old_images(facts: &Facts, raised: &mut Raised) {
    if let Some(age) = facts.age_ms.filter(|age| *age > OLD_MS && facts.stopped.is_empty()) {
        let seconds = decimal(age / 1e3, 1);
        match age > STOPPED_MS {
            // A lost camera has its own notice, with the time.
            true if !facts.lost.is_empty() => {}
            true => raised.add(alarms::STALE_IMAGE, text!("alarm-image-stale", seconds = seconds)),
            false => raised.add(alarms::OLD_IMAGE, text!("alarm-image-old", seconds = seconds)),
        }
    }
}

/// Free space, and what could not be written.
fn storage(facts: &Facts, raised: &mut Raised) {
    // One notice for a full disk, however many nodes cannot write.
    let is_disk_full = !facts.full_stages.is_empty() || facts.free_bytes.is_some_and(|free| free < FULL_BYTES);
    match facts.free_bytes {
        _ if !facts.full_stages.is_empty() => {
            let stages: Vec<String> = facts.full_stages.iter().map(|stage| format!("`{stage}`")).collect();
            raised.add(alarms::DISK_FULL, text!("notice-disk-full-for", stages = stages.join(", ")));
        }
        _ if is_disk_full => raised.add(alarms::DISK_FULL, text!("alarm-disk-full").to_owned()),
        Some(free) if free < LOW_BYTES && facts.recording => {
            raised.add(alarms::DISK_LOW, text!("alarm-disk-low", size = bytes(free)));
        }
        _ => {}
    }
    if let Some(problem) = facts.audit_problem.as_ref().filter(|problem| !(is_disk_full && is_full(problem))) {
        raised.add(alarms::AUDIT, text!("alarm-audit", reason = problem));
    }
}

/// Reasons not to trust what the images show.
fn doubts(facts: &Facts, raised: &mut Raised) {
    if facts.drifted {
        raised.add(alarms::DRIFTED, text!("alarm-drifted").to_owned());
    }
    if facts.was_swapped {
        raised.add(alarms::WAS_SWAPPED, text!("alarm-was-swapped").to_owned());
    } else if facts.swapped {
        raised.add(alarms::SWAPPED, text!("alarm-swapped").to_owned());
    }
    if facts.out_of_step {
        raised.add(alarms::OUT_OF_STEP, text!("alarm-out-of-step").to_owned());
    }
    if facts.unlike {
        raised.add(alarms::UNLIKE, text!("alarm-unlike").to_owned());
    }
}

/// Tracks which nodes have new faults, from one reading of the counters to the next.
#[derive(Default)]
pub struct Stages {
    counts: HashMap<String, u64>,
    /// When each node had its last new fault.
    at: HashMap<String, Instant>,
}

/// Whether a node works on as before: it was slow, or frames were dropped that a file lacks now.
pub(super) fn is_harmless(fault: &Fault) -> bool {
    fault.done == Action::Note && matches!(fault.cause, Cause::Slow | Cause::Leak | Cause::Size | Cause::Incomplete)
}

/// The message about a fault for the surgeon; `None` when it does not affect the images.
fn fault_message(node: &str, fault: &Fault) -> Option<String> {
    Some(match fault.cause {
        _ if is_harmless(fault) => return None,
        // The node works; the views show what is missing.
        Cause::TooOld => return None,
        Cause::Recording => text!("notice-recording-gaps", reason = &fault.words),
        _ if fault.done == Action::Bypass => text!("notice-stage-bypassed", stage = node),
        Cause::Hang => text!("notice-stage-silent", stage = node),
        Cause::Open => text!("notice-stage-closed", stage = node),
        Cause::Exhausted => text!("notice-stage-exhausted", stage = node),
        _ => text!("alarm-stage", stage = node),
    })
}

/// Of the newest faults of a node the one that matters most: a full disk, else one with a message, else the newest. What a node says next, as that it lacks
/// frames, must not hide why.
pub(super) fn gravest<'c>(counters: &'c Counters, node: &str) -> Option<&'c Fault> {
    let newest = counters.faults.get(node)?;
    let is_recent = |fault: &&Fault| {
        fault.node == node && u128::from(newest.unix_ms.saturating_sub(fault.unix_ms)) < FAULT_SHOWN.as_millis()
    };
    let recent = || counters.fault_list.iter().rev().filter(is_recent);
    let full = recent().find(|fault| is_full(&fault.words));
    full.or_else(|| recent().find(|fault| fault_message(node, fault).is_some())).or(Some(newest))
}

impl Stages {
    /// Takes new counters; returns the messages about failed nodes, and the nodes that failed because the disk is full.
    pub fn update(&mut self, counters: &Counters, now: Instant) -> (Vec<String>, Vec<String>) {
        for (id, node) in &counters.nodes {
            let count = node.faults + node.restarts;
            let before = self.counts.insert(id.clone(), count).unwrap_or(0);
            if count > before {
                self.at.insert(id.clone(), now);
            }
        }
        self.at.retain(|id, at| counters.nodes.contains_key(id) && now.duration_since(*at) < FAULT_SHOWN);
        let off = counters.switched_off().map(|f| f.node.clone());
        let mut nodes: Vec<String> = self.at.keys().cloned().chain(off).collect();
        nodes.retain(|id| counters.nodes.contains_key(id));
        nodes.sort();
        nodes.dedup();
        let (full, nodes): (Vec<String>, Vec<String>) =
            nodes.into_iter().partition(|id| gravest(counters, id).is_some_and(|fault| is_full(&fault.words)));
        let message = |id: &String| match gravest(counters, id) {
            Some(fault) => fault_message(id, fault),
            None => Some(text!("alarm-stage", stage = id)),
        };
        (nodes.iter().filter_map(message).collect(), full)
    }
}

/// What nodes last said against what is measured. It holds until they say otherwise: a graph that was started again has not looked yet.
#[derive(Default)]
pub struct Doubts {
    /// The left and right views are swapped.
    pub swapped: bool,
    /// The calibration does not fit the views any more.
    pub drifted: bool,
    /// The left and right views are not of one instant.
    pub out_of_step: bool,
}

impl Doubts {
    /// Takes new counters.
    pub fn update(&mut self, counters: &Counters) {
        let Self { swapped, drifted, out_of_step } = self;
        for (doubt, metric) in [(swapped, "views_swapped"), (drifted, "drifted"), (out_of_step, "views_late")] {
            *doubt = counters.metric_is_on(metric).unwrap_or(*doubt);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_engine::NodeWindow;

    fn message(facts: &Facts) -> Vec<String> {
        notices(facts).into_iter().map(|n| n.message).collect()
    }

    #[test]
    fn without_problems_there_are_no_notices() {
        let facts = Facts { age_ms: Some(80.0), free_bytes: Some(u64::MAX), ..Facts::default() };
        assert_eq!(message(&facts), Vec::<String>::new());
    }

    #[test]
    fn every_problem_has_a_notice_and_alarms_come_first() {
        let facts = Facts {
            age_ms: Some(430.0),
            lost: vec![LostCameras { titles: vec!["Left camera".to_owned()], since: Some(Duration::from_secs(3)) }],
            free_bytes: Some(1),
            drifted: true,
            emergency: true,
            unlocked: Some("plugin `stitch` has changed".to_owned()),
            ..Facts::default()
        };
        let all = notices(&facts);
        assert!(all.is_sorted_by_key(|n| std::cmp::Reverse(n.urgency)));
        let message = message(&facts);
        for part in ["Emergency stop", "Left camera lost: no image for 3 s", "Image is 0.4 s old", "disk is full"] {
            assert!(message.iter().any(|w| w.contains(part)), "{part}: {message:?}");
        }
        assert!(message.last().is_some_and(|w| w.starts_with("Runs although")));
        let unlike = Facts { unlike: true, ..Facts::default() };
        let [notice] = notices(&unlike).try_into().expect("one notice");
        assert_eq!(notice.urgency, Urgency::Note);
        assert!(notice.message.contains("unlike those learned from") && notice.action.contains("do not rely"));
        let public = Facts { public: vec!["stream at 0.0.0.0:8554".to_owned()], ..Facts::default() };
        assert_eq!(self::message(&public), ["Other machines can reach this one: stream at 0.0.0.0:8554"]);
        let stopped = Facts { age_ms: Some(5000.0), stopped: vec!["Wide".to_owned()], ..Facts::default() };
        assert_eq!(self::message(&stopped), ["Wide has stopped"], "one notice");
    }

    #[test]
    fn a_wrong_measurement_comes_before_an_age_and_a_lost_camera_before_both() {
        let mut facts = Facts { age_ms: Some(430.0), drifted: true, ..Facts::default() };
        assert!(message(&facts)[0].starts_with("The calibration does not fit any more"), "{:?}", message(&facts));
        facts.age_ms = Some(3000.0);
        assert_eq!(message(&facts)[0], "Image is 3.0 s old: not the present one");
        let doubtful = Facts { age_ms: Some(430.0), out_of_step: true, ..Facts::default() };
        assert!(message(&doubtful)[0].starts_with("The cameras show different instants"), "{:?}", message(&doubtful));
        facts.swapped = true;
        assert_eq!(message(&facts)[0], "The left and right cameras are swapped");
        let both = LostCameras { titles: vec!["Left camera".to_owned(), "Right camera".to_owned()], since: None };
        facts.lost = vec![LostCameras { since: Some(Duration::from_secs(3)), ..both.clone() }];
        assert_eq!(message(&facts)[0], "No new image: none from Left camera, Right camera for 3 s");
        assert!(message(&facts).iter().all(|m| !m.starts_with("Image is")), "{:?}", message(&facts));
    }

    #[test]
    fn a_full_disk_is_one_notice() {
        let facts = Facts {
            free_bytes: Some(0),
            full_stages: vec!["film".to_owned(), "table".to_owned(), "images".to_owned()],
            audit_problem: Some("log: No space left on device (os error 28)".to_owned()),
            ..Facts::default()
        };
        assert_eq!(message(&facts), ["The disk is full: `film`, `table`, `images` cannot write"]);
    }

    #[test]
    fn a_missing_image_shows_why_and_what_to_do() {
        let why = "node `scope` (capture) did not open: camera 2 does not open: it may be in use by another program"
            .to_owned();
        let dark = Facts { why_dark: Some(why.clone()), problem: Some(why.clone()), ..Facts::default() };
        assert_eq!(message(&dark), [format!("No image: {why}")], "one notice");
        match dark.no_picture("scope", false) {
            NoPicture::Because { why: shown, remedy } => {
                assert_eq!(shown, why);
                assert!(remedy.contains("Enter") && remedy.contains("cable"), "{remedy}");
            }
            other => panic!("{other:?}"),
        }
        let faults = HashMap::from([("scope".to_owned(), "camera 2 is gone".to_owned())]);
        let retried = Facts { source_faults: faults, ..Facts::default() };
        assert!(
            matches!(retried.no_picture("scope", false), NoPicture::Because { remedy, .. } if remedy.contains("automatically"))
        );
        assert_eq!(retried.no_picture("wide", false), NoPicture::Plain("starting".to_owned()));
        assert_eq!(Facts::default().no_picture("wide", true), NoPicture::Plain("no image".to_owned()));
        let alone = Facts { raw_only: Some(why.clone()), ..Facts::default() };
        assert_eq!(message(&alone), [format!("No image: {why}")], "there is no camera image yet");
        assert!(matches!(alone.no_picture("scope", false), NoPicture::Because { why: shown, .. } if shown == why));
        let alone = Facts { has_raw: true, ..alone };
        assert_eq!(message(&alone), [format!("Camera image only: {why}")]);
        let slow = Facts { starting: Some(Duration::from_secs(7)), ..Facts::default() };
        assert_eq!(slow.no_picture("scope", false), NoPicture::Plain("starting for 7 s".to_owned()));
    }

    #[test]
    fn a_fault_is_shown_for_a_while_and_a_bypassed_node_stays_shown() {
        let mut stages = Stages::default();
        let mut counters = Counters::default();
        counters.nodes.insert("match".to_owned(), NodeWindow { faults: 1, ..NodeWindow::default() });
        let fault = |done, cause, message: &str| Fault {
            unix_ms: 0,
            run_ms: 0.0,
            node: "match".to_owned(),
            cause,
            words: message.to_owned(),
            done,
            seq: None,
            late_ms: None,
            count: 1,
        };
        counters.faults.insert("match".to_owned(), fault(Action::Restart, Cause::Hang, ""));
        let start = Instant::now();
        assert_eq!(stages.update(&counters, start).0, ["Stage `match` does not respond"]);
        assert!(stages.update(&counters, start + Duration::from_secs(5)).0.is_empty());
        counters.faults.insert("match".to_owned(), fault(Action::Bypass, Cause::Panic, ""));
        assert_eq!(
            stages.update(&counters, start + Duration::from_secs(9)).0,
            ["Stage `match` is bypassed after a fault"]
        );
        let full = fault(Action::Restart, Cause::Error, "x.mkv: No space left on device (os error 28)");
        counters.faults.insert("match".to_owned(), full.clone());
        counters.nodes.insert("match".to_owned(), NodeWindow { faults: 2, ..NodeWindow::default() });
        let (messages, stages_on_it) = stages.update(&counters, start + Duration::from_secs(10));
        assert_eq!((messages.len(), stages_on_it), (0, vec!["match".to_owned()]));
        // That it lacks frames comes of it, and does not hide it.
        let lacks = Fault { unix_ms: 900, ..fault(Action::Note, Cause::Incomplete, "it lacks 3 frames") };
        counters.fault_list = vec![full, lacks.clone()];
        counters.faults.insert("match".to_owned(), lacks);
        let (messages, stages_on_it) = stages.update(&counters, start + Duration::from_secs(11));
        assert_eq!((messages.len(), stages_on_it), (0, vec!["match".to_owned()]));
    }
}
