//! What the log records.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The lock under which a graph was opened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockFacts {
    /// SHA-256 of what the lock says.
    pub sha256: String,
    /// Name of the key that signed it; `None` for a lock without signature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signed_by: Option<String>,
}

/// What became of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClipState {
    /// It is being recorded.
    Started,
    /// It was ended by the user.
    Ended,
    /// It could not be started, or ended early.
    Failed,
}

/// An event of the theatre, or of the log itself. No field holds what a user types: clips and stills are named by their numbers, faults by
/// their causes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// A graph was opened.
    Opened {
        /// Version of the program.
        program: String,
        /// Name of the graph file.
        graph: String,
        /// SHA-256 of the text that runs, with parts, overlays and arguments.
        graph_sha256: String,
        /// The lock that it was compared with and agrees with; `None` where there is none, or it differs.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lock: Option<LockFacts>,
    },
    /// A protection was overridden by the user.
    Override {
        /// How, such as `--unlocked`.
        by: String,
        /// What it overrode.
        reason: String,
    },
    /// The theatre did not open a graph.
    Refused {
        /// Name of the graph file.
        graph: String,
        /// Why.
        reason: String,
    },
    /// A setting was changed.
    Setting {
        /// The node.
        node: String,
        /// Its parameter.
        param: String,
        /// The new value.
        value: String,
    },
    /// A node had a fault.
    Fault {
        /// The node.
        node: String,
        /// The kind of the fault.
        cause: String,
        /// What the program did about it.
        done: String,
    },
    /// A clip.
    Clip {
        /// Its number.
        number: u32,
        /// What became of it.
        state: ClipState,
    },
    /// A still was requested.
    Still {
        /// Its number.
        number: u32,
    },
    /// The emergency stop of the arm was set or released.
    EmergencyStop {
        /// Whether the arm is stopped.
        stopped: bool,
    },
    /// The graph could not run, and the cameras are shown alone.
    CamerasOnly,
    /// The process that ran the graph ended; another one shows the cameras and starts the graph again.
    ProcessEnded {
        /// How it ended.
        cause: String,
    },
    /// The user started the whole graph again.
    Restarted,
    /// The window was closed.
    Closed,
    /// Events could not be written, and there were too many to keep.
    Lost {
        /// How many.
        count: u64,
    },
    /// A crash cut a line off.
    Recovered {
        /// Length of what is left of the line, bytes.
        cut_bytes: u64,
        /// SHA-256 of what is left of it.
        cut_sha256: String,
    },
    /// The log was found damaged when it was continued.
    Damaged {
        /// What is wrong.
        reason: String,
    },
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Opened { program, graph, graph_sha256, lock } => {
                let sha256 = graph_sha256.get(..16).unwrap_or(graph_sha256);
                write!(f, "opened {graph} ({sha256}) with version {program}, ")?;
                match lock {
                    None => write!(f, "not locked"),
                    Some(LockFacts { sha256, signed_by }) => {
                        write!(f, "as locked ({})", sha256.get(..16).unwrap_or(sha256))?;
                        match signed_by {
                            Some(key) => write!(f, ", signed by {key}"),
                            None => write!(f, ", not signed"),
                        }
                    }
                }
            }
            Self::Override { by, reason } => write!(f, "overridden by {by}: {reason}"),
            Self::Refused { graph, reason } => write!(f, "refused {graph}: {reason}"),
            Self::Setting { node, param, value } => write!(f, "set {node}.{param} to {value}"),
            Self::Fault { node, cause, done } => write!(f, "fault of {node}: {cause}; {done}"),
            Self::Clip { number, state } => {
                let state = match state {
                    ClipState::Started => "started",
                    ClipState::Ended => "ended",
                    ClipState::Failed => "failed",
                };
                write!(f, "clip {number} {state}")
            }
            Self::Still { number } => write!(f, "still {number}"),
            Self::EmergencyStop { stopped: true } => write!(f, "emergency stop"),
            Self::EmergencyStop { stopped: false } => write!(f, "arm released"),
            Self::CamerasOnly => write!(f, "the graph does not run: cameras only"),
            Self::ProcessEnded { cause } => write!(f, "the image processing {cause} and is restarted"),
            Self::Restarted => write!(f, "graph started again"),
            Self::Closed => write!(f, "closed"),
            Self::Lost { count } => write!(f, "{count} events could not be written and are lost"),
            Self::Recovered { cut_bytes, .. } => {
                write!(f, "continued after a crash, which left {cut_bytes} bytes of a line")
            }
            Self::Damaged { reason } => write!(f, "continued although the log is damaged: {reason}"),
        }
    }
}
