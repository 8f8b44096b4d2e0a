//! A PACS or worklist server, queried over the network: C-ECHO, C-FIND, C-STORE (PS3.7, PS3.8).
//!
//! The connection is not encrypted, as is usual between the devices of one department; a hospital that needs more puts
//! a TLS tunnel in between. Panoscope is only a client and listens on no DICOM port.

mod association;

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::str::FromStr;

use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::tags;

use crate::dicom::element::{Set, read_number, text};
use crate::dicom::entry::{Entry, Query};
use crate::dicom::error::{DicomError, Result};
use crate::dicom::lengths::Encoding;
use crate::dicom::part10::{EXPLICIT, Head, IMPLICIT};
use association::Association;

/// SOP class UID of Verification.
const VERIFICATION: &str = "1.2.840.10008.1.1";
/// SOP class UID of the Modality Worklist Information Model, FIND.
const WORKLIST: &str = "1.2.840.10008.5.1.4.31";
/// Maximum number of entries of a worklist.
const MAX_ENTRIES: usize = 1000;
/// Maximum number of presentation contexts of one association, without that of the echo.
const MAX_CONTEXTS: usize = 100;
/// Command field of C-STORE.
const C_STORE: u16 = 0x0001;
const C_FIND: u16 = 0x0020;
const C_ECHO: u16 = 0x0030;
/// Bit in the command field of responses.
const RESPONSE: u16 = 0x8000;

/// An application entity title: 1 to 16 characters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AeTitle(String);

/// A text that is not an application entity title.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not an application entity title: 1 to 16 characters of ASCII without `\\`, not spaces alone")]
pub struct AeTitleError {
    /// The text.
    pub text: String,
}

impl FromStr for AeTitle {
    type Err = AeTitleError;

    fn from_str(given: &str) -> Result<Self, AeTitleError> {
        let title = given.trim();
        let is_good =
            (1..=16).contains(&title.len()) && title.bytes().all(|b| (b' '..=b'~').contains(&b) && b != b'\\');
        if is_good { Ok(Self(title.to_owned())) } else { Err(AeTitleError { text: given.to_owned() }) }
    }
}

impl fmt::Display for AeTitle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Address and titles for a connection to a server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peer {
    /// `HOST:PORT`.
    pub address: String,
    /// Title of the server.
    pub called: AeTitle,
    /// Title of this client.
    pub calling: AeTitle,
}

/// Checks that a server answers (C-ECHO).
///
/// # Errors
///
/// It does not.
pub fn echo(peer: &Peer) -> Result<()> {
    let mut association = Association::open(peer, &[(VERIFICATION, &[IMPLICIT])])?;
    send_echo(&mut association)?;
    association.release();
    Ok(())
}

fn send_echo(association: &mut Association) -> Result<()> {
    let context = association.context(VERIFICATION, IMPLICIT).ok_or_else(|| association.no_service("verification"))?;
    let id = association.next_id();
    association.send_command(context, &command(C_ECHO, id, VERIFICATION, false, &[]))?;
    let response = association.receive(id, C_ECHO | RESPONSE)?;
    match status(association, &response.command)? {
        0 => Ok(()),
        status => Err(failed(association, "the echo", status, &response.command)),
    }
}

/// The entries of a worklist that match a query, sorted by their scheduled time.
///
/// Entries without a patient ID or study instance UID are left out and counted.
///
/// # Errors
/// The server cannot be reached, or its answers are malformed.
pub fn worklist(peer: &Peer, query: &Query) -> Result<(Vec<Entry>, Vec<DicomError>)> {
    let mut association = Association::open(peer, &[(WORKLIST, &[EXPLICIT, IMPLICIT])])?;
    let found = [(EXPLICIT, Encoding::Explicit), (IMPLICIT, Encoding::Implicit)]
        .into_iter()
        .find_map(|(syntax, encoding)| Some((association.context(WORKLIST, syntax)?, encoding)));
    let (context, encoding) = found.ok_or_else(|| association.no_service("a modality worklist"))?;
    let id = association.next_id();
    let priority = DataElement::new(tags::PRIORITY, VR::US, PrimitiveValue::from(0u16));
    association.send_command(context, &command(C_FIND, id, WORKLIST, true, &[priority]))?;
    association.send_set(context, &query.identifier(), encoding)?;
    let (mut entries, mut problems) = (Vec::new(), Vec::new());
    loop {
        let response = association.receive(id, C_FIND | RESPONSE)?;
        match status(&association, &response.command)? {
            // Pending, with an entry.
            0xFF00 | 0xFF01 => {
                if entries.len() + problems.len() == MAX_ENTRIES {
                    let problem = format!(
                        "more than {MAX_ENTRIES} worklist entries: narrow the query (--date, --modality, --station)"
                    );
                    return Err(association.broken(problem));
                }
                match Entry::decode(&response.data, encoding) {
                    Ok(entry) => entries.push(entry),
                    Err(error @ DicomError::Entry { .. }) => problems.push(error),
                    Err(error) => return Err(association.broken(error.to_string())),
                }
            }
            0 => break,
            status => return Err(failed(&association, "the worklist query", status, &response.command)),
        }
    }
    association.release();
    entries.sort_by(|a, b| (&a.start, &a.accession).cmp(&(&b.start, &b.accession)));
    Ok((entries, problems))
}

/// An object in a file, to be stored.
pub struct Object {
    /// Head of the file.
    pub head: Head,
    /// The open file, positioned at its data set.
    pub file: File,
    /// Bytes of the data set.
    pub bytes: u64,
}

