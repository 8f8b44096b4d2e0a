//! Stills and clips: their files and names, and how they survive a crash.
//!
//! Names are numbers: they contain no patient, date or place unless the user gives a label. A still is written atomically. A clip is a
//! `write_video` node that is added to the running graph and removed again; its file (MKV) can be played up to its last complete frame, however
//! the recording ends.

use std::ffi::CString;
use std::fs::Permissions;
use std::io::Write;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use panoscope_base::files;
use panoscope_editor_model::numbered::{self, FolderError};
use panoscope_editor_model::texts::text;
use panoscope_graph::edit::{EditError, GraphEdit};

use panoscope_editor_model::observe::Output;
use panoscope_editor_model::pixels::Pixels;

use super::time;

/// Time between two readings of the free space.
const POLL_INTERVAL: Duration = Duration::from_secs(2);

/// Free space in bytes for a folder, or for its nearest existing parent.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    let folder = std::path::absolute(folder).ok()?;
    let existing = folder.ancestors().find(|f| f.is_dir())?;
    let path = CString::new(existing.as_os_str().as_bytes()).ok()?;
    // SAFETY: `statvfs` is a C struct of integers, for which all zero bytes are valid.
    let mut stat: libc::statvfs = unsafe { std::mem::zeroed() };
    // SAFETY: `path` is zero-terminated and `stat` is valid for the call to write to.
    let status = unsafe { libc::statvfs(path.as_ptr(), &raw mut stat) };
    (status == 0).then(|| stat.f_bavail as u64 * stat.f_frsize as u64)
}

/// Encodes an image as PNG.
fn png(pixels: &Pixels) -> Result<Vec<u8>, image::ImageError> {
    let rgb: Vec<u8> = pixels.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let mut out = Vec::with_capacity(rgb.len() / 2);
    let encoder = PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Adaptive);
    let (width, height) = (pixels.width as u32, pixels.height as u32);
    encoder.write_image(&rgb, width, height, image::ExtendedColorType::Rgb8)?;
    Ok(out)
}

