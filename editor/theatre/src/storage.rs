//! Stills and clips: where they go, how they are called, how they survive a crash.
//!
//! Names are numbers: nothing that names a patient, a day or a place is written unless a label is asked for. A still is written whole or not at
//! all. A clip is a `write_video` node that is added to the running graph and taken out again; its file (MKV) plays up to its last whole frame
//! whatever ends it.

use std::ffi::CString;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use panoscope_editor_model::numbered;
use panoscope_graph::edit::{EditError, GraphEdit};

use panoscope_editor_model::disk;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::picture::Pixels;

/// Time from one look at the disk to the next.
const LOOK: Duration = Duration::from_secs(2);

/// Room left in a folder, or in the nearest one above it that exists, in bytes.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    let there = std::path::absolute(folder).ok()?;
    let there = there.ancestors().find(|f| f.is_dir())?;
    let path = CString::new(there.as_os_str().as_bytes()).ok()?;
    // SAFETY: all zero is a value of this plain struct.
    let mut found: libc::statvfs = unsafe { std::mem::zeroed() };
    // SAFETY: the path ends with a zero and the struct is there to be filled.
    let answer = unsafe { libc::statvfs(path.as_ptr(), &raw mut found) };
    (answer == 0).then(|| found.f_bavail as u64 * found.f_frsize as u64)
}

/// A PNG of a picture.
fn png(pixels: &Pixels) -> Result<Vec<u8>, image::ImageError> {
    let rgb: Vec<u8> = pixels.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let mut out = Vec::with_capacity(rgb.len() / 2);
    let encoder = PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Adaptive);
    let (width, height) = (pixels.width as u32, pixels.height as u32);
    encoder.write_image(&rgb, width, height, image::ExtendedColorType::Rgb8)?;
    Ok(out)
}

/// Writes a still, whole or not at all.
///
/// # Errors
/// In words.
pub fn write_still(file: &Path, pixels: &Pixels) -> Result<(), String> {
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let fail = |why: String| format!("{name} was not written: {why}");
    let bytes = png(pixels).map_err(|e| fail(e.to_string()))?;
    disk::replace(file, &bytes, None).map_err(|e| {
        fail(if e.kind() == std::io::ErrorKind::StorageFull { "the disk is full".to_owned() } else { e.to_string() })
    })
}

/// A clip under way.
#[derive(Clone, Debug)]
pub struct Clip {
    /// The node that writes it.
    pub node: String,
    /// Its file.
    pub file: PathBuf,
    /// Since when.
    pub since: Instant,
}

/// Adds the node that writes a clip to a graph's text; answers the new text and the node's name.
///
/// # Errors
/// The text cannot be edited like that.
pub fn with_clip(text: &str, output: &Output, file: &Path) -> Result<(String, String), EditError> {
    let mut edit = GraphEdit::parse(text)?;
    let taken = edit.node_names();
    let names = std::iter::once("theatre_clip".to_owned()).chain((2..).map(|k| format!("theatre_clip_{k}")));
    let node = names.into_iter().find(|n| !taken.contains(n)).unwrap_or_default();
    let file = toml::Value::from(file.to_string_lossy().into_owned());
    // A clip shows what was seen: it lasts as long as it was recorded, however slow the machine is. A fault ends it, and no file is ever replaced.
    let part = format!(
        "[nodes.{node}]\ntype = \"sinks/write_video\"\ninputs = {{ image = \"{output}\" }}\nparams = {{ path = {file}, time = \"passed\", replace = false }}\non_fault = \"bypass\"\n"
    );
    edit.add_plugin("sinks")?;
    edit.paste_nodes(&GraphEdit::parse(&part)?, &[(node.clone(), node.clone())])?;
    Ok((edit.text(), node))
}

/// Takes it out again.
///
/// # Errors
/// The text cannot be edited like that.
pub fn without_clip(text: &str, node: &str) -> Result<String, EditError> {
    let mut edit = GraphEdit::parse(text)?;
    edit.remove_node(node)?;
    Ok(edit.text())
}

struct Order {
    file: PathBuf,
    pixels: Pixels,
}

/// Writes stills on a thread of its own, so that the picture goes on meanwhile, and looks at the disk.
pub struct Keeper {
    folder: PathBuf,
    label: String,
    next: u32,
    orders: Option<Sender<Order>>,
    done: Receiver<Result<String, String>>,
    thread: Option<JoinHandle<()>>,
    free: Option<u64>,
    looked: Option<Instant>,
}

