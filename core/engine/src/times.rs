//! What a call may ask about the time of its inputs, and what it may say about that of its outputs.

use std::ffi::c_void;

use panoscope_abi::{INPUT_TICK, Tick};

use crate::clock;
use crate::decide::Ages;
use crate::host::{CallContext, call_context};
use crate::node::{RunContext, Sources, lag_flags, lag_ns};

/// Inputs from this index on share a bit of [`CallTimes::asked`]; [`INPUT_TICK`] has the bit after it.
const LAST_BIT: u32 = 62;

/// The times of one call.
pub(crate) struct CallTimes<'a> {
    /// The sources of the graph; none in calls that have no tick.
    sources: Option<&'a dyn Sources>,
    /// The moment for which ages are given, once one was asked for.
    now_ns: Option<i64>,
    /// Inputs whose time was asked for, one bit each, see [`bit`].
    asked: u64,
    /// What the recorded run returned, in a replay.
    recorded: Option<Box<Ages>>,
    /// Lag of all outputs, see [`Tick::flags`].
    lag: u32,
    /// For a source: arrival of the tick.
    arrived_ns: Option<i64>,
}

impl<'a> CallTimes<'a> {
    /// Nothing asked yet.
    #[inline]
    pub fn new(sources: Option<&'a dyn Sources>) -> Self {
        Self { sources, now_ns: None, asked: 0, recorded: None, lag: 0, arrived_ns: None }
    }

    /// Lag that the node declared for its outputs.
    #[inline]
    pub fn lag(&self) -> u32 {
        self.lag
    }

    /// Arrival that a source declared for its tick, ns of the host's clock.
    pub fn arrived_ns(&self) -> Option<i64> {
        self.arrived_ns
    }

    /// Whether the node asked for a time.
    #[inline]
    pub fn is_asked(&self) -> bool {
        self.asked != 0
    }
}

/// Bit of an input in [`CallTimes::asked`].
fn bit(input: u32) -> u64 {
    if input == INPUT_TICK { 1 << (LAST_BIT + 1) } else { 1 << input.min(LAST_BIT) }
}

fn wall_ns() -> i64 {
    i64::try_from(clock::now_ns()).unwrap_or(i64::MAX)
}

impl CallContext<'_> {
    fn run(&self) -> &RunContext {
        self.context
    }

    /// The moment of this call for ages: media time where results must not depend on the wall clock.
    fn now_ns(&mut self) -> i64 {
        if let Some(now_ns) = self.times.now_ns {
            return now_ns;
        }
        let decider = self.run().decider.as_deref().filter(|d| d.leads_nodes());
        self.times.recorded = decider.and_then(|d| d.ages(&self.runtime.id, &self.tick)).map(Box::new);
        let now_ns = match &self.times.recorded {
            Some(recorded) => recorded.now_ns,
            None if self.run().ignores_wall_clock() => self.tick.capture_ns,
            None => wall_ns(),
        };
        self.times.now_ns = Some(now_ns);
        now_ns
    }

    /// When the light of a packet arrived, by the clock of [`Self::now_ns`].
    fn light_ns(&self, tick: &Tick) -> Option<i64> {
        if self.run().ignores_wall_clock() {
            return Some(tick.capture_ns.saturating_sub(lag_ns(tick)));
        }
        self.times.sources?.light_ns(tick)
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
        self.now_ns();
        let tick = self.tick_of(input)?;
        self.times.asked |= bit(input);
        if let Some(recorded) = &self.times.recorded {
            let known = recorded.arrived.iter().find(|(index, _)| *index == input);
            if let Some((_, arrived_ns)) = known {
                return *arrived_ns;
            }
        }
        self.light_ns(&tick)
    }

    /// How much older the light of another tick's packet is than that of this call's tick, as [`Tick::flags`].
    #[cold]
    pub fn lag_behind(&self, tick: &Tick) -> u32 {
        if self.runtime.source {
            return 0;
        }
        match (self.light_ns(&Tick { flags: 0, ..self.tick }), self.light_ns(tick)) {
            (Some(own_ns), Some(light_ns)) => lag_flags(own_ns.saturating_sub(light_ns)),
            _ => 0,
        }
    }

    /// What the node was answered in this call.
    #[cold]
    pub fn answered(&mut self) -> Ages {
        let now_ns = self.now_ns();
        let asked = |input: &u32| self.times.asked & bit(*input) != 0;
        let inputs: Vec<u32> = (0..self.inputs_len as u32).chain([INPUT_TICK]).filter(asked).collect();
        Ages { now_ns, arrived: inputs.into_iter().map(|input| (input, self.input_light_ns(input))).collect() }
    }
}

pub(crate) unsafe extern "C" fn set_arrived_ns(call: *mut c_void, arrived_ns: i64) {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    if let Some(call_context) = unsafe { call_context(call) } {
        call_context.times.arrived_ns = Some(arrived_ns.min(wall_ns()));
    }
}

pub(crate) unsafe extern "C" fn arrived_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    let call_context = unsafe { call_context(call) };
    call_context.and_then(|call_context| call_context.input_light_ns(input)).unwrap_or(i64::MIN)
}

pub(crate) unsafe extern "C" fn age_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    let Some(call_context) = (unsafe { call_context(call) }) else { return i64::MAX };
    let arrived_ns = call_context.input_light_ns(input);
    arrived_ns.map_or(i64::MAX, |arrived_ns| call_context.now_ns().saturating_sub(arrived_ns).max(0))
}

pub(crate) unsafe extern "C" fn set_lag_ns(call: *mut c_void, lag_ns: i64) {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    if let Some(call_context) = unsafe { call_context(call) }.filter(|call_context| !call_context.runtime.source) {
        call_context.times.lag = lag_flags(lag_ns);
    }
}
