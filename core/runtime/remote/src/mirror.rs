//! Frame pools mapped at both ends of a connection.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read};
use std::os::fd::{AsRawFd, FromRawFd};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use panoscope_engine::isolation::Pixels;
use panoscope_engine::memory::MAX_POOLS;
use panoscope_engine::sync::lock;
use panoscope_host::isolate::relay::Bytes;

use crate::h264::{Decoders, Encoders};
use panoscope_host::isolate::relay::messages::{BadMessage, Coding, FrameHead};

/// Maximum wait for a pool that the host has already sent.
const MAX_WAIT: Duration = Duration::from_secs(1);
/// Maximum size of a pool, bytes.
const MAX_POOL_BYTES: u64 = 8 << 30;
/// Minimum length of a compressed frame, bytes.
const MIN_COMPRESSED_BYTES: u64 = 4096;

/// A mapped pool.
pub struct Pool {
    base: *mut u8,
    len: usize,
    /// Whether the group writes it.
    pub is_own: bool,
}

// SAFETY: a mapping that stays until this is dropped. Frames in it have one writer at a time, see `Pool::copy`.
unsafe impl Send for Pool {}
// SAFETY: a mapping that stays until this is dropped. Frames in it have one writer at a time, see `Pool::copy`.
unsafe impl Sync for Pool {}

impl Pool {
    /// Maps the file of a pool; `is_written` for a pool that this process writes.
    pub fn map(file: &File, len: usize, is_own: bool, is_written: bool) -> io::Result<Self> {
        let protection = if is_written { libc::PROT_READ | libc::PROT_WRITE } else { libc::PROT_READ };
        let flags = libc::MAP_SHARED | libc::MAP_NORESERVE;
        // SAFETY: a fresh mapping at an address that the system chooses, of a file whose size is sealed.
        let base = unsafe { libc::mmap(std::ptr::null_mut(), len, protection, flags, file.as_raw_fd(), 0) };
        if base == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        Ok(Self { base: base.cast(), len, is_own })
    }

    fn at(&self, offset: u64, len: u64) -> Result<(*mut u8, usize), BadMessage> {
        let end = offset.checked_add(len).filter(|end| *end <= self.len as u64).ok_or(BadMessage)?;
        let (offset, end) = (offset as usize, end as usize);
        // SAFETY: the stretch was just found to lie inside the mapping.
        Ok((unsafe { self.base.add(offset) }, end - offset))
    }

    /// The bytes of a frame. The frame is valid during the call that names it.
    pub fn copy(&self, frame: &Bytes) -> Result<Vec<u8>, BadMessage> {
        let (from, len) = self.at(frame.offset, frame.len)?;
        let mut bytes = Vec::with_capacity(len);
        // SAFETY: `len` bytes lie inside the mapping and fit into `bytes`. Nobody writes a frame that is lent; a process that breaks this harms only
        // the bytes of its own frames, all values of which are valid.
        unsafe {
            std::ptr::copy_nonoverlapping(from, bytes.as_mut_ptr(), len);
            bytes.set_len(len);
        }
        Ok(bytes)
    }

    /// Copies a frame into another buffer, which is not in use yet.
    pub fn copy_to(&self, frame: &Bytes, pool: &Self, offset: u64) -> Result<(), BadMessage> {
        let ((from, len), (to, _)) = (self.at(frame.offset, frame.len)?, pool.at(offset, frame.len)?);
        // SAFETY: both stretches lie inside mappings; `ptr::copy` allows them to overlap.
        unsafe { std::ptr::copy(from, to, len) };
        Ok(())
    }

    /// Fills a frame with bytes that were sent. The sender owns the buffer; it is not read before the message that
    /// names it is passed on.
    fn fill(&self, frame: &FrameHead, from: &mut impl Read, lane: u32, decoders: &Mutex<Decoders>) -> io::Result<()> {
        let (to, len) = self.at(frame.offset, frame.len)?;
        // SAFETY: `len` bytes inside a mapping that this process may write, and that nobody else uses, see above.
        let to = unsafe { std::slice::from_raw_parts_mut(to, len) };
        match frame.coding {
            Coding::Raw => from.read_exact(to),
            Coding::Lz4 => {
                let mut coded = vec![0; frame.coded_len as usize];
                from.read_exact(&mut coded)?;
                match lz4_flex::block::decompress_into(&coded, to) {
                    Ok(written) if written == len => Ok(()),
                    _ => Err(BadMessage.into()),
                }
            }
            Coding::H264(picture) => {
                let mut coded = vec![0; frame.coded_len as usize];
                from.read_exact(&mut coded)?;
                let mut decoders = lock(decoders);
                decoders.decode(lane, &picture, coded, to).map_err(io::Error::other)
            }
        }
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        // SAFETY: mapped by `map`, and nobody uses it any more.
        unsafe { libc::munmap(self.base.cast(), self.len) };
    }
}

/// The pools of a connection.
#[derive(Default)]
pub struct Pools {
    known: Mutex<HashMap<u32, Arc<Pool>>>,
    changed: Condvar,
}

impl Pools {
    /// Adds a pool, which can then be used.
    pub fn add(&self, number: u32, pool: Pool) {
        lock(&self.known).insert(number, Arc::new(pool));
        self.changed.notify_all();
    }

    /// A pool; waits for one that has not arrived yet.
    pub fn get(&self, number: u32) -> Result<Arc<Pool>, BadMessage> {
        let known = lock(&self.known);
        let missing = |known: &mut HashMap<u32, Arc<Pool>>| !known.contains_key(&number);
        let waited = self.changed.wait_timeout_while(known, MAX_WAIT, missing);
        waited.unwrap_or_else(PoisonError::into_inner).0.get(&number).cloned().ok_or(BadMessage)
    }

