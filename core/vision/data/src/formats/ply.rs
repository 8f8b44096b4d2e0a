//! Polygon file format, binary little-endian, points with colour.

use std::io::{self, Write};

use panoscope_abi::CloudPoint;
pub use panoscope_imaging::draw::GradientLimit;
use panoscope_imaging::draw::Rims;

/// Positions of the points that are on a surface, NaN for the others: ramps that matching draws between depths are not
/// surfaces.
fn on_surfaces(points: &[CloudPoint], width: usize, limit: GradientLimit) -> Vec<[f32; 3]> {
    let position = |p: &CloudPoint| if p.is_known() { [p.x_mm, p.y_mm, p.z_mm] } else { [f32::NAN; 3] };
    let mut positions: Vec<[f32; 3]> = points.iter().map(position).collect();
    if width > 0 {
        Rims::default().part(&mut positions, width, limit);
    }
    positions
}

/// Triangles between neighbours in rows of positions, NaN where unknown: three indices each.
///
/// Neighbours that `limit` separates belong to different surfaces.
fn triangles(positions: &[[f32; 3]], width: usize, limit: GradientLimit) -> impl Iterator<Item = [usize; 3]> + Clone {
    let height = positions.len().checked_div(width).unwrap_or(0);
    let joined = move |a: usize, b: usize| {
        let (p, q) = (positions[a], positions[b]);
        !p[0].is_nan() && !q[0].is_nan() && !limit.parts(p, q)
    };
    (1..height).flat_map(move |y| (1..width).map(move |x| y * width + x)).flat_map(move |d| {
        let (a, b, c) = (d - width - 1, d - width, d - 1);
        // Counter-clockwise as seen by the camera.
        [[a, c, b], [b, c, d]].into_iter().filter(move |[p, q, r]| joined(*p, *q) && joined(*q, *r) && joined(*r, *p))
    })
}

/// Writes the known points; returns their number. Coordinates in mm, left rectified camera frame (x right, y down, z
/// forward). The property `filled` is 1 for points that were filled in, 0 for measured ones. With `limit` the surface
/// between neighbours in rows of `width` points is written too: triangles between points of one surface.
///
/// # Errors
/// Errors of `out`.
pub fn write(
    out: &mut dyn Write,
    points: &[CloudPoint],
    width: usize,
    limit: Option<GradientLimit>,
) -> io::Result<usize> {
    let known = points.iter().filter(|p| p.is_known()).count();
    let positions = limit.map(|limit| on_surfaces(points, width, limit));
    let faces = limit.zip(positions.as_deref()).map(|(limit, positions)| triangles(positions, width, limit));
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment mm, x right, y down, z forward\nelement vertex {known}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         property uchar filled\n"
    )?;
    if let Some(faces) = &faces {
        write!(out, "element face {}\nproperty list uchar int vertex_indices\n", faces.clone().count())?;
    }
    writeln!(out, "end_header")?;
    for point in points.iter().filter(|p| p.is_known()) {
        let mut record = [0; 16];
        record[..4].copy_from_slice(&point.x_mm.to_le_bytes());
        record[4..8].copy_from_slice(&point.y_mm.to_le_bytes());
        record[8..12].copy_from_slice(&point.z_mm.to_le_bytes());
        let [blue, green, red] = point.bgr;
        record[12..].copy_from_slice(&[red, green, blue, point.filled]);
        out.write_all(&record)?;
    }
    if let Some(faces) = faces {
        let mut written = 0u32;
        let places: Vec<u32> = points
            .iter()
            .map(|p| {
                let place = written;
                written += u32::from(p.is_known());
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
        CloudPoint { x_mm: x, y_mm: y, z_mm: z, bgr: [1, 2, 3], filled: 0 }
    }

    fn faces(cloud: &[CloudPoint], width: usize) -> Vec<[usize; 3]> {
        triangles(&on_surfaces(cloud, width, LIMIT), width, LIMIT).collect()
    }

    #[test]
    fn a_ramp_between_two_depths_has_no_triangles() {
        // Seen by a camera of 750 px: the match takes 20 px to come from 70 mm to 80 mm, each of them no steeper than a surface may be.
        let (columns, rows) = (320, 30);
        let seen = |at: usize| {
            let (x, y) = ((at % columns) as f32 - 160.0, (at / columns) as f32 - 15.0);
            let z = 1.0 / (1.0 / 70.0 - (1.0 / 70.0 - 1.0 / 80.0) * (x / 20.0).clamp(0.0, 1.0));
            point(x / 750.0 * z, y / 750.0 * z, z)
        };
        let cloud: Vec<CloudPoint> = (0..columns * rows).map(seen).collect();
        let found = faces(&cloud, columns);
        let crosses = |corners: &[usize; 3], at: usize| {
            let columns = corners.map(|corner| corner % columns);
            columns.iter().any(|x| *x <= at) && columns.iter().any(|x| *x > at)
        };
        // In the middle of the ramp, and on both surfaces.
        assert!(!found.iter().any(|corners| crosses(corners, 170)));
        assert!([120, 200].iter().all(|at| found.iter().any(|corners| crosses(corners, *at))));
    }

    #[test]
    fn a_mesh_leaves_out_unknown_corners_and_steps_of_depth() {
        // At the edge of the image: 0.006 apart on the image plane, 0.45 off the axis. Tissue, and 20 mm before it an instrument.
        let (columns, rows) = (40, 12);
        let seen = |at: usize| {
            let (column, row) = (at % columns, at / columns);
            let z = if column < 20 { 45.0 } else { 65.0 };
            point((0.45 + 0.006 * column as f32) * z, 0.006 * row as f32 * z, z)
        };
        let mut cloud: Vec<CloudPoint> = (0..columns * rows).map(seen).collect();
        let unknown = 6 * columns + 8;
        (cloud[unknown].x_mm, cloud[unknown].z_mm) = (f32::NAN, f32::NAN);
        cloud[1].filled = 1;
        let found = faces(&cloud, columns);
        assert!(found.iter().all(|corners| !corners.contains(&unknown)));
        let sides = found.iter().map(|corners| corners.map(|corner| corner % columns < 20));
        assert!(sides.clone().all(|[a, b, c]| a == b && b == c), "a triangle across the step");
        let before = sides.filter(|side| side[0]).count();
        assert!(before > 200 && found.len() - before > 200, "{before} of {}", found.len());
        let mut file = Vec::new();
        assert_eq!(write(&mut file, &cloud, columns, Some(LIMIT)).unwrap(), columns * rows - 1);
        let header = String::from_utf8_lossy(&file);
        assert!(header.contains(&format!("element vertex {}\nproperty", columns * rows - 1)));
        assert!(header.contains(&format!("element face {}\n", found.len())));
        let size = (columns * rows - 1) * 16 + found.len() * 13;
        let points = header.find("end_header\n").unwrap() + 11;
        assert_eq!(file.len(), points + size);
        let marks: Vec<u8> =
            file[points..].chunks_exact(16).take(columns * rows - 1).map(|record| record[15]).collect();
        assert!(marks[1] == 1 && marks.iter().map(|mark| usize::from(*mark)).sum::<usize>() == 1);
    }
}
