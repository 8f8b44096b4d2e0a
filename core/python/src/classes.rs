//! The node classes from which descriptors were made.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use panoscope_abi::NodeType;
use pyo3::prelude::*;
use pyo3::types::PyAny;

/// The classes of the descriptors, by address.
static CLASSES: Mutex<Option<HashMap<usize, Py<PyAny>>>> = Mutex::new(None);

/// The `panoscope.nodes.NodeType` from which a descriptor was made.
pub fn class_of(py: Python<'_>, node_type: &'static NodeType) -> Option<Py<PyAny>> {
    let classes = CLASSES.lock().unwrap_or_else(PoisonError::into_inner);
    Some(classes.as_ref()?.get(&std::ptr::from_ref(node_type).addr())?.clone_ref(py))
}

/// Keeps the class of a descriptor for [`class_of`].
pub fn remember(node_type: &'static NodeType, class: &Bound<'_, PyAny>) {
    let mut classes = CLASSES.lock().unwrap_or_else(PoisonError::into_inner);
    classes.get_or_insert_default().insert(std::ptr::from_ref(node_type).addr(), class.clone().unbind());
}
