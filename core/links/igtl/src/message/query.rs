//! Requests for data and their answers: GET_, STT_, STP_, RTS_.

use crate::error::{IgtlError, Result};

use super::small::TrackingStart;

/// Action of a request, or the answer to one.
#[derive(Clone, Debug, PartialEq)]
pub enum Verb<'a> {
    /// `GET_`: one message.
    Get,
    /// `STT_`: continuous messages. The bytes are the type's own options; see [`Query::interval_ns`].
    Start(&'a [u8]),
    /// `STT_TDATA`: continuous tracking data.
    StartTracking(TrackingStart<'a>),
    /// `STP_`: no more messages.
    Stop,
    /// `RTS_`: answer to `STT_` and `STP_`.
    Answer {
        /// Whether it was granted.
        is_granted: bool,
    },
}

/// A request or its answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Query<'a> {
    /// Action or answer.
    pub verb: Verb<'a>,
    /// Message type as requests name it; see [`query_name`].
    pub kind: String,
}

/// Name of a message type in requests: types of more than 8 letters are shortened, so that `GET_` fits before them.
pub fn query_name(kind: &str) -> &str {
    match kind {
        "TRANSFORM" => "TRANS",
        "CAPABILITY" => "CAPABIL",
        other => other,
    }
}

const PREFIXES: [&str; 4] = ["GET_", "STT_", "STP_", "RTS_"];

impl<'a> Query<'a> {
    /// A request about messages of type `kind`, such as `TRANSFORM`.
    pub fn new(verb: Verb<'a>, kind: &str) -> Self {
        Self { verb, kind: query_name(kind).to_owned() }
    }

    /// Name of the request's own message type.
    pub fn name(&self) -> String {
        let prefix = match self.verb {
            Verb::Get => "GET_",
            Verb::Start(_) | Verb::StartTracking(_) => "STT_",
            Verb::Stop => "STP_",
            Verb::Answer { .. } => "RTS_",
        };
        format!("{prefix}{}", self.kind)
    }

    /// The message type that the request is about; `None` for types that this crate does not know.
    pub fn subject(&self) -> Option<&'static str> {
        super::KINDS.into_iter().find(|kind| query_name(kind) == self.kind)
    }

    /// Minimum time between messages that a start requests, ns; 0 if it has none.
    pub fn interval_ns(&self) -> u64 {
        match &self.verb {
            Verb::StartTracking(start) => u64::from(start.interval_ms.max(0) as u32) * 1_000_000,
            // As a timestamp: seconds and fraction.
            Verb::Start(options) => match options.first_chunk::<8>() {
                Some(bytes) => {
                    u64::try_from(crate::Timestamp::from_bits(u64::from_be_bytes(*bytes)).unix_ns()).unwrap_or(0)
                }
                None => 0,
            },
            _ => 0,
        }
    }

    /// Reads the content of a message of type `name`; `None` if it is not a request.
    pub(super) fn decode(name: &str, bytes: &'a [u8]) -> Result<Option<Self>> {
        let Some(prefix) = PREFIXES.into_iter().find(|prefix| name.starts_with(prefix)) else { return Ok(None) };
        let kind = name[prefix.len()..].to_owned();
        let verb = match prefix {
            "GET_" => Verb::Get,
            "STT_" if kind == "TDATA" && !bytes.is_empty() => Verb::StartTracking(TrackingStart::decode(bytes)?),
            "STT_" => Verb::Start(bytes),
            "STP_" => Verb::Stop,
            _ => match bytes {
                [status] => Verb::Answer { is_granted: *status == 0 },
                _ => {
                    return Err(IgtlError::Length { kind: "RTS_", bytes: bytes.len(), expected: "1".to_owned() });
                }
            },
        };
        Ok(Some(Self { verb, kind }))
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<()> {
        match &self.verb {
            Verb::Get | Verb::Stop => {}
            Verb::Start(options) => out.extend_from_slice(options),
            Verb::StartTracking(start) => start.encode(out)?,
            Verb::Answer { is_granted } => out.push(u8::from(!is_granted)),
        }
        Ok(())
    }
}
