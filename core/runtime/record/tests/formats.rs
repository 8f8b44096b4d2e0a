//! What a recording has on disk: compressed packets, chunks that other programs seek in, earlier formats.

use std::path::Path;
use std::sync::Arc;

use panoscope_engine::Options;
use panoscope_record::compare::compare_recordings;
use panoscope_record::{RecordOptions, Recorded, Recording, Replay, ReplayOptions};

use crate::common::{PATIENCE, scratch};
use crate::record::{HEAD, assert_same, node, source, start_with};

#[test]
fn a_compressed_recording_has_the_same_packets_in_less_space() {
    let text = [
        HEAD,
        &source("a", 400.0).replace("width_px = 16, height_px = 8", "width_px = 64, height_px = 48"),
        &node("same", "pass", "a.image"),
        &node("end", "drain", "same.image"),
    ];
    let record = |name: &str, compresses: bool| {
        let file = scratch(name);
        let record =
            RecordOptions { file: Some(file.clone()), all_ports: true, compresses, ..RecordOptions::default() };
        let options = Options { threads: 2, frames: Some(20), ..Options::default() };
        let run = start_with(&text.concat().replace("\"live\"", "\"batch\""), options, record);
        run.until("end", 20);
        (run.end().bytes, Recording::open(&file).expect("whole"))
    };
    let ((less, small), (more, large)) = (record("small.mcap", true), record("large.mcap", false));
    assert!(less < more / 3, "{less} and {more} bytes");
    let compared = compare_recordings(&small, &large, 0.0).expect("both are whole");
    assert!(compared.iter().all(|port| port.is_nothing()), "{compared:?}");
    for port in ["a.image", "same.image"] {
        assert_eq!(small.ports[port].len(), 20);
        for (a, b) in small.ports[port].iter().zip(&large.ports[port]) {
            assert_eq!(small.bytes(port, a).expect("whole"), large.bytes(port, b).expect("whole"));
        }
    }
}

/// Records a source until it made 30 pictures, with packets as they are in memory: as formats before 4 have them.
fn record_uncompressed(file: &Path) -> Recorded {
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let record =
        RecordOptions { file: Some(file.to_owned()), digests: true, compresses: false, ..RecordOptions::default() };
    let run = start_with(&text, Options { threads: 2, ..Options::default() }, record);
    run.until("a", 30);
    run.end()
}

/// MCAP's own library reads the chunks, their indices, the schemas and the checksums; so may any other program.
#[test]
fn other_programs_can_seek_in_a_recording() {
    // More than one chunk of 4 MiB: 24 pictures of 640 x 480 as they are.
    let text = [HEAD, &source("a", 400.0), &node("end", "drain", "a.image")].concat();
    let text = text.replace("width_px = 16, height_px = 8", "width_px = 640, height_px = 480");
    let file = scratch("seek.mcap");
    let record = RecordOptions { file: Some(file.clone()), compresses: false, ..RecordOptions::default() };
    let run = start_with(&text, Options { threads: 2, ..Options::default() }, record);
    run.until("a", 24);
    run.end();
    let ours = Recording::open(&file).expect("whole");
    ours.verify().expect("sound");
    let bytes = std::fs::read(&file).expect("written");
    let summary = mcap::Summary::read(&bytes).expect("sound").expect("a summary");
    let statistics = summary.stats.as_ref().expect("statistics");
    let packets = ours.ports["a.image"].len();
    assert!(summary.chunk_indexes.len() >= 2 && statistics.chunk_count as usize == summary.chunk_indexes.len());
    let channel = summary.channels.values().find(|channel| channel.topic == "a.image").expect("its channel");
    assert_eq!(channel.schema.as_ref().expect("a schema").name, "panoscope.Packet");
    assert_eq!(statistics.channel_message_counts[&channel.id], packets as u64);
    let mut found = 0;
    for chunk in &summary.chunk_indexes {
        let indices = summary.read_message_indexes(&bytes, chunk).expect("indices");
        for entry in indices.iter().filter(|(of, _)| of.id == channel.id).flat_map(|(_, entries)| entries) {
            let message = summary.seek_message(&bytes, chunk, entry).expect("a message");
            assert_eq!((message.log_time, &message.channel.topic[..]), (entry.log_time, "a.image"));
            assert!((chunk.message_start_time..=chunk.message_end_time).contains(&entry.log_time));
            let packet = &ours.ports["a.image"][found];
            assert_eq!(&message.data[72..], &bytes[packet.at as usize..][..packet.stored as usize]);
            found += 1;
        }
    }
    assert_eq!(found, packets);
    // Without the summary, with all checksums.
    let stream: Result<Vec<_>, _> = mcap::MessageStream::new(&bytes).expect("sound").collect();
    assert_eq!(stream.expect("sound").len() as u64, statistics.message_count);
    // A run that is killed leaves its last chunk open; what stands there is read all the same, by everybody.
    let last = &ours.ports["a.image"][packets - 3];
    let end = (last.at + last.stored) as usize;
    let open = summary.chunk_indexes.iter().find(|chunk| chunk.chunk_start_offset + chunk.chunk_length > end as u64);
    let mut killed = bytes[..end].to_vec();
    let head = open.expect("its chunk").chunk_start_offset as usize;
    killed[head + 1..head + 49].fill(0);
    killed[head + 1] = 40;
    std::fs::write(&file, &killed).expect("written");
    let cut = Recording::open(&file).expect("a part");
    assert_eq!((cut.ports["a.image"].len(), cut.cut.expect("not finished").damaged), (packets - 2, false));
    killed.extend(mcap::MAGIC);
    let read = mcap::MessageStream::new(&killed).expect("sound").map_while(Result::ok);
    assert_eq!(read.filter(|message| message.channel.topic == "a.image").count(), packets - 2);
}

