//! Measurements as Comprehensive SR (PS3.3, A.35.3): lengths, depths and angles with their 95 % error bounds, units in
//! UCUM.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::{Identity, Study, coded};
use crate::dicom::element::{Set, decimal, empty, sequence, set, text};
use crate::dicom::error::{DicomError, Result};
use crate::dicom::part10::{EXPLICIT, Pending, write};
use crate::dicom::time::Moment;

/// SOP class UID of Comprehensive SR Storage.
pub const CLASS: &str = "1.2.840.10008.5.1.4.1.1.88.33";
/// Number of the series of measurements.
const SERIES: (u32, &str) = (3, "Measurements");
/// Maximum length of a line of a table, bytes.
const MAX_LINE_BYTES: u64 = 1 << 20;
/// Maximum number of lines that are read of a table.
const MAX_LINES: usize = 10_000_000;
/// Maximum number of measurements of a table's line.
const MAX_ROWS: usize = 1000;

/// Own codes: no standard scheme has the 95 % error bound of a measurement.
const SCHEME: &str = "99PANOSCOPE";
const ERROR: (&str, &str, &str) = ("ERROR95", SCHEME, "95 % error bound");
const LENGTH: (&str, &str, &str) = ("410668003", "SCT", "Length");
const DEPTH: (&str, &str, &str) = ("131197000", "SCT", "Depth");
const ANGLE: (&str, &str, &str) = ("1483009", "SCT", "Angle");
const MM: (&str, &str, &str) = ("mm", "UCUM", "millimeter");
const DEGREE: (&str, &str, &str) = ("deg", "UCUM", "degree");

/// A measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Length {
    /// `Length`, `Depth` or `Angle`.
    kind: (&'static str, &'static str, &'static str),
    unit: (&'static str, &'static str, &'static str),
    /// The value in mm or degrees.
    pub value: f64,
    /// Its 95 % error bound; `None` if unknown.
    pub error: Option<f64>,
    /// Ends in the image, px: column and row, the centre of the first pixel at 0, 0.
    pub points: Vec<[f64; 2]>,
}

/// Measurements of one table, and the image in which they were made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lengths {
    /// Name of the image's file next to the table.
    pub picture: Option<PathBuf>,
    /// The measurements.
    pub rows: Vec<Length>,
}

/// A line of a table, as `write_table` writes it.
#[derive(Deserialize)]
struct Line {
    #[serde(default)]
    picture: Option<String>,
    #[serde(default)]
    table: Vec<Row>,
}

/// Columns of the node `measure`.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Row {
    u_px: Option<f64>,
    v_px: Option<f64>,
    u0_px: Option<f64>,
    v0_px: Option<f64>,
    u1_px: Option<f64>,
    v1_px: Option<f64>,
    u2_px: Option<f64>,
    v2_px: Option<f64>,
    distance_mm: Option<f64>,
    segment_mm: Option<f64>,
    segment_error_mm: Option<f64>,
    depth_mm: Option<f64>,
    error_mm: Option<f64>,
    angle_deg: Option<f64>,
    error_deg: Option<f64>,
}

impl Row {
    fn length(&self) -> Option<Length> {
        let known = |value: Option<f64>| value.filter(|v| v.is_finite());
        let points =
            [(self.u_px, self.v_px), (self.u0_px, self.v0_px), (self.u1_px, self.v1_px), (self.u2_px, self.v2_px)];
        let points = points.iter().filter_map(|(u, v)| Some([known(*u)?, known(*v)?])).collect();
        let of =
            |kind, unit, value, error| Some(Length { kind, unit, value: known(value)?, error: known(error), points });
        if self.distance_mm.is_some() {
            of(LENGTH, MM, self.distance_mm, self.error_mm)
        } else if self.segment_mm.is_some() {
            of(LENGTH, MM, self.segment_mm, self.segment_error_mm)
        } else if self.depth_mm.is_some() {
            of(DEPTH, MM, self.depth_mm, self.error_mm)
        } else {
            of(ANGLE, DEGREE, self.angle_deg, self.error_deg)
        }
    }
}

/// A table of measurements that cannot be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum TableError {
    /// The operating system's error.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// A line is too long.
    #[error("line {number} has more than {MAX_LINE_BYTES} bytes")]
    LongLine { number: usize },
    /// A line is not a row of such a table.
    #[error("line {number}: {cause}")]
    Line { number: usize, cause: serde_json::Error },
}

