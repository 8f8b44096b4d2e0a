//! From messages to outputs, for bags and topics alike.

use std::collections::{HashMap, VecDeque};

use panoscope_data::calibration::ros as camera;
use panoscope_node::abi::{Calibration, CloudPoint, Joints, Pose};
use panoscope_node::{Bgr8, Context, Depth, Disparity, LabeledDetections, NodeError, PointCloud, Ports, Result, Slot};
use panoscope_ros::cdr::{self, CdrError, Message};
use panoscope_ros::convert::{self, Boxes, ConvertError, Picture, Samples};
use panoscope_ros::messages;

/// Pictures of a view that wait for their partner.
const MAX_WAITING: usize = 8;

/// Outputs. A tick has what came together: both views of one instant, or one message of another topic.
#[derive(Ports)]
pub struct Out<'f> {
    /// Left view, or the only one.
    pub left: Slot<'f, Bgr8>,
    /// Right view of the same instant.
    pub right: Slot<'f, Bgr8>,
    /// Both cameras, with every picture, as soon as both camera_info topics had a message.
    pub calibration: Slot<'f, Calibration>,
    /// Depth of the left rectified view, mm; NaN where unknown.
    pub depth: Slot<'f, Depth>,
    /// Disparity of the left rectified view, px; NaN where unknown.
    pub disparity: Slot<'f, Disparity>,
    /// Points, mm, in the frame of the message.
    pub cloud: Slot<'f, PointCloud>,
    /// Boxes.
    pub detections: Slot<'f, LabeledDetections>,
    /// A pose, mm.
    pub pose: Slot<'f, Pose>,
    /// Joints of an arm.
    pub joints: Slot<'f, Joints>,
}

/// What the messages of a topic become.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// View 0 or 1.
    View(usize),
    /// Camera of view 0 or 1.
    Info(usize),
    /// `depth`.
    Depth,
    /// `disparity`.
    Disparity,
    /// `cloud`.
    Cloud,
    /// `detections`.
    Detections,
    /// `pose`.
    Pose,
    /// `joints`.
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

/// Where the camera of a picture's topic is: beside it.
pub fn info_topic(picture: &str) -> Option<String> {
    let plain = picture.strip_suffix("/compressed").unwrap_or(picture);
    plain.rsplit_once('/').map(|(namespace, _)| format!("{namespace}/camera_info"))
}

/// What came together.
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

/// Why a message was left out.
#[derive(Debug, thiserror::Error)]
pub enum IncomingError {
    /// The bytes are no message.
    #[error("`{topic}`: {cause}")]
    Bytes {
        /// The topic.
        topic: String,
        /// What is wrong.
        cause: CdrError,
    },
    /// The message has no packet.
    #[error("`{topic}`: {cause}")]
    Value {
        /// The topic.
        topic: String,
        /// What is wrong.
        cause: ConvertError,
    },
}

/// Collects messages until a tick is complete.
pub struct Incoming {
    roles: HashMap<String, Role>,
    is_pair: bool,
    tolerance_ns: i64,
    waiting: [VecDeque<(i64, Picture)>; 2],
    infos: [Option<camera::CameraInfo>; 2],
    calibration: Option<Calibration>,
    /// Why there is no calibration; said once.
    calibration_problem: Option<String>,
    /// Pictures without a partner.
    pub unpaired: u64,
    last_ns: Option<i64>,
}

impl Incoming {
    /// Reads topics with these roles. Views that are further apart than the tolerance do not belong together.
    pub fn new(roles: impl IntoIterator<Item = (String, Role)>, tolerance_ms: f64) -> Self {
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

    /// Takes the fields of a message, whose encoding has this number. Returns the time of its data and what is complete now.
    ///
    /// # Errors
    /// It is damaged, or not readable here; what came before stays.
    pub fn take(
        &mut self,
        topic: &str,
        message: &str,
        (number, body): (u16, &[u8]),
    ) -> std::result::Result<Option<(i64, Ready)>, IncomingError> {
        let Some(role) = self.roles.get(topic).copied() else { return Ok(None) };
        let bytes = |cause| IncomingError::Bytes { topic: topic.to_owned(), cause };
        let value = |cause| IncomingError::Value { topic: topic.to_owned(), cause };
        Ok(match role {
            Role::View(view) => {
                let (stamp, picture) = if message == messages::CompressedImage::TYPE {
                    let found: messages::CompressedImage<'_> = cdr::decode_body(number, body).map_err(bytes)?;
                    (found.header.stamp, convert::compressed(&found).map_err(value)?)
                } else {
                    let found: messages::Image<'_> = cdr::decode_body(number, body).map_err(bytes)?;
                    (found.header.stamp, convert::picture(&found).map_err(value)?)
                };
                self.view(view, stamp.ns(), picture)
            }
            Role::Info(view) => {
                let found: messages::CameraInfo = cdr::decode_body(number, body).map_err(bytes)?;
                let info = convert::camera_info(&found).map_err(value)?;
                if self.infos[view] != Some(info) {
                    self.infos[view] = Some(info);
                    self.calibrate();
                }
                None
            }
            Role::Depth => {
                let found: messages::Image<'_> = cdr::decode_body(number, body).map_err(bytes)?;
                let (width, height, mm) = convert::depth_mm(&found).map_err(value)?;
                Some((found.header.stamp.ns(), Ready::Depth(width, height, mm)))
            }
            Role::Disparity => {
                let found: messages::DisparityImage<'_> = cdr::decode_body(number, body).map_err(bytes)?;
                let (width, height, px) = convert::disparity(&found).map_err(value)?;
                Some((found.header.stamp.ns(), Ready::Disparity(width, height, px)))
            }
            Role::Cloud => {
                let found: messages::PointCloud2<'_> = cdr::decode_body(number, body).map_err(bytes)?;
                let (width, height, points) = convert::cloud(&found).map_err(value)?;
                Some((found.header.stamp.ns(), Ready::Cloud(width, height, points)))
            }
            Role::Detections => {
                let found: messages::Detection2DArray = cdr::decode_body(number, body).map_err(bytes)?;
                Some((found.header.stamp.ns(), Ready::Detections(convert::boxes(&found).map_err(value)?)))
            }
            Role::Pose => {
                let found: messages::PoseStamped = cdr::decode_body(number, body).map_err(bytes)?;
                let child = topic.rsplit('/').next().unwrap_or("");
                Some((found.header.stamp.ns(), Ready::Pose(convert::pose(&found, child))))
            }
            Role::Joints => {
                let found: messages::JointState = cdr::decode_body(number, body).map_err(bytes)?;
                Some((found.header.stamp.ns(), Ready::Joints(convert::joints(&found).map_err(value)?)))
            }
        })
    }

    /// Pairs a picture with the nearest one of the other view.
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
        let (other_ns, other) = self.waiting[1 - view].drain(..=index).next_back()?;
        let views = if view == 0 { vec![picture, other] } else { vec![other, picture] };
        // The left picture's time is that of the pair.
        Some((if view == 0 { stamp_ns } else { other_ns }, Ready::Views(views)))
    }

