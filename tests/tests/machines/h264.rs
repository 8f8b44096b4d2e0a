//! Frames that travel as H.264.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use panoscope_engine::memory::FrameRef;
use panoscope_engine::{Engine, Listener, Options};
use panoscope_tests::machines::{Machine, Namespace, Relay};
use panoscope_tests::{load, scratch};

use super::{PATIENCE, machine, plain_machine};

/// Frames of an output by tick.
type Pictures = Arc<Mutex<BTreeMap<u64, Vec<u8>>>>;

/// A run with a node on another machine that makes a new frame from each one that arrives: the frames sent and made, and the number of bytes
/// transferred.
struct ColourRun {
    sent: BTreeMap<u64, Vec<u8>>,
    made: BTreeMap<u64, Vec<u8>>,
    bytes: u64,
    faults: usize,
    /// Number of connections that were made.
    connections: u64,
}

impl ColourRun {
    /// Runs until `is_done`, which is given the numbers of frames made so far and of connections.
    fn new(folder: &Path, machine: &str, mut is_done: impl FnMut(usize, u64) -> bool) -> Self {
        // What was made comes back as a second stream.
        let text = format!(
            "mode = \"live\"\nplugins = [\"flow\", \"phantom\"]\n[nodes.scope]\ntype = \"phantom\"\nparams = {{ width = 320, height = 240 }}\n\
             [nodes.far]\ntype = \"smooth\"\non = \"rack\"\nparams = {{ past_weight = 0 }}\n\
             inputs = {{ image = \"scope.left\", past = \"scope.left\" }}\n\
             [nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"far.image\" }}\n{machine}"
        );
        let (graph, catalog, loader) =
            load(&folder.join("graph.toml"), &text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
        let (sent, made) = (Pictures::default(), Pictures::default());
        let listen = [("scope", "left", &sent), ("far", "image", &made)].map(|(node, output, pictures)| {
            let pictures = Arc::clone(pictures);
            let hear = move |frame: &FrameRef| {
                pictures.lock().expect("no panic").insert(frame.tick().seq, frame.bytes().to_vec());
            };
            Listener { node: node.to_owned(), output: output.to_owned(), hear: Arc::new(hear) }
        });
        let options = Options { listen: listen.into(), graph_dir: folder.to_owned(), ..Options::default() };
        let engine = Engine::start(graph, &catalog, &loader, options).unwrap_or_else(|error| panic!("{error}"));
        let (mut link, mut connections) = (None, 0);
        let end = Instant::now() + PATIENCE;
        let _ = engine.watch(Duration::from_millis(20), |engine| {
            let rack = &engine.report().groups["rack"];
            link = rack.link.clone().or(link.take());
            connections = rack.processes;
            let count = made.lock().expect("no panic").len();
            if is_done(count, connections) {
                engine.stop();
            }
            let log = engine.recent_log();
            assert!(Instant::now() < end, "{count} pictures, {connections} connections, then none: {log:?}");
            Ok::<_, ()>(())
        });
        engine.close(Duration::from_secs(30));
        let link = link.expect("a link");
        let take = |pictures: &Pictures| std::mem::take(&mut *pictures.lock().expect("no panic"));
        let (sent, made) = (take(&sent), take(&made));
        let bytes = link.sent_bytes + link.received_bytes;
        Self { sent, made, bytes, faults: engine.recent_faults().len(), connections }
    }

    /// Peak signal-to-noise ratio of the worst frame, dB.
    fn worst_db(&self) -> f64 {
        let psnr_db = |(seq, picture): (&u64, &Vec<u8>)| {
            let pairs = picture.iter().zip(&self.sent[seq]);
            let squares = pairs.map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum::<u64>();
            10.0 * (255.0 * 255.0 * picture.len() as f64 / squares.max(1) as f64).log10()
        };
        self.made.iter().map(psnr_db).fold(f64::INFINITY, f64::min)
    }
}

#[test]
fn colour_pictures_as_h264_are_close_to_what_was_sent_and_far_fewer_bytes() {
    let folder = scratch("machines-h264");
    let Some(space) = Namespace::new(1) else {
        return panoscope_testing::skipped!("this user makes no network namespaces");
    };
    let address = format!("tcp/{}:7447", space.address);
    let Some(_rack) = Machine::start(&space.words(), "rack", &address, &["--plaintext"], &folder) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let run = |pixels: &str| {
        let more = format!("plaintext = true\ntimeout_ms = 5000\npixels = \"{pixels}\"");
        // However long they take: a live graph on a loaded machine drops some.
        let run = ColourRun::new(&folder, &machine(&address, &more), |made, _| made >= 30);
        assert!(run.made.len() > 20 && run.faults == 0, "{} pictures, {} faults", run.made.len(), run.faults);
        run
    };
    let raw = run("raw");
    assert!(raw.made.iter().all(|(seq, picture)| raw.sent[seq] == *picture), "raw pixels arrive as they are");
    let coded = run("h264");
    let bytes = [&raw, &coded].map(|run| run.bytes / run.made.len() as u64);
    let worst_db = coded.worst_db();
    println!("PSNR {worst_db:.1} dB at least, coded twice; {} bytes per picture, {} as they are", bytes[1], bytes[0]);
    assert!(worst_db > 30.0, "{worst_db} dB");
    assert!(worst_db < 80.0, "truly coded");
    assert!(bytes[1] * 4 < bytes[0], "{bytes:?}");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn streams_of_h264_begin_anew_with_each_connection() {
    let folder = scratch("machines-h264-lost");
    let Some((_rack, port)) = plain_machine(&folder) else { return };
    let relay = Relay::start(([127, 0, 0, 1], port).into(), 1);
    // Longer than the run: the end of a connection is noticed, not waited for.
    let more = "timeout_ms = 60000\npixels = \"h264\"";
    let (mut at_loss, mut at_return) = (None, None);
    let run = ColourRun::new(&folder, &machine(&format!("tcp/{}", relay.address), more), |made, connections| {
        if at_loss.is_none() && made >= 10 {
            relay.weather.resets.fetch_add(1, Ordering::Relaxed);
            at_loss = Some(made);
        }
        if at_return.is_none() && connections >= 2 {
            at_return = Some(made);
        }
        at_return.is_some_and(|before| made > before + 10)
    });
    let (last, connections) = (run.made.len(), run.connections);
    assert!(
        connections >= 2 && at_loss.is_some_and(|made| last > made + 10),
        "{at_loss:?} of {last}, {connections} connections"
    );
    let worst_db = run.worst_db();
    assert!(worst_db > 30.0, "no picture after the loss is made of one that was lost: {worst_db} dB");
    let _ = std::fs::remove_dir_all(&folder);
}
