//! Records the run of a session: every output of every node, so that a recording fills all nodes when it is opened.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_host::loader::graph_file::Ready;
use panoscope_record::{RecordError, RecordOptions, Recorder, head};

/// A recording that is finished.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FinishedRecording {
    /// Its file.
    pub file: PathBuf,
    /// Number of ticks of the sources in it.
    pub ticks: u64,
    /// Why it ended early, if it did.
    pub failed: Option<String>,
}

/// The recorder of a session.
#[derive(Default)]
pub(super) struct RunRecorder {
    /// The file for the next run.
    next: Option<PathBuf>,
    running: Option<(Arc<Recorder>, PathBuf)>,
}

impl RunRecorder {
    /// Sets the file that the next run is recorded to; `None` for no recording.
    pub fn set_file(&mut self, file: Option<PathBuf>) {
        self.next = file;
    }

    /// The file that is being written.
    pub fn file(&self) -> Option<PathBuf> {
        self.running.as_ref().map(|(_, file)| file.clone())
    }

    /// Starts the recording of a run, where one is wanted: the observer for the engine.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn start(&mut self, ready: &Ready) -> Result<Option<Arc<Recorder>>, RecordError> {
        let Some(file) = self.next.take() else { return Ok(None) };
        let options = RecordOptions { file: Some(file.clone()), all_ports: true, ..RecordOptions::default() };
        let recorder = Recorder::start(options, head(ready))?;
        self.running = Some((Arc::clone(&recorder), file));
        Ok(Some(recorder))
    }

    /// Finishes the file, after the engine was closed.
    pub fn finish(&mut self) -> Option<FinishedRecording> {
        let (recorder, file) = self.running.take()?;
        let recorded = recorder.finish();
        Some(FinishedRecording { file, ticks: recorded.ticks, failed: recorded.failed })
    }
}

/// The folder for recordings of a graph: `GRAPH.recordings` beside it, as for its snapshots; for a graph of an installation the folder for its files.
pub fn folder(graph: &Path) -> PathBuf {
    let name = format!("{}.recordings", graph.file_stem().unwrap_or_default().to_string_lossy());
    let beside = graph.parent().unwrap_or(Path::new(""));
    match panoscope_graph::installed::data_dir(beside) {
        Some(_) => panoscope_graph::installed::output_dir().join(name),
        None => beside.join(name),
    }
}
