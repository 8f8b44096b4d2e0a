//! Two RTSP streams whose server is killed and started again. The number in every frame is the time at which it was drawn, so that the age of what is
//! shown can be read from it.
//!
//! The ordinary form lasts some seconds. PANOSCOPE_RTSP_SECONDS and PANOSCOPE_RTSP_KILLS choose the duration and how often the server is killed:
//! `PANOSCOPE_RTSP_SECONDS=600 PANOSCOPE_RTSP_KILLS=10 cargo nextest run -p panoscope-capture rtsp::a_server --no-capture`

use crate::common;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::{Folder, bgr_caps, number, scene};
use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app::AppSrc;
use gstreamer_rtsp_server::prelude::*;
use gstreamer_rtsp_server::{RTSPMediaFactory, RTSPServer};
use panoscope_capture::capture::Capture;
use panoscope_media::input::monotonic_ns;
use panoscope_node::harness::{Harness, Setup};

const SIZE: (usize, usize) = (320, 240);
const FPS: f64 = 30.0;
const PERIOD_NS: i64 = 33_333_333;
/// Set in the child process: the port of its server.
const PORT: &str = "PANOSCOPE_RTSP_PORT";
/// Set in the child process: rate of the frames, whatever their timestamps say.
const RATE: &str = "PANOSCOPE_RTSP_RATE";
/// A frame older than this when it is shown is too old, ms.
const OLD_MS: f64 = 1000.0;

fn number_now() -> usize {
    (monotonic_ns() / PERIOD_NS) as usize & 0xFFFF
}

/// Draws frames as long as the process lives.
fn feed(source: &AppSrc, rate_hz: f64) {
    let begin = Instant::now();
    for index in 0.. {
        let due = Duration::from_secs_f64(index as f64 / rate_hz);
        std::thread::sleep(due.saturating_sub(begin.elapsed()));
        let mut buffer = common::buffer(scene(number_now(), SIZE), index, FPS);
        // Times count at 30 per second also where pictures come at another rate; else they are those of the clock.
        if source.current_state() != gst::State::Playing {
            continue;
        }
        if rate_hz == FPS {
            let begin = source.base_time().map(|base| gst::SystemClock::obtain().time().saturating_sub(base));
            buffer.get_mut().unwrap().set_pts(begin);
        }
        // It refuses pictures while the server prepares it.
        let _ = source.push_buffer(buffer);
    }
}

/// Not a test: the server, in a process that the tests kill.
#[test]
fn server_process() {
    let Ok(port) = std::env::var(PORT) else { return };
    let rate_hz: f64 = std::env::var(RATE).unwrap().parse().unwrap();
    panoscope_media::init().unwrap();
    let server = RTSPServer::new();
    server.set_service(&port);
    for path in ["/left", "/right"] {
        let factory = RTSPMediaFactory::new();
        factory.set_launch(&format!(
            "( appsrc name=frames is-live=true format=time max-buffers=1 leaky-type=downstream caps={} ! videoconvert \
             ! x264enc tune=zerolatency speed-preset=ultrafast key-int-max=10 bitrate=4000 ! video/x-h264,profile=baseline ! rtph264pay name=pay0 pt=96 )",
            bgr_caps(SIZE, FPS)
        ));
        factory.set_shared(true);
        factory.connect_media_configure(move |_, media| {
            let bin: gst::Bin = media.element().downcast().unwrap();
            let source: AppSrc = bin.by_name("frames").unwrap().downcast().unwrap();
            std::thread::spawn(move || feed(&source, rate_hz));
        });
        server.mount_points().unwrap().add_factory(path, factory);
    }
    let _source = server.attach(None).unwrap();
    println!("server is ready");
    gst::glib::MainLoop::new(None, false).run();
}

struct Server(Child);

impl Server {
    /// Starts a server and waits until it answers.
    fn start(port: u16, rate_hz: f64) -> Self {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "rtsp::server_process", "--nocapture"])
            .env(PORT, port.to_string())
            .env(RATE, rate_hz.to_string())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        assert!(lines.any(|line| line.unwrap().contains("server is ready")), "the server did not start");
        // What follows is not read; the pipe stays open.
        std::thread::spawn(move || lines.for_each(drop));
        Self(child)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// Age of the frame with this number, ms.
fn age_ms(number: usize) -> f64 {
    let periods = (number_now() as i64 - number as i64).rem_euclid(0x1_0000);
    let periods = if periods > 0x8000 { periods - 0x1_0000 } else { periods };
    periods as f64 * PERIOD_NS as f64 * 1e-6
}

fn quantiles(values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| {
        values
            .get(((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1)))
            .copied()
            .unwrap_or(f64::NAN)
    };
    format!("median {:.1}, 99 % {:.1}, largest {:.1}", at(0.5), at(0.99), at(1.0))
}

