//! Recordings, their events, and digests.

use panoscope_abi::Tick;
use panoscope_engine::Machine;
use panoscope_record::format::{EVENTS, Head};
use panoscope_record::{Digests, Event, Recording};

use crate::scratch;

/// One event, as JSON.
pub fn event(bytes: &[u8]) {
    let Ok(event) = serde_json::from_slice::<Event>(bytes) else { return };
    let written = serde_json::to_vec(&event).expect("an event is JSON");
    let again: Event = serde_json::from_slice(&written)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&written)));
    assert_eq!(serde_json::to_vec(&again).expect("an event is JSON"), written);
}

fn head(format: u32) -> Head {
    let (text, graph) = crate::graph::example();
    Head {
        format,
        version: "0.1.0".to_owned(),
        graph_path: "/empty.toml".to_owned(),
        text: text.to_owned(),
        settings: vec!["a.b=1".to_owned()],
        graph,
        plugins: Vec::new(),
        models: Vec::new(),
        machine: Machine { cpu: "any".to_owned(), cores: 2, threads: 2, os: "linux".to_owned() },
        unix_ms: 7,
        all_ports: false,
    }
}

fn json(event: &Event) -> Vec<u8> {
    serde_json::to_vec(event).expect("an event is JSON")
}

fn tick(seq: u64, packets: u32) -> Event {
    Event::Tick { node: "scope".to_owned(), seq, capture_ns: 40_000_000 * seq as i64, packets, gap: false }
}

pub fn event_seeds() -> Vec<Vec<u8>> {
    let node = || "scope".to_owned();
    let events = [
        Event::Head(Box::new(head(3))),
        tick(1, 2),
        Event::Dropped { node: node(), seq: 3 },
        Event::Took { node: node(), source: 0, seq: 3, capture_ns: -1, inputs: vec![None, Some((1, 2))] },
        Event::Ages { node: node(), source: 0, seq: 3, now_ns: 9, arrived: vec![(0, None), (1, Some(4))] },
        Event::Skipped { node: node(), source: 0, seq: 3, closed: true },
        Event::End { gaps: 0 },
    ];
    let mut all: Vec<Vec<u8>> = events.iter().map(json).collect();
    all.push(
        br#"{"event":"values","node":"a","source":0,"seq":1,"values":[{"Float":1.5},{"Choice":{"index":0,"name":"x"}},{"Path":"/a"},{"Floats":[1.0]}]}"#
            .to_vec(),
    );
    all
}

