//! SIGINT (Ctrl-C), SIGTERM, SIGHUP, and others that would end the process (SIGUSR1, SIGUSR2, SIGXCPU): the first one
//! requests an end with all files finished. SIGXFSZ is ignored: a write beyond the limit of a file's size is an error
//! of that file's node.
//!
//! `timeout` and shells send a signal twice, to a process and to its group: signals within one second count as one
//! request. Later ones end the process at once. `Duty` says which code acknowledges the first one; if none does in
//! time, the process ends anyway.

use std::ffi::c_int;
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicI64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::exit::leave;
use super::line::Line;
use super::{crash, finish_files};
use crate::current_node;
use crate::sync::lock;

const SIGNALS: [c_int; 6] = [libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGUSR1, libc::SIGUSR2, libc::SIGXCPU];

/// Signals that come within this time of the first are the same request.
const ONE_REQUEST_MS: i64 = 1000;
/// Maximum time for nodes to open after a request to end.
const OPENING: Duration = Duration::from_secs(1);
/// Time limit for the watching code to acknowledge.
const NOTICE: Duration = Duration::from_secs(5);

/// The signal that requested an end; 0 for none.
static ASKED: AtomicI32 = AtomicI32::new(0);
static ASKED_MS: AtomicI64 = AtomicI64::new(0);
static NOTICED: AtomicBool = AtomicBool::new(false);
static PIPE: AtomicI32 = AtomicI32::new(-1);
static INSTALLED: AtomicBool = AtomicBool::new(false);

/// Which code acknowledges a request to end.
enum Duty {
    /// None: there is nothing to finish, the process exits.
    Leave,
    /// Nodes are opening and have made nothing yet. They get one second, then the process exits.
    Opening,
    /// The code that calls [`asked`] ends the run. If it does not notice, the signal thread finishes the files and
    /// exits.
    Watched,
    /// The same, notified by a call instead of polling.
    Told(Box<dyn Fn() + Send>),
    /// The run is ending already.
    Finishing,
}

static DUTY: Mutex<Duty> = Mutex::new(Duty::Leave);
static CHANGED: Condvar = Condvar::new();

fn duty() -> MutexGuard<'static, Duty> {
    lock(&DUTY)
}

fn set(new: Duty) {
    *duty() = new;
    CHANGED.notify_all();
}

/// A signal that requests an end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Signal(c_int);

impl Signal {
    /// Exit status of a process ended by the signal, as in shells.
    pub fn status(self) -> i32 {
        128 + self.0
    }

    fn name(self) -> &'static str {
        match self.0 {
            libc::SIGINT => "Ctrl-C (SIGINT)",
            libc::SIGTERM => "SIGTERM",
            libc::SIGHUP => "SIGHUP",
            libc::SIGUSR1 => "SIGUSR1",
            libc::SIGUSR2 => "SIGUSR2",
            libc::SIGXCPU => "SIGXCPU (the limit of processor time)",
            _ => "a signal",
        }
    }
}

impl fmt::Display for Signal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

fn now_ms() -> i64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: fills the struct; allowed in a signal handler.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    time.tv_sec * 1000 + time.tv_nsec / 1_000_000
}

/// The meaning of a signal after an earlier request.
#[derive(Debug, PartialEq, Eq)]
enum Meaning {
    First,
    /// The same request, sent twice.
    Same,
    AtOnce,
}

fn meaning(asked: bool, asked_ms: i64, now_ms: i64) -> Meaning {
    match asked {
        false => Meaning::First,
        true if now_ms - asked_ms < ONE_REQUEST_MS => Meaning::Same,
        true => Meaning::AtOnce,
    }
}

extern "C" fn handle(signal: c_int) {
    if !crash::is_ours() {
        // A forked child before `exec`.
        leave(128 + signal);
    }
    let now = now_ms();
    match meaning(ASKED.load(Ordering::Acquire) != 0, ASKED_MS.load(Ordering::Relaxed), now) {
        Meaning::First => {
            ASKED_MS.store(now, Ordering::Relaxed);
            ASKED.store(signal, Ordering::Release);
            // SAFETY: writes one byte that is there; allowed in a signal handler.
            unsafe { libc::write(PIPE.load(Ordering::Relaxed), b"!".as_ptr().cast(), 1) };
        }
        Meaning::Same => {}
        Meaning::AtOnce => {
            Line::new().text("stopped at once by a second signal: files may be incomplete").print();
            leave(128 + signal)
        }
    }
}

