//! One viewer: a pipeline that sends it the encoder's packets.

use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak, mpsc};
use std::time::{Duration, Instant};

use gstreamer::prelude::*;
use gstreamer::{Element, MessageType, PadProbeReturn, PadProbeType, Pipeline, Promise, State, StructureRef};
use gstreamer_app::AppSrc;
use gstreamer_sdp::SDPMessage;
use gstreamer_video::UpstreamForceKeyUnitEvent;
use gstreamer_webrtc::{
    WebRTCICEGatheringState, WebRTCPeerConnectionState, WebRTCRTPTransceiver, WebRTCRTPTransceiverDirection,
    WebRTCSDPType, WebRTCSessionDescription,
};
use panoscope_media::offer::Offer;
use panoscope_media::{MediaError, make};

use crate::stream::fanout::{Fanout, SOURCE};

/// GStreamer elements that a viewer needs.
const ELEMENTS: &[&str] =
    &["appsrc", "rtph264pay", "rtpbin", "webrtcbin", "nicesrc", "nicesink", "dtlssrtpenc", "dtlssrtpdec", "srtpenc"];
/// Time limit of one step of `webrtcbin`.
const STEP: Duration = Duration::from_secs(5);
/// A viewer that has not connected within this time has left.
const MAX_CONNECTING: Duration = Duration::from_secs(15);
/// A viewer that has sent nothing for this time has left. Browsers send a report about every second after the first frame.
const MAX_SILENCE: Duration = Duration::from_secs(10);
/// Minimum time between keyframes that a viewer may request, ms.
const KEY_EVERY_MS: u64 = 300;

/// Why a viewer cannot be served.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ViewerError {
    /// GStreamer refuses an element or a pipeline.
    #[error(transparent)]
    Media(#[from] MediaError),
    /// `webrtcbin` refuses a step of the negotiation, or exceeds its time limit.
    #[error("GStreamer's webrtcbin failed to {step}: {reason}")]
    Step { step: &'static str, reason: String },
    /// The answer does not contain the offered video.
    #[error("GStreamer's webrtcbin does not send the video that was offered")]
    Answer,
}

/// Creates each element once.
///
/// # Errors
/// An element is missing; the error names the package to install.
pub fn check() -> Result<(), MediaError> {
    ELEMENTS.iter().try_for_each(|name| make(name).map(drop))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Connecting,
    /// Connected, with its number among the receivers of packets.
    Connected(u64),
    Gone,
}

/// State that GStreamer's callbacks write.
struct Link {
    begin: Instant,
    phase: Mutex<Phase>,
    fanout: Arc<Fanout>,
    source: AppSrc,
    /// Time of the last packet from the viewer, ms since `begin`.
    heard_ms: AtomicU64,
    /// Time of the first packet sent to the viewer, ms since `begin`; 0 before.
    sent_ms: AtomicU64,
    /// Time of the last keyframe request, ms since `begin`.
    key_asked_ms: AtomicU64,
}

impl Link {
    fn phase(&self) -> std::sync::MutexGuard<'_, Phase> {
        self.phase.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now_ms(&self) -> u64 {
        u64::try_from(self.begin.elapsed().as_millis()).unwrap_or(u64::MAX)
    }

    fn hear(&self) {
        self.heard_ms.store(self.now_ms(), Ordering::Relaxed);
    }

    fn send(&self) {
        if self.sent_ms.load(Ordering::Relaxed) == 0 {
            self.sent_ms.store(self.now_ms().max(1), Ordering::Relaxed);
        }
    }

    /// Time for which it has been silent although it had something to report.
    fn silence(&self) -> Duration {
        let (heard, sent) = (self.heard_ms.load(Ordering::Relaxed), self.sent_ms.load(Ordering::Relaxed));
        let ms = if sent == 0 { 0 } else { self.now_ms().saturating_sub(heard.max(sent)) };
        Duration::from_millis(ms)
    }

    /// Starts the flow of packets at the moment when the viewer can receive them, so that none is old.
    fn connected(&self) {
        let mut phase = self.phase();
        if *phase == Phase::Connecting {
            self.hear();
            *phase = Phase::Connected(self.fanout.add(self.source.clone()));
        }
    }

    fn gone(&self) {
        let mut phase = self.phase();
        if let Phase::Connected(id) = *phase {
            self.fanout.remove(id);
        }
        *phase = Phase::Gone;
    }

    fn ask_key(&self) {
        let Phase::Connected(id) = *self.phase() else { return };
        let (now, last) = (self.now_ms(), self.key_asked_ms.load(Ordering::Relaxed));
        if last == 0 || now.saturating_sub(last) >= KEY_EVERY_MS {
            self.key_asked_ms.store(now.max(1), Ordering::Relaxed);
            self.fanout.ask_key(id);
        }
    }
}

/// Sends packets until it is dropped. Dropping waits for threads of the pipeline, so it must not happen on one of them.
pub struct Viewer {
    pipeline: Pipeline,
    link: Arc<Link>,
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.link.gone();
        // Stopping cannot fail in a way that anybody could repair.
        let _ = self.pipeline.set_state(State::Null);
    }
}

