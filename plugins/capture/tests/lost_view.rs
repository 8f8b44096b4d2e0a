//! One of two live views is lost: the other one continues, the lost one is named, and pairs are formed again when it is back.

use std::net::UdpSocket;
use std::time::Instant;

use gstreamer as gst;
use gstreamer::prelude::*;
use panoscope_capture::capture::Capture;
use panoscope_node::harness::{Harness, Outputs, Setup};

use crate::common::{Folder, until};

/// Maximum time between two frames, ms: a tick waits at most for a camera's pause and one step.
const MAX_STEP_MS: f64 = 1000.0;

/// Maximum time between the frames of a pair, ms: two senders have no common clock.
const TOLERANCE_MS: f64 = 60.0;

/// A sender of frames over UDP, which can be stopped and started.
struct Sender {
    pipeline: gst::Pipeline,
    port: u16,
}

impl Sender {
    fn start() -> Self {
        panoscope_media::init().unwrap();
        let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let text = format!(
            "videotestsrc is-live=true ! video/x-raw,format=I420,width=64,height=48,framerate=30/1 ! jpegenc ! rtpjpegpay ! udpsink host=127.0.0.1 port={port}"
        );
        let sender = Self { pipeline: gst::parse::launch(&text).unwrap().downcast().unwrap(), port };
        sender.set(gst::State::Playing);
        sender
    }

    fn set(&self, state: gst::State) {
        self.pipeline.set_state(state).unwrap();
    }

    /// The source text that receives it.
    fn receiver(&self) -> String {
        let caps = "application/x-rtp,media=video,clock-rate=90000,encoding-name=JPEG,payload=26";
        format!("udpsrc port={} caps=\"{caps}\" ! rtpjpegdepay", self.port)
    }
}

impl Drop for Sender {
    fn drop(&mut self) {
        let _ = self.pipeline.set_state(gst::State::Null);
    }
}

fn open(folder: &Folder, views: &[(&str, &str)], timeout_s: f64) -> Harness<Capture> {
    let views: Vec<String> = views.iter().map(|(view, source)| format!("{view} = '{source}'")).collect();
    let params = format!(
        "params = {{ {}, timeout_s = {timeout_s:.1}, tolerance_ms = {TOLERANCE_MS:.1}, open_limit_s = 20.0 }}",
        views.join(", ")
    );
    Harness::open(Setup::new(&params).graph_dir(&folder.0)).unwrap()
}

fn has(out: &Outputs, port: &str) -> bool {
    !out.is_empty(port).unwrap()
}

fn is_pair(out: &Outputs) -> bool {
    has(out, "left") && has(out, "right")
}

#[test]
fn the_living_view_goes_on_and_the_lost_one_is_named() {
    let folder = Folder::new("lost_view");
    let ports = ["left", "right"];
    for lost in [1, 0] {
        let senders = [Sender::start(), Sender::start()];
        let sources = senders.each_ref().map(Sender::receiver);
        let mut node = open(&folder, &[("left", &sources[0]), ("right", &sources[1])], 2.0);
        until(&mut node, is_pair).unwrap();
        until(&mut node, is_pair).unwrap();

        senders[lost].set(gst::State::Null);
        let (mut last, mut newest_ns, mut max_step_ms) = (Instant::now(), i64::MIN, 0.0_f64);
        let mut alone = |out: &Outputs| {
            if out.is_empty(ports[1 - lost]).unwrap() {
                return false;
            }
            let arrived_ns = out.arrived_ns().unwrap();
            assert!(arrived_ns > newest_ns, "an old frame came again");
            (newest_ns, max_step_ms) = (arrived_ns, max_step_ms.max(last.elapsed().as_secs_f64() * 1e3));
            last = Instant::now();
            !has(out, ports[lost])
        };
        // Before it counts as lost, and after.
        let mut before_fault = 0;
        let out = until(&mut node, |out| {
            before_fault += u32::from(alone(out) && out.fault().is_none());
            out.fault().is_some()
        });
        let fault = out.unwrap().fault().unwrap().to_owned();
        let title = ["left view lost", "right view lost"];
        assert!(fault.contains(title[lost]) && !fault.contains(title[1 - lost]), "{fault}");
        assert!(fault.contains(&sources[lost]) && !fault.contains(&sources[1 - lost]), "{fault}");
        assert!(before_fault > 5, "the living view waited for the timeout");
        assert_eq!(node.metric("lost"), Some(1.0));
        let mut after_fault = 0;
        until(&mut node, |out| {
            assert!(out.fault().is_none(), "{:?}", out.fault());
            after_fault += u32::from(alone(out));
            after_fault > 60
        })
        .unwrap();
        assert!(max_step_ms < MAX_STEP_MS, "no frame of the living view for {max_step_ms:.0} ms");

        senders[lost].set(gst::State::Playing);
        let out = until(&mut node, is_pair).unwrap();
        assert!(out.fault().is_none());
        assert_eq!((node.metric("lost"), node.metric("reconnects")), (Some(0.0), Some(1.0)));
        let mut pairs = 0;
        until(&mut node, |out| {
            pairs += u32::from(is_pair(out));
            pairs > 20
        })
        .unwrap();
        assert!(node.metric("skew_ms").is_some_and(|skew| skew <= TOLERANCE_MS), "{:?}", node.metric("skew_ms"));
    }
}

