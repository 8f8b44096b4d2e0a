//! One group of a host: its process here, its pools, and the lanes of its instances.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::{Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_engine::isolation::Pixels;
use panoscope_engine::sync::lock;
use panoscope_host::isolate::relay::{self, Bytes, Open, RelayError, Request, Served, ServedLane, Settings, kind};
use panoscope_host::isolate::system_ns;
use panoscope_host::loader::sealed::SealedWriter;
use panoscope_host::loader::{Loader, PluginFile, search_path};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;

use crate::error::RemoteError;
use crate::files::{self, Folders};
use crate::h264::{self, Decoders, Encoders};
use crate::mirror::{self, Pool, Pools};
use crate::network;
use crate::sessions::{Delivered, Shared};
use panoscope_host::isolate::relay::messages::{self as message, Message, Turn};

/// Multiple of the timeout after which a silent host counts as lost.
const PATIENCE: u32 = 2;
/// Maximum number of lanes of a group.
const MAX_LANES: usize = 1024;

/// State shared by the threads of a group.
struct Group {
    shared: Arc<Shared>,
    up: Publisher<'static>,
    pools: Pools,
    /// Frames of the group's own pools whose current content the host has.
    at_host: Mutex<HashSet<(u32, u64)>>,
    folders: Mutex<Folders>,
    pixels: Pixels,
    encoders: Mutex<Encoders>,
    decoders: Mutex<Decoders>,
}

/// Serves a group until its host ends it or is lost.
pub(crate) fn run(shared: &Arc<Shared>, host: &str, id: &str, delivered: &Receiver<Delivered>, heard: &AtomicI64) {
    let words = match serve(shared, host, id, delivered, heard) {
        Ok(()) => format!("{host} ended its group"),
        Err(error) => {
            let words = error.to_string();
            let lost = message::write(&Message::Lost { words: words.clone() });
            let _ = shared.session.put(shared.key(host, id, "up"), lost).wait();
            format!("{host}: {words}")
        }
    };
    shared.log(&words);
    shared.end(host, id);
}

fn serve(
    shared: &Arc<Shared>,
    host: &str,
    id: &str,
    delivered: &Receiver<Delivered>,
    heard: &AtomicI64,
) -> Result<(), RemoteError> {
    let Ok(Delivered {
        message: Message::Hello { version, group, threads, memory_bytes, deny, pixels, timeout_ms },
        ..
    }) = delivered.recv()
    else {
        return Ok(());
    };
    let own = crate::version();
    let machine = || shared.options.name.clone();
    if version != own {
        return Err(RemoteError::Version { host: version, own, machine: machine() });
    }
    h264::check(pixels).map_err(|cause| RemoteError::Pixels { cause, machine: machine() })?;
    let settings = Settings { threads: threads.clamp(1, 1024), memory_bytes, deny };
    let process = Served::start(&group, settings)?;
    let up = network::publisher(&shared.session, shared.key(host, id, "up"), false)?;
    let this = Arc::new(Group {
        shared: Arc::clone(shared),
        up,
        pools: Pools::default(),
        at_host: Mutex::default(),
        folders: Mutex::default(),
        pixels,
        encoders: Mutex::default(),
        decoders: Mutex::default(),
    });
    this.put(&Message::Ready, Vec::new())?;
    shared.log(&format!("{host} begins group `{group}`"));
    let patience = Duration::from_millis(timeout_ms.clamp(100, 60_000).into()) * PATIENCE;
    let mut lanes = HashMap::new();
    let ended = this.deliver(&process, delivered, heard, patience, &mut lanes);
    // Threads of lanes wait for the process, or for turns.
    process.kill("its host is gone");
    drop(lanes);
    ended
}

impl Group {
    fn put(&self, message: &Message, frames: Vec<Vec<u8>>) -> Result<(), RemoteError> {
        let mut bytes = ZBytes::writer();
        bytes.append(ZBytes::from(message::write(message)));
        frames.into_iter().for_each(|frame| bytes.append(ZBytes::from(frame)));
        Ok(self.up.put(bytes.finish()).wait()?)
    }

