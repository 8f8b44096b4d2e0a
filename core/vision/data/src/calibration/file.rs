//! Calibration files of all kinds, read and checked.

use std::fs;
use std::path::{Path, PathBuf};

use panoscope_abi::Calibration;
use panoscope_base::files;
use panoscope_imaging::stereo::StereoError;
use thiserror::Error;

use crate::calibration::document::Node;
use crate::calibration::error::{FileError, Mistake};
use crate::calibration::{
    endovis, equidistant_of, hamlyn, kalibr, kitti, matlab, middlebury, opencv, packet, ros, stereomis,
};

/// Largest relative difference between two baselines that one file states.
const BASELINE_PART: f64 = 0.01;

/// Which pair of KITTI's four cameras the views come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KittiCameras {
    /// Cameras 0 and 1.
    Gray,
    /// Cameras 2 and 3.
    Colour,
}

/// Reads a calibration: one file, or the two halves of one (OpenCV's intrinsics and extrinsics, ROS's left and right, Hamlyn's intrinsics and
/// extrinsics).
///
/// Lengths in OpenCV's files, MATLAB's without a unit, and those of Middlebury, StereoMIS, EndoVis and Hamlyn are in mm, those in ROS, Kalibr and KITTI files in metres.
/// Width and height are 0 when the file does not state them, as in the output of OpenCV's sample; the caller takes them from the views. Of KITTI's
/// cameras those in colours are taken where the file has them; see [`read_kitti`].
///
/// # Errors
/// [`FileError`] names file, line and column of what is unreadable, missing or impossible: left and right swapped
/// (the disparities would be negative), a matrix that is not a rotation, no baseline.
pub fn read(paths: &[PathBuf]) -> Result<Calibration, FileError> {
    let mut texts = Vec::new();
    for path in paths {
        texts.push((path.as_path(), text_in(path)?));
    }
    let texts: Vec<(&Path, &str)> = texts.iter().map(|(path, text)| (*path, text.as_str())).collect();
    parse(&texts)
}

/// Reads one pair of cameras from a file of KITTI (`calib.txt`, `calib_cam_to_cam.txt`).
///
/// # Errors
/// As [`read`]; also when the file is none of KITTI's.
pub fn read_kitti(path: &Path, cameras: KittiCameras) -> Result<Calibration, FileError> {
    let text = text_in(path)?;
    let pair = if cameras == KittiCameras::Gray { kitti::GRAY } else { kitti::COLOUR };
    let calibration = kitti::packet(&text, Some(pair)).map_err(|mistake| mistake.in_file(path))?;
    check(&calibration).map_err(|why| Mistake::whole(why.to_string()).in_file(path))?;
    Ok(calibration)
}

/// Largest file that is read, in bytes.
const MAX_BYTES: u64 = 16 << 20;

fn text_in(path: &Path) -> Result<String, FileError> {
    let fail = |what: String| Mistake::whole(what).in_file(path);
    if fs::metadata(path).is_ok_and(|file| file.len() > MAX_BYTES) {
        return Err(fail(format!("the file is larger than {} MB: it is no calibration", MAX_BYTES >> 20)));
    }
    let bytes = fs::read(path).map_err(|error| fail(error.to_string()))?;
    String::from_utf8(bytes).map_err(|_| fail("not text in UTF-8: a calibration file is needed".to_owned()))
}

/// Reads a calibration from the texts of its files; errors use the given names.
///
/// # Errors
/// The same as those of [`read`], except for files that cannot be opened.
pub fn parse(texts: &[(&Path, &str)]) -> Result<Calibration, FileError> {
    let Some((first, _)) = texts.first() else {
        return Err(Mistake::whole("no calibration file is given").in_file(Path::new("")));
    };
    if let Some((path, _)) = texts.iter().find(|(_, text)| text.trim().is_empty()) {
        return Err(Mistake::whole("the file is empty").in_file(path));
    }
    let calibration = match of_data_set(texts) {
        Some(found) => found,
        None => of_yaml(texts),
    }?;
    check(&calibration).map_err(|why| Mistake::whole(why.to_string()).in_file(first))?;
    Ok(calibration)
}

