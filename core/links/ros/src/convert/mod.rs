//! Packets as messages and back.

mod bayer;
mod from_ros;
mod to_ros;

pub use from_ros::{
    Boxes, ConvertError, Picture, Samples, boxes, camera_info, cloud, compressed, depth_mm, disparity, joints, picture,
    pose,
};
pub use to_ros::{
    camera_infos, detections_message, disparity_message, header, image_message, joint_message, jpeg_message,
    points_message, pose_message,
};
