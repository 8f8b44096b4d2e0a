//! Damage of a recording is reported, and never read as other data.

use std::path::Path;
use std::sync::Arc;

use panoscope_engine::Options;
use panoscope_record::compare::compare_recordings;
use panoscope_record::{Coding, Recording, RecordingError, Replay, ReplayOptions};

use crate::common::{self, PATIENCE, scratch};
use crate::record::{HEAD, node, replay, source, start};

/// A short recording, as bytes.
fn short() -> Vec<u8> {
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let file = scratch(&format!("short_{:?}.mcap", std::thread::current().id()));
    let run = start(&text, Some(file.clone()), Options { threads: 2, ..Options::default() }, false);
    run.until("a", 30);
    run.end();
    std::fs::read(&file).expect("it was written")
}

#[test]
fn a_recording_cut_off_anywhere_opens_up_to_its_last_whole_frame() {
    let whole = short();
    let file = scratch("cut.mcap");
    std::fs::write(&file, &whole).expect("written");
    let all = Recording::open(&file).expect("whole");
    let ends: Vec<u64> = all.ports["a.image"].iter().map(|p| p.at + p.head.len).collect();
    let ticks = all.sources["a"].len();
    assert_eq!(ends.len(), ticks);
    let mut opened = 0;
    for len in (0..whole.len()).filter(|l| *l < 200 || l % 97 == 0 || ends.iter().any(|e| e.abs_diff(*l as u64) < 3)) {
        std::fs::write(&file, &whole[..len]).expect("written");
        match Recording::open(&file) {
            Ok(cut) => {
                opened += 1;
                let frames = ends.iter().filter(|end| **end <= len as u64).count();
                assert_eq!(cut.ports.get("a.image").map_or(0, Vec::len), frames, "cut at {len}");
                let known = cut.sources.get("a").map_or(0, Vec::len);
                assert!(known == frames || known + 1 == frames, "cut at {len}: the last tick may have lost its end");
                for packet in cut.ports.values().flatten() {
                    cut.bytes("a.image", packet).unwrap_or_else(|e| panic!("cut at {len}: {e}"));
                }
                // The end mark may be whole already when the index behind it is cut.
                assert!(cut.cut.is_some() || known == ticks, "cut at {len}");
            }
            Err(RecordingError::Empty { bytes, .. }) => assert_eq!(bytes, len as u64),
            Err(error) => panic!("cut at {len}: {error}"),
        }
    }
    assert!(opened > 100);
    // One of them is also replayed, which says that it is not whole.
    std::fs::write(&file, &whole[..ends[ticks / 2] as usize + 400]).expect("written");
    let recording = Arc::new(Recording::open(&file).expect("a part"));
    let engine = Options { threads: 2, ..Options::default() };
    let options = ReplayOptions { engine, act: true, ..ReplayOptions::default() };
    let played = Replay::start(&recording, options).unwrap_or_else(|e| panic!("{e}"));
    assert!(played.engine().wait(Some(PATIENCE)), "the replay ends");
    played.engine().close(PATIENCE);
    assert!(played.engine().report().nodes["end"].count >= ticks as u64 / 2);
    let error = played.verdict().expect_err("the end is missing").to_string();
    assert!(error.contains("is cut off at byte"), "{error}");
}

#[test]
fn damaged_bytes_are_named_or_end_the_recording() {
    let whole = short();
    let file = scratch("damaged.mcap");
    std::fs::write(&file, &whole).expect("written");
    let all = Recording::open(&file).expect("whole");
    // Read now, before other bytes are written to the file.
    assert!(all.verify().is_ok() && all.checked);
    let mut dice = 1u64;
    for _ in 0..400 {
        dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let at = (dice >> 33) as usize % whole.len();
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (dice >> 20 & 7);
        std::fs::write(&file, &bytes).expect("written");
        let Ok(opened) = Recording::open(&file) else { continue };
        for (port, packet) in opened.ports.iter().flat_map(|(port, list)| list.iter().map(move |p| (port, p))) {
            match opened.bytes(port, packet) {
                Ok(_) | Err(RecordingError::Damaged { .. }) => {}
                Err(error) => panic!("byte {at}: {error}"),
            }
        }
    }
    let packet = all.ports["a.image"][3];
    let mut bytes = whole;
    bytes[packet.at as usize + 20] ^= 1;
    std::fs::write(&file, &bytes).expect("written");
    let error = replay(&file, 2).expect_err("a damaged frame is not shown as if it were whole");
    assert!(error.to_string().contains("is damaged at byte") && error.to_string().contains("a.image"), "{error}");
}

/// The report of damage: an error of `open`, an early end, or an error at a packet. `None` when nothing was reported.
fn reported_damage(file: &Path) -> Option<String> {
    match Recording::open(file) {
        Err(error) => Some(error.to_string()),
        Ok(recording) => match recording.verify() {
            Err(error) => Some(error.to_string()),
            Ok(()) => recording.cut.filter(|cut| cut.damaged).map(|cut| cut.reason),
        },
    }
}

