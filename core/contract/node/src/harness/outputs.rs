//! The outputs of one call of a node.

use crate::abi::{self, BufferId, Frame, Tick};
use crate::detections::{Detections, Instances};
use crate::input::{Cloud, FromFrame, Image, Text, Value, bytes};
use crate::packet::{Packet, Plane};
use crate::table::Table;
use crate::{View, ViewMut};

use super::available;
use super::error::HarnessError;
use super::host::SetTimes;

/// One output, copied out of the host's memory.
struct Output {
    name: String,
    packet: String,
    /// Describes `memory`; `None` when the output is empty.
    frame: Option<Frame>,
    /// The host's buffer that it was copied from.
    buffer: BufferId,
    _memory: Box<[u64]>,
}

/// The outputs of one call, by name. Owned: they outlive the harness.
pub struct Outputs {
    list: Vec<Output>,
    tick: Tick,
    skipped: bool,
    ended: bool,
    fault: Option<String>,
    times: SetTimes,
}

impl Outputs {
    pub(super) fn new(tick: Tick, skipped: bool, ended: bool) -> Self {
        Self { list: Vec::new(), tick, skipped, ended, fault: None, times: SetTimes::default() }
    }

    pub(super) fn set_fault(&mut self, fault: Option<String>) {
        self.fault = fault;
    }

    pub(super) fn set_times(&mut self, times: SetTimes) {
        self.times = times;
    }

    /// Arrival time that a source set for this tick, ns of the host's clock and not after the call.
    pub fn arrived_ns(&self) -> Option<i64> {
        self.times.arrived_ns
    }

    /// Lag behind the tick that the node declared for its outputs, ns.
    pub fn lag_ns(&self) -> Option<i64> {
        self.times.lag_ns
    }

    /// The fault that the node reported although it continues.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    pub(super) fn push(&mut self, name: &str, packet: &str, frame: &Frame) {
        let given = bytes(frame);
        let mut memory = vec![0_u64; given.len().div_ceil(8)].into_boxed_slice();
        let data: *mut u8 = memory.as_mut_ptr().cast();
        // SAFETY: `memory` is a fresh allocation of at least `given.len()` bytes, so the two do not overlap.
        unsafe { std::ptr::copy_nonoverlapping(given.as_ptr(), data, given.len()) };
        let copy = (!frame.is_empty()).then_some(Frame { data, tick: self.tick, ..*frame });
        let (name, packet) = (name.to_owned(), packet.to_owned());
        self.list.push(Output { name, packet, frame: copy, buffer: frame.buffer, _memory: memory });
    }

    /// Whether the node was skipped, because a required input was empty.
    pub fn skipped(&self) -> bool {
        self.skipped
    }

    /// Whether a source ended with this call.
    pub fn ended(&self) -> bool {
        self.ended
    }

    /// The tick of the call, with the capture time that a source set.
    pub fn tick(&self) -> Tick {
        self.tick
    }

    fn find(&self, name: &str) -> Result<&Output, HarnessError> {
        self.list.iter().find(|o| o.name == name).ok_or_else(|| {
            HarnessError::port(format!(
                "there is no output `{name}`{}",
                available(name, self.list.iter().map(|o| o.name.as_str()))
            ))
        })
    }

    /// Whether the node left the output empty.
    pub fn is_empty(&self, name: &str) -> Result<bool, HarnessError> {
        Ok(self.find(name)?.frame.is_none())
    }

    /// The host's buffer of the output, to check that a frame was forwarded and not copied.
    pub fn buffer(&self, name: &str) -> Result<BufferId, HarnessError> {
        Ok(self.find(name)?.buffer)
    }

    /// The output as any type that an input may declare. Fails when the packet type differs or the output is empty.
    pub fn get<'a, T: FromFrame<'a>>(&'a self, name: &str) -> Result<T, HarnessError> {
        let output = self.find(name)?;
        // SAFETY: `FromFrame::PORT` is made from static texts.
        let packet = unsafe { T::PORT.packet.text() }.unwrap_or_default();
        if packet != output.packet {
            return Err(HarnessError::port(format!("output `{name}` is `{}`, not `{packet}`", output.packet)));
        }
        let Some(frame) = &output.frame else {
            return Err(HarnessError::port(format!("output `{name}` is empty")));
        };
        T::from_frame(frame).map_err(|error| HarnessError::port(format!("output `{name}`: {error}")))
    }

    /// The pixels of an image, mask, disparity map or other plane.
    pub fn plane<P: Plane>(&self, name: &str) -> Result<View<'_, P::Element>, HarnessError> {
        Ok(self.get::<Image<'_, P>>(name)?.view())
    }

    /// The value of a plain-data output.
    pub fn value<T: Packet>(&self, name: &str) -> Result<T, HarnessError> {
        Ok(*self.get::<Value<'_, T>>(name)?)
    }

    /// The text of a `text` output.
    pub fn text(&self, name: &str) -> Result<&str, HarnessError> {
        Ok(self.get::<Text<'_>>(name)?.as_str())
    }

    /// The table of a `table` output.
    pub fn table(&self, name: &str) -> Result<Table<'_>, HarnessError> {
        self.get(name)
    }

    /// The boxes of a `detections` output.
    pub fn detections(&self, name: &str) -> Result<Detections<'_>, HarnessError> {
        self.get(name)
    }

    /// The boxes and masks of an `instances` output.
    pub fn instances(&self, name: &str) -> Result<Instances<'_>, HarnessError> {
        self.get(name)
    }

    /// The points of a `cloud` output, row after row.
    pub fn cloud(&self, name: &str) -> Result<&[abi::CloudPoint], HarnessError> {
        Ok(self.get::<Cloud<'_>>(name)?.points())
    }

    /// The raw bytes; empty when the output is empty.
    pub fn bytes(&self, name: &str) -> Result<&[u8], HarnessError> {
        Ok(self.find(name)?.frame.as_ref().map_or(&[], bytes))
    }
}

/// Copies `from` row by row, because strides may differ.
pub(super) fn copy_rows<E: Copy>(from: View<'_, E>, mut to: ViewMut<'_, E>) {
    for y in 0..from.height {
        to.row_mut(y).copy_from_slice(from.row(y));
    }
}
