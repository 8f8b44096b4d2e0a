//! `camera_calibration.txt` of the EndoVis challenges of 2017 and 2018: raw cameras, lengths in mm.
//!
//! `Width`, `Height`, `Camera-0-F` (focal lengths), `-C` (principal point), `-Alpha` (skew), `-K` (distortion in OpenCV's order), the same of
//! `Camera-1`, `Extrinsic-Omega` (rotation vector, left to right) and `Extrinsic-T`; `//` begins a comment (Allan et al., "2017 robotic
//! instrument segmentation challenge"). That `Extrinsic-Omega` is a rotation vector is what its readers take it for; the files do not say.

use panoscope_abi::{Calibration, Camera};

use crate::calibration::entries::Entries;
use crate::calibration::error::Mistake;
use crate::calibration::{EYE3, packet_of};

/// Whether a text is such a file.
pub(crate) fn is(text: &str) -> bool {
    let entries = Entries::parse(text, ':', "//");
    entries.get("Camera-0-F").or_else(|| entries.get("Camera-1-F")).is_some()
}

fn camera(entries: &Entries<'_>, number: u8, size: (u32, u32)) -> Result<Camera, Mistake> {
    let name = |what: &str| format!("Camera-{number}-{what}");
    let [fx, fy] = entries.needed(&name("F"))?.exactly()?;
    let [cx, cy] = entries.needed(&name("C"))?.exactly()?;
    let known: [f64; 5] = entries.needed(&name("K"))?.exactly()?;
    if let Some(entry) = entries.get(&name("Alpha"))
        && entry.number()?.abs() > 1e-6
    {
        return Err(entry.mistake(format!("`{}` is not 0: skewed pixels are not supported", entry.name)));
    }
    let mut distortion = [0.0; 14];
    distortion[..5].copy_from_slice(&known);
    Ok(Camera { width: size.0, height: size.1, fx, fy, cx, cy, distortion })
}

/// The rotation about a vector by its length (Rodrigues), rows one after the other.
fn rotation(omega: [f64; 3]) -> [f64; 9] {
    let angle = omega.iter().map(|v| v * v).sum::<f64>().sqrt();
    if angle < 1e-12 {
        return EYE3;
    }
    let [x, y, z] = omega.map(|v| v / angle);
    let (sine, cosine) = angle.sin_cos();
    let rest = 1.0 - cosine;
    [
        cosine + x * x * rest,
        x * y * rest - z * sine,
        x * z * rest + y * sine,
        y * x * rest + z * sine,
        cosine + y * y * rest,
        y * z * rest - x * sine,
        z * x * rest - y * sine,
        z * y * rest + x * sine,
        cosine + z * z * rest,
    ]
}

/// The packet of a file.
pub(crate) fn packet(text: &str) -> Result<Calibration, Mistake> {
    let entries = Entries::parse(text, ':', "//");
    let size = match (entries.get("Width"), entries.get("Height")) {
        (Some(width), Some(height)) => (width.pixels()?, height.pixels()?),
        _ => (0, 0),
    };
    let (left, right) = (camera(&entries, 0, size)?, camera(&entries, 1, size)?);
    let omega = entries.needed("Extrinsic-Omega")?.exactly()?;
    let translation: [f64; 3] = entries.needed("Extrinsic-T")?.exactly()?;
    Ok(packet_of([left, right], rotation(omega), translation))
}
