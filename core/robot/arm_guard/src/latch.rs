//! Stops that survive restarts, crashes and full disks: one file per device, under its serial number.
//!
//! The file holds one of three states, written before it takes effect and synchronized to the disk:
//!
//! | file | meaning after a restart |
//! |---|---|
//! | `rest` | the arm was left at rest, with no stop latched |
//! | `released` | the arm was released and the process ended without leaving it at rest: counts as a latched stop |
//! | `latched N` | the stop with number N was latched |
//!
//! A full disk never loses a stop: the file then still contains `released`, which counts as a stop. A release that
//! cannot be written does not take effect. A file that cannot be read, or whose checksum is wrong, counts as a latched
//! stop.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use panoscope_arm_core::Cause;
use panoscope_arm_core::line::Serial;
use rustix::fs::FlockOperation;
use thiserror::Error;

/// Variable that names the folder of the latches.
pub const FOLDER_VARIABLE: &str = "PANOSCOPE_ARM_STATE";
/// Folder of the whole machine; used if it exists.
const MACHINE_FOLDER: &str = "/var/lib/panoscope/arms";

/// Error of the store.
#[derive(Debug, Error)]
pub enum LatchError {
    /// No folder for latches is known.
    #[error("there is no folder for the arm's latched stops: set {FOLDER_VARIABLE} to one")]
    NoFolder,
    /// The folder cannot be used.
    #[error("{path}: latched stops cannot be stored here: {cause}; set {FOLDER_VARIABLE} to a folder that this user can write", path = path.display())]
    Folder {
        /// The folder or file.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// Another process uses this device.
    #[error("another program drives the arm {serial}; end it first")]
    InUse {
        /// The device's serial number.
        serial: String,
    },
}

/// State of a device in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Record {
    /// At rest, no stop latched.
    Rest,
    /// Released by a person: the arm may move.
    Released,
    /// A latched stop.
    Latched(Cause),
}

/// The file of one device. It is locked while this exists.
#[derive(Debug)]
pub struct LatchStore {
    folder: PathBuf,
    file: PathBuf,
    written: Option<Record>,
    _lock: File,
}

/// The folder of the latches: [`FOLDER_VARIABLE`], else the machine's, else the user's.
///
/// # Errors
/// No folder is known.
pub fn folder() -> Result<PathBuf, LatchError> {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(folder) = variable(FOLDER_VARIABLE) {
        return Ok(folder);
    }
    let machine = Path::new(MACHINE_FOLDER);
    if machine.is_dir() {
        return Ok(machine.to_owned());
    }
    variable("XDG_STATE_HOME")
        .or_else(|| variable("HOME").map(|home| home.join(".local/state")))
        .map(|state| state.join("panoscope/arms"))
        .ok_or(LatchError::NoFolder)
}

impl LatchStore {
    /// Opens the file of a device in `folder`. The second result is the stop that the arm starts with, `None` after a
    /// rest.
    ///
    /// # Errors
    /// The folder cannot be written, or another process uses the device.
    pub fn open(folder: &Path, serial: &Serial) -> Result<(Self, Option<Cause>), LatchError> {
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |cause| LatchError::Folder { path, cause }
        };
        fs::create_dir_all(folder).map_err(failed(folder))?;
        let lock_path = folder.join(format!("{}.lock", serial.as_str()));
        let lock =
            OpenOptions::new().write(true).create(true).truncate(false).open(&lock_path).map_err(failed(&lock_path))?;
        if rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive).is_err() {
            return Err(LatchError::InUse { serial: serial.as_str().to_owned() });
        }
        let file = folder.join(format!("{}.latch", serial.as_str()));
        let stop = match fs::read(&file) {
            Ok(bytes) => match decode(&bytes) {
                Some(Record::Rest) => None,
                Some(Record::Released) => Some(Cause::Interrupted),
                Some(Record::Latched(cause)) => Some(cause),
                None => Some(Cause::RecordLost),
            },
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(_) => Some(Cause::RecordLost),
        };
        Ok((Self { folder: folder.to_owned(), file, written: None, _lock: lock }, stop))
    }

    /// Writes the state and waits until it is on the disk. Writes nothing when the file already holds it.
    ///
    /// # Errors
    /// The disk is full or missing; the file is then unchanged.
    pub fn write(&mut self, record: Record) -> io::Result<()> {
        if self.written == Some(record) {
            return Ok(());
        }
        let fresh = self.file.with_extension("new");
        let mut file = File::create(&fresh)?;
        file.write_all(&encode(record))?;
        file.sync_all()?;
        fs::rename(&fresh, &self.file)?;
        // The new name must survive a loss of power, too.
        File::open(&self.folder)?.sync_all()?;
        self.written = Some(record);
        Ok(())
    }
}

