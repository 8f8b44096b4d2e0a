//! Choice of a camera's mode.

use gstreamer as gst;

/// Requested mode of a camera; 0 leaves the choice to its driver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraMode {
    /// Columns, px.
    pub width: u32,
    /// Rows, px.
    pub height: u32,
    /// Frames per second.
    pub fps: f64,
}

/// Readable media types, best first: undecoded data can be checked for damage and needs the least bus bandwidth.
const PREFERRED: [&str; 3] = ["image/jpeg", "video/x-raw", "video/x-h264"];

/// The mode of `offered` that is nearest to `wanted`: by size, then rate, then media type. `None` when nothing is
/// wanted or nothing usable is offered; the driver then chooses.
pub fn nearest(offered: &gst::Caps, wanted: CameraMode) -> Option<gst::Caps> {
    if wanted == CameraMode::default() {
        return None;
    }
    let mut best: Option<((i64, i64, usize), gst::Caps)> = None;
    for (index, structure) in offered.iter().enumerate() {
        let Some(rank) = PREFERRED.iter().position(|name| *name == structure.name()) else { continue };
        let mut fixed = structure.to_owned();
        let fixate = |fixed: &mut gst::Structure, name: &str, value: u32| {
            if value > 0 && fixed.has_field(name) {
                fixed.fixate_field_nearest_int(name, i32::try_from(value).unwrap_or(i32::MAX));
            }
            fixed.get::<i32>(name).ok()
        };
        let width = fixate(&mut fixed, "width", wanted.width);
        let height = fixate(&mut fixed, "height", wanted.height);
        if wanted.fps > 0.0 && fixed.has_field("framerate") {
            let rate = gst::Fraction::approximate_f64(wanted.fps).unwrap_or(gst::Fraction::new(30, 1));
            fixed.fixate_field_nearest_fraction("framerate", rate);
        }
        let rate = fixed
            .get::<gst::Fraction>("framerate")
            .ok()
            .map(|rate| f64::from(rate.numer()) / f64::from(rate.denom().max(1)));
        let off = |wanted: u32, got: Option<i32>| {
            if wanted == 0 { 0 } else { got.map_or(0, |got| (i64::from(wanted) - i64::from(got)).abs()) }
        };
        let size_error = off(wanted.width, width) + off(wanted.height, height);
        let rate_error =
            if wanted.fps > 0.0 { rate.map_or(0, |rate| ((wanted.fps - rate).abs() * 1e3) as i64) } else { 0 };
        let score = (size_error, rate_error, rank);
        if best.as_ref().is_none_or(|(least, _)| score < *least) {
            let mut caps = gst::Caps::new_empty();
            let features = offered.features(index).map(|features| features.to_owned());
            caps.make_mut().append_structure_full(fixed, features);
            best = Some((score, caps));
        }
    }
    best.map(|(_, caps)| caps)
}

/// All modes that are read, in order of preference.
pub fn readable() -> gst::Caps {
    PREFERRED.iter().map(|name| gst::Structure::new_empty(*name)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_mode_is_chosen_and_jpeg_wins_a_tie() {
        crate::init().expect("GStreamer");
        let offered: gst::Caps = "video/x-raw, format=YUY2, width=640, height=480, framerate={ 30/1, 15/1 }; \
             video/x-raw, format=YUY2, width=1280, height=720, framerate=10/1; \
             image/jpeg, width=1280, height=720, framerate={ 60/1, 30/1 }; \
             image/jpeg, width=640, height=480, framerate=30/1; \
             video/x-bayer, width=640, height=480, framerate=30/1"
            .parse()
            .expect("caps");
        let chosen =
            |width, height, fps| nearest(&offered, CameraMode { width, height, fps }).map(|caps| caps.to_string());
        let text = chosen(1280, 720, 30.0).unwrap_or_default();
        assert!(text.starts_with("image/jpeg") && text.contains("1280") && text.contains("30/1"), "{text}");
        let text = chosen(700, 500, 15.0).unwrap_or_default();
        assert!(text.starts_with("video/x-raw") && text.contains("640") && text.contains("15/1"), "{text}");
        let text = chosen(640, 0, 0.0).unwrap_or_default();
        assert!(text.starts_with("image/jpeg") && text.contains("640"), "{text}");
        assert_eq!(chosen(0, 0, 0.0), None);
    }
}
