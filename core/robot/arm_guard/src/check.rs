//! Checks the guard's permissions on this machine: `panoscope-arm --check` tries them and writes the result for
//! `panoscope doctor`.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use rustix::process::{Resource, getrlimit};

use crate::latch;
use crate::realtime::{self, Granted};

/// File systems in memory: TMPFS_MAGIC and RAMFS_MAGIC of `linux/magic.h`.
const IN_MEMORY: [rustix::fs::FsWord; 2] = [0x0102_1994, 0x8584_58f6];

/// Permissions granted, and the reasons for those that were not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// Rights that the system granted.
    pub granted: Granted,
    /// Highest real-time priority (RLIMIT_RTPRIO); `None` for no limit.
    pub priority_limit: Option<u64>,
    /// Maximum locked memory (RLIMIT_MEMLOCK), KiB; `None` for no limit.
    pub memory_limit_kib: Option<u64>,
    /// Folder of latched stops.
    pub folder: PathBuf,
    /// The reason why stops cannot be kept there; `None` if they can.
    pub folder_problem: Option<String>,
}

impl Check {
    /// Requests all permissions.
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

    /// The findings: whether it is granted, its name, and details with a remedy if it is not.
    pub fn findings(&self) -> [(bool, &'static str, String); 3] {
        let number = |value: Option<u64>| value.map_or_else(|| "no limit".to_owned(), |n| n.to_string());
        let priority = if self.granted.real_time {
            format!("SCHED_FIFO {}", realtime::PRIORITY)
        } else {
            format!(
                "no SCHED_FIFO {needed} (RLIMIT_RTPRIO {limit}): a busy machine may hold the guard up; the arm's own watchdog then stops the arm. For a user `me`: `me - rtprio {needed}` in /etc/security/limits.d/panoscope.conf, then log in again",
                needed = realtime::PRIORITY,
                limit = number(self.priority_limit),
            )
        };
        let memory = if self.granted.locked_memory {
            "allowed".to_owned()
        } else {
            format!(
                "not allowed (RLIMIT_MEMLOCK {limit} KiB, {needed} needed): a machine that swaps may hold the guard up. For a user `me`: `me - memlock {needed}` in /etc/security/limits.d/panoscope.conf, then log in again",
                needed = realtime::MEMORY_KIB,
                limit = number(self.memory_limit_kib),
            )
        };
        let folder = self.folder.display();
        let latches = match &self.folder_problem {
            None => folder.to_string(),
            Some(problem) => {
                format!(
                    "{folder}: {problem}; set {} to a folder on a disk that this user can write",
                    latch::FOLDER_VARIABLE
                )
            }
        };
        [
            (self.granted.real_time, "arm's guard, priority", priority),
            (self.granted.locked_memory, "arm's guard, locked memory", memory),
            (self.folder_problem.is_none(), "arm's latched stops", latches),
        ]
    }

    /// A line per finding: `ok` or `absent`, name and details, separated by tabs.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        self.findings().iter().try_for_each(|(is_fine, what, about)| {
            writeln!(out, "{}\t{what}\t{}", if *is_fine { "ok" } else { "absent" }, about.replace(['\n', '\t'], " "))
        })
    }
}

/// The reason why stops cannot be kept in a folder: it is not writable, or loses its files when the machine restarts.
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

    fn check(granted: bool) -> Check {
        Check {
            granted: Granted { locked_memory: granted, real_time: granted },
            priority_limit: Some(0),
            memory_limit_kib: Some(8192),
            folder: "/somewhere/arms".into(),
            folder_problem: None,
        }
    }

    #[test]
    fn a_machine_that_grants_everything_is_fine() {
        let mut text = Vec::new();
        check(true).write(&mut text).expect("memory");
        let text = String::from_utf8(text).expect("text");
        assert!(text.lines().count() == 3 && text.lines().all(|line| line.starts_with("ok\t")), "{text}");
        assert!(text.ends_with("\tarm's latched stops\t/somewhere/arms\n"), "{text}");
    }

    #[test]
    fn what_is_missing_comes_with_its_remedy() {
        let findings = Check { folder_problem: Some("it is in memory".to_owned()), ..check(false) }.findings();
        let about =
            |words: &[&str]| findings.iter().any(|(ok, _, about)| !ok && words.iter().all(|word| about.contains(word)));
        assert!(about(&["RLIMIT_RTPRIO 0", "`me - rtprio 60`", "/etc/security/limits.d"]));
        assert!(about(&["RLIMIT_MEMLOCK 8192 KiB", "`me - memlock 65536`", "/etc/security/limits.d"]));
        assert!(about(&["/somewhere/arms: it is in memory", "PANOSCOPE_ARM_STATE"]));
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
