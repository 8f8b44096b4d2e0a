//! Mistakes that a test switches on in simulated code, to see that they are found.

use std::sync::Mutex;

static ACTIVE: Mutex<Option<String>> = Mutex::new(None);

/// Switches a mistake on, or all off.
pub fn mutate(name: Option<&str>) {
    *ACTIVE.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = name.map(str::to_owned);
}

/// Whether a mistake is on.
pub fn is_mutated(name: &str) -> bool {
    ACTIVE.lock().unwrap_or_else(std::sync::PoisonError::into_inner).as_deref() == Some(name)
}
