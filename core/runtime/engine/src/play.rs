//! Replays sources whose ticks are known, in place of calling them.

use std::sync::Arc;
use std::time::Duration;

use panoscope_abi::{Frame, Tick};

use crate::clock;
use crate::decide::Decider;
use crate::fault::Action;
use crate::log::Level;
use crate::memory::FrameRef;
use crate::node::NodeRuntime;
use crate::observe::Event;
use crate::schedule::{Ready, Shared};
use crate::stats::bump;
use crate::threads::{capture_fits, capture_words};

impl Shared {
    /// Plays a source's known ticks; returns whether the thread must end.
    pub(crate) fn play(&self, decider: &dyn Decider, node: usize, runtime: &Arc<NodeRuntime>) -> bool {
        if !decider.has_source(&runtime.id) {
            return false;
        }
        while let Some(known) = decider.source_next(&runtime.id) {
            if self.is_stopping() || decider.has_failed() {
                return false;
            }
            if runtime.runner.leave.accept() {
                return true;
            }
            let seq = known.seq;
            if !capture_fits(known.capture_ns, None) {
                let words = capture_words(known.capture_ns, None);
                let words = format!("tick {seq} of `{}` in the recording: {words}", runtime.id);
                decider.fail(words.clone());
                self.fail(words);
                return false;
            }
            if self.frames.is_some_and(|most| seq >= most) {
                return false;
            }
            let region = Arc::clone(self.plan.load().region_of(node));
            let enters = known.admitted || known.gap;
            if enters && (!decider.may_enter(&runtime.id) || !region.has_room() || self.readers_lag(node)) {
                runtime.runner.park_at_most(Some(Duration::from_millis(1)));
                continue;
            }
            let tick = Tick { source: node as u32, flags: 0, seq, capture_ns: known.capture_ns };
            let outputs = match decider.source_frames(&runtime.id, &runtime.output_names) {
                Ok(frames) => self.admit_frames(runtime, tick, frames),
                Err(error) => {
                    decider.fail(error.to_string());
                    self.fail(error.to_string());
                    return false;
                }
            };
            let raw: Vec<Frame> = outputs.iter().map(|f| *f.frame()).collect();
            runtime.progress.record_ports(&raw);
            runtime.ticks.arrive(seq, clock::now_ns() as i64);
            runtime.subscribers.show(&raw);
            if let Some(observer) = &self.context.observer {
                observer.source_tick(&runtime.id, &runtime.output_names, &tick, &raw);
            }
            if !known.gap && raw.iter().all(Frame::is_empty) && runtime.is_read() {
                runtime.ticks.count_empty();
            }
            runtime.ticks.set_last_capture_ns(tick.capture_ns);
            runtime.ticks.enter(seq);
            decider.source_done(&runtime.id);
            if !known.admitted || known.gap {
                if enters {
                    decider.entered(&runtime.id);
                }
                bump(&runtime.stats.dropped);
                runtime.record_event(&self.context, |node| Event::Dropped { node, seq });
                continue;
            }
            // Only this thread admits ticks to this region, and it had room.
            if let (Some(outputs), _) = region.admit_or_keep(outputs) {
                let plan = self.plan.load();
                let mut ready = Ready::default();
                self.enter(&plan, node, outputs, &mut ready);
                ready.dispatch_ready(self, &plan, 0);
            }
            // Only now a following change of the graph may find the region at rest.
            decider.entered(&runtime.id);
        }
        false
    }

    /// The packets of a replayed tick. Withholds packets that the source may not make here, such as one of a format
    /// that it no longer declares.
    fn admit_frames(&self, runtime: &NodeRuntime, tick: Tick, frames: Vec<Option<FrameRef>>) -> Vec<FrameRef> {
        let mut frames = frames.into_iter();
        let outputs = runtime.rules.iter().map(|rule| {
            let Some(frame) = frames.next().flatten() else { return FrameRef::empty(tick) };
            if let Err((cause, words)) = rule.admit(frame.frame()) {
                bump(&runtime.stats.faults);
                self.context.log.write(Level::Error, &runtime.id, &words);
                runtime.report_repeated_fault(&self.context, cause, Action::Withhold, Some(tick.seq), || words.clone());
                return FrameRef::empty(tick);
            }
            let mut raw = frame.into_raw();
            raw.tick = tick;
            // SAFETY: the reference that `into_raw` released; only the tick changed.
            unsafe { FrameRef::adopt(raw) }
        });
        outputs.collect()
    }
}