impl Lengths {
    /// Whether a table has a measurement.
    ///
    /// # Errors
    /// It cannot be read, or is damaged.
    pub fn has_any(file: &Path) -> Result<bool> {
        let read = File::open(file).map_err(|cause| DicomError::Read { file: file.to_owned(), cause })?;
        let lengths = Self::read(BufReader::new(read));
        let wrong = |error: TableError| DicomError::Input { file: file.to_owned(), problem: error.to_string() };
        Ok(!lengths.map_err(wrong)?.rows.is_empty())
    }

    /// The last known measurements in a table of JSON lines: of the node `measure`, or of the theatre next to a still.
    ///
    /// # Errors
    /// It cannot be read, or has no measurement.
    pub fn open(file: &Path) -> Result<Self> {
        let failed = |cause| DicomError::Read { file: file.to_owned(), cause };
        let wrong = |problem: String| DicomError::Input { file: file.to_owned(), problem };
        let lengths = Self::read(BufReader::new(File::open(file).map_err(failed)?));
        let lengths = lengths.map_err(|error| wrong(error.to_string()))?;
        if lengths.rows.is_empty() {
            return Err(wrong("it has no measurement: it must be the `table` of a node `measure`".to_owned()));
        }
        Ok(lengths)
    }

    /// [`Self::open`] of text; no rows if there is no measurement.
    ///
    /// # Errors
    ///
    /// The text is malformed.
    pub fn read(mut lines: impl BufRead) -> Result<Self, TableError> {
        let mut last = Self::default();
        let mut bytes = Vec::new();
        for number in 1..=MAX_LINES {
            bytes.clear();
            let limited = &mut std::io::Read::take(&mut lines, MAX_LINE_BYTES);
            let count = limited.read_until(b'\n', &mut bytes)?;
            if count == 0 {
                break;
            }
            // A line without its end is one that a crash cut off, unless it is whole JSON.
            let is_whole = bytes.ends_with(b"\n");
            if !is_whole && count as u64 == MAX_LINE_BYTES {
                return Err(TableError::LongLine { number });
            }
            if bytes.trim_ascii().is_empty() {
                continue;
            }
            let line: Line = match serde_json::from_slice(&bytes) {
                Ok(line) => line,
                Err(_) if !is_whole => break,
                Err(cause) => return Err(TableError::Line { number, cause }),
            };
            let rows: Vec<Length> = line.table.iter().take(MAX_ROWS).filter_map(Row::length).collect();
            if !rows.is_empty() {
                let picture = line.picture.map(PathBuf::from);
                // A name of a file beside this one, and no path elsewhere.
                let picture = picture.filter(|name| name.components().count() == 1 && name.file_name().is_some());
                last = Self { picture, rows };
            }
        }
        Ok(last)
    }
}

/// A group of measurements in a report.
pub struct Group {
    /// Measurements and their image.
    pub lengths: Lengths,
    /// SOP class, SOP instance and series of the image.
    pub picture: Option<(String, String, String)>,
}

/// A report of measurements.
pub struct Report {
    /// Its groups.
    pub groups: Vec<Group>,
}

impl Report {
    /// Writes it as an object into `folder`.
    pub(crate) fn write(&self, study: &Study<'_>, folder: &Path) -> Result<Pending> {
        write(folder, &self.object(study), EXPLICIT, |_| Ok(()))
    }

