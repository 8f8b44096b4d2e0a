//! Which part of the mosaic the image shows.

use super::outline::Outline;
use super::params::{MosaicParams, MosaicView};
use crate::geometry::Homography;

/// Minimum scale, image pixels per mosaic pixel; a larger mosaic is shown around the newest frame.
const MIN_SCALE: f64 = 0.05;
/// Factor between scales, so that a growing mosaic is rarely redrawn.
const STEP: f64 = 0.85;
/// The image is enlarged again when the mosaic needs less than this share of it.
const LOOSE: f64 = 0.6;
/// Free space when a scale is chosen, as a share of the image.
const ROOM: f64 = 0.1;

fn shown_at(scale: f64, centre: [f64; 2], size: (usize, usize)) -> Homography {
    let shift = |k: usize, side: usize| (side as f64 - 1.0) / 2.0 - scale * centre[k];
    Homography([scale, 0.0, shift(0, size.0), 0.0, scale, shift(1, size.1), 0.0, 0.0, 1.0])
}

fn is_inside(map: &Homography, bounds: [f64; 4], size: (usize, usize)) -> bool {
    let ([left, top], [right, bottom]) = (map.map([bounds[0], bounds[1]]), map.map([bounds[2], bounds[3]]));
    left >= 0.0 && top >= 0.0 && right <= size.0 as f64 - 1.0 && bottom <= size.1 as f64 - 1.0
}

/// The map from mosaic to image, `now` while it is suitable.
///
/// `bounds`: of all keyframes and the newest frame, left, top, right, bottom. `newest`: bounds of the newest frame.
pub(super) fn choose(now: Option<Homography>, bounds: [f64; 4], newest: &Outline, params: &MosaicParams) -> Homography {
    let size = (params.width, params.height);
    let middle = [(bounds[0] + bounds[2]) / 2.0, (bounds[1] + bounds[3]) / 2.0];
    if params.view == MosaicView::Fit {
        let room = |side: usize| (side as f64 - 1.0) * (1.0 - ROOM);
        let fits = |room: f64, extent: f64| room / extent.max(1.0);
        let needed = fits(room(size.0), bounds[2] - bounds[0]).min(fits(room(size.1), bounds[3] - bounds[1]));
        let needed = needed.min(params.zoom);
        if needed >= MIN_SCALE {
            if let Some(now) = now
                && is_inside(&now, bounds, size)
                && now.0[0] <= params.zoom
                && needed * LOOSE <= now.0[0]
            {
                return now;
            }
            let mut scale = params.zoom;
            while scale > needed {
                scale *= STEP;
            }
            return shown_at(scale, middle, size);
        }
    }
    let scale = if params.view == MosaicView::Fit { MIN_SCALE } else { params.zoom };
    if let Some(now) = now.filter(|now| now.0[0] == scale) {
        let [x, y] = now.map(newest.centre);
        let central = |v: f64, side: usize| (0.25..0.75).contains(&(v / side as f64));
        if is_inside(&now, newest.bounds(), size) || (central(x, size.0) && central(y, size.1)) {
            return now;
        }
    }
    shown_at(scale, newest.centre, size)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(x: f64, y: f64) -> Outline {
        Outline::of(&Homography::translation(x, y), (320, 240)).unwrap()
    }

    #[test]
    fn fit_shows_everything_and_seldom_changes() {
        let params = MosaicParams { width: 640, height: 480, ..MosaicParams::default() };
        let mut now: Option<Homography> = None;
        let mut changes = 0;
        for step in 0..200 {
            let newest = frame(f64::from(step) * 20.0, 0.0);
            let bounds = [0.0, 0.0, newest.bounds()[2], 239.0];
            let next = choose(now, bounds, &newest, &params);
            assert!(is_inside(&next, bounds, (640, 480)), "{step}");
            changes += i32::from(now != Some(next));
            now = Some(next);
        }
        assert!((8..25).contains(&changes), "{changes}");
        // After most of it was dropped the rest is shown large again.
        let newest = frame(0.0, 0.0);
        assert_eq!(choose(now, newest.bounds(), &newest, &params).0[0], 1.0);
    }

    #[test]
    fn follow_keeps_its_scale_and_the_newest_frame_in_sight() {
        let params =
            MosaicParams { width: 640, height: 480, view: MosaicView::Follow, zoom: 0.8, ..MosaicParams::default() };
        let mut now = None;
        for step in 0..100 {
            let newest = frame(f64::from(step) * 15.0, f64::from(step) * 9.0);
            let next = choose(now, [0.0, 0.0, 5000.0, 5000.0], &newest, &params);
            assert!(is_inside(&next, newest.bounds(), (640, 480)) && next.0[0] == 0.8, "{step}");
            now = Some(next);
        }
    }
}
