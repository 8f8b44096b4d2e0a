//! The timeline as a file in the format of Chrome's trace events, which <https://ui.perfetto.dev> and
//! `chrome://tracing` open.
//!
//! Each thread is a row, each call a slice with its tick and bytes; arrows follow a tick from call to call; dropped
//! ticks are marks.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use panoscope_base::files;
use serde_json::{Value, json};

use super::{Call, Timeline};

/// The only process of the file.
const PROCESS: u32 = 1;

/// Writes the timeline to `path`, completely or not at all.
///
/// # Errors
/// The file cannot be written.
pub fn write(timeline: &Timeline, path: &Path) -> io::Result<()> {
    files::replace_with(path, None, |file| {
        let mut out = BufWriter::new(file);
        events(timeline, &mut out)?;
        out.flush()
    })
}

fn events(timeline: &Timeline, out: &mut dyn Write) -> io::Result<()> {
    let calls = timeline.snapshot();
    let mut first = true;
    let mut put = |event: &Value| {
        out.write_all(if std::mem::take(&mut first) { b"[\n" } else { b",\n" })?;
        serde_json::to_writer(&mut *out, event).map_err(io::Error::from)
    };
    put(&json!({"ph": "M", "pid": PROCESS, "name": "process_name", "args": {"name": "panoscope"}}))?;
    for (thread, name) in (0_u32..).zip(&calls.threads) {
        put(&json!({"ph": "M", "pid": PROCESS, "tid": thread, "name": "thread_name", "args": {"name": name}}))?;
    }
    // Times count from the first call, so that a viewer that keeps them as floats loses nothing.
    let begin = calls.calls.iter().map(|call| call.start_ns).chain(calls.drops.iter().map(|drop| drop.at_ns)).min();
    let us = |ns: u64| (ns - begin.unwrap_or(0)) as f64 / 1e3;
    let mut followed = std::collections::HashSet::new();
    for call in &calls.calls {
        let name = &*calls.nodes[call.node as usize];
        let args = json!({
            "tick": call.seq,
            "source": call.source,
            "made": call.made,
            "read_bytes": call.read_bytes,
            "made_bytes": call.made_bytes,
        });
        put(&json!({
            "ph": "X", "pid": PROCESS, "tid": call.thread, "name": name, "cat": "node",
            "ts": us(call.start_ns), "dur": (call.end_ns - call.start_ns) as f64 / 1e3, "args": args,
        }))?;
        let begins = followed.insert((call.source, call.seq));
        put(&json!({
            "ph": if begins { "s" } else { "t" }, "pid": PROCESS, "tid": call.thread, "name": "tick", "cat": "tick",
            "id": flow(call), "ts": us(call.start_ns),
        }))?;
    }
    for drop in &calls.drops {
        let name = format!("{} dropped tick {}", calls.nodes[drop.node as usize], drop.seq);
        put(
            &json!({"ph": "i", "s": "p", "pid": PROCESS, "tid": 0, "name": name, "cat": "drop", "ts": us(drop.at_ns)}),
        )?;
    }
    out.write_all(b"\n]\n")?;
    out.flush()
}

/// One number per tick of a source.
fn flow(call: &Call) -> u64 {
    (u64::from(call.source) << 40) ^ call.seq
}

#[cfg(test)]
mod tests {
    use panoscope_engine::trace::Tracer;
    use panoscope_testing::Folder;

    use super::super::tests::enter;
    use super::*;

    #[test]
    fn the_file_has_rows_slices_arrows_and_drops() {
        let timeline = Timeline::default();
        enter(&timeline, "camera", 0, 10, 11);
        enter(&timeline, "sink", 0, 12, 15);
        timeline.dropped("camera", 1, 13_000_000);
        let folder = Folder::new("perfetto", &[]);
        let path = folder.at("trace.json");
        write(&timeline, &path).expect("it is written");
        let events: Vec<Value> = serde_json::from_str(&folder.read("trace.json")).expect("a JSON array");
        let of = |phase: &str| events.iter().filter(|event| event["ph"] == phase).cloned().collect::<Vec<_>>();
        let slices = of("X");
        assert_eq!(slices.len(), 2);
        assert_eq!(
            (&slices[1]["name"], &slices[1]["ts"], &slices[1]["dur"]),
            (&json!("sink"), &json!(2000.0), &json!(3000.0))
        );
        assert_eq!(slices[1]["args"]["tick"], 0);
        assert_eq!((of("s").len(), of("t").len()), (1, 1), "one arrow, from the camera to the sink");
        assert_eq!(of("s")[0]["id"], of("t")[0]["id"]);
        assert_eq!(of("i")[0]["name"], "camera dropped tick 1");
        assert_eq!(of("M").len(), 2, "the process and one thread");
        assert!(!folder.at("trace.json.partial").exists());
    }

    #[test]
    fn a_folder_that_is_not_there_is_an_error() {
        let folder = Folder::new("perfetto-missing", &[]);
        assert_eq!(
            write(&Timeline::default(), &folder.at("no/such/trace.json")).expect_err("no folder").kind(),
            io::ErrorKind::NotFound
        );
    }
}
