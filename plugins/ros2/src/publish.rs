//! `ros2_publish`: publishes its inputs as topics of ROS 2.

use std::time::{SystemTime, UNIX_EPOCH};

use panoscope_data::formats::Pixels;
use panoscope_node::abi::{Calibration, Joints, Pose};
use panoscope_node::{
    AnyImage, Bgr8, Choice, Cloud, Context, Depth, Detections, Disparity, Gray8, Gray16, GrayF32, Image, NoPorts, Node,
    NodeError, NodeInfo, Open, Params, Ports, Result, Rgba8, Validation, Value,
};
use panoscope_ros::convert;
use panoscope_ros::messages;
use panoscope_ros::names;

use crate::Networks;
use crate::dds::{DdsError, MAX_DOMAIN, Member, Quality, TopicWriter};

/// Inputs: each connected one is published.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view, as `left/image_raw`.
    pub left: Option<AnyImage<'f>>,
    /// Right view, as `right/image_raw`.
    pub right: Option<AnyImage<'f>>,
    /// Both cameras, as `left/camera_info` and `right/camera_info`; the disparity's focal length and baseline.
    pub calibration: Option<Value<'f, Calibration>>,
    /// Depth, as `depth/image`, in m.
    pub depth: Option<Image<'f, Depth>>,
    /// Disparity, as `disparity`.
    pub disparity: Option<Image<'f, Disparity>>,
    /// Points, as `points`, in m.
    pub cloud: Option<Cloud<'f>>,
    /// Boxes, as `detections`.
    pub detections: Option<Detections<'f>>,
    /// A pose, as `pose`, in m.
    pub pose: Option<Value<'f, Pose>>,
    /// Joints of an arm, as `joint_states`.
    pub joints: Option<Value<'f, Joints>>,
}

/// How images are sent.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pictures {
    /// Uncompressed.
    Raw,
    /// As JPEG, on `left/image_raw/compressed`.
    Jpeg,
    /// Both: uncompressed and as JPEG.
    Both,
}

/// Origin of the stamps.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stamps {
    /// 1970: the time of day at the first tick, then advanced by capture times.
    Clock,
    /// Capture times unchanged.
    Capture,
}

/// Parameters of `ros2_publish`.
#[derive(Params)]
pub struct Settings {
    /// Prefix of the name of every topic.
    #[param(default = "/panoscope", reopen)]
    pub namespace: String,
    /// DDS domain, the ROS_DOMAIN_ID of other programs.
    #[param(default = 0, range = 0..=232, reopen)]
    pub domain: u16,
    /// Which machines can be reached.
    #[param(default = "loopback", reopen)]
    pub networks: Networks,
    /// Sends lost messages again; readers may still ask for best effort.
    #[param(default = true, reopen)]
    pub reliable: bool,
    /// Number of messages per topic that are kept for slow readers.
    #[param(default = 5, range = 1..=100, reopen)]
    pub queue: u16,
    /// How 8-bit images are sent.
    #[param(default = "raw", reopen)]
    pub pictures: Pictures,
    /// Origin of the stamps.
    #[param(default = "clock", reopen)]
    pub stamps: Stamps,
}

/// Writers; each is created when its input has its first packet.
#[derive(Default)]
struct Writers {
    views: [Option<TopicWriter>; 2],
    compressed: [Option<TopicWriter>; 2],
    infos: [Option<TopicWriter>; 2],
    depth: Option<TopicWriter>,
    disparity: Option<TopicWriter>,
    cloud: Option<TopicWriter>,
    detections: Option<TopicWriter>,
    pose: Option<TopicWriter>,
    joints: Option<TopicWriter>,
}

/// The `ros2_publish` node.
pub struct Publish {
    member: Member,
    writers: Writers,
    namespace: String,
    quality: Quality,
    pictures: Pictures,
    stamps: Stamps,
    /// Offset from capture times to stamps, ns.
    offset_ns: Option<i64>,
}

fn pixels_of<'a>(image: &AnyImage<'a>) -> Option<Pixels<'a>> {
    let eight = image.as_plane::<Bgr8>().map(|plane| Pixels::Bgr8(plane.view()));
    let eight = eight.or_else(|| image.as_plane::<Gray8>().map(|plane| Pixels::Gray8(plane.view())));
    let eight = eight.or_else(|| image.as_plane::<Rgba8>().map(|plane| Pixels::Rgba8(plane.view())));
    let any = eight.or_else(|| image.as_plane::<Gray16>().map(|plane| Pixels::Gray16(plane.view())));
    any.or_else(|| image.as_plane::<GrayF32>().map(|plane| Pixels::F32(plane.view())))
}

fn wrong(error: impl std::fmt::Display) -> NodeError {
    NodeError::new(error.to_string())
}

/// The writer in this field, created on first use.
fn made<'w, M: panoscope_ros::cdr::Message>(
    place: &'w mut Option<TopicWriter>,
    (member, namespace, quality): (&Member, &str, Quality),
    topic: &str,
) -> std::result::Result<&'w TopicWriter, DdsError> {
    match place {
        Some(writer) => Ok(writer),
        None => Ok(place.insert(member.writer::<M>(&format!("{namespace}/{topic}"), quality)?)),
    }
}

