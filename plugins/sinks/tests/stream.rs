//! A live stream as its clients see it: frames identified by number, clients that come, go and stall, several streams on one port, mistakes.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::common::{Decoded, numbered};
use gstreamer::prelude::*;
use gstreamer::{ClockTime, Pipeline, State};
use gstreamer_app::AppSink;
use panoscope_node::Bgr8;
use panoscope_node::harness::{Harness, Setup};
use panoscope_sinks::stream::Stream;

const SIZE_PX: (usize, usize) = (320, 192);
const PATIENCE: Duration = Duration::from_secs(60);

fn open_as(id: &str, params: &str) -> Result<Harness<Stream>, String> {
    let setup = Setup::new(&format!("params = {{ {params} }}")).node_id(id);
    Harness::open(setup).map_err(|error| error.to_string())
}

fn open(params: &str) -> Harness<Stream> {
    open_as("out", params).unwrap()
}

/// A node that shows frames at a fixed rate, in the test's own thread.
struct Source {
    node: Harness<Stream>,
    number: u64,
    max_call: Duration,
    faults: Vec<String>,
}

impl Source {
    fn new(params: &str) -> Self {
        Self::of(open(params), 0)
    }

    fn of(node: Harness<Stream>, number: u64) -> Self {
        Self { node, number, max_call: Duration::ZERO, faults: Vec::new() }
    }

    fn show(&mut self) {
        let picture = numbered(SIZE_PX, self.number % 4096);
        self.node.at_tick(self.number, self.number as i64 * 33_000_000);
        self.node.input_image::<Bgr8>("image", SIZE_PX.0, SIZE_PX.1, &picture);
        let begin = Instant::now();
        let outputs = self.node.process().unwrap();
        self.faults.extend(outputs.fault().map(str::to_owned));
        drop(outputs);
        self.max_call = self.max_call.max(begin.elapsed());
        self.number += 1;
    }

