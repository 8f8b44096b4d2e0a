//! An association: commands and data sets to a server, and its responses.

use std::io::Read;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use dicom_transfer_syntax_registry::entries::{EXPLICIT_VR_LITTLE_ENDIAN, IMPLICIT_VR_LITTLE_ENDIAN};
use dicom_ul::association::Error as UlError;
use dicom_ul::association::client::{ClientAssociation, ClientAssociationOptions};
use dicom_ul::pdu::{PDataValue, PDataValueType, Pdu};

use super::Peer;
use crate::dicom::element::{Set, read_number};
use crate::dicom::error::{DicomError, Result, chain};
use crate::dicom::lengths::{self, Encoding, LengthError};
use crate::dicom::part10::MAX_ENTRY_BYTES;

const CONNECT_WAIT: Duration = Duration::from_secs(10);
/// Maximum silence of a server, which may take long to store a video.
const ANSWER_WAIT: Duration = Duration::from_secs(60);
/// Maximum wait for the answer to an association request, which needs no search.
const ASSOCIATE_WAIT: Duration = Duration::from_secs(10);
/// Maximum time for one complete response.
const RESPONSE_WAIT: Duration = Duration::from_secs(120);
/// Maximum number of bytes of a PDU, both ways.
const MAX_PDU: u32 = 64 << 10;
/// Fewest bytes of a PDU that a server may ask for.
const MIN_PDU: u32 = 512;
/// Head of a presentation data value: length, context, control.
const VALUE_HEAD: usize = 6;
/// Maximum number of bytes of a command set.
const MAX_COMMAND_BYTES: usize = 16 << 10;
/// Data set type of a command without a data set.
const NO_DATA: u16 = 0x0101;

/// A response.
pub struct Response {
    /// Its command set.
    pub command: Set,
    /// Its data set; empty where it has none.
    pub data: Vec<u8>,
}

/// An open association.
pub struct Association {
    link: ClientAssociation<TcpStream>,
    peer: Peer,
    messages: u16,
    /// Maximum number of bytes of a presentation data value that the server accepts.
    chunk: usize,
}

impl Association {
    /// Opens an association with presentation contexts: SOP classes, each with transfer syntaxes.
    ///
    /// # Errors
    /// The server does not answer or refuses.
    pub fn open(peer: &Peer, contexts: &[(&str, &[&str])]) -> Result<Self> {
        let (calling, called) = (peer.calling.to_string(), peer.called.to_string());
        let mut options = ClientAssociationOptions::new()
            .calling_ae_title(calling)
            .called_ae_title(called)
            .max_pdu_length(MAX_PDU)
            .strict(true)
            .connection_timeout(CONNECT_WAIT)
            .read_timeout(ASSOCIATE_WAIT)
            .write_timeout(ANSWER_WAIT);
        for (class, syntaxes) in contexts {
            // One context for each syntax, so that the server's choice is known for each.
            for syntax in *syntaxes {
                options = options.with_presentation_context((*class).to_owned(), vec![(*syntax).to_owned()]);
            }
        }
        let mut link = options.establish(peer.address.as_str()).map_err(|error| refusal(peer, &error))?;
        let longer = link.inner_stream().set_read_timeout(Some(ANSWER_WAIT));
        longer.map_err(|error| DicomError::Broken { peer: peer.address.clone(), problem: error.to_string() })?;
        let most = link.acceptor_max_pdu_length();
        if most < MIN_PDU {
            let problem = format!("it takes only {most} bytes at once; {MIN_PDU} are the fewest");
            return Err(DicomError::Broken { peer: peer.address.clone(), problem });
        }
        let chunk = most.min(MAX_PDU) as usize - VALUE_HEAD;
        Ok(Self { link, peer: peer.clone(), messages: 0, chunk })
    }

    /// Address of the server, for errors.
    pub fn peer(&self) -> String {
        self.peer.address.clone()
    }

    /// An error of this association.
    pub fn broken(&self, problem: String) -> DicomError {
        DicomError::Broken { peer: self.peer(), problem }
    }

    /// The error that the server does not offer a service.
    pub fn no_service(&self, service: &str) -> DicomError {
        DicomError::NoService { peer: self.peer(), service: service.to_owned() }
    }