#[test]
fn a_server_that_is_killed_comes_back_and_no_old_picture_is_shown() {
    let (seconds, kills) =
        (from_environment("PANOSCOPE_RTSP_SECONDS", 15), from_environment("PANOSCOPE_RTSP_KILLS", 3));
    let folder = Folder::new("rtsp");
    let port = free_port();
    let mut server = Some(Server::start(port, FPS));
    let address = |path: &str| format!("rtsp://127.0.0.1:{port}/{path}");
    let params = format!(r#"left = "{}", right = "{}", open_limit_s = 20.0"#, address("left"), address("right"));
    let mut node =
        Harness::<Capture>::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&folder.0)).unwrap();
    let (mut pairs, mut ages, mut latencies, mut skews, mut back, mut faults) =
        (0, Vec::new(), Vec::new(), Vec::new(), Vec::new(), 0);
    let (mut old, mut differing, mut unread) = (0, 0, 0);
    let mut last = None;
    let mut restarted: Option<Instant> = None;
    let begin = Instant::now();
    let phase = Duration::from_secs_f64(seconds as f64 / (kills + 1) as f64);
    let mut killed = 0;
    while begin.elapsed() < Duration::from_secs(seconds) || killed < kills || restarted.is_some() {
        if killed < kills && begin.elapsed() > phase * (killed as u32 + 1) && restarted.is_none() {
            killed += 1;
            drop(server.take());
            let died = Instant::now();
            // Down for a while: what is shown meanwhile can only be old.
            while died.elapsed() < Duration::from_millis(1500) {
                let out = node.process().unwrap();
                faults += u64::from(out.fault().is_some());
                if !out.is_empty("left").unwrap() && died.elapsed() > Duration::from_secs(1) {
                    old += 1;
                }
            }
            server = Some(Server::start(port, FPS));
            restarted = Some(Instant::now());
        }
        let out = node.process().unwrap();
        faults += u64::from(out.fault().is_some());
        // The view that is back first is shown alone.
        if out.is_empty("left").unwrap() || out.is_empty("right").unwrap() {
            assert!(restarted.is_none_or(|since| since.elapsed() < Duration::from_secs(30)), "{:?}", node.logs());
            continue;
        }
        if let Some(since) = restarted.take() {
            back.push(since.elapsed().as_secs_f64());
        }
        let (Some(left), Some(right)) = (number(&out, "left"), number(&out, "right")) else {
            unread += 1;
            let plane = out.plane::<panoscope_node::Bgr8>("left").unwrap();
            println!(
                "a picture without a number, bytes at its top: {:?}",
                &plane.row(16)[..3 * SIZE.0].iter().step_by(15).collect::<Vec<_>>()
            );
            continue;
        };
        pairs += 1;
        let age = age_ms(left).max(age_ms(right));
        let is_again = last.is_some_and(|last: usize| (left as i64 - last as i64).rem_euclid(0x1_0000) > 0x8000);
        old += u64::from(age > OLD_MS || is_again);
        last = Some(left);
        differing += u64::from((left as i64 - right as i64).abs() > 1);
        ages.push(age);
        latencies.push(node.metric("latency_ms").unwrap());
        skews.push(node.metric("skew_ms").unwrap());
    }
    let metric = |name: &str| node.metric(name).unwrap_or(f64::NAN);
    println!("{pairs} pairs in {seconds} s; server killed {killed} times, {faults} faults");
    println!("drawn to shown, ms: {}", quantiles(&mut ages));
    println!("arrival to shown, ms: {}", quantiles(&mut latencies));
    println!("skew of arrival, ms: {}", quantiles(&mut skews));
    println!("back after the server's start, s: {back:.2?}");
    println!("dropped {}, unpaired {}, damaged {}", metric("dropped"), metric("unpaired"), metric("damaged"));
    println!("old pictures shown: {old}; pairs of different times: {differing}; pictures without a number: {unread}");
    assert_eq!((old, unread), (0, 0));
    assert_eq!(killed, kills);
    assert!(faults >= kills, "{faults} faults");
    // Two free-running streams may be half a period apart, where jitter leaves many pictures without a partner.
    assert!(pairs > 3 * seconds, "{pairs} pairs");
    // Half a period apart at most, and drawn by two threads.
    assert!(differing * 20 <= pairs, "{differing} of {pairs} pairs hold different times");
}

#[test]
fn a_camera_that_counts_at_another_rate_is_stamped_by_arrival() {
    let folder = Folder::new("rtsp_slow");
    let port = free_port();
    let _server = Server::start(port, 10.0);
    let params = format!(r#"left = "rtsp://127.0.0.1:{port}/left", open_limit_s = 20.0"#);
    let mut node =
        Harness::<Capture>::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&folder.0)).unwrap();
    let (mut times, mut oldest): (Vec<(i64, usize)>, f64) = (Vec::new(), 0.0);
    for _ in 0..30 {
        let out = node.process().unwrap();
        if out.is_empty("left").unwrap() {
            continue;
        }
        let drawn = number(&out, "left").unwrap();
        times.push((out.tick().capture_ns, drawn));
        oldest = oldest.max((node.metric("latency_ms").unwrap() - age_ms(drawn)).abs());
    }
    // As much time as passed at the camera, however regularly it drew; by its stamps it would be a third.
    let ((first_ns, first), (last_ns, last)) = (times[0], times[times.len() - 1]);
    let drawn_ns = (last as i64 - first as i64).rem_euclid(0x1_0000) * PERIOD_NS;
    let ratio = (last_ns - first_ns) as f64 / drawn_ns as f64;
    assert!((0.85..1.15).contains(&ratio), "{ratio}: {times:?}");
    // The age that the node states is that of the drawing, but for encoding and sending.
    assert!(oldest < 500.0, "{oldest}");
}
