//! Maps of points: x, y and z of the point in each pixel of a raw view, as in the ground truth of SCARED.
//!
//! Such points are in the frame of the raw left camera (x right, y down, z forward, mm), one for each pixel of the raw
//! left view. Disparity and depth of a graph belong to the *rectified* left view, whose camera is turned and has
//! another focal length: [`Points::rectified_depth`] moves the points there. The z of the raw view is not the depth of
//! the rectified one.

use std::path::Path;

use panoscope_imaging::stereo::{FloatImage, Rectification};

use crate::truth::maps::{self, ContentError, MapError};

/// One point for each pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Points {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// x, y, z in mm of the raw left camera, row after row; NaN where unknown.
    pub xyz_mm: Vec<[f32; 3]>,
}

/// Reads a TIFF of three floats a pixel. A point without positive z is unknown: files hold NaN or zeros there.
///
/// # Errors
/// See [`MapError`]; each names the file.
pub fn read(path: &Path) -> Result<Points, MapError> {
    let bytes = std::fs::read(path).map_err(|cause| MapError::Read { path: path.to_owned(), cause })?;
    decode(&bytes).map_err(|cause| MapError::Content { path: path.to_owned(), cause })
}

/// Decodes a TIFF of points in memory.
///
/// # Errors
/// The bytes are malformed.
pub fn decode(bytes: &[u8]) -> Result<Points, ContentError> {
    let values = maps::tiff_values(bytes)?;
    if values.channels != 3 || values.stored != maps::Stored::Floats {
        return Err(ContentError::Points { channels: values.channels });
    }
    let known = |point: &[f32; 3]| point.iter().all(|v| v.is_finite()) && point[2] > 0.0;
    let points = values.data.as_chunks::<3>().0.iter().map(|point| if known(point) { *point } else { [f32::NAN; 3] });
    Ok(Points { width: values.width, height: values.height, xyz_mm: points.collect() })
}

impl Points {
    /// The upper half, which belongs to the left view in files with both views on top of each other.
    pub fn upper_half(mut self) -> Self {
        self.height /= 2;
        self.xyz_mm.truncate(self.width * self.height);
        self
    }

    /// Depth of the left rectified view, mm: every point is rotated, projected and written to the nearest pixel, where
    /// the nearest point wins. Pixels without a point are NaN.
    pub fn rectified_depth(&self, rectification: &Rectification) -> FloatImage {
        let (width, height) = (rectification.width, rectification.height);
        let mut depth = FloatImage { width, height, data: vec![f32::NAN; width * height] };
        let (r, camera) = (&rectification.rotation_left, &rectification.left);
        for point in &self.xyz_mm {
            let p = point.map(f64::from);
            let turned = |row: usize| r[row][0] * p[0] + r[row][1] * p[1] + r[row][2] * p[2];
            let z = turned(2);
            let u = (camera.focal_px * turned(0) / z + camera.cx).round();
            let v = (camera.focal_px * turned(1) / z + camera.cy).round();
            // NaN lies inside no range.
            if z > 0.0 && (0.0..width as f64).contains(&u) && (0.0..height as f64).contains(&v) {
                let pixel = &mut depth.data[v as usize * width + u as usize];
                // As f32, so that NaN gives way.
                *pixel = pixel.min(z as f32);
            }
        }
        depth
    }
}

/// Converts depth in mm to disparity in px, or the inverse: both are focal length times baseline over the other,
/// shifted by the principal columns. NaN stays; points that are not in front of both cameras become NaN.
fn turned_over(map: &FloatImage, to: impl Fn(f64) -> f64) -> FloatImage {
    let value = |v: &f32| {
        let value = to(f64::from(*v)) as f32;
        if value.is_finite() && value > 0.0 { value } else { f32::NAN }
    };
    FloatImage { width: map.width, height: map.height, data: map.data.iter().map(value).collect() }
}

/// Disparity in px of a depth map in mm, both of the left rectified view.
pub fn disparity_of_depth(depth_mm: &FloatImage, rectification: &Rectification) -> FloatImage {
    let Rectification { left, right, baseline_mm, .. } = rectification;
    turned_over(depth_mm, |z| left.focal_px * baseline_mm / z + left.cx - right.cx)
}