    fn object(&self, study: &Study<'_>) -> Set {
        let content: Vec<Set> = self.groups.iter().map(group).collect();
        // Debug forms of numbers are exact.
        let groups = self.groups.iter().map(|group| format!("{:?} {:?}", group.lengths.rows, group.picture));
        let hash = Sha256::digest(groups.collect::<String>());
        let mut object = study.common(&Identity {
            class: CLASS,
            instance: study.instance(CLASS, &hash),
            modality: "SR",
            series: SERIES,
            number: 1,
            moment: Moment::now(),
        });
        let entry = study.entry;
        object.put(empty(tags::REFERENCED_PERFORMED_PROCEDURE_STEP_SEQUENCE, VR::SQ));
        object.put(text(tags::COMPLETION_FLAG, VR::CS, "COMPLETE"));
        object.put(text(tags::VERIFICATION_FLAG, VR::CS, "UNVERIFIED"));
        object.put(empty(tags::PERFORMED_PROCEDURE_CODE_SEQUENCE, VR::SQ));
        let request = set([
            text(tags::STUDY_INSTANCE_UID, VR::UI, entry.study.as_str()),
            empty(tags::REFERENCED_STUDY_SEQUENCE, VR::SQ),
            text(tags::ACCESSION_NUMBER, VR::SH, entry.accession.as_str()),
            empty(tags::PLACER_ORDER_NUMBER_IMAGING_SERVICE_REQUEST, VR::LO),
            empty(tags::FILLER_ORDER_NUMBER_IMAGING_SERVICE_REQUEST, VR::LO),
            text(tags::REQUESTED_PROCEDURE_ID, VR::SH, entry.requested.0.as_str()),
            text(tags::REQUESTED_PROCEDURE_DESCRIPTION, VR::LO, entry.requested.1.as_str()),
            empty(tags::REQUESTED_PROCEDURE_CODE_SEQUENCE, VR::SQ),
        ]);
        object.put(sequence(tags::REFERENCED_REQUEST_SEQUENCE, vec![request]));
        if let Some(evidence) = self.evidence(study) {
            object.put(sequence(tags::CURRENT_REQUESTED_PROCEDURE_EVIDENCE_SEQUENCE, vec![evidence]));
        }
        let scheme = set([
            text(tags::CODING_SCHEME_DESIGNATOR, VR::SH, SCHEME),
            text(tags::CODING_SCHEME_NAME, VR::ST, "Codes of Panoscope"),
            text(tags::CODING_SCHEME_VERSION, VR::SH, "1"),
        ]);
        object.put(sequence(tags::CODING_SCHEME_IDENTIFICATION_SEQUENCE, vec![scheme]));
        // The tree.
        object.put(text(tags::VALUE_TYPE, VR::CS, "CONTAINER"));
        object.put(coded(tags::CONCEPT_NAME_CODE_SEQUENCE, ("126000", "DCM", "Imaging Measurement Report")));
        object.put(text(tags::CONTINUITY_OF_CONTENT, VR::CS, "SEPARATE"));
        let mut language =
            item("HAS CONCEPT MOD", "CODE", ("121049", "DCM", "Language of Content Item and Descendants"));
        language.put(coded(tags::CONCEPT_CODE_SEQUENCE, ("en", "RFC5646", "English")));
        let mut observer = item("HAS OBS CONTEXT", "CODE", ("121005", "DCM", "Observer Type"));
        observer.put(coded(tags::CONCEPT_CODE_SEQUENCE, ("121007", "DCM", "Device")));
        let mut device = item("HAS OBS CONTEXT", "UIDREF", ("121012", "DCM", "Device Observer UID"));
        device.put(text(tags::UID, VR::UI, crate::dicom::uid::IMPLEMENTATION));
        let mut name = item("HAS OBS CONTEXT", "TEXT", ("121013", "DCM", "Device Observer Name"));
        name.put(text(tags::TEXT_VALUE, VR::UT, "Panoscope"));
        object.put(sequence(tags::CONTENT_SEQUENCE, [vec![language, observer, device, name], content].concat()));
        object
    }

    /// The images that the report refers to.
    fn evidence(&self, study: &Study<'_>) -> Option<Set> {
        let mut pictures: Vec<_> = self.groups.iter().filter_map(|group| group.picture.as_ref()).collect();
        pictures.sort();
        pictures.dedup();
        let series = |uid: &str| {
            let own = pictures.iter().filter(|(.., series)| series == uid);
            let objects = own.map(|(class, instance, _)| reference(class, instance)).collect();
            set([text(tags::SERIES_INSTANCE_UID, VR::UI, uid), sequence(tags::REFERENCED_SOP_SEQUENCE, objects)])
        };
        let mut all: Vec<&str> = pictures.iter().map(|(.., series)| series.as_str()).collect();
        all.sort_unstable();
        all.dedup();
        (!all.is_empty()).then(|| {
            set([
                text(tags::STUDY_INSTANCE_UID, VR::UI, study.entry.study.as_str()),
                sequence(tags::REFERENCED_SERIES_SEQUENCE, all.into_iter().map(series).collect()),
            ])
        })
    }
}

fn item(relation: &str, value_type: &str, name: (&str, &str, &str)) -> Set {
    set([
        text(tags::RELATIONSHIP_TYPE, VR::CS, relation),
        text(tags::VALUE_TYPE, VR::CS, value_type),
        coded(tags::CONCEPT_NAME_CODE_SEQUENCE, name),
    ])
}

fn reference(class: &str, instance: &str) -> Set {
    set([
        text(tags::REFERENCED_SOP_CLASS_UID, VR::UI, class),
        text(tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, instance),
    ])
}

