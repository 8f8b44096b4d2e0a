//! The file of a recording as it is written.

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use crate::check;
use crate::digest::padded_hash;
use crate::format::{EVENTS, Event, PACKET_ENCODING, PacketHead};
use panoscope_engine::memory::FrameRef;

/// Where a recording goes.
pub trait Output: Write + Seek + Send {
    /// Cuts the output off.
    fn cut(&mut self, len: u64) -> io::Result<()>;

    /// Hands everything to the disk, where there is one.
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Output for File {
    fn cut(&mut self, len: u64) -> io::Result<()> {
        self.set_len(len)
    }

    fn sync(&mut self) -> io::Result<()> {
        match self.sync_all() {
            // Pipes and devices have nothing to hand over.
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            done => done,
        }
    }
}

impl Output for io::Cursor<Vec<u8>> {
    fn cut(&mut self, len: u64) -> io::Result<()> {
        self.get_mut().truncate(usize::try_from(len).unwrap_or(usize::MAX));
        Ok(())
    }
}

/// Counts what has been written, for whoever cannot ask the MCAP writer.
struct Counted {
    output: BufWriter<Box<dyn Output>>,
    written: Arc<AtomicU64>,
}

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.output.write(bytes)?;
        self.written.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.output.flush()
    }
}

impl Seek for Counted {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.output.seek(to)
    }
}

/// A recording under way.
pub(crate) struct RecordFile {
    writer: Writer<Counted>,
    written: Arc<AtomicU64>,
    events: u16,
    channels: HashMap<String, (u16, u32)>,
    event_count: u32,
    buffer: Vec<u8>,
    /// Length up to the last whole message.
    whole: u64,
    /// Source ticks that have left for the system, and where each of the later ones ends.
    ticks: u64,
    pending_ticks: VecDeque<u64>,
}

fn io_error(error: mcap::McapError) -> io::Error {
    match error {
        mcap::McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

impl RecordFile {
    pub fn create(output: Box<dyn Output>) -> io::Result<Self> {
        let written = Arc::new(AtomicU64::new(0));
        let counted = Counted { output: BufWriter::with_capacity(1 << 20, output), written: Arc::clone(&written) };
        let options = WriteOptions::new()
            .compression(None)
            .use_chunks(false)
            .disable_seeking(true)
            .calculate_data_section_crc(false)
            .profile("panoscope")
            .library(concat!("panoscope ", env!("CARGO_PKG_VERSION")));
        let mut writer = options.create(counted).map_err(io_error)?;
        let events = writer.add_channel(0, EVENTS, "json", &Default::default()).map_err(io_error)?;
        let mut this = Self {
            writer,
            written,
            events,
            channels: HashMap::new(),
            event_count: 0,
            buffer: Vec::new(),
            whole: 0,
            ticks: 0,
            pending_ticks: VecDeque::new(),
        };
        this.flush()?;
        Ok(this)
    }

    fn message(&mut self, header: &MessageHeader) -> io::Result<()> {
        self.writer.write_to_known_channel(header, &self.buffer).map_err(io_error)?;
        self.whole = self.written.load(Ordering::Relaxed);
        Ok(())
    }

    pub fn event(&mut self, event: &Event) -> io::Result<()> {
        self.buffer.clear();
        serde_json::to_writer(&mut self.buffer, event)?;
        self.event_count += 1;
        let now = unix_ns();
        let header =
            MessageHeader { channel_id: self.events, sequence: self.event_count, log_time: now, publish_time: now };
        check::seal(EVENTS, &check::head_bytes(&header), &mut self.buffer);
        self.message(&header)?;
        if matches!(event, Event::Tick { gap: false, .. }) {
            self.pending_ticks.push_back(self.whole);
        }
        Ok(())
    }

    pub fn packet(&mut self, port: &str, frame: &FrameRef, hash: u64) -> io::Result<()> {
        let (channel, sequence) = match self.channels.get_mut(port) {
            Some((channel, sequence)) => {
                *sequence = sequence.wrapping_add(1);
                (*channel, *sequence)
            }
            None => {
                let channel =
                    self.writer.add_channel(0, port, PACKET_ENCODING, &Default::default()).map_err(io_error)?;
                self.channels.insert(port.to_owned(), (channel, 0));
                (channel, 0)
            }
        };
        self.buffer.clear();
        let publish_time = u64::try_from(frame.tick().capture_ns).unwrap_or(0);
        let header = MessageHeader { channel_id: channel, sequence, log_time: unix_ns(), publish_time };
        PacketHead::of(frame.frame(), hash, padded_hash(frame.frame(), frame.bytes())).write(&mut self.buffer);
        let sum = check::sum(port, &check::head_bytes(&header), &self.buffer);
        self.buffer.extend_from_slice(&sum.to_le_bytes());
        self.buffer.extend_from_slice(frame.bytes());
        self.message(&header)
    }

    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(io_error)?;
        self.ticks += self.pending_ticks.drain(..).count() as u64;
        Ok(())
    }

    /// Source ticks that have left for the system.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Writes the summary and hands the file to the disk; answers its length.
    pub fn finish(mut self) -> io::Result<u64> {
        self.writer.finish().map_err(io_error)?;
        let mut output = self.writer.into_inner().output;
        output.flush()?;
        output.get_mut().sync()?;
        Ok(self.written.load(Ordering::Relaxed))
    }

    /// After an error nothing more is written; what is torn is cut off. Answers how long the file is, and the source ticks in it.
    pub fn give_up(self) -> (u64, u64) {
        let (mut output, _) = self.writer.into_inner().output.into_parts();
        let len = match output.seek(SeekFrom::End(0)) {
            Ok(len) if len > self.whole => output.cut(self.whole).map_or(len, |()| self.whole),
            Ok(len) => len,
            Err(_) => 0,
        };
        // The first error is the one to tell.
        let _ = output.sync();
        let more = self.pending_ticks.iter().filter(|end| **end <= len).count() as u64;
        (len, self.ticks + more)
    }
}

fn unix_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
