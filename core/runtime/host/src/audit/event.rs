//! Events of the log.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The lock under which a graph was opened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockFacts {
    /// SHA-256 of the lock's content.
    pub sha256: String,
    /// Name of the key that signed it; `None` for a lock without signature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signed_by: Option<String>,
}

/// State of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClipState {
    /// Its recording began.
    Started,
    /// The user ended it.
    Ended,
    /// It could not be started, or ended early.
    Failed,
}

/// An event of the theatre, or of the log itself. No field holds what a user types: clips and stills are named by their
/// numbers, faults by their causes.
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
        /// The lock that it agrees with; `None` if there is none or it differs.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lock: Option<LockFacts>,
    },
    /// The user overrode a protection.
    Override {
        /// The option used, such as `--unlocked`.
        by: String,
        /// The protection that it overrode.
        reason: String,
    },
    /// The theatre did not open a graph.
    Refused {
        /// Name of the graph file.
        graph: String,
        /// Reason.
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
        /// The program's response.
        done: String,
    },
    /// A clip.
    Clip {
        /// Its number.
        number: u32,
        /// State of the clip.
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
        /// Its end.
        cause: String,
    },
    /// The user started the whole graph again.
    Restarted,
    /// The window was closed.
    Closed,
    /// Events could not be written, and there were too many to keep.
    Lost {
        /// Number of lost events.
        count: u64,
    },
    /// A crash truncated a line.
    Recovered {
        /// Length of the rest of the line, bytes.
        cut_bytes: u64,
        /// SHA-256 of the rest of the line.
        cut_sha256: String,
    },
    /// The log was found damaged when it was continued.
    Damaged {
        /// Description of the damage.
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
