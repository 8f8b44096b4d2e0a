//! Signals that request an end, for commands that poll; see [`panoscope_engine::ending::signals`].

use panoscope_engine::ending::signals;

/// Lets the code that polls [`asked`] handle signals until the command ends.
pub fn listen() {
    std::mem::forget(signals::watching());
}

/// Whether an end was requested.
pub fn asked() -> bool {
    signals::asked().is_some()
}
