//! ROS `camera_info` YAML: one file per camera; lengths in metres.

use panoscope_abi::{Calibration, Camera};

use crate::document::Node;
use crate::error::Mistake;

const MM_PER_M: f64 = 1000.0;

/// Whether the document is a `camera_info`.
pub(crate) fn is(document: &Node) -> bool {
    document.get("projection_matrix").is_some() && document.get("rectification_matrix").is_some()
}

struct Info {
    camera: Camera,
    rectification: [f64; 9],
    projection: [f64; 12],
}

fn info(document: &Node) -> Result<Info, Mistake> {
    let get = |key: &str| {
        document.get(key).ok_or_else(|| {
            Mistake::whole(format!("`{key}` is missing: the file is cut off, or no camera_info of a stereo pair"))
        })
    };
    let k: [f64; 9] = get("camera_matrix")?.exactly("camera_matrix")?;
    let mut distortion = [0.0; 14];
    if let Some(node) = document.get("distortion_coefficients") {
        let all = node.numbers("distortion_coefficients")?;
        let known = document.get("distortion_model").and_then(Node::text).unwrap_or("plumb_bob");
        let longest = match known {
            "plumb_bob" => 5,
            "rational_polynomial" => 14,
            other => {
                return Err(node.mistake(format!(
                    "the distortion model `{other}` is not supported: plumb_bob and rational_polynomial are"
                )));
            }
        };
        if all.len() > longest || ![0, 4, 5, 8, 12, 14].contains(&all.len()) {
            let what = format!("{} distortion coefficients do not belong to the model {known}", all.len());
            return Err(node.mistake(what));
        }
        distortion[..all.len()].copy_from_slice(&all);
    }
    Ok(Info {
        camera: Camera {
            width: get("image_width")?.pixels("image_width")?,
            height: get("image_height")?.pixels("image_height")?,
            fx: k[0],
            fy: k[4],
            cx: k[2],
            cy: k[5],
            distortion,
        },
        rectification: get("rectification_matrix")?.exactly("rectification_matrix")?,
        projection: get("projection_matrix")?.exactly("projection_matrix")?,
    })
}

/// Converts a left and a right file to the packet; a mistake comes with the index of its file.
pub(crate) fn packet(left: &Node, right: &Node) -> Result<Calibration, (usize, Mistake)> {
    let (left, right) = (info(left).map_err(|m| (0, m))?, info(right).map_err(|m| (1, m))?);
    let (r1, r2) = (&left.rectification, &right.rectification);
    // Right from left goes by way of the rectified frame, in which the cameras differ by the baseline alone.
    let turn = |row: usize, column: usize| (0..3).map(|k| r2[3 * k + row] * r1[3 * k + column]).sum::<f64>();
    let rotation = std::array::from_fn(|index| turn(index / 3, index % 3));
    let shift_mm = right.projection[3] / right.projection[0] * MM_PER_M;
    let in_mm = |mut projection: [f64; 12]| {
        projection[3] *= MM_PER_M;
        projection
    };
    Ok(Calibration {
        left: left.camera,
        right: right.camera,
        right_from_left_rotation: rotation,
        right_from_left_mm: [r2[0] * shift_mm, r2[1] * shift_mm, r2[2] * shift_mm],
        rectified_from_left: *r1,
        rectified_from_right: *r2,
        left_projection: in_mm(left.projection),
        right_projection: in_mm(right.projection),
        baseline_mm: shift_mm.abs(),
        rms_px: f64::NAN,
        is_rectified: 0,
        reserved: 0,
    })
}
