//! Calibration files of all kinds, read and checked.

use std::fs;
use std::path::{Path, PathBuf};

use panoscope_abi::Calibration;

use crate::document::Node;
use crate::error::{FileError, Mistake};
use crate::{kalibr, opencv, packet, ros};

/// Baselines that two places of a file state may differ by this part.
const BASELINE_PART: f64 = 0.01;

/// Reads a calibration: one file, or the two halves of one (OpenCV's intrinsics and extrinsics, ROS's left and right).
///
/// Lengths of OpenCV's files are taken for mm, those of ROS and Kalibr for metres. Width and height are 0 where the
/// file tells none, as OpenCV's sample writes it: whoever knows the views fills them in.
///
/// # Errors
/// [`FileError`] names file, line and column of what cannot be read, is missing, or cannot be: left and right swapped
/// (the disparities would be negative), no rotation, no baseline.
pub fn read(paths: &[PathBuf]) -> Result<Calibration, FileError> {
    let mut texts = Vec::new();
    for path in paths {
        let text = fs::read(path).map_err(|error| Mistake::whole(error.to_string()).in_file(path))?;
        let text = String::from_utf8(text)
            .map_err(|_| Mistake::whole("this is no text: a YAML calibration file is needed").in_file(path))?;
        texts.push((path.as_path(), text));
    }
    let texts: Vec<(&Path, &str)> = texts.iter().map(|(path, text)| (*path, text.as_str())).collect();
    parse(&texts)
}

/// As [`read`], of texts with the names that errors give them.
///
/// # Errors
/// As [`read`].
pub fn parse(texts: &[(&Path, &str)]) -> Result<Calibration, FileError> {
    let Some((first, _)) = texts.first() else {
        return Err(Mistake::whole("no calibration file is given").in_file(Path::new("")));
    };
    let mut documents = Vec::new();
    for (path, text) in texts {
        if text.trim().is_empty() {
            return Err(Mistake::whole("the file is empty").in_file(path));
        }
        documents.push(Node::parse(text).map_err(|mistake| mistake.in_file(path))?);
    }
    let blame = |(index, mistake): (usize, Mistake)| mistake.in_file(texts.get(index).map_or(first, |(path, _)| path));
    let calibration = match &documents[..] {
        [left, right] if ros::is(left) && ros::is(right) => ros::packet(left, right).map_err(blame)?,
        [one] if ros::is(one) => {
            let what = "this camera_info describes one camera: give the left and the right file";
            return Err(Mistake::whole(what).in_file(first));
        }
        [one] if kalibr::is(one) => kalibr::packet(one).map_err(|mistake| mistake.in_file(first))?,
        all if opencv::is(all) => opencv::packet(all).map_err(blame)?,
        _ => {
            let what = "no calibration of a stereo pair: neither OpenCV's (M1, D1, M2, D2, R, T), nor ROS camera_info, nor a Kalibr camera chain; the file is cut off or of another kind";
            return Err(Mistake::whole(what).in_file(first));
        }
    };
    check(&calibration).map_err(|what| Mistake::whole(what).in_file(first))?;
    Ok(calibration)
}

/// Refuses what no pair of cameras can have.
fn check(calibration: &Calibration) -> Result<(), String> {
    let mut known = *calibration;
    for camera in [&mut known.left, &mut known.right] {
        if camera.width == 0 {
            // Any size will do: nothing that is checked here depends on it.
            (camera.width, camera.height) = ((2.0 * camera.cx).max(2.0) as u32, (2.0 * camera.cy).max(2.0) as u32);
        }
        packet::camera(camera).map_err(|error| error.to_string())?;
    }
    if calibration.left.width == 0 {
        (known.right.width, known.right.height) = (known.left.width, known.left.height);
    }
    // What the cameras themselves say, whatever the file says of their rectification.
    let bare = Calibration { left_projection: [0.0; 12], right_projection: [0.0; 12], ..known };
    let computed = packet::rectification(&bare).map_err(|error| error.to_string())?;
    let stated = packet::rectification(&known).map_err(|error| error.to_string())?;
    if (computed.baseline_mm - stated.baseline_mm).abs() > BASELINE_PART * computed.baseline_mm {
        return Err(format!(
            "its parts do not belong together: the translation between the cameras is {:.3} mm long, the projection says {:.3} mm",
            computed.baseline_mm, stated.baseline_mm
        ));
    }
    Ok(())
}

/// Writes a calibration as OpenCV's `FileStorage` YAML, in one step, so that nobody reads half of it.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, calibration: &Calibration) -> Result<(), FileError> {
    let fail = |error: std::io::Error| Mistake::whole(format!("cannot be written: {error}")).in_file(path);
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(fail)?;
    }
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    fs::write(&part, opencv::text_of(calibration)).map_err(fail)?;
    fs::rename(&part, path).map_err(fail)
}