/// Result of storing an object.
pub type Stored = Result<(), DicomError>;

/// Opens an association for objects of these classes and transfer syntaxes, and checks that the server answers.
///
/// # Errors
/// It does not.
pub fn store(peer: &Peer, heads: &[Head]) -> Result<Store> {
    let mut wanted: Vec<(&str, &str)> =
        heads.iter().map(|head| (head.class.as_str(), head.transfer_syntax.as_str())).collect();
    wanted.sort_unstable();
    wanted.dedup();
    wanted.truncate(MAX_CONTEXTS);
    let syntaxes: Vec<[&str; 1]> = wanted.iter().map(|(_, syntax)| [*syntax]).collect();
    let own: Vec<(&str, &[&str])> =
        wanted.iter().zip(&syntaxes).map(|((class, _), syntax)| (*class, &syntax[..])).collect();
    let contexts = [&[(VERIFICATION, &[IMPLICIT][..])][..], &own].concat();
    let mut association = Association::open(peer, &contexts)?;
    // A server without verification says so in the negotiation; then the first object shows whether it answers.
    if association.context(VERIFICATION, IMPLICIT).is_some() {
        send_echo(&mut association)?;
    }
    Ok(Store { association })
}

/// An association for storing.
pub struct Store {
    association: Association,
}

impl Store {
    /// Stores an object.
    ///
    /// # Errors
    /// The server did not store it. After [`DicomError::Broken`] the association is unusable.
    pub fn send(&mut self, mut object: Object) -> Stored {
        let Head { class, instance, transfer_syntax, .. } = &object.head;
        let association = &mut self.association;
        let context = association.context(class, transfer_syntax).ok_or_else(|| {
            association
                .no_service(&format!("storage of {} in the transfer syntax {transfer_syntax}", class_name(class)))
        })?;
        let id = association.next_id();
        let about = [
            DataElement::new(tags::PRIORITY, VR::US, PrimitiveValue::from(0u16)),
            text(tags::AFFECTED_SOP_INSTANCE_UID, VR::UI, instance.as_str()),
        ];
        association.send_command(context, &command(C_STORE, id, class, true, &about))?;
        association.send_data(context, &mut Read::take(&mut object.file, object.bytes), object.bytes)?;
        let response = association.receive(id, C_STORE | RESPONSE)?;
        let confirmed = response
            .command
            .get(tags::AFFECTED_SOP_INSTANCE_UID)
            .is_none_or(|own| own.to_str().is_ok_and(|own| own.trim_end_matches('\0').trim() == instance));
        if !confirmed {
            return Err(association.broken("it confirmed another object than the sent one".to_owned()));
        }
        match status(association, &response.command)? {
            // Stored; stored with a warning, such as values that it changed.
            0 | 0xB000..=0xBFFF => Ok(()),
            // It has the object already. UIDs come from the content, so it is this one.
            0x0111 => Ok(()),
            status => Err(failed(association, "storage", status, &response.command)),
        }
    }

    /// Ends the association.
    pub fn release(self) {
        self.association.release();
    }
}

/// A command set.
fn command(field: u16, id: u16, class: &str, has_data: bool, more: &[dicom_object::mem::InMemElement]) -> Set {
    let number = |tag: Tag, value: u16| DataElement::new(tag, VR::US, PrimitiveValue::from(value));
    let own = [
        text(tags::AFFECTED_SOP_CLASS_UID, VR::UI, class),
        number(tags::COMMAND_FIELD, field),
        number(tags::MESSAGE_ID, id),
        number(tags::COMMAND_DATA_SET_TYPE, if has_data { 0x0000 } else { 0x0101 }),
    ];
    // With the group's length.
    Set::command_from_element_iter(own.into_iter().chain(more.iter().cloned()))
}

fn status(association: &Association, command: &Set) -> Result<u16> {
    read_number(command, tags::STATUS).ok_or_else(|| association.broken("a response has no status".to_owned()))
}

fn failed(association: &Association, service: &'static str, status: u16, command: &Set) -> DicomError {
    let comment: String =
        crate::dicom::element::read(command, tags::ERROR_COMMENT).chars().filter(|c| !c.is_control()).collect();
    let meaning = match status {
        0x0122 | 0xA800 => "it does not take objects of this class",
        0xA700..=0xA7FF => "it has no room or is too busy; try again later",
        0xA900..=0xA9FF => "the object does not fit its class",
        0xC000..=0xCFFF => "it does not understand the object, or refuses it",
        0x0124 => "it does not allow this",
        0xFE00 => "it cancelled the request",
        _ => "it failed",
    };
    let meaning = if comment.is_empty() { meaning.to_owned() } else { format!("{meaning} ({comment})") };
    DicomError::Status { peer: association.peer(), service, status, meaning }
}

/// Name of a SOP class that this crate writes.
fn class_name(class: &str) -> &str {
    match class {
        "1.2.840.10008.5.1.4.1.1.7" => "stills (Secondary Capture)",
        "1.2.840.10008.5.1.4.1.1.77.1.1.1" => "clips (Video Endoscopic Image)",
        "1.2.840.10008.5.1.4.1.1.88.33" => "measurements (Comprehensive SR)",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_have_1_to_16_characters() {
        assert_eq!("  PANOSCOPE ".parse::<AeTitle>().unwrap().to_string(), "PANOSCOPE");
        for text in ["", "   ", "SEVENTEEN_LETTERS", "A\\B", "Ä"] {
            assert!(text.parse::<AeTitle>().unwrap_err().to_string().contains("application entity title"), "{text}");
        }
    }
}