    /// Handles the messages of the host in order.
    fn deliver(
        self: &Arc<Self>,
        process: &Served,
        delivered: &Receiver<Delivered>,
        heard: &AtomicI64,
        patience: Duration,
        lanes: &mut HashMap<u32, Option<Sender<Turn>>>,
    ) -> Result<(), RemoteError> {
        loop {
            let Delivered { message, payload, begin } = match delivered.recv_timeout(patience / 4) {
                Ok(delivered) => delivered,
                // Another session of the host took the place of this one, or the server ends.
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => {
                    let silent_ns = system_ns().saturating_sub(heard.load(Ordering::Relaxed)).max(0);
                    if Duration::from_nanos(silent_ns.unsigned_abs()) > patience {
                        return Err(RemoteError::HostSilent { silence: patience });
                    }
                    continue;
                }
            };
            match message {
                Message::Pool { number, len, is_own } => {
                    let file = mirror::new_file(number, len)?;
                    let len = usize::try_from(len)?;
                    let pool = Pool::map(&file, len, is_own, true)?;
                    process.give_pool(number, &file, len, is_own).map_err(|_| ended(process))?;
                    self.pools.add(number, pool);
                }
                Message::Plugin { id, path, sha256 } => self.plugin(process, id, Path::new(&path), &sha256)?,
                Message::Lane { id } => {
                    if lanes.len() >= MAX_LANES {
                        return Err(RemoteError::TooManyLanes { max: MAX_LANES });
                    }
                    // It begins when its first turn says for which node.
                    lanes.insert(id, None);
                }
                Message::Turn(turn) => {
                    let mut reader = payload.reader();
                    reader.seek(SeekFrom::Start(begin))?;
                    // Here and not in the threads of lanes: a frame that one lane brings is there for the next.
                    let (frames, lane) = (&turn.frames, turn.lane);
                    self.pools.fill(frames, false, &mut reader, lane, &self.decoders)?;
                    let own =
                        turn.frames.iter().filter(|frame| self.pools.get(frame.pool).is_ok_and(|pool| pool.is_own));
                    lock(&self.at_host).extend(own.map(|frame| (frame.pool, frame.offset)));
                    let (id, is_last) = (turn.lane, turn.kind == kind::CLOSE);
                    let Some(lane) = lanes.get_mut(&id) else { continue };
                    if lane.is_none() {
                        *lane = Some(self.begin(process, &turn)?);
                    }
                    // The thread of a lane whose node did not open is gone.
                    if lane.as_ref().is_some_and(|lane| lane.send(turn).is_err()) || is_last {
                        lanes.remove(&id);
                    }
                }
                Message::Bye => return Ok(()),
                Message::Hello { .. } | Message::Ready | Message::Lost { .. } => return Err(message::BadMessage.into()),
            }
        }
    }

    /// Begins the lane of an instance with its first turn.
    fn begin(self: &Arc<Self>, process: &Served, turn: &Turn) -> Result<Sender<Turn>, RemoteError> {
        let open = Open::read(&turn.message)?;
        let lane = process.lane(open.node()).map_err(|_| ended(process))?;
        let (sender, turns) = channel();
        let (mine, id) = (Arc::clone(self), turn.lane);
        let work = move || {
            if let Err(error) = mine.carry(id, &lane, &turns) {
                let _ = mine.put(&Message::Lost { words: error.to_string() }, Vec::new());
            }
        };
        std::thread::Builder::new().spawn(work)?;
        Ok(sender)
    }

    /// Sends the process this machine's file of a plugin, if its bytes equal the host's.
    fn plugin(&self, process: &Served, id: u32, path: &Path, sha256: &str) -> Result<(), RemoteError> {
        let machine = &self.shared.options.name;
        let name = path.file_name().unwrap_or(path.as_os_str());
        let folders = search_path(&self.shared.options.plugins);
        let loader = Loader::search(&folders);
        let found = loader.found().find(|found| found.file.file_name() == Some(name));
        let Some(PluginFile { file, note, .. }) = found else {
            let folders: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
            return Err(RemoteError::PluginMissing {
                path: path.to_owned(),
                sha256: sha256.to_owned(),
                machine: machine.clone(),
                folders: folders.join(", "),
            });
        };
        let unreadable = |cause| RemoteError::PluginUnreadable { file: file.clone(), machine: machine.clone(), cause };
        // The copy is what is compared and what runs.
        let mut copy = SealedWriter::new(file).map_err(unreadable)?;
        let own = copy.append_from(&mut File::open(file).map_err(unreadable)?).map_err(unreadable)?.sha256;
        if own != sha256 {
            return Err(RemoteError::PluginDiffers {
                path: path.into(),
                sha256: sha256.into(),
                own: own.into(),
                machine: machine.as_str().into(),
                file: file.as_path().into(),
            });
        }
        let folder = |file: &Path| -> PathBuf { file.parent().unwrap_or(Path::new("")).join(&note.name) };
        // Files that come with a plugin are in a folder of its name beside it.
        lock(&self.folders).add(&folder(path), &folder(file));
        let image = copy.seal().map_err(unreadable)?;
        // Opened again, so that the position is at its begin and the process cannot move it.
        let image = File::open(panoscope_host::loader::sealed::path_of(&image)).map_err(unreadable)?;
        process.give_plugin(id, &image, file).map_err(|_| ended(process))
    }

