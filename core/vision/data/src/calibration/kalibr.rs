//! Kalibr's camera chain: `cam0` is the left camera, `cam1` the right one; lengths in metres.

use panoscope_abi::{Calibration, Camera};

use crate::calibration::document::Node;
use crate::calibration::error::Mistake;
use crate::calibration::{equidistant, packet_of};

const MM_PER_M: f64 = 1000.0;

/// Whether the document is a Kalibr camera chain.
pub(crate) fn is(document: &Node) -> bool {
    document.get("cam0").is_some_and(|camera| camera.get("intrinsics").is_some())
}

fn camera(chain: &Node, name: &str) -> Result<Camera, Mistake> {
    let node = chain.get(name).ok_or_else(|| Mistake::whole(format!("`{name}` is missing: two cameras are needed")))?;
    let get = |key: &str| node.get(key).ok_or_else(|| node.mistake(format!("`{name}` has no `{key}`")));
    let word = |key: &str| node.get(key).and_then(Node::text).unwrap_or_default();
    if word("camera_model") != "pinhole" {
        let what = format!("`{name}` has the camera model `{}`: only pinhole is supported", word("camera_model"));
        return Err(node.mistake(what));
    }
    let mut distortion = [0.0; 14];
    match word("distortion_model") {
        "radtan" => {
            let given: [f64; 4] = get("distortion_coeffs")?.exactly("distortion_coeffs")?;
            distortion[..4].copy_from_slice(&given);
        }
        "equidistant" => distortion = equidistant(get("distortion_coeffs")?.exactly("distortion_coeffs")?),
        "none" | "" => {}
        other => {
            let what =
                format!("`{name}` has the distortion model `{other}`: radtan, equidistant and none are supported");
            return Err(node.mistake(what));
        }
    }
    let [fx, fy, cx, cy] = get("intrinsics")?.exactly("intrinsics")?;
    let resolution = get("resolution")?;
    let [width, height] = resolution.exactly("resolution")?;
    let whole = |v: f64| v.fract() == 0.0 && (2.0..=65536.0).contains(&v);
    if !whole(width) || !whole(height) {
        return Err(resolution.mistake("`resolution` is no size in px"));
    }
    Ok(Camera { width: width as u32, height: height as u32, fx, fy, cx, cy, distortion })
}

/// Converts a camera chain to the packet.
pub(crate) fn packet(chain: &Node) -> Result<Calibration, Mistake> {
    let (left, right) = (camera(chain, "cam0")?, camera(chain, "cam1")?);
    let pose = chain.get("cam1").and_then(|camera| camera.get("T_cn_cnm1"));
    let pose = pose.ok_or_else(|| Mistake::whole("`cam1` has no `T_cn_cnm1`: the pose between the cameras"))?;
    let m: [f64; 16] = pose.exactly("T_cn_cnm1")?;
    let translation = [m[3], m[7], m[11]].map(|t| t * MM_PER_M);
    let rotation = std::array::from_fn(|index| m[4 * (index / 3) + index % 3]);
    Ok(packet_of([left, right], rotation, translation))
}
