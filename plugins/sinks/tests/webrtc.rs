//! A live stream as browsers see it: Chromium opens the node's page, and the pixels of its video are read back.

use crate::chromium;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use crate::chromium::{Browser, Page};
use crate::common::{number_in, numbered};
use panoscope_node::Bgr8;
use panoscope_node::harness::{Harness, Setup};
use panoscope_sinks::webrtc::WebRtc;
use panoscope_testing::skipped;

const SIZE_PX: (usize, usize) = (320, 192);
const PATIENCE: Duration = Duration::from_secs(90);

/// Draws the video to a canvas and reads its pixels back, as BGR; empty before the first frame.
const READ: &str = r#"(() => {
    const video = document.querySelector("video");
    if (!video || !video.videoWidth) return null;
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(video, 0, 0);
    const rgba = context.getImageData(0, 0, canvas.width, canvas.height).data;
    let bgr = "";
    for (let i = 0; i < rgba.length; i += 4) bgr += String.fromCharCode(rgba[i + 2], rgba[i + 1], rgba[i]);
    return { width: canvas.width, height: canvas.height, bgr: btoa(bgr), state: document.getElementById("state").textContent };
})()"#;

fn open_as(id: &str, params: &str) -> Result<Harness<WebRtc>, String> {
    let setup = Setup::new(&format!("params = {{ {params} }}")).node_id(id);
    Harness::open(setup).map_err(|error| error.to_string())
}

/// A node that shows frames at a fixed rate, in the test's own thread.
struct Source {
    node: Harness<WebRtc>,
    number: u64,
    max_call: Duration,
}

impl Source {
    fn new(params: &str) -> Self {
        Self::of(open_as("out", params).unwrap(), 1)
    }

    fn of(node: Harness<WebRtc>, number: u64) -> Self {
        let mut source = Self { node, number, max_call: Duration::ZERO };
        source.show();
        source
    }

    fn show(&mut self) {
        let picture = numbered(SIZE_PX, self.number);
        self.node.at_tick(self.number, self.number as i64 * 33_000_000);
        self.node.input_image::<Bgr8>("image", SIZE_PX.0, SIZE_PX.1, &picture);
        let begin = Instant::now();
        self.node.process().unwrap();
        self.max_call = self.max_call.max(begin.elapsed());
        self.number += 1;
    }