    /// The accepted context of a class in a transfer syntax; `None` if there is none.
    pub fn context(&self, class: &str, syntax: &str) -> Option<u8> {
        let own = |text: &str| text.trim_end_matches('\0').to_owned();
        let contexts = self.link.presentation_contexts().iter();
        contexts
            .filter(|context| context.reason == dicom_ul::pdu::PresentationContextResultReason::Acceptance)
            .find(|context| own(&context.abstract_syntax) == class && own(&context.transfer_syntax) == syntax)
            .map(|context| context.id)
    }

    /// Number of the next message.
    pub fn next_id(&mut self) -> u16 {
        self.messages = self.messages.wrapping_add(1);
        self.messages
    }

    /// Sends a command.
    ///
    /// # Errors
    /// The connection broke.
    pub fn send_command(&mut self, context: u8, command: &Set) -> Result<()> {
        let mut bytes = Vec::new();
        let encoded = command.write_dataset_with_ts(&mut bytes, &IMPLICIT_VR_LITTLE_ENDIAN.erased());
        encoded.map_err(|error| self.broken(chain(&error)))?;
        self.send_value(context, PDataValueType::Command, true, bytes)
    }

    /// Sends a small data set.
    ///
    /// # Errors
    /// The connection broke.
    pub fn send_set(&mut self, context: u8, set: &Set, encoding: Encoding) -> Result<()> {
        let syntax = match encoding {
            Encoding::Implicit => IMPLICIT_VR_LITTLE_ENDIAN.erased(),
            Encoding::Explicit => EXPLICIT_VR_LITTLE_ENDIAN.erased(),
        };
        let mut bytes = Vec::new();
        set.write_dataset_with_ts(&mut bytes, &syntax).map_err(|error| self.broken(chain(&error)))?;
        let length = bytes.len() as u64;
        self.send_data(context, &mut bytes.as_slice(), length)
    }

    /// Sends an encoded data set of `bytes` bytes.
    ///
    /// # Errors
    /// The connection broke, or the data set is shorter; then the association is aborted, so that the server keeps no
    /// part of it.
    pub fn send_data(&mut self, context: u8, data: &mut dyn Read, bytes: u64) -> Result<()> {
        let mut left = bytes;
        loop {
            let mut chunk = vec![0; left.min(self.chunk as u64) as usize];
            data.read_exact(&mut chunk).map_err(|error| self.broken(format!("the object cannot be read: {error}")))?;
            left -= chunk.len() as u64;
            self.send_value(context, PDataValueType::Data, left == 0, chunk)?;
            if left == 0 {
                return Ok(());
            }
        }
    }

    fn send_value(&mut self, context: u8, value_type: PDataValueType, is_last: bool, data: Vec<u8>) -> Result<()> {
        let value = PDataValue { presentation_context_id: context, value_type, is_last, data };
        let sent = self.link.send(&Pdu::PData { data: vec![value] });
        sent.map_err(|error| self.broken(format!("sending failed: {}", chain(&error))))
    }

    /// Waits for the response to message `id` with this command field.
    ///
    /// # Errors
    /// The connection broke, the server takes too long, or the received message is not that response.
    pub fn receive(&mut self, id: u16, field: u16) -> Result<Response> {
        let until = Instant::now() + RESPONSE_WAIT;
        let (mut command_bytes, mut data) = (Vec::new(), Vec::new());
        let mut command: Option<Set> = None;
        loop {
            if Instant::now() > until {
                return Err(self.broken(format!("no response within {} s", RESPONSE_WAIT.as_secs())));
            }
            let pdu = self.link.receive().map_err(|error| self.silence(&error))?;
            let values = match pdu {
                Pdu::PData { data } => data,
                Pdu::AbortRQ { .. } => return Err(self.broken("it aborted the association".to_owned())),
                other => return Err(self.broken(format!("got {} instead of a response", other.short_description()))),
            };
            for value in values {
                let is_command = value.value_type == PDataValueType::Command;
                if is_command == command.is_some() {
                    return Err(self.broken("the parts of a response are in the wrong order".to_owned()));
                }
                let (part, limit) =
                    if is_command { (&mut command_bytes, MAX_COMMAND_BYTES) } else { (&mut data, MAX_ENTRY_BYTES) };
                if part.len() + value.data.len() > limit {
                    return Err(self.broken(format!("a response has more than {limit} bytes")));
                }
                part.extend_from_slice(&value.data);
                if !value.is_last {
                    continue;
                }
                if is_command {
                    let parsed = parse_command(&command_bytes).map_err(|error| self.broken(error.to_string()))?;
                    if read_number(&parsed, tags::COMMAND_FIELD) != Some(field)
                        || read_number(&parsed, tags::MESSAGE_ID_BEING_RESPONDED_TO) != Some(id)
                    {
                        return Err(self.broken("got a response to another request".to_owned()));
                    }
                    if read_number(&parsed, tags::COMMAND_DATA_SET_TYPE) == Some(NO_DATA) {
                        return Ok(Response { command: parsed, data });
                    }
                    command = Some(parsed);
                } else if let Some(command) = command.take() {
                    return Ok(Response { command, data });
                }
            }
        }
    }

