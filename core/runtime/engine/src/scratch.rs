//! Memory of the calls that a thread makes.

use panoscope_abi::Frame;

use crate::memory::FrameRef;

/// Outputs of a call. Outside a call all frames are empty.
#[derive(Default)]
pub struct CallOutputs {
    /// The host's descriptions.
    pub(crate) outputs: Vec<Frame>,
    /// The node's copies, which it may change.
    pub(crate) shown: Vec<Frame>,
}

impl CallOutputs {
    /// Makes room for a node's outputs.
    #[inline]
    pub(crate) fn set_len(&mut self, len: usize) {
        if self.outputs.len() != len {
            self.clear();
            self.outputs.resize(len, Frame::EMPTY);
            self.shown.resize(len, Frame::EMPTY);
        }
    }

    /// Releases everything.
    #[inline]
    pub(crate) fn clear(&mut self) {
        // SAFETY: outside a call the outputs are empty or hold references: `CallContext` puts nothing else there, and a forwarded frame
        // has its input's reference when the call ends.
        unsafe { clear(&mut self.outputs) };
    }
}

impl Drop for CallOutputs {
    fn drop(&mut self) {
        self.clear();
    }
}

/// Memory for the calls that a thread makes one after the other.
pub struct Scratch {
    /// Inputs of a chain's first node.
    pub(crate) inputs: Vec<FrameRef>,
    /// Outputs of a node and of the one before it, in turn.
    pub(crate) made: [CallOutputs; 2],
}

/// Ports that a thread has room for from its start; grows when a node has more.
const USUAL_PORTS: usize = 16;

impl Default for Scratch {
    fn default() -> Self {
        let made = || CallOutputs { outputs: Vec::with_capacity(USUAL_PORTS), shown: Vec::with_capacity(USUAL_PORTS) };
        Self { inputs: Vec::with_capacity(USUAL_PORTS), made: [made(), made()] }
    }
}

impl Scratch {
    /// Releases everything.
    pub(crate) fn clear(&mut self) {
        self.inputs.clear();
        self.made.iter_mut().for_each(CallOutputs::clear);
    }
}

/// Releases the frames of a list.
///
/// # Safety
/// Each frame that is not empty holds a reference, as [`FrameRef::adopt`] requires.
#[inline]
pub(crate) unsafe fn clear(outputs: &mut [Frame]) {
    for frame in outputs.iter_mut().filter(|f| !f.is_empty()) {
        // SAFETY: the caller's promise; the list no longer has the frame after the `replace`.
        drop(unsafe { FrameRef::adopt(std::mem::replace(frame, Frame::EMPTY)) });
    }
}
