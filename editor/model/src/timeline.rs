//! A recording to move through: pictures of its ports at any moment, step by step, or a part of it again and again; a second one beside it.
//!
//! A thread of its own reads and renders, so that the window's thread never waits for a disk. The graph in the window keeps running.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_engine::memory::FrameRef;
use panoscope_engine::sync::lock;
use panoscope_record::{Recording, RecordingError};

use crate::comparing::{self, Comparison, ComparisonRequest};
use crate::computing::{Computation, Request};
use crate::observe::{Output, PreviewRequest};
use crate::picture::{self, Range, RenderedPacket};
use crate::probe::{self, Probe, ProbeRequest};
use crate::session::Wake;

/// Time between two pictures while it plays.
const INTERVAL: Duration = Duration::from_millis(33);
/// What the names of nodes of the second recording begin with.
const SECOND: &str = "second run: ";

/// An output of the second recording, beside that of the first.
pub fn second(output: &Output) -> Output {
    Output { node: format!("{SECOND}{}", output.node), port: output.port.clone() }
}

/// Where the recording stands and how it moves. Times count from its first tick, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// The moment that is shown.
    pub at_s: f64,
    /// Whether it moves by itself.
    pub plays: bool,
    /// The part that is played again and again.
    pub range_s: Option<(f64, f64)>,
    /// How fast it moves; 1 as it was recorded.
    pub speed: f64,
}

impl Default for Position {
    fn default() -> Self {
        Self { at_s: 0.0, plays: false, range_s: None, speed: 1.0 }
    }
}

#[derive(Default)]
struct State {
    position: Position,
    requests: HashMap<Output, PreviewRequest>,
    previews: HashMap<Output, RenderedPacket>,
    probe_requests: HashMap<Output, ProbeRequest>,
    probes: HashMap<Output, Probe>,
    compared: Option<ComparisonRequest>,
    comparison: Option<Comparison>,
    problem: Option<String>,
    second: Option<Arc<Recording>>,
    /// What was computed from the recorded sources.
    computed: Option<Arc<Recording>>,
    /// Incremented when everything is to be rendered again.
    generation: u64,
    quit: bool,
}

/// What there is of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Held {
    /// It is in the recording.
    Recorded,
    /// It was computed from the recorded sources.
    Computed,
    /// It is being computed: %.
    Computing(u8),
    /// Nothing.
    Lacking,
}

/// An opened recording.
pub struct Timeline {
    path: PathBuf,
    recording: Arc<Recording>,
    wake: Arc<Wake>,
    /// The outputs that the recording lacks.
    computation: Option<Computation>,
    second_path: Option<PathBuf>,
    /// Capture times of all ticks, s from the first one, without repetitions.
    ticks_s: Vec<f64>,
    ports: Vec<String>,
    state: Arc<Mutex<State>>,
    thread: Option<JoinHandle<()>>,
}

/// Why a recording was not opened.
#[derive(Debug, thiserror::Error)]
pub enum TimelineError {
    /// The file is not a recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// It has no ticks.
    #[error("{} has no ticks", .path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The thread cannot be started.
    #[error("no thread could be started: {0}")]
    Thread(#[from] std::io::Error),
}

fn seconds(ns: i64) -> f64 {
    ns as f64 / 1e9
}

/// The first capture time of a recording, ns.
fn start_of(recording: &Recording) -> Option<i64> {
    recording.sources.values().filter_map(|ticks| ticks.first().map(|tick| tick.capture_ns)).min()
}

impl Timeline {
    /// Opens a recording at its beginning. `wake` is called when there is something new to draw.
    ///
    /// # Errors
    /// The file is no recording, or has no ticks.
    pub fn open(path: &Path, wake: Arc<Wake>) -> Result<Self, TimelineError> {
        let recording = Arc::new(Recording::open(path)?);
        let start_ns = start_of(&recording).ok_or_else(|| TimelineError::Empty { path: path.to_owned() })?;
        let times: BTreeSet<i64> = recording.sources.values().flatten().map(|tick| tick.capture_ns).collect();
        let ticks_s = times.into_iter().map(|ns| seconds(ns.saturating_sub(start_ns))).collect();
        let state = Arc::new(Mutex::new(State::default()));
        let ports = recording.ports.keys().cloned().collect();
        let player = Player {
            recording: Arc::clone(&recording),
            start_ns,
            state: Arc::clone(&state),
            rendered: HashMap::new(),
            probed: HashMap::new(),
            compared: None,
            wake: Arc::clone(&wake),
        };
        let thread = std::thread::Builder::new().name("timeline".to_owned()).spawn(move || player.run())?;
        let path = path.to_owned();
        let (second_path, computation, thread) = (None, None, Some(thread));
        Ok(Self { path, recording, wake, computation, second_path, ticks_s, ports, state, thread })
    }

