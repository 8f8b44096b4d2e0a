//! A graph whose cameras and processes fail, in simulated time: what the window is shown of it, and what is true.

use std::cell::RefCell;
use std::collections::{HashMap, HashSet, VecDeque};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use panoscope_abi::Tick;
use panoscope_base::random::SplitMix64;
use panoscope_editor_model::content::{Content, Rig};
use panoscope_editor_model::observe::{Counters, Output, PreviewRequest};
use panoscope_editor_model::picture::RenderedPacket;
use panoscope_editor_model::session::{Phase, Session, Status};
use panoscope_editor_model::surface::Cloud;
use panoscope_editor_model::texts::phrase;
use panoscope_engine::NodeWindow;
use panoscope_engine::fault::{Action, Cause, Fault};
use panoscope_graph::ParamValue;
use panoscope_host::loader::verify::Seal;

use super::marks::{Mark, SIZE_PX};
use crate::guard::{Recovery, Step};
use crate::runner::{Outage, Runner};
use crate::time;

/// Step of the simulation, ms.
pub const STEP_MS: u64 = 10;
const PERIOD_MS: u64 = 30;
/// Time until the graph says that its views are swapped, ms.
const MAX_DETECTION_MS: u64 = 2000;
/// Time until the window shows that, ms.
const MARGIN_MS: u64 = 700;
const COUNTERS_MS: u64 = 500;

pub const LEFT: u8 = 1;
pub const RIGHT: u8 = 2;
pub const WIDE: u8 = 3;
pub const DEPTH: u8 = 4;
pub const SURFACE: u8 = 5;
/// The views that nodes make, their nodes and the time that they take, ms.
const MADE: [(u8, &str, &str, u64); 3] =
    [(WIDE, "wide", "panorama", 40), (DEPTH, "depth", "image", 120), (SURFACE, "points", "cloud", 80)];

/// What a camera does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraState {
    /// It sends its light at once.
    Live,
    /// It sends nothing.
    Silent,
    /// Its light is late by this time, ms.
    Late(u64),
    /// It sends the light of this time again and again, ms.
    Stuck(u64),
}

/// How the cameras are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// By one source, which sends nothing while one of them is silent.
    Together,
    /// By one source, which sends what there is.
    Single,
    /// By two sources. Nodes wait for both.
    Apart,
    /// By two sources. Nodes take the newest image of the right one, however old it is.
    Latest,
}

impl Reading {
    pub const ALL: [Self; 4] = [Self::Together, Self::Single, Self::Apart, Self::Latest];

    pub fn has_two_sources(self) -> bool {
        matches!(self, Self::Apart | Self::Latest)
    }
}

/// What runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Run {
    /// Nothing; cameras alone or the whole graph start then, ms.
    Down {
        at_ms: u64,
        whole: bool,
    },
    /// The cameras alone, and the whole graph from a time on, ms.
    Cameras {
        until_ms: u64,
    },
    Whole,
    Failed,
}

/// A time in which the cables were as they are.
#[derive(Clone, Copy, Debug)]
pub struct Cabling {
    /// Whether they are exchanged.
    pub is_swapped: bool,
    /// Whether a graph had the time to see that. The window does not forget it when the graph is started again.
    pub is_known: bool,
}

/// The simulated graph.
pub struct World {
    pub reading: Reading,
    pub ms: u64,
    pub cameras: [CameraState; 2],
    /// When each camera last changed, ms.
    pub changed_ms: [u64; 2],
    /// Whether each camera stuck and has not sent other images since.
    pub was_stuck: [bool; 2],
    /// When each camera's image was last sent to the window, ms.
    pub sent_ms: [Option<u64>; 2],
    /// Whether the cables are exchanged, and since when, ms.
    pub swapped: (bool, u64),
    /// All cablings so far. The last one is the present one.
    cablings: Vec<Cabling>,
    /// The cabling of each image that was sent, by its number.
    sent: HashMap<(Output, Mark), usize>,
    /// Lights of both eyes that belong to one tick.
    pub pairs: HashSet<[u64; 2]>,
    /// The camera that the last fault of a source names, and when, ms.
    blamed: Option<(usize, u64)>,
    /// Since when it runs, ms.
    pub since_ms: u64,
    dice: SplitMix64,
    run: Run,
    recovery: Recovery,
    /// Nodes that have stopped.
    stopped: HashSet<&'static str>,
    /// Newest light of the right camera, and when the graph thinks that it arrived, ms.
    newest_right: Option<(u64, u64)>,
    seq: u64,
    on_the_way: VecDeque<(u64, Output, RenderedPacket)>,
    requests: HashMap<Output, PreviewRequest>,
    previews: HashMap<Output, RenderedPacket>,
    counters: Arc<Counters>,
    /// Whether the views are swapped, as a node of this run has seen it; `None` before it has looked.
    seen_swapped: Option<bool>,
    faults: HashMap<String, Fault>,
    detection_ms: u64,
    next_harm_ms: u64,
    /// Whether a node says that its views are not of one instant.
    pub is_out_of_step: bool,
    /// Nothing happens by itself.
    pub is_calm: bool,
    log: Vec<String>,
}