/// Starts a step of `webrtcbin` and waits for its reply.
fn step<T: Send + 'static>(
    name: &'static str,
    peer: &Element,
    signal: &'static str,
    argument: &dyn ToValue,
    read: impl Fn(Option<&StructureRef>) -> Option<T> + Send + 'static,
) -> Result<T, ViewerError> {
    let failed = |reason: &str| ViewerError::Step { step: name, reason: reason.to_owned() };
    let (sender, reply) = mpsc::channel();
    let promise = Promise::with_change_func(move |reply| {
        let result = match reply {
            Ok(reply) => match reply.and_then(|reply| reply.get::<gstreamer::glib::Error>("error").ok()) {
                Some(error) => Err(error.message().to_owned()),
                None => read(reply).ok_or_else(|| "it gave no reply".to_owned()),
            },
            Err(error) => Err(format!("{error:?}")),
        };
        // Nobody waits any longer after a time-out.
        let _ = sender.send(result);
    });
    peer.emit_by_name_with_values(signal, &[argument.to_value(), promise.to_value()]);
    let result = reply.recv_timeout(STEP).map_err(|_| failed("it took too long"))?;
    result.map_err(|reason| failed(&reason))
}

impl Viewer {
    /// Negotiates with a viewer that reached this machine at `local`, and answers its offer. The viewer gets packets of `fanout` once it has
    /// connected.
    ///
    /// # Errors
    /// GStreamer refuses the offer, or exceeds its time limit.
    pub fn connect(offer: &Offer, local: IpAddr, fanout: &Arc<Fanout>) -> Result<(Self, String), ViewerError> {
        let payload_type = offer.format.payload_type;
        let text = format!(
            "{SOURCE} ! rtph264pay pt={payload_type} config-interval=-1 aggregate-mode=zero-latency \
             ! application/x-rtp,media=video,encoding-name=H264,payload={payload_type} \
             ! webrtcbin name=peer bundle-policy=max-bundle"
        );
        let refused = |reason: String| ViewerError::Media(MediaError::Refused { reason });
        let pipeline = gstreamer::parse::launch(&text).map_err(|error| refused(error.to_string()))?;
        let pipeline = pipeline.downcast::<Pipeline>().map_err(|_| refused("no pipeline".to_owned()))?;
        let source = pipeline.by_name("source").and_then(|source| source.downcast::<AppSrc>().ok());
        let peer = pipeline.by_name("peer");
        let (Some(source), Some(peer)) = (source, peer) else {
            return Err(refused("an element of the pipeline is missing".to_owned()));
        };
        let link = Arc::new(Link {
            begin: Instant::now(),
            phase: Mutex::new(Phase::Connecting),
            fanout: Arc::clone(fanout),
            source,
            heard_ms: AtomicU64::new(0),
            sent_ms: AtomicU64::new(0),
            key_asked_ms: AtomicU64::new(0),
        });
        let viewer = Self { pipeline, link };
        viewer.listen(&peer);
        only_at(&peer, local)?;
        viewer.pipeline.set_state(State::Playing).map_err(|error| refused(error.to_string()))?;
        let answer = negotiate(&peer, offer)?;
        Ok((viewer, answer))
    }

