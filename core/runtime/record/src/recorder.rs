//! Records the events and packets of an engine without blocking it.
//!
//! The engine's threads only append to a queue; one thread hashes and writes. Events are never lost. Queued packets
//! occupy frame memory: when the queue is full, the packets of a tick are skipped and a gap is recorded in their place.
//! A disk that stalls until hundreds of thousands of items wait ends the recording, not the run.

use std::collections::{HashMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_abi::{Frame, Tick};
use panoscope_engine::files::{self, OutputLock, OutputLocked};
use panoscope_engine::observe::{self, Observer, ReportFn};
use panoscope_engine::panic_words;
use panoscope_engine::sync::lock;

use crate::digest::{Digests, PacketDigest, digest_of};
use crate::file::RecordFile;
use crate::format::{Event, Head};
use crate::mcap_file::Output;
use panoscope_engine::memory::FrameRef;

/// Packets are compressed while at most this many bytes of frames wait.
const SHORT_QUEUE_BYTES: usize = 64 << 20;

/// Events and packets that may wait for the disk: some minutes of a stall, below 100 MB.
const MAX_QUEUED_ITEMS: usize = 1 << 18;

/// Settings of a recording.
pub struct RecordOptions {
    /// The recording; `None` for fingerprints only.
    pub file: Option<PathBuf>,
    /// Whether to compute fingerprints of all ports.
    pub digests: bool,
    /// Whether to record all ports of all nodes, not only those of sources.
    pub all_ports: bool,
    /// Whether sources make all their outputs, also those without a reader, so that other graphs can be replayed on the
    /// recording.
    pub all_source_ports: bool,
    /// Whether nodes make all their outputs, also those without a reader, because the run that is replayed did.
    pub all_outputs: bool,
    /// Whether packets are compressed while the disk keeps up, and equal packets stored once.
    pub compresses: bool,
    /// Maximum number of bytes of frames in the queue to the disk.
    pub max_queued_bytes: usize,
}

impl Default for RecordOptions {
    fn default() -> Self {
        Self {
            file: None,
            digests: false,
            all_ports: false,
            all_source_ports: true,
            all_outputs: false,
            compresses: true,
            max_queued_bytes: 512 << 20,
        }
    }
}

/// A recording that could not be started.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The operating system refused.
    #[error("cannot write {}: {cause}", .file.display())]
    Unwritable {
        /// The recording.
        file: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// Another run writes it.
    #[error(transparent)]
    Locked(#[from] OutputLocked),
}

/// Reason for the end of a recording whose disk stalls.
const STALLED: &str = "the disk has stalled, and more events wait than memory may hold";

/// The result of a recording.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    /// Number of bytes written.
    pub bytes: u64,
    /// Number of source ticks written.
    pub ticks: u64,
    /// Number of source ticks skipped because the disk was too slow.
    pub gaps: u64,
    /// Reason why writing stopped before the end of the run; `None` if it did not.
    pub failed: Option<String>,
    /// Fingerprints, if the options ask for them.
    pub digests: Option<Digests>,
}

enum Item {
    Event(Event),
    /// An event of the engine; files that it names are hashed when it is written.
    Observed(observe::Event),
    /// `node.port`, packet, and whether the packet is written to the file.
    Packet(Arc<str>, FrameRef, bool),
    /// `node.port` and fingerprint of a packet that did not fit in the queue.
    Digest(Arc<str>, PacketDigest),
}

#[derive(Default)]
struct Queue {
    items: VecDeque<Item>,
    bytes: usize,
    ended: bool,
}

struct Inner {
    queue: Mutex<Queue>,
    wake: Condvar,
    options: RecordOptions,
    /// Number of admitted ticks, by head of region.
    admitted: Mutex<HashMap<String, u64>>,
    /// Outputs of the newest instance of each node.
    ports: Mutex<HashMap<String, Ports>>,
    gaps: AtomicU64,
    writes: AtomicBool,
    /// Maximum number of events and packets in the queue.
    max_queued_items: usize,
    /// Whether the disk stalled for so long that the queue was discarded.
    has_stalled: AtomicBool,
    report: OnceLock<Box<ReportFn>>,
    /// Messages before `report` was set.
    unreported: Mutex<Vec<String>>,
}

/// The outputs of one instance of a node; a later node of this name may have another type with other outputs.
#[derive(Clone)]
struct Ports {
    names: Arc<[String]>,
    /// `node.port` of each.
    topics: Arc<[Arc<str>]>,
}

/// Records a run of an engine; pass it as [`panoscope_engine::Options::observer`].
pub struct Recorder {
    inner: Arc<Inner>,
    thread: Mutex<Option<JoinHandle<Recorded>>>,
}

impl Recorder {
    /// Starts a recording with its head.
    pub fn start(options: RecordOptions, head: Head) -> Result<Arc<Self>, RecordError> {
        let created = options.file.as_deref().map(create).transpose()?;
        let (output, output_lock) =
            created.map_or((None, None), |(file, lock)| (Some(Box::new(file) as Box<dyn Output>), lock));
        Self::start_locked(output, output_lock, options, head)
    }

    /// As [`Self::start`], writing to any output.
    pub fn start_on(
        output: Option<Box<dyn Output>>,
        options: RecordOptions,
        head: Head,
    ) -> Result<Arc<Self>, RecordError> {
        Self::start_locked(output, None, options, head)
    }

    fn start_locked(
        output: Option<Box<dyn Output>>,
        output_lock: Option<OutputLock>,
        options: RecordOptions,
        head: Head,
    ) -> Result<Arc<Self>, RecordError> {
        let error = |cause| RecordError::Unwritable { file: options.file.clone().unwrap_or_default(), cause };
        let file = output.map(RecordFile::create).transpose().map_err(error)?;
        let graph = head.graph.name.clone();
        let head = Head { all_ports: options.all_ports, ..head };
        let inner = Arc::new(Inner {
            queue: Mutex::default(),
            wake: Condvar::new(),
            admitted: Mutex::default(),
            ports: Mutex::default(),
            gaps: AtomicU64::new(0),
            writes: AtomicBool::new(file.is_some()),
            // Only a replay has no limit: it loses nothing.
            max_queued_items: if options.max_queued_bytes == usize::MAX { usize::MAX } else { MAX_QUEUED_ITEMS },
            has_stalled: AtomicBool::new(false),
            report: OnceLock::new(),
            unreported: Mutex::default(),
            options,
        });
        let mine = Arc::clone(&inner);
        let work = move || {
            // Released when everything is written.
            let _output_lock = output_lock;
            let recorded = catch_unwind(AssertUnwindSafe(|| mine.work(file, graph)));
            recorded.unwrap_or_else(|payload| {
                // From here on nothing is queued, because nothing would empty the queue.
                mine.writes.store(false, Ordering::Relaxed);
                let message = format!("thread `record` panicked, the recording ends here: {}", panic_words(&*payload));
                mine.report(&message);
                while let Some(items) = mine.next() {
                    drop(items);
                    lock(&mine.queue).bytes = 0;
                }
                Recorded { failed: Some(message), ..Recorded::default() }
            })
        };
        let thread = std::thread::Builder::new().name("record".to_owned()).spawn(work);
        let file = || inner.options.file.clone().unwrap_or_default();
        let thread = thread.map_err(|cause| RecordError::Unwritable { file: file(), cause })?;
        let this = Arc::new(Self { inner, thread: Mutex::new(Some(thread)) });
        this.push(Event::Head(Box::new(head)));
        Ok(this)
    }

    /// Waits until everything is written. The engine must be closed before.
    pub fn finish(&self) -> Recorded {
        self.push(Event::End { gaps: self.inner.gaps.load(Ordering::Relaxed) });
        lock(&self.inner.queue).ended = true;
        self.inner.wake.notify_all();
        let thread = lock(&self.thread).take();
        let failed = || Recorded { failed: Some("the recording thread failed".to_owned()), ..Recorded::default() };
        thread.map_or_else(Recorded::default, |t| t.join().unwrap_or_else(|_| failed()))
    }

    /// Queues an event.
    fn push(&self, event: Event) {
        if self.inner.writes.load(Ordering::Relaxed) {
            self.append([Item::Event(event)]);
        }
    }

    fn append(&self, items: impl IntoIterator<Item = Item>) {
        let inner = &self.inner;
        let mut queue = lock(&inner.queue);
        for item in items {
            if let Item::Packet(_, frame, _) = &item {
                queue.bytes += frame.bytes().len();
            }
            queue.items.push_back(item);
        }
        if queue.items.len() <= inner.max_queued_items {
            drop(queue);
            return inner.wake.notify_one();
        }
        // Dropped without the lock: frames go back to the engine's memory.
        let lost = std::mem::take(&mut queue.items);
        queue.bytes = 0;
        drop(queue);
        drop(lost);
        inner.has_stalled.store(true, Ordering::Relaxed);
        if inner.writes.swap(false, Ordering::Relaxed) {
            inner.report(&format!("{STALLED}; the recording ends here, the run goes on"));
        }
    }

    fn ports(&self, node: &str, names: &Arc<[String]>) -> Ports {
        let mut ports = lock(&self.inner.ports);
        // A node of another type may have the same name now.
        if let Some(known) = ports.get(node).filter(|p| Arc::ptr_eq(&p.names, names)) {
            return known.clone();
        }
        let topics = names.iter().map(|name| format!("{node}.{name}").into()).collect();
        let new = Ports { names: Arc::clone(names), topics };
        ports.insert(node.to_owned(), new.clone());
        new
    }

    fn queue(&self, name: &str, ports: &Arc<[String]>, outputs: &[Frame], stored: bool, tick: Option<&Tick>) {
        let inner = &self.inner;
        let Ports { topics, .. } = self.ports(name, ports);
        let full = |queue: &Queue| queue.bytes >= inner.options.max_queued_bytes;
        let gap = stored && full(&lock(&inner.queue));
        let mut packets = 0;
        let mut items = Vec::with_capacity(outputs.len() + 1);
        for (topic, frame) in topics.iter().zip(outputs).filter(|(_, f)| !f.is_empty()) {
            // SAFETY: the engine holds a reference to the frame during this call; `ManuallyDrop` never releases it.
            let borrowed = std::mem::ManuallyDrop::new(unsafe { FrameRef::adopt(*frame) });
            packets += 1;
            if gap {
                if inner.options.digests {
                    items.push(Item::Digest(Arc::clone(topic), digest_of(&borrowed)));
                }
            } else {
                items.push(Item::Packet(Arc::clone(topic), FrameRef::clone(&borrowed), stored));
            }
        }
        if let Some(tick) = tick {
            let (seq, capture_ns) = (tick.seq, tick.capture_ns);
            items.push(Item::Event(Event::Tick { node: name.to_owned(), seq, capture_ns, packets, gap }));
            if gap && inner.gaps.fetch_add(1, Ordering::Relaxed).is_multiple_of(100) {
                inner.report(&format!("the disk is too slow: tick {seq} of `{name}` is not in the recording"));
            }
        }
        self.append(items);
    }
}

impl Observer for Recorder {
    fn wants_all_source_outputs(&self) -> bool {
        self.inner.options.all_source_ports && self.inner.options.file.is_some()
    }

    fn wants_all_outputs(&self) -> bool {
        let options = &self.inner.options;
        options.all_outputs || options.all_ports && options.file.is_some()
    }

    fn event(&self, event: observe::Event) {
        if self.inner.writes.load(Ordering::Relaxed) {
            self.append([Item::Observed(event)]);
        }
    }

    fn admitted(&self, head: &str) {
        let mut admitted = lock(&self.inner.admitted);
        match admitted.get_mut(head) {
            Some(count) => *count += 1,
            None => {
                admitted.insert(head.to_owned(), 1);
            }
        }
    }

    fn admitted_by(&self, head: &str) -> u64 {
        lock(&self.inner.admitted).get(head).copied().unwrap_or(0)
    }

    fn outputs(&self, node: &str, ports: &Arc<[String]>, outputs: &[Frame]) {
        let options = &self.inner.options;
        if options.digests || options.all_ports {
            let stored = options.all_ports && self.inner.writes.load(Ordering::Relaxed);
            self.queue(node, ports, outputs, stored, None);
        }
    }

    fn source_tick(&self, node: &str, ports: &Arc<[String]>, tick: &Tick, outputs: &[Frame]) {
        let stored = self.inner.writes.load(Ordering::Relaxed);
        self.queue(node, ports, outputs, stored, Some(tick));
    }

    fn report_to(&self, report: Box<ReportFn>) {
        let mut unreported = lock(&self.inner.unreported);
        let _ = self.inner.report.set(report);
        let earlier = std::mem::take(&mut *unreported);
        drop(unreported);
        earlier.iter().for_each(|message| self.inner.report(message));
    }

    /// Writes everything in the queue, but no [`Event::End`].
    fn break_off(&self, until: Instant) -> bool {
        lock(&self.inner.queue).ended = true;
        self.inner.wake.notify_all();
        let done = || lock(&self.thread).as_ref().is_none_or(JoinHandle::is_finished);
        while !done() {
            if Instant::now() >= until {
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        true
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.finish();
    }
}

fn create(path: &Path) -> Result<(std::fs::File, Option<OutputLock>), RecordError> {
    let error = |cause| RecordError::Unwritable { file: path.to_owned(), cause };
    files::create_folders(path).map_err(error)?;
    let lock = OutputLock::take(path, files::LOCK_PATIENCE)?;
    Ok((files::create(path).map_err(error)?, lock))
}

impl Inner {
    /// Reports a message to the engine; stores it until the engine has set `report`.
    fn report(&self, message: &str) {
        if self.report.get().is_none() {
            let mut unreported = lock(&self.unreported);
            // Checked again, because `report_to` sets it under this lock.
            if self.report.get().is_none() {
                return unreported.push(message.to_owned());
            }
        }
        if let Some(report) = self.report.get() {
            report(message);
        }
    }

    fn next(&self) -> Option<VecDeque<Item>> {
        let mut queue = lock(&self.queue);
        loop {
            if !queue.items.is_empty() {
                return Some(std::mem::take(&mut queue.items));
            }
            if queue.ended {
                return None;
            }
            queue = self.wake.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn work(&self, mut file: Option<RecordFile>, graph: String) -> Recorded {
        let mut recorded = Recorded::default();
        let mut digests = self.options.digests.then(|| Digests { graph, ..Digests::default() });
        while let Some(items) = self.next() {
            for item in items {
                let wrote = self.write(item, &mut file, &mut digests);
                if let Err(cause) = wrote {
                    self.give_up(&mut file, &cause, &mut recorded);
                }
            }
            if let Some(Err(cause)) = file.as_mut().map(RecordFile::flush) {
                self.give_up(&mut file, &cause, &mut recorded);
            }
            if self.has_stalled.load(Ordering::Relaxed) {
                self.give_up(&mut file, &std::io::Error::other(STALLED), &mut recorded);
            }
        }
        if let Some(file) = file {
            recorded.ticks = file.ticks();
            match file.finish() {
                Ok(bytes) => recorded.bytes = bytes,
                Err(cause) => recorded.failed = Some(format!("the recording could not be finished: {cause}")),
            }
        }
        recorded.gaps = self.gaps.load(Ordering::Relaxed);
        if let Some(digests) = &mut digests {
            digests.finish();
        }
        recorded.digests = digests;
        recorded
    }

    /// Whether there is time to compress; a long queue is written uncompressed, before packets have to be dropped.
    fn compresses(&self) -> bool {
        self.options.compresses && lock(&self.queue).bytes <= SHORT_QUEUE_BYTES.min(self.options.max_queued_bytes / 8)
    }

    /// Ends the recording after an error of the disk; the run continues without it.
    fn give_up(&self, file: &mut Option<RecordFile>, cause: &std::io::Error, recorded: &mut Recorded) {
        let Some(file) = file.take() else { return };
        let is_news = self.writes.swap(false, Ordering::Relaxed);
        (recorded.bytes, recorded.ticks) = file.give_up();
        let message = format!("the recording ends here, the run goes on: {cause}");
        if is_news {
            self.report(&message);
        }
        recorded.failed = Some(message);
    }

    fn write(&self, item: Item, file: &mut Option<RecordFile>, digests: &mut Option<Digests>) -> std::io::Result<()> {
        match item {
            Item::Event(event) => {
                if let Some(file) = file {
                    file.event(&event)?;
                }
            }
            Item::Observed(event) => {
                if let Some(file) = file {
                    file.event(&event.into())?;
                }
            }
            Item::Digest(topic, digest) => {
                if let Some(digests) = digests {
                    digests.add(&topic, digest);
                }
            }
            Item::Packet(topic, frame, stored) => {
                let digest = digest_of(&frame);
                if let Some(digests) = digests {
                    digests.add(&topic, digest);
                }
                let wrote = match file.as_mut().filter(|_| stored) {
                    Some(file) => file.packet(&topic, &frame, digest.hash, self.compresses()),
                    None => Ok(()),
                };
                let mut queue = lock(&self.queue);
                queue.bytes = queue.bytes.saturating_sub(frame.bytes().len());
                drop(queue);
                wrote?;
            }
        }
        Ok(())
    }
}