impl World {
    pub fn new(reading: Reading, dice: SplitMix64) -> Self {
        Self {
            reading,
            ms: 1000,
            cameras: [CameraState::Live; 2],
            changed_ms: [0; 2],
            was_stuck: [false; 2],
            sent_ms: [None; 2],
            swapped: (false, 0),
            cablings: vec![Cabling { is_swapped: false, is_known: false }],
            sent: HashMap::new(),
            pairs: HashSet::new(),
            blamed: None,
            since_ms: 0,
            dice,
            run: Run::Whole,
            recovery: Recovery::new(time::now()),
            stopped: HashSet::new(),
            newest_right: None,
            seq: 0,
            on_the_way: VecDeque::new(),
            requests: HashMap::new(),
            previews: HashMap::new(),
            counters: Arc::default(),
            seen_swapped: None,
            faults: HashMap::new(),
            detection_ms: MAX_DETECTION_MS,
            next_harm_ms: 2500,
            is_out_of_step: false,
            is_calm: false,
            log: Vec::new(),
        }
    }

    /// What has happened so far.
    pub fn log(&self) -> String {
        self.log.join("\n")
    }

    pub fn note(&mut self, what: impl AsRef<str>) {
        self.log.push(format!("{:>6} ms: {}", self.ms, what.as_ref()));
    }

    /// Whether all that is known of cameras that send nothing is that this one is gone: the source of both says no more when it comes back, or when
    /// the other one goes too.
    pub fn is_last_word(&self, camera: usize) -> bool {
        let since_ms = self.sent_ms[camera].unwrap_or(0);
        self.reading == Reading::Together
            && self.blamed.is_some_and(|(blamed, at_ms)| blamed == camera && at_ms + PERIOD_MS >= since_ms)
    }

    /// Whether cameras are read.
    pub fn is_running(&self) -> bool {
        matches!(self.run, Run::Cameras { .. } | Run::Whole)
    }

    /// Whether the graph has compared the images of this cabling for a time: it compares two that are live.
    fn has_compared_for(&self, ms: u64) -> bool {
        let last_ms = self.swapped.1.max(self.changed_ms[0]).max(self.changed_ms[1]).max(self.since_ms);
        self.run == Run::Whole && self.cameras == [CameraState::Live; 2] && self.ms >= last_ms + ms
    }

    /// The cabling that an image was sent with; `None` where it was not sent.
    pub fn cabling(&self, output: &Output, mark: Mark) -> Option<Cabling> {
        self.sent.get(&(output.clone(), mark)).map(|n| self.cablings[*n])
    }

    /// The output of a camera.
    pub fn camera(&self, n: usize) -> Output {
        match self.reading.has_two_sources() {
            true => Output::new(["left", "right"][n], "image"),
            false => Output::new("scope", ["left", "right"][n]),
        }
    }

    /// Passes one step.
    pub fn step(&mut self) {
        self.ms += STEP_MS;
        time::source::advance(Duration::from_millis(STEP_MS));
        if self.ms >= self.next_harm_ms && !self.is_calm {
            self.harm();
            self.next_harm_ms = self.ms + 200 + self.dice.below(3000) as u64;
        }
        self.recover();
        if self.ms.is_multiple_of(PERIOD_MS) && matches!(self.run, Run::Cameras { .. } | Run::Whole) {
            self.expose();
        }
        while let Some(at) = self.on_the_way.iter().position(|(at_ms, ..)| *at_ms <= self.ms)
            && let Some((_, output, packet)) = self.on_the_way.remove(at)
        {
            if self.requests.contains_key(&output) {
                self.previews.insert(output, packet);
            }
        }
        if self.ms.is_multiple_of(COUNTERS_MS) {
            self.count();
        }
        let is_known = self.has_compared_for(MAX_DETECTION_MS + MARGIN_MS);
        if let Some(cabling) = self.cablings.last_mut() {
            cabling.is_known |= is_known;
        }
    }

