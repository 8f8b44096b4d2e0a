//! The numbers in a packet that is not an image: for curves, trajectories and boxes. Read on the observer's thread.

use panoscope_abi as abi;
use panoscope_base::packet::{self, Detections, Numbers, PacketError, decode};

/// Maximum number of list entries that are read.
const MAX_ENTRIES: usize = 256;

/// A detected object and its box.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectedBox {
    /// Left, top, width and height, as fractions of the searched image's width and height.
    pub share: [f32; 4],
    /// Name of the class and score, such as `hook 87 %`.
    pub label: String,
    /// Index of the class; determines the colour.
    pub class: u32,
    /// 0 to 1.
    pub score: f32,
}

/// The numbers of a packet.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Content {
    /// No numbers, or an unknown packet type.
    #[default]
    Nothing,
    /// Boxes of detected objects.
    Boxes(Vec<DetectedBox>),
    /// A tool's tip in the left camera's frame, mm.
    Tip([f64; 3]),
    /// Pose of coordinate frame `b` in frame `a`.
    Pose {
        /// Rotation as w, x, y, z.
        wxyz: [f64; 4],
        /// Position in mm.
        mm: [f64; 3],
        /// Names of frames `a` and `b`.
        frames: (String, String),
    },
    /// Positions of an arm's joints, in the frame `a` of the arm's pose, mm.
    Links(Vec<[f64; 3]>),
    /// Named numbers: a scalar, or the first row of a table.
    Numbers(Vec<(String, f64)>),
    /// The geometry of a stereo camera.
    Rig(Rig),
}

/// The quantities of a stereo calibration that determine the error of distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    /// Focal length of the rectified views, px.
    pub focal_px: f64,
    /// Distance between the cameras, mm.
    pub baseline_mm: f64,
    /// Reprojection error, px; NaN when unknown.
    pub rms_px: f64,
    /// What the calibration states of its own error, as the packet has it.
    pub stated_error: u32,
}

/// Reads a packet; [`Content::Nothing`] when the bytes do not fit the packet type.
pub fn read(bytes: &[u8], packet: &str) -> Content {
    try_read(bytes, packet).unwrap_or_default()
}

fn try_read(bytes: &[u8], kind: &str) -> Result<Content, PacketError> {
    Ok(match kind {
        "detections" | "instances" => Content::Boxes(boxes(&Detections::parse(bytes)?)),
        "tip" => {
            let tip: abi::Tip = decode(bytes)?;
            if tip.xyz_valid == 0 { Content::Nothing } else { Content::Tip(tip.xyz_mm) }
        }
        "pose" => {
            let pose: abi::Pose = decode(bytes)?;
            let frames = (packet::name(&pose.a), packet::name(&pose.b));
            Content::Pose { wxyz: pose.a_from_b_wxyz, mm: pose.a_from_b_mm, frames }
        }
        "scalar" | "table" => match Numbers::read(bytes, kind)? {
            Some(numbers) if numbers.names == abi::LINK_COLUMNS => {
                Content::Links(numbers.rows().filter_map(|row| row.try_into().ok()).collect())
            }
            Some(numbers) => numbers.first_row().map_or(Content::Nothing, Content::Numbers),
            None => Content::Nothing,
        },
        "calibration" => {
            let calibration: abi::Calibration = decode(bytes)?;
            // An unrectified calibration has no projection; the camera matrix then gives the focal length.
            let [projected, ..] = calibration.left_projection;
            let rig = Rig {
                focal_px: if projected > 0.0 { projected } else { calibration.left.fx },
                baseline_mm: calibration.baseline_mm,
                rms_px: calibration.rms_px,
                stated_error: calibration.stated_error,
            };
            if rig.focal_px > 0.0 && rig.baseline_mm > 0.0 { Content::Rig(rig) } else { Content::Nothing }
        }
        _ => Content::Nothing,
    })
}

fn boxes(list: &Detections<'_>) -> Vec<DetectedBox> {
    let labels: Vec<&str> = list.labels().collect();
    let (width, height) = list.image_size();
    let (width, height) = (width.max(1) as f32, height.max(1) as f32);
    let boxes = list.items().take(MAX_ENTRIES).map(|item| DetectedBox {
        share: [item.x_px / width, item.y_px / height, item.width_px / width, item.height_px / height],
        label: format!("{} {:.0} %", labels.get(item.class_index as usize).unwrap_or(&"?"), item.score * 100.0),
        class: item.class_index,
        score: item.score,
    });
    boxes.filter(|detected| detected.share.iter().all(|v| v.is_finite())).collect()
}

