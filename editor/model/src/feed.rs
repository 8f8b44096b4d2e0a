//! Packets of an output, of the run in this process or of a machine elsewhere.

use std::sync::Arc;

use panoscope_engine::memory::FrameRef;
use panoscope_engine::{Engine, Preview};
use panoscope_host::attach::Attachment;

use crate::output::Output;

/// Where the packets of an output come from.
pub(crate) enum Feed {
    Engine(Preview),
    Machine(Arc<Attachment>, Output),
}

/// A packet with what only its feed knows.
pub(crate) struct Fed {
    pub frame: FrameRef,
    /// For points: the confidence of their tick.
    pub confidence: Option<FrameRef>,
    /// From a machine: when its light arrived, and its size before it was thinned, px.
    pub elsewhere: Option<(Option<i64>, (usize, usize))>,
}

impl Feed {
    /// Of an output of a machine, else of the run.
    pub fn of(output: &Output, machine: Option<&Arc<Attachment>>, engine: Option<&Engine>) -> Option<Self> {
        match machine {
            Some(machine) => Some(Self::Machine(Arc::clone(machine), output.clone())),
            None => engine?.preview(&output.node, &output.port).map(Self::Engine),
        }
    }

    /// Keeps the newest packets for pairs.
    pub fn keep(&self, count: usize) {
        if let Self::Engine(preview) = self {
            preview.keep(count);
        }
    }

    /// The newest packets of one tick of two outputs of this run.
    pub fn take_pair(&self, other: &Self) -> Option<[Fed; 2]> {
        let (Self::Engine(preview), Self::Engine(other)) = (self, other) else { return None };
        let (a, b) = preview.take_pair(other)?;
        Some([a, b].map(Fed::of))
    }

    /// The newest packet since the last call.
    pub fn take(&self) -> Option<Fed> {
        match self {
            Self::Engine(preview) => preview.take().map(Fed::of),
            Self::Machine(machine, Output { node, port }) => {
                let (packet, arrived_ns) = machine.take_packet(node, port)?;
                Some(Fed { elsewhere: Some((arrived_ns, packet.size_px)), ..Fed::of(packet.frame) })
            }
        }
    }
}

impl Fed {
    fn of(frame: FrameRef) -> Self {
        Self { frame, confidence: None, elsewhere: None }
    }
}
