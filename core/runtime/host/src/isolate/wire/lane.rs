//! The messages between the host and a process of isolated nodes: those of the socket, and those of a lane.

use panoscope_abi::{BufferId, Frame, PortRange, Tick};
use panoscope_engine::isolation::Deny;

use super::{BadMessage, Params, fields, message, whole};
use crate::isolate::PROTOCOL;

macro_rules! kinds {
    ($($(#[$doc:meta])* $number:literal => $name:ident),* $(,)?) => {
        /// Kind of a message of a lane.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u32)]
        pub(crate) enum Kind { $($(#[$doc])* $name = $number),* }

        impl Kind {
            pub fn of(number: u32) -> Option<Self> {
                match number {
                    $($number => Some(Self::$name),)*
                    _ => None,
                }
            }
        }
    };
}

kinds! {
    // From the host.
    /// [`Open`].
    1 => Open,
    /// [`TickRequest`].
    2 => Process,
    3 => Close,
    4 => SaveState,
    /// A part of a state, as bytes.
    5 => LoadPart,
    6 => LoadState,
    7 => Finish,
    /// The number of a plugin.
    8 => Describe,
    /// [`Validate`].
    9 => Validate,
    /// The result of a host function.
    10 => Answer,

    // From the child. Each message begins with the deferred functions, as bytes.
    /// The status, and what the request asked for: [`TickDone`], a description, a list of [`Problem`].
    100 => Done,
    /// [`Wanted`]; answered by [`Made`].
    101 => Alloc,
    /// [`Forwarded`]; answered by [`Made`].
    102 => Forward,
    /// [`CopyWanted`]; answered by [`Made`].
    103 => MakeMut,
    /// A buffer.
    104 => Retain,
    /// A buffer.
    105 => Release,
    /// A level, and a text as bytes.
    106 => Log,
    /// A text as bytes.
    107 => Fail,
    /// A name as bytes, and a number.
    108 => Metric,
    /// An action, and a path as bytes; answered by a status, and a path as bytes.
    109 => ClaimFile,
    /// Answered by ns of the host's clock, as the next four.
    110 => Clock,
    /// Ns of the host's clock.
    111 => SetArrived,
    /// The number of an input.
    112 => Arrived,
    /// The number of an input.
    113 => Age,
    /// Ns.
    114 => SetLag,
    /// A part of a state, as bytes.
    115 => Save,
    /// [`Wanted`]: an output in a buffer of the stock.
    116 => Placed,
    /// The number of an output, which is copied into a buffer of the stock.
    117 => Copied,
    /// Only the deferred functions.
    118 => Flush,
}

impl Kind {
    /// Whether the child may defer it instead of asking, because its result is not needed.
    pub fn is_deferred(self) -> bool {
        use Kind::{Copied, Forward, Metric, Placed, Release, Retain, SetArrived, SetLag};
        matches!(self, Placed | Copied | Forward | Retain | Release | Metric | SetArrived | SetLag)
    }
}

message! {
    /// A message from the host on the socket.
    #[derive(Debug)]
    pub(crate) enum ToChild {
        /// First message.
        1 => Hello { protocol: u32, settings: Settings },
        /// A pool, with its file. `is_own`: the child writes it.
        2 => Pool { number: u32, len: u64, is_own: bool },
        /// A lane, with its file.
        3 => Lane,
        /// A plugin, with its file; `path` is for messages.
        4 => Plugin { id: u32, path: Vec<u8> },
    }
}

/// Settings of a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Threads of its parallel loops.
    pub threads: u32,
    /// Maximum number of bytes of private memory.
    pub memory_bytes: u64,
    /// Operations denied to it.
    pub deny: Deny,
}

fields!(Deny { network: bool, new_files: bool });
fields!(Settings { threads: u32, memory_bytes: u64, deny: Deny });

/// Reads the first message of a host.
///
/// # Errors
/// The host is of another version.
pub(crate) fn hello(message: &[u8]) -> std::io::Result<Settings> {
    match whole(message) {
        Ok(ToChild::Hello { protocol: PROTOCOL, settings }) => Ok(settings),
        _ => Err(std::io::Error::other("the programs have different versions; install both again")),
    }
}

message! {
    /// The request to open an instance.
    #[derive(Clone, Debug)]
    pub(crate) struct Open {
        pub plugin: u32,
        /// Number of the node type in its plugin.
        pub index: u32,
        pub flags: u32,
        pub threads: u32,
        pub outputs_read: u64,
        pub node: String,
        pub graph_dir: String,
        pub params: Params,
        /// For a link: the parameters that name files which the node reads.
        pub reads: Vec<u32>,
    }
}

message! {
    /// The request to check parameters and wiring.
    #[derive(Debug)]
    pub(crate) struct Validate {
        pub plugin: u32,
        pub index: u32,
        pub flags: u32,
        pub node: String,
        pub graph_dir: String,
        pub params: Params,
        pub connections: Vec<u32>,
        pub outputs_read: u64,
    }
}

message! {
    /// A problem that a check found.
    #[derive(Debug)]
    pub(crate) struct Problem {
        pub severity: u32,
        pub param: u32,
        pub message: Vec<u8>,
        pub help: Vec<u8>,
    }
}

message! {
    /// The request of a tick, with data that the node is likely to ask for.
    #[derive(Clone, Debug, Default)]
    pub(crate) struct TickRequest {
        pub flags: u32,
        pub tick: Tick,
        pub outputs_read: u64,
        pub params_version: u64,
        /// When they are not those of the last request.
        pub params: Option<Params>,
        pub ranges: Vec<PortRange>,
        pub inputs: Vec<Frame>,
        /// For each output.
        pub stock: Vec<Reserved>,
        pub clock: Option<Clock>,
        pub ages: Vec<Age>,
        /// For a link: the use count of each input's buffer, which tells which frames the other machine has already.
        pub uses: Vec<u32>,
    }
}

message! {
    /// A buffer for an output.
    #[derive(Clone, Copy, Debug, Default)]
    pub(crate) struct Reserved {
        pub buffer: BufferId,
        /// Its size in bytes; 0 for none.
        pub len: u64,
    }
}

message! {
    /// The host's clock and the system's at the same moment, ns.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Clock {
        pub host_ns: i64,
        pub system_ns: i64,
    }
}

message! {
    /// Arrival and age of an input.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Age {
        pub input: u32,
        pub arrived_ns: i64,
        pub age_ns: i64,
    }
}

message! {
    /// The result of a tick after its status.
    #[derive(Debug, Default)]
    pub(crate) struct TickDone {
        /// The tick as changed by the node.
        pub tick: Tick,
        /// The outputs as changed by the node.
        pub outputs: Vec<Frame>,
        /// Position of a source; empty for none.
        pub position: Vec<u8>,
    }
}

message! {
    /// A frame that the node makes.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Wanted {
        pub output: u32,
        pub format: u32,
        pub width: u32,
        pub height: u32,
        pub stride_bytes: u32,
        pub len: u64,
    }
}

message! {
    /// A frame that the node hands on.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Forwarded {
        pub output: u32,
        /// Whether the address that the node gave was that of the buffer.
        pub is_buffer: bool,
        pub frame: Frame,
    }
}

