//! `igtl_send`: sends what a graph computes to programs that speak OpenIGTLink.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

use panoscope_igtl::message::{
    Attribute, Cells, Image, Orientation, Point, PolyData, Position, Scalar, Status, StatusCode, Text as IgtlText,
    Tool, ToolKind, Tracking, Transform,
};
use panoscope_igtl::{Content, Message, Timestamp};
use panoscope_node::abi::{Pose, Tip};
use panoscope_node::{
    AnyImage, Bgr8, Choice, Cloud, Context, Detections, Finish, Gray8, Gray16, GrayF32, NoPorts, Node, NodeError,
    NodeInfo, Open, Params, Ports, Result, Rgba8, Text, Validation, Value, View,
};

use crate::connection::{Connection, check_name};
use crate::link::{Link, Outgoing, utc_ns};

/// Time limit for sending queued messages when the graph ends.
const DRAIN_LIMIT: Duration = Duration::from_secs(2);
/// Maximum number of buffers kept for reuse.
const MAX_SPARES: usize = 16;

/// Inputs: connect at least one. Each packet is sent when it arrives.
#[derive(Ports)]
pub struct In<'f> {
    /// Image, as IMAGE: gray8 and gray16 with one component, bgr8 as red, green, blue, rgba8 with four, f32 as floats.
    image: Option<AnyImage<'f>>,
    /// Pose, in the message type that `poses_as` selects.
    pose: Option<Value<'f, Pose>>,
    /// Tip of a tool in mm, in the message type that `poses_as` selects; not sent while its position is unknown.
    tip: Option<Value<'f, Tip>>,
    /// Surface, as the points of POLYDATA with their colours.
    cloud: Option<Cloud<'f>>,
    /// Detections, as POINT: the centre of each box in the image plane, with the class as name and half the diagonal as radius.
    detections: Option<Detections<'f>>,
    /// Text, as STRING; truncated to 65,535 bytes.
    text: Option<Text<'f>>,
}

/// Message type of poses and tips.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum PosesAs {
    /// TRANSFORM: a matrix; for a tip a translation.
    Transform,
    /// POSITION: mm and a quaternion; for a tip without orientation.
    Position,
    /// TDATA: both in one message of tracked tools; a tip as a tool with three degrees of freedom.
    Tracking,
}

/// Parameters of `igtl_send`.
#[derive(Params)]
pub struct Settings {
    #[param(flatten)]
    connection: Connection,
    /// Header version of the messages. Every program understands 1. Versions 2 and 3 add a message number and, as metadata, the media time
    /// (`capture_ns`) and the frames of a pose (`a`, `b`).
    #[param(default = 1, range = 1..=3)]
    version: u32,
    /// Message type of poses and tips. A program that asks for tracking data (`STT_TDATA`) gets it whatever this is.
    #[param(default = "transform")]
    poses_as: PosesAs,
    /// Device name of the image.
    #[param(default = "Panoscope")]
    image_name: String,
    /// Device name of the pose. Empty: from the names of its frames, `bToa` for a pose that maps coordinates of `b` to those of `a`.
    #[param(default = "")]
    pose_name: String,
    /// Device name of the tip.
    #[param(default = "Tip")]
    tip_name: String,
    /// Device name of tracking data.
    #[param(default = "Tracker")]
    tracker_name: String,
    /// Device name of the surface.
    #[param(default = "Surface")]
    cloud_name: String,
    /// Device name of the detections.
    #[param(default = "Detections")]
    detections_name: String,
    /// Device name of the text.
    #[param(default = "Text")]
    text_name: String,
    /// Side of an image pixel, for programs that place it in space: pixel (0, 0) is at the origin, x goes along columns, y along rows.
    #[param(default = 1.0, range = 0.001..=100.0, step = 0.001, unit = "mm")]
    pixel_mm: f64,
    /// Every n-th column and row of a surface is sent.
    #[param(default = 4, range = 1..=64)]
    cloud_step: u32,
}

impl Settings {
    fn names(&self) -> [(&'static str, &str); 7] {
        [
            ("image_name", &self.image_name),
            ("pose_name", &self.pose_name),
            ("tip_name", &self.tip_name),
            ("tracker_name", &self.tracker_name),
            ("cloud_name", &self.cloud_name),
            ("detections_name", &self.detections_name),
            ("text_name", &self.text_name),
        ]
    }
}

/// Queues messages for every connected program. In live mode the graph never waits for a program: each has a separate queue, and what a slow one does
/// not take is dropped and counted.
///
/// **Time.** A message carries the time at which the light behind its packet arrived, as UTC: the system's clock minus the age of the packet. In
/// batch mode it carries the capture time as time since 1970, so that two runs send the same bytes.
pub struct Send {
    link: Arc<Link>,
    message_id: u32,
    spares: Vec<Arc<Vec<u8>>>,
    pixels: Vec<u8>,
    pose_name: (([u8; 16], [u8; 16]), String),
}

/// Data that the messages of one call share.
#[derive(Clone, Copy)]
struct Call<'a, 'f> {
    cx: &'a Context<'f>,
    version: u16,
    most: usize,
}

fn frame_name(bytes: &[u8; 16]) -> Cow<'_, str> {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end])
}

