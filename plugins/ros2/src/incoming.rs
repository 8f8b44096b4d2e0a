//! Converts messages to outputs, for bags and topics alike.

use std::collections::{HashMap, VecDeque};

use panoscope_data::bit_depth::{Deep, Remark, White};
use panoscope_data::calibration::ros as camera;
use panoscope_node::abi::{Calibration, CloudPoint, Joints, Pose};
use panoscope_node::{Bgr8, Context, Depth, Disparity, LabeledDetections, NodeError, PointCloud, Ports, Result, Slot};
use panoscope_ros::cdr::{self, CdrError, Message};
use panoscope_ros::convert::{self, Boxes, ConvertError, Picture, Samples};
use panoscope_ros::messages;

use crate::times::Times;

/// Maximum number of images of a view that wait for their partner.
const MAX_WAITING: usize = 8;

/// Outputs. A tick contains what belongs together: both views of one instant, or one message of another topic.
#[derive(Ports)]
pub struct Out<'f> {
    /// Left view, or the only one.
    pub left: Slot<'f, Bgr8>,
    /// Right view of the same instant.
    pub right: Slot<'f, Bgr8>,
    /// Both cameras, with every image, once both camera_info topics had a message.
    pub calibration: Slot<'f, Calibration>,
    /// Depth of the left rectified view, mm; NaN where unknown.
    pub depth: Slot<'f, Depth>,
    /// Disparity of the left rectified view, px; NaN where unknown.
    pub disparity: Slot<'f, Disparity>,
    /// Points, mm, in the frame of the message.
    pub cloud: Slot<'f, PointCloud>,
    /// Detected boxes.
    pub detections: Slot<'f, LabeledDetections>,
    /// A pose, mm.
    pub pose: Slot<'f, Pose>,
    /// Joints of an arm.
    pub joints: Slot<'f, Joints>,
}

/// Output that the messages of a topic become.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// Image of view 0 or 1.
    View(usize),
    /// Camera of view 0 or 1.
    Info(usize),
    /// Output `depth`.
    Depth,
    /// Output `disparity`.
    Disparity,
    /// Output `cloud`.
    Cloud,
    /// Output `detections`.
    Detections,
    /// Output `pose`.
    Pose,
    /// Output `joints`.
    Joints,
}

impl Role {
    /// Type of the messages on a topic with this role.
    pub fn message(self, topic: &str) -> &'static str {
        match self {
            Self::View(_) if topic.ends_with("/compressed") => messages::CompressedImage::TYPE,
            Self::View(_) | Self::Depth => messages::Image::TYPE,
            Self::Info(_) => messages::CameraInfo::TYPE,
            Self::Disparity => messages::DisparityImage::TYPE,
            Self::Cloud => messages::PointCloud2::TYPE,
            Self::Detections => messages::Detection2DArray::TYPE,
            Self::Pose => messages::PoseStamped::TYPE,
            Self::Joints => messages::JointState::TYPE,
        }
    }
}

impl Role {
    /// Whether the output of this role is read.
    fn is_read(self, out: &Out<'_>) -> bool {
        match self {
            // A view is also the partner of the other one.
            Self::View(_) => out.left.is_read() || out.right.is_read() || out.calibration.is_read(),
            Self::Info(_) => out.calibration.is_read(),
            Self::Depth => out.depth.is_read(),
            Self::Disparity => out.disparity.is_read(),
            Self::Cloud => out.cloud.is_read(),
            Self::Detections => out.detections.is_read(),
            Self::Pose => out.pose.is_read(),
            Self::Joints => out.joints.is_read(),
        }
    }
}

/// Topic of the camera of an image topic: camera_info in the same namespace.
pub fn info_topic(picture: &str) -> Option<String> {
    let plain = picture.strip_suffix("/compressed").unwrap_or(picture);
    plain.rsplit_once('/').map(|(namespace, _)| format!("{namespace}/camera_info"))
}

