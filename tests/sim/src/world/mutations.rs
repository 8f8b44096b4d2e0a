//! Defects that a test enables in simulated code, to check that they are found.

use std::sync::Mutex;

static ACTIVE: Mutex<Option<String>> = Mutex::new(None);

/// Enables one defect, or disables all.
pub fn mutate(name: Option<&str>) {
    *ACTIVE.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = name.map(str::to_owned);
}

/// Whether a defect is enabled.
pub fn is_mutated(name: &str) -> bool {
    ACTIVE.lock().unwrap_or_else(std::sync::PoisonError::into_inner).as_deref() == Some(name)
}
