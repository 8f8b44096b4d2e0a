//! Objects of a study: common elements.

mod clip;
mod jpeg;
mod mp4;
mod report;
mod still;

use dicom_core::VR;
use dicom_dictionary_std::tags;

use crate::dicom::element::{Set, code, empty, sequence, set, text};
use crate::dicom::entry::Entry;
use crate::dicom::time::Moment;
use crate::dicom::uid;

pub use clip::Clip;
pub use jpeg::{Jpeg, parse as parse_jpeg};
pub use mp4::{Film, parse as parse_mp4};
pub use report::{Group, Length, Lengths, Report};
pub use still::Still;

/// Data shared by all objects of one export.
#[derive(Clone, Debug)]
pub struct Study<'a> {
    /// Worklist entry that they belong to.
    pub entry: &'a Entry,
    /// Body region in view of the endoscope.
    pub region: Region,
}

/// Body region, which every endoscopic video must name (PS3.16, CID 4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Region {
    /// Not known: the entire body.
    #[default]
    Unknown,
    /// Abdomen.
    Abdomen,
    /// Pelvis.
    Pelvis,
    /// Chest.
    Chest,
    /// A joint.
    Joint,
    /// Head.
    Head,
    /// Neck.
    Neck,
}

impl Region {
    /// Its code in SNOMED CT.
    fn code(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Unknown => ("38266002", "SCT", "Entire body"),
            Self::Abdomen => ("818981001", "SCT", "Abdomen"),
            Self::Pelvis => ("816092008", "SCT", "Pelvis"),
            Self::Chest => ("816094009", "SCT", "Chest"),
            Self::Joint => ("39352004", "SCT", "Joint"),
            Self::Head => ("69536005", "SCT", "Head"),
            Self::Neck => ("45048000", "SCT", "Neck"),
        }
    }
}

/// Identification of an object.
pub(crate) struct Identity<'a> {
    /// SOP class UID.
    pub class: &'a str,
    /// SOP instance UID.
    pub instance: String,
    /// Modality of the series.
    pub modality: &'a str,
    /// Number and description of the series; objects of one number are in one series.
    pub series: (u32, &'a str),
    /// Number within the series.
    pub number: u32,
    /// Time of its content.
    pub moment: Moment,
}