/// Data of a completed tick.
pub enum Ready {
    /// Both views, or one.
    Views(Vec<Picture>),
    /// Width, height, mm.
    Depth(usize, usize, Vec<f32>),
    /// Width, height, px.
    Disparity(usize, usize, Vec<f32>),
    /// Width, height, points.
    Cloud(usize, usize, Vec<CloudPoint>),
    /// Boxes.
    Detections(Boxes),
    /// A pose.
    Pose(Pose),
    /// Joints.
    Joints(Joints),
}

/// A message as received.
#[derive(Clone, Copy, Debug)]
pub struct Arrived<'m> {
    /// Name of the topic.
    pub topic: &'m str,
    /// Type of the message.
    pub message: &'m str,
    /// When it was recorded or received, ns.
    pub log_ns: i64,
    /// Identifier of its encoding.
    pub encoding: u16,
    /// Its encoded fields.
    pub body: &'m [u8],
}

impl<'m> Arrived<'m> {
    fn decode<M: Message + serde::Deserialize<'m>>(&self) -> std::result::Result<M, IncomingError> {
        let damaged = |cause| IncomingError::Bytes { topic: self.topic.to_owned(), cause };
        cdr::decode_body(self.encoding, self.body).map_err(damaged)
    }
}

/// Why a message was left out.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum IncomingError {
    /// The bytes are malformed.
    #[error("`{topic}`: {cause}")]
    Bytes { topic: String, cause: CdrError },
    /// The message cannot be converted to a packet.
    #[error("`{topic}`: {cause}")]
    Value { topic: String, cause: ConvertError },
}

/// Collects messages until a tick is complete.
pub struct Incoming {
    roles: HashMap<String, Role>,
    is_pair: bool,
    tolerance_ns: i64,
    waiting: [VecDeque<(i64, Picture)>; 2],
    infos: [Option<camera::CameraInfo>; 2],
    calibration: Option<Calibration>,
    /// Why there is no calibration; reported once.
    calibration_problem: Option<String>,
    /// Number of images without a partner.
    pub unpaired: u64,
    /// Number of images with a partner.
    pub paired: u64,
    times: Times,
    white: White,
    bit_depth: u32,
    /// Warnings that wait for the next report.
    remarks: Vec<String>,
    last_ns: Option<i64>,
}

impl Incoming {
    /// Reads topics with these roles. Views that are further apart than the tolerance are not paired. `bit_depth` applies to images of more than
    /// eight bits; 0 finds it from the values.
    pub fn new(roles: impl IntoIterator<Item = (String, Role)>, tolerance_ms: f64, bit_depth: u32) -> Self {
        let roles: HashMap<String, Role> = roles.into_iter().filter(|(topic, _)| !topic.is_empty()).collect();
        let is_pair = [0, 1].iter().all(|view| roles.values().any(|role| *role == Role::View(*view)));
        Self {
            roles,
            is_pair,
            tolerance_ns: (tolerance_ms * 1e6) as i64,
            waiting: Default::default(),
            infos: [None; 2],
            calibration: None,
            calibration_problem: None,
            unpaired: 0,
            paired: 0,
            times: Times::default(),
            white: White::default(),
            bit_depth,
            remarks: Vec::new(),
            last_ns: None,
        }
    }

    /// The topics with their roles.
    pub fn roles(&self) -> impl Iterator<Item = (&str, Role)> {
        self.roles.iter().map(|(topic, role)| (topic.as_str(), *role))
    }

    /// Whether messages of this topic and type are read.
    pub fn wants(&self, topic: &str, message: &str) -> bool {
        self.roles.get(topic).is_some_and(|role| {
            let is_picture = [messages::Image::TYPE, messages::CompressedImage::TYPE].contains(&message);
            role.message(topic) == message || matches!(role, Role::View(_)) && is_picture
        })
    }