/// The recording in format 1, without chunks, schemas and checksums.
fn without_checksums(recording: &Path) -> Vec<u8> {
    let whole = std::fs::read(recording).expect("it was written");
    let mut out = Vec::from(mcap::MAGIC);
    let mut at = mcap::MAGIC.len();
    let mut packets = std::collections::HashSet::new();
    while whole[at] != mcap::records::op::DATA_END {
        let len = u64::from_le_bytes(whole[at + 1..at + 9].try_into().expect("eight")) as usize;
        if whole[at] == mcap::records::op::CHUNK {
            // Its records follow its head.
            at += 9 + 40;
            continue;
        }
        let (kind, mut body) = (whole[at], whole[at + 9..at + 9 + len].to_vec());
        at += 9 + len;
        if [mcap::records::op::SCHEMA, mcap::records::op::MESSAGE_INDEX].contains(&kind) {
            continue;
        }
        let channel = u16::from_le_bytes([body[0], body[1]]);
        if kind == mcap::records::op::CHANNEL {
            body[2..4].fill(0);
        }
        if kind == mcap::records::op::CHANNEL && String::from_utf8_lossy(&body).contains("panoscope.packet") {
            packets.insert(channel);
        }
        if kind == mcap::records::op::MESSAGE {
            if packets.contains(&channel) {
                body.drain(22 + 56..22 + 72);
            } else {
                body.truncate(body.len() - 27);
                body.push(b'}');
                let json = String::from_utf8(body.split_off(22)).expect("JSON");
                body.extend(json.replacen("\"format\":5", "\"format\":1", 1).into_bytes());
            }
        }
        out.push(kind);
        out.extend((body.len() as u64).to_le_bytes());
        out.extend(body);
    }
    out.extend(&whole[at..at + 9]);
    // No checksum of the data.
    out.extend([0; 4]);
    out.extend(&whole[at + 13..]);
    out
}

#[test]
fn recordings_of_format_1_replay_with_a_warning_about_missing_checksums() {
    let file = scratch("new_format.mcap");
    let original = record_uncompressed(&file).digests.expect("fingerprints");
    let old = scratch("old_format.mcap");
    std::fs::write(&old, without_checksums(&file)).expect("written");
    let recording = Arc::new(Recording::open(&old).expect("an old recording"));
    assert_eq!((recording.head.format, recording.checked), (1, false));
    let replay = Replay::start(&recording, ReplayOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    assert!(replay.warnings.iter().any(|w| w.contains("carry no checksums")), "{:?}", replay.warnings);
    drop(replay);
    assert_same("format 1", &original, &crate::record::replay(&old, 2).unwrap_or_else(|e| panic!("{e}")));
}

/// A recording whose packets are described otherwise than its source declares them.
#[test]
fn a_recorded_packet_that_its_source_may_not_put_out_is_withheld() {
    let file = scratch("misfit.mcap");
    record_uncompressed(&file);
    // Rows that do not lie inside the packet, in a format without checksums: what a reader would take for its own memory.
    let mut bytes = without_checksums(&file);
    let old = scratch("misfit_old.mcap");
    std::fs::write(&old, &bytes).expect("written");
    let recording = Recording::open(&old).expect("an old recording");
    let packet = recording.ports["a.image"][7];
    let head = packet.at as usize - 56;
    // The stride, which the packet's own fingerprint does not cover for one row of pixels after the other.
    bytes[head + 16..head + 20].copy_from_slice(&3u32.to_le_bytes());
    std::fs::write(&old, &bytes).expect("written");
    let recording = Arc::new(Recording::open(&old).expect("an old recording"));
    let options = ReplayOptions { act: true, ..ReplayOptions::default() };
    let replay = Replay::start(&recording, options).unwrap_or_else(|e| panic!("{e}"));
    assert!(replay.engine().wait(Some(PATIENCE)));
    replay.engine().close(PATIENCE);
    let report = replay.engine().report();
    let ticks = recording.sources["a"].iter().filter(|t| t.admitted).count() as u64;
    assert_eq!((report.nodes["a"].faults, report.nodes["end"].count), (1, ticks - 1), "{:?}", report.nodes);
    let faults = replay.engine().recent_faults();
    assert!(faults.iter().any(|f| f.node == "a" && f.words.contains("3 bytes per row does not match")), "{faults:?}");
}
