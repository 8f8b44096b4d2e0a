//! When the light behind a packet arrived, and how old it is.

use std::time::Duration;

use crate::abi;
use crate::context::{Context, has};
use crate::detections::{Detections, Instances};
use crate::input::{AnyImage, Cloud, Image, Picture, Value};

/// An input packet whose age a node can ask for.
pub trait Timed {
    /// The frame as the host describes it.
    #[doc(hidden)]
    fn timed_frame(&self) -> &abi::Frame;
}

impl<P> Timed for Image<'_, P> {
    fn timed_frame(&self) -> &abi::Frame {
        self.raw_frame()
    }
}

impl<T> Timed for Value<'_, T> {
    fn timed_frame(&self) -> &abi::Frame {
        self.raw_frame()
    }
}

macro_rules! timed {
    ($($packet:ident),*) => {$(
        impl Timed for $packet<'_> {
            fn timed_frame(&self) -> &abi::Frame {
                self.raw_frame()
            }
        }
    )*};
}
timed!(AnyImage, Picture, Cloud, Detections);

impl Timed for Instances<'_> {
    fn timed_frame(&self) -> &abi::Frame {
        self.list().raw_frame()
    }
}

/// End of a function's field in the host's table.
macro_rules! end_of {
    ($function:ident) => {
        std::mem::offset_of!(abi::Host, $function) + size_of::<usize>()
    };
}

impl Context<'_> {
    /// For sources: sets when the light (or the packet) of this tick arrived, in ns of [`Context::clock_ns`]. All ages
    /// count from there. A time in the future counts as now. Without it a tick arrives when it enters the graph.
    pub fn set_arrived_ns(&self, arrived_ns: i64) {
        let host = self.host();
        if let Some(set) = host.set_arrived_ns.filter(|_| has(host, end_of!(set_arrived_ns))) {
            // SAFETY: the host keeps the handle of the running call valid for the lifetime of this context.
            unsafe { set(self.call().call, arrived_ns) }
        }
    }

    /// Declares that the outputs of this call show light that is older than that of the tick by `lag`: held or
    /// predicted values. Readers see that age. Sources use [`Context::set_arrived_ns`].
    pub fn set_lag(&self, lag: Duration) {
        let host = self.host();
        if let Some(set) = host.set_lag_ns.filter(|_| has(host, end_of!(set_lag_ns))) {
            let lag_ns = i64::try_from(lag.as_nanos()).unwrap_or(i64::MAX);
            // SAFETY: the host keeps the handle of the running call valid for the lifetime of this context.
            unsafe { set(self.call().call, lag_ns) }
        }
    }

    /// Age of an input's light: the time since it arrived at the host. In `batch`, and where the host has no arrival
    /// times, the difference of capture times. [`Duration::MAX`] where it is unknown. A replay returns what the
    /// recorded run returned, so results may depend on it.
    pub fn age(&self, packet: &impl Timed) -> Duration {
        let frame = packet.timed_frame();
        self.age_of(self.index_of(frame), frame.tick.capture_ns)
    }

    /// Age of the light of the tick, whatever its inputs are; see [`Context::age`].
    pub fn tick_age(&self) -> Duration {
        self.age_of(Some(abi::INPUT_TICK), self.tick().capture_ns)
    }

    /// When an input's light arrived, in ns of [`Context::clock_ns`], for times between two arrivals. In `batch`, and
    /// where the host has no arrival times, the capture time; `None` where it is unknown.
    pub fn arrived_ns(&self, packet: &impl Timed) -> Option<i64> {
        let frame = packet.timed_frame();
        self.arrival_of(self.index_of(frame), frame.tick.capture_ns)
    }

    /// When the light of the tick arrived; see [`Context::arrived_ns`].
    pub fn tick_arrived_ns(&self) -> Option<i64> {
        self.arrival_of(Some(abi::INPUT_TICK), self.tick().capture_ns)
    }

    fn age_of(&self, index: Option<u32>, capture_ns: i64) -> Duration {
        let host = self.host();
        let age_ns = match (host.age_ns.filter(|_| has(host, end_of!(age_ns))), index) {
            // SAFETY: the host keeps the handle of the running call valid for the lifetime of this context.
            (Some(age), Some(index)) => unsafe { age(self.call().call, index) },
            _ => self.tick().capture_ns.saturating_sub(capture_ns),
        };
        match age_ns {
            i64::MAX => Duration::MAX,
            _ => Duration::from_nanos(age_ns.max(0).unsigned_abs()),
        }
    }

    fn arrival_of(&self, index: Option<u32>, capture_ns: i64) -> Option<i64> {
        let host = self.host();
        match (host.arrived_ns.filter(|_| has(host, end_of!(arrived_ns))), index) {
            (Some(arrived), Some(index)) => {
                // SAFETY: the host keeps the handle of the running call valid for the lifetime of this context.
                Some(unsafe { arrived(self.call().call, index) }).filter(|&ns| ns != i64::MIN)
            }
            _ => Some(capture_ns),
        }
    }

    /// Index of a frame among the inputs of the call.
    fn index_of(&self, frame: &abi::Frame) -> Option<u32> {
        let call = self.call();
        let offset = std::ptr::from_ref(frame).addr().checked_sub(call.inputs.addr())?;
        let index = offset / size_of::<abi::Frame>();
        (index < call.inputs_len).then_some(index as u32)
    }
}