/// `text`, truncated to at most `most` bytes.
fn cut(text: &str, most: usize) -> &str {
    &text[..text.floor_char_boundary(most)]
}

impl Send {
    /// A buffer that is no longer read, or a new one.
    fn spare(&mut self) -> Arc<Vec<u8>> {
        match self.spares.iter_mut().position(|spare| Arc::get_mut(spare).is_some()) {
            Some(index) => self.spares.swap_remove(index),
            None => Arc::default(),
        }
    }

    /// Sends one message. `age` is that of its packet's light.
    fn send(
        &mut self,
        call: Call<'_, '_>,
        device: &str,
        age: Duration,
        content: Content<'_>,
        metadata: &[(&str, &str)],
        is_pushed: bool,
    ) -> Result<()> {
        let Some(kind) = content.kind() else { return Ok(()) };
        let capture_ns = call.cx.tick().capture_ns;
        let time_ns = match call.cx.is_batch() {
            true => i128::from(capture_ns),
            false => utc_ns() - i128::try_from(age.as_nanos()).unwrap_or(0),
        };
        let mut message = Message::new(device, Timestamp::from_unix_ns(time_ns), content);
        message.version = call.version;
        if call.version > 1 {
            self.message_id = self.message_id.wrapping_add(1);
            message.message_id = self.message_id;
            message.metadata.push(("capture_ns".into(), capture_ns.to_string().into()));
            message.metadata.extend(metadata.iter().map(|(key, value)| ((*key).into(), (*value).into())));
        }
        let mut buffer = self.spare();
        if let Some(bytes) = Arc::get_mut(&mut buffer) {
            bytes.clear();
            message.encode(bytes)?;
        }
        let bytes = Arc::clone(&buffer);
        if self.spares.len() < MAX_SPARES {
            self.spares.push(buffer);
        }
        let device = device.to_owned();
        let outgoing = Outgoing { kind, device, bytes, is_pushed, is_answer: false, most: call.most };
        self.link.send(&outgoing, call.cx.is_batch());
        Ok(())
    }

    fn send_image(&mut self, call: Call<'_, '_>, image: &AnyImage<'_>, params: &Settings) -> Result<()> {
        let mut pixels = std::mem::take(&mut self.pixels);
        pixels.clear();
        let result = match pack(image, &mut pixels) {
            Some((components, scalar)) => {
                let (width, height) = (image.width(), image.height());
                let picture = Image::picture(width, height, components, scalar, params.pixel_mm as f32, &pixels)?;
                self.send(call, &params.image_name, call.cx.age(image), Content::Image(picture), &[], true)
            }
            None => Err(NodeError::new("the image has an unknown pixel format")),
        };
        self.pixels = pixels;
        result
    }

    /// Device name of a pose.
    fn name_of(&mut self, pose: &Pose, params: &Settings) -> String {
        if !params.pose_name.is_empty() {
            return params.pose_name.clone();
        }
        if self.pose_name.1.is_empty() || self.pose_name.0 != (pose.a, pose.b) {
            let (a, b) = (frame_name(&pose.a), frame_name(&pose.b));
            let name = if a.is_empty() && b.is_empty() { "Pose".to_owned() } else { format!("{b}To{a}") };
            self.pose_name = ((pose.a, pose.b), cut(&name, panoscope_igtl::NAME_BYTES).to_owned());
        }
        self.pose_name.1.clone()
    }

