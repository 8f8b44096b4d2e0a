//! Sources whose ticks are known: they are played instead of made.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use panoscope_abi::{Frame, Tick};

use crate::clock;
use crate::decide::Decider;
use crate::fault::Action;
use crate::ingest::INGEST_RING;
use crate::log::Level;
use crate::memory::FrameRef;
use crate::node::NodeRuntime;
use crate::observe::Event;
use crate::schedule::{Ready, Shared};
use crate::stats::bump;
use crate::threads::{capture_fits, capture_words};

impl Shared {
    /// Plays a source's known ticks; returns whether the thread is to leave.
    pub(crate) fn play(&self, decider: &dyn Decider, node: usize, cell: &Arc<NodeRuntime>) -> bool {
        if !decider.has_source(&cell.id) {
            return false;
        }
        while let Some(known) = decider.source_next(&cell.id) {
            if self.is_stopping() || decider.has_failed() {
                return false;
            }
            if cell.runner.leave.accept() {
                return true;
            }
            let seq = known.seq;
            if !capture_fits(known.capture_ns, None) {
                let words = capture_words(known.capture_ns, None);
                let words = format!("tick {seq} of `{}` in the recording: {words}", cell.id);
                decider.fail(words.clone());
                self.fail(words);
                return false;
            }
            if self.frames.is_some_and(|most| seq >= most) {
                return false;
            }
            let region = Arc::clone(self.plan.load().region_of(node));
            let enters = known.admitted || known.gap;
            if enters && (!decider.may_enter(&cell.id) || !region.has_room() || self.readers_lag(node)) {
                self.park(cell, Some(Duration::from_millis(1)));
                continue;
            }
            let tick = Tick { source: node as u32, flags: 0, seq, capture_ns: known.capture_ns };
            let outputs = match decider.source_frames(&cell.id, &cell.output_names) {
                Ok(frames) => self.admit_frames(cell, tick, frames),
                Err(words) => {
                    decider.fail(words.clone());
                    self.fail(words);
                    return false;
                }
            };
            let raw: Vec<Frame> = outputs.iter().map(|f| *f.frame()).collect();
            cell.note_made(&raw);
            cell.subscribers.show(&raw);
            if let Some(observer) = &self.around.observer {
                observer.source_tick(&cell.id, &cell.output_names, &tick, &raw);
            }
            cell.ticks.last_capture_ns.store(tick.capture_ns, Ordering::Relaxed);
            cell.ticks.ingest_ns[seq as usize % INGEST_RING].store(clock::now_ns().max(1), Ordering::Relaxed);
            cell.ticks.made.store(seq + 1, Ordering::Relaxed);
            decider.source_done(&cell.id);
            if !known.admitted || known.gap {
                if enters {
                    decider.entered(&cell.id);
                }
                bump(&cell.stats.dropped);
                cell.write_down(&self.around, |node| Event::Dropped { node, seq });
                continue;
            }
            // Nobody else lets ticks into this region, and it had room.
            if let (Some(outputs), _) = region.admit_or_keep(outputs) {
                let plan = self.plan.load();
                let mut ready = Ready::default();
                self.enter(&plan, node, outputs, &mut ready);
                ready.dispatch_ready(self, &plan, 0);
            }
            // Only now may a change of the graph that comes next find the region at rest.
            decider.entered(&cell.id);
        }
        false
    }

    /// The packets of a played tick. One that the source may not put out here, such as one of a format that it does not declare any more, is
    /// withheld.
    fn admit_frames(&self, cell: &NodeRuntime, tick: Tick, frames: Vec<Option<FrameRef>>) -> Vec<FrameRef> {
        let mut frames = frames.into_iter();
        let outputs = cell.rules.iter().map(|rule| {
            let Some(frame) = frames.next().flatten() else { return FrameRef::empty(tick) };
            if let Err((cause, words)) = rule.admit(frame.frame()) {
                bump(&cell.stats.faults);
                self.around.log.write(Level::Error, &cell.id, &words);
                cell.note(&self.around, cause, Action::Withhold, Some(tick.seq), || words.clone());
                return FrameRef::empty(tick);
            }
            let mut raw = frame.into_raw();
            raw.tick = tick;
            // SAFETY: the reference that `into_raw` gave up; only the tick is another.
            unsafe { FrameRef::adopt(raw) }
        });
        outputs.collect()
    }
}
