//! `igtl_receive`: converts messages of programs that speak OpenIGTLink to packets of the graph.

mod packets;

use std::sync::Arc;
use std::time::{Duration, Instant};

use panoscope_igtl::message::KINDS;
use panoscope_igtl::{Content, Message};
use panoscope_node::abi::{Pose, Scalar};
use panoscope_node::{
    AnyFormat, Choice, Context, NoPorts, Node, NodeError, NodeInfo, Open, Params, PointCloud, Ports, Result, Slot,
    TableData, TextPacket, Validation,
};

use crate::connection::{Connection, check_name};
use crate::link::{Filter, Inbox, Link, Received, Role, utc_ns};
use packets::Packets;

/// Maximum wait for a message in one call: an empty tick then shows that the node is alive.
const STEP: Duration = Duration::from_millis(100);
/// Time limit for a server to appear in batch mode.
const BATCH_CONNECT_LIMIT: Duration = Duration::from_secs(10);

/// Outputs. Each message is a separate tick, with the outputs of its type.
#[derive(Ports)]
pub struct Out<'f> {
    /// IMAGE of one slice. 8 bits with one component are gray8, with three bgr8, with four rgba8; 16 bits are gray16; other numbers of one component
    /// f32. A partial image is merged into the previous one.
    image: Slot<'f, AnyFormat>,
    /// TRANSFORM that is a rotation and a translation, POSITION with an orientation, or the first tool of TDATA.
    pose: Slot<'f, Pose>,
    /// POINT, POSITION, the tools of TDATA, or the translation of TRANSFORM: a row per point with position and radius in mm.
    points: Slot<'f, TableData>,
    /// Names of the rows of `points`, one per line: those of the points or tools, or the device name.
    names: Slot<'f, TextPacket>,
    /// POLYDATA: its points, in one row, with their colours if it has any.
    cloud: Slot<'f, PointCloud>,
    /// STRING, and the text of STATUS.
    text: Slot<'f, TextPacket>,
    /// Code of STATUS; 1 is OK.
    status: Slot<'f, Scalar>,
}

/// Where the capture time of a tick comes from.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeFrom {
    /// The message's timestamp, counted from the first one; its arrival if it has no timestamp.
    Sender,
    /// The arrival of the message.
    Arrival,
}

/// Parameters of `igtl_receive`.
#[derive(Params)]
pub struct Settings {
    #[param(flatten)]
    connection: Connection,
    /// Device name of the messages to take; empty takes those of all devices.
    #[param(default = "", reopen)]
    device: String,
    /// Frame `a` of the pose, to which it maps. Empty: from a device name such as `ToolToTracker`, the part after `To`.
    #[param(default = "")]
    a: String,
    /// Frame `b` of the pose, from which it maps. Empty: from the device name, the part before `To`, or all of it.
    #[param(default = "")]
    b: String,
    /// Where the capture time of a tick comes from. Capture times never decrease.
    #[param(default = "sender")]
    time_from: TimeFrom,
    /// Whether the sender's clock and this machine's are synchronised (NTP or PTP) to better than the ages that matter. On: ages count from a
    /// message's timestamp. Off: ages count from its arrival here, and the transmission time is unknown.
    #[param(default = false)]
    clocks_agree: bool,
}

/// Emits each message as a tick, in the order of arrival.
///
/// **Time.** The capture time is the message's timestamp, counted from the first one of this run; in live mode from the message with the shortest
/// transmission time, so that no tick is held back. The arrival, from which ages count, is the moment at which the last byte was received; with
/// `clocks_agree` it is the message's timestamp.
pub struct Receive {
    link: Arc<Link>,
    inbox: Arc<Inbox>,
    packets: Packets,
    opened: Instant,
    /// Timestamp and capture time from which capture times count.
    from: Option<(i128, i64)>,
    /// Time and capture time of the first message of a live run.
    begun: Option<(Instant, i64)>,
    capture_ns: i64,
    has_warned: bool,
    refused: u64,
}

impl Drop for Receive {
    fn drop(&mut self) {
        // A connection may wait for room in it.
        self.inbox.close();
    }
}

