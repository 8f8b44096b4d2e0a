//! Opening with a time limit. GStreamer may block forever on a disk, a driver or a network. The call therefore runs on a separate thread, which is
//! abandoned when it does not return in time.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use super::error::CaptureError;
use super::name::SourceName;

/// Number of calls that have not returned yet, by the source's name.
static RUNNING: Mutex<BTreeMap<String, usize>> = Mutex::new(BTreeMap::new());
/// Maximum number of hanging calls per source; each abandoned call holds a thread.
const MAX_RUNNING: usize = 3;

/// A pending call that opens a source.
pub struct Opening<T> {
    name: SourceName,
    /// Host time of the first [`Self::poll`], ns.
    since_ns: Option<i64>,
    limit: Duration,
    result: Receiver<Result<T, CaptureError>>,
}

fn running<R>(change: impl FnOnce(&mut BTreeMap<String, usize>) -> R) -> R {
    change(&mut RUNNING.lock().unwrap_or_else(PoisonError::into_inner))
}

impl<T: Send + 'static> Opening<T> {
    /// Starts opening `name` by `open` with the time limit `limit`.
    ///
    /// # Errors
    /// [`CaptureError::Closed`] when too many earlier calls for the same source have not returned, or no thread can be started.
    pub fn start(
        name: &SourceName,
        limit: Duration,
        open: impl FnOnce() -> Result<T, CaptureError> + Send + 'static,
    ) -> Result<Self, CaptureError> {
        let key = name.in_words();
        let closed = |reason: String| CaptureError::Closed { name: key.clone(), reason };
        let is_free = running(|running| {
            let count = running.entry(key.clone()).or_default();
            let is_free = *count < MAX_RUNNING;
            *count += usize::from(is_free);
            is_free
        });
        if !is_free {
            return Err(closed(format!("{MAX_RUNNING} earlier attempts have not returned yet")));
        }
        let (sender, result) = channel();
        let key_of_task = key.clone();
        let started = std::thread::Builder::new().name("open source".to_owned()).spawn(move || {
            let opened = open();
            returned(&key_of_task);
            // After the limit nobody receives it: the source closes again here.
            let _ = sender.send(opened);
        });
        if let Err(error) = started {
            returned(&key);
            return Err(closed(format!("no thread can be started: {error}")));
        }
        Ok(Self { name: name.clone(), since_ns: None, limit, result })
    }

    /// Blocks until the call returns or the time limit passes.
    ///
    /// # Errors
    /// Why the source does not open.
    pub fn wait(self) -> Result<T, CaptureError> {
        match self.result.recv_timeout(self.limit) {
            Ok(opened) => opened,
            Err(RecvTimeoutError::Timeout) => Err(too_late(&self.name, self.limit)),
            Err(RecvTimeoutError::Disconnected) => Err(self.broken()),
        }
    }

    /// The result of the call or of the time limit, once there is one. The limit counts from the first poll.
    pub fn poll(&mut self, now_ns: i64) -> Option<Result<T, CaptureError>> {
        let passed_ns = now_ns.saturating_sub(*self.since_ns.get_or_insert(now_ns));
        let is_in_time = passed_ns < i64::try_from(self.limit.as_nanos()).unwrap_or(i64::MAX);
        match self.result.try_recv() {
            Ok(opened) => Some(opened),
            Err(TryRecvError::Empty) if is_in_time => None,
            Err(TryRecvError::Empty) => Some(Err(too_late(&self.name, self.limit))),
            Err(TryRecvError::Disconnected) => Some(Err(self.broken())),
        }
    }

    fn broken(&self) -> CaptureError {
        CaptureError::Closed { name: self.name.in_words(), reason: "the call that opens it panicked".to_owned() }
    }
}

/// The error of a source that does not answer within `limit`.
pub fn too_late(name: &SourceName, limit: Duration) -> CaptureError {
    let seconds = limit.as_secs_f64();
    let hint = match name {
        SourceName::Address(_) => {
            "check that the address is correct and the sender is running; `open_limit_s` sets the time limit".to_owned()
        }
        SourceName::Pipeline(text) => format!(
            "one of its elements ({}) waits for data, a device or an address; try it with gst-launch-1.0, or set `open_limit_s`",
            super::elements::names(text).join(", ")
        ),
        SourceName::Device(_) => "the driver does not answer; unplug and reconnect the camera".to_owned(),
        _ => "check that it is a file on a disk that responds".to_owned(),
    };
    CaptureError::Closed { name: name.in_words(), reason: format!("no answer within {seconds} s: {hint}") }
}

fn returned(key: &str) {
    running(|running| {
        if let Some(count) = running.get_mut(key) {
            *count -= 1;
            if *count == 0 {
                running.remove(key);
            }
        }
    });
}