impl Node for Publish {
    const INFO: NodeInfo = NodeInfo::blocking(
        "ros2_publish",
        "ros2",
        "Publishes images, cameras, depth, disparity, points, boxes, poses and joints as topics of ROS 2.",
    )
    .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        if names::sanitized(&params.namespace) != params.namespace.trim_start_matches('/') {
            let fixed = format!("write \"/{}\"", names::sanitized(&params.namespace));
            let words = format!(
                "`{}` is not a valid ROS name: use letters, digits and `_`, separated by `/`",
                params.namespace
            );
            check.error("namespace", words, &fixed);
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let member = Member::join(params.domain.min(MAX_DOMAIN), params.networks).map_err(wrong)?;
        if params.networks == Networks::All {
            open.warn("other machines can reach this domain and read the topics");
        }
        let name = names::sanitized(&params.namespace);
        let namespace = if name.is_empty() { String::new() } else { format!("/{name}") };
        let quality = Quality { is_reliable: params.reliable, depth: params.queue };
        let (pictures, stamps) = (params.pictures, params.stamps);
        Ok(Self { member, writers: Writers::default(), namespace, quality, pictures, stamps, offset_ns: None })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, _: &Settings) -> Result<()> {
        let capture_ns = cx.tick().capture_ns;
        let stamp_ns = capture_ns.saturating_add(self.offset(capture_ns));
        let at = (&self.member, self.namespace.as_str(), self.quality);
        let writers = &mut self.writers;
        for (view, (image, (side, frame))) in
            [&input.left, &input.right].into_iter().zip([("left", names::LEFT), ("right", names::RIGHT)]).enumerate()
        {
            let Some(pixels) = image.as_ref().and_then(pixels_of) else { continue };
            let is_deep = matches!(pixels, Pixels::Gray16(_) | Pixels::F32(_));
            if self.pictures != Pictures::Jpeg || is_deep {
                let topic = format!("{side}/image_raw");
                let writer = made::<messages::Image<'_>>(&mut writers.views[view], at, &topic).map_err(wrong)?;
                let message = convert::image_message(&pixels, 1.0, convert::header(stamp_ns, frame));
                writer.send(&message).map_err(wrong)?;
            }
            if self.pictures != Pictures::Raw && !is_deep {
                let (topic, place) = (format!("{side}/image_raw/compressed"), &mut writers.compressed[view]);
                let writer = made::<messages::CompressedImage<'_>>(place, at, &topic).map_err(wrong)?;
                let message = convert::jpeg_message(&pixels, convert::header(stamp_ns, frame)).map_err(wrong)?;
                writer.send(&message).map_err(wrong)?;
            }
        }
        if let Some(calibration) = &input.calibration {
            let infos = convert::camera_infos(calibration, stamp_ns);
            for ((info, place), side) in infos.iter().zip(&mut writers.infos).zip(["left", "right"]) {
                let topic = format!("{side}/camera_info");
                made::<messages::CameraInfo>(place, at, &topic).and_then(|writer| writer.send(info)).map_err(wrong)?;
            }
        }
        let rectified = || convert::header(stamp_ns, names::LEFT_RECTIFIED);
        if let Some(depth) = &input.depth {
            let message = convert::image_message(&Pixels::F32(depth.view()), 1e-3, rectified());
            let writer = made::<messages::Image<'_>>(&mut writers.depth, at, "depth/image").map_err(wrong)?;
            writer.send(&message).map_err(wrong)?;
        }
        if let Some(disparity) = &input.disparity {
            let calibration = input.calibration.as_deref();
            let message = convert::disparity_message(&disparity.view(), calibration, rectified());
            let place = &mut writers.disparity;
            let writer = made::<messages::DisparityImage<'_>>(place, at, "disparity").map_err(wrong)?;
            writer.send(&message).map_err(wrong)?;
        }
        if let Some(cloud) = &input.cloud {
            let message = convert::points_message(cloud.points().iter().copied(), cloud.width(), rectified());
            let writer = made::<messages::PointCloud2<'_>>(&mut writers.cloud, at, "points").map_err(wrong)?;
            writer.send(&message).map_err(wrong)?;
        }
        if let Some(detections) = &input.detections {
            let boxes = detections.items().iter().map(|item| (*item, detections.label(item.class_index)));
            let message = convert::detections_message(boxes, convert::header(stamp_ns, names::LEFT));
            let place = &mut writers.detections;
            let writer = made::<messages::Detection2DArray>(place, at, "detections").map_err(wrong)?;
            writer.send(&message).map_err(wrong)?;
        }
        if let Some(pose) = &input.pose {
            let writer = made::<messages::PoseStamped>(&mut writers.pose, at, "pose").map_err(wrong)?;
            writer.send(&convert::pose_message(pose, stamp_ns)).map_err(wrong)?;
        }
        if let Some(joints) = &input.joints {
            let writer = made::<messages::JointState>(&mut writers.joints, at, "joint_states").map_err(wrong)?;
            writer.send(&convert::joint_message(joints, stamp_ns)).map_err(wrong)?;
        }
        Ok(())
    }
}

impl Publish {
    /// Offset from capture times to stamps, ns. The clock is read once: intervals are those of capture times, and nothing in the graph depends on the
    /// clock.
    fn offset(&mut self, capture_ns: i64) -> i64 {
        match self.stamps {
            Stamps::Capture => 0,
            Stamps::Clock => *self.offset_ns.get_or_insert_with(|| {
                let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos());
                i64::try_from(now).unwrap_or(0).saturating_sub(capture_ns)
            }),
        }
    }
}
