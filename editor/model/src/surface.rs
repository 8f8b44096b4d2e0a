//! Renders a point cloud as a surface from a viewpoint, and finds points on the rendered surface. Rendering runs on the observer's thread.

use std::sync::Arc;

use panoscope_abi as abi;
use panoscope_base::packet;
use panoscope_imaging::ViewMut;
use panoscope_imaging::draw::{DrawnPoint, Orbit, Projection, SurfacePainter, SurfacePoints};
use panoscope_imaging::stereo::SurfacePoint;
use serde::{Deserialize, Serialize};

use crate::pixels::Pixels;
use crate::probe::Layout;

/// The viewpoint on a surface, and the depth range that is shown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewpoint {
    /// Rotation about the vertical axis, radians.
    pub yaw: f32,
    /// Rotation about the horizontal axis, radians; positive values look from above.
    pub pitch: f32,
    /// Magnification; at 1 the surface fills the image when seen from the front.
    pub zoom: f32,
    /// Offset of the centre, right and down, as a fraction of the image's width.
    pub shift: [f32; 2],
    /// Nearest and farthest depth shown, in mm from the camera.
    pub clip_mm: [f32; 2],
    /// Width and height of the image.
    pub size_px: [usize; 2],
    /// Whether a ruler states a length in mm.
    pub has_ruler: bool,
}

impl Viewpoint {
    /// Largest depth that can be set.
    pub const FAR_MM: f32 = 1000.0;
}

impl Default for Viewpoint {
    fn default() -> Self {
        let clip_mm = [0.0, Self::FAR_MM];
        Self { yaw: 0.35, pitch: 0.25, zoom: 0.9, shift: [0.0; 2], clip_mm, size_px: [960, 720], has_ruler: true }
    }
}

/// The points of one tick, row by row as the left rectified camera sees them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Points per row.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// x, y, z in mm in the camera's frame; NaN where nothing was measured.
    pub xyz_mm: Vec<[f32; 3]>,
    /// Confidence of each point's disparity, 0 to 1; NaN, or none at all, where it is not known.
    pub confidence: Vec<f32>,
}

impl Cloud {
    /// The surface point at a column and row, estimated from the pixels within `radius_px`; `None` when too few are known.
    pub fn surface_point(&self, (u, v): (f32, f32), radius_px: usize) -> Option<SurfacePoint> {
        let at = [f64::from(u).max(0.0), f64::from(v).max(0.0)];
        let sample = |x: usize, y: usize| {
            let [x, y, z] = self.xyz_mm.get(y * self.width + x)?.map(f64::from);
            let known = z > 0.0 && [x, y, z].iter().all(|v| v.is_finite());
            known.then(|| [x / z, y / z, 1.0 / z])
        };
        let trust = |x: usize, y: usize| self.confidence.get(y * self.width + x).copied().unwrap_or(f32::NAN);
        SurfacePoint::at((self.width, self.height), at, radius_px, &mut Vec::new(), sample, trust)
    }
}

/// Distance of two points, mm.
pub fn distance_mm(a: [f32; 3], b: [f32; 3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
}

/// The depth buffer of a rendered surface: finds the point under a click.
#[derive(Clone, Debug)]
pub struct DepthBuffer {
    /// The viewpoint of the rendering.
    pub viewpoint: Viewpoint,
    /// The projection of the rendering.
    pub projection: Projection,
    depth_mm: Vec<f32>,
    size_px: [usize; 2],
}

impl PartialEq for DepthBuffer {
    fn eq(&self, other: &Self) -> bool {
        self.viewpoint == other.viewpoint && self.projection == other.projection
    }
}

impl DepthBuffer {
    /// The point under a pixel of the image, mm; `None` where nothing is drawn, and where the surface was filled in.
    pub fn pick(&self, x: f32, y: f32) -> Option<[f32; 3]> {
        let [width, height] = self.size_px;
        let (column, row) = (x.round(), y.round());
        if !(column >= 0.0 && row >= 0.0 && column < width as f32 && row < height as f32) {
            return None;
        }
        let depth = *self.depth_mm.get(row as usize * width + column as usize)?;
        depth.is_finite().then(|| self.projection.unproject(column, row, depth))
    }
}

/// The points of a cloud packet within a depth range, as a surface.
struct Packed<'b> {
    cloud: packet::Cloud<'b>,
    clip_mm: [f32; 2],
}

impl SurfacePoints for Packed<'_> {
    fn size(&self) -> (usize, usize) {
        (self.cloud.width(), self.cloud.height())
    }

    fn at(&self, column: usize, row: usize) -> Option<DrawnPoint> {
        let point = self.cloud.point(column, row)?;
        let mm = [point.x_mm, point.y_mm, point.z_mm];
        let [near, far] = self.clip_mm;
        let is_shown = point.is_known() && (near..=far).contains(&point.z_mm);
        is_shown.then_some(DrawnPoint { mm, color: point.bgr, is_filled: point.filled != 0 })
    }
}

