//! Makes Ctrl-C, SIGTERM and SIGHUP close the window normally, so that all files are finished.

use eframe::egui::{Context, ViewportCommand};
use panoscope_engine::ending::signals;

/// Closes the window when a signal arrives. The window calls [`signals::notice`] before it closes its session; the process does not wait for
/// a window that does not.
pub fn close_on_signals(ctx: &Context) {
    let ctx = ctx.clone();
    let close = move || {
        ctx.send_viewport_cmd(ViewportCommand::Close);
        ctx.request_repaint();
    };
    // Stays registered until the process exits.
    std::mem::forget(signals::telling(close));
}