    /// Carries the turns of a lane until its instance is closed.
    fn carry(&self, id: u32, lane: &ServedLane, turns: &Receiver<Turn>) -> Result<(), RemoteError> {
        let mut answer = Vec::new();
        // The last request of the host, and the last question of the process, with the frame that it wants a copy of.
        let (mut request, mut asked, mut original) = (0, 0, None);
        while let Ok(turn) = turns.recv() {
            let sent = turn.kind;
            if sent != kind::ANSWER {
                request = sent;
            }
            let message = self.here(turn, asked, original.take()).map_err(|error| match error {
                refused @ RemoteError::Files { .. } => refused,
                bad => of_host(bad),
            })?;
            asked = match lane.exchange(sent, &message, &mut answer) {
                Ok(asked) => asked,
                Err(RelayError::Gone) => return Err(RemoteError::ProcessEnded { reason: lane.death() }),
                Err(RelayError::Bad) => return Err(RemoteError::BadProcess),
            };
            let at_ns = system_ns();
            let mut up = Turn { lane: id, kind: asked, at_ns, ..Turn::default() };
            let mut frames = Vec::new();
            if asked == kind::DONE && request == kind::PROCESS {
                for (slot, output) in (0..).zip(relay::outputs(&answer)?) {
                    if let Some((head, bytes)) = self.new_at_host(&output, (id, slot)).map_err(of_host)? {
                        up.frames.push(head);
                        frames.push(bytes);
                    }
                }
            } else if asked == kind::MAKE_MUT {
                original = Some(relay::made_copy(&answer)?);
            }
            let is_over = asked == kind::DONE
                && (request == kind::CLOSE || (request == kind::OPEN && !relay::succeeded(&answer)?));
            up.message = std::mem::take(&mut answer);
            let up = Message::Turn(up);
            self.put(&up, frames)?;
            if let Message::Turn(turn) = up {
                answer = turn.message;
            }
            if is_over {
                return Ok(());
            }
        }
        Ok(())
    }

    /// A message of the host, translated for the process here.
    fn here(&self, turn: Turn, asked: u32, original: Option<Bytes>) -> Result<Vec<u8>, RemoteError> {
        let mut message = turn.message;
        let path = |path: &str| lock(&self.folders).here(path).display().to_string();
        match turn.kind {
            kind::OPEN => {
                let mut open = Open::read(&message)?;
                lock(&self.folders).add(Path::new(open.graph_dir()), &self.shared.options.graph_dir);
                let folders = lock(&self.folders).clone();
                files::compare(&turn.files, &folders, &self.shared.hashes, &self.shared.options.name)
                    .map_err(|cause| RemoteError::Files { node: open.node().to_owned(), cause: Box::new(cause) })?;
                open.replace_paths(self.shared.options.graph_dir.display().to_string(), path)?;
                open.write(&mut message);
            }
            kind::PROCESS => {
                // The node makes new frames in these.
                let mut request = Request::read(&message)?;
                let mut at_host = lock(&self.at_host);
                request.reserved().for_each(|buffer| _ = at_host.remove(&buffer));
                drop(at_host);
                request.replace_paths(path)?;
                request.write(&mut message);
            }
            kind::ANSWER if asked == kind::ALLOC || asked == kind::MAKE_MUT => {
                if let Some(made) = relay::answered(&message)? {
                    lock(&self.at_host).remove(&(made.pool, made.offset));
                    if let Some(original) = original {
                        // The host copied it there; here the bytes are those that the node sees.
                        let (from, to) = (self.pools.get(original.pool)?, self.pools.get(made.pool)?);
                        from.copy_to(&original, &to, made.offset)?;
                    }
                }
            }
            kind::ANSWER if asked == kind::CLOCK => {
                if let Some(clock) = message.first_chunk_mut::<8>().filter(|_| turn.at_ns != 0) {
                    // It went on meanwhile.
                    let way_ns = system_ns().saturating_sub(turn.at_ns).max(0);
                    *clock = i64::from_le_bytes(*clock).saturating_add(way_ns).to_le_bytes();
                }
            }
            _ => {}
        }
        Ok(message)
    }

    /// The head of an output that the host lacks; the host then counts as having it.
    fn new_at_host(
        &self,
        output: &Bytes,
        stream: (u32, u32),
    ) -> Result<Option<(message::FrameHead, Vec<u8>)>, message::BadMessage> {
        let is_own = self.pools.get(output.pool)?.is_own;
        if !is_own || !lock(&self.at_host).insert((output.pool, output.offset)) {
            return Ok(None);
        }
        self.pools.coded(output, self.pixels, stream, &self.encoders).map(Some)
    }
}

/// The error of a process that has ended, with its reason.
fn ended(process: &Served) -> RemoteError {
    RemoteError::ProcessEnded { reason: process.death() }
}

/// The error of a message of the host.
fn of_host(cause: impl Into<RemoteError>) -> RemoteError {
    RemoteError::BadHost { cause: Box::new(cause.into()) }
}