/// The points of a frame; `None` when the frame is not a cloud, is empty or does not fit its bytes.
fn parse<'b>(frame: &abi::Frame, bytes: &'b [u8]) -> Option<packet::Cloud<'b>> {
    if frame.format != abi::FORMAT_CLOUD || frame.width == 0 || frame.height == 0 {
        return None;
    }
    packet::Cloud::parse(bytes, frame.width as usize, frame.height as usize, frame.stride_bytes as usize).ok()
}

/// The measured points of a cloud packet, to take lengths from, with the packet of their confidence; `None` when the frame is not a cloud or its
/// description does not fit its bytes. A confidence of another size counts as unknown.
pub fn cloud_of(frame: &abi::Frame, bytes: &[u8], confidence: Option<(&abi::Frame, &[u8])>) -> Option<Cloud> {
    let cloud = parse(frame, bytes)?;
    let all = (0..cloud.height()).flat_map(|row| (0..cloud.width()).map(move |column| (column, row)));
    let measured = |p: abi::CloudPoint| if p.is_measured() { [p.x_mm, p.y_mm, p.z_mm] } else { [f32::NAN; 3] };
    let xyz_mm = all.filter_map(|(x, y)| cloud.point(x, y)).map(measured).collect();
    let is_map =
        |map: &abi::Frame| map.format == abi::FORMAT_F32 && (map.width, map.height) == (frame.width, frame.height);
    let map = confidence.filter(|(map, _)| is_map(map)).and_then(|(map, bytes)| Layout::of(map, bytes, "confidence"));
    let confidence = map.map(|map| map.first_channel()).unwrap_or_default();
    Some(Cloud { width: cloud.width(), height: cloud.height(), xyz_mm, confidence })
}

/// Renders clouds; reuses its buffers.
#[derive(Default)]
pub struct Painter {
    painter: SurfacePainter,
    bgr: Vec<u8>,
}

