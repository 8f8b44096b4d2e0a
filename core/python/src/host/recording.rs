//! A recording: its ports and packets.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use panoscope_abi::Frame;
use panoscope_host::loader::{self as loader, Loader};
use panoscope_record::{PortTypes, Recording};
use pyo3::prelude::*;

use super::error::Problem;
use super::watched::{TickParts, Watched};
use crate::view::View;

/// A recording that was scanned. Packets are read on demand.
#[pyclass(frozen, module = "panoscope._native")]
pub struct RecordingFile {
    recording: Arc<Recording>,
    /// The types of its ports, declared by the plugins of its graph.
    types: OnceLock<PortTypes>,
    /// Whether plugins from the folders that its graph names may run here.
    trusts_plugins: bool,
}

impl RecordingFile {
    /// The recording.
    pub fn recording(&self) -> &Arc<Recording> {
        &self.recording
    }

    /// Name of the packet type of a port.
    fn packet_type(&self, port: &str) -> Result<&str, Problem> {
        let types = self.types.get_or_init(|| {
            let own = panoscope_record::own_folders(&self.recording.head);
            let loader = match self.trusts_plugins {
                true => Loader::search(&loader::search_path(&own)),
                false => Loader::search_without_loading(&own),
            };
            PortTypes::new(Arc::clone(&self.recording), loader)
        });
        types.packet(port).map_err(|error| Problem::Recording(error.to_string()))
    }

    /// Outputs of the recorded graph to watch in a replay.
    pub fn watched(&self, watch: &[String]) -> Result<Vec<Watched>, Problem> {
        let watched = |name: &String| {
            let (node, output) =
                name.rsplit_once('.').ok_or_else(|| Problem::Use(format!("`{name}` is not NODE.OUTPUT")))?;
            let packet = self.packet_type(name)?.to_owned();
            Ok(Watched { node: node.to_owned(), output: output.to_owned(), packet })
        };
        watch.iter().map(watched).collect()
    }
}

#[pymethods]
impl RecordingFile {
    /// Opens a recording.
    #[new]
    fn open(py: Python<'_>, path: PathBuf, trusts_plugins: bool) -> PyResult<Self> {
        let open = || Recording::open(&path).map_err(Problem::from);
        let recording = py.detach(open).map_err(|problem| problem.raise(py))?;
        Ok(Self { recording: Arc::new(recording), types: OnceLock::new(), trusts_plugins })
    }

    /// The recorded ports and their numbers of packets.
    fn ports(&self) -> Vec<(String, usize)> {
        self.recording.ports.iter().map(|(port, packets)| (port.clone(), packets.len())).collect()
    }

    /// Name of the packet type of a port.
    fn packet(&self, py: Python<'_>, port: &str) -> PyResult<String> {
        py.detach(|| self.packet_type(port).map(str::to_owned)).map_err(|problem| problem.raise(py))
    }

    /// A packet: view, (source, number, capture time in ns). None if there is no such packet.
    fn read(&self, py: Python<'_>, port: &str, index: usize) -> PyResult<Option<(View, TickParts)>> {
        let Some(packet) = self.recording.ports.get(port).and_then(|packets| packets.get(index)) else {
            return Ok(None);
        };
        let bytes = py.detach(|| self.recording.bytes(port, packet).map_err(Problem::from));
        let bytes = bytes.map_err(|problem| problem.raise(py))?;
        let head = packet.head;
        let (format, width, height, stride_bytes) = (head.format, head.width, head.height, head.stride_bytes);
        let frame = Frame { format, width, height, stride_bytes, ..Frame::EMPTY };
        Ok(Some((View::own(&frame, bytes), (head.tick.source, head.tick.seq, head.tick.capture_ns))))
    }

    /// The graph that was recorded: its file, its text.
    fn graph(&self) -> (String, String) {
        (self.recording.head.graph_path.clone(), self.recording.head.text.clone())
    }

    /// Reason for an early end of the recording; None if it is complete.
    fn cut(&self) -> Option<String> {
        self.recording.cut.as_ref().map(|cut| format!("it ends at byte {}: {}", cut.at, cut.reason))
    }
}