    /// Takes a message whose outputs are read. Returns the time of its data and what is complete now.
    ///
    /// # Errors
    /// The message is damaged or of an unsupported encoding; earlier data are kept.
    pub fn take(
        &mut self,
        arrived: Arrived<'_>,
        out: &Out<'_>,
    ) -> std::result::Result<Option<(i64, Ready)>, IncomingError> {
        let Some(role) = self.roles.get(arrived.topic).copied().filter(|role| role.is_read(out)) else {
            return Ok(None);
        };
        let value = |cause| IncomingError::Value { topic: arrived.topic.to_owned(), cause };
        let (stamp, ready) = match role {
            Role::View(view) => {
                let (stamp, picture) = if arrived.message == messages::CompressedImage::TYPE {
                    let found: messages::CompressedImage<'_> = arrived.decode()?;
                    (found.header.stamp, convert::compressed(&found).map_err(value)?)
                } else {
                    let found: messages::Image<'_> = arrived.decode()?;
                    (found.header.stamp, convert::picture(&found).map_err(value)?)
                };
                let stamp_ns = self.time(&arrived, stamp);
                return Ok(self.view(view, stamp_ns, picture));
            }
            Role::Info(view) => {
                self.camera(view, convert::camera_info(&arrived.decode()?));
                return Ok(None);
            }
            Role::Depth => {
                let found: messages::Image<'_> = arrived.decode()?;
                let (width, height, mm) = convert::depth_mm(&found).map_err(value)?;
                (found.header.stamp, Ready::Depth(width, height, mm))
            }
            Role::Disparity => {
                let found: messages::DisparityImage<'_> = arrived.decode()?;
                let (width, height, px) = convert::disparity(&found).map_err(value)?;
                (found.header.stamp, Ready::Disparity(width, height, px))
            }
            Role::Cloud => {
                let found: messages::PointCloud2<'_> = arrived.decode()?;
                let (width, height, points) = convert::cloud(&found).map_err(value)?;
                (found.header.stamp, Ready::Cloud(width, height, points))
            }
            Role::Detections => {
                let found: messages::Detection2DArray = arrived.decode()?;
                (found.header.stamp, Ready::Detections(convert::boxes(&found).map_err(value)?))
            }
            Role::Pose => {
                let found: messages::PoseStamped = arrived.decode()?;
                let child = arrived.topic.rsplit('/').next().unwrap_or("");
                (found.header.stamp, Ready::Pose(convert::pose(&found, child)))
            }
            Role::Joints => {
                let found: messages::JointState = arrived.decode()?;
                (found.header.stamp, Ready::Joints(convert::joints(&found).map_err(value)?))
            }
        };
        Ok(Some((self.time(&arrived, stamp), ready)))
    }

    /// Time of a message's data, ns.
    fn time(&mut self, arrived: &Arrived<'_>, stamp: messages::Time) -> i64 {
        let (time_ns, remark) = self.times.of(arrived.topic, stamp.ns(), arrived.log_ns);
        self.remarks.extend(remark);
        time_ns
    }

    /// Takes the camera of a view. A camera that cannot be used disables the calibration, not the images.
    fn camera(&mut self, view: usize, info: std::result::Result<camera::CameraInfo, ConvertError>) {
        match info {
            Ok(info) if self.infos[view] == Some(info) => {}
            Ok(info) => {
                self.infos[view] = Some(info);
                self.calibrate();
            }
            Err(error) => {
                self.infos[view] = None;
                self.no_calibration(format!("the camera of the {} view: {error}", ["left", "right"][view]));
            }
        }
    }

    /// Pairs an image with the nearest one of the other view.
    fn view(&mut self, view: usize, stamp_ns: i64, picture: Picture) -> Option<(i64, Ready)> {
        if !self.is_pair {
            return Some((stamp_ns, Ready::Views(vec![picture])));
        }
        let nearest = self.waiting[1 - view]
            .iter()
            .enumerate()
            .map(|(index, (other_ns, _))| (index, other_ns.saturating_sub(stamp_ns).saturating_abs()))
            .min_by_key(|(_, apart_ns)| *apart_ns)
            .filter(|(_, apart_ns)| *apart_ns <= self.tolerance_ns);
        let Some((index, _)) = nearest else {
            let own = &mut self.waiting[view];
            own.push_back((stamp_ns, picture));
            if own.len() > MAX_WAITING {
                own.pop_front();
                self.unpaired += 1;
            }
            return None;
        };
        // What is older than the pair has no partner any more.
        self.unpaired += index as u64 + self.waiting[view].len() as u64;
        self.waiting[view].clear();
        self.paired += 2;
        let (other_ns, other) = self.waiting[1 - view].drain(..=index).next_back()?;
        let views = if view == 0 { vec![picture, other] } else { vec![other, picture] };
        // The left picture's time is that of the pair.
        Some((if view == 0 { stamp_ns } else { other_ns }, Ready::Views(views)))
    }

