//! Polygon file format, binary little-endian, points with colour.

use std::io::{self, Write};

use panoscope_abi::CloudPoint;
pub use panoscope_imaging::draw::GradientLimit;

/// Whether a point has coordinates.
pub fn is_known(point: &CloudPoint) -> bool {
    point.x_mm.is_finite() && point.y_mm.is_finite() && point.z_mm.is_finite()
}

/// Triangles between neighbours in rows of points: three places in the cloud each.
///
/// Neighbours that `limit` parts belong to different surfaces.
pub fn triangles(
    points: &[CloudPoint],
    width: usize,
    limit: GradientLimit,
) -> impl Iterator<Item = [usize; 3]> + Clone {
    let height = points.len().checked_div(width).unwrap_or(0);
    let joined = move |a: usize, b: usize| {
        let (p, q) = (&points[a], &points[b]);
        let place = |p: &CloudPoint| [p.x_mm, p.y_mm, p.z_mm];
        is_known(p) && is_known(q) && !limit.parts(place(p), place(q))
    };
    (1..height).flat_map(move |y| (1..width).map(move |x| y * width + x)).flat_map(move |d| {
        let (a, b, c) = (d - width - 1, d - width, d - 1);
        // Counter-clockwise as seen by the camera.
        [[a, c, b], [b, c, d]].into_iter().filter(move |[p, q, r]| joined(*p, *q) && joined(*q, *r) && joined(*r, *p))
    })
}

/// Writes the known points; returns their number. Coordinates in mm, left rectified camera frame (x right, y
/// down, z forward). With `limit` the surface between neighbours in rows of `width` points is written too, see [`triangles`].
///
/// # Errors
/// Those of `out`.
pub fn write(
    out: &mut dyn Write,
    points: &[CloudPoint],
    width: usize,
    limit: Option<GradientLimit>,
) -> io::Result<usize> {
    let known = points.iter().filter(|p| is_known(p)).count();
    let faces = limit.map(|limit| triangles(points, width, limit));
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment mm, x right, y down, z forward\nelement vertex {known}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n"
    )?;
    if let Some(faces) = &faces {
        write!(out, "element face {}\nproperty list uchar int vertex_indices\n", faces.clone().count())?;
    }
    writeln!(out, "end_header")?;
    for point in points.iter().filter(|p| is_known(p)) {
        let mut record = [0; 15];
        record[..4].copy_from_slice(&point.x_mm.to_le_bytes());
        record[4..8].copy_from_slice(&point.y_mm.to_le_bytes());
        record[8..12].copy_from_slice(&point.z_mm.to_le_bytes());
        let [blue, green, red] = point.bgr;
        record[12..].copy_from_slice(&[red, green, blue]);
        out.write_all(&record)?;
    }
    if let Some(faces) = faces {
        let mut written = 0u32;
        let places: Vec<u32> = points
            .iter()
            .map(|p| {
                let place = written;
                written += u32::from(is_known(p));
                place
            })
            .collect();
        for corners in faces {
            let mut record = [3; 13];
            for (k, corner) in corners.into_iter().enumerate() {
                record[1 + 4 * k..5 + 4 * k].copy_from_slice(&places[corner].to_le_bytes());
            }
            out.write_all(&record)?;
        }
    }
    Ok(known)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: GradientLimit = GradientLimit { max_gradient: 1.5, baseline_mm: 15.0 };

    fn point(x: f32, y: f32, z: f32) -> CloudPoint {
        CloudPoint { x_mm: x, y_mm: y, z_mm: z, bgr: [1, 2, 3], reserved: 0 }
    }

    #[test]
    fn a_step_near_the_edge_of_the_picture_is_no_surface() {
        // One row of pixels, 0.006 apart on the image plane, 0.45 off the axis: an instrument before tissue, twice.
        let seen = |k: usize, z: f32| point((0.45 + 0.006 * (k % 3) as f32) * z, 0.006 * (k / 3) as f32 * z, z);
        let cloud: Vec<CloudPoint> = (0..6).map(|k| seen(k, if k % 3 == 0 { 45.0 } else { 67.0 })).collect();
        let found: Vec<_> = triangles(&cloud, 3, LIMIT).collect();
        assert_eq!(found, [[1, 4, 2], [2, 4, 5]]);
    }

    #[test]
    fn a_mesh_leaves_out_unknown_corners_and_steps() {
        // 3 x 2 points; the lower right one is unknown, the upper right one lies 30 mm deeper.
        let cloud = [
            point(0.0, 0.0, 50.0),
            point(1.0, 0.0, 50.0),
            point(2.0, 0.0, 80.0),
            point(0.0, 1.0, 50.0),
            point(1.0, 1.0, 50.0),
            point(f32::NAN, f32::NAN, f32::NAN),
        ];
        let found: Vec<_> = triangles(&cloud, 3, LIMIT).collect();
        assert_eq!(found, [[0, 3, 1], [1, 3, 4]]);
        let mut file = Vec::new();
        assert_eq!(write(&mut file, &cloud, 3, Some(LIMIT)).unwrap(), 5);
        let header = String::from_utf8_lossy(&file);
        assert!(header.contains("element vertex 5\n") && header.contains("element face 2\n"));
        assert_eq!(file.len(), header.find("end_header\n").unwrap() + 11 + 5 * 15 + 2 * 13);
    }
}