    fn send_poses(
        &mut self,
        call: Call<'_, '_>,
        pose: Option<&Value<'_, Pose>>,
        tip: Option<&Value<'_, Tip>>,
        params: &Settings,
    ) -> Result<()> {
        let mut tools = Vec::new();
        let mut oldest = Duration::ZERO;
        let is_tracking = params.poses_as == PosesAs::Tracking;
        let is_asked = is_tracking || self.link.is_asked_for("TDATA");
        if let Some(pose) = pose
            && pose.a_from_b_wxyz.iter().chain(&pose.a_from_b_mm).all(|v| v.is_finite())
        {
            let (name, age) = (self.name_of(pose, params), call.cx.age(pose));
            let transform = Transform::from_quaternion(pose.a_from_b_wxyz, pose.a_from_b_mm);
            let (a, b) = (frame_name(&pose.a), frame_name(&pose.b));
            let metadata: [(&str, &str); 2] = [("a", &a), ("b", &b)];
            let content = match params.poses_as {
                PosesAs::Transform => Some(Content::Transform(transform)),
                PosesAs::Position => {
                    let [w, x, y, z] = pose.a_from_b_wxyz.map(|v| v as f32);
                    let orientation = Orientation::Xyzw([x, y, z, w]);
                    Some(Content::Position(Position { position_mm: transform.translation_mm, orientation }))
                }
                PosesAs::Tracking => None,
            };
            if let Some(content) = content {
                self.send(call, &name, age, content, &metadata, true)?;
            }
            oldest = oldest.max(age);
            tools.push(Tool { name: Cow::Owned(name), kind: ToolKind::SixD, pose: transform });
        }
        if let Some(tip) = tip
            && tip.xyz_valid != 0
            && tip.xyz_mm.iter().all(|mm| mm.is_finite())
        {
            let age = call.cx.age(tip);
            let transform = Transform { translation_mm: tip.xyz_mm.map(|mm| mm as f32), ..Transform::default() };
            let position_mm = transform.translation_mm;
            let content = match params.poses_as {
                PosesAs::Transform => Some(Content::Transform(transform)),
                PosesAs::Position => Some(Content::Position(Position { position_mm, orientation: Orientation::None })),
                PosesAs::Tracking => None,
            };
            if let Some(content) = content {
                self.send(call, &params.tip_name, age, content, &[], true)?;
            }
            oldest = oldest.max(age);
            tools.push(Tool { name: Cow::Borrowed(&params.tip_name), kind: ToolKind::ThreeD, pose: transform });
        }
        // Without a tool in view a list of none says so.
        if is_asked && (pose.is_some() || tip.is_some()) {
            let content = Content::Tracking(Tracking { tools });
            self.send(call, &params.tracker_name, oldest, content, &[], is_tracking)?;
        }
        Ok(())
    }

    fn send_detections(&mut self, call: Call<'_, '_>, detections: &Detections<'_>, params: &Settings) -> Result<()> {
        let pixel_mm = params.pixel_mm as f32;
        let points = detections.items().iter().map(|item| {
            let centre = [item.x_px + item.width_px / 2.0, item.y_px + item.height_px / 2.0];
            Point {
                name: Cow::Borrowed(cut(detections.label(item.class_index), 64)),
                group: Cow::Borrowed("Detection"),
                rgba: [255, 255, 0, 255],
                position_mm: [centre[0] * pixel_mm, centre[1] * pixel_mm, 0.0],
                radius_mm: item.width_px.hypot(item.height_px) / 2.0 * pixel_mm,
                owner: Cow::Borrowed(&params.image_name),
            }
        });
        let content = Content::Points(points.collect());
        self.send(call, &params.detections_name, call.cx.age(detections), content, &[], true)
    }

    /// Sends the measured points. Points that were filled in are left out, because the message has no field that could mark them.
    fn send_cloud(&mut self, call: Call<'_, '_>, cloud: &Cloud<'_>, params: &Settings) -> Result<()> {
        let (width, step) = (cloud.width().max(1), params.cloud_step.max(1) as usize);
        let rows = cloud.points().chunks_exact(width).step_by(step);
        let (mut points_mm, mut values) = (Vec::new(), Vec::new());
        for point in rows.flat_map(|row| row.iter().step_by(step)).filter(|point| point.is_measured()) {
            points_mm.push([point.x_mm, point.y_mm, point.z_mm]);
            let [blue, green, red] = point.bgr.map(|value| f32::from(value) / 255.0);
            values.extend_from_slice(&[red, green, blue, 1.0]);
        }
        let vertices = Cells::vertices(points_mm.len() as u32);
        // Libraries of protocol version 2 read colours with nine numbers, past their end.
        let kind = if call.version == 1 { Attribute::POINT_SCALARS } else { Attribute::POINT_COLOURS };
        let attributes = vec![Attribute { kind, components: 4, name: Cow::Borrowed("RGBA"), values }];
        let data = PolyData { points_mm, vertices, attributes, ..PolyData::default() };
        self.send(call, &params.cloud_name, call.cx.age(cloud), Content::PolyData(data), &[], true)
    }

    fn report(&self, cx: &Context<'_>) {
        for remark in self.link.remarks() {
            remark.log(cx);
        }
        if let Some(bound) = self.link.bound() {
            cx.metric("port", f64::from(bound.port()));
        }
        let counts = self.link.counts();
        cx.metric("peers", counts.peers as f64);
        cx.metric("sent", counts.sent as f64);
        cx.metric("dropped", counts.dropped as f64);
    }
}