    fn calibrate(&mut self) {
        let [Some(left), Some(right)] = &self.infos else { return };
        match camera::calibration(left, right) {
            Ok(calibration) => self.calibration = Some(calibration),
            Err(error) => self.no_calibration(error.to_string()),
        }
    }

    fn no_calibration(&mut self, problem: String) {
        self.calibration = None;
        if self.calibration_problem.as_ref() != Some(&problem) {
            self.remarks.push(format!("no calibration: {problem}"));
            self.calibration_problem = Some(problem);
        }
    }

    /// Number of images of both views without a partner, including those that still wait.
    pub fn without_partner(&self) -> u64 {
        self.unpaired + self.waiting.iter().map(|waiting| waiting.len() as u64).sum::<u64>()
    }

    /// Sets the time of a tick. A time that does not increase becomes the next nanosecond, because ticks of a source follow each other.
    pub fn set_time(&mut self, cx: &Context<'_>, stamp_ns: i64) {
        let capture_ns = self.last_ns.map_or(stamp_ns, |last| stamp_ns.max(last.saturating_add(1)));
        self.last_ns = Some(capture_ns);
        cx.set_capture_ns(capture_ns);
    }

    /// Sets the time of a tick without data.
    pub fn set_empty_time(&mut self, cx: &Context<'_>) {
        let next = self.last_ns.map_or(0, |last| last.saturating_add(1));
        self.last_ns = Some(next);
        cx.set_capture_ns(next);
    }

    /// Logs the warnings since the last call.
    pub fn report(&mut self, cx: &Context<'_>) {
        self.remarks.drain(..).for_each(|remark| cx.warn(&remark));
    }

    /// White level of these views.
    fn white(&mut self, cx: &Context<'_>, views: &[Picture]) -> Result<f32> {
        let deep =
            views.iter().zip(["the left image", "the right image"]).filter_map(|(view, name)| match &view.samples {
                Samples::Gray16(pixels) => {
                    let peak = f32::from(pixels.iter().copied().max().unwrap_or(0));
                    Some(Deep { name, peak, is_float: false })
                }
                _ => None,
            });
        let found = self.white.of(self.bit_depth, deep, Vec::new);
        let (white, remark) = found.map_err(|error| NodeError::new(error.to_string()))?;
        match remark {
            Some(Remark::Info(words)) => cx.info(&words),
            Some(Remark::Warning(words)) => cx.warn(&words),
            None => {}
        }
        Ok(white)
    }

    /// Writes the outputs that are read.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub fn write(&mut self, cx: &Context<'_>, ready: Ready, out: &mut Out<'_>) -> Result<()> {
        match ready {
            Ready::Views(views) => {
                let white = self.white(cx, &views)?;
                for (slot, picture) in [&mut out.left, &mut out.right].into_iter().zip(views) {
                    if slot.is_read() {
                        write_picture(slot, &picture, white)?;
                    }
                }
                if let Some(calibration) = self.calibration.filter(|_| out.calibration.is_read()) {
                    out.calibration.set(calibration)?;
                }
                Ok(())
            }
            Ready::Depth(width, height, mm) => {
                if out.depth.is_read() {
                    out.depth.alloc(width, height)?.data.copy_from_slice(&mm);
                }
                Ok(())
            }
            Ready::Disparity(width, height, px) => {
                if out.disparity.is_read() {
                    out.disparity.alloc(width, height)?.data.copy_from_slice(&px);
                }
                Ok(())
            }
            Ready::Cloud(width, height, points) => {
                if out.cloud.is_read() && !points.is_empty() {
                    out.cloud.alloc_cloud(width, height)?.data.copy_from_slice(&points);
                }
                Ok(())
            }
            Ready::Detections(Boxes { items, labels }) => {
                if out.detections.is_read() {
                    out.detections.set_detections(&items, &labels.join("\n"), (0, 0))?;
                }
                Ok(())
            }
            Ready::Pose(pose) => {
                if out.pose.is_read() {
                    out.pose.set(pose)
                } else {
                    Ok(())
                }
            }
            Ready::Joints(joints) => {
                if out.joints.is_read() {
                    out.joints.set(joints)
                } else {
                    Ok(())
                }
            }
        }
    }
}

