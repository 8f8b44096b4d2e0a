//! Cameras of this machine, as Linux lists them.

use std::fs;
use std::path::{Path, PathBuf};

/// A V4L2 video device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Device {
    /// Path, `/dev/videoN`.
    pub path: PathBuf,
    /// Number N of the path.
    pub number: u32,
    /// Name that the driver reports.
    pub name: String,
}

/// All `/dev/video*` devices, sorted by number. A camera often has a second device for its metadata. Both are listed, because the list opens no
/// device.
pub fn list() -> Vec<Device> {
    list_in(Path::new("/sys/class/video4linux"))
}

fn list_in(class: &Path) -> Vec<Device> {
    let Ok(entries) = fs::read_dir(class) else { return Vec::new() };
    let mut devices: Vec<Device> = entries
        .flatten()
        .filter_map(|entry| {
            let file_name = entry.file_name();
            let number = file_name.to_str()?.strip_prefix("video")?.parse().ok()?;
            let name = fs::read_to_string(entry.path().join("name")).unwrap_or_default().trim().to_owned();
            Some(Device { path: Path::new("/dev").join(&file_name), number, name })
        })
        .collect();
    devices.sort_by_key(|device| device.number);
    devices
}

/// All devices in one line, for messages.
pub fn in_words() -> String {
    let devices = list();
    if devices.is_empty() {
        return "this machine has no video device".to_owned();
    }
    let names: Vec<String> = devices.iter().map(|d| format!("{} ({})", d.path.display(), d.name)).collect();
    format!("existing devices: {}", names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_sorted_by_number_and_named() {
        let class = std::env::temp_dir().join(format!("panoscope_v4l_{}", std::process::id()));
        for (device, name) in [("video10", "Right\n"), ("video2", "Left\n"), ("v4l-subdev0", "no\n")] {
            fs::create_dir_all(class.join(device)).unwrap();
            fs::write(class.join(device).join("name"), name).unwrap();
        }
        let found = list_in(&class);
        assert_eq!(found.iter().map(|d| (d.number, d.name.as_str())).collect::<Vec<_>>(), [(2, "Left"), (10, "Right")]);
        assert_eq!(found[0].path, Path::new("/dev/video2"));
        fs::remove_dir_all(&class).unwrap();
        assert!(list_in(&class).is_empty());
    }
}