    /// Shows frames at 50 Hz until `done`.
    fn show_until<T>(&mut self, what: &str, mut done: impl FnMut(&mut Self) -> Option<T>) -> T {
        let end = Instant::now() + PATIENCE;
        loop {
            if let Some(result) = done(self) {
                return result;
            }
            let counts = ["viewers", "frames", "replaced", "held_back"].map(|name| self.metric(name));
            assert!(Instant::now() < end, "{what}: viewers, frames, replaced, held back: {counts:?}");
            self.show();
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn metric(&self, name: &str) -> u64 {
        self.node.metric(name).unwrap_or(0.0) as u64
    }

    fn at(&self) -> String {
        format!("127.0.0.1:{}", self.metric("port"))
    }

    fn page(&self) -> String {
        format!("http://{}/live", self.at())
    }
}

fn base64(text: &str) -> Vec<u8> {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut bytes, mut bits, mut count) = (Vec::new(), 0_u32, 0);
    for digit in text.bytes().filter(|digit| *digit != b'=') {
        bits = bits << 6 | DIGITS.iter().position(|known| *known == digit).unwrap() as u32;
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    bytes
}

/// A browser page that plays the stream, and the numbers of the frames that it showed.
struct Player {
    browser: Browser,
    page: Page,
    numbers: Vec<u64>,
    state: String,
    worst_colour: u8,
}

impl Player {
    fn open(name: &str, url: &str) -> Self {
        let mut browser = Browser::start(name);
        let page = browser.open(url);
        Self { browser, page, numbers: Vec::new(), state: String::new(), worst_colour: 0 }
    }

    /// Reads the frame that is shown; returns the number of different ones so far.
    fn look(&mut self) -> usize {
        let read = self.browser.evaluate(&self.page, READ);
        let Some(bgr) = read["bgr"].as_str().map(base64) else { return 0 };
        assert_eq!((read["width"].as_u64(), read["height"].as_u64()), (Some(320), Some(192)));
        self.state = read["state"].as_str().unwrap().to_owned();
        if let Some(number) = number_in(&bgr, SIZE_PX).filter(|number| *number > 0)
            && self.numbers.last() != Some(&number)
        {
            self.numbers.push(number);
            self.worst_colour = self.worst_colour.max(colour_error(&bgr, number));
        }
        self.numbers.len()
    }
}

/// Maximum difference from the frame of this number, in the middle of small squares of the coloured half, except for the ones where red jumps.
fn colour_error(bgr: &[u8], number: u64) -> u8 {
    let sent = numbered(SIZE_PX, number);
    let mut worst = 0;
    for y in (SIZE_PX.1 / 2 + 16..SIZE_PX.1 - 16).step_by(16) {
        for x in (16..SIZE_PX.0 - 16).step_by(16) {
            let at = (y * SIZE_PX.0 + x) * 3;
            if (24..176).contains(&sent[at + 2]) {
                worst = (0..3).map(|c| bgr[at + c].abs_diff(sent[at + c])).fold(worst, u8::max);
            }
        }
    }
    worst
}

fn grow(numbers: &[u64]) -> bool {
    numbers.windows(2).all(|pair| pair[0] < pair[1])
}

#[test]
fn browsers_show_the_pictures_and_one_that_is_killed_leaves_the_others_alone() {
    if !chromium::is_there() {
        return skipped!("no Chromium: `cargo xtask setup` installs it");
    }
    if !chromium::has_network() {
        return skipped!("no network: Chromium does not connect by WebRTC without one");
    }
    let mut source = Source::new("port = 0");
    for _ in 0..5 {
        source.show();
    }
    assert_eq!(source.metric("frames"), 0, "nothing is encoded for nobody");
    let mut first = Player::open("first", &source.page());
    let mut second = Player::open("second", &source.page());
    source.show_until("both play", |_| (first.look().min(second.look()) >= 15).then_some(()));
    assert_eq!(source.metric("viewers"), 2);
    for player in [&first, &second] {
        assert!(grow(&player.numbers), "{:?}", player.numbers);
        let newest = *player.numbers.last().unwrap();
        assert!(newest + 25 > source.number, "{newest} of {}", source.number);
        assert!(player.state.starts_with("connected for "), "{}", player.state);
        assert!(player.worst_colour < 30, "a colour is {} off", player.worst_colour);
    }
    second.browser.kill();
    source.max_call = Duration::ZERO;
    source.show_until("the killed one is removed", |source| {
        first.look();
        (source.metric("viewers") == 1).then_some(())
    });
    let before = first.look();
    source.show_until("the other goes on", |_| (first.look() >= before + 15).then_some(()));
    assert!(grow(&first.numbers), "{:?}", first.numbers);
    assert!(source.max_call < Duration::from_millis(500), "a call took {:?}", source.max_call);
    // Pictures of another size begin with a key frame; H.264 has even sizes.
    let end = Instant::now() + PATIENCE;
    while first.browser.evaluate(&first.page, READ)["width"] != 642 {
        assert!(Instant::now() < end, "pictures of the new size arrive");
        let picture = numbered((641, 361), 77);
        source.node.input_image::<Bgr8>("image", 641, 361, &picture).process().unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
    // A picture that stands still is named.
    let end = Instant::now() + PATIENCE;
    let mut state = serde_json::Value::Null;
    while !state.as_str().is_some_and(|state| state.contains("no new frame for ")) {
        assert!(Instant::now() < end, "{state}");
        std::thread::sleep(Duration::from_millis(100));
        state = first.browser.evaluate(&first.page, "document.getElementById('state').textContent");
    }
    assert_eq!(first.browser.evaluate(&first.page, "document.querySelector('video').className"), "old");
    // A page that is closed says so.
    first.browser.evaluate(&first.page, "leave()");
    source.show_until("the page has left", |source| (source.metric("viewers") == 0).then_some(()));
    source.node.finish().unwrap();
}

/// Status, head and body of the response to a request.
fn ask(at: &str, request: &str, fields: &str, body: &[u8]) -> (u16, String, String) {
    let mut stream = TcpStream::connect(at).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let length = body.len();
    let host = if fields.contains("Host:") { String::new() } else { format!("Host: {at}\r\n") };
    let head = format!("{request} HTTP/1.1\r\n{host}{fields}Content-Length: {length}\r\n\r\n");
    stream.write_all(head.as_bytes()).unwrap();
    // A server that refuses a long body does not read all of it.
    let _ = stream.write_all(body);
    let mut answer = Vec::new();
    let read = stream.read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{request}: {read:?}: {answer}"));
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    (status, head.to_lowercase(), body.to_owned())
}

const IS_SDP: &str = "Content-Type: application/sdp\r\n";

/// An offer of audio and of H.264 video whose sender never connects.
fn offer() -> String {
    let digest = ["0A"; 32].join(":");
    let ice = format!(
        "a=ice-ufrag:abcd\r\na=ice-pwd:0123456789012345678901\r\na=fingerprint:sha-256 {digest}\r\na=setup:actpass\r\n"
    );
    format!(
        "v=0\r\no=- 1 2 IN IP4 127.0.0.1\r\ns=-\r\nt=0 0\r\na=group:BUNDLE 0 1\r\n\
         m=audio 9 UDP/TLS/RTP/SAVPF 111\r\nc=IN IP4 0.0.0.0\r\n{ice}a=mid:0\r\na=recvonly\r\na=rtcp-mux\r\n\
         a=rtpmap:111 opus/48000/2\r\n\
         m=video 9 UDP/TLS/RTP/SAVPF 102\r\nc=IN IP4 0.0.0.0\r\n{ice}a=mid:1\r\na=recvonly\r\na=rtcp-mux\r\n\
         a=rtpmap:102 H264/90000\r\na=fmtp:102 packetization-mode=1;profile-level-id=42e01f\r\n"
    )
}

#[test]
fn offers_are_answered_with_one_address_of_this_machine() {
    let source = Source::new("port = 0");
    let at = source.at();
    let (status, head, answer) = ask(&at, "POST /live", IS_SDP, offer().as_bytes());
    assert!(status == 201 && head.contains("content-type: application/sdp"), "{head}\n{answer}");
    let media: Vec<&str> = answer.lines().filter(|line| line.starts_with("m=")).collect();
    assert!(media[0].starts_with("m=audio 0 ") && media[1].starts_with("m=video ") && media.len() == 2, "{answer}");
    let candidates: Vec<&str> = answer.lines().filter(|line| line.starts_with("a=candidate:")).collect();
    assert!(!candidates.is_empty(), "{answer}");
    for candidate in candidates {
        assert!(candidate.contains(" UDP ") && candidate.contains(" 127.0.0.1 "), "{candidate}");
        assert!(candidate.contains(" typ host"), "{candidate}");
    }
    let place = head.lines().find_map(|line| line.strip_prefix("location: ")).unwrap().trim().to_owned();
    assert_eq!(ask(&at, &format!("PATCH {place}"), "", b"").0, 405);
    assert_eq!(ask(&at, "DELETE /live/viewers/0123", "", b"").0, 404);
    assert_eq!(ask(&at, &format!("DELETE {place}"), "", b"").0, 200);
    assert_eq!(ask(&at, &format!("DELETE {place}"), "", b"").0, 404);
}

#[test]
fn malformed_and_foreign_requests_are_refused_and_nothing_is_lost() {
    let mut source = Source::new("port = 0");
    let at = source.at();
    let good = offer();
    let no_codec = good.replace("H264", "AV1");
    let no_video = good.replace("m=video", "m=text");
    let control = good.replace("abcd", "ab\u{1}d");
    let cases: &[(&str, &str, &[u8], u16, &str)] = &[
        ("POST /live", IS_SDP, b"", 400, "not an SDP"),
        ("POST /live", IS_SDP, b"\xff\0\xfe", 400, "not an SDP"),
        ("POST /live", IS_SDP, b"v=0\r\n", 400, "no video"),
        ("POST /live", IS_SDP, no_codec.as_bytes(), 400, "H.264"),
        ("POST /live", IS_SDP, no_video.as_bytes(), 400, "recvonly"),
        ("POST /live", IS_SDP, control.as_bytes(), 400, "ice-ufrag"),
        ("POST /live", IS_SDP, &good.as_bytes()[..good.len() / 2], 400, "offer"),
        ("POST /live", IS_SDP, &[b'v'; (64 << 10) + 1], 413, "65536 bytes"),
        ("POST /live", "Content-Type: text/plain\r\n", good.as_bytes(), 415, "application/sdp"),
        ("POST /live", "", good.as_bytes(), 415, "application/sdp"),
        ("PUT /live", IS_SDP, good.as_bytes(), 405, "POST"),
        ("POST /other", IS_SDP, good.as_bytes(), 404, "/live"),
        ("GET /", "", b"", 404, "/live"),
        ("GET /live", "Host: panoscope.example\r\n", b"", 403, "IP address"),
        ("POST /live", "Host: 127.0.0.1.example\r\n", good.as_bytes(), 403, "IP address"),
        (
            "POST /live",
            "Origin: http://panoscope.example\r\nContent-Type: application/sdp\r\n",
            good.as_bytes(),
            403,
            "own page",
        ),
        ("POST /live", "Origin: null\r\nContent-Type: application/sdp\r\n", good.as_bytes(), 403, "own page"),
    ];
    for (request, fields, body, status, words) in cases {
        let (given, _, text) = ask(&at, request, fields, body);
        assert_eq!(given, *status, "{request} {fields}: {text}");
        assert!(text.contains(words), "{request} {fields}: {text}");
        source.show();
    }
    let (status, head, page) = ask(&at, "GET /live", "", b"");
    assert!(status == 200 && head.contains("content-security-policy: default-src 'none'"), "{head}");
    assert!(page.contains("<video") && !page.contains("http"), "the page loads nothing from elsewhere");
    // Bytes that are no HTTP, and a client that sends nothing, take no seat.
    let _silent = TcpStream::connect(&at).unwrap();
    TcpStream::connect(&at).unwrap().write_all(&[0xff; 4096]).unwrap();
    assert_eq!(ask(&at, "POST /live", IS_SDP, good.as_bytes()).0, 201);
    source.node.finish().unwrap();
}

#[test]
fn seats_are_counted_and_streams_share_a_port() {
    let mut wide = Source::new(r#"port = 0, path = "/wide""#);
    let at = wide.at();
    let port = wide.metric("port");
    let params = format!(r#"port = {port}, path = "depth/left""#);
    let mut depth = Source::of(open_as("depth", &params).unwrap(), 1);
    assert_eq!(depth.metric("port"), port);
    let mut places = Vec::new();
    for _ in 0..8 {
        let (status, head, answer) = ask(&at, "POST /wide", IS_SDP, offer().as_bytes());
        assert_eq!(status, 201, "{answer}");
        places.push(head.lines().find_map(|line| line.strip_prefix("location: ")).unwrap().trim().to_owned());
    }
    let (status, _, words) = ask(&at, "POST /wide", IS_SDP, offer().as_bytes());
    assert!(status == 503 && words.contains("8 viewers"), "{words}");
    assert_eq!(ask(&at, "POST /depth/left", IS_SDP, offer().as_bytes()).0, 201, "another node has its own seats");
    assert_eq!(ask(&at, &format!("DELETE {}", places[3]), "", b"").0, 200);
    assert_eq!(ask(&at, "POST /wide", IS_SDP, offer().as_bytes()).0, 201, "a seat is free again");
    let message = open_as("other", &format!(r#"port = {port}, path = "/wide/""#)).err().expect("a path has one stream");
    assert!(message.contains("`out`") && message.contains("/wide") && message.contains("another `path`"), "{message}");
    depth.node.finish().unwrap();
    drop(depth);
    assert_eq!(ask(&at, "GET /depth/left", "", b"").0, 404, "its stream has ended");
    wide.node.finish().unwrap();
}

#[test]
fn mistakes_are_named_with_their_remedies() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let cases = [
        (format!("port = {port}"), vec![format!("127.0.0.1:{port}"), "another program uses this port".to_owned()]),
        (r#"path = "/my view""#.to_owned(), vec!["`/my view`".to_owned(), "contains a space".to_owned()]),
        (r#"path = "/""#.to_owned(), vec!["it is empty".to_owned(), "such as `/wide`".to_owned()]),
        (
            r#"address = "localhost""#.to_owned(),
            vec!["`localhost` is not an IP address".to_owned(), "127.0.0.1".to_owned()],
        ),
        (r#"port = 0, address = "203.0.113.7""#.to_owned(), vec!["no such address".to_owned()]),
    ];
    for (params, words) in cases {
        let message = open_as("out", &params).err().unwrap_or_else(|| panic!("{params} was accepted"));
        for word in words {
            assert!(message.contains(&word), "{params}: {message}");
        }
    }
}
