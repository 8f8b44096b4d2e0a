//! One camera of the rig: its lens, and its position in a frame.

use panoscope_imaging::ViewMut;

use super::cast::{Coarse, Station};
use super::lens::Lens;
use super::math::Pose;
use super::params::{CameraModel, PhantomError};
use super::tools::Tool;

/// A camera with its lens tables and buffers.
pub(super) struct CameraBuffers {
    pub(super) model: CameraModel,
    pub(super) lens: Lens,
    pub(super) stations: Vec<(Station, Coarse)>,
    pub(super) drops: Vec<u8>,
    pub(super) smoke: Vec<f32>,
}

impl CameraBuffers {
    pub(super) fn new(model: CameraModel, camera: usize, subframes: usize) -> Result<Self, PhantomError> {
        let lens = Lens::new(&model, camera)?;
        let stations = (0..subframes).map(|_| (Station::default(), Coarse::new(&lens))).collect();
        Ok(Self { model, lens, stations, drops: Vec::new(), smoke: Vec::new() })
    }
}

/// Transforms the instruments into the frame of a camera at `offset_mm` from the first one.
pub(super) fn equip(
    tools: &[Tool],
    seconds: f64,
    pose: &Pose,
    offset_mm: [f64; 3],
    light_mm: [f64; 3],
    lens: &Lens,
    coarse: &mut Coarse,
) {
    coarse.light = std::array::from_fn(|i| light_mm[i] - offset_mm[i]);
    coarse.parts.clear();
    for tool in tools {
        tool.at(seconds).place_in_camera(pose, offset_mm, &mut coarse.parts);
    }
    coarse.sort_parts(lens);
}

/// Position of a camera at `offset_mm` from the first one, in the scene frame wrapped to the first period.
pub(super) fn station_at(pose: &Pose, offset_mm: [f64; 3], light_mm: [f64; 3], period_mm: f64) -> Station {
    let centre = pose.apply(offset_mm);
    let light = pose.apply(light_mm);
    let wrap = [(centre[0] / period_mm).floor() * period_mm, (centre[1] / period_mm).floor() * period_mm, 0.0];
    Station {
        centre: std::array::from_fn(|i| (centre[i] - wrap[i]) as f32),
        rotation: pose.rotation().map(|row| row.map(|v| v as f32)),
        light: std::array::from_fn(|i| (light[i] - wrap[i]) as f32),
    }
}

/// Refuses an image of another size.
pub(super) fn check_size<T>(
    index: usize,
    view: &ViewMut<T>,
    width: usize,
    height: usize,
    channels: usize,
) -> Result<(), PhantomError> {
    if (view.width, view.height, view.channels) == (width, height, channels) {
        return Ok(());
    }
    Err(PhantomError::WrongSize {
        view: index,
        width: view.width,
        height: view.height,
        channels: view.channels,
        want_width: width,
        want_height: height,
        want_channels: channels,
    })
}