fn encode(record: Record) -> Vec<u8> {
    let body = match record {
        Record::Rest => "rest".to_owned(),
        Record::Released => "released".to_owned(),
        Record::Latched(cause) => format!("latched {} {cause}", cause.number()),
    };
    format!("{body}\n{:08x}\n", crc32fast::hash(body.as_bytes())).into_bytes()
}

fn decode(bytes: &[u8]) -> Option<Record> {
    let text = std::str::from_utf8(bytes).ok()?;
    let (body, crc) = text.strip_suffix('\n')?.split_once('\n')?;
    if u32::from_str_radix(crc, 16).ok()? != crc32fast::hash(body.as_bytes()) || crc.len() != 8 {
        return None;
    }
    match body {
        "rest" => Some(Record::Rest),
        "released" => Some(Record::Released),
        _ => {
            let number = body.strip_prefix("latched ")?.split(' ').next()?.parse::<usize>().ok()?;
            Some(Record::Latched(Cause::from_number(number)?))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("panoscope-latch-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        folder
    }

    fn serial() -> Serial {
        Serial::new("CAM6-1").expect("a serial number")
    }

    #[test]
    fn every_state_comes_back() {
        let folder = folder("states");
        let latching: Vec<Cause> = Cause::ALL.into_iter().filter(|cause| cause.latches()).collect();
        for (record, stop) in [(Record::Rest, None), (Record::Released, Some(Cause::Interrupted))]
            .into_iter()
            .chain(latching.into_iter().map(|cause| (Record::Latched(cause), Some(cause))))
        {
            let (mut store, _) = LatchStore::open(&folder, &serial()).expect("opened");
            store.write(record).expect("written");
            drop(store);
            assert_eq!(LatchStore::open(&folder, &serial()).expect("opened").1, stop, "{record:?}");
        }
        let _ = fs::remove_dir_all(folder);
    }

    #[test]
    fn a_damaged_file_is_a_stop() {
        let folder = folder("damaged");
        let (mut store, stop) = LatchStore::open(&folder, &serial()).expect("opened");
        assert_eq!(stop, None, "a new device");
        store.write(Record::Rest).expect("written");
        let file = store.file.clone();
        drop(store);
        let sound = fs::read(&file).expect("read");
        let open = || LatchStore::open(&folder, &serial()).expect("opened").1;
        for at in 0..sound.len() {
            for bit in 0..8 {
                let mut bad = sound.clone();
                bad[at] ^= 1 << bit;
                fs::write(&file, &bad).expect("written");
                // A digit of the checksum may change its case.
                assert!(open() == Some(Cause::RecordLost) || bad.eq_ignore_ascii_case(&sound), "{at} {bit}");
            }
            fs::write(&file, &sound[..at]).expect("written");
            assert_eq!(open(), Some(Cause::RecordLost), "cut at {at}");
        }
        let _ = fs::remove_dir_all(folder);
    }

    #[test]
    fn a_failed_write_keeps_the_state() {
        let folder = folder("full");
        let (mut store, _) = LatchStore::open(&folder, &serial()).expect("opened");
        store.write(Record::Released).expect("written");
        // A folder in place of the temporary file makes every write fail, whoever runs the test.
        fs::create_dir(store.file.with_extension("new")).expect("made");
        store.write(Record::Latched(Cause::EmergencyStop)).expect_err("it cannot be written");
        drop(store);
        assert_eq!(LatchStore::open(&folder, &serial()).expect("opened").1, Some(Cause::Interrupted));
        let _ = fs::remove_dir_all(folder);
    }

    #[test]
    fn a_device_has_one_owner() {
        let folder = folder("owner");
        let first = LatchStore::open(&folder, &serial()).expect("opened");
        let error = LatchStore::open(&folder, &serial()).expect_err("it is in use").to_string();
        assert!(error.contains("another program drives the arm CAM6-1"), "{error}");
        drop(first);
        LatchStore::open(&folder, &serial()).expect("free again");
        let _ = fs::remove_dir_all(folder);
    }
}
