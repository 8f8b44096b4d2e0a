//! What the author of a Panoscope node uses.
//!
//! A node is a type that implements [`Node`]: it declares its ports and parameters as plain structs and processes one
//! tick per call. [`export_plugin!`] makes a plugin of one or more nodes. The rest is typed access to what
//! the host lends: [`Image`], [`Value`] and [`List`] for inputs, [`Slot`] for outputs, [`Context`] for everything else.

extern crate self as panoscope_node;

pub mod context;
pub mod detections;
pub mod device;
pub mod error;
pub mod export;
mod guard;
#[cfg(feature = "harness")]
pub mod harness;
pub mod host;
pub mod input;
mod nest;
pub mod output;
pub mod packet;
pub mod param;
pub mod pick;
pub mod port;
pub mod table;
mod time;
pub mod validation;

pub use context::{Context, Finish, Open, Pool};
pub use detections::{Detections, Instances};
pub use error::{NodeError, Result};
pub use input::{AnyImage, Cloud, Image, List, Picture, Retained, Text, Value};
pub use output::Slot;
pub use packet::{
    AnyFormat, Bgr8, Confidence, Depth, Disparity, Gray8, Gray16, GrayF32, LabeledDetections, LabeledInstances, Mask,
    Packet, Plain, Plane, PlaneFormat, PointCloud, Rgba8, TableData, TextPacket, name16, name32,
};
pub use panoscope_abi as abi;
pub use panoscope_base::{Parallel, Rect, View, ViewMut, random};
pub use panoscope_node_derive::{Choice, Packet, Params, Ports};
pub use param::{Choice, ParamField, Params};
pub use port::{NoPorts, PortField, Ports, RawCall};
pub use table::Table;
pub use time::Timed;
pub use validation::Validation;

/// One processing node.
///
/// The host calls an instance from one thread at a time, but not always the same one. `process` uses no clock and no
/// random number except the host's, and allocates nothing in steady state. An output that it does not make is empty.
pub trait Node: Sized + Send + 'static {
    /// Name, family and kind.
    const INFO: NodeInfo;
    /// Input ports, see [`macro@Ports`]; [`NoPorts`] for none.
    type In<'f>: Ports<'f>;
    /// Output ports, see [`macro@Ports`]; [`NoPorts`] for none.
    type Out<'f>: Ports<'f>;
    /// Parameters, see [`macro@Params`].
    type Params: Params;

    /// Reports parameters and wiring with which `open` or the first tick would fail, so that `panoscope check` finds
    /// them. Must not open a device or write anything; may test whether files exist. The host calls it again before
    /// `open`, which therefore need not repeat it.
    fn validate(_params: &Self::Params, _check: &mut Validation<'_>) {}

    /// Creates an instance: loads models, opens devices, builds tables. May take long. Not called with parameters that
    /// [`Self::validate`] rejects.
    fn open(open: &Open<'_>, params: &Self::Params) -> Result<Self>;

    /// Processes one tick.
    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: Self::In<'f>,
        out: Self::Out<'f>,
        params: &Self::Params,
    ) -> Result<()>;

    /// Completes the node's files before it is closed; no other call follows. An error is reported and fails the run.
    /// Not called for an instance that was never used, nor when the host has no time left: then `drop` does what it
    /// can.
    fn finish(&mut self, _cx: &Finish<'_>) -> Result<()> {
        Ok(())
    }

    /// State for the instance that replaces this one while the graph runs; `None` when there is none.
    fn save_state(&self) -> Option<Vec<u8>> {
        None
    }

    /// Restores the state that an earlier instance saved.
    fn load_state(&mut self, _state: &[u8]) -> Result<()> {
        Ok(())
    }
}

/// When and where the host may run a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A short calculation; runs on the shared pool.
    Compute,
    /// May wait for a device or a file; has a separate thread.
    Blocking,
    /// A control loop; has a separate thread with high priority.
    Realtime,
}

/// A node type's name, family and scheduling needs.
#[derive(Clone, Copy, Debug)]
pub struct NodeInfo {
    /// Name in graph files, `snake_case`.
    pub name: &'static str,
    /// Family: source, stereo, stitch, tools, arm, overlay, sink, filter.
    pub family: &'static str,
    /// Purpose of the node, in one sentence; shown by `describe` and the editor.
    pub doc: &'static str,
    /// When and where the host may run it.
    pub kind: Kind,
    /// Starts ticks; has no required input.
    pub source: bool,
    /// Owns a device that no second instance can open at the same time.
    pub exclusive: bool,
    /// Has an effect outside the graph: writes files, moves an arm.
    pub side_effects: bool,
}

const fn is_snake_case(name: &str) -> bool {
    let bytes = name.as_bytes();
    let mut i = 0;
    while i < bytes.len() {
        let lower = bytes[i].is_ascii_lowercase();
        if !(lower || (i > 0 && (bytes[i].is_ascii_digit() || bytes[i] == b'_'))) {
            return false;
        }
        i += 1;
    }
    i > 0
}

impl NodeInfo {
    #[track_caller]
    const fn new(kind: Kind, name: &'static str, family: &'static str, doc: &'static str) -> Self {
        assert!(is_snake_case(name), "the first argument is the node type's name in graph files, in `snake_case`");
        assert!(!family.is_empty(), "a node type needs a family, such as \"filter\"");
        assert!(!doc.is_empty(), "a node type needs a text that says what it does");
        Self { name, family, doc, kind, source: false, exclusive: false, side_effects: false }
    }

    /// A short calculation.
    #[track_caller]
    pub const fn compute(name: &'static str, family: &'static str, doc: &'static str) -> Self {
        Self::new(Kind::Compute, name, family, doc)
    }

    /// A node that may wait.
    #[track_caller]
    pub const fn blocking(name: &'static str, family: &'static str, doc: &'static str) -> Self {
        Self::new(Kind::Blocking, name, family, doc)
    }

    /// A control loop.
    #[track_caller]
    pub const fn realtime(name: &'static str, family: &'static str, doc: &'static str) -> Self {
        Self::new(Kind::Realtime, name, family, doc)
    }

    /// Marks a node that starts ticks.
    pub const fn source(mut self) -> Self {
        self.source = true;
        self
    }

    /// Marks a node that owns a device.
    pub const fn exclusive(mut self) -> Self {
        self.exclusive = true;
        self
    }

    /// Marks a node that has an effect outside the graph.
    pub const fn side_effects(mut self) -> Self {
        self.side_effects = true;
        self
    }
}

#[doc(hidden)]
pub mod __private {
    pub use crate::nest::{params, ports};
    pub use crate::packet::{plain_size, sum};
    pub use crate::param::{
        Declared, DefaultValue, has_word, is_flag, is_floats, is_number, is_path, is_text, on_step, param,
        wrong_param_count,
    };
    pub use crate::port::port;
}