/// Transforms a position from frame `b` to frame `a`: rotates it by `wxyz` and moves it by `mm`.
pub fn moved(wxyz: [f64; 4], mm: [f64; 3], position: [f64; 3]) -> [f64; 3] {
    let turned = turned(wxyz, position);
    [turned[0] + mm[0], turned[1] + mm[1], turned[2] + mm[2]]
}

/// The inverse of [`moved`]: transforms a position from frame `a` to frame `b`.
pub fn moved_back(wxyz: [f64; 4], mm: [f64; 3], position: [f64; 3]) -> [f64; 3] {
    let [w, x, y, z] = wxyz;
    turned([w, -x, -y, -z], [position[0] - mm[0], position[1] - mm[1], position[2] - mm[2]])
}

/// Rotates a vector by a unit quaternion w, x, y, z.
fn turned([w, x, y, z]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let axis = [x, y, z];
    let t = cross(axis, v).map(|c| 2.0 * c);
    let u = cross(axis, t);
    [0, 1, 2].map(|k| v[k] + w * t[k] + u[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_have_positions_and_labels() {
        let mut bytes = Vec::new();
        for number in [1u32, 13, 200, 100] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(&0u64.to_le_bytes());
        for number in [50f32, 20.0, 100.0, 50.0, 0.87] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(&1u32.to_le_bytes());
        bytes.extend_from_slice(&(-1i64).to_le_bytes());
        bytes.extend_from_slice(b"hook\nscissors");
        let Content::Boxes(found) = read(&bytes, "detections") else { panic!("no boxes") };
        assert_eq!(found[0].share, [0.25, 0.2, 0.5, 0.5]);
        assert_eq!((found[0].label.as_str(), found[0].score), ("scissors 87 %", 0.87));
        // Cut off anywhere it is read without harm.
        for end in 0..bytes.len() {
            read(&bytes[..end], "detections");
        }
    }

    #[test]
    fn numbers_of_scalars_and_tables_have_names() {
        let mut bytes = 7.5f64.to_le_bytes().to_vec();
        bytes.extend_from_slice(b"error");
        bytes.resize(8 + 32, 0);
        bytes.extend_from_slice(b"mm");
        bytes.resize(8 + 32 + 16, 0);
        assert_eq!(read(&bytes, "scalar"), Content::Numbers(vec![("error mm".to_owned(), 7.5)]));
        let mut bytes = Vec::new();
        for number in [1u32, 2, 8, 0] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(b"x mm\ny\0\0");
        for number in [1.0f64, -2.0] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        let expected = vec![("x mm".to_owned(), 1.0), ("y".to_owned(), -2.0)];
        assert_eq!(read(&bytes, "table"), Content::Numbers(expected));
        assert_eq!(read(&[], "table"), Content::Nothing);
    }

    #[test]
    fn a_table_of_links_is_a_line_in_space() {
        let names = abi::LINK_COLUMNS.join("\n");
        let mut bytes = Vec::new();
        for number in [2u32, 3, names.len().next_multiple_of(8) as u32, 0] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(names.as_bytes());
        bytes.resize(16 + names.len().next_multiple_of(8), 0);
        for number in 1..=6 {
            bytes.extend_from_slice(&f64::from(number).to_le_bytes());
        }
        assert_eq!(read(&bytes, "table"), Content::Links(vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
    }

    #[test]
    fn moving_there_and_back_is_nothing() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A quarter turn about z takes x to y.
        let turn = [half, 0.0, 0.0, half];
        let there = moved(turn, [1.0, 2.0, 3.0], [10.0, 0.0, 0.0]);
        assert!((there[0] - 1.0).abs() < 1e-9 && (there[1] - 12.0).abs() < 1e-9, "{there:?}");
        let back = moved_back(turn, [1.0, 2.0, 3.0], there);
        assert!((back[0] - 10.0).abs() < 1e-9 && back[1].abs() < 1e-9, "{back:?}");
    }
}
