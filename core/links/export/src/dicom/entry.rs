//! Entries of a modality worklist: the only source of a patient's identity.

use std::path::Path;

use dicom_core::{Tag, VR};
use dicom_dictionary_std::tags;
use dicom_encoding::text::SpecificCharacterSet;
use dicom_transfer_syntax_registry::entries::{EXPLICIT_VR_LITTLE_ENDIAN, IMPLICIT_VR_LITTLE_ENDIAN};

use crate::dicom::element::{Set, empty, first_item, read, sequence, set, text};
use crate::dicom::error::{DicomError, Result, chain};
use crate::dicom::lengths::{self, Encoding};
use crate::dicom::part10::{self, MAX_ENTRY_BYTES};
use crate::dicom::uid;

/// A procedure in a worklist, copied unchanged into each object of the study.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Entry {
    /// Patient ID.
    pub patient_id: String,
    /// Issuer of the patient ID.
    pub patient_id_issuer: String,
    /// Patient's name: family^given^middle^prefix^suffix.
    pub patient_name: String,
    /// Birth date, `YYYYMMDD`.
    pub birth_date: String,
    /// `M`, `F`, `O` or nothing.
    pub sex: String,
    /// Accession number.
    pub accession: String,
    /// Study instance UID.
    pub study: String,
    /// Referring physician's name.
    pub referring_physician: String,
    /// Requested procedure: ID and description.
    pub requested: (String, String),
    /// Scheduled procedure step: ID and description.
    pub step: (String, String),
    /// Date and time for which the step is scheduled, `YYYYMMDD` and `HHMMSS`.
    pub start: (String, String),
    /// Modality for which the step is scheduled.
    pub modality: String,
    /// Application entity title of the station for which the step is scheduled.
    pub station: String,
}

/// Tags of the texts of an entry.
const FIELDS: [(Tag, VR); 10] = [
    (tags::PATIENT_ID, VR::LO),
    (tags::ISSUER_OF_PATIENT_ID, VR::LO),
    (tags::PATIENT_NAME, VR::PN),
    (tags::PATIENT_BIRTH_DATE, VR::DA),
    (tags::PATIENT_SEX, VR::CS),
    (tags::ACCESSION_NUMBER, VR::SH),
    (tags::STUDY_INSTANCE_UID, VR::UI),
    (tags::REFERRING_PHYSICIAN_NAME, VR::PN),
    (tags::REQUESTED_PROCEDURE_ID, VR::SH),
    (tags::REQUESTED_PROCEDURE_DESCRIPTION, VR::LO),
];

/// Filter of a worklist query; empty texts match all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Query {
    /// Modality, such as `ES`.
    pub modality: String,
    /// Date of the scheduled step, `YYYYMMDD` or a range `YYYYMMDD-YYYYMMDD`.
    pub date: String,
    /// Application entity title of the station.
    pub station: String,
}

