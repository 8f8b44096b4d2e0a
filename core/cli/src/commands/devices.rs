//! `panoscope devices`.

use std::fs;
use std::path::PathBuf;

use anyhow::Result;
use serde::Serialize;

use crate::End;
use crate::terminal::out;

/// Arguments of `devices`.
#[derive(clap::Args)]
pub struct Arguments {
    /// As JSON.
    #[arg(long)]
    json: bool,
}

/// A video device.
#[derive(Debug, Serialize)]
pub struct Device {
    /// Its file.
    pub path: PathBuf,
    /// Name given by its driver.
    pub name: String,
    /// Whether this user may open it; `None` when its file is missing.
    pub accessible: Option<bool>,
}

/// Video devices that deliver images, without those for metadata only.
pub fn cameras() -> Vec<Device> {
    let Ok(entries) = fs::read_dir("/sys/class/video4linux") else { return Vec::new() };
    let mut numbered: Vec<(u32, Device)> = entries
        .flatten()
        .filter_map(|entry| {
            let file = entry.file_name().into_string().ok()?;
            let number = file.strip_prefix("video")?.parse().ok()?;
            let text = |name: &str| fs::read_to_string(entry.path().join(name)).unwrap_or_default().trim().to_owned();
            // A camera's further nodes (index above 0) carry metadata.
            if !matches!(text("index").as_str(), "" | "0") {
                return None;
            }
            let path = PathBuf::from("/dev").join(&file);
            let c_path = std::ffi::CString::new(path.to_string_lossy().as_bytes()).ok()?;
            // SAFETY: a terminated path.
            let accessible =
                path.exists().then(|| unsafe { libc::access(c_path.as_ptr(), libc::R_OK | libc::W_OK) } == 0);
            Some((number, Device { path, name: text("name"), accessible }))
        })
        .collect();
    numbered.sort_by_key(|(number, _)| *number);
    numbered.into_iter().map(|(_, device)| device).collect()
}

/// Lists cameras.
pub fn run(arguments: &Arguments) -> Result<End> {
    let cameras = cameras();
    if arguments.json {
        out!("{}", serde_json::to_string_pretty(&cameras)?);
        return Ok(End::Done);
    }
    if cameras.is_empty() {
        out!("no cameras (no video devices in /sys/class/video4linux)");
    }
    for camera in &cameras {
        let note = match camera.accessible {
            Some(true) => "",
            Some(false) => "  (no permission: join the group `video`)",
            None => "  (its device file is missing)",
        };
        out!("{}  {}{note}", camera.path.display(), camera.name);
    }
    Ok(End::Done)
}