    /// Puts a second recording beside it, whose first tick is at the first tick of this one; `None` takes it away.
    ///
    /// # Errors
    /// The file is no recording; the one beside it stays.
    pub fn compare_with(&mut self, path: Option<&Path>) -> Result<(), TimelineError> {
        let second = path.map(Recording::open).transpose()?.map(Arc::new);
        let mut state = lock(&self.state);
        (state.second, self.second_path) = (second, path.map(Path::to_owned));
        state.generation += 1;
        drop(state);
        self.wake_player();
        Ok(())
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file of the second recording.
    pub fn second_path(&self) -> Option<&Path> {
        self.second_path.as_deref()
    }

    /// The recorded ports, as `node.port`.
    pub fn ports(&self) -> &[String] {
        &self.ports
    }

    /// Whether an output is recorded.
    pub fn has(&self, output: &Output) -> bool {
        let port = output.to_string();
        self.ports.contains(&port)
    }

    /// What there is of an output.
    pub fn held(&self, output: &Output) -> Held {
        let computed =
            || lock(&self.state).computed.as_ref().map(|computed| computed.ports.contains_key(&output.to_string()));
        match self.computation.as_ref() {
            _ if self.has(output) => Held::Recorded,
            Some(_) if computed() == Some(true) => Held::Computed,
            Some(computation) => computation.percent().map_or(Held::Lacking, Held::Computing),
            None => Held::Lacking,
        }
    }

    /// Computes the outputs that the recording lacks, with a graph of the same sources.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn compute(&mut self, request: Request) -> Result<(), TimelineError> {
        // The one before ends first.
        self.computation = None;
        lock(&self.state).computed = None;
        let wake = Arc::clone(&self.wake);
        self.computation = Some(Computation::start(Arc::clone(&self.recording), request, move || wake())?);
        Ok(())
    }

    /// The computation of what the recording lacks.
    pub fn computation(&self) -> Option<&Computation> {
        self.computation.as_ref()
    }

    /// Shows what has been computed meanwhile.
    pub fn follow_computation(&self) {
        let Some(recording) = self.computation.as_ref().and_then(Computation::recording) else { return };
        let mut state = lock(&self.state);
        if state.computed.is_none() {
            state.computed = Some(recording);
            state.generation += 1;
            drop(state);
            self.wake_player();
        }
    }

    /// Time from the first to the last tick, s.
    pub fn length_s(&self) -> f64 {
        self.ticks_s.last().copied().unwrap_or(0.0)
    }

    /// Number of the tick that is shown, from 0, and how many there are.
    pub fn tick(&self) -> (usize, usize) {
        let at_s = self.position().at_s;
        let passed = self.ticks_s.partition_point(|tick| *tick <= at_s + 1e-9);
        (passed.saturating_sub(1), self.ticks_s.len())
    }

    /// Where it stands.
    pub fn position(&self) -> Position {
        lock(&self.state).position
    }

