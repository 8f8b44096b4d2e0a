//! The thread that guards the processes: it starts, watches and replaces them.

use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use panoscope_editor_model::session::Wake;
use panoscope_editor_model::texts::{Phrase, phrase};
use panoscope_engine::sync::lock;

use super::process::{Inbox, Incoming, Process, Program};
use super::recovery::Step;
use super::state::{Spare, State};
use crate::link::{Command, Message};
use crate::{OpenError, Refusal};

/// Time between two looks at the processes.
const LOOK: Duration = Duration::from_millis(25);
/// Longest time that counts for one look: the window itself did not run for the rest.
const MAX_LOOK: Duration = Duration::from_millis(100);
/// Time from the first pictures, or from the last try, to the start of the process that waits.
pub(super) const SPARE_AFTER: Duration = Duration::from_secs(2);
const SPARE_AGAIN: Duration = Duration::from_secs(20);

pub(super) struct Shared {
    pub(super) program: Program,
    pub(super) path: PathBuf,
    pub(super) state: Mutex<State>,
    pub(super) changed: Condvar,
    pub(super) wake: Mutex<Option<Arc<Wake>>>,
}

impl Shared {
    pub(super) fn wake(&self) {
        let wake = lock(&self.wake).clone();
        if let Some(wake) = wake {
            wake();
        }
    }

    pub(super) fn act<T>(&self, act: impl FnOnce(&mut State) -> T) -> T {
        let result = act(&mut lock(&self.state));
        self.changed.notify_all();
        result
    }

    /// Starts a process.
    pub(super) fn start(self: &Arc<Self>, state: &mut State) -> io::Result<Process> {
        let id = state.next_id;
        state.next_id += 1;
        let shared = Arc::downgrade(self);
        let inbox: Arc<Inbox> = Arc::new(move |id, incoming| {
            if let Some(shared) = shared.upgrade() {
                shared.receive(id, incoming);
            }
        });
        Process::start(id, &self.program, inbox)
    }

    /// Takes what a process sent.
    pub(super) fn receive(&self, id: u64, incoming: Incoming) {
        {
            let mut guard = lock(&self.state);
            let state = &mut *guard;
            let is_active = state.active.as_ref().is_some_and(|active| active.id == id);
            let spare = state.spare.as_mut().filter(|spare| spare.process.id == id);
            match (incoming, spare) {
                (Incoming::Message(Message::Prepared(Ok(_))), Some(spare)) => spare.is_ready = true,
                (Incoming::Message(Message::Prepared(Err(refusal))), Some(spare)) => {
                    spare.process.kill(phrase!("worker-refused", reason = &refusal.line))
                }
                // Its end is seen by the next look.
                (Incoming::End, _) => {}
                (Incoming::Message(message), None) if is_active => state.take_message(message),
                (Incoming::Picture(output, packet), None) if is_active => {
                    state.recovery.picture(Instant::now());
                    state.previews.insert(output, packet);
                }
                _ => return,
            }
        }
        self.changed.notify_all();
        self.wake();
    }

    /// Guards the processes until the window is closed.
    pub(super) fn watch(self: Arc<Self>) {
        let mut state = lock(&self.state);
        loop {
            let now = Instant::now();
            let passed = now.duration_since(state.looked_at).min(MAX_LOOK);
            state.looked_at = now;
            let closing_since = state.closing_since;
            let changed = match closing_since {
                Some(since) if state.see_close(since, passed) => return,
                Some(_) => false,
                None => self.look(&mut state, now, passed),
            };
            if changed {
                drop(state);
                self.changed.notify_all();
                self.wake();
                state = lock(&self.state);
            } else {
                state = self.changed.wait_timeout(state, LOOK).unwrap_or_else(PoisonError::into_inner).0;
            }
        }
    }

    /// One look at the processes; returns whether something changed.
    fn look(self: &Arc<Self>, state: &mut State, now: Instant, passed: Duration) -> bool {
        let mut changed = state.see_late_switches();
        state.watch_silence(passed);
        changed |= self.see_ends(state, now);
        if state.known.is_none() {
            return changed | self.begin_first(state);
        }
        match state.recovery.step(now) {
            Step::Wait => {}
            Step::Cameras => {
                changed = true;
                self.replace(state, now);
            }
            // A process that is still loading goes on.
            Step::CamerasAgain if state.is_preparing => {}
            Step::CamerasAgain => state.run_text(state.cameras.clone(), true),
            Step::Whole => {
                changed = true;
                state.run_text(state.whole.clone(), false);
            }
        }
        changed |= state.judge_start(now);
        self.begin_spare(state, now);
        changed
    }

    /// Starts the first process, before anything is known of the graph.
    fn begin_first(self: &Arc<Self>, state: &mut State) -> bool {
        let is_asked = state.asked.is_some() || state.searched.is_some();
        if !is_asked || state.active.is_some() || state.prepared.is_some() {
            return false;
        }
        match self.start(state) {
            Ok(process) => state.active = Some(process),
            Err(error) => {
                state.prepared = Some(Err(self.refusal(phrase!("worker-not-started", reason = error.to_string()))))
            }
        }
        if let Some((file, given)) = state.asked.clone() {
            state.send(Command::Prepare { file, given });
        }
        if let Some((file, given)) = state.searched.clone() {
            state.send(Command::FindOverlays { file, given });
        }
        true
    }

    /// Makes the process that waits the one that runs the graph, or a new one.
    fn replace(self: &Arc<Self>, state: &mut State, now: Instant) {
        state.recovery.opening(now);
        state.spare_at = now + SPARE_AFTER;
        if let Some(Spare { process, is_ready }) = state.spare.take() {
            state.active = Some(process);
            state.is_preparing = !is_ready;
            if is_ready {
                state.show_cameras();
            }
            return;
        }
        match self.start(state) {
            Ok(process) => {
                state.reload(&process);
                state.active = Some(process);
                state.is_preparing = true;
            }
            Err(error) => state.recovery.crashed(phrase!("worker-not-started", reason = error.to_string()), now),
        }
    }

    /// Starts the process that waits, once all is well.
    fn begin_spare(self: &Arc<Self>, state: &mut State, now: Instant) {
        let is_well = state.recovery.shows_pictures() && state.run.is_running() && !state.is_preparing;
        if state.spare.is_some() || !is_well || now < state.spare_at {
            return;
        }
        state.spare_at = now + SPARE_AGAIN;
        // Without it a crash costs the time to load the plugins.
        if let Ok(process) = self.start(state) {
            state.reload(&process);
            state.spare = Some(Spare { process, is_ready: false });
        }
    }

    /// Takes note of processes that have ended.
    fn see_ends(&self, state: &mut State, now: Instant) -> bool {
        if state.spare.as_ref().is_some_and(|spare| spare.process.end().is_some()) {
            state.spare = None;
            state.spare_at = now + SPARE_AGAIN;
        }
        let Some(why) = state.active.as_ref().and_then(Process::end) else { return false };
        state.active = None;
        state.forget_run();
        if state.asked.take().is_some() {
            // What was being checked may be what it crashed on.
            state.prepared = Some(Err(self.refusal(why.clone())));
        }
        if state.searched.take().is_some() {
            state.overlays = Some(Vec::new());
        }
        if state.known.is_some() {
            state.recovery.crashed(why, now);
        }
        true
    }

    pub(super) fn refusal(&self, why: Phrase) -> Refusal {
        Refusal::of(&self.path, &OpenError::Worker(why))
    }
}
