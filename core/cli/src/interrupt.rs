//! Signals that ask for an end, for commands that ask every now and then; see [`panoscope_engine::ending::signals`].

use panoscope_engine::ending::signals;

/// From now on the code that calls [`asked`] handles signals, until the command ends.
pub fn listen() {
    std::mem::forget(signals::watching());
}

/// Whether an end was asked for.
pub fn asked() -> bool {
    signals::asked().is_some()
}
