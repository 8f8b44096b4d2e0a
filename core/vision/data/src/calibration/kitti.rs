//! KITTI's calibration texts: projections of the rectified cameras, lengths in metres.
//!
//! `calib.txt` of the odometry sequences and `calib/NNNNNN.txt` of the stereo set of 2012 hold `P0` to `P3`; `calib_cam_to_cam.txt` of the raw
//! recordings and of the stereo set of 2015 holds `P_rect_00` to `P_rect_03` with the sizes `S_rect_0x`. Cameras 0 and 1 are gray, 2 and 3 in colours,
//! the first of each pair is the left one (Geiger et al., "Vision meets robotics: the KITTI dataset", 2013; development kits of cvlibs.net).

use panoscope_abi::Calibration;

use crate::calibration::entries::{Entries, Entry};
use crate::calibration::error::Mistake;
use crate::calibration::rectified::{self, View};

const MM_PER_M: f64 = 1000.0;
/// Left and right camera in colours.
pub(crate) const COLOUR: [u8; 2] = [2, 3];
/// Left and right gray camera.
pub(crate) const GRAY: [u8; 2] = [0, 1];

fn projection_names(camera: u8) -> [String; 2] {
    [format!("P{camera}"), format!("P_rect_0{camera}")]
}

/// Whether a text holds projections as KITTI names them.
pub(crate) fn is(text: &str) -> bool {
    let entries = Entries::parse(text, ':', "#");
    // OpenCV's YAML has `P1` and `P2`, too, with a matrix in the lines below.
    let has = |name: &String| entries.get(name).is_some_and(Entry::begins_with_number);
    (0..4).any(|camera| projection_names(camera).iter().any(has))
}

/// One camera, and where it stands along the rows, m.
fn camera(entries: &Entries<'_>, camera: u8) -> Result<(View, f64), Mistake> {
    let [short, long] = projection_names(camera);
    let entry = entries.get(&short).or_else(|| entries.get(&long)).ok_or_else(|| {
        Mistake::whole(format!("neither `{short}` nor `{long}` is there: the projection of camera {camera} is missing"))
    })?;
    let p: [f64; 12] = entry.exactly()?;
    if p[0] <= 0.0 {
        return Err(entry.mistake(format!("the focal length of `{}` is {} px: it must be positive", entry.name, p[0])));
    }
    let size = match entries.get(&format!("S_rect_0{camera}")) {
        Some(entry) => {
            let [width, height] = entry.exactly()?;
            (entry.whole_pixels(width)?, entry.whole_pixels(height)?)
        }
        None => (0, 0),
    };
    Ok((View { size, focal: (p[0], p[5]), centre: (p[2], p[6]) }, p[3] / p[0]))
}

/// The packet of two cameras; `cameras` are their numbers, left and right, by default those in colours where both are there.
pub(crate) fn packet(text: &str, cameras: Option<[u8; 2]>) -> Result<Calibration, Mistake> {
    let entries = Entries::parse(text, ':', "#");
    let has = |camera: &u8| projection_names(*camera).iter().any(|name| entries.get(name).is_some());
    let [left, right] = cameras.unwrap_or(if COLOUR.iter().all(has) { COLOUR } else { GRAY });
    let ((mut left, left_m), (mut right, right_m)) = (camera(&entries, left)?, camera(&entries, right)?);
    // Both rectified views have one size.
    match (left.size, right.size) {
        ((0, 0), size) => left.size = size,
        (size, (0, 0)) => right.size = size,
        _ => {}
    }
    Ok(rectified::packet(left, right, (left_m - right_m) * MM_PER_M))
}
