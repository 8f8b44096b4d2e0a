//! MATLAB's `stereoParameters` as JSON: `jsonencode(toStruct(stereoParams))`, or of the object itself.
//!
//! MATLAB counts pixels from 1, writes sizes as rows and columns, and its older matrices multiply rows of numbers from the right, so that they are
//! the transposed ones of everybody else: `IntrinsicMatrix`, `RotationOfCamera2`. The newer `K` and `PoseCamera2.R` are not transposed
//! (documentation of `stereoParametersToOpenCV`, `cameraIntrinsics` and `rigidtform3d`).

use panoscope_abi::{Calibration, Camera};

use crate::calibration::document::{Node, Value};
use crate::calibration::error::Mistake;
use crate::calibration::{no_camera_matrix, packet_of};

/// The parameters in a document: the whole, or what is called `stereoParams` in it.
fn parameters(document: &Node) -> Option<&Node> {
    let inner = document.get("stereoParams").unwrap_or(document);
    inner.get("CameraParameters1").map(|_| inner)
}

/// Whether the document has two cameras of MATLAB.
pub(crate) fn is(document: &Node) -> bool {
    parameters(document).is_some()
}

fn transposed(m: [f64; 9]) -> [f64; 9] {
    std::array::from_fn(|index| m[3 * (index % 3) + index / 3])
}

/// Whether a value was empty in MATLAB.
fn is_empty(node: &Node) -> bool {
    matches!(&node.value, Value::List(items) if items.is_empty()) || node.text() == Some("null")
}

fn needed<'n>(node: &'n Node, key: &str) -> Result<&'n Node, Mistake> {
    node.get(key).ok_or_else(|| node.mistake(format!("`{key}` is missing: the file is cut off, or of another kind")))
}

fn camera(parameters: &Node, name: &str) -> Result<Camera, Mistake> {
    let node = needed(parameters, name)?;
    let k = match node.get("K") {
        Some(k) => k.exactly::<9>("K")?,
        None => transposed(needed(node, "IntrinsicMatrix")?.exactly("IntrinsicMatrix")?),
    };
    if let Some(words) = no_camera_matrix(&k) {
        return Err(node.mistake(format!("the camera matrix of `{name}` {words}")));
    }
    if k[1].abs() > 1e-6 * k[0].abs() {
        return Err(node.mistake(format!("`{name}` has the skew {}: calibrate without skew", k[1])));
    }
    let radial = needed(node, "RadialDistortion")?.numbers("RadialDistortion")?;
    let [p1, p2] = needed(node, "TangentialDistortion")?.exactly("TangentialDistortion")?;
    if ![2, 3].contains(&radial.len()) {
        let what = format!("`RadialDistortion` holds {} numbers, 2 or 3 are needed", radial.len());
        return Err(node.mistake(what));
    }
    let mut distortion = [0.0; 14];
    distortion[..4].copy_from_slice(&[radial[0], radial[1], p1, p2]);
    distortion[4] = radial.get(2).copied().unwrap_or(0.0);
    let (width, height) = match node.get("ImageSize").filter(|size| !is_empty(size)) {
        None => (0, 0),
        Some(size) => match size.exactly::<2>("ImageSize")? {
            [rows, columns] if [rows, columns].iter().all(|v| v.fract() == 0.0 && (2.0..=65536.0).contains(v)) => {
                (columns as u32, rows as u32)
            }
            _ => return Err(size.mistake("`ImageSize` is no size in px")),
        },
    };
    Ok(Camera { width, height, fx: k[0], fy: k[4], cx: k[2] - 1.0, cy: k[5] - 1.0, distortion })
}

/// How many mm the unit of the board's squares has.
fn unit_mm(parameters: &Node) -> Result<f64, Mistake> {
    let node = parameters.get("CameraParameters1").and_then(|camera| camera.get("WorldUnits"));
    let Some(node) = node else { return Ok(1.0) };
    match node.text().unwrap_or_default() {
        "mm" | "millimeters" | "" => Ok(1.0),
        "cm" | "centimeters" => Ok(10.0),
        "m" | "meters" => Ok(1000.0),
        "in" | "inches" => Ok(25.4),
        other => Err(node.mistake(format!("the unit `{other}` is not known: mm, cm, m and in are"))),
    }
}

/// Converts the document to the packet.
pub(crate) fn packet(document: &Node) -> Result<Calibration, Mistake> {
    let parameters = parameters(document).ok_or_else(|| document.mistake("`CameraParameters1` is missing"))?;
    let cameras = [camera(parameters, "CameraParameters1")?, camera(parameters, "CameraParameters2")?];
    let (rotation, translation) = match parameters.get("PoseCamera2") {
        Some(pose) => (
            match pose.get("R") {
                Some(r) => r.exactly("R")?,
                None => transposed(needed(pose, "Rotation")?.exactly("Rotation")?),
            },
            needed(pose, "Translation")?.exactly::<3>("Translation")?,
        ),
        None => (
            transposed(needed(parameters, "RotationOfCamera2")?.exactly("RotationOfCamera2")?),
            needed(parameters, "TranslationOfCamera2")?.exactly("TranslationOfCamera2")?,
        ),
    };
    let unit_mm = unit_mm(parameters)?;
    Ok(packet_of(cameras, rotation, translation.map(|t| t * unit_mm)))
}
