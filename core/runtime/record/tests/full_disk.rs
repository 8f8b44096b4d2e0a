//! A disk that is full or slow costs the recording ticks, never the run.

use std::sync::Arc;
use std::time::{Duration, Instant};

use panoscope_engine::Options;
use panoscope_record::{RecordOptions, Recorder, Recording, head};

use crate::common::{PATIENCE, ready, scratch};
use crate::record::{HEAD, node, replay, source};

/// A disk that becomes full.
struct Small {
    bytes: Arc<std::sync::Mutex<Vec<u8>>>,
    room: usize,
}

impl std::io::Write for Small {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let mut held = self.bytes.lock().expect("no panic");
        let n = bytes.len().min(self.room - held.len());
        if n == 0 && !bytes.is_empty() {
            return Err(std::io::Error::from(std::io::ErrorKind::StorageFull));
        }
        held.extend_from_slice(&bytes[..n]);
        Ok(n)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl std::io::Seek for Small {
    fn seek(&mut self, _: std::io::SeekFrom) -> std::io::Result<u64> {
        Ok(self.bytes.lock().expect("no panic").len() as u64)
    }
}

impl panoscope_record::Output for Small {
    fn cut(&mut self, len: u64) -> std::io::Result<()> {
        self.bytes.lock().expect("no panic").truncate(len as usize);
        Ok(())
    }
}

#[test]
fn a_full_disk_is_reported_at_once_and_the_run_goes_on() {
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let ready = ready("full.toml", &text);
    let bytes = Arc::new(std::sync::Mutex::new(Vec::new()));
    let disk = Small { bytes: Arc::clone(&bytes), room: 12_345 };
    let recorder = Recorder::start_on(Some(Box::new(disk)), RecordOptions::default(), head(&ready)).expect("it begins");
    let options = Options { observer: Some(Arc::clone(&recorder) as _), threads: 2, ..Options::default() };
    let live = ready.start(options).expect("it starts");
    let engine = live.engine();
    let end = Instant::now() + PATIENCE;
    while !engine.recent_faults().iter().any(|f| f.node == "record") {
        assert!(Instant::now() < end, "the full disk is not reported");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(engine.recent_log().iter().any(|(_, node, words)| node == "record" && words.contains("the run goes on")));
    let before = engine.report().nodes["end"].count;
    while engine.report().nodes["end"].count < before + 50 {
        assert!(Instant::now() < end, "the picture stands still");
        std::thread::sleep(Duration::from_millis(1));
    }
    engine.stop();
    assert!(engine.wait(Some(PATIENCE)));
    engine.close(PATIENCE);
    let recorded = recorder.finish();
    assert!(recorded.failed.is_some());
    let file = scratch("full.mcap");
    std::fs::write(&file, &*bytes.lock().expect("no panic")).expect("written");
    let recording = Recording::open(&file).expect("readable up to there");
    assert!(recording.cut.is_some() && recording.sources["a"].len() > 3, "{:?}", recording.cut);
    assert_eq!(bytes.lock().expect("no panic").len() as u64, recorded.bytes, "an incomplete message is removed");
}

#[test]
fn a_slow_disk_leaves_counted_gaps_and_never_blocks_the_run() {
    // A queue of all frames: a busy machine must not drop any of them.
    let end = node("end", "drain", "FROM").replace("\"FROM\"", "{ from = \"a.image\", queue = 60 }");
    let text = [HEAD, &source("a", 400.0), &end].concat();
    let ready = ready("gaps.toml", &text);
    let file = scratch("gaps.mcap");
    // The queue holds nothing, so every tick is a gap.
    let record = RecordOptions { file: Some(file.clone()), max_queued_bytes: 0, ..RecordOptions::default() };
    let recorder = Recorder::start(record, head(&ready)).expect("it begins");
    let options =
        Options { observer: Some(Arc::clone(&recorder) as _), threads: 2, frames: Some(50), ..Options::default() };
    let live = ready.start(options).expect("it starts");
    let engine = live.engine();
    assert!(engine.wait(Some(PATIENCE)));
    engine.close(PATIENCE);
    assert_eq!(engine.report().nodes["end"].count, 50);
    assert!(engine.recent_faults().iter().any(|f| f.node == "record" && f.words.contains("too slow")));
    assert_eq!(recorder.finish().gaps, 50);
    let recording = Recording::open(&file).expect("readable");
    assert!(recording.sources["a"].iter().all(|t| t.gap));
    assert!(replay(&file, 2).expect("there is nothing to play").ports.is_empty());
}