fn number(relation: &str, name: (&str, &str, &str), value: f64, unit: (&str, &str, &str)) -> Set {
    let measured = set([
        coded(tags::MEASUREMENT_UNITS_CODE_SEQUENCE, unit),
        text(tags::NUMERIC_VALUE, VR::DS, decimal(value)),
        DataElement::new(tags::FLOATING_POINT_VALUE, VR::FD, PrimitiveValue::from(value)),
    ]);
    let mut number = item(relation, "NUM", name);
    number.put(sequence(tags::MEASURED_VALUE_SEQUENCE, vec![measured]));
    number
}

fn group(group: &Group) -> Set {
    let lengths = group.lengths.rows.iter().map(|length| {
        let mut item = number("CONTAINS", length.kind, length.value, length.unit);
        let mut about = Vec::new();
        if let Some(error) = length.error {
            about.push(number("HAS PROPERTIES", ERROR, error, length.unit));
        }
        if let Some((class, instance, _)) = &group.picture
            && !length.points.is_empty()
        {
            about.push(ends(&length.points, class, instance));
        }
        if !about.is_empty() {
            item.put(sequence(tags::CONTENT_SEQUENCE, about));
        }
        item
    });
    let mut container = item("CONTAINS", "CONTAINER", ("125007", "DCM", "Measurement Group"));
    container.put(text(tags::CONTINUITY_OF_CONTENT, VR::CS, "SEPARATE"));
    container.put(sequence(tags::CONTENT_SEQUENCE, lengths.collect()));
    container
}

/// Position in the image of a measurement. DICOM's origin is the corner of the first pixel, not its centre.
fn ends(points: &[[f64; 2]], class: &str, instance: &str) -> Set {
    let data: Vec<f32> = points.iter().flatten().map(|px| (px + 0.5) as f32).collect();
    let mut picture =
        set([text(tags::RELATIONSHIP_TYPE, VR::CS, "SELECTED FROM"), text(tags::VALUE_TYPE, VR::CS, "IMAGE")]);
    picture.put(sequence(tags::REFERENCED_SOP_SEQUENCE, vec![reference(class, instance)]));
    set([
        text(tags::RELATIONSHIP_TYPE, VR::CS, "INFERRED FROM"),
        text(tags::VALUE_TYPE, VR::CS, "SCOORD"),
        text(tags::GRAPHIC_TYPE, VR::CS, if points.len() == 1 { "POINT" } else { "POLYLINE" }),
        DataElement::new(tags::GRAPHIC_DATA, VR::FL, PrimitiveValue::F32(data.into())),
        sequence(tags::CONTENT_SEQUENCE, vec![picture]),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_known_row_of_a_table_counts() {
        let table = concat!(
            r#"{"seq":0,"table":[{"u0_px":1,"v0_px":2,"u1_px":3,"v1_px":4,"distance_mm":9.5,"error_mm":0.5}]}"#,
            "\n",
            r#"{"seq":1,"table":[{"u0_px":1,"v0_px":2,"u1_px":3,"v1_px":4,"distance_mm":10.25,"error_mm":0.75}]}"#,
            "\n",
            r#"{"seq":2,"table":[{"u0_px":1,"v0_px":2,"u1_px":3,"v1_px":4,"distance_mm":null,"error_mm":null}]}"#,
            "\n",
            r#"{"seq":3,"table":[{"u0_px"#,
        );
        let lengths = Lengths::read(table.as_bytes()).unwrap();
        let [length] = &lengths.rows[..] else { panic!("{lengths:?}") };
        assert_eq!((length.value, length.error, length.kind), (10.25, Some(0.75), LENGTH));
        assert_eq!(length.points, [[1.0, 2.0], [3.0, 4.0]]);
        let depth = Lengths::read(
            &br#"{"picture":"../x.png","table":[{"u_px":1,"v_px":2,"depth_mm":50,"error_mm":null}]}"#[..],
        );
        let depth = depth.unwrap();
        assert_eq!((depth.rows[0].kind, depth.rows[0].error, depth.picture), (DEPTH, None, None));
    }

    #[test]
    fn tables_without_measurements_have_no_rows_and_damaged_ones_are_errors() {
        for table in ["", "{\"seq\":0}\n", "{\"table\":[{\"distance_mm\":null}]}\n"] {
            assert_eq!(Lengths::read(table.as_bytes()).unwrap(), Lengths::default(), "{table}");
        }
        for table in ["nonsense\n", "{\"table\":[{\"distance_mm\":\"9\"}]}\n"] {
            let error = Lengths::read(table.as_bytes()).unwrap_err().to_string();
            assert!(error.contains("line 1"), "{error}");
        }
    }
}
