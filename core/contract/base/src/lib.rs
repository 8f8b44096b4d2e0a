//! Shared definitions of all Panoscope crates.
//!
//! - [`packet`]: decodes the packets of the contract from untrusted bytes.
//! - [`format`]: names, ids and sizes of the pixel formats.
//! - [`View`], [`ViewMut`], [`Rect`]: borrowed images and rectangles in px.
//! - [`Parallel`]: how a kernel splits its work without knowing whose threads run it.
//! - [`Simd`]: which instruction set a kernel may use.
//! - [`onnx`]: which files hold the weights of a model, where ONNX Runtime is.
//! - [`files`]: creates and replaces output files.
//! - [`program`]: where the installation is that the running process belongs to.
//! - [`secret`]: hides user and password of addresses; reads them from the environment.
//! - [`web`]: which requests of a browser a server may answer.
//! - [`gray`], [`random`], [`Report`]: gray conversion, reproducible random numbers, where algorithms report to.
//!
//! The crate sees only the contract. Unsafe code is confined to the two modules that opt in below.
#![deny(unsafe_code)]

pub mod files;
pub mod format;
#[expect(unsafe_code, reason = "AVX2 loads and stores go through pointers")]
pub mod gray;
pub mod onnx;
pub mod packet;
pub mod parallel;
pub mod program;
pub mod random;
pub mod rect;
pub mod report;
pub mod secret;
pub mod simd;
#[expect(unsafe_code, reason = "threads that outlive one loop borrow the loop's body")]
pub mod threads;
pub mod view;
pub mod web;

pub use parallel::{Parallel, Serial};
pub use rect::Rect;
pub use report::{Report, Silent};
pub use simd::Simd;
pub use threads::Threads;
pub use view::{View, ViewMut};
