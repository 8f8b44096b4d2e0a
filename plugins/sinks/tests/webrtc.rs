//! A live stream as browsers see it: Chromium opens the page of the node, and the pixels of its video are read back.

mod chromium;
mod common;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use chromium::{Browser, Page};
use common::{number_in, numbered};
use panoscope_node::Bgr8;
use panoscope_node::harness::{Harness, Setup};
use panoscope_sinks::webrtc::WebRtc;
use panoscope_testing::skipped;

const SIZE_PX: (usize, usize) = (320, 192);
const PATIENCE: Duration = Duration::from_secs(90);

/// Draws the video to a canvas and reads its pixels back, as BGR; empty before the first picture.
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

/// A graph that shows a picture every so often, in the test's own thread.
struct Source {
    node: Harness<WebRtc>,
    number: u64,
    longest_call: Duration,
}

impl Source {
    fn new(params: &str) -> Self {
        Self::of(open_as("out", params).unwrap(), 1)
    }

    fn of(node: Harness<WebRtc>, number: u64) -> Self {
        let mut source = Self { node, number, longest_call: Duration::ZERO };
        source.show();
        source
    }

    fn show(&mut self) {
        let picture = numbered(SIZE_PX, self.number);
        self.node.at_tick(self.number, self.number as i64 * 33_000_000);
        self.node.input_image::<Bgr8>("image", SIZE_PX.0, SIZE_PX.1, &picture);
        let begin = Instant::now();
        self.node.process().unwrap();
        self.longest_call = self.longest_call.max(begin.elapsed());
        self.number += 1;
    }

    /// Shows pictures at 50 Hz until something has happened.
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

/// A page of a browser that plays the stream, and the numbers of the pictures that it showed.
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

    /// Reads the picture that is shown; answers how many different ones there were.
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

/// Largest difference from the picture of this number, in the middle of small squares of the coloured half, but for the ones where red jumps.
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
    let mut source = Source::new("port = 0");
    for _ in 0..5 {
        source.show();
    }
    assert_eq!(source.metric("frames"), 0, "nothing is encoded for nobody");
    let mut first = Player::open("first", &source.page());
    let mut second = Player::open("second", &source.page());
    source.show_until("both play", |_| (first.look().min(second.look()) >= 15).then_some(()));
    println!("{:?} {:?} {}", first.numbers, second.numbers, first.worst_colour);
    assert_eq!(source.metric("viewers"), 2);
    for player in [&first, &second] {
        assert!(grow(&player.numbers), "{:?}", player.numbers);
        assert!(player.state.starts_with("connected for "), "{}", player.state);
        assert!(player.worst_colour < 30, "a colour is {} off", player.worst_colour);
    }
    second.browser.kill();
    source.longest_call = Duration::ZERO;
    let begin = Instant::now();
    source.show_until("the killed one is removed", |source| {
        first.look();
        (source.metric("viewers") == 1).then_some(())
    });
    println!("removed after {:?}", begin.elapsed());
    let before = first.look();
    source.show_until("the other goes on", |_| (first.look() >= before + 15).then_some(()));
    assert!(grow(&first.numbers), "{:?}", first.numbers);
    assert!(source.longest_call < Duration::from_millis(500), "a call took {:?}", source.longest_call);
    // A page that is closed says so.
    first.browser.evaluate(&first.page, "leave()");
    source.show_until("the page has left", |source| (source.metric("viewers") == 0).then_some(()));
    source.node.finish().unwrap();
}
