//! Calibration files of all kinds, read and checked.

use std::fs;
use std::path::{Path, PathBuf};

use panoscope_abi::Calibration;
use panoscope_imaging::stereo::StereoError;
use thiserror::Error;

use crate::document::Node;
use crate::error::{FileError, Mistake};
use crate::{kalibr, opencv, packet, ros};

/// Largest relative difference between two baselines that one file states.
const BASELINE_PART: f64 = 0.01;

/// Reads a calibration: one file, or the two halves of one (OpenCV's intrinsics and extrinsics, ROS's left and right).
///
/// Lengths in OpenCV's files are in mm, those in ROS and Kalibr files in metres. Width and height are 0 when the file does
/// not state them, as in the output of OpenCV's sample; the caller takes them from the views.
///
/// # Errors
/// [`FileError`] names file, line and column of what is unreadable, missing or impossible: left and right swapped
/// (the disparities would be negative), a matrix that is not a rotation, no baseline.
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

/// Reads a calibration from the texts of its files; errors use the given names.
///
/// # Errors
/// The same as those of [`read`], except for files that cannot be opened.
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
    check(&calibration).map_err(|why| Mistake::whole(why.to_string()).in_file(first))?;
    Ok(calibration)
}

/// Why the numbers of a file, each of them readable, describe no pair of cameras.
#[derive(Debug, Error)]
enum Contradiction {
    /// A camera or the rectification is impossible.
    #[error(transparent)]
    Cameras(#[from] StereoError),
    /// The extrinsics and the rectified projections state different baselines.
    #[error(
        "its parts do not belong together: the translation between the cameras is {translation_mm:.3} mm long, the projection says {projection_mm:.3} mm"
    )]
    Baseline { translation_mm: f64, projection_mm: f64 },
}

/// Refuses cameras that cannot exist, and parts of different calibrations.
fn check(calibration: &Calibration) -> Result<(), Contradiction> {
    let mut known = *calibration;
    for camera in [&mut known.left, &mut known.right] {
        if camera.width == 0 {
            // Nothing that is checked here depends on the size.
            (camera.width, camera.height) = ((2.0 * camera.cx).max(2.0) as u32, (2.0 * camera.cy).max(2.0) as u32);
        }
        packet::camera(camera)?;
    }
    if calibration.left.width == 0 {
        (known.right.width, known.right.height) = (known.left.width, known.left.height);
    }
    // The baseline from the extrinsics alone, without the rectification that the file states.
    let bare = Calibration { left_projection: [0.0; 12], right_projection: [0.0; 12], ..known };
    let computed = packet::rectification(&bare)?;
    let stated = packet::rectification(&known)?;
    if (computed.baseline_mm - stated.baseline_mm).abs() > BASELINE_PART * computed.baseline_mm {
        let (translation_mm, projection_mm) = (computed.baseline_mm, stated.baseline_mm);
        return Err(Contradiction::Baseline { translation_mm, projection_mm });
    }
    Ok(())
}

/// Writes a calibration as OpenCV's `FileStorage` YAML. The file is renamed into place, so a reader never sees half of it.
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
