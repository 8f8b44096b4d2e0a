//! Ctrl-C and SIGTERM close the window as a click on its corner does.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use eframe::egui::{Context, ViewportCommand};

/// Set when the process was asked to end by a signal.
static ASKED_TO_END: AtomicBool = AtomicBool::new(false);

extern "C" fn on_signal(_: libc::c_int) {
    // A second signal means now.
    if ASKED_TO_END.swap(true, Ordering::Relaxed) {
        // SAFETY: allowed in a signal handler.
        unsafe { libc::_exit(130) }
    }
}

/// Closes the window, with all files finished, on Ctrl-C and SIGTERM.
pub fn close_on_signals(ctx: &Context) {
    for signal in [libc::SIGINT, libc::SIGTERM] {
        // SAFETY: the handler touches one atomic and leaves the process, both allowed there.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = on_signal as *const () as usize;
            action.sa_flags = libc::SA_RESTART;
            libc::sigaction(signal, &raw const action, std::ptr::null_mut());
        }
    }
    let ctx = ctx.clone();
    let wait = move || {
        while !ASKED_TO_END.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(100));
        }
        ctx.send_viewport_cmd(ViewportCommand::Close);
        ctx.request_repaint();
    };
    // Without the thread a second Ctrl-C still ends the program.
    let _ = std::thread::Builder::new().name("signals".to_owned()).spawn(wait);
}
