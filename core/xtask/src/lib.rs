//! Set-up, demo, tests and generated files of Panoscope.
