//! The panoscope command.
