//! A recording as a bag of ROS 2.
//!
//! | packets | topic | type |
//! |---|---|---|
//! | `image`, `mask`, `confidence` | `/node/port/image_raw` | `sensor_msgs/msg/Image` |
//! | `depth` | `/node/port/image_raw` | `sensor_msgs/msg/Image`, 32FC1, m |
//! | `disparity` | `/node/port` | `stereo_msgs/msg/DisparityImage` |
//! | `calibration` | `/node/left/camera_info`, `/node/right/camera_info` | `sensor_msgs/msg/CameraInfo` |
//! | `cloud` | `/node/port` | `sensor_msgs/msg/PointCloud2`, m, in rows, NaN where unknown |
//! | `detections`, `instances` | `/node/port` | `vision_msgs/msg/Detection2DArray` |
//! | `pose` | `/node/port` | `geometry_msgs/msg/PoseStamped`, m |
//! | `joints` | `/node/port` | `sensor_msgs/msg/JointState` |
//!
//! Other packets have no message in ROS's common packages and are left out; the report says so. Stamps are times of
//! capture, frames end with `_optical_frame`.

use std::path::Path;

use panoscope_abi as abi;
use panoscope_data::formats::Pixels;
use panoscope_record::Packet;
use panoscope_ros::bag::{BagError, BagWriter};
use panoscope_ros::convert;
use panoscope_ros::names;

use crate::error::ExportError;
use crate::selection::{Export, Form, Port, PortReport};
use crate::value::{Kind, Value};

/// Remark about packets without a message type.
const NO_MESSAGE: &str = "ROS's common packages have no message for it; --folder and --foxglove have it";

/// Writes a bag. It is complete when it has its `metadata.yaml`. With `replaces`, a folder that is not empty is
/// accepted and the bag's files are replaced.
///
/// # Errors
/// The folder is not empty, something cannot be written, or the recording is damaged.
pub fn write(export: &Export<'_>, folder: &Path, replaces: bool) -> Result<Vec<PortReport>, ExportError> {
    let failed = |error: BagError| match error {
        BagError::Exists { path } => ExportError::Exists { path },
        BagError::Write { path, cause } => ExportError::Write { path, cause },
        other => ExportError::Write { path: folder.to_owned(), cause: std::io::Error::other(other) },
    };
    let mut bag = BagWriter::create(folder, replaces).map_err(failed)?;
    let mut reports: Vec<Option<PortReport>> = vec![None; export.ports.len()];
    let mut order: Vec<(usize, Kind, &Packet)> = Vec::new();
    for (index, port) in export.ports.iter().enumerate() {
        match &port.kind {
            Ok(kind) => order.extend(port.packets.iter().map(|packet| (index, *kind, *packet))),
            Err(why) => reports[index] = Some(port.left_out(why.clone())),
        }
    }
    order.sort_by_key(|(index, _, packet)| (packet.head.tick.capture_ns, packet.head.tick.seq, *index));
    let calibration = calibration(export)?;
    for (index, kind, packet) in order {
        let port = &export.ports[index];
        let written = export.value(port, kind, packet, |value| {
            put(&mut bag, port, packet.head.tick.capture_ns, packet.head.width, value, calibration.as_ref())
                .map_err(failed)
        })?;
        reports[index].get_or_insert_with(|| match written {
            Some((form, topic)) => port.written(form, topic),
            None => port.left_out(NO_MESSAGE),
        });
    }
    bag.finish().map_err(failed)?;
    Ok(reports.into_iter().flatten().collect())
}

