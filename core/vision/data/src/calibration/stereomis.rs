//! `StereoCalibration.ini` of StereoMIS, as da Vinci systems write it: raw cameras, lengths in mm.
//!
//! Sections `StereoLeft` and `StereoRight` hold `res_x`, `res_y`, focal lengths `fc_x`, `fc_y`, principal point `cc_x`, `cc_y`, distortion `kc_0` to
//! `kc_7` in OpenCV's order, and the pose `R_0` to `R_8`, `T_0` to `T_2` (Hayoz et al., "Learning how to robustly estimate camera pose in
//! endoscopic videos", 2023).

use panoscope_abi::{Calibration, Camera};

use crate::calibration::entries::Entries;
use crate::calibration::error::Mistake;
use crate::calibration::{EYE3, packet_of};

/// Whether a text is such a file.
pub(crate) fn is(text: &str) -> bool {
    text.lines().any(|line| ["[StereoLeft]", "[StereoRight]"].contains(&line.trim()))
}

struct Side {
    camera: Camera,
    rotation: [f64; 9],
    translation_mm: [f64; 3],
}

fn side(text: &str, name: &str) -> Result<Side, Mistake> {
    let missing = || Mistake::whole(format!("the section [{name}] is missing: the file is cut off"));
    let entries = Entries::section(text, name).ok_or_else(missing)?;
    let within = |mut mistake: Mistake| {
        if mistake.line == 0 {
            mistake.what = format!("[{name}]: {}", mistake.what);
        }
        mistake
    };
    let number = |key: &str| entries.needed(key).and_then(|entry| entry.number()).map_err(within);
    let pixels = |key: &str| entries.needed(key).and_then(|entry| entry.pixels()).map_err(within);
    let known: [f64; 8] = entries.numbered("kc_", 5).map_err(within)?;
    let mut distortion = [0.0; 14];
    distortion[..8].copy_from_slice(&known);
    let camera = Camera {
        width: pixels("res_x")?,
        height: pixels("res_y")?,
        fx: number("fc_x")?,
        fy: number("fc_y")?,
        cx: number("cc_x")?,
        cy: number("cc_y")?,
        distortion,
    };
    // The left camera may leave its pose out: it is the origin.
    let has_pose = entries.get("R_0").is_some() || name == "StereoRight";
    let rotation = if has_pose { entries.numbered("R_", 9).map_err(within)? } else { EYE3 };
    let translation_mm = if has_pose { entries.numbered("T_", 3).map_err(within)? } else { [0.0; 3] };
    Ok(Side { camera, rotation, translation_mm })
}

/// The packet of a file.
pub(crate) fn packet(text: &str) -> Result<Calibration, Mistake> {
    let (left, right) = (side(text, "StereoLeft")?, side(text, "StereoRight")?);
    let (a, b) = (&left.rotation, &right.rotation);
    // Both poses turn the scene into a camera: right from left is right after the left one's inverse.
    let rotation: [f64; 9] =
        std::array::from_fn(|index| (0..3).map(|k| b[3 * (index / 3) + k] * a[3 * (index % 3) + k]).sum());
    let turned = |row: usize| (0..3).map(|k| rotation[3 * row + k] * left.translation_mm[k]).sum::<f64>();
    let translation: [f64; 3] = std::array::from_fn(|row| right.translation_mm[row] - turned(row));
    Ok(packet_of([left.camera, right.camera], rotation, translation))
}