impl Out<'_> {
    /// Message types that a connected output needs, as [`Inbox::set_wanted`] takes them.
    fn wanted(&self) -> usize {
        let places = self.points.is_read() || self.names.is_read();
        let mut bits = 0;
        for (index, kind) in KINDS.iter().enumerate() {
            let is_read = match *kind {
                "IMAGE" => self.image.is_read(),
                "TRANSFORM" | "POSITION" | "TDATA" => self.pose.is_read() || places,
                "POINT" => places,
                "POLYDATA" => self.cloud.is_read(),
                "STRING" => self.text.is_read(),
                "STATUS" => self.text.is_read() || self.status.is_read(),
                _ => false,
            };
            bits |= usize::from(is_read) << index;
        }
        bits
    }
}

impl Receive {
    /// Sets capture time and arrival of the tick.
    fn set_times(&mut self, cx: &Context<'_>, received: &Received, message: &Message<'_>, params: &Settings) {
        let sent_ns = message.time.unix_ns();
        let is_timed = !message.time.is_unknown();
        let stamp_ns = if is_timed && params.time_from == TimeFrom::Sender { sent_ns } else { received.arrived_utc_ns };
        let (first_ns, capture_ns) = *self.from.get_or_insert((stamp_ns, self.capture_ns + 1));
        let since_ns = i64::try_from(stamp_ns - first_ns).unwrap_or(0);
        let mut next_ns = capture_ns.saturating_add(since_ns);
        if !cx.is_batch() {
            // The host holds a live tick back until as much time has passed as capture times say. A message that was quicker on its way than the first
            // one, or a sender whose clock is fast, must not make every later one late: capture times count from the quickest message.
            let (begun, begun_ns) = *self.begun.get_or_insert_with(|| (Instant::now(), next_ns));
            let passed_ns = i64::try_from(begun.elapsed().as_nanos()).unwrap_or(i64::MAX);
            let ahead_ns = next_ns.saturating_sub(begun_ns).saturating_sub(passed_ns);
            if ahead_ns > 0 {
                next_ns -= ahead_ns;
                self.from = Some((first_ns + i128::from(ahead_ns), capture_ns));
            }
        }
        self.capture_ns = next_ns.max(self.capture_ns + 1);
        cx.set_capture_ns(self.capture_ns);
        let late_ns = received.arrived_utc_ns - sent_ns;
        if is_timed {
            cx.metric("latency_ms", late_ns as f64 * 1e-6);
        }
        if let Some(now_ns) = cx.clock_ns() {
            let waited_ns = i64::try_from(received.arrived.elapsed().as_nanos()).unwrap_or(0);
            let way_ns = if params.clocks_agree && is_timed { i64::try_from(late_ns.max(0)).unwrap_or(0) } else { 0 };
            cx.set_arrived_ns(now_ns.saturating_sub(waited_ns).saturating_sub(way_ns));
        }
    }

    /// Makes an empty tick, or ends the source in batch mode.
    ///
    /// # Errors
    /// In batch mode: the server is missing.
    fn idle(&mut self, cx: &Context<'_>, params: &Settings) -> Result<()> {
        if cx.is_batch() && self.link.has_ended() {
            // What arrived before the end was taken before.
            cx.end();
            return Ok(());
        }
        let is_missing = params.connection.role == Role::Client && !self.link.is_connected();
        if cx.is_batch() && is_missing && self.opened.elapsed() > BATCH_CONNECT_LIMIT {
            let (at, limit_s) = (self.link.words(), BATCH_CONNECT_LIMIT.as_secs());
            return Err(NodeError::ended_early(format!(
                "no server answered at {at} within {limit_s} s: start the server first"
            )));
        }
        // By the clock: time goes on.
        if let Some((first_ns, capture_ns)) = self.from {
            let since_ns = i64::try_from(utc_ns() - first_ns).unwrap_or(0);
            let is_arrival = params.time_from == TimeFrom::Arrival;
            let next_ns = if is_arrival { capture_ns.saturating_add(since_ns) } else { self.capture_ns + 1 };
            self.capture_ns = next_ns.max(self.capture_ns + 1);
        } else {
            self.capture_ns += 1;
        }
        cx.set_capture_ns(self.capture_ns);
        Ok(())
    }

