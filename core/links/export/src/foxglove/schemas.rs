//! Which topics and schemas the packets of an output have.

use foxglove::Encode;
use foxglove::messages as own;
use serde_json::{Value as Json, json};

use crate::selection::Form;
use crate::value::Kind;

/// The schema of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// `protobuf` or `jsonschema`.
    pub encoding: &'static str,
    /// Description of the message: a set of file descriptors, or a text.
    pub data: Vec<u8>,
    /// Encoding of messages: `protobuf` or `json`.
    pub message_encoding: &'static str,
}

/// A topic of an output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// Name of its schema.
    pub form: Form,
}

/// The topics of an output of this kind in a live connection, where 8-bit images are raw and, below `/jpeg`,
/// compressed. `topic` is the output's.
pub fn topics(kind: Kind, topic: &str) -> Vec<Topic> {
    let forms: &[(&str, Form)] = match kind {
        Kind::Picture => &[("", "foxglove.RawImage"), ("/jpeg", "foxglove.CompressedImage")],
        Kind::Cloud => &[("", "foxglove.PointCloud")],
        Kind::Calibration => &[
            ("/frames", "foxglove.FrameTransforms"),
            ("/left", "foxglove.CameraCalibration"),
            ("/right", "foxglove.CameraCalibration"),
        ],
        Kind::Detections | Kind::Roi => &[("", "foxglove.ImageAnnotations")],
        Kind::Instances => &[("", "foxglove.ImageAnnotations"), ("/masks", "foxglove.RawImage")],
        Kind::Tip => &[("", "foxglove.ImageAnnotations"), ("/position", "foxglove.Point3InFrame")],
        Kind::Pose => &[("", "foxglove.PoseInFrame"), ("/frame", "foxglove.FrameTransform")],
        Kind::Joints => &[("", "foxglove.JointStates")],
        Kind::Homography => &[("", "panoscope.Homography")],
        Kind::Scalar => &[("", "panoscope.Scalar")],
        Kind::Table => &[("", "panoscope.Table")],
        Kind::Text => &[("", "panoscope.Text")],
    };
    forms.iter().map(|(below, form)| Topic { name: format!("{topic}{below}"), form }).collect()
}

impl Schema {
    /// The schema of that name. `columns` are those of a table, if they are known.
    pub fn of(form: Form, columns: &[String]) -> Self {
        match form {
            "foxglove.RawImage" => protobuf::<own::RawImage>(),
            "foxglove.CompressedImage" => protobuf::<own::CompressedImage>(),
            "foxglove.PointCloud" => protobuf::<own::PointCloud>(),
            "foxglove.FrameTransforms" => protobuf::<own::FrameTransforms>(),
            "foxglove.FrameTransform" => protobuf::<own::FrameTransform>(),
            "foxglove.CameraCalibration" => protobuf::<own::CameraCalibration>(),
            "foxglove.ImageAnnotations" => protobuf::<own::ImageAnnotations>(),
            "foxglove.Point3InFrame" => protobuf::<own::Point3InFrame>(),
            "foxglove.PoseInFrame" => protobuf::<own::PoseInFrame>(),
            "foxglove.JointStates" => protobuf::<own::JointStates>(),
            _ => json_schema(form, columns),
        }
    }
}

fn protobuf<M: Encode>() -> Schema {
    let data = M::get_schema().map(|schema| schema.data.into_owned()).unwrap_or_default();
    Schema { encoding: "protobuf", data, message_encoding: "protobuf" }
}

fn json_schema(form: Form, columns: &[String]) -> Schema {
    let number = || json!({ "type": ["number", "null"] });
    let text = || json!({ "type": "string" });
    let mut properties = match form {
        "panoscope.Homography" => json!({
            "left_from_right": { "type": "array", "items": number() },
            "rms_px": number(), "inliers": number(), "state": text(),
        }),
        "panoscope.Scalar" => json!({ "name": text(), "value": number(), "unit": text() }),
        "panoscope.Text" => json!({ "text": text() }),
        _ => {
            let columns: serde_json::Map<String, Json> = columns.iter().map(|name| (name.clone(), number())).collect();
            json!({ "rows": { "type": "array", "items": { "type": "object", "properties": columns } } })
        }
    };
    properties["tick"] = json!({ "type": "integer" });
    properties["capture_ns"] = json!({ "type": "integer" });
    let schema = json!({ "title": form, "type": "object", "properties": properties });
    Schema { encoding: "jsonschema", data: schema.to_string().into_bytes(), message_encoding: "json" }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KINDS: [Kind; 13] = [
        Kind::Picture,
        Kind::Cloud,
        Kind::Homography,
        Kind::Roi,
        Kind::Calibration,
        Kind::Detections,
        Kind::Instances,
        Kind::Tip,
        Kind::Pose,
        Kind::Joints,
        Kind::Scalar,
        Kind::Table,
        Kind::Text,
    ];

    #[test]
    fn every_topic_has_the_schema_that_it_names() {
        for kind in KINDS {
            let all = topics(kind, "/a/b");
            assert!(all.iter().all(|topic| topic.name.starts_with("/a/b")), "{kind:?}");
            for Topic { form, .. } in all {
                let schema = Schema::of(form, &[]);
                let is_own = form.starts_with("panoscope.");
                assert_eq!(schema.encoding == "jsonschema", is_own, "{form}");
                let name = form.rsplit('.').next().unwrap();
                assert!(String::from_utf8_lossy(&schema.data).contains(name), "{form}");
            }
        }
    }
}
