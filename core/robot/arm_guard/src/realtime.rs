//! Locked memory and real-time priority, if the system allows them.

/// Priority of the loop: above the threads of the program.
pub const PRIORITY: i32 = 60;
/// Maximum locked memory that the guard needs, KiB.
pub const MEMORY_KIB: u64 = 65_536;

/// Rights that the system granted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Granted {
    /// Whether memory is locked in RAM.
    pub locked_memory: bool,
    /// Whether the loop runs under SCHED_FIFO.
    pub real_time: bool,
}

/// Locks the memory of this process and raises its priority, as far as allowed.
pub fn request() -> Granted {
    let locked = rustix::mm::mlockall(rustix::mm::MlockAllFlags::CURRENT | rustix::mm::MlockAllFlags::FUTURE);
    let priority = libc::sched_param { sched_priority: PRIORITY };
    // SAFETY: the call reads one `sched_param`, which lives across it.
    let real_time = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const priority) } == 0;
    Granted { locked_memory: locked.is_ok(), real_time }
}