/// The first calibration with a rectification: disparity needs focal length and baseline.
fn calibration(export: &Export<'_>) -> Result<Option<abi::Calibration>, ExportError> {
    for port in export.ports.iter().filter(|port| port.kind == Ok(Kind::Calibration)) {
        let Some(packet) = port.packets.first() else { continue };
        let found = export.value(port, Kind::Calibration, packet, |value| {
            Ok(match value {
                Value::Calibration(calibration) if calibration.left_projection != [0.0; 12] => Some(*calibration),
                _ => None,
            })
        })?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}

/// The optical frame of an image, by the output's name.
fn frame_of(port: &Port<'_>) -> &'static str {
    let output = port.name.rsplit_once('.').map_or(port.name, |(_, output)| output);
    match port.packet.as_str() {
        "depth" | "confidence" => names::LEFT_RECTIFIED,
        _ if output.contains("right") => names::RIGHT,
        _ => names::LEFT,
    }
}

/// Topics of the cameras of a calibration: next to the images `left` and `right` of its node.
fn camera_topics(port: &str) -> [String; 2] {
    let beside = match port.rsplit_once('.') {
        Some((node, "calibration")) => names::topic(node),
        _ => names::topic(port),
    };
    ["left", "right"].map(|side| format!("{beside}/{side}/camera_info"))
}

/// Writes a packet. Returns type and topic; `None` if ROS has no message for it.
fn put(
    bag: &mut BagWriter,
    port: &Port<'_>,
    capture_ns: i64,
    width: u32,
    value: Value<'_>,
    calibration: Option<&abi::Calibration>,
) -> Result<Option<(Form, String)>, BagError> {
    let topic = names::topic(port.name);
    let form = match value {
        Value::Picture(picture) => match picture.pixels() {
            Pixels::F32(view) if port.packet == "disparity" => {
                let header = convert::header(capture_ns, names::LEFT_RECTIFIED);
                bag.write(&topic, capture_ns, &convert::disparity_message(&view, calibration, header))?;
                "stereo_msgs/msg/DisparityImage"
            }
            pixels => {
                let topic = format!("{topic}/image_raw");
                let scale = if port.packet == "depth" { 1e-3 } else { 1.0 };
                let header = convert::header(capture_ns, frame_of(port));
                bag.write(&topic, capture_ns, &convert::image_message(&pixels, scale, header))?;
                return Ok(Some(("sensor_msgs/msg/Image", topic)));
            }
        },
        Value::Cloud(points, _) => {
            let header = convert::header(capture_ns, names::LEFT_RECTIFIED);
            let message = convert::points_message(points.into_iter(), width as usize, header);
            bag.write(&topic, capture_ns, &message)?;
            "sensor_msgs/msg/PointCloud2"
        }
        Value::Calibration(calibration) => {
            let topics = camera_topics(port.name);
            for (topic, info) in topics.iter().zip(convert::camera_infos(&calibration, capture_ns)) {
                bag.write(topic, capture_ns, &info)?;
            }
            return Ok(Some(("sensor_msgs/msg/CameraInfo", topics.join(", "))));
        }
        Value::Detections(detections) => {
            let header = convert::header(capture_ns, names::LEFT);
            let boxes = detections.items().map(|item| (item, detections.label(item.class_index).unwrap_or("")));
            bag.write(&topic, capture_ns, &convert::detections_message(boxes, header))?;
            "vision_msgs/msg/Detection2DArray"
        }
        Value::Pose(pose) => {
            bag.write(&topic, capture_ns, &convert::pose_message(&pose, capture_ns))?;
            "geometry_msgs/msg/PoseStamped"
        }
        Value::Joints(joints) => {
            bag.write(&topic, capture_ns, &convert::joint_message(&joints, capture_ns))?;
            "sensor_msgs/msg/JointState"
        }
        Value::Homography(_) | Value::Roi(_) | Value::Tip(_) | Value::Scalar(_) | Value::Table(_) | Value::Text(_) => {
            return Ok(None);
        }
    };
    Ok(Some((form, topic)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_stand_beside_their_pictures() {
        assert_eq!(camera_topics("scope.calibration"), ["/scope/left/camera_info", "/scope/right/camera_info"]);
        assert_eq!(camera_topics("a/b.cameras")[1], "/a/b/cameras/right/camera_info");
    }
}