    /// Why the newest pictures could not be read.
    pub fn problem(&self) -> Option<String> {
        lock(&self.state).problem.clone()
    }

    fn change(&self, change: impl FnOnce(&mut Position)) {
        let length_s = self.length_s();
        let mut state = lock(&self.state);
        change(&mut state.position);
        state.position.at_s = state.position.at_s.clamp(0.0, length_s);
        drop(state);
        self.wake_player();
    }

    fn wake_player(&self) {
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }

    /// Goes to a moment, s from the first tick.
    pub fn seek(&self, at_s: f64) {
        self.change(|position| position.at_s = at_s);
    }

    /// Plays or stops.
    pub fn play(&self, plays: bool) {
        let length_s = self.length_s();
        self.change(|position| {
            // From the beginning again at the end.
            if plays && position.range_s.is_none() && position.at_s >= length_s - 1e-9 {
                position.at_s = 0.0;
            }
            position.plays = plays;
        });
    }

    /// Goes to another tick, counted from the shown one, and stops.
    pub fn step(&self, by: isize) {
        let (at, count) = self.tick();
        let wanted = at.saturating_add_signed(by).min(count.saturating_sub(1));
        let at_s = self.ticks_s.get(wanted).copied().unwrap_or(0.0);
        self.change(|position| (position.at_s, position.plays) = (at_s, false));
    }

    /// Plays a part again and again; `None` ends that.
    pub fn set_range(&self, range_s: Option<(f64, f64)>) {
        self.change(|position| position.range_s = range_s.filter(|(from, to)| from < to));
    }

    /// Sets how fast it moves.
    pub fn set_speed(&self, speed: f64) {
        self.change(|position| position.speed = speed.clamp(0.05, 20.0));
    }

    /// Sets which outputs are rendered.
    pub fn set_requests(&self, requests: HashMap<Output, PreviewRequest>) {
        let mut state = lock(&self.state);
        if state.requests != requests {
            state.requests = requests;
            drop(state);
            self.wake_player();
        }
    }

    /// Sets whose values are read.
    pub fn set_probes(&self, requests: HashMap<Output, ProbeRequest>) {
        let mut state = lock(&self.state);
        if state.probe_requests != requests {
            state.probes.retain(|output, _| requests.contains_key(output));
            state.probe_requests = requests;
            drop(state);
            self.wake_player();
        }
    }

    /// The values of the shown pictures.
    pub fn probes(&self) -> HashMap<Output, Probe> {
        lock(&self.state).probes.clone()
    }

    /// Sets which outputs are compared in numbers.
    pub fn compare(&self, request: Option<ComparisonRequest>) {
        let mut state = lock(&self.state);
        if state.compared != request {
            (state.compared, state.comparison) = (request, None);
            drop(state);
            self.wake_player();
        }
    }

    /// How the shown packets of the compared outputs differ.
    pub fn comparison(&self) -> Option<Comparison> {
        lock(&self.state).comparison
    }