    fn silence(&self, error: &UlError) -> DicomError {
        match is_timeout(error) {
            true => self.broken(format!("no answer within {} s", ANSWER_WAIT.as_secs())),
            false => self.broken(chain(error)),
        }
    }

    /// Releases the association; does not wait long for a confirmation.
    pub fn release(self) {
        let _ = self.link.release();
    }
}

/// A command set of a server cannot be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum CommandError {
    /// A length inside it is wrong.
    #[error("the command set cannot be read: {0}")]
    Length(#[from] LengthError),
    /// It cannot be decoded.
    #[error("the command set cannot be read: {reason}")]
    Decode { reason: String },
}

/// A command set, which is always implicit VR little endian.
pub fn parse_command(bytes: &[u8]) -> Result<Set, CommandError> {
    lengths::check(bytes, Encoding::Implicit)?;
    let read = InMemDicomObject::read_dataset_with_ts(bytes, &IMPLICIT_VR_LITTLE_ENDIAN.erased());
    read.map_err(|error| CommandError::Decode { reason: chain(&error) })
}

/// Whether an error is a timeout.
fn is_timeout(error: &UlError) -> bool {
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = cause {
        let io = error.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
        if matches!(io, Some(std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut)) {
            return true;
        }
        cause = error.source();
    }
    matches!(error, UlError::Timeout { .. })
}

fn refusal(peer: &Peer, error: &UlError) -> DicomError {
    let address = peer.address.clone();
    match error {
        UlError::Connect { .. } | UlError::ToAddress { .. } => {
            DicomError::Unreachable { peer: address, cause: chain(error) }
        }
        error if is_timeout(error) => {
            let wait_s = ASSOCIATE_WAIT.as_secs();
            let problem = format!(
                "it accepts connections and gives no answer within {wait_s} s: is this the port of a DICOM server?"
            );
            DicomError::Broken { peer: address, problem }
        }
        UlError::Rejected { association_rj, .. } => DicomError::Refused {
            peer: address,
            calling: peer.calling.to_string(),
            called: peer.called.to_string(),
            reason: association_rj.source.to_string(),
        },
        UlError::NoAcceptedPresentationContexts { .. } => {
            DicomError::NoService { peer: address, service: "any of the services asked for".to_owned() }
        }
        UlError::Aborted { .. } => aborted(address),
        UlError::UnexpectedPdu { pdu, .. } if matches!(**pdu, Pdu::AbortRQ { .. }) => aborted(address),
        other => DicomError::Broken { peer: address, problem: format!("no association: {}", chain(other)) },
    }
}

fn aborted(peer: String) -> DicomError {
    DicomError::Broken { peer, problem: "it aborted the association".to_owned() }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;
    use std::time::Instant;

    use super::*;

    #[test]
    fn a_server_that_never_answers_is_named() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address").to_string();
        let title = || "PANOSCOPE".parse().expect("a title");
        let peer = Peer { address: address.clone(), calling: title(), called: title() };
        let start = Instant::now();
        let error = Association::open(&peer, &[("1.2.840.10008.1.1", &["1.2.840.10008.1.2"])]);
        let words = error.err().expect("no association").to_string();
        assert!(words.contains(&address) && words.contains("no answer within 10 s"), "{words}");
        assert!(start.elapsed() < ANSWER_WAIT, "it waits for the answer to a question");
    }
}
