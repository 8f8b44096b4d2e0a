//! DDS: participants, and readers and writers of encoded messages.

use std::net::Ipv4Addr;
use std::os::fd::BorrowedFd;

use panoscope_ros::cdr::{self, Message};
use panoscope_ros::names;
use rustdds::bytes::Bytes;
use rustdds::no_key::{DataReader, DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use rustdds::policy::{Durability, History, Reliability};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, Duration, Publisher, QosPolicies, QosPolicyBuilder,
    RepresentationIdentifier, Subscriber, TopicKind,
};
use serde::Serialize;
use socket2::{SockRef, Type};

use crate::Networks;

/// First port of domain 0.
const FIRST_PORT: u16 = 7400;
/// Number of ports per domain.
const PORTS: u16 = 250;
/// Highest domain that has valid ports.
pub const MAX_DOMAIN: u16 = 232;

/// Why DDS cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum DdsError {
    /// The domain cannot be joined.
    #[error("cannot join DDS domain {domain}: {words}")]
    Join { domain: u16, words: String },
    /// A socket cannot be restricted to this machine.
    #[error("cannot bind the sockets of DDS to the loopback device: {words}; `networks = \"all\"` does not need that")]
    Confine { words: String },
    /// A topic cannot be created.
    #[error("cannot create topic `{topic}`: {words}")]
    Topic { topic: String, words: String },
    /// A message cannot be encoded or sent.
    #[error("topic `{topic}`: a message was not sent: {words}")]
    Send { topic: String, words: String },
}

/// Quality of service of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quality {
    /// Whether lost messages are sent again.
    pub is_reliable: bool,
    /// Number of messages that are kept for slow readers.
    pub depth: u16,
}

impl Quality {
    fn policies(self) -> QosPolicies {
        let reliability = if self.is_reliable {
            Reliability::Reliable { max_blocking_time: Duration::from_millis(100) }
        } else {
            Reliability::BestEffort
        };
        QosPolicyBuilder::new()
            .reliability(reliability)
            .durability(Durability::Volatile)
            .history(History::KeepLast { depth: i32::from(self.depth) })
            .build()
    }
}

/// An encoded message: the identifier of its encoding, and the fields.
pub struct Encoded {
    /// Identifier of the encoding, as in the CDR header.
    pub number: u16,
    /// The encoded fields.
    pub body: Bytes,
}

/// Passes encoded messages through unchanged.
pub struct Plain;

impl SerializerAdapter<Encoded> for Plain {
    type Error = std::convert::Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Encoded) -> Result<Bytes, Self::Error> {
        Ok(value.body.clone())
    }
}

impl DeserializerAdapter<Encoded> for Plain {
    type Error = std::convert::Infallible;
    type Decoded = Encoded;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: Encoded) -> Encoded {
        decoded
    }
}

/// Decoder of [`Plain`]: copies the bytes.
#[derive(Clone)]
pub struct CopyDecoder;

impl<'de> Decode<'de, Encoded> for CopyDecoder {
    type Error = std::convert::Infallible;

    fn decode_bytes(self, bytes: &'de [u8], encoding: RepresentationIdentifier) -> Result<Encoded, Self::Error> {
        let number = u16::from(encoding == RepresentationIdentifier::CDR_LE);
        Ok(Encoded { number, body: Bytes::copy_from_slice(bytes) })
    }
}

impl DefaultDecoder<Encoded> for Plain {
    type Decoder = CopyDecoder;

    const DECODER: CopyDecoder = CopyDecoder;
}

/// A writer of one topic.
pub struct TopicWriter {
    topic: String,
    writer: DataWriter<Encoded, Plain>,
}

impl TopicWriter {
    /// Sends a message.
    ///
    /// # Errors
    /// The message cannot be encoded or sent.
    pub fn send<M: Message + Serialize>(&self, message: &M) -> Result<(), DdsError> {
        let failed = |words: String| DdsError::Send { topic: self.topic.clone(), words };
        let body = cdr::encode_body(message).map_err(|error| failed(error.to_string()))?;
        self.writer.write(Encoded { number: 1, body: body.into() }, None).map_err(|error| failed(error.to_string()))
    }
}