/// What may stand in a file's name.
fn tidy(label: &str) -> String {
    let good = |c: char| if c.is_alphanumeric() || c == '-' { c } else { '_' };
    label.trim().chars().map(good).collect()
}

impl Keeper {
    /// Writes into `folder`, which is made when it is needed. Names begin with `label` where there is one.
    ///
    /// # Errors
    /// The system gave no thread.
    pub fn new(folder: &Path, label: Option<&str>) -> std::io::Result<Self> {
        let (orders, todo) = channel::<Order>();
        let (tell, done) = channel();
        let thread = std::thread::Builder::new().name("stills".to_owned()).spawn(move || {
            for order in todo {
                let name = order.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                let _ = tell.send(write_still(&order.file, &order.pixels).map(|()| name));
            }
        })?;
        // Nodes are told whole paths: theirs would start from the graph's folder.
        let folder = std::path::absolute(folder)?;
        let label = label.map(|l| format!("{}_", tidy(l))).unwrap_or_default();
        let next = numbered::newest(&folder) + 1;
        let (orders, thread) = (Some(orders), Some(thread));
        Ok(Self { folder, label, next, orders, done, thread, free: None, looked: None })
    }

    /// The next file of a kind, such as `still` with `png`; its folder is there.
    ///
    /// # Errors
    /// In words, when the folder cannot be made.
    pub fn next_file(&mut self, kind: &str, ending: &str) -> Result<PathBuf, String> {
        std::fs::create_dir_all(&self.folder).map_err(|e| format!("{} cannot be made: {e}", self.folder.display()))?;
        let file = self.folder.join(format!("{}{kind}_{:04}.{ending}", self.label, self.next));
        self.next += 1;
        Ok(file)
    }

    /// Sets a still to be written.
    ///
    /// # Errors
    /// In words.
    pub fn still(&mut self, pixels: Pixels) -> Result<(), String> {
        let file = self.next_file("still", "png")?;
        let sent = self.orders.as_ref().map(|orders| orders.send(Order { file, pixels }));
        if matches!(sent, Some(Ok(()))) { Ok(()) } else { Err("the still was not written".to_owned()) }
    }

    /// Stills that were written, or were not, since the last call.
    pub fn finished(&self) -> Vec<Result<String, String>> {
        self.done.try_iter().collect()
    }

    /// Room left, looked up every few seconds.
    pub fn free_bytes(&mut self) -> Option<u64> {
        if self.looked.is_none_or(|at| at.elapsed() > LOOK) {
            self.looked = Some(Instant::now());
            self.free = free_bytes(&self.folder);
        }
        self.free
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.orders = None;
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
    fn names_are_numbers_that_go_on() {
        let folder = std::env::temp_dir().join(format!("panoscope_keep_{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let mut keeper = Keeper::new(&folder, None).unwrap();
        let pixels = Pixels { width: 2, height: 1, rgba: vec![9, 8, 7, 255, 1, 2, 3, 255] };
        keeper.still(pixels.clone()).unwrap();
        keeper.still(pixels).unwrap();
        drop(keeper);
        let mut names: Vec<String> =
            std::fs::read_dir(&folder).unwrap().map(|f| f.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        assert_eq!(names, ["still_0001.png", "still_0002.png"], "and nothing half-written");
        let picture = image::open(folder.join("still_0001.png")).unwrap().to_rgb8();
        assert_eq!(picture.into_raw(), [9, 8, 7, 1, 2, 3]);
        let mut keeper = Keeper::new(&folder, Some("case 7")).unwrap();
        let clip = keeper.next_file("clip", "mkv").unwrap();
        assert!(clip.is_absolute() && clip.ends_with("case_7_clip_0003.mkv"), "{}", clip.display());
        assert!(keeper.free_bytes().is_some_and(|free| free > 0));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_told() {
        let file = std::env::temp_dir().join(format!("panoscope_keep_file_{}", std::process::id()));
        std::fs::write(&file, "").unwrap();
        let error = Keeper::new(&file.join("in"), None).unwrap().next_file("still", "png").unwrap_err();
        assert!(error.contains("cannot be made"), "{error}");
        std::fs::remove_file(file).unwrap();
    }

    #[test]
    fn a_clip_is_added_and_taken_out_without_a_trace() {
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
