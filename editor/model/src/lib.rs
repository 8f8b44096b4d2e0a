//! The model of a graph behind the editor and the theatre: its text, the running graph, previews of its outputs. It draws nothing and does
//! not depend on egui.
//!
//! The graph file's text is the only state ([`document`]). A session ([`session`]) changes the running graph to match the text, one
//! transaction after the other. An observer ([`observe`]) renders previews and reads counters on a thread of its own.

pub mod arguments;
pub mod attaching;
pub mod comparing;
pub mod computing;
pub mod content;
pub mod copying;
pub mod difference;
pub mod disk;
pub mod docks;
pub mod document;
mod entries;
pub mod examples;
pub mod first_previews;
pub mod folding;
pub mod graph_view;
pub mod history;
pub mod idle;
pub mod layout;
mod mark;
pub mod numbered;
pub mod observe;
pub mod ops;
pub mod output;
pub mod pedal;
pub mod picture;
pub mod pixels;
pub mod playing;
pub mod presets;
pub mod probe;
pub mod problems;
pub mod session;
pub mod snapshots;
pub mod surface;
pub mod sweeping;
pub mod texts;
pub mod timeline;
pub mod trace;

pub use mark::Mark;
