//! Names the node that crashes the process: the handler marks its lane, then the signal ends the process as without the
//! handler.

use std::ffi::{c_int, c_void};

use super::table;

/// Marks the lane of the thread that crashes.
extern "C" fn handle(signal: c_int, info: *mut libc::siginfo_t, _: *mut c_void) {
    // SAFETY: the lane of the call that this thread runs; marking it is a store.
    if let Some(lane) = unsafe { table::current_lane().as_ref() } {
        lane.lane.set_signal(signal as u32);
    }
    // SAFETY: plain system calls that are allowed in a handler. The kernel passes a description with SA_SIGINFO.
    unsafe {
        libc::signal(signal, libc::SIG_DFL);
        // A signal that a program sent, such as that of `abort`, does not repeat on return.
        if (*info).si_code <= 0 {
            libc::raise(signal);
        }
    }
}

/// Installs the handlers.
pub(super) fn install() {
    for signal in [libc::SIGSEGV, libc::SIGBUS, libc::SIGFPE, libc::SIGILL, libc::SIGABRT] {
        // SAFETY: plain system calls. The handler touches a thread-local without destructor and an atomic of a mapping that stays.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = handle as *const () as usize;
            // On the alternate stack that Rust gives each thread, because the ordinary one may have overflowed.
            action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
            libc::sigaction(signal, &raw const action, std::ptr::null_mut());
        }
    }
}