    /// Something changes.
    fn harm(&mut self) {
        let camera = self.dice.below(2);
        match self.dice.below(12) {
            0..=2 => {
                self.set(camera, CameraState::Silent);
                self.blame(camera);
            }
            3 => [0, 1].into_iter().for_each(|n| self.set(n, CameraState::Silent)),
            4 => {
                let late_ms = 100 + self.dice.below(4000) as u64;
                self.set(camera, CameraState::Late(late_ms));
            }
            5 => self.set(camera, CameraState::Stuck(self.ms)),
            6 => {
                self.swap();
                self.detection_ms = self.dice.below(MAX_DETECTION_MS as usize) as u64;
            }
            7 => {
                let node = MADE[self.dice.below(MADE.len())].1;
                let is_new = self.stopped.insert(node);
                if !is_new {
                    self.stopped.remove(node);
                }
                self.note(format!("node {node} has stopped: {is_new}"));
            }
            8 if self.run != Run::Failed => self.crash(),
            9 if self.run == Run::Whole && self.recovery.takes_changes() && !self.recovery.is_starting() => self.fail(),
            _ => {
                [0, 1].into_iter().for_each(|n| self.set(n, CameraState::Live));
                self.stopped.clear();
            }
        }
    }

    /// Changes what a camera does.
    pub fn set(&mut self, n: usize, state: CameraState) {
        if self.cameras[n] == state {
            return;
        }
        self.was_stuck[n] = match state {
            CameraState::Stuck(_) => true,
            CameraState::Silent => self.was_stuck[n],
            CameraState::Live | CameraState::Late(_) => false,
        };
        (self.cameras[n], self.changed_ms[n]) = (state, self.ms);
        self.note(format!("camera {n} is {state:?}"));
    }

    /// The process that runs the graph ends.
    pub fn crash(&mut self) {
        self.note("the process dies");
        self.recovery.crashed(phrase!("worker-crashed", signal = "SIGSEGV"), time::now());
        self.forget();
        self.run = Run::Down { at_ms: u64::MAX, whole: false };
    }

    /// Exchanges the cables.
    pub fn swap(&mut self) {
        self.swapped = (!self.swapped.0, self.ms);
        self.cablings.push(Cabling { is_swapped: self.swapped.0, is_known: false });
        self.stick_again();
        self.note(format!("swapped: {}", self.swapped.0));
    }

    /// The graph ends with an error.
    pub fn fail(&mut self) {
        self.note("the graph fails");
        self.on_the_way.clear();
        self.run = Run::Failed;
    }

    /// A camera that is opened again sticks with a new image.
    fn stick_again(&mut self) {
        for camera in &mut self.cameras {
            if matches!(camera, CameraState::Stuck(_)) {
                *camera = CameraState::Stuck(self.ms);
            }
        }
    }

    /// What a camera repeats shows only in what is sent: one that sticks while nothing is sent sticks with the first image after that.
    fn stick_unseen(&mut self) {
        for (camera, sent_ms) in self.cameras.iter_mut().zip(self.sent_ms) {
            if matches!(camera, CameraState::Stuck(ms) if sent_ms.is_none_or(|sent_ms| sent_ms < *ms)) {
                *camera = CameraState::Stuck(self.ms);
            }
        }
    }

    /// The source of a camera that is lost may name it.
    fn blame(&mut self, camera: usize) {
        if self.dice.below(3) == 0 {
            return;
        }
        let node = self.camera(camera).node;
        let fault = Fault {
            unix_ms: time::unix_ms(),
            run_ms: 0.0,
            node: node.clone(),
            cause: Cause::Error,
            words: format!("camera /dev/video{camera} is gone after {} frames: the stream has ended", self.seq),
            done: Action::Note,
            seq: None,
            late_ms: None,
            count: 1,
        };
        self.faults.insert(node, fault);
        self.blamed = Some((camera, self.ms));
    }