/// The file that a mistake is in, by its index.
fn blame(texts: &[(&Path, &str)], index: usize, mistake: Mistake) -> FileError {
    mistake.in_file(texts.get(index).or(texts.first()).map_or(Path::new(""), |(path, _)| path))
}

/// Reads the plain texts of data sets; `None` for every other kind of file.
fn of_data_set(texts: &[(&Path, &str)]) -> Option<Result<Calibration, FileError>> {
    let result = match texts {
        [(_, text)] if middlebury::is(text) => middlebury::packet(text).map_err(|mistake| (0, mistake)),
        [(_, text)] if stereomis::is(text) => stereomis::packet(text).map_err(|mistake| (0, mistake)),
        [(_, text)] if endovis::is(text) => endovis::packet(text).map_err(|mistake| (0, mistake)),
        [(_, text)] if kitti::is(text) => kitti::packet(text, None).map_err(|mistake| (0, mistake)),
        [(_, a), (_, b)] if hamlyn::is(a) && hamlyn::is(b) => hamlyn::packet([a, b]),
        [(_, text)] if hamlyn::is(text) => {
            let what =
                "this is one camera matrix or pose: give the intrinsics and the extrinsics of the rectified views";
            Err((0, Mistake::whole(what)))
        }
        _ => return None,
    };
    Some(result.map_err(|(index, mistake)| blame(texts, index, mistake)))
}

fn of_yaml(texts: &[(&Path, &str)]) -> Result<Calibration, FileError> {
    let mut documents = Vec::new();
    for (path, text) in texts {
        documents.push(Node::parse(text).map_err(|mistake| mistake.in_file(path))?);
    }
    let first = texts.first().map_or(Path::new(""), |(path, _)| path);
    let blame = |(index, mistake): (usize, Mistake)| blame(texts, index, mistake);
    match &documents[..] {
        [left, right] if ros::is(left) && ros::is(right) => ros::packet_of_files(left, right).map_err(blame),
        [one] if ros::is(one) => {
            let what = "this camera_info describes one camera: give the left and the right file";
            Err(Mistake::whole(what).in_file(first))
        }
        [one] if kalibr::is(one) => kalibr::packet(one).map_err(|mistake| mistake.in_file(first)),
        [one] if matlab::is(one) => matlab::packet(one).map_err(|mistake| mistake.in_file(first)),
        all if opencv::is(all) => opencv::packet(all).map_err(blame),
        _ => {
            let what = "no calibration of a stereo pair: neither OpenCV's (M1, D1, M2, D2, R, T), nor ROS camera_info, nor a Kalibr camera chain, nor MATLAB's stereoParameters as JSON, nor a file of KITTI, Middlebury, StereoMIS or EndoVis; the file is cut off or of another kind";
            Err(Mistake::whole(what).in_file(first))
        }
    }
}

/// Why the numbers of a file, each of them readable, describe no pair of cameras.
#[derive(Debug, Error)]
enum Contradiction {
    /// A camera or the rectification is impossible.
    #[error(transparent)]
    Cameras(#[from] StereoError),
    /// One camera has a fisheye, the other has not.
    #[error("one camera has an equidistant lens, the other has not")]
    Lenses,
    /// The extrinsics and the rectified projections state different baselines.
    #[error(
        "its parts do not belong together: the translation between the cameras is {translation_mm:.3} mm long, the projection says {projection_mm:.3} mm"
    )]
    Baseline { translation_mm: f64, projection_mm: f64 },
}

/// Refuses cameras that cannot exist, and parts of different calibrations.
fn check(calibration: &Calibration) -> Result<(), Contradiction> {
    let mut known = *calibration;
    if equidistant_of(&known.left).is_some() != equidistant_of(&known.right).is_some() {
        return Err(Contradiction::Lenses);
    }
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
    files::replace(path, opencv::text_of(calibration).as_bytes()).map_err(fail)
}
