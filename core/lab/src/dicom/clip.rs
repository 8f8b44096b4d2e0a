//! Clips as MP4 with H.264, for DICOM.

use std::fs;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use panoscope_cli::beside;
use panoscope_export::dicom::DicomError;
use panoscope_export::dicom::object::Clip;

use panoscope_cli::terminal::log;

/// Constant rate factor of the video: visually close to the original.
const CRF: u8 = 18;

/// MP4 files made of clips, in a hidden folder that is removed when this is dropped.
pub struct Clips {
    folder: PathBuf,
    count: u32,
}

impl Clips {
    /// For clips of objects in `outbox`.
    pub fn new(outbox: &Path) -> Self {
        Self { folder: outbox.join(format!(".clips.{}", std::process::id())), count: 0 }
    }

    /// The MP4 form of a clip: the clip itself if the standard allows its video, else a new file.
    ///
    /// # Errors
    /// The clip cannot be read or converted.
    pub fn mp4_of(&mut self, clip: &Path) -> Result<PathBuf, DicomError> {
        let is_mp4 = clip.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mp4"));
        if is_mp4 && Clip::open(clip, clip).is_ok() {
            return Ok(clip.to_owned());
        }
        let wrong = |problem: String| DicomError::Input { file: clip.to_owned(), problem };
        log!("converting {} to H.264", clip.display());
        let mut builder = fs::DirBuilder::new();
        let made = builder.recursive(true).mode(0o700).create(&self.folder);
        made.map_err(|cause| DicomError::Write { file: self.folder.clone(), cause })?;
        self.count += 1;
        let mp4 = self.folder.join(format!("{}.mp4", self.count));
        let graph = self.folder.join(format!("{}.toml", self.count));
        let text = graph_text(clip, &mp4).map_err(|error| wrong(error.to_string()))?;
        fs::write(&graph, text).map_err(|cause| DicomError::Write { file: graph.clone(), cause })?;
        let program = beside::file(beside::PROGRAM).map_err(|error| wrong(error.to_string()))?;
        let mut run = Command::new(program);
        run.arg("run").arg(&graph).arg("--headless").stdin(Stdio::null()).stdout(Stdio::null());
        let output = run.output().map_err(|error| wrong(error.to_string()))?;
        if output.status.success() && mp4.is_file() {
            return Ok(mp4);
        }
        let words = String::from_utf8_lossy(&output.stderr);
        let words = words.lines().find(|line| line.contains("error")).unwrap_or("the conversion failed").to_owned();
        Err(wrong(format!("it cannot be converted to H.264: {words}")))
    }
}

impl Drop for Clips {
    fn drop(&mut self) {
        if self.count > 0 {
            let _ = fs::remove_dir_all(&self.folder);
        }
    }
}

/// A path that a graph cannot name.
#[derive(Debug, thiserror::Error)]
enum PathError {
    #[error("{0}")]
    Absolute(#[from] std::io::Error),
    #[error("{} is not UTF-8", .path.display())]
    NotUtf8 { path: PathBuf },
}

/// A graph that converts a clip. Damaged frames are skipped, as by players.
fn graph_text(clip: &Path, mp4: &Path) -> Result<String, PathError> {
    let absolute = |path: &Path| {
        let path = std::path::absolute(path)?;
        let text = path.to_str().ok_or_else(|| PathError::NotUtf8 { path: path.clone() })?;
        Ok::<_, PathError>(toml::Value::from(text).to_string())
    };
    let (clip, mp4) = (absolute(clip)?, absolute(mp4)?);
    Ok(format!(
        r#"name = "clip"
mode = "batch"
plugins = ["capture", "sinks"]

[nodes.clip]
type = "capture"
params = {{ left = {clip}, on_damage = "skip" }}

[nodes.mp4]
type = "write_video"
inputs = {{ image = "clip.left" }}
params = {{ path = {mp4}, codec = "h264", crf = {CRF} }}
"#
    ))
}
