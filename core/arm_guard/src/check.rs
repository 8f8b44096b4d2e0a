//! What the guard may do on this machine, for `panoscope doctor`: `panoscope-arm --check` tries it and writes the result.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use rustix::process::{Resource, getrlimit};

use crate::latch;
use crate::realtime::{self, Granted};

/// File systems in memory: TMPFS_MAGIC and RAMFS_MAGIC of `linux/magic.h`.
const IN_MEMORY: [rustix::fs::FsWord; 2] = [0x0102_1994, 0x8584_58f6];

/// What was granted, and why not more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// What the system granted.
    pub granted: Granted,
    /// Highest real-time priority (RLIMIT_RTPRIO); `None` for no limit.
    pub priority_limit: Option<u64>,
    /// Most locked memory (RLIMIT_MEMLOCK), KiB; `None` for no limit.
    pub memory_limit_kib: Option<u64>,
    /// Folder of latched stops.
    pub folder: PathBuf,
    /// Why stops cannot be kept there; `None` where they can.
    pub folder_problem: Option<String>,
}

impl Check {
    /// Tries everything.
    pub fn run(latches: Option<&Path>) -> Self {
        let limit = |resource| getrlimit(resource).current;
        let (folder, folder_problem) = match latches.map_or_else(latch::folder, |folder| Ok(folder.to_owned())) {
            Ok(folder) => {
                let problem = folder_problem(&folder);
                (folder, problem)
            }
            Err(error) => (PathBuf::new(), Some(error.to_string())),
        };
        Self {
            granted: realtime::request(),
            priority_limit: limit(Resource::Rtprio),
            memory_limit_kib: limit(Resource::Memlock).map(|bytes| bytes / 1024),
            folder,
            folder_problem,
        }
    }

    /// One `name=value` per line.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let number = |value: Option<u64>| value.map_or_else(|| "none".to_owned(), |n| n.to_string());
        writeln!(out, "locked_memory={}", self.granted.locked_memory)?;
        writeln!(out, "real_time={}", self.granted.real_time)?;
        writeln!(out, "priority_limit={}", number(self.priority_limit))?;
        writeln!(out, "memory_limit_kib={}", number(self.memory_limit_kib))?;
        writeln!(out, "folder={}", self.folder.display())?;
        writeln!(out, "folder_problem={}", self.folder_problem.as_deref().unwrap_or_default().replace('\n', " "))
    }

    /// Reads what [`Check::write`] wrote; `None` for anything else.
    pub fn read(text: &str) -> Option<Self> {
        let value = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
        let number = |name: &str| match value(name)? {
            "none" => Some(None),
            text => text.parse().ok().map(Some),
        };
        let problem = value("folder_problem")?;
        Some(Self {
            granted: Granted {
                locked_memory: value("locked_memory")?.parse().ok()?,
                real_time: value("real_time")?.parse().ok()?,
            },
            priority_limit: number("priority_limit")?,
            memory_limit_kib: number("memory_limit_kib")?,
            folder: value("folder")?.into(),
            folder_problem: (!problem.is_empty()).then(|| problem.to_owned()),
        })
    }
}

/// Why stops cannot be kept in a folder: it cannot be written, or loses its files when the machine restarts.
fn folder_problem(folder: &Path) -> Option<String> {
    // The guard creates the folder: the first one above it that exists decides.
    let existing = folder.ancestors().find(|folder| folder.is_dir())?;
    let tried = if existing == folder { write_file(folder) } else { may_create(existing) };
    if let Err(error) = tried {
        return Some(format!("it cannot be written: {error}"));
    }
    let system = rustix::fs::statfs(existing).ok()?;
    let is_in_memory = IN_MEMORY.contains(&system.f_type);
    is_in_memory.then(|| "it is in memory (tmpfs): a restart of the machine forgets the arm's stops".to_owned())
}

fn write_file(folder: &Path) -> io::Result<()> {
    let path = folder.join(format!(".check-{}", std::process::id()));
    let result = File::create(&path).and_then(|mut file| {
        file.write_all(b"check\n")?;
        file.sync_all()
    });
    let _ = fs::remove_file(&path);
    result
}

fn may_create(folder: &Path) -> io::Result<()> {
    let needed = rustix::fs::Access::WRITE_OK | rustix::fs::Access::EXEC_OK;
    rustix::fs::access(folder, needed).map_err(io::Error::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check() -> Check {
        Check {
            granted: Granted { locked_memory: true, real_time: false },
            priority_limit: Some(20),
            memory_limit_kib: None,
            folder: "/var/lib/panoscope/arms".into(),
            folder_problem: Some("it cannot be written: no space".to_owned()),
        }
    }

    #[test]
    fn a_check_comes_back_as_it_was_written() {
        for check in [check(), Check { folder_problem: None, priority_limit: None, ..check() }] {
            let mut text = Vec::new();
            check.write(&mut text).expect("memory");
            let text = String::from_utf8(text).expect("text");
            assert_eq!(Check::read(&text), Some(check));
            for line in text.lines() {
                assert_eq!(Check::read(&text.replace(line, "")), None, "without `{line}`");
            }
        }
    }

    #[test]
    fn a_folder_must_be_writable_and_durable() {
        let base = std::env::temp_dir().join(format!("panoscope-check-{}", std::process::id()));
        let _ = fs::remove_dir_all(&base);
        fs::create_dir_all(&base).expect("made");
        let expected = folder_problem(&base);
        assert!(expected.as_deref().is_none_or(|words| words.contains("tmpfs")), "{expected:?}");
        assert_eq!(folder_problem(&base.join("a/b")), expected, "the guard creates it");
        assert_eq!(fs::read_dir(&base).expect("read").count(), 0, "nothing is left there");
        // Nobody may write there, an administrator included.
        let problem = folder_problem(Path::new("/proc/self")).unwrap_or_default();
        assert!(problem.contains("cannot be written"), "{problem}");
        let memory = Path::new("/dev/shm");
        if fs::read_to_string("/proc/mounts").is_ok_and(|mounts| mounts.contains(" /dev/shm tmpfs ")) {
            assert!(folder_problem(memory).is_some_and(|words| words.contains("tmpfs")));
        }
        let _ = fs::remove_dir_all(base);
    }
}
