//! Names of topics, types and frames.

/// The left camera.
pub const LEFT: &str = "left_optical_frame";
/// The right camera.
pub const RIGHT: &str = "right_optical_frame";
/// The left camera after rectification: points, depth and disparity are in it.
pub const LEFT_RECTIFIED: &str = "left_rectified_optical_frame";

/// Converts a name to ROS's rules: letters, digits and `_`, parts separated by `/` that do not begin with a digit.
/// Other characters become `_`.
pub fn sanitized(name: &str) -> String {
    let part = |part: &str| {
        let part: String = part.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        if part.starts_with(|c: char| c.is_ascii_digit()) { format!("_{part}") } else { part }
    };
    name.split('/').filter(|each| !each.is_empty()).map(part).collect::<Vec<_>>().join("/")
}

/// Converts `node.output` to the start of a topic: `/node/output`.
pub fn topic(port: &str) -> String {
    format!("/{}", sanitized(&port.replace('.', "/")))
}

/// The topic of DDS for a topic of ROS: `/left/image_raw` is `rt/left/image_raw`.
pub fn dds_topic(topic: &str) -> String {
    format!("rt/{}", topic.trim_start_matches('/'))
}

/// The type of DDS for a type of ROS: `sensor_msgs/msg/Image` is `sensor_msgs::msg::dds_::Image_`.
pub fn dds_type(message: &str) -> String {
    match message.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => message.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_ros() {
        assert_eq!(topic("stereo/match-1.disparity"), "/stereo/match_1/disparity");
        assert_eq!(sanitized("/2nd//a b/"), "_2nd/a_b");
        assert_eq!(dds_topic("/left/image_raw"), "rt/left/image_raw");
        assert_eq!(dds_type("sensor_msgs/msg/Image"), "sensor_msgs::msg::dds_::Image_");
    }
}