/// Why a still was not written.
#[derive(Debug, thiserror::Error)]
pub enum StillError {
    /// The folder cannot be created.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The image cannot be encoded.
    #[error("{name} was not written: {cause}")]
    Encode {
        /// Name of the still.
        name: String,
        /// The encoder's error.
        cause: image::ImageError,
    },
    /// The disk is full.
    #[error("{name} was not written: the disk is full")]
    DiskFull {
        /// Name of the still.
        name: String,
    },
    /// The file cannot be written.
    #[error("{name} was not written: {cause}")]
    Write {
        /// Name of the still.
        name: String,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The thread that writes stills has ended.
    #[error("the still was not written: the writing thread has ended")]
    NoThread,
}

impl StillError {
    /// The error in the language of the window. What the system says stays as it is.
    pub fn words(&self) -> String {
        match self {
            Self::Folder(error) => error.to_string(),
            Self::Encode { name, cause } => text!("not-written", file = name, reason = cause.to_string()),
            Self::DiskFull { name } => text!("not-written-full", file = name),
            Self::Write { name, cause } => text!("not-written", file = name, reason = cause.to_string()),
            Self::NoThread => text!("not-written-thread").to_owned(),
        }
    }
}

/// Writes a still atomically.
///
/// # Errors
/// See [`StillError`]; an older file is unchanged.
pub fn write_still(file: &Path, pixels: &Pixels) -> Result<(), StillError> {
    let bytes = png(pixels).map_err(|cause| StillError::Encode { name: name_of(file), cause })?;
    write(file, &bytes)
}

fn name_of(file: &Path) -> String {
    file.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn write(file: &Path, bytes: &[u8]) -> Result<(), StillError> {
    // Only its owner may look at a patient.
    let mode = Permissions::from_mode(0o600);
    files::replace_with(file, Some(mode), |out| out.write_all(bytes)).map_err(|cause| match cause.kind() {
        std::io::ErrorKind::StorageFull => StillError::DiskFull { name: name_of(file) },
        _ => StillError::Write { name: name_of(file), cause },
    })
}

/// Writes the measurement of a still beside it: one line with the name of the picture and a table as that of a node `measure`, as JSON.
fn write_table(still: &Path, row: &serde_json::Value) -> Result<(), StillError> {
    let line = serde_json::json!({ "picture": name_of(still), "table": [row] });
    write(&still.with_extension("jsonl"), format!("{line}\n").as_bytes())
}

/// Why a clip could not be started.
#[derive(Debug, thiserror::Error)]
pub enum ClipError {
    /// The folder cannot be created.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The node that writes the clip cannot be added to the graph.
    #[error(transparent)]
    Edit(#[from] EditError),
}

/// A clip being recorded.
#[derive(Clone, Debug)]
pub struct Clip {
    /// The node that writes it.
    pub node: String,
    /// Its file.
    pub file: PathBuf,
    /// Its number.
    pub number: u32,
    /// When it was started.
    pub since: Instant,
}

/// Adds the node that writes a clip to a graph's text; returns the new text and the node's name.
///
/// # Errors
/// The edit does not fit the text.
pub fn with_clip(text: &str, output: &Output, file: &Path) -> Result<(String, String), EditError> {
    let mut edit = GraphEdit::parse(text)?;
    let taken = edit.node_names();
    let names = std::iter::once("theatre_clip".to_owned()).chain((2..).map(|k| format!("theatre_clip_{k}")));
    let node = names.into_iter().find(|n| !taken.contains(n)).unwrap_or_default();
    let file = toml::Value::from(file.to_string_lossy().into_owned());
    // The clip plays in real time, however slow the machine is (`time = "passed"`). A fault ends it. No file is ever replaced.
    let part = format!(
        "[nodes.{node}]\ntype = \"sinks/write_video\"\ninputs = {{ image = \"{output}\" }}\nparams = {{ path = {file}, time = \"passed\", replace = false }}\non_fault = \"bypass\"\n"
    );
    edit.add_plugin("sinks")?;
    edit.paste_nodes(&GraphEdit::parse(&part)?, &[(node.clone(), node.clone())])?;
    Ok((edit.text(), node))
}

/// Removes the node that writes a clip from a graph's text.
///
/// # Errors
/// The edit does not fit the text.
pub fn without_clip(text: &str, node: &str) -> Result<String, EditError> {
    let mut edit = GraphEdit::parse(text)?;
    edit.remove_node(node)?;
    Ok(edit.text())
}

/// A still to be written.
struct StillJob {
    file: PathBuf,
    pixels: Pixels,
    /// What was measured in it.
    row: Option<serde_json::Value>,
}

/// Files of stills and clips: writes stills on a thread of its own, so that the window is not blocked, and reads the free space.
pub struct Storage {
    folder: PathBuf,
    label: String,
    next: u32,
    jobs: Option<Sender<StillJob>>,
    done: Receiver<Result<String, StillError>>,
    thread: Option<JoinHandle<()>>,
    free: Option<u64>,
    polled: Option<Instant>,
}

/// Replaces characters that are not safe in a file name.
fn sanitize(label: &str) -> String {
    let good = |c: char| if c.is_alphanumeric() || c == '-' { c } else { '_' };
    label.trim().chars().map(good).collect()
}

impl Storage {
    /// Storage in `folder`, which is created when it is needed. Names begin with `label` if there is one.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn new(folder: &Path, label: Option<&str>) -> std::io::Result<Self> {
        let (jobs, queue) = channel::<StillJob>();
        let (results, done) = channel();
        let thread = std::thread::Builder::new().name("stills".to_owned()).spawn(move || {
            for job in queue {
                let table = |()| job.row.as_ref().map_or(Ok(()), |row| write_table(&job.file, row));
                let written = write_still(&job.file, &job.pixels).and_then(table);
                let _ = results.send(written.map(|()| name_of(&job.file)));
            }
        })?;
        // Absolute, because relative paths in a graph start from the graph's folder.
        let folder = std::path::absolute(folder)?;
        let label = label.map(|l| format!("{}_", sanitize(l))).unwrap_or_default();
        let next = numbered::newest(&folder) + 1;
        let (jobs, thread) = (Some(jobs), Some(thread));
        Ok(Self { folder, label, next, jobs, done, thread, free: None, polled: None })
    }

    /// The path of the next file of a kind, such as `still` with the ending `png`. Creates the folder.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub fn next_file(&mut self, kind: &str, ending: &str) -> Result<PathBuf, FolderError> {
        numbered::create_folder(&self.folder)?;
        let file = self.folder.join(format!("{}{kind}_{:04}.{ending}", self.label, self.next));
        self.next += 1;
        Ok(file)
    }

    /// Queues a still for writing, with what was measured in it, and returns its number; [`Self::finished`] returns the result.
    ///
    /// # Errors
    /// The folder cannot be created, or the writing thread has ended.
    pub fn still(&mut self, pixels: Pixels, row: Option<serde_json::Value>) -> Result<u32, StillError> {
        let number = self.next;
        let file = self.next_file("still", "png")?;
        let sent = self.jobs.as_ref().map(|jobs| jobs.send(StillJob { file, pixels, row }));
        if matches!(sent, Some(Ok(()))) { Ok(number) } else { Err(StillError::NoThread) }
    }

    /// Adds the node that records `output` to a graph's text; returns the new text and the clip.
    ///
    /// # Errors
    /// The folder cannot be created, or the edit does not fit the text.
    pub fn start_clip(&mut self, text: &str, output: &Output) -> Result<(String, Clip), ClipError> {
        let number = self.next;
        let file = self.next_file("clip", "mkv")?;
        let (text, node) = with_clip(text, output, &file)?;
        Ok((text, Clip { node, file, number, since: time::now() }))
    }

    /// Names of the stills written since the last call, and errors.
    pub fn finished(&self) -> Vec<Result<String, StillError>> {
        self.done.try_iter().collect()
    }

    /// Free space in bytes, read every few seconds.
    pub fn free_bytes(&mut self) -> Option<u64> {
        if self.polled.is_none_or(|at| time::since(at) > POLL_INTERVAL) {
            self.polled = Some(time::now());
            self.free = free_bytes(&self.folder);
        }
        self.free
    }
}

impl Drop for Storage {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_graph::GraphText;

