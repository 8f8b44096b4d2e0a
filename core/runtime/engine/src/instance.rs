//! An open instance of a node type.

use std::ffi::c_void;

use panoscope_abi as abi;

use crate::busy::CallKind;
use crate::claims::Holds;
use crate::current_node;
use crate::retained::RetainedFrames;

/// An open instance of a node type, closed when dropped.
pub(crate) struct Instance {
    /// May be null: a C plugin without state needs none.
    pub raw: *mut c_void,
    pub node_type: &'static abi::NodeType,
    pub open: bool,
    /// Whether the node used it; an unused instance has nothing to complete.
    pub begun: bool,
    /// Frames that it retains between calls.
    pub retained: RetainedFrames,
    /// Files that it claims.
    pub holds: Box<Holds>,
}

// SAFETY: the contract lets an instance move between threads; it is used by one at a time.
unsafe impl Send for Instance {}

unsafe extern "C" fn collect(sink: *mut c_void, bytes: *const u8, len: usize) {
    // SAFETY: `sink` is the `Vec` that `save_state` passed; `bytes` are lent for the call.
    unsafe {
        if let Some(sink) = sink.cast::<Vec<u8>>().as_mut()
            && len > 0
        {
            sink.extend_from_slice(std::slice::from_raw_parts(bytes, len));
        }
    }
}

impl Instance {
    pub fn none(node_type: &'static abi::NodeType) -> Self {
        let retained = RetainedFrames::new(std::ptr::from_ref(node_type).cast());
        Self { raw: std::ptr::null_mut(), node_type, open: false, begun: false, retained, holds: Box::default() }
    }

    /// Marks the instance as used by its node.
    pub fn begun(mut self) -> Self {
        self.begun = true;
        self
    }

    pub fn is_open(&self) -> bool {
        self.open
    }

    /// Closes now instead of on drop.
    pub fn close(&mut self) {
        let raw = std::mem::replace(&mut self.raw, std::ptr::null_mut());
        let was_open = std::mem::replace(&mut self.open, false);
        if let Some(close) = self.node_type.close.filter(|_| was_open) {
            current_node::with(&self.retained.who(), CallKind::Close, || {
                // SAFETY: opened by `open` and closed once.
                self.retained.during(|| unsafe { close(raw) })
            });
        }
        self.retained.reclaim();
        self.holds.release();
    }

    /// Whether it can save a state for a successor.
    pub fn saves_state(&self) -> bool {
        self.open && self.node_type.save_state.is_some()
    }

    /// Saves the state for a successor; `None` if there is none.
    pub fn save_state(&mut self, host: &abi::Host) -> Option<Vec<u8>> {
        let save = self.node_type.save_state.filter(|_| self.open)?;
        let host = abi::Host { save: Some(collect), ..*host };
        let mut bytes: Vec<u8> = Vec::new();
        let (raw, who) = (self.raw, self.retained.who());
        let status = current_node::with(&who, CallKind::SaveState, || {
            // SAFETY: an open instance that no other thread uses; the sink outlives the call.
            self.retained.during(|| unsafe { save(raw, &raw const host, (&raw mut bytes).cast()) })
        });
        (status == abi::STATUS_OK && !bytes.is_empty()).then_some(bytes)
    }

    /// Loads a predecessor's state; `false` if the node does not understand it.
    pub fn load_state(&mut self, bytes: &[u8]) -> bool {
        let Some(load) = self.node_type.load_state.filter(|_| self.open) else { return false };
        let (raw, who) = (self.raw, self.retained.who());
        current_node::with(&who, CallKind::LoadState, || {
            // SAFETY: an open instance that no other thread uses; the bytes are lent for the call.
            self.retained.during(|| unsafe { load(raw, bytes.as_ptr(), bytes.len()) == abi::STATUS_OK })
        })
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.close();
    }
}