    fn forget(&mut self) {
        self.on_the_way.clear();
        self.previews.clear();
        self.counters = Arc::default();
        self.faults.clear();
        self.newest_right = None;
        self.seen_swapped = None;
    }

    /// Follows starts of processes and graphs.
    fn recover(&mut self) {
        let now = time::now();
        match self.recovery.step(now) {
            Step::Wait => {}
            Step::Cameras | Step::CamerasAgain => {
                self.recovery.opening(now);
                self.start(false, 1500);
            }
            // The cameras go on until the whole graph runs.
            Step::Whole if self.dice.below(6) == 0 => {
                self.recovery.refused(phrase!("worker-run-ended"), now);
            }
            Step::Whole => self.run = Run::Cameras { until_ms: self.ms + 50 + self.dice.below(2500) as u64 },
        }
        let (next, at_ms) = match self.run {
            Run::Down { at_ms, whole: false } => (Run::Cameras { until_ms: u64::MAX }, at_ms),
            Run::Down { at_ms, whole: true } | Run::Cameras { until_ms: at_ms } => (Run::Whole, at_ms),
            Run::Whole | Run::Failed => return,
        };
        if self.ms >= at_ms {
            if matches!(self.run, Run::Down { .. }) {
                self.stick_again();
            }
            (self.run, self.since_ms) = (next, self.ms);
            self.note(format!("{:?} runs", self.run));
            if self.run == Run::Whole {
                self.recovery.runs(now);
            }
        }
    }

    fn start(&mut self, whole: bool, limit_ms: usize) {
        self.run = Run::Down { at_ms: self.ms + 50 + self.dice.below(limit_ms) as u64, whole };
    }

    /// Light of a camera that is sent now; `None` where it sends none.
    fn light(&self, camera: usize) -> Option<u64> {
        match self.cameras[camera] {
            CameraState::Live => Some(self.ms),
            CameraState::Silent => None,
            CameraState::Late(ms) => Some(self.ms.saturating_sub(ms)),
            CameraState::Stuck(ms) => Some(ms),
        }
    }

    /// When the graph thinks that the light of a camera arrived.
    fn known(&self, camera: usize, light_ms: u64) -> u64 {
        if matches!(self.cameras[camera], CameraState::Stuck(_)) { self.ms } else { light_ms }
    }

    /// Sends the images of one exposure.
    fn expose(&mut self) {
        self.seq += 1;
        let mut lights = [self.light(0), self.light(1)];
        if self.reading == Reading::Together && lights.contains(&None) {
            lights = [None; 2];
            self.stick_unseen();
        }
        let known = [0, 1].map(|n| lights[n].map(|light_ms| self.known(n, light_ms)));
        for n in 0..2 {
            if let (Some(light_ms), Some(known_ms)) = (lights[n], known[n]) {
                let shown = if self.swapped.0 { 1 - n } else { n };
                // What is on a cable is the other camera's, and so is its light.
                let mark = Mark::new([LEFT, RIGHT][shown], light_ms);
                let source = if self.reading.has_two_sources() { n as u32 } else { 0 };
                self.sent_ms[n] = Some(self.ms);
                self.send(self.camera(n), mark, known_ms, source, 0);
            }
        }
        if let [Some(left), Some(right)] = lights {
            let mark = |ms| Mark::new(LEFT, ms).light_ms;
            self.pairs.insert([mark(left), mark(right)]);
        }
        let newest = lights[1].zip(known[1]);
        self.newest_right = newest.or(self.newest_right);
        let right = match self.reading {
            Reading::Latest => self.newest_right,
            _ => newest,
        };
        if self.run != Run::Whole {
            return;
        }
        if let (Some((left, left_known)), Some((right, right_known))) = (lights[0].zip(known[0]), right) {
            for (view, node, port, ms) in MADE {
                if !self.stopped.contains(node) {
                    let mark = Mark::new(view, left.min(right));
                    self.send(Output::new(node, port), mark, left_known.min(right_known), 0, ms);
                }
            }
        }
        let rig = Rig { focal_px: 750.0, baseline_mm: 15.0, rms_px: 0.2, stated_error: 0 };
        let packet = RenderedPacket { content: Content::Rig(rig), ..RenderedPacket::default() };
        self.on_the_way.push_back((self.ms, Output::new("rig", "calibration"), packet));
    }

