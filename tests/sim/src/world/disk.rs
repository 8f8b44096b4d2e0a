//! A disk in memory that is slow, becomes full, and fails.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::world::thread;

/// Behaviour of a disk.
#[derive(Clone, Debug, Default)]
pub struct Habits {
    /// Capacity, bytes; `None` for no limit.
    pub capacity_bytes: Option<usize>,
    /// Duration of each operation.
    pub operation: Duration,
    /// Number of the first operation that fails with an I/O error, counted from 1; all later ones fail too.
    pub fails_from: Option<u64>,
}

#[derive(Default)]
struct State {
    habits: Habits,
    files: BTreeMap<String, Vec<u8>>,
    used_bytes: usize,
    operations: u64,
}

/// A disk. Clones are the same disk.
#[derive(Clone, Default)]
pub struct Disk(Arc<Mutex<State>>);

impl Disk {
    /// An empty disk.
    pub fn new(habits: Habits) -> Self {
        Self(Arc::new(Mutex::new(State { habits, ..State::default() })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the duration of an operation, and counts it.
    fn operation(&self) -> std::io::Result<()> {
        let time = self.state().habits.operation;
        if time.is_zero() {
            thread::yield_now();
        } else {
            thread::sleep(time);
        }
        let mut state = self.state();
        state.operations += 1;
        match state.habits.fails_from {
            Some(from) if state.operations >= from => Err(std::io::Error::from_raw_os_error(libc::EIO)),
            _ => Ok(()),
        }
    }

    /// Creates or truncates a file.
    ///
    /// # Errors
    /// The disk fails.
    pub fn create(&self, name: &str) -> std::io::Result<File> {
        self.operation()?;
        let mut state = self.state();
        let before = state.files.insert(name.to_owned(), Vec::new());
        state.used_bytes -= before.map_or(0, |bytes| bytes.len());
        Ok(File { disk: self.clone(), name: name.to_owned() })
    }

    /// The bytes of a file; `None` if it does not exist.
    pub fn read(&self, name: &str) -> Option<Vec<u8>> {
        self.state().files.get(name).cloned()
    }

    /// Names of all files.
    pub fn names(&self) -> Vec<String> {
        self.state().files.keys().cloned().collect()
    }
}

/// A file of a [`Disk`].
pub struct File {
    disk: Disk,
    name: String,
}

impl File {
    /// Appends bytes: as many as fit, in pieces like a real disk.
    ///
    /// # Errors
    /// The disk is full or fails; a part may have been written.
    pub fn append(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.disk.operation()?;
        let mut state = self.disk.state();
        let room = state.habits.capacity_bytes.map_or(usize::MAX, |all| all.saturating_sub(state.used_bytes));
        let fits = bytes.len().min(room);
        state.used_bytes += fits;
        if let Some(file) = state.files.get_mut(&self.name) {
            file.extend_from_slice(&bytes[..fits]);
        }
        if fits < bytes.len() {
            return Err(std::io::Error::from_raw_os_error(libc::ENOSPC));
        }
        Ok(())
    }

    /// Truncates the file to `len` bytes.
    pub fn cut(&mut self, len: usize) {
        let mut state = self.disk.state();
        if let Some(file) = state.files.get_mut(&self.name) {
            let cut = file.len().saturating_sub(len);
            file.truncate(len);
            state.used_bytes -= cut;
        }
    }

    /// Length of the file, bytes.
    pub fn len(&self) -> usize {
        self.disk.state().files.get(&self.name).map_or(0, Vec::len)
    }

    /// Whether nothing has been written.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