/// Converts the pixels to OpenIGTLink's layout: rows without padding, red before blue. Returns components and type; `None` for an unknown format.
fn pack(image: &AnyImage<'_>, out: &mut Vec<u8>) -> Option<(u8, Scalar)> {
    fn rows<'v, T>(view: &'v View<'v, T>) -> impl Iterator<Item = &'v [T]> {
        (0..view.height).map(|y| view.row(y))
    }
    if let Some(image) = image.as_plane::<Bgr8>() {
        let view = image.view();
        out.reserve(view.width * view.height * 3);
        for row in rows(&view) {
            out.extend(row.chunks_exact(3).flat_map(|pixel| [pixel[2], pixel[1], pixel[0]]));
        }
        return Some((3, Scalar::Uint8));
    }
    if let Some(image) = image.as_plane::<Gray8>() {
        rows(&image.view()).for_each(|row| out.extend_from_slice(row));
        return Some((1, Scalar::Uint8));
    }
    if let Some(image) = image.as_plane::<Rgba8>() {
        rows(&image.view()).for_each(|row| out.extend_from_slice(row));
        return Some((4, Scalar::Uint8));
    }
    if let Some(image) = image.as_plane::<Gray16>() {
        rows(&image.view()).for_each(|row| out.extend(row.iter().flat_map(|value| value.to_le_bytes())));
        return Some((1, Scalar::Uint16));
    }
    let image = image.as_plane::<GrayF32>()?;
    rows(&image.view()).for_each(|row| out.extend(row.iter().flat_map(|value| value.to_le_bytes())));
    Some((1, Scalar::Float32))
}

impl Node for Send {
    const INFO: NodeInfo = NodeInfo::blocking(
        "igtl_send",
        "sink",
        "Sends images, poses, tips, surfaces, detections and texts to programs that speak OpenIGTLink.",
    )
    .side_effects();
    type In<'f> = In<'f>;
    type Out<'f> = NoPorts;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        params.connection.check(check);
        for (param, name) in params.names() {
            check_name(check, param, name);
        }
        let inputs = ["image", "pose", "tip", "cloud", "detections", "text"];
        if inputs.iter().all(|input| check.is_connected(input) == Some(false)) {
            check.node_error("nothing is sent: no input is connected", "connect `image`, `pose` or another input");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let link = Link::get(&params.connection.endpoint())?;
        params.connection.warn(open);
        match link.bound() {
            Some(bound) => open.info(&format!("OpenIGTLink: serves {bound}")),
            None => open.info(&format!("OpenIGTLink: connects to {}", link.words())),
        }
        Ok(Self { link, message_id: 0, spares: Vec::new(), pixels: Vec::new(), pose_name: Default::default() })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, _: NoPorts, params: &Settings) -> Result<()> {
        self.report(cx);
        if !self.link.is_connected() {
            return Ok(());
        }
        let call = Call { cx, version: params.version as u16, most: params.connection.queue as usize };
        // Poses first: they are small, and a picture ahead of them would make them late.
        self.send_poses(call, input.pose.as_ref(), input.tip.as_ref(), params)?;
        if let Some(text) = &input.text {
            let content = Content::Text(IgtlText { text: Cow::Borrowed(cut(text, IgtlText::MAX_COUNT)) });
            self.send(call, &params.text_name, cx.tick_age(), content, &[], true)?;
        }
        if let Some(detections) = &input.detections {
            self.send_detections(call, detections, params)?;
        }
        if let Some(image) = &input.image {
            self.send_image(call, image, params)?;
        }
        if let Some(cloud) = &input.cloud {
            self.send_cloud(call, cloud, params)?;
        }
        Ok(())
    }

    fn finish(&mut self, finish: &Finish<'_>) -> Result<()> {
        if self.link.is_connected() {
            let status = Status {
                code: StatusCode::ShuttingDown as u16,
                sub_code: 0,
                name: "".into(),
                text: "the graph has ended".into(),
            };
            let message = Message::new("Panoscope", Timestamp::from_unix_ns(utc_ns()), Content::Status(status));
            let mut bytes = Vec::new();
            message.encode(&mut bytes)?;
            let (kind, device, bytes) = ("STATUS", "Panoscope".to_owned(), Arc::new(bytes));
            self.link.send(&Outgoing { kind, device, bytes, is_pushed: true, is_answer: false, most: 1 }, false);
        }
        let left = self.link.drain(DRAIN_LIMIT);
        if left > 0 {
            finish.warn(&format!("{left} messages were not read within {} s and are lost", DRAIN_LIMIT.as_secs()));
        }
        Ok(())
    }
}