impl Query {
    /// The identifier of the C-FIND request.
    pub(crate) fn identifier(&self) -> Set {
        let step = set([
            text(tags::MODALITY, VR::CS, self.modality.as_str()),
            text(tags::SCHEDULED_STATION_AE_TITLE, VR::AE, self.station.as_str()),
            text(tags::SCHEDULED_PROCEDURE_STEP_START_DATE, VR::DA, self.date.as_str()),
            empty(tags::SCHEDULED_PROCEDURE_STEP_START_TIME, VR::TM),
            empty(tags::SCHEDULED_PERFORMING_PHYSICIAN_NAME, VR::PN),
            empty(tags::SCHEDULED_PROCEDURE_STEP_DESCRIPTION, VR::LO),
            empty(tags::SCHEDULED_PROCEDURE_STEP_ID, VR::SH),
        ]);
        let fields = FIELDS.iter().map(|&(tag, vr)| empty(tag, vr));
        let mut identifier = set(fields);
        identifier.put(text(tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192"));
        identifier.put(sequence(tags::SCHEDULED_PROCEDURE_STEP_SEQUENCE, vec![step]));
        identifier
    }
}

impl Entry {
    /// An entry from an encoded data set.
    ///
    /// # Errors
    /// It is not a data set, uses an unsupported character set, or lacks the identification of patient or study.
    pub fn decode(bytes: &[u8], encoding: Encoding) -> Result<Self> {
        let malformed = |problem: String| DicomError::Malformed { what: "a worklist entry".to_owned(), problem };
        if bytes.len() > MAX_ENTRY_BYTES {
            return Err(malformed(format!("{} bytes exceed the limit of {MAX_ENTRY_BYTES}", bytes.len())));
        }
        lengths::check(bytes, encoding).map_err(|error| malformed(error.to_string()))?;
        let syntax = match encoding {
            Encoding::Implicit => IMPLICIT_VR_LITTLE_ENDIAN.erased(),
            Encoding::Explicit => EXPLICIT_VR_LITTLE_ENDIAN.erased(),
        };
        let decoded = Set::read_dataset_with_ts(bytes, &syntax).map_err(|error| malformed(chain(&error)))?;
        Self::of(&decoded)
    }

    /// An entry from a file: a worklist file of a server, or any DICOM object of the study.
    ///
    /// # Errors
    /// As [`Self::decode`]; or the file cannot be read.
    pub fn open(file: &Path) -> Result<Self> {
        let bytes = part10::read_small(file)?;
        let head = part10::Head::parse(&bytes)
            .map_err(|error| DicomError::Malformed { what: file.display().to_string(), problem: error.to_string() })?;
        let encoding = head.encoding().ok_or_else(|| DicomError::Malformed {
            what: file.display().to_string(),
            problem: format!("a worklist entry in the transfer syntax {} is not read", head.transfer_syntax),
        })?;
        Self::decode(&bytes[head.length..], encoding)
    }

    fn of(decoded: &Set) -> Result<Self> {
        let sets = read(decoded, tags::SPECIFIC_CHARACTER_SET);
        let is_known = sets.is_empty() || (!sets.contains('\\') && SpecificCharacterSet::from_code(&sets).is_some());
        if !is_known {
            let problem = format!(
                "it uses the character set `{sets}`, which would garble the patient's name; have the server use ISO_IR 192 (UTF-8) or ISO_IR 100"
            );
            return Err(DicomError::Entry { problem });
        }
        let nothing = Set::new_empty();
        let step = first_item(decoded, tags::SCHEDULED_PROCEDURE_STEP_SEQUENCE).unwrap_or(&nothing);
        let entry = Self {
            patient_id: read(decoded, tags::PATIENT_ID),
            patient_id_issuer: read(decoded, tags::ISSUER_OF_PATIENT_ID),
            patient_name: read(decoded, tags::PATIENT_NAME),
            birth_date: read(decoded, tags::PATIENT_BIRTH_DATE),
            sex: read(decoded, tags::PATIENT_SEX),
            accession: read(decoded, tags::ACCESSION_NUMBER),
            study: read(decoded, tags::STUDY_INSTANCE_UID),
            referring_physician: read(decoded, tags::REFERRING_PHYSICIAN_NAME),
            requested: (
                read(decoded, tags::REQUESTED_PROCEDURE_ID),
                read(decoded, tags::REQUESTED_PROCEDURE_DESCRIPTION),
            ),
            step: (
                read(step, tags::SCHEDULED_PROCEDURE_STEP_ID),
                read(step, tags::SCHEDULED_PROCEDURE_STEP_DESCRIPTION),
            ),
            start: (
                read(step, tags::SCHEDULED_PROCEDURE_STEP_START_DATE),
                read(step, tags::SCHEDULED_PROCEDURE_STEP_START_TIME),
            ),
            modality: read(step, tags::MODALITY),
            station: read(step, tags::SCHEDULED_STATION_AE_TITLE),
        };
        entry.check()?;
        Ok(entry)
    }

    fn check(&self) -> Result<()> {
        let problem = if self.patient_id.is_empty() {
            "it has no patient ID"
        } else if !uid::is_valid(&self.study) {
            "it has no valid study instance UID"
        } else if self.texts().any(|text| text.chars().any(char::is_control)) {
            "it has control characters in a text"
        } else {
            return Ok(());
        };
        Err(DicomError::Entry { problem: problem.to_owned() })
    }

    fn texts(&self) -> impl Iterator<Item = &str> {
        [
            &self.patient_id,
            &self.patient_id_issuer,
            &self.patient_name,
            &self.birth_date,
            &self.sex,
            &self.accession,
            &self.study,
            &self.referring_physician,
            &self.requested.0,
            &self.requested.1,
            &self.step.0,
            &self.step.1,
            &self.start.0,
            &self.start.1,
            &self.modality,
            &self.station,
        ]
        .into_iter()
        .map(String::as_str)
    }

    /// Whether `key` is its accession number, step ID or study instance UID.
    pub fn has_key(&self, key: &str) -> bool {
        [&self.accession, &self.step.0, &self.study].into_iter().any(|own| !own.is_empty() && own == key)
    }

    /// The only entry with `key`.
    ///
    /// # Errors
    ///
    /// No entry or several entries match; entries are never guessed.
    pub fn choose<'a>(entries: &'a [Self], key: &str) -> Result<&'a Self> {
        let mut named = entries.iter().filter(|entry| entry.has_key(key));
        match (named.next(), named.count()) {
            (Some(entry), 0) => Ok(entry),
            (first, more) => {
                let count = usize::from(first.is_some()) + more;
                let help = match count {
                    0 => "`panoscope dicom worklist` lists those that there are",
                    _ => "name the step or the study instead",
                };
                Err(DicomError::Choice { key: key.to_owned(), count, help })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub fn encoded(change: impl FnOnce(&mut Set)) -> Vec<u8> {
        let mut whole = Query { modality: "ES".into(), date: "20260309".into(), station: String::new() }.identifier();
        whole.put(text(tags::PATIENT_ID, VR::LO, "P-7"));
        whole.put(text(tags::PATIENT_NAME, VR::PN, "Müller^Änne"));
        whole.put(text(tags::STUDY_INSTANCE_UID, VR::UI, "1.2.3"));
        whole.put(text(tags::ACCESSION_NUMBER, VR::SH, "A1"));
        change(&mut whole);
        let mut bytes = Vec::new();
        whole.write_dataset_with_ts(&mut bytes, &EXPLICIT_VR_LITTLE_ENDIAN.erased()).unwrap();
        bytes
    }

    #[test]
    fn an_entry_is_what_the_worklist_says() {
        let entry = Entry::decode(&encoded(|_| {}), Encoding::Explicit).unwrap();
        assert_eq!((entry.patient_id.as_str(), entry.patient_name.as_str()), ("P-7", "Müller^Änne"));
        assert_eq!(
            (entry.study.as_str(), entry.modality.as_str(), entry.start.0.as_str()),
            ("1.2.3", "ES", "20260309")
        );
        let other = Entry { accession: "A2".into(), ..entry.clone() };
        let both = [entry, other];
        assert_eq!(Entry::choose(&both, "A2").unwrap(), &both[1]);
        for (key, words) in [("A3", "0 worklist entries"), ("1.2.3", "2 worklist entries"), ("", "0 worklist entries")]
        {
            let error = Entry::choose(&both, key).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }

    #[test]
    fn entries_that_identify_nobody_are_refused() {
        let without = |tag: Tag| {
            encoded(|whole| {
                whole.remove_element(tag);
            })
        };
        for (bytes, words) in [
            (without(tags::PATIENT_ID), "no patient ID"),
            (without(tags::STUDY_INSTANCE_UID), "no valid study"),
            (encoded(|whole| drop(whole.put(text(tags::PATIENT_NAME, VR::PN, "A\u{1b}[2J")))), "control characters"),
            (
                encoded(|whole| drop(whole.put(text(tags::SPECIFIC_CHARACTER_SET, VR::CS, "\\ISO 2022 IR 87")))),
                "character set",
            ),
            (encoded(|_| {})[..50].to_vec(), "announced"),
        ] {
            let error = Entry::decode(&bytes, Encoding::Explicit).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
