//! Host functions for the times of inputs and outputs of a call.

use std::ffi::c_void;

use panoscope_abi::{INPUT_TICK, Tick};

use super::{CallContext, call_context};
use crate::clock;
use crate::decide::Ages;
use crate::exec::CallTimes;
use crate::light::{Lag, Lights};

/// Inputs from this index on share a bit of [`CallTimes::asked`]; [`INPUT_TICK`] has the bit after it.
const LAST_BIT: u32 = 62;

/// Bit of an input in [`CallTimes::asked`].
fn bit(input: u32) -> u64 {
    if input == INPUT_TICK { 1 << (LAST_BIT + 1) } else { 1 << input.min(LAST_BIT) }
}

fn wall_ns() -> i64 {
    i64::try_from(clock::now_ns()).unwrap_or(i64::MAX)
}

impl CallContext<'_> {
    /// The times of this call; `None` where it has no tick.
    fn times(&mut self) -> Option<&mut CallTimes> {
        self.has_times = true;
        self.times.as_deref_mut()
    }

    /// The moment of this call for ages: media time where results must not depend on the wall clock.
    fn now_ns(&mut self) -> Option<i64> {
        let (run, runtime, tick) = (self.context, self.runtime, self.tick);
        let times = self.times()?;
        if times.now_ns.is_none() {
            let decider = run.decider.as_deref().filter(|d| d.leads_nodes());
            times.recorded = decider.and_then(|d| d.ages(&runtime.id, &tick)).map(Box::new);
            times.now_ns = Some(match &times.recorded {
                Some(recorded) => recorded.now_ns,
                None if run.ignores_wall_clock() => tick.capture_ns,
                None => wall_ns(),
            });
        }
        times.now_ns
    }

    /// When the light of a packet arrived, by the clock of [`Self::now_ns`].
    fn light_ns(&self, tick: &Tick) -> Option<i64> {
        if self.context.ignores_wall_clock() {
            return Some(tick.capture_ns.saturating_sub(Lag::carried(tick).oldest_ns));
        }
        self.sources?.light_ns(tick)
    }

    /// The tick of an input that is not empty.
    fn tick_of(&self, input: u32) -> Option<Tick> {
        if input == INPUT_TICK {
            return Some(Tick { flags: 0, ..self.tick });
        }
        // SAFETY: `inputs` holds `inputs_len` frames for the length of the call.
        let frame = ((input as usize) < self.inputs_len).then(|| unsafe { &*self.inputs.add(input as usize) })?;
        (!frame.is_empty()).then_some(frame.tick)
    }

    fn input_light_ns(&mut self, input: u32) -> Option<i64> {
        self.now_ns()?;
        let tick = self.tick_of(input)?;
        let times = self.times()?;
        times.asked |= bit(input);
        let recorded = times.recorded.as_ref();
        let known = recorded.and_then(|recorded| recorded.arrived.iter().find(|(index, _)| *index == input));
        match known {
            Some((_, arrived_ns)) => *arrived_ns,
            None => self.light_ns(&tick),
        }
    }

    /// How much older the light of another tick's packet is than that of this call's tick, as [`Tick::flags`].
    #[cold]
    pub fn lag_behind(&self, tick: &Tick) -> u32 {
        let Some(sources) = self.sources.filter(|_| !self.runtime.source) else { return 0 };
        let lights = Lights { sources, by_capture: self.context.ignores_wall_clock(), now_ns: 0 };
        lights.lag(&self.tick, tick).map_or(0, Lag::flags)
    }

    /// Input ages that the node received in this call; `None` when it asked for none.
    pub fn answered(&mut self) -> Option<Ages> {
        let asked = self.times()?.asked;
        if asked == 0 {
            return None;
        }
        let now_ns = self.now_ns()?;
        let inputs = (0..self.inputs_len as u32).chain([INPUT_TICK]).filter(|input| asked & bit(*input) != 0);
        Some(Ages { now_ns, arrived: inputs.map(|input| (input, self.input_light_ns(input))).collect() })
    }

    /// Ends the use of times in this call. Returns the lag that the node declared for its outputs.
    pub fn end_times(&mut self) -> u32 {
        let Some(times) = self.times() else { return 0 };
        let (lag, arrived_ns) = (times.lag, times.arrived_ns);
        *times = CallTimes { arrived_ns, ..CallTimes::default() };
        lag
    }
}

pub(super) unsafe extern "C" fn set_arrived_ns(call: *mut c_void, arrived_ns: i64) {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    let call_context = unsafe { call_context(call) };
    if let Some(times) = call_context.and_then(CallContext::times) {
        times.arrived_ns = Some(arrived_ns.min(wall_ns()));
    }
}

pub(super) unsafe extern "C" fn arrived_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    let call_context = unsafe { call_context(call) };
    call_context.and_then(|call_context| call_context.input_light_ns(input)).unwrap_or(i64::MIN)
}

pub(super) unsafe extern "C" fn age_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    let Some(call_context) = (unsafe { call_context(call) }) else { return i64::MAX };
    let arrived_ns = call_context.input_light_ns(input);
    let now_ns = call_context.now_ns();
    now_ns.zip(arrived_ns).map_or(i64::MAX, |(now_ns, arrived_ns)| now_ns.saturating_sub(arrived_ns).max(0))
}

pub(super) unsafe extern "C" fn set_lag_ns(call: *mut c_void, lag_ns: i64) {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    let call_context = unsafe { call_context(call) }.filter(|call_context| !call_context.runtime.source);
    if let Some(times) = call_context.and_then(CallContext::times) {
        times.lag = Lag::of(lag_ns).flags();
    }
}
