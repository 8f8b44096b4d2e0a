//! Where the packets of previews come from: this run, or that of another machine.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use panoscope_abi::Tick;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::{Engine, Preview};
use panoscope_host::attach::message::Wanted;
use panoscope_host::attach::{Attachment, Packet};

use super::{ComparisonRequest, Output, PreviewRequest};

/// Where the packets of an output come from.
pub(super) enum Feed {
    Engine(Preview),
    Machine(Arc<Attachment>, Output),
}

/// A packet with what only its feed knows.
pub(super) struct Fed {
    pub frame: FrameRef,
    /// For points: the confidence of their tick.
    pub confidence: Option<FrameRef>,
    /// From a machine: when its light arrived, and its size before it was thinned, px.
    pub elsewhere: Option<(Option<i64>, (usize, usize))>,
}

impl From<(Packet, Option<i64>)> for Fed {
    fn from((packet, arrived_ns): (Packet, Option<i64>)) -> Self {
        Self { elsewhere: Some((arrived_ns, packet.size_px)), ..packet.frame.into() }
    }
}

impl From<FrameRef> for Fed {
    fn from(frame: FrameRef) -> Self {
        Self { frame, confidence: None, elsewhere: None }
    }
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

    /// The newest packets of one tick of two outputs.
    pub fn take_pair(&self, other: &Self) -> Option<[Fed; 2]> {
        match (self, other) {
            (Self::Engine(preview), Self::Engine(other)) => {
                let (a, b) = preview.take_pair(other)?;
                Some([a, b].map(Fed::from))
            }
            (Self::Machine(machine, a), Self::Machine(_, b)) => {
                Some(machine.take_pair([a, b].map(|output| (&*output.node, &*output.port)))?.map(Fed::from))
            }
            _ => None,
        }
    }

    /// The kept packet of a tick; none from a machine, which sends pairs.
    pub fn take_tick(&self, tick: Tick) -> Option<FrameRef> {
        match self {
            Self::Engine(preview) => preview.take_tick(tick),
            Self::Machine(..) => None,
        }
    }

    /// The newest packet since the last call.
    pub fn take(&self) -> Option<Fed> {
        match self {
            Self::Engine(preview) => preview.take().map(Fed::from),
            Self::Machine(machine, Output { node, port }) => machine.take_packet(node, port).map(Fed::from),
        }
    }
}

/// Group of two outputs that are compared.
const COMPARED: u32 = 1;
/// Group of the eyes of a stereo pair.
const EYES: u32 = 2;
/// First group of points with their confidence.
const MEASURED: u32 = 3;

/// What a machine is to send for previews, with packets of one tick for outputs that are compared, shown or measured together.
pub(super) fn wanted(requests: &HashMap<Output, PreviewRequest>, compared: Option<&ComparisonRequest>) -> Vec<Wanted> {
    // In an order of their own, so that groups keep their numbers.
    let requests: BTreeMap<_, _> = requests.iter().collect();
    let mut all: BTreeMap<&Output, Wanted> = BTreeMap::new();
    for ((&output, request), own) in requests.iter().zip(MEASURED..) {
        let group = match (compared.is_some_and(|pair| pair.is_of(output)), &request.pair, &request.confidence) {
            (true, ..) => COMPARED,
            (_, Some(_), _) => EYES,
            (_, _, Some(_)) => own,
            _ => 0,
        };
        let max_width = u32::try_from(request.max_width).unwrap_or(u32::MAX);
        // A surface and points need all of a cloud.
        let max_width = if request.viewpoint.is_some() || request.points { u32::MAX } else { max_width };
        let confidence = request.confidence.as_ref().filter(|_| group == own);
        for (output, max_width) in [(output, max_width)].into_iter().chain(confidence.map(|map| (map, u32::MAX))) {
            let (node, port) = (output.node.clone(), output.port.clone());
            let one = all.entry(output).or_insert(Wanted { node, port, max_width, group });
            // A map that is shown too comes once.
            (one.max_width, one.group) = (one.max_width.max(max_width), one.group.max(group));
        }
    }
    all.into_values().collect()
}