/// A reader of one topic.
pub type TopicReader = DataReader<Encoded, Plain>;

/// A participant in a domain.
pub struct Member {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
}

impl Member {
    /// Joins a domain.
    ///
    /// # Errors
    /// There are no sockets, or they cannot be restricted to this machine.
    pub fn join(domain: u16, networks: Networks) -> Result<Self, DdsError> {
        let failed = |words: String| DdsError::Join { domain, words };
        let mut builder = DomainParticipantBuilder::new(domain);
        if networks == Networks::Loopback {
            builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
        }
        let participant = builder.build().map_err(|error| failed(error.to_string()))?;
        if networks == Networks::Loopback {
            confine(domain)?;
        }
        let policies = QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&policies).map_err(|error| failed(error.to_string()))?;
        let subscriber = participant.create_subscriber(&policies).map_err(|error| failed(error.to_string()))?;
        Ok(Self { participant, publisher, subscriber })
    }

    fn topic(&self, topic: &str, message: &str, quality: Quality) -> Result<rustdds::Topic, DdsError> {
        let (name, kind) = (names::dds_topic(topic), names::dds_type(message));
        self.participant
            .create_topic(name, kind, &quality.policies(), TopicKind::NoKey)
            .map_err(|error| DdsError::Topic { topic: topic.to_owned(), words: error.to_string() })
    }

    /// Creates a writer of messages `M`.
    ///
    /// # Errors
    /// The topic cannot be created.
    pub fn writer<M: Message>(&self, topic: &str, quality: Quality) -> Result<TopicWriter, DdsError> {
        let failed = |words: String| DdsError::Topic { topic: topic.to_owned(), words };
        let dds = self.topic(topic, M::TYPE, quality)?;
        let writer = self.publisher.create_datawriter_no_key(&dds, None).map_err(|error| failed(error.to_string()))?;
        Ok(TopicWriter { topic: topic.to_owned(), writer })
    }

    /// Creates a reader of messages of the type `message`.
    ///
    /// # Errors
    /// The topic cannot be created.
    pub fn reader(&self, topic: &str, message: &str, quality: Quality) -> Result<TopicReader, DdsError> {
        let failed = |words: String| DdsError::Topic { topic: topic.to_owned(), words };
        let dds = self.topic(topic, message, quality)?;
        self.subscriber.create_datareader_no_key(&dds, None).map_err(|error| failed(error.to_string()))
    }
}

/// Binds the sockets of a domain to the loopback device. rustdds itself listens on all addresses, whatever networks it announces.
fn confine(domain: u16) -> Result<(), DdsError> {
    let failed = |words: String| DdsError::Confine { words };
    let ports = FIRST_PORT + PORTS * domain..FIRST_PORT + PORTS * domain + PORTS;
    let all = std::fs::read_dir("/proc/self/fd").map_err(|error| failed(error.to_string()))?;
    let numbers = all.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    let mut bound = 0;
    for number in numbers {
        // SAFETY: the number was listed as open just now and is borrowed for this step only. Another thread could close it meanwhile and open
        // something else under the number: the port is compared before anything is changed, and only sockets of this domain have it.
        let file = unsafe { BorrowedFd::borrow_raw(number) };
        let socket = SockRef::from(&file);
        let is_udp = socket.r#type().is_ok_and(|kind| kind == Type::DGRAM);
        let port = socket.local_addr().ok().and_then(|address| address.as_socket()).map(|address| address.port());
        if is_udp && port.is_some_and(|port| ports.contains(&port)) {
            socket.bind_device(Some(&b"lo"[..])).map_err(|error| failed(error.to_string()))?;
            bound += 1;
        }
    }
    if bound == 0 {
        return Err(failed("none of its sockets was found".to_owned()));
    }
    Ok(())
}