    /// Warns once of content that is not passed on; all of it is counted.
    fn refuse(&mut self, cx: &Context<'_>, received: &Received, words: &str) {
        self.refused += 1;
        if !std::mem::replace(&mut self.has_warned, true) {
            let Received { kind, device, .. } = received;
            cx.warn(&format!("{kind} of `{device}` was dropped: {words}; further ones are only counted"));
        }
    }

    fn report(&self, cx: &Context<'_>) {
        for mut remark in self.link.remarks() {
            // A fault beside the end of a batch would say that data is missing.
            remark.is_fault &= !(remark.is_end && cx.is_batch());
            remark.log(cx);
        }
        if let Some(bound) = self.link.bound() {
            cx.metric("port", f64::from(bound.port()));
        }
        let counts = self.link.counts();
        cx.metric("peers", counts.peers as f64);
        cx.metric("received", counts.received as f64);
        cx.metric("damaged", counts.damaged as f64);
        cx.metric("skipped", counts.skipped as f64);
        cx.metric("dropped", self.inbox.dropped() as f64);
        cx.metric("refused", self.refused as f64);
    }
}

impl Node for Receive {
    const INFO: NodeInfo = NodeInfo::blocking(
        "igtl_receive",
        "source",
        "Receives images, poses, points, surfaces and texts from programs that speak OpenIGTLink.",
    )
    .source();
    type In<'f> = NoPorts;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        params.connection.check(check);
        check_name(check, "device", &params.device);
        for (param, name) in [("a", &params.a), ("b", &params.b)] {
            if name.len() > 15 {
                let message = format!("`{name}` has {} bytes, the name of a frame has at most 15", name.len());
                check.error(param, message, "write a shorter name");
            }
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let link = Link::get(&params.connection.endpoint())?;
        params.connection.warn(open);
        match link.bound() {
            Some(bound) => open.info(&format!("OpenIGTLink: receives at {bound}")),
            None => open.info(&format!("OpenIGTLink: connects to {}", link.words())),
        }
        let filter = Filter { device: params.device.clone() };
        let inbox = link.subscribe(filter, params.connection.queue as usize, open.is_batch());
        Ok(Self {
            link,
            inbox,
            packets: Packets::default(),
            opened: Instant::now(),
            from: None,
            begun: None,
            capture_ns: -1,
            has_warned: false,
            refused: 0,
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, params: &Settings) -> Result<()> {
        self.inbox.set_wanted(out.wanted());
        let received = self.inbox.take(STEP);
        self.report(cx);
        let Some(received) = received else { return self.idle(cx, params) };
        let message = match Message::decode(&received.bytes) {
            Ok(message) => message,
            Err(error) => {
                self.refuse(cx, &received, &error.to_string());
                return self.idle(cx, params);
            }
        };
        self.set_times(cx, &received, &message, params);
        let frames = packets::Frames { a: &params.a, b: &params.b };
        let made = match &message.content {
            Content::Image(image) => self.packets.image(image, &message.device, &mut out.image),
            Content::Transform(_) | Content::Position(_) | Content::Tracking(_) | Content::Points(_) => {
                self.packets.places(&message, frames, &mut out)
            }
            Content::PolyData(data) => packets::cloud(data, &mut out.cloud),
            Content::Text(text) => out.text.set_text(&text.text).map(|()| None),
            Content::Status(status) => out
                .text
                .set_text(&status.text)
                .and_then(|()| out.status.set_scalar("status", f64::from(status.code), ""))
                .map(|()| None),
            Content::Nothing => Ok(Some("it is empty: the sender has no such data".to_owned())),
            Content::Capability(_) | Content::Query(_) | Content::Other(_) => Ok(None),
            _ => Ok(None),
        };
        if let Some(words) = made? {
            self.refuse(cx, &received, &words);
        }
        Ok(())
    }
}
