//! Questions to the operating system about this process.
#![allow(unsafe_code)]

/// Processor time and waits of this process so far.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Usage {
    /// Processor time of all threads, user and system.
    pub cpu_seconds: f64,
    /// Times a thread gave up its core to wait.
    pub voluntary_waits: u64,
}

/// What this process has used so far.
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

/// Resident memory of this process, MB; 0 if `/proc` does not have it.
pub(crate) fn resident_mb() -> f64 {
    // In pages; see proc(5). The second number is the resident part.
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: f64 = text.split_whitespace().nth(1).and_then(|n| n.parse().ok()).unwrap_or(0.0);
    // SAFETY: `sysconf` takes a number and returns a number.
    let page_bytes = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    pages * page_bytes as f64 / 1e6
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
}