impl Painter {
    /// Renders a cloud packet; returns the image and its depth buffer. `None` when the frame is not a cloud.
    pub fn paint(
        &mut self,
        frame: &abi::Frame,
        bytes: &[u8],
        viewpoint: &Viewpoint,
    ) -> Option<(Pixels, Option<Arc<DepthBuffer>>)> {
        let points = Packed { cloud: parse(frame, bytes)?, clip_mm: viewpoint.clip_mm };
        let [width, height] = viewpoint.size_px.map(|n| n.clamp(16, 4096));
        self.bgr.clear();
        self.bgr.resize(width * height * 3, 0);
        let orbit = Orbit {
            yaw: viewpoint.yaw,
            pitch: viewpoint.pitch,
            zoom: viewpoint.zoom,
            // More vertices than pixels would not be visible.
            step: (points.cloud.width() / 320).max(1),
            shift: viewpoint.shift,
            has_ruler: viewpoint.has_ruler,
            ..Orbit::default()
        };
        let projection = self.painter.paint(&points, &orbit, &mut ViewMut::new(&mut self.bgr, width, height, 3));
        let rgba = self.bgr.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0], 255]).collect();
        let depth_buffer = projection.map(|projection| {
            let depth_mm = self.painter.depth_mm().to_vec();
            Arc::new(DepthBuffer { viewpoint: *viewpoint, projection, depth_mm, size_px: [width, height] })
        });
        Some((Pixels { width, height, rgba }, depth_buffer))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The packet of a plane at 50 mm depth with 1 mm between points.
    fn plane(width: usize, height: usize) -> (abi::Frame, Vec<u8>) {
        let mut bytes = Vec::new();
        for y in 0..height {
            for x in 0..width {
                for v in [x as f32 - width as f32 / 2.0, y as f32 - height as f32 / 2.0, 50.0] {
                    bytes.extend_from_slice(&v.to_le_bytes());
                }
                bytes.extend_from_slice(&[10, 20, 200, 0]);
            }
        }
        let frame = abi::Frame {
            format: abi::FORMAT_CLOUD,
            width: width as u32,
            height: height as u32,
            stride_bytes: (width * 16) as u32,
            len: bytes.len(),
            ..abi::Frame::EMPTY
        };
        (frame, bytes)
    }

    #[test]
    fn clicks_on_a_turned_plane_measure_its_length() {
        let (frame, bytes) = plane(40, 30);
        let viewpoint = Viewpoint { size_px: [320, 240], zoom: 0.6, ..Viewpoint::default() };
        let (pixels, depth_buffer) = Painter::default().paint(&frame, &bytes, &viewpoint).unwrap();
        assert_eq!((pixels.width, pixels.height), (320, 240));
        let depth_buffer = depth_buffer.unwrap();
        let [a, b] = [[-10.0, 0.0, 50.0], [10.0, 5.0, 50.0]].map(|p| {
            let [x, y, _] = depth_buffer.projection.project(p);
            depth_buffer.pick(x, y).unwrap()
        });
        let length = distance_mm(a, b);
        assert!((length - 425f32.sqrt()).abs() < 0.6, "{length}");
        assert_eq!(depth_buffer.pick(1.0, 1.0), None, "nothing is there");
    }

    #[test]
    fn a_ruler_is_drawn_only_where_lengths_are_known() {
        let (frame, bytes) = plane(40, 30);
        let ruled = |has_ruler| {
            let viewpoint = Viewpoint { size_px: [320, 240], has_ruler, ..Viewpoint::default() };
            let (pixels, _) = Painter::default().paint(&frame, &bytes, &viewpoint).unwrap();
            pixels.rgba.chunks_exact(4).filter(|pixel| **pixel == [230, 230, 230, 255]).count()
        };
        assert!(ruled(true) > 20 && ruled(false) == 0, "{} and {}", ruled(true), ruled(false));
    }

    #[test]
    fn what_was_filled_in_is_darker_and_no_point_is_there() {
        let (frame, mut bytes) = plane(40, 30);
        // A square of 5 x 5 points around the middle.
        for at in (13..18).flat_map(|y| (18..23).map(move |x| y * 40 + x)) {
            bytes[at * 16 + 15] = 1;
        }
        let viewpoint =
            Viewpoint { size_px: [320, 240], yaw: 0.0, pitch: 0.0, has_ruler: false, ..Viewpoint::default() };
        let (pixels, depth_buffer) = Painter::default().paint(&frame, &bytes, &viewpoint).unwrap();
        let depth_buffer = depth_buffer.unwrap();
        let at = |place: [f32; 3]| {
            let [x, y, _] = depth_buffer.projection.project(place);
            let red = pixels.rgba[(y.round() as usize * 320 + x.round() as usize) * 4];
            (red, depth_buffer.pick(x, y).is_some())
        };
        assert_eq!((at([0.0, 0.0, 50.0]), at([-10.0, 0.0, 50.0])), ((160, false), (200, true)));
        let cloud = cloud_of(&frame, &bytes, None).unwrap();
        assert!(cloud.xyz_mm[15 * 40 + 20][2].is_nan() && cloud.xyz_mm[15 * 40 + 10][2] == 50.0);
        assert_eq!(cloud.surface_point((20.0, 15.0), 2), None);
    }

    #[test]
    fn what_is_clipped_is_not_there() {
        let (frame, bytes) = plane(40, 30);
        let viewpoint = Viewpoint { size_px: [64, 48], clip_mm: [60.0, 100.0], ..Viewpoint::default() };
        let (_, depth_buffer) = Painter::default().paint(&frame, &bytes, &viewpoint).unwrap();
        assert_eq!(depth_buffer, None);
    }

    #[test]
    fn a_surface_point_has_the_confidence_of_its_pixel() {
        let (frame, bytes) = plane(40, 30);
        // Rows of 44 numbers, four of them beyond the map.
        let numbers = (0..30 * 44).map(|i| if i == 10 * 44 + 20 { 0.25f32 } else { 0.75 });
        let map: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
        let map_frame = abi::Frame { format: abi::FORMAT_F32, stride_bytes: 44 * 4, len: map.len(), ..frame };
        let confidence = |map_frame: &abi::Frame| {
            let cloud = cloud_of(&frame, &bytes, Some((map_frame, &map[..]))).unwrap();
            [(20.4, 9.6), (21.0, 10.0)].map(|at| cloud.surface_point(at, 4).unwrap().confidence)
        };
        assert_eq!(confidence(&map_frame), [Some(0.25), Some(0.75)]);
        // Another size, another kind, or cut off: not known.
        for wrong in [
            abi::Frame { width: 39, ..map_frame },
            abi::Frame { format: abi::FORMAT_GRAY8, ..map_frame },
            abi::Frame { stride_bytes: 48 * 4, ..map_frame },
        ] {
            assert_eq!(confidence(&wrong), [None, None]);
        }
    }

    #[test]
    fn a_surface_point_comes_from_the_points_around_it() {
        let (frame, bytes) = plane(40, 30);
        let mut cloud = cloud_of(&frame, &bytes, None).unwrap();
        cloud.xyz_mm[10 * 40 + 20] = [f32::NAN; 3];
        let depth = cloud.surface_point((20.0, 10.0), 4).map(|p| p.xyz_mm(0.0)[2]);
        assert!(depth.is_some_and(|z| (z - 50.0).abs() < 1e-6), "{depth:?}");
        cloud.xyz_mm.fill([f32::NAN; 3]);
        assert_eq!(cloud.surface_point((20.0, 10.0), 4), None);
        assert_eq!(cloud_of(&abi::Frame { height: 4000, ..frame }, &bytes, None), None, "described wrongly");
    }
}
