//! A recording as a folder of files in common formats.
//!
//! | packets | files |
//! |---|---|
//! | `image`, `mask` | a PNG per tick, 8 or 16 bits |
//! | `disparity`, `depth`, `confidence`, images of floats | an NPY per tick, 32-bit floats, NaN kept |
//! | `cloud` | a binary PLY per tick, mm, known points |
//! | `calibration` | OpenCV's YAML, one per calibration that differs from the last |
//! | `instances` | a CSV of the boxes, and a PNG per tick with the number of the box in each pixel |
//! | all others | one CSV: a line per tick, table row or box |
//!
//! Every line of a CSV begins with the number of the tick, its source and its capture time; `index.csv` lists all
//! files.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use panoscope_abi::{Calibration, Tick};
use panoscope_data::calibration;
use panoscope_data::formats::array::{self, ArrayFormat};
use panoscope_data::formats::fields::{self, CsvFields, Fields};
use panoscope_data::formats::{Pixels, ply, still};
use panoscope_record::Packet;

use crate::error::ExportError;
use crate::selection::{Export, Form, Port, PortReport};
use crate::table_file::TableFile;
use crate::value::{Kind, Picture, Value};

/// Name of the list of all that was written.
pub const INDEX: &str = "index.csv";

/// Writes a folder. With `replaces`, a folder that is not empty is accepted: files of the same names are replaced,
/// other files stay.
///
/// # Errors
/// The folder is not empty, something cannot be written, or the recording is damaged.
pub fn write(export: &Export<'_>, folder: &Path, replaces: bool) -> Result<Vec<PortReport>, ExportError> {
    let is_taken = match fs::read_dir(folder) {
        Ok(mut entries) => entries.next().is_some(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => false,
        Err(cause) => return Err(ExportError::Write { path: folder.to_owned(), cause }),
    };
    if is_taken && !replaces {
        return Err(ExportError::Exists { path: folder.to_owned() });
    }
    let mut reports = Vec::new();
    for port in &export.ports {
        let report = match (&port.kind, file_name(port.name)) {
            (Err(why), _) => port.left_out(why.clone()),
            (_, None) => port.left_out("its name cannot be the name of a file"),
            (Ok(kind), Some(name)) => write_port(export, port, *kind, folder, &name)?,
        };
        reports.push(report);
    }
    write_index(folder, &reports)?;
    Ok(reports)
}

/// The port's name as a path below a folder, if it is one; parts of graphs become folders.
fn file_name(port: &str) -> Option<PathBuf> {
    let is_plain = |part: &str| {
        !part.is_empty()
            && !part.starts_with('.')
            && part.len() <= 200
            && part.chars().all(|c| c.is_alphanumeric() || matches!(c, '_' | '-' | '.'))
    };
    port.split('/').all(is_plain).then(|| PathBuf::from(port))
}

fn failed(path: &Path, cause: io::Error) -> ExportError {
    ExportError::Write { path: path.to_owned(), cause }
}

/// Writes a file and its folder.
fn write_file(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), ExportError> {
    let done = || {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        let mut file = BufWriter::new(File::create(path)?);
        write(&mut file)?;
        file.into_inner().map(drop).map_err(io::IntoInnerError::into_error)
    };
    done().map_err(|cause| failed(path, cause))
}

/// Output of one port.
struct PortFiles<'p> {
    folder: &'p Path,
    /// Path of the port's files below the folder.
    name: &'p Path,
    /// Source of the port's first packet. Ticks of another source, after a change of the graph, have its number in
    /// their file names.
    source: u32,
    table: TableFile,
    calibration: Option<Calibration>,
    /// Forms of the files of single ticks.
    form: Option<Form>,
}

