//! Both nodes as peers of each other: what arrives, slow and hostile programs, lost connections, requests, mistakes.

use crate::common;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use crate::common::{
    PATIENCE, PIXELS, batch_receiver, batch_sender, fill, free_port, pose, receive_until, receiver, send_until, sender,
    tip,
};
use panoscope_igtl::message::{Image, Query, Scalar, Tool, Tracking, TrackingStart, Transform, Verb};
use panoscope_igtl::{Content, Message, Reader, Timestamp};
use panoscope_node::abi::Pose;
use panoscope_node::harness::{Harness, Setup};
use panoscope_node::{Bgr8, Gray16, Rgba8};
use panoscope_openigtlink::receive::Receive;
use panoscope_openigtlink::send::Send;

/// A sender that serves a free port, and the port.
fn server(params: &str) -> (Harness<Send>, u16) {
    let mut node = sender(&format!("port = 0, {params}"));
    fill(&mut node);
    node.process().expect("nobody is there yet");
    let port = node.metric("port").expect("a port") as u16;
    (node, port)
}

/// A bare connection that speaks the protocol.
struct Plain {
    stream: TcpStream,
    reader: Reader,
}

impl Plain {
    fn connect(port: u16) -> Self {
        let end = Instant::now() + PATIENCE;
        loop {
            match TcpStream::connect(("127.0.0.1", port)) {
                Ok(stream) => {
                    stream.set_read_timeout(Some(PATIENCE)).expect("a limit");
                    return Self { stream, reader: Reader::default() };
                }
                Err(error) => assert!(Instant::now() < end, "{error}"),
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn send(&mut self, device: &str, content: Content<'_>) {
        let mut bytes = Vec::new();
        Message::new(device, Timestamp::from_unix_ns(1_500_000_000), content).encode(&mut bytes).expect("it fits");
        self.stream.write_all(&bytes).expect("it is taken");
    }

    /// Waits for a message of a type.
    fn wait<T>(&mut self, kind: &str, take: impl Fn(&Message<'_>) -> T) -> T {
        loop {
            while let Some(raw) = self.reader.next_message().expect("whole messages") {
                if raw.header.kind == kind {
                    return take(&raw.message().expect("it can be read"));
                }
            }
            assert!(self.reader.fill(&mut self.stream).expect("bytes") > 0, "the connection ended before {kind}");
        }
    }
}

#[test]
fn what_is_sent_arrives() {
    for version in 1..=3 {
        let (mut node, port) = server(&format!("version = {version}, cloud_step = 1"));
        let mut other = receiver(&format!("role = 'client', port = {port}"));
        let mut seen = std::collections::BTreeSet::new();
        let mut last_ns = -1;
        receive_until(&mut other, "everything arrives", |out| {
            fill(&mut node);
            node.process().expect("it sends");
            assert!(out.tick().capture_ns > last_ns, "capture times rise");
            last_ns = out.tick().capture_ns;
            if let Ok(picture) = out.plane::<Bgr8>("image") {
                assert!(picture.row(0).iter().chain(picture.row(1)).eq(&PIXELS));
                seen.insert("image");
            }
            if let Ok(pose) = out.value::<Pose>("pose")
                && out.text("names").ok() == Some("CameraToBase")
            {
                let expected = common::pose();
                assert!((pose.a_from_b_wxyz[0] - expected.a_from_b_wxyz[0]).abs() < 1e-6);
                assert_eq!((pose.a_from_b_mm, pose.a, pose.b), (expected.a_from_b_mm, expected.a, expected.b));
                seen.insert("pose");
            }
            match out.text("names") {
                Ok("Tip") => {
                    let points = out.table("points").expect("points");
                    assert_eq!(points.rows().next(), Some(&[1.5, -2.5, 66.0, 0.0][..]));
                    seen.insert("tip");
                }
                Ok("Grasper") => {
                    let points = out.table("points").expect("points");
                    assert_eq!(points.rows().next(), Some(&[13.0, 24.0, 0.0, 5.0][..]));
                    seen.insert("detections");
                }
                _ => {}
            }
            if let Ok(points) = out.cloud("cloud")
                && !points.is_empty()
            {
                assert_eq!((points.len(), points[0].bgr, points[1].x_mm), (2, [0, 51, 255], 3.0));
                seen.insert("cloud");
            }
            if out.text("text").ok() == Some("a text") {
                seen.insert("text");
            }
            seen.len() == 6
        });
    }
}

#[test]
fn one_connection_carries_both_ways() {
    let port = free_port();
    let mut node = sender(&format!("port = {port}"));
    let mut back = receiver(&format!("port = {port}"));
    let mut other = Plain::connect(port);
    other.send(
        "StylusToTracker",
        Content::Transform(Transform { translation_mm: [7.0, 8.0, 9.0], ..Transform::default() }),
    );
    receive_until(&mut back, "the transform arrives", |out| {
        out.value::<Pose>("pose")
            .is_ok_and(|pose| pose.a_from_b_mm == [7.0, 8.0, 9.0] && pose.b.starts_with(b"Stylus\0"))
    });
    send_until(&mut node, "the program gets messages", |node| node.metric("sent").unwrap_or(0.0) > 6.0);
    let text = other.wait("STRING", |message| match &message.content {
        Content::Text(text) => text.text.to_string(),
        other => panic!("{other:?}"),
    });
    assert_eq!(text, "a text");
}

#[test]
fn a_program_that_does_not_read_stalls_nobody_and_its_losses_are_counted() {
    let (mut node, port) = server("queue = 4");
    let mut lazy = Plain::connect(port);
    let big = vec![7_u8; 320 * 240 * 3];
    let (mut longest, end) = (Duration::ZERO, Instant::now() + PATIENCE);
    while node.metric("dropped").unwrap_or(0.0) < 20.0 {
        assert!(Instant::now() < end, "nothing was dropped");
        node.input_image::<Bgr8>("image", 320, 240, &big);
        let begin = Instant::now();
        node.process().expect("it sends");
        longest = longest.max(begin.elapsed());
    }
    assert!(longest < Duration::from_secs(3), "a call took {longest:?}");
    // Another program gets its messages meanwhile.
    let mut quick = Plain::connect(port);
    let found = std::thread::spawn(move || quick.wait("STRING", |_| ()));
    let end = Instant::now() + PATIENCE;
    while !found.is_finished() {
        assert!(Instant::now() < end, "the second program got nothing");
        node.input_text("text", "news");
        node.process().expect("it sends");
        std::thread::sleep(Duration::from_millis(5));
    }
    found.join().expect("no panic");
    // It reads at last, and goes on with whole messages.
    lazy.wait("IMAGE", |message| match &message.content {
        Content::Image(image) => assert_eq!(image.size, [320, 240, 1]),
        other => panic!("{other:?}"),
    });
}

#[test]
fn a_client_connects_again_and_goes_on() {
    let port = free_port();
    let mut node = receiver(&format!("role = 'client', port = {port}"));
    let mut faults = Vec::new();
    for round in 0..2 {
        let mut server = sender(&format!("port = {port}"));
        let end = Instant::now() + PATIENCE;
        loop {
            server.input_value("tip", tip(f64::from(round))).process().expect("it sends");
            let out = node.process().expect("it receives");
            faults.extend(out.fault().map(str::to_owned));
            let row = out.table("points").ok().and_then(|table| table.rows().next().map(|row| row[0]));
            if row == Some(f64::from(round)) {
                break;
            }
            drop(out);
            assert!(Instant::now() < end, "round {round}: {:?}", node.logs());
        }
        server.finish().expect("it ends");
        drop(server);
    }
    let end = Instant::now() + PATIENCE;
    while !node.logs().iter().any(|line| line.message.contains("closed the connection; reconnecting")) {
        assert!(Instant::now() < end, "the loss is reported: {:?}", node.logs());
        faults.extend(node.process().expect("it receives").fault().map(str::to_owned));
    }
    assert!(faults.is_empty(), "a peer that restarts fails no live run: {faults:?}");
}

#[test]
fn hostile_bytes_end_their_connection_and_nothing_else() {
    let port = free_port();
    let mut node = receiver(&format!("port = {port}"));
    let mut good = Plain::connect(port);
    let mut bytes = Vec::new();
    let message = Message::new("A", Timestamp::default(), Content::Transform(Transform::default()));
    message.encode(&mut bytes).expect("it fits");
    let mut long = bytes.clone();
    long[42..50].copy_from_slice(&u64::MAX.to_be_bytes());
    let mut other = bytes.clone();
    other[0..2].copy_from_slice(&[9, 9]);
    for hostile in [
        long,
        other,
        vec![0xFF; 5000],
        b"GET / HTTP/1.1\r\nHost: localhost\r\nAccept: text/html, everything else\r\n\r\n".to_vec(),
    ] {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a limit");
        // It may be closed before everything is written.
        let _ = stream.write_all(&hostile);
        let ended = stream.read(&mut [0; 16]);
        assert!(matches!(ended, Ok(0) | Err(_)), "{ended:?}");
        assert!(!matches!(&ended, Err(error) if error.kind() == std::io::ErrorKind::WouldBlock), "it stays open");
    }
    // A damaged message costs that one only.
    let mut damaged = bytes.clone();
    *damaged.last_mut().expect("bytes") ^= 1;
    good.stream.write_all(&damaged).expect("it is taken");
    good.send("B", Content::Transform(Transform { translation_mm: [4.0, 5.0, 6.0], ..Transform::default() }));
    receive_until(&mut node, "the good program is heard", |out| out.text("names").ok() == Some("B"));
    node.process().expect("it goes on");
    assert_eq!(node.metric("damaged"), Some(5.0));
}

#[test]
fn requests_are_answered_and_steer_what_is_sent() {
    let (mut node, port) = server("");
    let mut other = Plain::connect(port);
    // Nothing was sent to it yet: an answer without content.
    other.send("Nobody", Content::Query(Query::new(Verb::Get, "IMAGE")));
    let is_nothing = other.wait("IMAGE", |message| message.content == Content::Nothing && message.device == "Nobody");
    assert!(is_nothing);
    send_until(&mut node, "it gets messages", |node| node.metric("sent").unwrap_or(0.0) > 10.0);
    other.send("", Content::Query(Query::new(Verb::Get, "STATUS")));
    other.wait("STATUS", |message| match &message.content {
        Content::Status(status) => assert_eq!(status.code, 1),
        other => panic!("{other:?}"),
    });
    // No more pictures, but one where it asks.
    other.send("Panoscope", Content::Query(Query::new(Verb::Stop, "IMAGE")));
    other.wait("RTS_IMAGE", |message| match &message.content {
        Content::Query(Query { verb: Verb::Answer { is_granted }, .. }) => assert!(is_granted),
        other => panic!("{other:?}"),
    });
    let before = node.metric("sent").unwrap_or(0.0);
    send_until(&mut node, "it gets other messages", |node| node.metric("sent").unwrap_or(0.0) > before + 20.0);
    other.send("", Content::Query(Query::new(Verb::Get, "CAPABILITY")));
    let mut images = 0;
    'read: loop {
        while let Some(raw) = other.reader.next_message().expect("whole messages") {
            images += usize::from(raw.header.kind == "IMAGE");
            if raw.header.kind == "CAPABILITY" {
                break 'read;
            }
        }
        assert!(other.reader.fill(&mut other.stream).expect("bytes") > 0);
    }
    assert_eq!(images, 0, "pictures after the stop");
    other.send("Panoscope", Content::Query(Query::new(Verb::Get, "IMAGE")));
    other.wait("IMAGE", |message| assert!(matches!(message.content, Content::Image(_))));
    // Tracking data at 20 Hz at most.
    let start = TrackingStart { interval_ms: 50, coordinates: "".into() };
    other.send("Tracker", Content::Query(Query::new(Verb::StartTracking(start), "TDATA")));
    other.wait("RTS_TDATA", |_| ());
    let (begin, mut calls) = (Instant::now(), 0);
    while begin.elapsed() < Duration::from_millis(400) {
        fill(&mut node);
        node.process().expect("it sends");
        calls += 1;
        std::thread::sleep(Duration::from_millis(2));
    }
    let elapsed = begin.elapsed();
    other.send("", Content::Query(Query::new(Verb::Get, "CAPABILITY")));
    let mut tracked = 0;
    'count: loop {
        while let Some(raw) = other.reader.next_message().expect("whole messages") {
            tracked += usize::from(raw.header.kind == "TDATA");
            if raw.header.kind == "CAPABILITY" {
                break 'count;
            }
        }
        assert!(other.reader.fill(&mut other.stream).expect("bytes") > 0);
    }
    let most = elapsed.as_millis() as usize / 50 + 1;
    assert!((1..=most).contains(&tracked), "{tracked} of {calls} messages in {elapsed:?}");
    // What is not sent in series is refused.
    other.send("", Content::Query(Query::new(Verb::Start(&[]), "STRING")));
    other.wait("RTS_STRING", |message| match &message.content {
        Content::Query(Query { verb: Verb::Answer { is_granted }, .. }) => assert!(!is_granted),
        other => panic!("{other:?}"),
    });
}

#[test]
fn pictures_of_all_formats_and_in_parts_are_put_together() {
    let port = free_port();
    let mut node = receiver(&format!("port = {port}"));
    let mut other = Plain::connect(port);
    let rgba: Vec<u8> = (0..16).collect();
    other.send("A", Content::Image(Image::picture(2, 2, 4, Scalar::Uint8, 1.0, &rgba).expect("small")));
    receive_until(&mut node, "rgba8", |out| {
        out.plane::<Rgba8>("image").is_ok_and(|picture| picture.row(1) == [8, 9, 10, 11, 12, 13, 14, 15])
    });
    let mut part = Image::picture(3, 2, 1, Scalar::Uint16, 1.0, &[0x12, 0x34]).expect("small");
    part.endian = panoscope_igtl::message::Endian::Big;
    (part.part_start, part.part_size) = ([2, 1, 0], [1, 1, 1]);
    other.send("B", Content::Image(part.clone()));
    receive_until(&mut node, "the part", |out| {
        out.plane::<Gray16>("image")
            .is_ok_and(|picture| picture.row(0) == [0, 0, 0] && picture.row(1) == [0, 0, 0x1234])
    });
    (part.part_start, part.part_size, part.pixels) = ([0; 3], [2, 1, 1], &[0, 1, 0, 2]);
    other.send("B", Content::Image(part));
    receive_until(&mut node, "both parts", |out| {
        out.plane::<Gray16>("image")
            .is_ok_and(|picture| picture.row(0) == [1, 2, 0] && picture.row(1) == [0, 0, 0x1234])
    });
    let f64s: Vec<u8> = [0.5_f64, -2.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    other.send("C", Content::Image(Image::picture(2, 1, 1, Scalar::Float64, 1.0, &f64s).expect("small")));
    receive_until(&mut node, "floats", |out| {
        out.plane::<panoscope_node::GrayF32>("image").is_ok_and(|picture| picture.row(0) == [0.5, -2.0])
    });
    // A volume is no picture.
    let mut volume = Image::picture(1, 1, 1, Scalar::Uint8, 1.0, &[1, 2]).expect("small");
    (volume.size, volume.part_size) = ([1, 1, 2], [1, 1, 2]);
    other.send("D", Content::Image(volume));
    other.send("D", Content::Tracking(Tracking { tools: Vec::new() }));
    receive_until(&mut node, "what follows", |out| {
        out.table("points").is_ok_and(|table| table.rows().next().is_none()) && out.text("names").ok() == Some("")
    });
    node.process().expect("it goes on");
    assert_eq!(node.metric("refused"), Some(1.0), "{:?}", node.logs());
}

#[test]
fn only_the_named_device_is_taken_and_its_timestamps_are_capture_times() {
    let port = free_port();
    let mut node = batch_receiver(&format!("port = {port}, device = 'Wanted', a = 'World', b = 'Tool'"));
    let mut other = Plain::connect(port);
    let mut send = |device: &str, seconds: u32, x: f32| {
        let content = Content::Transform(Transform { translation_mm: [x, 0.0, 0.0], ..Transform::default() });
        let mut bytes = Vec::new();
        let message = Message::new(device, Timestamp { seconds, fraction: 0 }, content);
        message.encode(&mut bytes).expect("it fits");
        other.stream.write_all(&bytes).expect("it is taken");
    };
    for (device, seconds, x) in [("Other", 50, 1.0), ("Wanted", 100, 2.0), ("Wanted", 103, 3.0), ("Wanted", 101, 4.0)] {
        send(device, seconds, x);
    }
    let mut times = Vec::new();
    receive_until(&mut node, "three transforms", |out| {
        if let Ok(pose) = out.value::<Pose>("pose") {
            assert!(pose.a.starts_with(b"World\0") && pose.b.starts_with(b"Tool\0"));
            times.push((pose.a_from_b_mm[0], out.tick().capture_ns));
        }
        times.len() == 3
    });
    let (first, second, third) = (times[0].1, times[1].1, times[2].1);
    assert_eq!(times.iter().map(|(x, _)| *x).collect::<Vec<_>>(), [2.0, 3.0, 4.0]);
    assert_eq!(second - first, 3_000_000_000);
    assert!(third > second, "they never go back");
}

#[test]
fn a_batch_loses_nothing_and_ends_with_its_connection() {
    let port = free_port();
    const COUNT: u32 = 2000;
    let sending = std::thread::spawn(move || {
        let mut node = batch_sender(&format!("port = {port}, queue = 2"));
        let end = Instant::now() + PATIENCE;
        // Without a program there is nobody to send to.
        while node.metric("peers").unwrap_or(0.0) == 0.0 {
            assert!(Instant::now() < end, "nobody connects");
            node.input_text("text", "wait").process().expect("it sends");
            std::thread::sleep(Duration::from_millis(5));
        }
        for k in 0..COUNT {
            node.input_value("tip", tip(f64::from(k))).process().expect("it sends");
        }
        node.finish().expect("it ends");
        assert_eq!(node.metric("dropped"), Some(0.0));
    });
    let mut node = batch_receiver(&format!("role = 'client', port = {port}, queue = 2"));
    let mut next = 0;
    receive_until(&mut node, "the end", |out| {
        if out.text("names").ok() == Some("Tip") {
            let table = out.table("points").expect("points");
            assert_eq!(table.rows().next().map(|row| row[0]), Some(f64::from(next)));
            next += 1;
        }
        out.ended()
    });
    assert_eq!(next, COUNT);
    sending.join().expect("no panic");
}

#[test]
fn two_runs_of_a_batch_send_the_same_bytes() {
    let run = || {
        let port = free_port();
        let mut node = batch_sender(&format!("port = {port}, version = 2"));
        let mut other = Plain::connect(port);
        let end = Instant::now() + PATIENCE;
        while node.metric("peers").unwrap_or(0.0) == 0.0 {
            assert!(Instant::now() < end, "nobody connects");
            node.input_empty("text").process().expect("it sends");
        }
        node.at_tick(5, 1_234_567_890);
        fill(&mut node);
        node.process().expect("it sends");
        node.finish().expect("it ends");
        drop(node);
        let mut bytes = Vec::new();
        other.stream.read_to_end(&mut bytes).expect("until the end");
        // The last message, STATUS, is about the end and carries the time of day.
        let mut reader = Reader::default();
        let mut rest = bytes.as_slice();
        while reader.fill(&mut rest).expect("bytes in memory") > 0 {}
        let mut all = Vec::new();
        while let Some(raw) = reader.next_message().expect("whole messages") {
            if raw.header.kind != "STATUS" {
                assert_eq!(raw.header.time.unix_ns(), 1_234_567_890);
                all.push(raw.bytes.to_vec());
            }
        }
        all
    };
    let (first, second) = (run(), run());
    assert_eq!(first.len(), 6);
    assert_eq!(first, second);
}

fn problems<N: panoscope_node::Node>(params: &str, connected: &[&str]) -> String {
    let setup = Setup::new(&format!("params = {{ {params} }}"));
    let found = Harness::<N>::problems(&setup, connected).expect("the parameters are declared");
    found.iter().map(|problem| format!("{problem:?}")).collect::<Vec<_>>().join("\n")
}

#[test]
fn mistakes_are_named_before_anything_is_opened() {
    for (params, words) in [
        ("address = 'localhost'", "is not an IP address to listen on"),
        ("role = 'client', address = ''", "is not the name of a machine"),
        ("role = 'client', address = '10.0.0.1:18944'", ""),
        ("role = 'client', port = 0", "cannot connect to port 0"),
        ("image_name = 'a name of more than 20 bytes'", "a device name has at most 20"),
    ] {
        let found = problems::<Send>(params, &["image"]);
        assert!(found.contains(words), "{params}: {found}");
    }
    assert!(problems::<Send>("", &[]).contains("nothing is sent"));
    assert_eq!(problems::<Send>("", &["pose"]), "");
    assert!(problems::<Receive>("a = 'a name of more than 15 bytes'", &[]).contains("at most 15"));
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("bound").port();
    let error = Harness::<Send>::from_toml(&format!("params = {{ port = {port} }}")).err().expect("it is taken");
    assert!(error.to_string().contains("another program uses this port"), "{error}");
    let _ = pose();
}

#[test]
fn other_machines_are_served_on_the_users_word_only() {
    let node = sender("port = 0, address = '0.0.0.0'");
    assert!(node.logs().iter().any(|line| line.message.contains("there is no password")), "{:?}", node.logs());
    let node = sender("port = 0");
    assert!(node.logs().iter().any(|line| line.message.contains("serves 127.0.0.1:")), "{:?}", node.logs());
    assert!(!node.logs().iter().any(|line| line.message.contains("password")));
}

#[test]
fn a_tool_out_of_view_is_not_sent() {
    let (mut node, port) = server("poses_as = 'tracking'");
    let mut other = Plain::connect(port);
    let end = Instant::now() + PATIENCE;
    while node.metric("sent").unwrap_or(0.0) < 3.0 {
        assert!(Instant::now() < end, "nothing was sent");
        let mut lost = tip(1.0);
        (lost.xyz_valid, lost.xyz_mm) = (0, [f64::NAN; 3]);
        node.input_value("tip", lost).input_value("pose", pose()).process().expect("it sends");
        std::thread::sleep(Duration::from_millis(5));
    }
    let names = other.wait("TDATA", |message| match &message.content {
        Content::Tracking(tracking) => {
            tracking.tools.iter().map(|tool: &Tool<'_>| tool.name.to_string()).collect::<Vec<_>>()
        }
        other => panic!("{other:?}"),
    });
    assert_eq!(names, ["CameraToBase"]);
}
