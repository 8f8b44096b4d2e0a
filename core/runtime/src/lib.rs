//! The Panoscope runtime: loader, scheduler, parameters, timing.
