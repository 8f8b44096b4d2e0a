//! What the editor and the theatre know of a graph: its text, the running graph, what is seen of it. Nothing here draws.
//!
//! The graph file's text is the truth ([`document`]); a session ([`session`]) makes the running graph what the text says, one transaction
//! after the other. An observer ([`observe`]) takes pictures and counters off the window's thread.

pub mod content;
pub mod disk;
pub mod document;
pub mod history;
pub mod layout;
mod mark;
pub mod numbered;
pub mod observe;
pub mod ops;
pub mod picture;
pub mod session;
pub mod surface;
pub mod sweeping;

pub use mark::Mark;