/// Installs the handlers, once per process. SIGHUP stays ignored if it was, as under `nohup`.
///
/// # Errors
/// The system gives no pipe or thread; signals then keep their default effect.
pub fn install() -> std::io::Result<()> {
    super::install();
    if INSTALLED.swap(true, Ordering::AcqRel) {
        return Ok(());
    }
    let mut ends = [-1; 2];
    // SAFETY: a plain system call that fills the array.
    if unsafe { libc::pipe2(ends.as_mut_ptr(), libc::O_CLOEXEC) } != 0 {
        return Err(std::io::Error::last_os_error());
    }
    PIPE.store(ends[1], Ordering::Relaxed);
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        let mut byte = 0u8;
        // SAFETY: reads one byte into a byte.
        while unsafe { libc::read(ends[0], (&raw mut byte).cast(), 1) } < 1 {}
        answer();
    })?;
    // SAFETY: a plain system call.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
    for signal in SIGNALS {
        // SAFETY: plain system calls; the handler touches atomics, a clock and a pipe, all allowed there.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            libc::sigaction(signal, std::ptr::null(), &raw mut action);
            if signal == libc::SIGHUP && action.sa_sigaction == libc::SIG_IGN {
                continue;
            }
            action.sa_sigaction = handle as *const () as usize;
            action.sa_flags = libc::SA_RESTART | libc::SA_ONSTACK;
            libc::sigemptyset(&raw mut action.sa_mask);
            libc::sigaction(signal, &raw const action, std::ptr::null_mut());
        }
    }
    Ok(())
}

/// The signal that requested an end, if any. The caller must then end the run.
pub fn asked() -> Option<Signal> {
    let signal = ASKED.load(Ordering::Acquire);
    if signal == 0 {
        return None;
    }
    notice();
    Some(Signal(signal))
}

/// Acknowledges the request: the run is ending.
pub fn notice() {
    NOTICED.store(true, Ordering::Release);
    CHANGED.notify_all();
}

/// Nodes are opening, until the guard is dropped or turned into another duty.
pub fn opening() -> OnDuty {
    set(Duty::Opening);
    OnDuty(())
}

/// The caller polls [`asked`] until the guard is dropped.
pub fn watching() -> OnDuty {
    set(Duty::Watched);
    OnDuty(())
}

/// `tell` is called once, from another thread, when an end is requested; its receiver calls [`notice`].
pub fn telling(tell: impl Fn() + Send + 'static) -> OnDuty {
    set(Duty::Told(Box::new(tell)));
    OnDuty(())
}

/// Some code acknowledges signals until this is dropped; afterwards a signal ends the process.
#[must_use]
pub struct OnDuty(());

impl OnDuty {
    /// Continues as [`watching`] without a gap.
    pub fn watching(self) -> Self {
        std::mem::forget(self);
        watching()
    }

    /// The run has ended and files are being finished: a first signal changes nothing, a second one exits at once.
    pub fn finishing(self) -> Self {
        set(Duty::Finishing);
        self
    }
}

impl Drop for OnDuty {
    fn drop(&mut self) {
        set(Duty::Leave);
    }
}

/// Handles the first signal, on its own thread.
fn answer() {
    let signal = Signal(ASKED.load(Ordering::Acquire));
    let asked = Instant::now();
    let mut now = duty();
    loop {
        if NOTICED.load(Ordering::Acquire) {
            return;
        }
        let wait = match &*now {
            Duty::Finishing => return,
            Duty::Leave => {
                Line::new().text("stopped by ").text(signal.name()).print();
                leave(signal.status())
            }
            Duty::Opening => OPENING,
            Duty::Watched => NOTICE,
            Duty::Told(tell) => {
                tell();
                *now = Duty::Watched;
                NOTICE
            }
        };
        let Some(left) = wait.checked_sub(asked.elapsed()) else {
            let opening = matches!(*now, Duty::Opening);
            drop(now);
            if opening { leave_opening(signal) } else { leave_unnoticed(signal) }
        };
        now = CHANGED.wait_timeout(now, left.max(Duration::from_millis(1))).unwrap_or_else(PoisonError::into_inner).0;
    }
}

fn leave_opening(signal: Signal) -> ! {
    let nodes = current_node::being_opened();
    let what = if nodes.is_empty() {
        "the graph was being loaded".to_owned()
    } else {
        format!("{} was still opening", nodes.join(", "))
    };
    Line::new().text("stopped by ").text(signal.name()).text(" before the first frame: ").text(&what).print();
    leave(signal.status())
}

fn leave_unnoticed(signal: Signal) -> ! {
    let nodes = current_node::being_opened();
    let what = if nodes.is_empty() { String::new() } else { format!(", {} is still opening", nodes.join(", ")) };
    let files = finish_files();
    let mut words = Line::new();
    words.text(&files).print();
    words.text("stopped by ").text(signal.name()).text(": the program was busy").text(&what).print();
    leave(signal.status())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_doubled_signal_is_one_and_a_later_one_means_now() {
        assert_eq!(meaning(false, 0, 5), Meaning::First);
        assert_eq!(meaning(true, 5, 6), Meaning::Same);
        assert_eq!(meaning(true, 5, 5 + ONE_REQUEST_MS - 1), Meaning::Same);
        assert_eq!(meaning(true, 5, 5 + ONE_REQUEST_MS), Meaning::AtOnce);
    }
}