message! {
    /// An output that the node wants a copy of. The frame is for a relay between two machines; the host knows it.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct CopyWanted {
        pub output: u32,
        pub frame: Frame,
    }
}

message! {
    /// The output that the host made, unless the status is an error.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Made {
        pub status: i32,
        pub frame: Frame,
    }
}

/// A message of a process after its deferred functions.
pub(crate) fn after_deferred(message: &[u8]) -> Result<super::Reader<'_>, BadMessage> {
    let mut reader = super::Reader(message);
    reader.bytes()?;
    Ok(reader)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::isolate::wire::Wire;

    #[test]
    fn kinds_have_their_numbers() {
        assert!(Kind::of(99).is_none() && Kind::of(103) == Some(Kind::MakeMut) && Kind::of(0).is_none());
        assert!(Kind::of(Kind::Flush as u32 + 1).is_none() && Kind::of(Kind::Answer as u32 + 1).is_none());
    }

    #[test]
    fn a_request_is_read_into_the_memory_of_the_last_one() {
        let input = Frame { len: 12, ..Frame::EMPTY };
        let request = |inputs: usize, params| TickRequest {
            params,
            inputs: vec![input; inputs],
            uses: vec![7; inputs],
            clock: Some(Clock { host_ns: -1, system_ns: 2 }),
            ..TickRequest::default()
        };
        let (mut first, mut second) = (Vec::new(), Vec::new());
        request(3, Some(Params::default())).put(&mut first);
        request(1, None).put(&mut second);
        let mut read = whole::<TickRequest>(&first).expect("a request");
        let place = read.inputs.as_ptr();
        read.refill(&mut super::super::Reader(&second)).expect("a request");
        assert_eq!((read.inputs.as_ptr(), read.inputs.len(), &read.uses[..]), (place, 1, &[7][..]));
        assert!(read.params.is_none() && read.clock.is_some_and(|clock| clock.host_ns == -1));
        assert!(whole::<TickRequest>(&first[..first.len() - 1]).is_err());
    }

    #[test]
    fn a_host_of_another_version_is_refused() {
        let settings = Settings { threads: 2, memory_bytes: 1 << 30, deny: Deny { network: true, new_files: false } };
        let message = |protocol| {
            let mut bytes = Vec::new();
            ToChild::Hello { protocol, settings }.put(&mut bytes);
            bytes
        };
        let read = hello(&message(PROTOCOL)).expect("settings");
        assert!(read.threads == 2 && read.deny.network && !read.deny.new_files);
        assert!(
            hello(&message(PROTOCOL + 1)).is_err() && hello(&message(PROTOCOL)[..9]).is_err() && hello(&[]).is_err()
        );
    }
}
