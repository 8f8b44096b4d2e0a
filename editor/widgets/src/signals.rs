//! Ctrl-C, SIGTERM and SIGHUP close the window as a click on its corner does, with all files finished.

use eframe::egui::{Context, ViewportCommand};
use panoscope_engine::ending::signals;

/// Closes the window when a signal asks for it. Whoever closes the session says [`signals::notice`]; a window that does not is not waited for.
pub fn close_on_signals(ctx: &Context) {
    let ctx = ctx.clone();
    let tell = move || {
        ctx.send_viewport_cmd(ViewportCommand::Close);
        ctx.request_repaint();
    };
    // Until the process leaves.
    std::mem::forget(signals::telling(tell));
}
