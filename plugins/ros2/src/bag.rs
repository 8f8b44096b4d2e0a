//! `ros2_bag`: plays a bag of ROS 2.

use std::path::PathBuf;

use panoscope_node::{Context, NoPorts, Node, NodeError, NodeInfo, Open, Params, Result, Validation};
use panoscope_ros::bag::{BagError, BagReader, BagTopic, RawMessage, survey};
use panoscope_ros::cdr::{CdrError, Message};
use panoscope_ros::messages;

pub use crate::incoming::Out;
use crate::incoming::{Arrived, Incoming, IncomingError, Ready, Role, info_topic};

/// Parameters of `ros2_bag`.
#[derive(Params)]
pub struct Settings {
    /// Folder of a bag with MCAP files, or one MCAP file.
    #[param(default = "", reopen, file)]
    pub path: String,
    /// Topic of the left view. Empty: the first image topic with `left` in its name, or the only one there is.
    #[param(default = "", reopen)]
    pub left: String,
    /// Topic of the right view. Empty: the first image topic with `right` in its name.
    #[param(default = "", reopen)]
    pub right: String,
    /// Topic of depth. Empty: the first image topic with `depth` in its name.
    #[param(default = "", reopen)]
    pub depth: String,
    /// Topic of disparity. Empty: the first one.
    #[param(default = "", reopen)]
    pub disparity: String,
    /// Topic of points. Empty: the first one.
    #[param(default = "", reopen)]
    pub cloud: String,
    /// Topic of boxes. Empty: the first one.
    #[param(default = "", reopen)]
    pub detections: String,
    /// Topic of poses. Empty: the first one.
    #[param(default = "", reopen)]
    pub pose: String,
    /// Topic of joints. Empty: the first one.
    #[param(default = "", reopen)]
    pub joints: String,
    /// Maximum difference of the stamps of two views of a pair.
    #[param(default = 5.0, range = 0.0..=1000.0, unit = "ms", reopen)]
    pub tolerance_ms: f64,
    /// Bit depth of images with more than eight bits: 12 makes 4095 white. 0 finds it from the values and logs it.
    #[param(default = 0, range = 0..=16, reopen)]
    pub bit_depth: u32,
}

/// The topics to read, from the named ones and those that the bag has.
fn roles(params: &Settings, topics: &[BagTopic]) -> Result<Vec<(String, Role)>> {
    let is_picture = |message: &str| [messages::Image::TYPE, messages::CompressedImage::TYPE].contains(&message);
    let pictures: Vec<&BagTopic> = topics.iter().filter(|topic| is_picture(&topic.message)).collect();
    let with = |word: &str| {
        let mut named = pictures.iter().filter(|topic| topic.topic.contains(word) && !topic.topic.contains("depth"));
        named.next().map(|topic| topic.topic.clone())
    };
    let of = |message: &str| topics.iter().find(|topic| topic.message == message).map(|topic| topic.topic.clone());
    let given = |topic: &str| (!topic.trim().is_empty()).then(|| topic.trim().to_owned());
    let known = |topic: &String| topics.iter().any(|known| known.topic == *topic);
    let left = given(&params.left).or_else(|| with("left")).or_else(|| match pictures[..] {
        [only] if !only.topic.contains("right") => Some(only.topic.clone()),
        _ => None,
    });
    let right = given(&params.right).or_else(|| with("right"));
    let depth = given(&params.depth).or_else(|| {
        let mut deep = topics.iter().filter(|topic| topic.message == messages::Image::TYPE);
        deep.find(|topic| topic.topic.contains("depth")).map(|topic| topic.topic.clone())
    });
    let chosen = [
        (left, Role::View(0)),
        (right, Role::View(1)),
        (depth, Role::Depth),
        (given(&params.disparity).or_else(|| of(messages::DisparityImage::TYPE)), Role::Disparity),
        (given(&params.cloud).or_else(|| of(messages::PointCloud2::TYPE)), Role::Cloud),
        (given(&params.detections).or_else(|| of(messages::Detection2DArray::TYPE)), Role::Detections),
        (given(&params.pose).or_else(|| of(messages::PoseStamped::TYPE)), Role::Pose),
        (given(&params.joints).or_else(|| of(messages::JointState::TYPE)), Role::Joints),
    ];
    let mut roles: Vec<(String, Role)> = chosen.into_iter().filter_map(|(topic, role)| Some((topic?, role))).collect();
    if let Some((missing, _)) = roles.iter().find(|(topic, _)| !known(topic)) {
        let all = topics.iter().map(|topic| topic.topic.as_str()).take(20).collect::<Vec<_>>().join(", ");
        return Err(NodeError::new(format!("the bag has no topic `{missing}`; it has {all}")));
    }
    if roles.is_empty() {
        return Err(NodeError::new("the bag has no topic of a supported type"));
    }
    let views = roles.iter().filter_map(|(topic, role)| match role {
        Role::View(view) => Some((info_topic(topic)?, Role::Info(*view))),
        _ => None,
    });
    let infos: Vec<(String, Role)> = views.filter(|(topic, _)| known(topic)).collect();
    roles.extend(infos);
    Ok(roles)
}

/// The `ros2_bag` node.
pub struct Bag {
    path: PathBuf,
    reader: BagReader,
    incoming: Incoming,
    /// Number of ticks so far; a replacement continues there.
    ticks: u64,
    /// Number of ticks that the predecessor made.
    skip: u64,
    /// Number of messages that could not be read.
    left_out: u64,
    /// Error of the last such message.
    last_error: Option<NodeError>,
    /// The first damaged message.
    damage: Option<String>,
}