    fn calibrate(&mut self) {
        let [Some(left), Some(right)] = &self.infos else { return };
        match camera::calibration(left, right) {
            Ok(calibration) => self.calibration = Some(calibration),
            Err(error) => {
                self.calibration = None;
                self.calibration_problem = Some(error.to_string());
            }
        }
    }

    /// Sets the time of a tick. Times that do not grow become the next nanosecond, because ticks of a source follow each other.
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

    /// Writes outputs that are read.
    ///
    /// # Errors
    /// No frame memory is left.
    pub fn write(&mut self, cx: &Context<'_>, ready: Ready, out: &mut Out<'_>) -> Result<()> {
        if let Some(problem) = self.calibration_problem.take() {
            cx.warn(&format!("no calibration: {problem}"));
        }
        match ready {
            Ready::Views(views) => {
                for (slot, picture) in [&mut out.left, &mut out.right].into_iter().zip(views) {
                    if slot.is_read() {
                        write_picture(slot, &picture)?;
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

/// Writes a picture as BGR; 16 bits by their upper byte.
fn write_picture(slot: &mut Slot<'_, Bgr8>, picture: &Picture) -> Result<()> {
    let gray = |out: &mut dyn Iterator<Item = u8>, to: &mut [u8]| {
        to.as_chunks_mut::<3>().0.iter_mut().zip(out).for_each(|(pixel, value)| *pixel = [value; 3]);
    };
    let out = slot.alloc(picture.width, picture.height)?;
    match &picture.samples {
        Samples::Bgr8(pixels) => out.data.copy_from_slice(pixels),
        Samples::Gray8(pixels) => gray(&mut pixels.iter().copied(), out.data),
        Samples::Gray16(pixels) => gray(&mut pixels.iter().map(|value| (value >> 8) as u8), out.data),
        Samples::F32(_) => {
            return Err(NodeError::new("a picture of floats is no view: read its topic as `depth`"));
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
        Incoming::new([("/l".to_owned(), Role::View(0)), ("/r".to_owned(), Role::View(1))], 5.0)
    }

    #[test]
    fn views_of_one_instant_belong_together() {
        let mut incoming = pair();
        assert!(incoming.view(0, 0, picture(1)).is_none());
        assert!(incoming.view(0, 33_000_000, picture(2)).is_none());
        let Some((stamp, Ready::Views(views))) = incoming.view(1, 34_000_000, picture(3)) else { panic!("a pair") };
        assert_eq!((stamp, incoming.unpaired), (33_000_000, 1));
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
        assert_eq!((incoming.waiting[0].len(), incoming.unpaired), (MAX_WAITING, 92));
    }

    #[test]
    fn a_camera_stands_beside_its_picture() {
        assert_eq!(info_topic("/a/left/image_raw").as_deref(), Some("/a/left/camera_info"));
        assert_eq!(info_topic("/a/left/image_raw/compressed").as_deref(), Some("/a/left/camera_info"));
        assert_eq!(info_topic("image"), None);
    }

    #[test]
    fn damaged_messages_leave_the_rest() {
        let mut incoming = pair();
        assert!(incoming.take("/l", messages::Image::TYPE, (1, &[1, 2, 3])).is_err());
        assert!(incoming.take("/other", messages::Image::TYPE, (1, &[])).unwrap().is_none());
        assert!(incoming.wants("/l", messages::CompressedImage::TYPE));
        assert!(!incoming.wants("/l", messages::PoseStamped::TYPE));
    }
}