/// A recording: scanned, verified, and every packet read.
pub fn file(bytes: &[u8]) {
    let path = scratch::file("run.mcap", bytes);
    let recording = match Recording::open(&path) {
        Ok(recording) => recording,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let packets: usize = recording.ports.values().map(Vec::len).sum();
    assert!(packets + recording.ticks() + recording.events.len() <= bytes.len());
    if let Some(cut) = &recording.cut {
        assert!(cut.at <= bytes.len() as u64 && !cut.reason.is_empty(), "{cut:?}");
    }
    let mut all_whole = recording.cut.as_ref().is_none_or(|cut| !cut.damaged);
    for (port, packet) in recording.ports.iter().flat_map(|(port, all)| all.iter().map(move |p| (port, p))) {
        assert!(packet.at + packet.head.len <= bytes.len() as u64, "{packet:?}");
        match recording.bytes(port, packet) {
            Ok(read) => assert_eq!(read.len() as u64, packet.head.len),
            Err(_) => all_whole = false,
        }
    }
    assert_eq!(recording.verify().is_ok(), all_whole);
    assert_eq!(recording.digests().packets(), packets);
}

struct Mcap(Vec<u8>);

impl Mcap {
    fn new() -> Self {
        Self(b"\x89MCAP0\r\n".to_vec())
    }

    fn record(&mut self, op: u8, body: &[u8]) {
        self.0.push(op);
        self.0.extend((body.len() as u64).to_le_bytes());
        self.0.extend_from_slice(body);
    }

    fn text(out: &mut Vec<u8>, text: &str) {
        out.extend((text.len() as u32).to_le_bytes());
        out.extend_from_slice(text.as_bytes());
    }

    fn header(&mut self) {
        let mut body = Vec::new();
        Self::text(&mut body, "panoscope");
        Self::text(&mut body, "panoscope 0.1.0");
        self.record(1, &body);
    }

    fn channel(&mut self, id: u16, topic: &str, encoding: &str) {
        let mut body = [id.to_le_bytes(), 0u16.to_le_bytes()].concat();
        Self::text(&mut body, topic);
        Self::text(&mut body, encoding);
        body.extend(0u32.to_le_bytes());
        self.record(4, &body);
    }

    fn message(&mut self, channel: u16, payload: &[u8]) {
        let mut body = channel.to_le_bytes().to_vec();
        body.extend([0; 20]);
        body.extend_from_slice(payload);
        self.record(5, &body);
    }

    /// A packet of format 1, whose description has no checksum.
    fn packet(&mut self, channel: u16, tick: Tick, bytes: &[u8], hash: u64) {
        let mut body: Vec<u8> = [tick.source, 0, 0, 0, 0, 0].iter().flat_map(|n: &u32| n.to_le_bytes()).collect();
        body.extend(tick.seq.to_le_bytes());
        body.extend(tick.capture_ns.to_le_bytes());
        body.extend((bytes.len() as u64).to_le_bytes());
        body.extend(hash.to_le_bytes());
        body.extend_from_slice(bytes);
        self.message(channel, &body);
    }

    fn end(&mut self) {
        self.record(15, &[0; 4]);
        self.record(2, &[0; 20]);
        self.0.extend(b"\x89MCAP0\r\n");
    }
}

pub fn file_seeds() -> Vec<Vec<u8>> {
    let begin = |format: u32| {
        let mut mcap = Mcap::new();
        mcap.header();
        mcap.channel(0, EVENTS, "json");
        mcap.message(0, &json(&Event::Head(Box::new(head(format)))));
        mcap
    };
    let mut plain = begin(1);
    plain.channel(1, "scope.left", "panoscope.packet");
    let moment = Tick { source: 0, flags: 0, seq: 1, capture_ns: 4 };
    let frame = panoscope_abi::Frame { format: 0, width: 0, height: 0, stride_bytes: 0, ..panoscope_abi::Frame::EMPTY };
    plain.packet(1, moment, b"abcd", panoscope_record::digest::packet_hash(&frame, b"abcd"));
    plain.message(0, &json(&tick(1, 1)));
    plain.message(0, &json(&Event::Dropped { node: "scope".to_owned(), seq: 1 }));
    plain.message(0, &json(&Event::End { gaps: 0 }));
    let cut = plain.0.clone();
    plain.end();
    let mut other = begin(9);
    other.end();
    let mut sealed = begin(3);
    sealed.end();
    let mut foreign = Mcap::new();
    foreign.record(3, &[0; 30]);
    foreign.record(6, &[0; 60]);
    let mut long = begin(1);
    long.record(5, &[0xff; 30]);
    let file = scratch::path("recorded.mcap");
    crate::isolated::recorded(&file);
    let whole = std::fs::read(&file).expect("a recording");
    let damaged = |at: usize| {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        bytes
    };
    let unfinished = whole[..whole.len() * 2 / 3].to_vec();
    let mut no_mark = whole.clone();
    no_mark.truncate(whole.len() - 8);
    let mut wrong_mark = whole.clone();
    if let Some(last) = wrong_mark.last_mut() {
        *last ^= 1;
    }
    let real =
        vec![damaged(whole.len() / 2), damaged(whole.len() - 60), damaged(40), unfinished, no_mark, wrong_mark, whole];
    // Channels, edits and drops of a source that is removed.
    let mut edited = begin(1);
    edited.channel(2, "no port", "panoscope.packet");
    edited.packet(2, moment, b"abcd", 0);
    edited.message(9, b"nobody's");
    let mut short = begin(1);
    short.channel(1, "scope.left", "panoscope.packet");
    short.message(1, b"short");
    let mut missing = begin(1);
    missing.message(0, &json(&tick(1, 2)));
    let mut no_head = Mcap::new();
    no_head.header();
    no_head.channel(0, EVENTS, "json");
    no_head.message(0, br#"{"event":"end","gaps":0}"#);
    let mut unreadable = Mcap::new();
    unreadable.header();
    unreadable.channel(0, EVENTS, "json");
    unreadable.message(0, br#"{"format":7,"version":"9"}"#);
    let mut chunked = Mcap::new();
    chunked.record(6, &[0; 60]);
    let mut damaged_channel = begin(1);
    damaged_channel.record(4, &[0xff; 12]);
    let mut unknown = begin(1);
    unknown.record(99, &[0; 4]);
    let more = [edited, short, missing, no_head, unreadable, chunked, damaged_channel, unknown];
    let more = more.into_iter().map(|mcap| mcap.0).chain(real);
    let mut all: Vec<Vec<u8>> = more.collect();
    all.extend([
        plain.0,
        cut,
        other.0,
        sealed.0,
        foreign.0,
        long.0,
        b"\x89MCAP0\r\n".to_vec(),
        b"no recording".to_vec(),
    ]);
    all
}

/// Digests of a run, as JSON.
pub fn digests(bytes: &[u8]) {
    let Ok(digests) = Digests::read(&scratch::file("run.json", bytes)) else { return };
    assert!(digests.packets() <= bytes.len());
    let copy = scratch::path("copy.json");
    digests.write(&copy).expect("written");
    assert_eq!(Digests::read(&copy).expect("its own text"), digests);
}

pub fn digest_seeds() -> Vec<Vec<u8>> {
    let texts = [
        r#"{"graph":"g","ports":{"scope.left":{"digest":"00ff","packets":[[0,1,"00000000000000ff"],[0,2,"1"]]}}}"#,
        r#"{"graph":"","ports":{}}"#,
        r#"{"graph":"g","ports":{"a":{"digest":"","packets":[[0,18446744073709551615,"+1"]]}}}"#,
        r#"{"graph":"g","ports":[]}"#,
    ];
    texts.iter().map(|text| text.as_bytes().to_vec()).collect()
}