impl Study<'_> {
    /// UID of the object of `class` with this content: the same whenever it is exported.
    pub(crate) fn instance(&self, class: &str, content_sha256: &[u8]) -> String {
        uid::of(&[self.entry.study.as_bytes(), self.entry.step.0.as_bytes(), class.as_bytes(), content_sha256])
    }

    /// UID of the series of this number.
    fn series(&self, number: u32, class: &str) -> String {
        let Entry { study, step, .. } = self.entry;
        uid::of(&[study.as_bytes(), step.0.as_bytes(), b"series", &number.to_le_bytes(), class.as_bytes()])
    }

    /// UID of the series of stills.
    pub(crate) fn stills(&self) -> String {
        self.series(still::SERIES.0, still::CLASS)
    }

    /// The elements of patient, study, series, equipment and the object itself.
    pub(crate) fn common(&self, identity: &Identity<'_>) -> Set {
        let entry = self.entry;
        let (number, description) = identity.series;
        let series = self.series(number, identity.class);
        let Moment { date, time, offset } = &identity.moment;
        let start = if entry.start.0.is_empty() { (date, time) } else { (&entry.start.0, &entry.start.1) };
        let mut common = set([
            text(tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192"),
            text(tags::SOP_CLASS_UID, VR::UI, identity.class),
            text(tags::SOP_INSTANCE_UID, VR::UI, identity.instance.as_str()),
            text(tags::TIMEZONE_OFFSET_FROM_UTC, VR::SH, offset.as_str()),
            // Patient.
            text(tags::PATIENT_NAME, VR::PN, entry.patient_name.as_str()),
            text(tags::PATIENT_ID, VR::LO, entry.patient_id.as_str()),
            text(tags::PATIENT_BIRTH_DATE, VR::DA, entry.birth_date.as_str()),
            text(tags::PATIENT_SEX, VR::CS, entry.sex.as_str()),
            // Study. Its date is that of the scheduled step, so that all objects of the study agree, whenever they are exported.
            text(tags::STUDY_INSTANCE_UID, VR::UI, entry.study.as_str()),
            text(tags::STUDY_DATE, VR::DA, start.0.as_str()),
            text(tags::STUDY_TIME, VR::TM, start.1.as_str()),
            text(tags::ACCESSION_NUMBER, VR::SH, entry.accession.as_str()),
            text(tags::REFERRING_PHYSICIAN_NAME, VR::PN, entry.referring_physician.as_str()),
            text(tags::STUDY_ID, VR::SH, entry.requested.0.as_str()),
            // Series.
            text(tags::MODALITY, VR::CS, identity.modality),
            text(tags::SERIES_INSTANCE_UID, VR::UI, series),
            text(tags::SERIES_NUMBER, VR::IS, number.to_string()),
            text(tags::SERIES_DESCRIPTION, VR::LO, description),
            // Equipment.
            text(tags::MANUFACTURER, VR::LO, "Panoscope"),
            text(tags::MANUFACTURER_MODEL_NAME, VR::LO, "Panoscope"),
            text(tags::SOFTWARE_VERSIONS, VR::LO, env!("CARGO_PKG_VERSION")),
            // The object.
            text(tags::INSTANCE_NUMBER, VR::IS, identity.number.to_string()),
            text(tags::CONTENT_DATE, VR::DA, date.as_str()),
            text(tags::CONTENT_TIME, VR::TM, time.as_str()),
        ]);
        if !entry.patient_id_issuer.is_empty() {
            common.put(text(tags::ISSUER_OF_PATIENT_ID, VR::LO, entry.patient_id_issuer.as_str()));
        }
        if !entry.requested.1.is_empty() {
            common.put(text(tags::STUDY_DESCRIPTION, VR::LO, entry.requested.1.as_str()));
        }
        common
    }

    /// The request and step that an image belongs to; `None` if the worklist has none.
    pub(crate) fn request(&self) -> Option<Set> {
        let Entry { requested, step, .. } = self.entry;
        if requested.0.is_empty() || step.0.is_empty() {
            return None;
        }
        let mut request = set([
            text(tags::REQUESTED_PROCEDURE_ID, VR::SH, requested.0.as_str()),
            text(tags::SCHEDULED_PROCEDURE_STEP_ID, VR::SH, step.0.as_str()),
        ]);
        for (tag, words) in [
            (tags::REQUESTED_PROCEDURE_DESCRIPTION, &requested.1),
            (tags::SCHEDULED_PROCEDURE_STEP_DESCRIPTION, &step.1),
        ] {
            if !words.is_empty() {
                request.put(text(tag, VR::LO, words.as_str()));
            }
        }
        Some(request)
    }

    /// [`Self::common`] with the elements of all images.
    pub(crate) fn image(&self, identity: &Identity<'_>) -> Set {
        let mut image = self.common(identity);
        image.put(empty(tags::PATIENT_ORIENTATION, VR::CS));
        if matches!(self.region, Region::Chest | Region::Joint) {
            // Nobody has said which side it is; parts without sides must not name one (PS3.3, C.7.3.1).
            image.put(empty(tags::LATERALITY, VR::CS));
        }
        image.put(coded(tags::ANATOMIC_REGION_SEQUENCE, self.region.code()));
        if let Some(request) = self.request() {
            image.put(sequence(tags::REQUEST_ATTRIBUTES_SEQUENCE, vec![request]));
        }
        image
    }
}

/// A sequence of one code.
pub(crate) fn coded(tag: dicom_core::Tag, value: (&str, &str, &str)) -> dicom_object::mem::InMemElement {
    sequence(tag, vec![code(value)])
}

/// The number at the end of a file's name, such as 12 in `still_0012.png`.
pub(crate) fn number_in_name(file: &std::path::Path) -> Option<u32> {
    let stem = file.file_stem()?.to_str()?;
    let digits = stem.len() - stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    stem[stem.len() - digits..].parse().ok().filter(|n| *n <= i32::MAX as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_file_names() {
        for (name, number) in [
            ("a/still_0012.png", Some(12)),
            ("case_7_clip_0003.mkv", Some(3)),
            ("still.png", None),
            ("99999999999.png", None),
        ] {
            assert_eq!(number_in_name(name.as_ref()), number, "{name}");
        }
    }
}