/// Makes the error lasting: another attempt would read the same bytes.
fn wrong(error: BagError) -> NodeError {
    NodeError::lasting(error.to_string())
}

impl Bag {
    /// Takes a message and returns what it completes.
    ///
    /// # Errors
    /// The message cannot be read; reading can continue with the next one.
    fn take(&mut self, message: &RawMessage, out: &Out<'_>) -> Result<Option<(i64, Ready)>> {
        let named = |words: String| NodeError::lasting(format!("{}: {words}", self.path.display()));
        let RawMessage { topic, message, log_ns, data } = message;
        let (head, body) = data.split_first_chunk::<4>().ok_or_else(|| named(short(topic)))?;
        let encoding = u16::from_be_bytes([head[0], head[1]]);
        let arrived = Arrived { topic, message, log_ns: *log_ns, encoding, body };
        self.incoming.take(arrived, out).map_err(|error| {
            let words = named(error.to_string());
            if matches!(error, IncomingError::Bytes { .. }) {
                self.damage.get_or_insert_with(|| words.message().to_owned());
            }
            words
        })
    }

    /// Ends the source and reports what was not played.
    ///
    /// # Errors
    /// Nothing could be read, or, in batch mode, a message is damaged or most images have no partner.
    fn end(&mut self, cx: &Context<'_>, params: &Settings) -> Result<()> {
        if self.ticks == 0
            && let Some(error) = self.last_error.take()
        {
            return Err(error);
        }
        if let Some(damage) = self.damage.take().filter(|_| cx.is_batch()) {
            return Err(NodeError::ended_early(format!("{damage}; all undamaged messages were played")));
        }
        let alone = self.incoming.without_partner();
        if alone > 0 {
            let (all, tolerance) = (alone + self.incoming.paired, params.tolerance_ms);
            let words = format!(
                "{alone} of {all} images of the two views have no partner within {tolerance} ms (`tolerance_ms`) and were left out"
            );
            if cx.is_batch() && alone > self.incoming.paired {
                return Err(NodeError::ended_early(words));
            }
            cx.warn(&words);
        }
        cx.end();
        Ok(())
    }
}

impl Node for Bag {
    const INFO: NodeInfo = NodeInfo::blocking(
        "ros2_bag",
        "ros2",
        "Plays a bag of ROS 2: images in pairs with their cameras, depth, disparity, points, boxes, poses, joints.",
    )
    .source();
    type In<'f> = NoPorts;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        if params.path.trim().is_empty() {
            return check.error(
                "path",
                "`path` is empty: no bag is given",
                "give its folder, as in path = \"/data/run1\"",
            );
        }
        let path = check.graph_dir().join(params.path.trim());
        let topics = match survey(&path) {
            Ok(topics) => topics,
            Err(error) => return check.error("path", error.to_string(), ""),
        };
        if let Err(error) = roles(params, &topics) {
            check.error("path", error.to_string(), "name topics, as in left = \"/camera/left/image_raw\"");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        if params.path.trim().is_empty() {
            return Err(NodeError::new("`path` is empty: give the folder of a bag"));
        }
        let path = open.graph_dir().join(params.path.trim());
        let reader = BagReader::open(&path).map_err(wrong)?;
        let topics = reader.survey().map_err(wrong)?;
        let incoming = Incoming::new(roles(params, &topics)?, params.tolerance_ms, params.bit_depth);
        let mut read: Vec<&str> = incoming.roles().map(|(topic, _)| topic).collect();
        read.sort_unstable();
        open.info(&format!("reads {}", read.join(", ")));
        Ok(Self { path, reader, incoming, ticks: 0, skip: 0, left_out: 0, last_error: None, damage: None })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, params: &Settings) -> Result<()> {
        loop {
            let next = self.reader.next(|topic, message| self.incoming.wants(topic, message));
            let message = match next {
                Ok(Some(message)) => message,
                Ok(None) => return self.end(cx, params),
                Err(error @ BagError::CutOff { .. }) => {
                    cx.warn(&format!("{error}; the messages before it were played"));
                    return self.end(cx, params);
                }
                Err(error) => return Err(wrong(error)),
            };
            let ready = self.take(&message, &out);
            self.incoming.report(cx);
            match ready {
                Ok(None) => {}
                Ok(Some((stamp_ns, ready))) => {
                    self.ticks += 1;
                    if self.ticks <= self.skip {
                        continue;
                    }
                    self.incoming.set_time(cx, stamp_ns);
                    cx.metric("unpaired", self.incoming.unpaired as f64);
                    return self.incoming.write(cx, ready, &mut out);
                }
                Err(error) => {
                    self.left_out += 1;
                    cx.metric("left_out", self.left_out as f64);
                    // A bag of damaged messages does not fill the log.
                    if self.left_out.is_power_of_two() {
                        let message = if self.left_out == 1 { "message was" } else { "messages were" };
                        cx.warn(&format!("{error}; {} {message} left out so far", self.left_out));
                    }
                    self.last_error = Some(error);
                }
            }
        }
    }

    fn save_state(&self) -> Option<Vec<u8>> {
        Some(self.ticks.to_le_bytes().to_vec())
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        let ticks = state.try_into().map(u64::from_le_bytes);
        self.skip = ticks.map_err(|_| NodeError::new("the saved state belongs to another node"))?;
        Ok(())
    }
}

fn short(topic: &str) -> String {
    format!("`{topic}`: {}", CdrError::Short { len: 0 })
}
