//! What the author of a Panoscope node uses.
//!
//! A node is a type that implements [`Node`]: it names its ports and parameters as plain structs and processes one
//! tick per call. [`export_plugin!`] makes a plugin of one or more nodes. The rest is typed access to what
//! the host lends: [`Image`], [`Value`], [`List`] for inputs, [`Slot`] for outputs, [`Context`] for everything else.

extern crate self as panoscope_node;

pub mod context;
pub mod detections;
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
pub mod port;
pub mod table;
pub mod validation;

pub use context::{Context, Finish, Open, Pool};
pub use detections::{Detections, Instances, LabeledDetections, LabeledInstances};
pub use error::{NodeError, Result};
pub use input::{AnyImage, Cloud, Image, Kept, List, Text, Value};
pub use output::Slot;
pub use packet::{
    AnyFormat, Bgr8, Confidence, Depth, Disparity, Gray8, Gray16, GrayF32, Mask, Packet, Plain, Plane, PlaneFormat,
    PointCloud, Rgba8, TextPacket, name16, name32,
};
pub use panoscope_abi as abi;
pub use panoscope_base::{Parallel, Rect, View, ViewMut, random};
pub use panoscope_node_derive::{Choice, Packet, Params, Ports};
pub use param::{Choice, ParamField, Params};
pub use port::{NoPorts, PortField, Ports, RawCall};
pub use table::{Table, TableData};
pub use validation::Validation;

/// One processing node.
///
/// An instance is used by one thread at a time, but not always the same one. `process` sees no clock and no random
/// number except the host's, allocates nothing in steady state, and leaves an output empty by not making it.
pub trait Node: Sized + Send + 'static {
    /// Name, family and kind.
    const INFO: NodeInfo;
    /// Input ports, see [`macro@Ports`]; [`NoPorts`] for none.
    type In<'f>: Ports<'f>;
    /// Output ports, see [`macro@Ports`]; [`NoPorts`] for none.
    type Out<'f>: Ports<'f>;
    /// Parameters, see [`macro@Params`].
    type Params: Params;

    /// Reports what `open` or a first tick would refuse about parameters and wiring, so that `panoscope check` finds it. Opens no device and
    /// writes nothing; may look whether files are there. Called again before `open`, which therefore need not repeat it.
    fn validate(_params: &Self::Params, _check: &mut Validation<'_>) {}

    /// Makes an instance: loads models, opens devices, builds tables. May take long. Not called for parameters that
    /// [`Self::validate`] refuses.
    fn open(open: &Open<'_>, params: &Self::Params) -> Result<Self>;

    /// Processes one tick.
    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: Self::In<'f>,
        out: Self::Out<'f>,
        params: &Self::Params,
    ) -> Result<()>;

    /// Completes what the node writes, before it is closed: nothing comes after this call. An error is told and fails the run. Not called for an
    /// instance that was never used, nor when the host has no time left: `drop` does what can be done then.
    fn finish(&mut self, _cx: &Finish<'_>) -> Result<()> {
        Ok(())
    }

    /// State worth handing to a replacement of this node while the graph runs.
    fn save_state(&self) -> Option<Vec<u8>> {
        None
    }

    /// Takes over what an earlier instance saved.
    fn load_state(&mut self, _state: &[u8]) -> Result<()> {
        Ok(())
    }
}

/// When and where the host may run a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Short calculation on the shared pool.
    Compute,
    /// May wait: owns a thread.
    Blocking,
    /// Control loop: owns a thread of high priority.
    Realtime,
}

/// What a node type says of itself.
#[derive(Clone, Copy, Debug)]
pub struct NodeInfo {
    /// Name in graph files, `snake_case`.
    pub name: &'static str,
    /// Family: source, stereo, stitch, tools, arm, overlay, sink, filter.
    pub family: &'static str,
    /// What the node does.
    pub doc: &'static str,
    /// Where it runs.
    pub kind: Kind,
    /// Makes ticks without any input.
    pub source: bool,
    /// Owns a device.
    pub exclusive: bool,
    /// Acts on the world outside the graph.
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

    /// Marks a node that makes ticks.
    pub const fn source(mut self) -> Self {
        self.source = true;
        self
    }

    /// Marks a node that owns a device.
    pub const fn exclusive(mut self) -> Self {
        self.exclusive = true;
        self
    }

    /// Marks a node that acts on the world outside the graph.
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