    fn send(&mut self, output: Output, mark: Mark, known_ms: u64, source: u32, takes_ms: u64) {
        let (width, height) = SIZE_PX;
        let ago = Duration::from_millis(self.ms.saturating_sub(known_ms));
        let arrived_ns = (time::clock_ns() as i64).saturating_sub(ago.as_nanos() as i64);
        let cloud = (mark.view == SURFACE).then(|| {
            let point = |i: usize| [(i % width) as f32, (i / width) as f32, 50.0];
            let xyz_mm = (0..width * height).map(point).collect();
            Arc::new(Cloud { width, height, xyz_mm, confidence: vec![1.0; width * height] })
        });
        let packet = RenderedPacket {
            pixels: Some(mark.pixels()),
            size: SIZE_PX,
            seq: self.seq,
            tick: Tick { source, seq: self.seq, ..Tick::default() },
            arrived_ns: Some(arrived_ns),
            cloud,
            ..RenderedPacket::default()
        };
        self.sent.insert((output.clone(), mark), self.cablings.len() - 1);
        let way_ms = self.dice.below(25) as u64;
        self.on_the_way.push_back((self.ms + takes_ms + way_ms, output, packet));
        // Images of cameras are what shows that a new process works.
        if mark.view <= RIGHT {
            self.recovery.picture(time::now());
        }
    }

    /// Publishes counters.
    fn count(&mut self) {
        if self.has_compared_for(self.detection_ms) {
            self.seen_swapped = Some(self.swapped.0);
        }
        let mut counters = Counters::default();
        let seen =
            self.seen_swapped.map(|is_swapped| [("views_swapped", is_swapped), ("views_late", self.is_out_of_step)]);
        let metrics = seen.into_iter().flatten().map(|(name, is_on)| (name.to_owned(), f64::from(u8::from(is_on))));
        let metrics = metrics.collect();
        counters.nodes.insert("depth".to_owned(), NodeWindow { metrics, fps: 30.0, ..NodeWindow::default() });
        counters.faults.clone_from(&self.faults);
        self.counters = Arc::new(counters);
    }
}

/// A world as the window knows it.
pub struct Simulated(pub Rc<RefCell<World>>);

impl Runner for Simulated {
    fn status(&self) -> Status {
        let world = self.0.borrow();
        let (phase, busy) = match world.run {
            Run::Down { .. } => (Phase::Starting, true),
            Run::Cameras { .. } | Run::Whole => (Phase::Running, world.recovery.is_starting()),
            Run::Failed => (Phase::Failed("node `wide` failed".to_owned()), false),
        };
        Status { phase, busy, ..Status::default() }
    }

    fn counters(&self) -> Arc<Counters> {
        Arc::clone(&self.0.borrow().counters)
    }

    fn take_previews(&self) -> HashMap<Output, RenderedPacket> {
        std::mem::take(&mut self.0.borrow_mut().previews)
    }

    fn request_previews(&self, requests: HashMap<Output, PreviewRequest>, _: Duration) {
        let mut world = self.0.borrow_mut();
        world.previews.retain(|output, _| requests.contains_key(output));
        world.requests = requests;
    }

    fn values(&self, _: &str) -> Option<Vec<ParamValue>> {
        None
    }

    fn run(&self, _: &str) {}

    fn restart(&self, text: &str) {
        let mut world = self.0.borrow_mut();
        let whole = text.contains("[nodes.wide]");
        world.note(format!("restart, whole: {whole}"));
        world.forget();
        world.start(whole, 1500);
    }

    fn keep(&self, _: &str, _: &str) {}

    fn set_at_once(&self, _: &str, _: &str, _: bool) {}

    fn take_refusals(&self) -> Vec<String> {
        Vec::new()
    }

    fn seal(&self, _: Option<Arc<Seal>>) {}

    fn report(&self) -> Option<serde_json::Value> {
        None
    }

    fn outage(&self) -> Option<Outage> {
        self.0.borrow().recovery.outage(time::now())
    }

    fn end_outage(&self) {
        self.0.borrow_mut().recovery.done();
    }

    fn resume(&self) {
        self.0.borrow_mut().recovery.ask(time::now());
    }

    fn close(&mut self) {}

    fn session(&self) -> Option<&Session> {
        None
    }
}