    /// Connects the callbacks that follow the viewer's state.
    fn listen(&self, peer: &Element) {
        let link = Arc::downgrade(&self.link);
        peer.connect_notify(Some("connection-state"), move |peer, _| {
            let Some(link) = link.upgrade() else { return };
            match peer.property::<WebRTCPeerConnectionState>("connection-state") {
                WebRTCPeerConnectionState::Connected => link.connected(),
                WebRTCPeerConnectionState::Failed | WebRTCPeerConnectionState::Closed => link.gone(),
                _ => {}
            }
        });
        let link = Arc::downgrade(&self.link);
        self.pipeline.connect_deep_element_added(move |_, _, element| {
            let is_receiver = element.factory().is_some_and(|factory| factory.name() == "nicesrc");
            if let Some(pad) = element.static_pad("src").filter(|_| is_receiver) {
                on_probe(&pad, PadProbeType::BUFFER | PadProbeType::BUFFER_LIST, link.clone(), |link, _| link.hear());
            }
        });
        if let Some(pad) = self.link.source.static_pad("src") {
            on_probe(&pad, PadProbeType::BUFFER, Arc::downgrade(&self.link), |link, _| link.send());
            let link = Arc::downgrade(&self.link);
            on_probe(&pad, PadProbeType::EVENT_UPSTREAM, link, |link, info| {
                if info.event().is_some_and(|event| UpstreamForceKeyUnitEvent::parse(event).is_ok()) {
                    link.ask_key();
                }
            });
        }
    }

    /// Whether it has left: it closed the connection, never connected, or is silent.
    pub fn has_left(&self) -> bool {
        let has_failed = self.pipeline.bus().is_some_and(|bus| {
            // Other messages are taken off as well, so that they do not pile up.
            let all = std::iter::from_fn(|| bus.pop());
            all.filter(|message| message.type_() == MessageType::Error).count() > 0
        });
        if has_failed {
            self.link.gone();
        }
        let phase = *self.link.phase();
        match phase {
            Phase::Gone => true,
            Phase::Connecting => self.link.begin.elapsed() > MAX_CONNECTING,
            Phase::Connected(_) => self.link.silence() > MAX_SILENCE,
        }
    }
}

fn on_probe(
    pad: &gstreamer::Pad,
    kind: PadProbeType,
    link: Weak<Link>,
    act: impl Fn(&Link, &gstreamer::PadProbeInfo<'_>) + Send + Sync + 'static,
) {
    // Kept as long as the pad.
    let _ = pad.add_probe(kind, move |_, info| {
        if let Some(link) = link.upgrade() {
            act(&link, info);
        }
        PadProbeReturn::Ok
    });
}

/// Restricts the connection to UDP at one address of this machine, which the viewer is known to reach. No server is asked for other addresses.
fn only_at(peer: &Element, local: IpAddr) -> Result<(), ViewerError> {
    let agent = peer.property::<gstreamer::Object>("ice-agent");
    if !agent.emit_by_name::<bool>("add-local-ip-address", &[&local.to_string()]) {
        return Err(ViewerError::Step { step: "take an address", reason: format!("it refuses {local}") });
    }
    if agent.find_property("ice-tcp").is_some() {
        agent.set_property("ice-tcp", false);
    }
    if agent.find_property("agent").is_some()
        && let Some(nice) = agent.property::<Option<gstreamer::glib::Object>>("agent")
        && nice.find_property("upnp").is_some()
    {
        nice.set_property("upnp", false);
    }
    Ok(())
}

fn negotiate(peer: &Element, offer: &Offer) -> Result<String, ViewerError> {
    let failed = |step: &'static str, reason: String| ViewerError::Step { step, reason };
    let text = SDPMessage::parse_buffer(offer.to_text().as_bytes())
        .map_err(|error| failed("read the offer", error.to_string()))?;
    let offered = WebRTCSessionDescription::new(WebRTCSDPType::Offer, text);
    step("take the offer", peer, "set-remote-description", &offered, |_| Some(()))?;
    if let Some(sender) = peer.emit_by_name::<Option<WebRTCRTPTransceiver>>("get-transceiver", &[&0_i32]) {
        sender.set_property("direction", WebRTCRTPTransceiverDirection::Sendonly);
    }
    let answer = step("answer", peer, "create-answer", &None::<gstreamer::Structure>, |reply| {
        reply?.get::<WebRTCSessionDescription>("answer").ok()
    })?;
    step("use the answer", peer, "set-local-description", &answer, |_| Some(()))?;
    let end = Instant::now() + STEP;
    while peer.property::<WebRTCICEGatheringState>("ice-gathering-state") != WebRTCICEGatheringState::Complete {
        if Instant::now() > end {
            return Err(failed("find its address", "it took too long".to_owned()));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let complete = peer.property::<Option<WebRTCSessionDescription>>("local-description");
    let text = complete.and_then(|complete| complete.sdp().as_text().ok()).ok_or(ViewerError::Answer)?;
    let sends = text.lines().any(|line| line == "a=sendonly");
    let has_address = text.lines().any(|line| line.starts_with("a=candidate:"));
    if !sends || !has_address {
        return Err(ViewerError::Answer);
    }
    offer.complete(&text).ok_or(ViewerError::Answer)
}