/// Writes an image as BGR; `white` is the value of 16 bits that becomes 255.
fn write_picture(slot: &mut Slot<'_, Bgr8>, picture: &Picture, white: f32) -> Result<()> {
    let gray = |out: &mut dyn Iterator<Item = u8>, to: &mut [u8]| {
        to.as_chunks_mut::<3>().0.iter_mut().zip(out).for_each(|(pixel, value)| *pixel = [value; 3]);
    };
    let out = slot.alloc(picture.width, picture.height)?;
    match &picture.samples {
        Samples::Bgr8(pixels) => out.data.copy_from_slice(pixels),
        Samples::Gray8(pixels) => gray(&mut pixels.iter().copied(), out.data),
        Samples::Gray16(pixels) => {
            // A cast of a float ends at 255.
            gray(&mut pixels.iter().map(|value| (f32::from(*value) * (255.0 / white) + 0.5) as u8), out.data);
        }
        Samples::F32(_) => {
            return Err(NodeError::new("an image of floats cannot be a view: set its topic as `depth`"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: u8) -> Picture {
        Picture { width: 1, height: 1, samples: Samples::Gray8(vec![value]) }
    }

    fn pair() -> Incoming {
        Incoming::new([("/l".to_owned(), Role::View(0)), ("/r".to_owned(), Role::View(1))], 5.0, 0)
    }

    #[test]
    fn views_of_one_instant_belong_together() {
        let mut incoming = pair();
        assert!(incoming.view(0, 0, picture(1)).is_none());
        assert!(incoming.view(0, 33_000_000, picture(2)).is_none());
        let Some((stamp, Ready::Views(views))) = incoming.view(1, 34_000_000, picture(3)) else { panic!("a pair") };
        assert_eq!((stamp, incoming.unpaired, incoming.paired), (33_000_000, 1, 2));
        assert_eq!(views, [picture(2), picture(3)]);
        assert!(incoming.view(1, 100_000_000, picture(4)).is_none());
        assert!(incoming.view(0, 106_000_000, picture(5)).is_none());
    }

    #[test]
    fn pictures_without_a_partner_do_not_pile_up() {
        let mut incoming = pair();
        for at in 0..100 {
            assert!(incoming.view(0, at * 33_000_000, picture(0)).is_none());
        }
        assert_eq!((incoming.waiting[0].len(), incoming.unpaired, incoming.without_partner()), (MAX_WAITING, 92, 100));
    }

    #[test]
    fn a_camera_stands_beside_its_picture() {
        assert_eq!(info_topic("/a/left/image_raw").as_deref(), Some("/a/left/camera_info"));
        assert_eq!(info_topic("/a/left/image_raw/compressed").as_deref(), Some("/a/left/camera_info"));
        assert_eq!(info_topic("image"), None);
    }

    #[test]
    fn types_that_fit_the_topic_are_wanted() {
        let incoming = pair();
        assert!(incoming.wants("/l", messages::CompressedImage::TYPE));
        assert!(!incoming.wants("/l", messages::PoseStamped::TYPE) && !incoming.wants("/other", messages::Image::TYPE));
    }

    #[test]
    fn a_camera_that_cannot_be_used_is_reported_once() {
        let mut incoming = pair();
        let unknown = || ConvertError::Camera(camera::CameraInfoError::Model { model: "fisheye_x".to_owned() });
        incoming.camera(1, Err(unknown()));
        incoming.camera(1, Err(unknown()));
        assert_eq!(incoming.remarks.len(), 1);
        assert!(incoming.remarks[0].contains("the camera of the right view") && incoming.calibration.is_none());
    }
}
