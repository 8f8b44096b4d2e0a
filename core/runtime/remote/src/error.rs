//! Errors of the processes that link machines.

use std::io;
use std::num::{ParseIntError, TryFromIntError};
use std::path::{Path, PathBuf};
use std::time::Duration;

use panoscope_host::isolate::relay::messages::BadMessage;
use panoscope_host::isolate::relay::{RelayError, ServeError};

use crate::files::FileError;
use crate::h264::Unusable;
use crate::keys::KeysError;
use crate::network::NetworkError;

/// A link, a server or a connection of a window that ended or did not start.
#[derive(Debug, thiserror::Error)]
pub enum RemoteError {
    /// A user started a program that needs the socket of its parent.
    #[error("other programs of Panoscope start this one")]
    NoParent,
    /// An argument is not a number.
    #[error("{text}: {cause}")]
    NotANumber {
        /// The argument.
        text: String,
        /// Description of the problem.
        cause: ParseIntError,
    },
    /// A path that cannot be made absolute.
    #[error("{path}: {cause}")]
    Path {
        /// The path.
        path: String,
        /// The system's error.
        cause: io::Error,
    },
    /// A name with other characters than a machine's name may have.
    #[error("`{name}` cannot name a machine: a name has letters, digits, _ and -")]
    BadName {
        /// The name.
        name: String,
    },
    /// A server without hosts.
    #[error("no host may run nodes here; give their names with --allow, as in --allow theatre")]
    NoHosts,
    /// A graph that no window may attach to.
    #[error("no machine may attach; give the names of machines with --allow-read or --allow-edit")]
    NoWindows,
    /// TLS without keys.
    #[error("there is no folder of keys: set PANOSCOPE_KEYS")]
    NoKeys,
    /// Keys that cannot be read; `remedy` says how to make some.
    #[error("{cause}; {remedy}")]
    UnreadableKeys {
        /// Description of the problem.
        cause: KeysError,
        /// What to do.
        remedy: &'static str,
    },
    /// Keys that cannot be made.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// Nothing listens at the address.
    #[error("nothing responds at {address} within {} s: {cause}; is `{command}` running there?", timeout.as_secs_f64())]
    NoAnswer {
        /// Address on which the machine should listen.
        address: String,
        /// Time in which it counts as lost.
        timeout: Duration,
        /// Error of the last attempt.
        cause: String,
        /// The command that listens there.
        command: &'static str,
    },
    /// The machine closes the connection.
    #[error(
        "{address} refuses the connection: {cause}{}",
        if *is_tls { "; both need certificates of one authority, and that of the machine must name this address" } else { "" }
    )]
    Refused {
        /// Address of the machine.
        address: String,
        /// The network's error.
        cause: NetworkError,
        /// Whether certificates were exchanged.
        is_tls: bool,
    },
    /// The machine listens but does not answer the greeting.
    #[error(
        "it did not respond within {} s: `panoscope serve` there has another --name than `{machine}`, or does not --allow this host",
        timeout.as_secs_f64()
    )]
    NoGreeting {
        /// The machine's name in the graph.
        machine: String,
        /// Time in which it counts as lost.
        timeout: Duration,
    },
    /// Two builds with different protocols.
    #[error("the versions differ: {host} on the host, {own} on `{machine}`; install the same on both")]
    Version {
        /// Version of the host.
        host: String,
        /// Version of this machine.
        own: String,
        /// This machine.
        machine: String,
    },
    /// This machine cannot encode pixels as the graph requires.
    #[error("{cause} on `{machine}`")]
    Pixels {
        /// What is missing.
        cause: Unusable,
        /// This machine.
        machine: String,
    },
    /// A host that is silent for too long.
    #[error("the host was silent for {} s", silence.as_secs_f64())]
    HostSilent {
        /// Time without a message.
        silence: Duration,
    },
    /// More instances than a group may have.
    #[error("more than {max} instances at a time")]
    TooManyLanes {
        /// Maximum number of instances.
        max: usize,
    },
    /// A plugin that this machine lacks.
    #[error("plugin {} (SHA-256 {sha256} on the host) is not installed on `{machine}`: put it into one of {folders}", path.display())]
    PluginMissing {
        /// The plugin's file on the host.
        path: PathBuf,
        /// Its hash.
        sha256: String,
        /// This machine.
        machine: String,
        /// Folders of plugins on this machine.
        folders: String,
    },
    /// A plugin that cannot be read.
    #[error("plugin {} on `{machine}`: {cause}", file.display())]
    PluginUnreadable {
        /// The plugin's file here.
        file: PathBuf,
        /// This machine.
        machine: String,
        /// The system's error.
        cause: io::Error,
    },
    /// The plugin differs between the machines.
    #[error(
        "plugin {} differs: SHA-256 {sha256} on the host, {own} on `{machine}` ({}); install the same build on both",
        path.display(),
        file.display()
    )]
    PluginDiffers {
        /// The plugin's file on the host.
        path: Box<Path>,
        /// Its hash there.
        sha256: Box<str>,
        /// The hash of the file here.
        own: Box<str>,
        /// This machine.
        machine: Box<str>,
        /// The plugin's file here.
        file: Box<Path>,
    },
    /// Files of a node that differ from the host's.
    #[error("node `{node}`: {cause}")]
    Files {
        /// The node.
        node: String,
        /// Description of the difference.
        cause: Box<FileError>,
    },
    /// The process that runs the nodes has ended.
    #[error("{reason}")]
    ProcessEnded {
        /// Reason reported by the host.
        reason: String,
    },
    /// The process that runs the nodes sent a malformed message.
    #[error("its process sent a malformed message")]
    BadProcess,
    /// A malformed message of the host.
    #[error("the host sent a malformed message: {cause}")]
    BadHost {
        /// Description of the problem.
        cause: Box<RemoteError>,
    },
    /// A lane of this host that has to end.
    #[error("its link cannot continue: {cause}")]
    Lane {
        /// Reason.
        cause: Box<RemoteError>,
    },
    /// A malformed message of the other machine.
    #[error(transparent)]
    BadMessage(#[from] BadMessage),
    /// A malformed message of a process of this machine.
    #[error(transparent)]
    Relay(#[from] RelayError),
    /// A size that this machine cannot address.
    #[error(transparent)]
    Size(#[from] TryFromIntError),
    /// The process that runs the nodes does not start.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// An error of the network.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// An error of zenoh.
    #[error(transparent)]
    Zenoh(#[from] zenoh::Error),
    /// An error of the system.
    #[error(transparent)]
    System(#[from] io::Error),
}
