//! A pair after rectification, and points from its disparity.

use panoscope_imaging::stereo::{
    Rectification, RectifyParams, RemapTable, ReprojectInput, ReprojectParams, StereoCameras, reproject,
};
use panoscope_imaging::{Rect, Serial, View, ViewMut};

use super::data::Picture;
use crate::error::{Result, ensure};

/// A pair after rectification.
pub struct Rectified {
    pub geometry: Rectification,
    /// From the left camera into the rectified one.
    pub rotation: [[f64; 3]; 3],
    pub views: [Picture; 2],
    table: RemapTable,
}

impl Rectified {
    pub fn new(cameras: &StereoCameras, views: [Picture; 2]) -> Result<Self> {
        let geometry = Rectification::new(cameras, RectifyParams::default())?;
        let (width, height) = (geometry.width, geometry.height);
        let all = Rect::whole(width, height);
        let table = RemapTable::left(&cameras.left, &geometry, all, &Serial)?;
        let right = RemapTable::right(&cameras.right, &geometry, all, &Serial)?;
        let turn = |table: &RemapTable, view: &Picture| -> Result<Picture> {
            let mut bgr = vec![0; 3 * width * height];
            let source = View::new(&view.bgr[..], view.width, view.height, 3);
            table.remap(source, ViewMut::new(&mut bgr, width, height, 3), &Serial)?;
            Ok(Picture::new(width, height, bgr))
        };
        let views = [turn(&table, &views[0])?, turn(&right, &views[1])?];
        Ok(Self { rotation: geometry.rotation_left, geometry, views, table })
    }

    pub fn mask(&self, mask: &[u8]) -> Result<Vec<u8>> {
        let (width, height) = (self.geometry.width, self.geometry.height);
        ensure!(mask.len() == width * height, "the mask has another size than the views");
        let mut out = vec![0; width * height];
        let source = View::new(mask, width, height, 1);
        self.table.remap(source, ViewMut::new(&mut out, width, height, 1), &Serial)?;
        Ok(out)
    }

    pub fn points(&self, disparity: &[f32]) -> Result<Vec<[f32; 3]>> {
        points(&self.geometry, disparity)
    }
}

/// Points in the rectified left camera, NaN where unknown.
pub fn points(geometry: &Rectification, disparity: &[f32]) -> Result<Vec<[f32; 3]>> {
    let (width, height) = (geometry.width, geometry.height);
    let (mut depth, mut points) = (vec![0.0; width * height], vec![0.0; 3 * width * height]);
    let input = ReprojectInput {
        disparity: View::new(disparity, width, height, 1),
        confidence: None,
        roi: Rect::whole(width, height),
    };
    let (to, to_points) = (ViewMut::new(&mut depth, width, height, 1), ViewMut::new(&mut points, width, height, 3));
    reproject(input, geometry, &ReprojectParams::default(), &Serial, to, Some(to_points))?;
    Ok(points.as_chunks::<3>().0.to_vec())
}