    /// Fills the frames of a message of a lane with the bytes that follow it. `own_only`: only pools that the group
    /// writes are filled.
    pub fn fill(
        &self,
        frames: &[FrameHead],
        own_only: bool,
        from: &mut impl Read,
        lane: u32,
        decoders: &Mutex<Decoders>,
    ) -> io::Result<()> {
        for frame in frames {
            let pool = self.get(frame.pool)?;
            if own_only && !pool.is_own {
                return Err(BadMessage.into());
            }
            pool.fill(frame, from, lane, decoders)?;
        }
        Ok(())
    }

    /// Encodes the bytes of a frame for a stream of a lane.
    pub fn coded(
        &self,
        frame: &Bytes,
        pixels: Pixels,
        (lane, stream): (u32, u32),
        encoders: &Mutex<Encoders>,
    ) -> Result<(FrameHead, Vec<u8>), BadMessage> {
        let Bytes { pool, offset, len, .. } = *frame;
        let bytes = self.get(pool)?.copy(frame)?;
        let raw = FrameHead { pool, offset, len, coding: Coding::Raw, coded_len: len };
        if let Some(size) = frame.colour_px.filter(|_| pixels == Pixels::H264) {
            let mut encoders = lock(encoders);
            if let Some((picture, coded)) = encoders.encode((lane, stream), size, &bytes) {
                return Ok((FrameHead { coding: Coding::H264(picture), coded_len: coded.len() as u64, ..raw }, coded));
            }
        }
        if pixels != Pixels::Raw && frame.is_pixels && len >= MIN_COMPRESSED_BYTES {
            let coded = lz4_flex::block::compress(&bytes);
            if coded.len() < bytes.len() {
                return Ok((FrameHead { coding: Coding::Lz4, coded_len: coded.len() as u64, ..raw }, coded));
            }
        }
        Ok((raw, bytes))
    }
}

/// A memory file of fixed size for a pool.
pub fn new_file(number: u32, len: u64) -> io::Result<File> {
    if number == 0 || number as usize > MAX_POOLS || len == 0 || len > MAX_POOL_BYTES {
        return Err(BadMessage.into());
    }
    // SAFETY: the name is a zero-terminated text.
    let fd = unsafe { libc::memfd_create(c"panoscope-mirror".as_ptr(), libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: `memfd_create` returned this file descriptor, and nothing else owns it.
    let file = unsafe { File::from_raw_fd(fd) };
    file.set_len(len)?;
    let seals = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_SEAL;
    // SAFETY: a plain system call on a file that is open.
    match unsafe { libc::fcntl(fd, libc::F_ADD_SEALS, seals) } {
        0 => Ok(file),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pools(len: u64) -> Pools {
        let pools = Pools::default();
        let file = new_file(1, len).expect("memory");
        pools.add(1, Pool::map(&file, len as usize, true, true).expect("memory"));
        pools
    }

    fn bytes(offset: u64, len: u64) -> Bytes {
        Bytes { pool: 1, offset, len, is_pixels: true, colour_px: None, uses: 0 }
    }

    #[test]
    fn frames_arrive_as_they_were_whatever_the_coding() {
        let (here, there) = (pools(1 << 20), pools(1 << 20));
        for len in [0, 1, 4095, 4096, 100_000] {
            let noise: Vec<u8> = (0..len).map(|at| (at * at / 7 % 13) as u8).collect();
            let head = FrameHead { pool: 1, offset: 512, len, coding: Coding::Raw, coded_len: len };
            let (encoders, decoders) = (Mutex::default(), Mutex::default());
            here.fill(&[head], true, &mut &noise[..], 1, &decoders).expect("it fits");
            for pixels in [Pixels::Raw, Pixels::Lz4] {
                let (head, coded) = here.coded(&bytes(512, len), pixels, (1, 0), &encoders).expect("it is there");
                assert_eq!(head.coding == Coding::Lz4, pixels == Pixels::Lz4 && len >= MIN_COMPRESSED_BYTES);
                there.fill(&[head], true, &mut &coded[..], 1, &decoders).expect("it fits");
                assert_eq!(there.get(1).expect("a pool").copy(&bytes(512, len)).expect("bytes"), noise);
            }
        }
    }

    #[test]
    fn nothing_outside_a_pool_is_touched() {
        let pools = pools(4096);
        let (encoders, decoders) = (Mutex::default(), Mutex::default());
        for (offset, len) in [(4096, 1), (u64::MAX, 2), (0, 4097), (4000, u64::MAX)] {
            assert!(pools.coded(&bytes(offset, len), Pixels::Raw, (1, 0), &encoders).is_err());
            let head = FrameHead { pool: 1, offset, len, coding: Coding::Raw, coded_len: len };
            assert!(pools.fill(&[head], true, &mut std::io::repeat(0), 1, &decoders).is_err());
        }
        let short = FrameHead { pool: 1, offset: 0, len: 4096, coding: Coding::Lz4, coded_len: 3 };
        assert!(pools.fill(&[short], true, &mut &b"\x10a\x00"[..], 1, &decoders).is_err(), "too few bytes come out");
        // A match of 4,100 bytes: a release of lz4_flex panicked at such a one.
        let coded = [&[0x1f, 7, 1, 0][..], &[255; 16], &[1, 0]].concat();
        let long = FrameHead { coded_len: coded.len() as u64, ..short };
        assert!(pools.fill(&[long], true, &mut &coded[..], 1, &decoders).is_err(), "too many bytes come out");
        assert!(new_file(0, 1).is_err() && new_file(1, u64::MAX).is_err() && new_file(1 << 20, 1).is_err());
    }
}
