//! Messages and bags of ROS 2, and the request heads that a WebSocket server's gate reads.

use panoscope_ros::bag::{BagReader, BagWriter};
use panoscope_ros::cdr::{self, Message};
use panoscope_ros::convert;
use panoscope_ros::messages::{
    CameraInfo, CompressedImage, Detection2DArray, DisparityImage, Image, JointState, PointCloud2, PoseStamped,
};

use crate::scratch;

/// Reads bytes as a message; a valid message is written and read again.
fn again<'b, M>(bytes: &'b [u8]) -> Option<M>
where
    M: Message + serde::Serialize + serde::Deserialize<'b>,
{
    let message = cdr::decode::<M>(bytes).ok()?;
    let written = cdr::encode(&message).expect("what was read can be written");
    // A list without elements may stand for bytes that were ignored, so the text may be shorter, but never in proportion longer.
    assert!(written.len() <= bytes.len() * 8 + 64, "{} bytes became {}", bytes.len(), written.len());
    Some(message)
}

/// One message: the first byte selects its type.
pub fn message(bytes: &[u8]) {
    let Some((kind, bytes)) = bytes.split_first() else { return };
    match kind % 8 {
        0 => {
            if let Some(message) = again::<Image<'_>>(bytes) {
                let _ = convert::depth_mm(&message);
                if let Ok(picture) = convert::picture(&message) {
                    assert_eq!((picture.width, picture.height), (message.width as usize, message.height as usize));
                }
            }
        }
        1 => {
            if let Some(message) = again::<CompressedImage<'_>>(bytes) {
                let _ = convert::compressed(&message);
            }
        }
        2 => {
            if let Some(message) = again::<CameraInfo>(bytes) {
                let _ = convert::camera_info(&message);
            }
        }
        3 => {
            if let Some(message) = again::<DisparityImage<'_>>(bytes)
                && let Ok((_, _, values)) = convert::disparity(&message)
            {
                assert!(values.iter().all(|value| value.is_nan() || *value > 0.0));
            }
        }
        4 => {
            if let Some(message) = again::<PointCloud2<'_>>(bytes)
                && let Ok((width, height, points)) = convert::cloud(&message)
            {
                assert_eq!(width * height, points.len());
            }
        }
        5 => {
            if let Some(message) = again::<Detection2DArray>(bytes)
                && let Ok(boxes) = convert::boxes(&message)
            {
                assert_eq!(boxes.items.len(), message.detections.len());
                assert!(boxes.items.iter().all(|item| (item.class_index as usize) < boxes.labels.len()));
            }
        }
        6 => {
            if let Some(message) = again::<PoseStamped>(bytes) {
                let _ = convert::pose(&message, "child");
            }
        }
        _ => {
            if let Some(message) = again::<JointState>(bytes) {
                let _ = convert::joints(&message);
            }
        }
    }
}

fn of<M: Message + serde::Serialize>(kind: u8, message: &M) -> Vec<u8> {
    let mut bytes = vec![kind];
    bytes.extend(cdr::encode(message).expect("a message"));
    bytes
}

pub fn message_seeds() -> Vec<Vec<u8>> {
    let image = |encoding: &str, pixel: u32| Image {
        width: 2,
        height: 2,
        step: 2 * pixel,
        encoding: encoding.to_owned(),
        data: panoscope_ros::messages::Bytes(vec![65; 4 * pixel as usize].into()),
        ..Image::default()
    };
    let detections = {
        let item = panoscope_abi::Detection {
            x_px: 1.0,
            y_px: 2.0,
            width_px: 3.0,
            height_px: 4.0,
            score: 0.5,
            class_index: 0,
            track_id: 1,
        };
        convert::detections_message([(item, "hook"), (item, "")].into_iter(), convert::header(7, "f"))
    };
    let point = panoscope_abi::CloudPoint { x_mm: 1.0, y_mm: 2.0, z_mm: 3.0, bgr: [1, 2, 3], filled: 0 };
    vec![
        of(0, &image("rgb8", 3)),
        of(0, &image("32FC1", 4)),
        of(
            1,
            &CompressedImage { data: panoscope_ros::messages::Bytes(b"\x89PNG\r\n"[..].into()), ..Default::default() },
        ),
        of(2, &CameraInfo { distortion_model: "plumb_bob".to_owned(), d: vec![0.0; 5], ..CameraInfo::default() }),
        of(3, &DisparityImage { image: image("32FC1", 4), ..DisparityImage::default() }),
        of(4, &convert::points_message([point, point].into_iter(), 2, convert::header(0, "f"))),
        of(5, &detections),
        of(6, &PoseStamped::default()),
        of(7, &JointState { name: vec!["a".to_owned()], position: vec![1.0], ..JointState::default() }),
    ]
}

/// An MCAP file of a bag.
pub fn bag(bytes: &[u8]) {
    let mut total = 0;
    let _ = BagReader::read_bytes(bytes, |message| {
        total += message.data.len() + message.topic.len();
        let _ = cdr::decode::<Image<'_>>(&message.data);
    });
    // Compressed chunks may hold more than their bytes; the fuzzer's limit of memory holds for single messages.
    let _ = total;
}

pub fn bag_seeds() -> Vec<Vec<u8>> {
    let folder = scratch::path("ros_bag");
    let _ = std::fs::remove_dir_all(&folder);
    let mut writer = BagWriter::create(&folder, true).expect("a bag");
    for tick in 0..2 {
        writer.write("/joints", tick, &JointState::default()).expect("written");
        writer.write("/pose", tick, &PoseStamped::default()).expect("written");
    }
    writer.finish().expect("finished");
    let bytes = std::fs::read(folder.join("ros_bag_0.mcap")).expect("a file");
    let _ = std::fs::remove_dir_all(&folder);
    vec![bytes.clone(), bytes[..bytes.len() / 2].to_vec(), b"\x89MCAP0\r\n".to_vec()]
}

/// The head of a request.
pub fn gate(bytes: &[u8]) {
    let passes = panoscope_export::live::check_head(bytes).is_ok();
    // What passes has one host, and it is an address or `localhost`.
    assert!(!passes || bytes.to_ascii_lowercase().windows(5).any(|five| five == b"host:"));
}

pub fn gate_seeds() -> Vec<Vec<u8>> {
    let head = |fields: &str| format!("GET / HTTP/1.1\r\n{fields}\r\n").into_bytes();
    vec![
        head("Host: 127.0.0.1:8765\r\nUpgrade: websocket\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n"),
        head("Host: [::1]:1\r\nOrigin: http://localhost:8080\r\n"),
        head("Host: evil.example\r\nOrigin: null\r\n"),
    ]
}
