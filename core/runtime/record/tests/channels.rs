//! Which channels a recording has, and who may write it.

use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::mpsc::channel;
use std::sync::{Arc, Condvar, Mutex};

use panoscope_abi::{Frame, Tick};
use panoscope_engine::Options;
use panoscope_engine::memory::{FrameRef, memory};
use panoscope_engine::observe::{Event, Observer};
use panoscope_graph::GraphText;
use panoscope_record::{Head, Output, RecordError, RecordOptions, Recorder, Recording, head};

use crate::common::{PATIENCE, ready, scratch};
use crate::record::{HEAD, assert_same, node, replay, source, start};

/// A recorder without an engine.
fn recorder(options: RecordOptions) -> Result<Arc<Recorder>, RecordError> {
    Recorder::start(options, any_head())
}

fn any_head() -> Head {
    head(&ready("recorded.toml", &[HEAD, &source("a", 400.0)].concat()))
}

#[test]
fn channels_belong_to_the_instance_and_not_to_the_name() {
    let recorder = recorder(RecordOptions { digests: true, ..RecordOptions::default() }).expect("it starts");
    let (buffer, data) = memory().allocate(4).expect("memory");
    // SAFETY: `allocate` returned the buffer with one reference, which this frame takes over.
    let frame = unsafe { FrameRef::adopt(Frame { buffer, data, len: 4, ..Frame::EMPTY }) };
    for (seq, port) in ["left", "image", "left"].into_iter().enumerate() {
        let ports: Arc<[String]> = [port.to_owned()].into();
        let tick = Tick { source: 0, flags: 0, seq: seq as u64, capture_ns: 0 };
        recorder.source_tick("cam", &ports, &tick, &[*frame.frame()]);
    }
    let digests = recorder.finish().digests.expect("fingerprints");
    let counts: Vec<_> = digests.ports.iter().map(|(port, all)| (port.as_str(), all.packets.len())).collect();
    assert_eq!(counts, [("cam.image", 1), ("cam.left", 2)]);
}

#[test]
fn a_source_that_is_replaced_keeps_its_channels() {
    let graph =
        |source: &str| [HEAD, source, &node("show", "pass", "cam.image"), &node("end", "drain", "show.image")].concat();
    let text = graph("[nodes.cam]\ntype = \"aged\"\n");
    let file = scratch("replaced.mcap");
    let mut run = start(&text, Some(file.clone()), Options { threads: 2, ..Options::default() }, false);
    run.until("end", 20);
    let new = graph(&source("cam", 200.0));
    run.live.apply(&GraphText::parse(Path::new("recorded.toml"), &new)).expect("a good change");
    run.until("end", 40);
    let recorded = run.end().digests.expect("fingerprints");
    let recording = Recording::open(&file).expect("a recording");
    let ticks = recording.sources["cam"].len();
    let [tips, images] = ["cam.tip", "cam.image"].map(|port| recording.ports.get(port).map_or(0, Vec::len));
    assert!(tips >= 20 && images > tips && images == ticks, "{tips} and {images} of {ticks}");
    assert_same("as recorded", &replay(&file, 2).unwrap_or_else(|e| panic!("{e}")), &recorded);
}

#[test]
fn all_ports_are_recorded_also_those_that_nobody_reads() {
    let text = [HEAD, &source("a", 400.0), &node("alone", "pass", "a.image")].concat();
    let file = scratch("unread.mcap");
    let run = start(&text, Some(file.clone()), Options { threads: 2, ..Options::default() }, true);
    run.until("alone", 20);
    let recorded = run.end().digests.expect("fingerprints");
    assert!(recorded.ports["alone.image"].packets.len() >= 20);
    assert!(Recording::open(&file).expect("a recording").ports["alone.image"].len() >= 20);
    assert_same("as recorded", &replay(&file, 2).unwrap_or_else(|e| panic!("{e}")), &recorded);
}

#[test]
fn a_recording_has_one_writer_and_never_writes_through_a_link() {
    let (file, target) = (scratch("linked.mcap"), scratch("target.mcap"));
    std::fs::write(&target, "kept").expect("written");
    std::os::unix::fs::symlink(&target, &file).expect("a link");
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let run = start(&text, Some(file.clone()), Options::default(), false);
    let again = || recorder(RecordOptions { file: Some(file.clone()), ..RecordOptions::default() });
    let refused = again().err().expect("another run has it").to_string();
    assert!(refused.starts_with("another run (process ") && refused.contains("linked.mcap"), "{refused}");
    run.until("a", 5);
    run.end();
    assert_eq!(std::fs::read_to_string(&target).expect("the target"), "kept");
    assert!(Recording::open(&file).expect("a recording").cut.is_none());
    again().expect("it is free").finish();
}

/// A disk that takes nothing while it is stalled.
#[derive(Clone, Default)]
struct Stalling(Arc<(Mutex<bool>, Condvar)>);

impl Stalling {
    fn stall(&self, is_stalled: bool) {
        *self.0.0.lock().expect("no panic") = is_stalled;
        self.0.1.notify_all();
    }
}

impl Write for Stalling {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let is_stalled = self.0.0.lock().expect("no panic");
        drop(self.0.1.wait_while(is_stalled, |is_stalled| *is_stalled).expect("no panic"));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Seek for Stalling {
    fn seek(&mut self, _: SeekFrom) -> std::io::Result<u64> {
        Ok(0)
    }
}

impl Output for Stalling {
    fn cut(&mut self, _: u64) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_disk_that_stalls_ends_the_recording_before_memory_ends() {
    let (disk, (reports, reported)) = (Stalling::default(), channel());
    let recorder = Recorder::start_on(Some(Box::new(disk.clone())), RecordOptions::default(), any_head());
    let recorder = recorder.expect("it starts");
    recorder.report_to(Box::new(move |message| _ = reports.send(message.to_owned())));
    disk.stall(true);
    for seq in 0..600_000 {
        recorder.event(Event::Dropped { node: "cam".to_owned(), seq });
    }
    let message = reported.recv_timeout(PATIENCE).expect("a report");
    assert!(message.contains("the disk has stalled"), "{message}");
    disk.stall(false);
    let recorded = recorder.finish();
    assert!(recorded.failed.is_some_and(|reason| reason.contains("the disk has stalled")));
    assert!(reported.try_recv().is_err(), "one report");
}
