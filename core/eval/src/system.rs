//! Resources of this process, from the operating system.
#![allow(unsafe_code)]

/// Processor time and waits of this process since its start.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Usage {
    /// Processor time of all threads, user and system, s.
    pub cpu_seconds: f64,
    /// Number of voluntary context switches.
    pub voluntary_waits: u64,
}

/// Usage of this process since its start.
pub(crate) fn usage() -> Usage {
    // SAFETY: `rusage` is plain integers, for which zero is valid; the call fills it and keeps no pointer to it.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_SELF, &raw mut usage);
        usage
    };
    let seconds = |t: libc::timeval| t.tv_sec as f64 + t.tv_usec as f64 / 1e6;
    Usage { cpu_seconds: seconds(usage.ru_utime) + seconds(usage.ru_stime), voluntary_waits: usage.ru_nvcsw as u64 }
}

/// Resident memory of this process, MB; 0 if `/proc` lacks it.
pub(crate) fn resident_mb() -> f64 {
    resident_mb_of(std::process::id())
}

/// Resident memory of process `id`, MB; 0 if there is none.
pub(crate) fn resident_mb_of(id: u32) -> f64 {
    // In pages; see proc(5). The second number is the resident part.
    let text = std::fs::read_to_string(format!("/proc/{id}/statm")).unwrap_or_default();
    let pages: f64 = text.split_whitespace().nth(1).and_then(|n| n.parse().ok()).unwrap_or(0.0);
    // SAFETY: `sysconf` takes a number and returns a number.
    let page_bytes = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    pages * page_bytes as f64 / 1e6
}

/// Threads of this process; 0 if `/proc` lacks it.
pub(crate) fn threads() -> usize {
    entries("/proc/self/task")
}

/// Open files of this process; 0 if `/proc` lacks it.
pub(crate) fn open_files() -> usize {
    // Without the one that reads the folder.
    entries("/proc/self/fd").saturating_sub(1)
}

fn entries(folder: &str) -> usize {
    std::fs::read_dir(folder).map_or(0, Iterator::count)
}

/// Ends process `id` by SIGKILL. Returns whether there was one.
pub(crate) fn kill(id: u32) -> bool {
    let Ok(id) = libc::pid_t::try_from(id) else { return false };
    // SAFETY: a plain system call. A number that is not positive would name a group of processes.
    id > 0 && unsafe { libc::kill(id, libc::SIGKILL) } == 0
}

#[cfg(test)]
mod tests {
    #[test]
    fn this_process_uses_memory_and_time() {
        assert!(super::resident_mb() > 1.0);
        let before = super::usage();
        let mut sum = 0u64;
        while super::usage().cpu_seconds <= before.cpu_seconds {
            sum = std::hint::black_box(sum.wrapping_add(1));
        }
        assert!(super::usage().voluntary_waits >= before.voluntary_waits);
    }

    #[test]
    fn an_open_file_and_a_thread_are_counted() {
        assert!(super::threads() >= 1 && super::open_files() >= 3);
    }

    #[test]
    fn a_process_is_killed_by_its_number() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        assert!(super::kill(child.id()));
        assert!(!child.wait().unwrap().success());
        assert!(!super::kill(0) && !super::kill(u32::MAX));
    }
}
