//! `ros2_subscribe`: receives topics of ROS 2.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use panoscope_node::{Context, NoPorts, Node, NodeError, NodeInfo, Open, Params, Result, Validation};

use crate::Networks;
use crate::dds::{Encoded, MAX_DOMAIN, Member, Quality, TopicReader};
pub use crate::incoming::Out;
use crate::incoming::{Arrived, Incoming, Role, info_topic};

/// Polling interval of the readers.
const STEP: Duration = Duration::from_millis(2);
/// Maximum wait of one call; a tick without data follows.
const MAX_WAIT: Duration = Duration::from_millis(200);

/// Parameters of `ros2_subscribe`.
#[derive(Params)]
pub struct Settings {
    /// Topic of the left view, such as /camera/left/image_raw, or of the only one. A topic that ends with /compressed has JPEG or PNG. Its camera is
    /// read from camera_info in the same namespace.
    #[param(default = "", reopen)]
    pub left: String,
    /// Topic of the right view.
    #[param(default = "", reopen)]
    pub right: String,
    /// Topic of depth: 32FC1 in m, 16UC1 in mm.
    #[param(default = "", reopen)]
    pub depth: String,
    /// Topic of a DisparityImage.
    #[param(default = "", reopen)]
    pub disparity: String,
    /// Topic of a PointCloud2.
    #[param(default = "", reopen)]
    pub cloud: String,
    /// Topic of a Detection2DArray.
    #[param(default = "", reopen)]
    pub detections: String,
    /// Topic of a PoseStamped.
    #[param(default = "", reopen)]
    pub pose: String,
    /// Topic of a JointState.
    #[param(default = "", reopen)]
    pub joints: String,
    /// Maximum difference of the stamps of two views of a pair.
    #[param(default = 5.0, range = 0.0..=1000.0, unit = "ms", reopen)]
    pub tolerance_ms: f64,
    /// Bit depth of images with more than eight bits: 12 makes 4095 white. 0 finds it from the values and logs it.
    #[param(default = 0, range = 0..=16, reopen)]
    pub bit_depth: u32,
    /// DDS domain, the ROS_DOMAIN_ID of other programs.
    #[param(default = 0, range = 0..=232, reopen)]
    pub domain: u16,
    /// Which machines can be reached.
    #[param(default = "loopback", reopen)]
    pub networks: Networks,
    /// Requests lost messages again; publishers of best effort do not match then.
    #[param(default = false, reopen)]
    pub reliable: bool,
    /// Maximum number of waiting messages per topic.
    #[param(default = 5, range = 1..=100, reopen)]
    pub queue: u16,
}

impl Settings {
    fn roles(&self) -> Vec<(String, Role)> {
        let topics = [
            (&self.left, Role::View(0)),
            (&self.right, Role::View(1)),
            (&self.depth, Role::Depth),
            (&self.disparity, Role::Disparity),
            (&self.cloud, Role::Cloud),
            (&self.detections, Role::Detections),
            (&self.pose, Role::Pose),
            (&self.joints, Role::Joints),
        ];
        let named = topics.into_iter().filter(|(topic, _)| !topic.trim().is_empty());
        let mut roles: Vec<(String, Role)> = named.map(|(topic, role)| (absolute(topic), role)).collect();
        let infos = [(&self.left, 0), (&self.right, 1)].into_iter();
        roles.extend(infos.filter_map(|(topic, view)| Some((info_topic(&absolute(topic))?, Role::Info(view)))));
        roles
    }
}

/// The topic with a leading slash.
fn absolute(topic: &str) -> String {
    let topic = topic.trim();
    if topic.is_empty() || topic.starts_with('/') { topic.to_owned() } else { format!("/{topic}") }
}

/// The `ros2_subscribe` node.
pub struct Subscribe {
    readers: Vec<(String, &'static str, TopicReader)>,
    incoming: Incoming,
    /// Reader that is polled first, in turn, so that no topic starves another.
    first: usize,
    left_out: u64,
    // Readers belong to it.
    _member: Member,
}

impl Node for Subscribe {
    const INFO: NodeInfo = NodeInfo::blocking(
        "ros2_subscribe",
        "ros2",
        "Receives images, cameras, depth, disparity, points, boxes, poses and joints from topics of ROS 2.",
    )
    .source();
    type In<'f> = NoPorts;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        if params.roles().is_empty() {
            check.error("left", "no topic is named", "name one, as in left = \"/camera/left/image_raw\"");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let roles = params.roles();
        if roles.is_empty() {
            return Err(NodeError::new("no topic is named: name one, as in left = \"/camera/left/image_raw\""));
        }
        let wrong = |error: crate::dds::DdsError| NodeError::new(error.to_string());
        let member = Member::join(params.domain.min(MAX_DOMAIN), params.networks).map_err(wrong)?;
        if params.networks == Networks::All {
            open.warn("other machines can reach this domain and send to these topics");
        }
        let quality = Quality { is_reliable: params.reliable, depth: params.queue };
        let incoming = Incoming::new(roles, params.tolerance_ms, params.bit_depth);
        let mut readers = Vec::new();
        for (topic, role) in incoming.roles() {
            let message = role.message(topic);
            readers.push((topic.to_owned(), message, member.reader(topic, message, quality).map_err(wrong)?));
        }
        Ok(Self { readers, incoming, first: 0, left_out: 0, _member: member })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, _: &Settings) -> Result<()> {
        let until = Instant::now() + MAX_WAIT;
        loop {
            for offset in 0..self.readers.len() {
                let index = (self.first + offset) % self.readers.len();
                let (topic, message, reader) = &mut self.readers[index];
                let sample = match reader.take_next_sample() {
                    Ok(Some(sample)) => sample,
                    Ok(None) => continue,
                    Err(error) => return Err(NodeError::new(format!("`{topic}`: {error}"))),
                };
                let Encoded { number, body } = sample.into_value();
                let log_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i64);
                let arrived = Arrived { topic, message, log_ns, encoding: number, body: &body };
                let ready = self.incoming.take(arrived, &out);
                self.incoming.report(cx);
                match ready {
                    Ok(None) => {}
                    Ok(Some((stamp_ns, ready))) => {
                        self.first = index + 1;
                        if let Some(now_ns) = cx.clock_ns() {
                            cx.set_arrived_ns(now_ns);
                        }
                        self.incoming.set_time(cx, stamp_ns);
                        cx.metric("unpaired", self.incoming.unpaired as f64);
                        return self.incoming.write(cx, ready, &mut out);
                    }
                    Err(error) => {
                        self.left_out += 1;
                        // A publisher that sends damaged messages does not fill the log.
                        if self.left_out.is_power_of_two() {
                            cx.warn(&format!("{error}; {} messages were left out so far", self.left_out));
                        }
                    }
                }
            }
            if Instant::now() >= until {
                self.incoming.set_empty_time(cx);
                return Ok(());
            }
            std::thread::sleep(STEP);
        }
    }
}