impl PortFiles<'_> {
    fn path(&self, tick: &Tick, ending: &str) -> PathBuf {
        let name = match tick.source == self.source {
            true => format!("{:06}.{ending}", tick.seq),
            false => format!("source{}_{:06}.{ending}", tick.source, tick.seq),
        };
        self.folder.join(self.name).join(name)
    }

    fn picture(&mut self, tick: &Tick, picture: &Picture) -> Result<(), ExportError> {
        let pixels = picture.pixels();
        if let Pixels::F32(_) = pixels {
            self.form = Some("NPY");
            return write_file(&self.path(tick, "npy"), |out| array::write(out, ArrayFormat::Npy, &pixels));
        }
        self.form = Some("PNG");
        write_file(&self.path(tick, "png"), |out| {
            still::encode(out, "png", &pixels, 0, &mut Vec::new()).map_err(io::Error::other)
        })
    }

    fn take(&mut self, tick: &Tick, value: Value<'_>) -> Result<(), ExportError> {
        let mut line = CsvFields::default();
        line.integer("tick", tick.seq.into());
        line.integer("source", tick.source.into());
        line.integer("capture_ns", tick.capture_ns.into());
        match &value {
            Value::Picture(picture) => return self.picture(tick, picture),
            Value::Cloud(points, width) => {
                self.form = Some("PLY");
                return write_file(&self.path(tick, "ply"), |out| ply::write(out, points, *width, None).map(drop));
            }
            Value::Calibration(new) => {
                self.form = Some("YAML");
                if self.calibration.as_ref().is_some_and(|last| calibration::packet::same(last, new)) {
                    return Ok(());
                }
                self.calibration = Some(**new);
                let path = self.path(tick, "yml");
                return calibration::write(&path, new).map_err(|error| failed(&path, io::Error::other(error)));
            }
            Value::Detections(boxes) => {
                if let Some(masks) = Picture::of_masks(boxes) {
                    self.picture(tick, &masks)?;
                }
                let head = line.len();
                for item in boxes.items() {
                    line.truncate(head);
                    fields::detection(&item, boxes.label(item.class_index).unwrap_or(""), &mut line);
                    self.table.push(&line);
                }
                return Ok(());
            }
            Value::Table(table) => {
                let head = line.len();
                for row in 0..table.rows() {
                    line.truncate(head);
                    for (column, name) in table.names().enumerate() {
                        line.number(name, table.value(row, column).unwrap_or(f64::NAN));
                    }
                    self.table.push(&line);
                }
                return Ok(());
            }
            Value::Homography(value) => fields::homography(value, &mut line),
            Value::Roi(value) => fields::roi(value, &mut line),
            Value::Tip(value) => fields::tip(value, &mut line),
            Value::Pose(value) => fields::pose(value, &mut line),
            Value::Joints(value) => fields::joints(value, &mut line),
            Value::Scalar(value) => fields::scalar(value, &mut line),
            Value::Text(text) => line.text("text", text),
        }
        self.table.push(&line);
        Ok(())
    }
}

fn write_port(
    export: &Export<'_>,
    port: &Port<'_>,
    kind: Kind,
    folder: &Path,
    name: &Path,
) -> Result<PortReport, ExportError> {
    let source = port.packets.first().map_or(0, |packet: &&Packet| packet.head.tick.source);
    let mut files = PortFiles { folder, name, source, table: TableFile::default(), calibration: None, form: None };
    for packet in &port.packets {
        export.value(port, kind, packet, |value| files.take(&packet.head.tick, value))?;
    }
    let text = |path: &Path| path.to_string_lossy().into_owned();
    if let Some(form) = files.form
        && files.table.len() == 0
    {
        return Ok(port.written(form, text(name)));
    }
    let mut file = name.as_os_str().to_owned();
    file.push(".csv");
    let file = PathBuf::from(file);
    write_file(&folder.join(&file), |out| out.write_all(files.table.text().as_bytes()))?;
    Ok(port.written(if files.form.is_some() { "CSV and PNG" } else { "CSV" }, text(&file)))
}

fn write_index(folder: &Path, reports: &[PortReport]) -> Result<(), ExportError> {
    let mut index = TableFile::default();
    for report in reports {
        let mut line = CsvFields::default();
        line.text("port", &report.port);
        line.text("packet", &report.packet);
        line.number("packets", report.packets as f64);
        match &report.outcome {
            Ok((form, at)) => {
                line.text("form", form);
                line.text("path", at);
                line.text("left_out", "");
            }
            Err(why) => {
                line.text("form", "");
                line.text("path", "");
                line.text("left_out", why);
            }
        }
        index.push(&line);
    }
    write_file(&folder.join(INDEX), |out| out.write_all(index.text().as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_ports_stay_below_the_folder() {
        assert_eq!(file_name("stereo/match.disparity"), Some(PathBuf::from("stereo/match.disparity")));
        for port in ["../a.b", "/etc/a.b", "a/../b.c", "a//b.c", ".a.b", "a\0.b", "", "a/"] {
            assert_eq!(file_name(port), None, "{port:?}");
        }
    }
}