#[test]
fn each_loss_is_a_fault_and_what_returns_first_is_shown_alone() {
    let folder = Folder::new("both_lost");
    let senders = [Sender::start(), Sender::start()];
    let sources = senders.each_ref().map(Sender::receiver);
    let mut node = open(&folder, &[("left", &sources[0]), ("right", &sources[1])], 0.6);
    until(&mut node, is_pair).unwrap();
    let fault =
        |node: &mut Harness<Capture>| until(node, |out| out.fault().is_some()).unwrap().fault().unwrap().to_owned();
    senders[1].set(gst::State::Null);
    let first = fault(&mut node);
    assert!(first.contains("right view lost") && !first.contains("left view"), "{first}");
    senders[0].set(gst::State::Null);
    let second = fault(&mut node);
    assert!(second.contains("left view and the right view lost"), "{second}");
    assert!(second.contains(&sources[0]) && second.contains(&sources[1]), "{second}");
    senders[1].set(gst::State::Playing);
    let out = until(&mut node, |out| has(out, "right")).unwrap();
    assert!(!has(&out, "left") && node.metric("lost") == Some(1.0));
    senders[0].set(gst::State::Playing);
    until(&mut node, is_pair).unwrap();
    assert_eq!(node.metric("lost"), Some(0.0));
}

#[test]
fn a_slow_view_is_waited_for() {
    let folder = Folder::new("slow_view");
    let source = "videotestsrc is-live=true ! video/x-raw,width=64,height=48,framerate=1/1";
    let mut node = open(&folder, &[("left", source), ("right", source)], 10.0);
    let mut pairs = 0;
    until(&mut node, |out| {
        assert_eq!(has(out, "left"), has(out, "right"), "after {pairs} pairs");
        pairs += u32::from(is_pair(out));
        pairs > 3
    })
    .unwrap();
}

#[test]
fn a_view_that_stops_gives_no_pairs_of_old_frames() {
    let folder = Folder::new("stops");
    let source = "videotestsrc is-live=true ! video/x-raw,width=64,height=48,framerate=30/1";
    // The right view fails after 20 frames.
    let stopping = format!("{source} ! identity error-after=20");
    let mut node = open(&folder, &[("left", source), ("right", &stopping)], 0.4);
    let (mut pairs, mut last_ns) = (0, i64::MIN);
    let out = until(&mut node, |out| {
        if has(out, "left") {
            let arrived_ns = out.arrived_ns().unwrap();
            assert!(arrived_ns > last_ns, "an old frame came again");
            last_ns = arrived_ns;
        }
        pairs += u32::from(is_pair(out));
        out.fault().is_some()
    });
    assert!((1..=20).contains(&pairs), "{pairs}");
    let out = out.unwrap();
    assert!(
        !has(&out, "right") && out.fault().is_some_and(|fault| fault.contains("disappeared after")),
        "{:?}",
        out.fault()
    );
    assert_eq!(node.metric("lost"), Some(1.0));
}
