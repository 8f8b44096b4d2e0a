//! Handles crashes of plugins: SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT.
//!
//! The handler names the node, wakes the rescue thread (see [`super::rescue`]) and waits for it, because the crashed
//! thread cannot continue. Then it restores the previous handlers and returns: the fault happens again and ends the
//! process with the signal's status and core dump.

use std::cell::UnsafeCell;
use std::ffi::{c_int, c_void};
use std::mem::MaybeUninit;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

use super::line::Line;
use super::rescue;
use crate::current_node;
use crate::log;

const SIGNALS: [c_int; 5] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGFPE, libc::SIGILL, libc::SIGABRT];

/// The previous handlers in the order of [`SIGNALS`]: Rust's own for stack guard pages, a sanitizer's, or the default.
struct PreviousActions(UnsafeCell<[MaybeUninit<libc::sigaction>; SIGNALS.len()]>);

// SAFETY: `install` writes it before it sets the handlers; afterwards it is only read.
unsafe impl Sync for PreviousActions {}

static BEFORE: PreviousActions = PreviousActions(UnsafeCell::new([const { MaybeUninit::uninit() }; SIGNALS.len()]));
static INSTALLED: AtomicBool = AtomicBool::new(false);
/// Process that installed the handlers. A forked child that crashes before `exec` is not handled.
static PROCESS: AtomicI32 = AtomicI32::new(0);
/// Thread that crashed first; 0 for none.
static CRASHED: AtomicI32 = AtomicI32::new(0);

/// Whether this is the process that installed the handlers, not a forked child.
pub(super) fn is_ours() -> bool {
    // SAFETY: a plain question to the system.
    PROCESS.load(Ordering::Relaxed) == unsafe { libc::getpid() }
}

/// Installs the handlers, once.
pub(super) fn install() {
    if INSTALLED.swap(true, Ordering::AcqRel) {
        return;
    }
    // SAFETY: plain system calls. The handler touches atomics, thread-locals without destructors and the stack, and makes system calls that
    // are allowed in handlers.
    unsafe {
        PROCESS.store(libc::getpid(), Ordering::Relaxed);
        let before = &mut *BEFORE.0.get();
        for (signal, before) in SIGNALS.into_iter().zip(before) {
            libc::sigaction(signal, std::ptr::null(), before.as_mut_ptr());
        }
        for signal in SIGNALS {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = handle as *const () as usize;
            // On the alternate stack that Rust gives each thread, because the ordinary one may have overflowed.
            action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
            libc::sigaction(signal, &raw const action, std::ptr::null_mut());
        }
    }
}

/// Restores the handlers that were set before [`install`], or the defaults.
fn restore(to_default: bool) {
    // SAFETY: plain system calls on structs that `install` filled.
    unsafe {
        let before = &*BEFORE.0.get();
        for (signal, before) in SIGNALS.into_iter().zip(before) {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = libc::SIG_DFL;
            let action = if to_default { &raw const action } else { before.as_ptr() };
            libc::sigaction(signal, action, std::ptr::null_mut());
        }
    }
}

fn name(signal: c_int) -> &'static str {
    match signal {
        libc::SIGSEGV => "SIGSEGV",
        libc::SIGBUS => "SIGBUS",
        libc::SIGFPE => "SIGFPE",
        libc::SIGILL => "SIGILL",
        libc::SIGABRT => "SIGABRT",
        _ => "a signal",
    }
}

fn meaning(signal: c_int) -> &'static str {
    match signal {
        libc::SIGSEGV => "memory that is not there",
        libc::SIGBUS => "memory that could not be had",
        libc::SIGFPE => "an impossible division",
        libc::SIGILL => "an instruction that this processor does not know",
        _ => "abort",
    }
}