/// Depth in mm of a disparity map in px, both of the left rectified view.
pub fn depth_of_disparity(disparity_px: &FloatImage, rectification: &Rectification) -> FloatImage {
    turned_over(disparity_px, |d| rectification.depth_mm(d))
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use panoscope_imaging::Rect;
    use panoscope_imaging::stereo::RectifiedCamera;
    use tiff::encoder::{TiffEncoder, colortype};

    use super::*;

    const WIDTH: usize = 64;
    const HEIGHT: usize = 48;

    /// A rectification rotated by 4 degrees about the vertical axis, longer by a tenth, principal points 7 px apart.
    fn rectification() -> Rectification {
        let (sine, cosine) = 4.0f64.to_radians().sin_cos();
        let camera = |cx: f64| RectifiedCamera { focal_px: 110.0, cx, cy: 23.0 };
        let all = Rect::whole(WIDTH, HEIGHT);
        Rectification {
            width: WIDTH,
            height: HEIGHT,
            rotation_left: [[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]],
            rotation_right: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            left: camera(30.0),
            right: camera(37.0),
            baseline_mm: 5.0,
            valid_left: all,
            valid_right: all,
        }
    }

    /// The plane z = 80 + x / 4 of the raw camera, as a pinhole camera of 100 px sees it.
    fn plane() -> Points {
        let point = |index: usize| {
            let (x, y) = (((index % WIDTH) as f64 - 31.5) / 100.0, ((index / WIDTH) as f64 - 23.5) / 100.0);
            let z = 80.0 / (1.0 - x / 4.0);
            [(x * z) as f32, (y * z) as f32, z as f32]
        };
        Points { width: WIDTH, height: HEIGHT, xyz_mm: (0..WIDTH * HEIGHT).map(point).collect() }
    }

    #[test]
    fn a_plane_stays_a_plane_in_the_turned_view() {
        let rectification = rectification();
        let depth = plane().rectified_depth(&rectification);
        let disparity = disparity_of_depth(&depth, &rectification);
        let (sine, cosine) = 4.0f64.to_radians().sin_cos();
        // In turned axes: x = c X + s Z, z = -s X + c Z for rectified X, Z; the plane z - x / 4 = 80 becomes
        // Z (c - s / 4) - X (s + c / 4) = 80.
        let expected = |u: usize| 80.0 / (cosine - sine / 4.0 - (u as f64 - 30.0) / 110.0 * (sine + cosine / 4.0));
        let mut known = 0;
        for (index, z) in depth.data.iter().enumerate().filter(|(_, z)| !z.is_nan()) {
            let (z, u) = (f64::from(*z), index % WIDTH);
            // Half a pixel along the slope: dZ/du is below 0.25 mm per px.
            assert!((z - expected(u)).abs() < 0.25, "column {u}: {z}, not {}", expected(u));
            let d = f64::from(disparity.data[index]);
            assert!((d - (110.0 * 5.0 / z - 7.0)).abs() < 1e-4 || (d.is_nan() && 550.0 / z <= 7.0), "{d} at {z}");
            assert!(d.is_nan() || (rectification.depth_mm(d) - z).abs() < 1e-3);
            known += 1;
        }
        // The picture grows by a tenth and is turned by 8 px to the side.
        assert!(known > WIDTH * HEIGHT * 6 / 10, "{known} pixels are known");
        // The raw z is another number: up to 2.8 mm away.
        let raw = f64::from(plane().xyz_mm[23 * WIDTH + 31][2]);
        assert!((expected(31) - raw).abs() > 0.5 || (expected(60) - raw).abs() > 0.5);
    }

    #[test]
    fn the_nearest_point_wins_and_unknown_ones_leave_nothing() {
        let mut rectification = rectification();
        rectification.rotation_left = rectification.rotation_right;
        let at = |z: f32| [0.0, 0.0, z];
        let behind = Points { width: 2, height: 2, xyz_mm: vec![at(90.0), at(70.0), [f32::NAN; 3], at(-5.0)] };
        let depth = behind.rectified_depth(&rectification);
        assert_eq!(depth.data[23 * WIDTH + 30], 70.0);
        assert_eq!(depth.data.iter().filter(|z| !z.is_nan()).count(), 1);
    }

    fn tiff_of(points: &[f32], width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).expect("a TIFF");
        encoder.write_image::<colortype::RGB32Float>(width, height, points).expect("written");
        bytes.into_inner()
    }

    #[test]
    fn all_three_numbers_are_read_and_zeros_are_unknown() {
        let values = [1.0, -2.0, 50.0, 0.0, 0.0, 0.0, f32::NAN, 1.0, 1.0, 7.0, 8.0, 9.0];
        let points = decode(&tiff_of(&values, 1, 4)).expect("points");
        assert_eq!((points.width, points.height, points.xyz_mm[0]), (1, 4, [1.0, -2.0, 50.0]));
        assert!(points.xyz_mm[1][2].is_nan() && points.xyz_mm[2][1].is_nan());
        let upper = points.upper_half();
        assert_eq!((upper.height, upper.xyz_mm.len()), (2, 2));
        let whole = tiff_of(&values, 1, 4);
        for at in 0..whole.len() / 2 {
            assert!(decode(&whole[..at]).is_err(), "cut at {at}");
        }
        let mut gray = Cursor::new(Vec::new());
        TiffEncoder::new(&mut gray)
            .and_then(|mut encoder| encoder.write_image::<colortype::Gray32Float>(1, 1, &[1.0]))
            .expect("written");
        assert!(decode(&gray.into_inner()).expect_err("one number").to_string().contains("1 number"));
    }

    #[test]
    fn depth_and_disparity_turn_over() {
        let rectification = rectification();
        let disparity = FloatImage { width: 3, height: 1, data: vec![4.0, f32::NAN, 43.0] };
        let depth = depth_of_disparity(&disparity, &rectification);
        assert_eq!((depth.data[0], depth.data[2]), (50.0, 11.0));
        let back = disparity_of_depth(&depth, &rectification);
        assert!((back.data[0] - 4.0).abs() < 1e-5 && back.data[1].is_nan());
    }
}
