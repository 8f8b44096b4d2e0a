//! Polygon file format, binary little-endian, points with colour.

use std::io::{self, Write};

use panoscope_node::abi::CloudPoint;

fn is_known(point: &CloudPoint) -> bool {
    point.x_mm.is_finite() && point.y_mm.is_finite() && point.z_mm.is_finite()
}

/// Writes the points whose place is known; answers how many. Coordinates in mm, left rectified camera frame (x right, y
/// down, z forward).
///
/// # Errors
/// Those of `out`.
pub fn write(out: &mut dyn Write, points: &[CloudPoint]) -> io::Result<usize> {
    let known = points.iter().filter(|p| is_known(p)).count();
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment mm, x right, y down, z forward\nelement vertex {known}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    )?;
    for point in points.iter().filter(|p| is_known(p)) {
        let mut record = [0; 15];
        record[..4].copy_from_slice(&point.x_mm.to_le_bytes());
        record[4..8].copy_from_slice(&point.y_mm.to_le_bytes());
        record[8..12].copy_from_slice(&point.z_mm.to_le_bytes());
        let [blue, green, red] = point.bgr;
        record[12..].copy_from_slice(&[red, green, blue]);
        out.write_all(&record)?;
    }
    Ok(known)
}