/// A recording of pictures that are packed, and of a node that hands them on, which are stored as references.
fn packed() -> Vec<u8> {
    let text = [
        HEAD,
        &source("a", 400.0).replace("width_px = 16, height_px = 8", "width_px = 64, height_px = 48"),
        &node("same", "pass", "a.image"),
        &node("end", "drain", "same.image"),
    ];
    let file = scratch("packed.mcap");
    let run = start(&text.concat(), Some(file.clone()), Options { threads: 2, ..Options::default() }, true);
    run.until("a", 12);
    run.end();
    let recording = Recording::open(&file).expect("whole");
    let sizes = |port: &str| recording.ports[port].iter().map(|p| (p.coding, p.stored)).collect::<Vec<_>>();
    let (made, same) = (sizes("a.image"), sizes("same.image"));
    assert!(made.iter().all(|(coding, stored)| *coding == Coding::Packed && *stored < 64 * 48 / 2), "{made:?}");
    assert!(!same.is_empty() && same == made[..same.len()], "{same:?}");
    let ats = |port: &str| recording.ports[port].iter().map(|p| p.at).collect::<Vec<_>>();
    assert_eq!(ats("same.image"), ats("a.image")[..same.len()], "stored once");
    std::fs::read(&file).expect("it was written")
}

#[test]
fn a_flipped_bit_anywhere_is_reported_and_never_read_as_other_data() {
    for whole in [short(), packed()] {
        let file = scratch("flipped.mcap");
        std::fs::write(&file, &whole).expect("written");
        assert_eq!(reported_damage(&file), None);
        let all = Recording::open(&file).expect("whole");
        // All of the beginning (header, channel, head, first ticks) and of the end; a sample of what repeats between them.
        let first = all.ports["a.image"][2].at as usize + 8;
        let (mut flipped, mut step) = (0, 0u64);
        let mut at = 0;
        while at < whole.len() {
            let mut bytes = whole.clone();
            step += 1;
            bytes[at] ^= 1 << (step % 8);
            std::fs::write(&file, &bytes).expect("written");
            assert!(reported_damage(&file).is_some(), "bit {} of byte {at} of {}: not reported", step % 8, whole.len());
            flipped += 1;
            at += if at < first || at + 800 > whole.len() { 1 } else { 13 };
        }
        assert!(flipped > 3000, "{flipped}");
    }
}

#[test]
fn a_damaged_recording_fails_a_replay_and_a_comparison() {
    let whole = short();
    let [good, bad] = ["good.mcap", "bad.mcap"].map(scratch);
    std::fs::write(&good, &whole).expect("written");
    let all = Recording::open(&good).expect("whole");
    // The description of a packet in the middle: source, tick, time and size stand there.
    let packet = all.ports["a.image"][10];
    let mut bytes = whole.clone();
    bytes[packet.at as usize - 72 + 33] ^= 4;
    std::fs::write(&bad, &bytes).expect("written");
    let cut = Recording::open(&bad).expect("good up to there").cut.expect("it is damaged");
    assert!(cut.damaged && cut.at < packet.at, "{cut:?}");
    let error = replay(&bad, 2).expect_err("the rest is lost").to_string();
    assert!(error.contains("is damaged at byte") && error.contains("description of a packet"), "{error}");
    // Bytes of a picture: the fingerprints are equal.
    let mut bytes = whole;
    bytes[packet.at as usize + 5] ^= 1;
    std::fs::write(&bad, &bytes).expect("written");
    let damaged = Recording::open(&bad).expect("its messages are whole");
    let error = compare_recordings(&all, &damaged, 0.0).expect_err("it is not called equal").to_string();
    assert!(error.contains("is damaged at byte") && error.contains("packet 10 of `a.image`"), "{error}");
}

#[test]
fn files_that_are_not_recordings_are_errors() {
    let file = scratch("text.mcap");
    std::fs::write(&file, "name = \"panorama\"\n").expect("written");
    assert!(matches!(Recording::open(&file), Err(RecordingError::NoMcap { .. })));
    assert!(matches!(Recording::open(Path::new("nowhere.mcap")), Err(RecordingError::Unreadable { .. })));
    assert!(matches!(Recording::open(&common::scratch_dir()), Err(RecordingError::Unreadable { .. })));
    let foreign = mcap::WriteOptions::new().compression(None).create(std::io::Cursor::new(Vec::new()));
    let mut foreign = foreign.expect("memory");
    foreign.finish().expect("memory");
    std::fs::write(&file, foreign.into_inner().into_inner()).expect("written");
    let error = Recording::open(&file).expect_err("of another program");
    assert!(matches!(error, RecordingError::Foreign { .. }), "{error}");
}