    /// Shows frames at 50 Hz until `done`.
    fn show_until(&mut self, what: &str, mut done: impl FnMut(&mut Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !done(self) {
            let counts = ["consumers", "frames", "held_back"].map(|name| self.metric(name));
            assert!(Instant::now() < end, "{what}: consumers, frames, held back: {counts:?}");
            self.show();
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn metric(&self, name: &str) -> u64 {
        self.node.metric(name).unwrap_or(0.0) as u64
    }

    fn port(&mut self) -> u16 {
        self.show();
        self.metric("port") as u16
    }
}

/// A player.
struct Client {
    source: String,
    pipeline: Pipeline,
    sink: AppSink,
    numbers: Vec<u64>,
}

impl Client {
    fn launch(source: &str) -> Self {
        gstreamer::init().unwrap();
        let text =
            format!("{source} ! decodebin ! videoconvert ! video/x-raw,format=BGR ! appsink name=sink sync=false");
        let pipeline = gstreamer::parse::launch(&text).unwrap().downcast::<Pipeline>().unwrap();
        let sink = pipeline.by_name("sink").unwrap().downcast::<AppSink>().unwrap();
        // A player that cannot connect yet reports it on its bus.
        let _ = pipeline.set_state(State::Playing);
        Self { source: source.to_owned(), pipeline, sink, numbers: Vec::new() }
    }

    /// Reconnects if the first request failed, as on a loaded machine on which the answer took too long. Returns whether it did.
    fn retry(&mut self) -> bool {
        let failed = self.pipeline.bus().unwrap().pop_filtered(&[gstreamer::MessageType::Error]);
        if let Some(message) = &failed {
            println!("asks again after {:?}", message.view());
            *self = Self::launch(&self.source);
        }
        failed.is_some()
    }

    fn connect(port: u16, path: &str, protocol: &str) -> Self {
        Self::launch(&format!(
            "rtspsrc location=rtsp://127.0.0.1:{port}{path} protocols={protocol} latency=0 drop-on-latency=true"
        ))
    }

    /// Whether its newest frame is one of the last that were shown.
    fn is_current(&self, source: &Source) -> bool {
        self.numbers.last().is_some_and(|newest| newest + 25 > source.number)
    }

    /// Takes the decoded frames; returns their number so far.
    fn look(&mut self) -> usize {
        if self.numbers.is_empty() {
            self.retry();
        }
        while let Some(sample) = self.sink.try_pull_sample(ClockTime::ZERO) {
            let picture = Decoded::of(&sample);
            assert_eq!(picture.size_px, SIZE_PX);
            self.numbers.extend(picture.number());
        }
        self.numbers.len()
    }

    /// The state that the pipeline reports, as text.
    fn state(&self) -> String {
        let bus = self.pipeline.bus().unwrap();
        let said = bus.iter_filtered(&[gstreamer::MessageType::Error, gstreamer::MessageType::Warning]);
        let words: Vec<String> = said.map(|message| format!("{:?}", message.view())).collect();
        format!("{:?}, {} pictures, {words:?}", self.pipeline.state(ClockTime::ZERO).1, self.numbers.len())
    }

    fn ended(&self) -> bool {
        let ends = [gstreamer::MessageType::Eos, gstreamer::MessageType::Error];
        self.sink.is_eos() || self.pipeline.bus().unwrap().pop_filtered(&ends).is_some()
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        let _ = self.pipeline.set_state(State::Null);
    }
}

/// Frames that an encoder may hold when the previous client has just left.
const IN_FLIGHT: u64 = 8;

fn grow(numbers: &[u64]) -> bool {
    numbers.windows(2).all(|pair| pair[0] < pair[1])
}

#[test]
fn clients_see_the_pictures_of_every_codec_and_come_and_go() {
    for (codec, protocol) in [("h264", "tcp"), ("h264", "udp"), ("hevc", "tcp"), ("mjpg", "tcp")] {
        let mut source = Source::new(&format!(r#"port = 0, codec = "{codec}""#));
        let port = source.port();
        for _ in 0..5 {
            source.show();
        }
        assert_eq!(source.metric("frames"), 0, "nothing is encoded for nobody");
        for visit in 0..2 {
            let shown_before = source.number;
            let mut client = Client::connect(port, "/live", protocol);
            let what = format!("new pictures of {codec} over {protocol}, visit {visit}");
            source.show_until(&what, |source| client.look() >= 20 && client.is_current(source));
            assert!(grow(&client.numbers), "{codec}: {:?}", client.numbers);
            let first = client.numbers[0];
            assert!(first + IN_FLIGHT >= shown_before, "{first} was shown before {shown_before}: {:?}", client.numbers);
            drop(client);
            source.show_until("the client has left", |source| source.metric("consumers") == 0);
        }
        source.node.finish().unwrap();
    }
}

#[test]
fn streams_share_a_port_and_end_alone() {
    let mut wide = Source::new(r#"port = 0, path = "/wide""#);
    let port = wide.port();
    let params = format!(r#"port = {port}, path = "depth/left", codec = "mjpg""#);
    let mut depth = Source::of(open_as("depth", &params).unwrap(), 2000);
    assert_eq!(depth.port(), port);
    let mut first = Client::connect(port, "/wide", "tcp");
    let mut second = Client::connect(port, "/depth/left", "tcp");
    wide.show_until("both play", |_| {
        depth.show();
        first.look();
        second.look();
        first.numbers.len() >= 10 && second.numbers.len() >= 10
    });
    assert!(first.numbers.iter().all(|n| *n < 2000) && second.numbers.iter().all(|n| *n >= 2000));
    let message = open_as("other", &format!(r#"port = {port}, path = "/wide/""#)).err().expect("a path has one stream");
    assert!(message.contains("`out`") && message.contains("/wide") && message.contains("another `path`"), "{message}");
    depth.node.finish().unwrap();
    drop(depth);
    wide.show_until("the client of the stream that ended is told", |_| {
        // The end comes after the last picture.
        second.look();
        second.ended()
    });
    let before = first.look();
    wide.show_until("the other goes on", |_| first.look() > before + 10);
    // The path is free again.
    drop(open_as("other", &format!(r#"port = {port}, path = "/depth/left""#)).unwrap());
}

#[test]
fn a_stalled_client_holds_up_neither_the_graph_nor_others() {
    let mut source = Source::new(r#"port = 0, bitrate = 20000"#);
    let port = source.port();
    // Asks for the stream and reads nothing more.
    let mut stalled = Client::connect(port, "/live", "tcp");
    let mut good = Client::connect(port, "/live", "tcp");
    let begin = Instant::now();
    source.show_until("both play", |source| {
        assert!(begin.elapsed() < PATIENCE / 2, "good: {}; stalled: {}", good.state(), stalled.state());
        let consumers = source.metric("consumers");
        if consumers < 2 {
            stalled.retry();
        }
        good.look() >= 10 && consumers == 2
    });
    stalled.pipeline.set_state(State::Paused).unwrap();
    source.max_call = Duration::ZERO;
    let before = good.look();
    source.show_until("the other goes on, with new pictures", |source| {
        good.look() >= before + 100 && good.is_current(source)
    });
    assert!(grow(&good.numbers), "{:?}", good.numbers);
    // One that waited for the stalled client would not return: it reads nothing more.
    assert!(source.max_call < Duration::from_secs(5), "a call took {:?}", source.max_call);
}

#[test]
fn a_change_of_size_goes_on_with_a_key_frame() {
    let mut source = Source::new("port = 0");
    let port = source.port();
    let mut client = Client::connect(port, "/live", "tcp");
    source.show_until("it plays", |_| client.look() >= 5);
    let other = (SIZE_PX.0 * 2, SIZE_PX.1);
    let mut wide = 0;
    let end = Instant::now() + PATIENCE;
    while wide < 5 {
        assert!(Instant::now() < end, "pictures of the new size arrive");
        let picture = numbered(other, 77);
        source.node.input_image::<Bgr8>("image", other.0, other.1, &picture).process().unwrap();
        while let Some(sample) = client.sink.try_pull_sample(ClockTime::from_mseconds(20)) {
            let picture = Decoded::of(&sample);
            wide += u32::from(picture.size_px == other && picture.number() == Some(77));
        }
    }
}

#[test]
fn rtp_packets_are_sent_to_an_address() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = socket.local_addr().unwrap().port();
    drop(socket);
    let caps = "application/x-rtp,media=video,clock-rate=90000,encoding-name=H264,payload=96";
    let mut client = Client::launch(&format!("udpsrc address=127.0.0.1 port={port} caps={caps} ! rtph264depay"));
    let mut source = Source::new(&format!(r#"serve = false, push = "udp://127.0.0.1:{port}""#));
    source.show_until("packets arrive", |_| client.look() >= 20);
    assert!(grow(&client.numbers), "{:?}", client.numbers);
    source.node.finish().unwrap();
}

/// An RTSP server that takes a recording and shows it in an appsink.
struct Recorder {
    pictures: std::sync::mpsc::Receiver<u64>,
    port: u16,
    main_loop: gstreamer::glib::MainLoop,
    context: gstreamer::glib::MainContext,
    thread: Option<std::thread::JoinHandle<()>>,
    server: gstreamer_rtsp_server::RTSPServer,
    attached: Option<gstreamer::glib::SourceId>,
}

impl Recorder {
    fn start(port: u16) -> Self {
        use gstreamer_rtsp_server::prelude::*;
        gstreamer::init().unwrap();
        let server = gstreamer_rtsp_server::RTSPServer::new();
        server.set_address("127.0.0.1");
        server.set_service(&port.to_string());
        server.thread_pool().unwrap().set_max_threads(0);
        let factory = gstreamer_rtsp_server::RTSPMediaFactory::new();
        factory.set_transport_mode(gstreamer_rtsp_server::RTSPTransportMode::RECORD);
        factory.set_latency(0);
        factory.set_launch(
            "( rtph264depay name=depay0 ! avdec_h264 ! videoconvert ! video/x-raw,format=BGR ! appsink name=sink sync=false )",
        );
        let (sender, pictures) = std::sync::mpsc::channel();
        factory.connect_media_configure(move |_, media| {
            let sink = media.element().downcast::<gstreamer::Bin>().unwrap().by_name("sink").unwrap();
            let sender = sender.clone();
            let show = move |sink: &AppSink| {
                let sample = sink.pull_sample().map_err(|_| gstreamer::FlowError::Eos)?;
                if let Some(number) = Decoded::of(&sample).number() {
                    let _ = sender.send(number);
                }
                Ok(gstreamer::FlowSuccess::Ok)
            };
            let sink = sink.downcast::<AppSink>().unwrap();
            sink.set_callbacks(gstreamer_app::AppSinkCallbacks::builder().new_sample(show).build());
        });
        server.mount_points().unwrap().add_factory("/taken", factory);
        let context = gstreamer::glib::MainContext::new();
        let main_loop = gstreamer::glib::MainLoop::new(Some(&context), false);
        let attached = Some(server.attach(Some(&context)).unwrap());
        let port = server.bound_port() as u16;
        let (own_loop, own_context) = (main_loop.clone(), context.clone());
        let thread = std::thread::spawn(move || own_context.with_thread_default(|| own_loop.run()).unwrap());
        Self { pictures, port, main_loop, context, thread: Some(thread), server, attached }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        use gstreamer_rtsp_server::prelude::*;
        if let Some(source) = self.attached.take().and_then(|id| self.context.find_source_by_id(&id)) {
            source.destroy();
        }
        let (server, main_loop) = (self.server.clone(), self.main_loop.clone());
        // A client can only be closed by the thread that serves it.
        self.context.invoke(move || {
            server.client_filter(Some(&mut |_, _| gstreamer_rtsp_server::RTSPFilterResult::Remove));
            main_loop.quit();
        });
        self.thread.take().unwrap().join().unwrap();
    }
}

#[test]
fn a_server_that_takes_recordings_is_found_again() {
    let first = Recorder::start(0);
    let port = first.port;
    let mut source = Source::new(&format!(r#"serve = false, push = "rtsp://127.0.0.1:{port}/taken""#));
    let mut numbers = Vec::new();
    source.show_until("pictures arrive", |_| {
        numbers.extend(first.pictures.try_iter());
        numbers.len() >= 10
    });
    assert!(grow(&numbers), "{numbers:?}");
    drop(first);
    source.show_until("the loss is reported", |source| {
        source.faults.iter().any(|fault| fault.contains("cannot send the stream") && fault.contains("/taken"))
    });
    let shown = source.number;
    let second = Recorder::start(port);
    let mut numbers = Vec::new();
    source.show_until("pictures arrive again", |_| {
        numbers.extend(second.pictures.try_iter());
        numbers.len() >= 10
    });
    assert!(grow(&numbers) && numbers[0] >= shown, "{shown}: {numbers:?}");
}

/// Answers the requests of a client that records, up to and including RECORD. Returns the first request.
fn take_recording(client: &mut TcpStream) -> std::io::Result<String> {
    client.set_read_timeout(Some(PATIENCE))?;
    let mut requests = BufReader::new(client.try_clone()?);
    let mut first = String::new();
    loop {
        let (mut line, mut answer, mut body_bytes) = (String::new(), "RTSP/1.0 200 OK\r\nSession: 1\r\n".to_owned(), 0);
        requests.read_line(&mut line)?;
        let is_last = line.starts_with("RECORD");
        first = if first.is_empty() { line } else { first };
        loop {
            let mut field = String::new();
            requests.read_line(&mut field)?;
            match field.split_once(": ") {
                Some(("Content-Length", bytes)) => body_bytes = bytes.trim().parse().expect("a length"),
                Some(("CSeq" | "Transport", _)) => answer += &field,
                Some(_) => {}
                None => break,
            }
        }
        requests.read_exact(&mut vec![0; body_bytes])?;
        write!(client, "{answer}Public: OPTIONS, ANNOUNCE, SETUP, RECORD, TEARDOWN\r\n\r\n")?;
        if is_last {
            return Ok(first);
        }
    }
}

#[test]
fn a_server_that_leaves_is_asked_from_the_start() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let (takes, taken) = std::sync::mpsc::channel();
    let (leave, leaves) = std::sync::mpsc::channel::<()>();
    let server = std::thread::spawn(move || {
        [(); 2].map(|()| {
            let mut client = listener.accept().unwrap().0;
            let first = take_recording(&mut client);
            takes.send(()).unwrap();
            // The second time the sender is gone already.
            let _ = leaves.recv();
            first.unwrap()
        })
    });
    let mut source = Source::new(&format!(r#"serve = false, push = "rtsp://127.0.0.1:{port}/taken""#));
    source.show_until("the server takes the stream", |_| taken.try_recv().is_ok());
    // It leaves while nothing is being sent.
    let pause = Duration::from_millis(300);
    std::thread::sleep(pause);
    leave.send(()).unwrap();
    std::thread::sleep(pause);
    drop(leave);
    source.show_until("the server is asked again", |_| server.is_finished());
    for first in server.join().unwrap() {
        assert!(first.starts_with("OPTIONS "), "{first}");
    }
}

#[test]
fn mistakes_are_named_with_their_remedies() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let cases = [
        (format!("port = {port}"), vec![format!("127.0.0.1:{port}"), "another program uses this port".to_owned()]),
        (
            r#"path = "/my view""#.to_owned(),
            vec!["`/my view`".to_owned(), "contains a space".to_owned(), "such as `/wide`".to_owned()],
        ),
        (r#"path = "/""#.to_owned(), vec!["it is empty".to_owned()]),
        (
            r#"address = "localhost""#.to_owned(),
            vec!["`localhost` is not an IP address".to_owned(), "127.0.0.1".to_owned()],
        ),
        (r#"port = 0, address = "203.0.113.7""#.to_owned(), vec!["no such address".to_owned()]),
        (r#"push = "http://a/b""#.to_owned(), vec!["`http://a/b`".to_owned(), "udp://HOST:PORT".to_owned()]),
        ("serve = false".to_owned(), vec!["has no destination".to_owned(), "`push`".to_owned()]),
    ];
    for (params, words) in cases {
        let message = open_as("out", &params).err().unwrap_or_else(|| panic!("{params} was accepted"));
        for word in words {
            assert!(message.contains(&word), "{params}: {message}");
        }
    }
    let message = open_as("out", r#"codec = "av1""#).err().expect("an unknown codec");
    assert!(message.contains("h264") && message.contains("av1"), "{message}");
}

/// The `q` quantile of latencies.
fn quantile(latencies: &[Duration], q: f64) -> Duration {
    let mut sorted = latencies.to_vec();
    sorted.sort();
    sorted[((sorted.len() as f64 * q) as usize).min(sorted.len() - 1)]
}

/// Latency from the call that shows a frame to the decoded frame at a player on this machine. The figures are printed; the test asserts only that
/// frames do not queue up.
#[test]
fn pictures_arrive_while_they_are_new() {
    const PICTURES: usize = 60;
    const NEW: Duration = Duration::from_secs(2);
    for codec in ["h264", "hevc", "mjpg"] {
        let mut source = Source::new(&format!(r#"port = 0, codec = "{codec}""#));
        let port = source.port();
        let mut client = Client::connect(port, "/live", "tcp");
        let shown = Arc::new(Mutex::new(Vec::<Instant>::new()));
        let (sender, latencies) = std::sync::mpsc::channel();
        let times = Arc::clone(&shown);
        let arrive = move |sink: &AppSink| {
            let sample = sink.pull_sample().map_err(|_| gstreamer::FlowError::Eos)?;
            let now = Instant::now();
            // Picture 0 was shown to learn the port, and has no time; a player may get it all the same.
            let index = Decoded::of(&sample).number().and_then(|number| number.checked_sub(1));
            let time = index.and_then(|index| times.lock().unwrap().get(index as usize).copied());
            if let Some(time) = time {
                let _ = sender.send(now - time);
            }
            Ok(gstreamer::FlowSuccess::Ok)
        };
        let listen = |client: &Client| {
            let callbacks = gstreamer_app::AppSinkCallbacks::builder().new_sample(arrive.clone());
            client.sink.set_callbacks(callbacks.build());
        };
        listen(&client);
        let mut arrived = Vec::new();
        source.show_until(&format!("{PICTURES} new pictures of {codec} in a row"), |_| {
            shown.lock().unwrap().push(Instant::now());
            arrived.extend(latencies.try_iter());
            if arrived.is_empty() && client.retry() {
                listen(&client);
            }
            // The first ones waited for the player to connect.
            arrived.last_chunk::<PICTURES>().is_some_and(|newest| quantile(newest, 0.99) < NEW)
        });
        let settled = &arrived[arrived.len() - PICTURES..];
        println!(
            "stream_latency/{codec}: p50 {:.1} ms, p99 {:.1} ms",
            quantile(settled, 0.5).as_secs_f64() * 1e3,
            quantile(settled, 0.99).as_secs_f64() * 1e3
        );
    }
}