/// Stack pointer at the time of the signal, where it is known.
fn stack_pointer(context: *mut c_void) -> Option<usize> {
    // SAFETY: the kernel passes a context to handlers that were installed with SA_SIGINFO.
    let context = unsafe { context.cast::<libc::ucontext_t>().as_ref() }?;
    #[cfg(target_arch = "x86_64")]
    return Some(context.uc_mcontext.gregs[libc::REG_RSP as usize] as usize);
    #[cfg(target_arch = "aarch64")]
    return Some(context.uc_mcontext.sp as usize);
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    {
        let _ = context;
        None
    }
}

/// Distance from the stack pointer within which an invalid access is an overflow: nothing else of a thread lies so
/// close to its stack.
const STACK_REACH_BYTES: usize = 1 << 16;

fn is_overflow(signal: c_int, address: usize, context: *mut c_void) -> bool {
    (signal == libc::SIGSEGV || signal == libc::SIGBUS)
        && stack_pointer(context).is_some_and(|sp| address.abs_diff(sp) < STACK_REACH_BYTES)
}

extern "C" fn handle(signal: c_int, info: *mut libc::siginfo_t, context: *mut c_void) {
    // SAFETY: the kernel passes a description to handlers that were installed with SA_SIGINFO.
    let (code, address) = unsafe { ((*info).si_code, (*info).si_addr() as usize) };
    // A signal sent by a program (`abort`) does not repeat on return, so send it again.
    let sent = code <= 0;
    let again = || {
        if sent {
            // SAFETY: allowed in a handler; the signal is blocked here and arrives on return.
            unsafe { libc::raise(signal) };
        }
    };
    if !is_ours() {
        restore(true);
        return again();
    }
    let me = current_node::thread_id();
    if let Err(first) = CRASHED.compare_exchange(0, me, Ordering::AcqRel, Ordering::Acquire) {
        if first == me {
            // This handler itself crashed.
            restore(true);
            return again();
        }
        // The thread that crashed first ends the process. If this is the rescue thread, that one stops waiting for it.
        rescue::crashed(me);
        loop {
            // SAFETY: allowed in a handler.
            unsafe { libc::pause() };
        }
    }
    let overflow = !sent && is_overflow(signal, address, context);
    // Earlier log lines come first.
    log::flush_all(rescue::LINES);
    report(signal, (!sent).then_some(address), overflow);
    rescue::after_crash(current_node::current().map(|(who, _, _)| who));
    // Skip Rust's own handler for an overflow, which is reported already. Everything else goes to the previous handler.
    restore(overflow);
    again();
}

fn report(signal: c_int, address: Option<usize>, overflow: bool) {
    let mut words = Line::new();
    words.text("error: ");
    match current_node::current() {
        Some((who, kind, tick)) => {
            if who.node.is_empty() {
                words.text("plugin ").text(&who.file).text(" crashed while it was loaded");
            } else {
                words.text("node `").text(&who.node).text("` (").text(&who.node_type).text(") crashed while it ");
                words.text(kind.while_words());
                if let Some((source, seq)) = tick {
                    words.text(" tick ").number(seq).text(" of source ").number(u64::from(source));
                }
            }
            say_signal(&mut words, signal, address, overflow);
            words.print();
            if !who.node.is_empty() && !who.file.is_empty() {
                words.text("  plugin: ").text(&who.file).print();
            }
            words.text("  help: take the node out of the graph or replace its plugin, and report this text to the plugin's author");
        }
        None => {
            words
                .text("the program crashed outside of every node, in thread ")
                .number(current_node::thread_id() as u64);
            say_signal(&mut words, signal, address, overflow);
            words.print();
            words.text("  help: a library's own thread, or panoscope itself: report this text");
        }
    }
    words.print();
}

fn say_signal(words: &mut Line, signal: c_int, address: Option<usize>, overflow: bool) {
    words.text(": ").text(name(signal)).text(", ");
    words.text(if overflow { "its stack overflowed" } else { meaning(signal) });
    if let Some(address) = address {
        words.text(", at address ").address(address);
    }
}