    #[test]
    fn names_have_consecutive_numbers() {
        let folder = std::env::temp_dir().join(format!("panoscope_storage_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let mut storage = Storage::new(&folder, None).unwrap();
        let pixels = Pixels { width: 2, height: 1, rgba: vec![9, 8, 7, 255, 1, 2, 3, 255] };
        storage.still(pixels.clone(), None).unwrap();
        storage.still(pixels, Some(serde_json::json!({ "distance_mm": 9.5 }))).unwrap();
        drop(storage);
        let mut names: Vec<String> =
            std::fs::read_dir(&folder).unwrap().map(|f| f.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        assert_eq!(names, ["still_0001.png", "still_0002.jsonl", "still_0002.png"], "no partial files");
        let table = std::fs::read_to_string(folder.join("still_0002.jsonl")).unwrap();
        assert_eq!(table, "{\"picture\":\"still_0002.png\",\"table\":[{\"distance_mm\":9.5}]}\n");
        let mode = |path: &Path| path.metadata().unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&folder), mode(&folder.join("still_0001.png"))), (0o700, 0o600));
        let picture = image::open(folder.join("still_0001.png")).unwrap().to_rgb8();
        assert_eq!(picture.into_raw(), [9, 8, 7, 1, 2, 3]);
        let mut storage = Storage::new(&folder, Some("case 7")).unwrap();
        let clip = storage.next_file("clip", "mkv").unwrap();
        assert!(clip.is_absolute() && clip.ends_with("case_7_clip_0003.mkv"), "{}", clip.display());
        assert!(storage.free_bytes().is_some_and(|free| free > 0));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_created_is_an_error() {
        let file = std::env::temp_dir().join(format!("panoscope_storage_file_{}", std::process::id()));
        std::fs::write(&file, "").unwrap();
        let error = Storage::new(&file.join("in"), None).unwrap().next_file("still", "png").unwrap_err();
        assert!(error.to_string().contains("cannot be created"), "{error}");
        std::fs::remove_file(file).unwrap();
    }

    #[test]
    fn a_clip_is_added_and_removed_without_a_trace() {
        let text = "# mine\nplugins = [\"flow\"]\n[nodes.a]\ntype = \"frames\" # source\n";
        let (with, node) = with_clip(text, &Output::new("a", "image"), Path::new("/x/clip \"1\".mkv")).unwrap();
        let parsed = GraphText::parse("g.toml".as_ref(), &with);
        assert_eq!(parsed.plugins(), ["flow", "sinks"]);
        let outline = parsed.outline();
        assert_eq!(outline[1].params["path"].as_str(), Some("/x/clip \"1\".mkv"));
        assert_eq!(outline[1].params["time"].as_str(), Some("passed"));
        assert!(with.contains("on_fault = \"bypass\""));
        let (twice, second) = with_clip(&with, &Output::new("a", "image"), Path::new("/x/2.mkv")).unwrap();
        assert_eq!((node.as_str(), second.as_str()), ("theatre_clip", "theatre_clip_2"));
        let without = without_clip(&without_clip(&twice, &second).unwrap(), &node).unwrap();
        let nodes: Vec<String> =
            GraphText::parse("g.toml".as_ref(), &without).outline().into_iter().map(|n| n.id).collect();
        assert_eq!(nodes, ["a"]);
        assert!(without.starts_with("# mine") && without.contains("# source"));
    }
}