    /// Takes the pictures rendered since the last call.
    pub fn take(&self) -> HashMap<Output, RenderedPacket> {
        std::mem::take(&mut lock(&self.state).previews)
    }
}

impl Drop for Timeline {
    fn drop(&mut self) {
        lock(&self.state).quit = true;
        self.wake_player();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What was rendered of an output: generation, position in the port, request.
type Rendered = (u64, Option<usize>, PreviewRequest, Range);

/// Whose values were read: generation, position in the port, request.
type Probed = (u64, usize, ProbeRequest);

struct Player {
    recording: Arc<Recording>,
    start_ns: i64,
    state: Arc<Mutex<State>>,
    rendered: HashMap<Output, Rendered>,
    probed: HashMap<Output, Probed>,
    /// What was compared last: outputs, generation, positions in their ports.
    compared: Option<(ComparisonRequest, u64, [Option<usize>; 2])>,
    wake: Arc<Wake>,
}

impl Player {
    fn run(mut self) {
        let mut last = Instant::now();
        loop {
            let elapsed_s = last.elapsed().as_secs_f64();
            last = Instant::now();
            let (at_s, plays, requests, asked, others, generation) = {
                let mut state = lock(&self.state);
                if state.quit {
                    return;
                }
                advance(&mut state.position, elapsed_s, self.length_s());
                let Position { at_s, plays, .. } = state.position;
                let asked = state.probe_requests.clone();
                let others = Others { second: state.second.clone(), computed: state.computed.clone() };
                (at_s, plays, state.requests.clone(), asked, others, state.generation)
            };
            self.rendered.retain(|output, _| requests.contains_key(output));
            self.probed.retain(|output, _| asked.contains_key(output));
            let mut changed = plays;
            for (output, request) in requests {
                let asked = asked.get(&output).copied();
                changed |= self.render(&output, (request, asked), at_s, &others, generation);
            }
            changed |= self.compare(at_s, &others, generation);
            if changed {
                (self.wake)();
            }
            match plays {
                true => std::thread::park_timeout(INTERVAL.saturating_sub(last.elapsed())),
                false => std::thread::park(),
            }
            if !plays {
                last = Instant::now();
            }
        }
    }

    fn length_s(&self) -> f64 {
        let last = self.recording.sources.values().filter_map(|ticks| ticks.last().map(|tick| tick.capture_ns)).max();
        seconds(last.unwrap_or(self.start_ns).saturating_sub(self.start_ns))
    }

    /// The packets of an output, in its recording, and the position of the newest one at a moment.
    fn packets<'r>(&'r self, output: &Output, at_s: f64, others: &'r Others) -> Option<Shown<'r>> {
        let (recording, start_ns, port) = match output.node.strip_prefix(SECOND) {
            None => {
                let port = output.to_string();
                // A computed output has the capture times of the recorded sources.
                let computed = others.computed.as_deref().filter(|_| !self.recording.ports.contains_key(&port));
                (computed.unwrap_or(&self.recording), self.start_ns, port)
            }
            Some(node) => {
                let second = others.second.as_deref()?;
                (second, start_of(second).unwrap_or(0), format!("{node}.{}", output.port))
            }
        };
        let packets = recording.ports.get(&port)?;
        let until_ns = start_ns.saturating_add((at_s * 1e9).round() as i64);
        // Ticks of a port are in order.
        let passed = packets.partition_point(|packet| packet.head.tick.capture_ns <= until_ns);
        Some(Shown { recording, port, at: passed.checked_sub(1) })
    }

    /// Compares two outputs as they were at a moment, as far as that is not done already; returns whether there is something new.
    fn compare(&mut self, at_s: f64, others: &Others, generation: u64) -> bool {
        let Some(pair) = lock(&self.state).compared.clone() else { return false };
        let shown = |output| self.packets(output, at_s, others);
        let (Some(a), Some(b)) = (shown(&pair.output), shown(&pair.other)) else { return false };
        let question = (pair.clone(), generation, [a.at, b.at]);
        if self.compared.as_ref() == Some(&question) {
            return false;
        }
        let (Some(Ok(a)), Some(Ok(b))) = (a.frame(), b.frame()) else { return false };
        let measures = comparing::compare((a.frame(), a.bytes()), (b.frame(), b.bytes()), &pair.packet);
        self.compared = Some(question);
        let mut state = lock(&self.state);
        // Meanwhile another pair may be asked for.
        if state.compared.as_ref() == Some(&pair) {
            state.comparison = Some(Comparison { seq: a.frame().tick.seq, measures });
        }
        true
    }

    /// Renders an output as it was at a moment and reads its values, as far as that is not done already; returns whether there is something new.
    fn render(
        &mut self,
        output: &Output,
        (request, asked): (PreviewRequest, Option<ProbeRequest>),
        at_s: f64,
        others: &Others,
        generation: u64,
    ) -> bool {
        let Some(shown) = self.packets(output, at_s, others) else { return false };
        let at = shown.at;
        let known = self.rendered.get(output);
        let renders = known.is_none_or(|(g, n, r, _)| (*g, *n, r) != (generation, at, &request));
        let question = asked.zip(at).map(|(asked, at)| (generation, at, asked));
        let probes = question.is_some_and(|question| self.probed.get(output) != Some(&question));
        if !renders && !probes {
            return false;
        }
        let mut range = known.and_then(|(.., range)| *range);
        let mut is_new = false;
        match shown.frame() {
            Some(Ok(frame)) => {
                let rendered = renders.then(|| picture::render(&frame, &request.packet, request.max_width, &mut range));
                let probe = asked
                    .filter(|_| probes)
                    .and_then(|asked| probe::read(frame.frame(), frame.bytes(), &request.packet, &asked));
                let mut state = lock(&self.state);
                state.previews.extend(rendered.map(|rendered| (output.clone(), rendered)));
                state.probes.extend(probe.map(|probe| (output.clone(), probe)));
                state.problem = None;
                is_new = true;
            }
            Some(Err(error)) => lock(&self.state).problem = Some(error.to_string()),
            None => {}
        }
        if let Some(question) = question {
            self.probed.insert(output.clone(), question);
        }
        self.rendered.insert(output.clone(), (generation, at, request, range));
        is_new
    }
}

/// Recordings beside the one that is shown.
struct Others {
    /// The second one, to compare with.
    second: Option<Arc<Recording>>,
    /// What was computed from the recorded sources.
    computed: Option<Arc<Recording>>,
}

/// What an output shows at a moment.
struct Shown<'r> {
    recording: &'r Recording,
    port: String,
    /// Position of the packet in the port; `None` before the first one.
    at: Option<usize>,
}

impl Shown<'_> {
    fn frame(&self) -> Option<Result<FrameRef, RecordingError>> {
        let packet = self.recording.ports.get(&self.port)?.get(self.at?)?;
        Some(self.recording.frame(&self.port, packet))
    }
}

/// Moves a position on while it plays: to the end, or round its range.
fn advance(position: &mut Position, elapsed_s: f64, length_s: f64) {
    if !position.plays {
        return;
    }
    position.at_s += elapsed_s * position.speed;
    match position.range_s {
        Some((from, to)) if position.at_s > to || position.at_s < from => {
            let length = (to - from).max(1e-3);
            position.at_s = from + (position.at_s - from).rem_euclid(length);
        }
        Some(_) => {}
        None if position.at_s >= length_s => (position.at_s, position.plays) = (length_s, false),
        None => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_plays_to_the_end_or_round_its_range() {
        let mut position = Position { at_s: 0.0, plays: true, range_s: None, speed: 2.0 };
        advance(&mut position, 0.5, 3.0);
        assert_eq!(position.at_s, 1.0);
        advance(&mut position, 5.0, 3.0);
        assert_eq!((position.at_s, position.plays), (3.0, false));
        let mut position = Position { at_s: 1.4, plays: true, range_s: Some((1.0, 1.5)), speed: 1.0 };
        advance(&mut position, 0.2, 3.0);
        assert!((position.at_s - 1.1).abs() < 1e-9, "{position:?}");
        position.at_s = 2.9;
        advance(&mut position, 0.01, 3.0);
        assert!((1.0..1.5).contains(&position.at_s), "from outside into the range: {position:?}");
    }

    #[test]
    fn what_is_no_recording_is_refused() {
        let file = std::env::temp_dir().join(format!("panoscope_timeline_{}.mcap", std::process::id()));
        std::fs::write(&file, b"no recording").expect("written");
        let error = Timeline::open(&file, Arc::new(|| ())).err().expect("it is none").to_string();
        assert!(error.contains("panoscope_timeline_"), "{error}");
        std::fs::remove_file(&file).expect("removed");
    }
}
