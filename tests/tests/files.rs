//! What sinks write in a running graph survives edits, refused edits, faults and a second writer; losses are reported.

use std::path::{Path, PathBuf};
use std::time::Duration;

use panoscope_engine::fault::Action;
use panoscope_engine::{Options, SetError};
use panoscope_host::loader::Live;
use panoscope_tests::{ready, scratch, wait_until};

use crate::video::whole_frames;

const PATIENCE: Duration = Duration::from_secs(60);

fn video(id: &str, path: &Path, more: &str) -> String {
    // Room enough that a busy machine drops nothing.
    format!(
        "[nodes.{id}]\ntype = \"write_video\"\ninputs = {{ image = {{ from = \"camera.image\", queue = 500 }} }}\n\
         params = {{ path = \"{}\"{more} }}\n",
        path.display()
    )
}

fn graph(nodes: &str) -> String {
    format!(
        "mode = \"live\"\nplugins = [\"flow\", \"sinks\"]\n[nodes.camera]\ntype = \"frames\"\n\
         params = {{ width_px = 32, height_px = 24, rate_hz = 200.0 }}\n{nodes}"
    )
}

fn start(text: &str) -> Result<Live, String> {
    let path = Path::new("files.toml");
    ready(path, text)?.start(Options { threads: 2, ..Options::default() }).map_err(|error| error.to_string())
}

fn made(live: &Live, node: &str) -> u64 {
    live.engine().report().nodes.get(node).map_or(0, |n| n.count)
}

fn more_frames(live: &Live, node: &str) {
    let before = made(live, node);
    wait_until("frames are written", || made(live, node) > before + 10);
}

/// Stops the run; returns the number of calls of a node.
fn end(live: &Live, node: &str) -> u64 {
    live.engine().stop();
    assert!(live.engine().wait(Some(PATIENCE)), "it does not end");
    live.engine().close(PATIENCE);
    made(live, node)
}

/// Number of frames of a completed video: a known size, complete JPEGs, an index.
fn frames(path: &Path) -> u64 {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let segment = bytes.windows(4).position(|w| w == [0x18, 0x53, 0x80, 0x67]).expect("a segment");
    let size = u64::from_be_bytes(bytes[segment + 4..segment + 12].try_into().expect("eight bytes")) & !(0xFF << 56);
    assert_eq!(segment as u64 + 12 + size, bytes.len() as u64, "{} was not completed", path.display());
    let (frames, end) = whole_frames(&bytes);
    assert_ne!(bytes.get(end..end + 4), Some(&[0x1F, 0x43, 0xB6, 0x75][..]), "frame {frames} is cut off");
    frames as u64
}

fn names(folder: &Path) -> Vec<String> {
    panoscope_tests::files(folder).into_iter().map(|(name, _)| name).collect()
}

#[test]
fn a_refused_change_of_path_leaves_the_file_as_it_is() {
    let folder = scratch("files-refused");
    let file = folder.join("v.mkv");
    let mut live = start(&graph(&video("out", &file, ""))).expect("a good graph");
    more_frames(&live, "out");
    // The first is found when the new node opens, the second when the new graph is checked.
    let unchanged = [("/proc/nowhere/v.mkv", "nothing was changed"), ("/dev/null/v.mkv", "the old one keeps running")];
    for (path, words) in unchanged {
        let refused =
            live.set_param("out", "path", &path.into()).expect_err("nothing can be written there").to_string();
        assert!(refused.contains(words) && refused.contains(path), "{refused}");
        more_frames(&live, "out");
    }
    // Refused for another node's sake.
    let refused = live.edit(|edit| {
        edit.set_param("out", "path", &folder.join("w.mkv").to_string_lossy().into_owned().into())?;
        edit.add_node("bad", "write_video")?;
        edit.set_input("bad", "image", &["camera.image"])?;
        edit.set_param("bad", "path", &"/proc/nowhere/v.mkv".into())
    });
    assert!(refused.is_err_and(|e| e.to_string().contains("`bad`")));
    more_frames(&live, "out");
    let count = end(&live, "out");
    assert_eq!(names(&folder), ["v.mkv"], "one file, as if nothing had been asked");
    assert_eq!(frames(&file), count);
    std::fs::remove_dir_all(folder).expect("it is removed");
}

#[test]
fn a_reopened_sink_goes_on_in_the_next_part() {
    let folder = scratch("files-parts");
    let file = folder.join("v.mkv");
    // What an earlier run left is replaced once, not twice.
    std::fs::write(&file, "earlier").expect("a file");
    let mut live = start(&graph(&video("out", &file, ""))).expect("a good graph");
    more_frames(&live, "out");
    live.set_param("out", "fps", &25.0.into()).expect("a good change");
    more_frames(&live, "out");
    let other = folder.join("w.mkv");
    live.set_param("out", "path", &other.to_string_lossy().into_owned().into()).expect("a good change");
    more_frames(&live, "out");
    live.set_param("out", "path", &file.to_string_lossy().into_owned().into()).expect("a good change");
    more_frames(&live, "out");
    let count = end(&live, "out");
    assert_eq!(names(&folder), ["v.mkv", "v.part2.mkv", "v.part3.mkv", "w.mkv"]);
    let all: u64 = names(&folder).iter().map(|name| frames(&folder.join(name))).sum();
    assert_eq!(all, count, "every frame is in one of the files");
    std::fs::remove_dir_all(folder).expect("it is removed");
}

#[test]
fn two_runs_never_write_one_file() {
    let folder = scratch("files-runs");
    let file = folder.join("v.mkv");
    let stills = |id: &str, path: &Path| {
        format!(
            "[nodes.{id}]\ntype = \"write_images\"\ninputs = {{ image = \"camera.image\" }}\nparams = {{ path = \"{}\" }}\n",
            path.display()
        )
    };
    let pattern = folder.join("stills/{seq}.png");
    let first = graph(&(video("out", &file, "") + &stills("still", &pattern)));
    let mut live = start(&first).expect("a good graph");
    more_frames(&live, "out");
    for other in [video("clip", &file, ""), stills("picture", &pattern)] {
        let refused = start(&graph(&other)).err().expect("the other run writes it");
        assert!(refused.contains("another run (process ") && refused.contains(" writes "), "{refused}");
    }
    // A hot swap in the run that has them.
    live.set_param("out", "fps", &25.0.into()).expect("a good change");
    more_frames(&live, "out");
    let count = end(&live, "out");
    assert_eq!(frames(&file) + frames(&folder.join("v.part2.mkv")), count);
    let next = start(&graph(&video("clip", &file, ""))).expect("it is free");
    more_frames(&next, "clip");
    end(&next, "clip");
    assert_eq!(names(&folder), ["v.mkv", "v.part2.mkv"]);
    std::fs::remove_dir_all(folder).expect("it is removed");
}

#[test]
fn files_of_earlier_runs_stay_where_that_is_wanted() {
    let folder = scratch("files-kept");
    let file = folder.join("v.mkv");
    let text = graph(&video("out", &file, ""));
    let mut counts = Vec::new();
    for _ in 0..2 {
        let options = Options { threads: 2, keep_outputs: true, ..Options::default() };
        let ready = ready(Path::new("files.toml"), &text).expect("a good graph");
        let live = ready.start(options).expect("it starts");
        more_frames(&live, "out");
        counts.push(end(&live, "out"));
    }
    assert_eq!([frames(&file), frames(&folder.join("v.part2.mkv"))], counts[..]);
    assert_eq!(names(&folder), ["v.mkv", "v.part2.mkv"]);
    std::fs::remove_dir_all(folder).expect("it is removed");
}

#[test]
fn one_file_has_one_writer() {
    let folder = scratch("files-writers");
    let file = folder.join("v.mkv");
    // Another way to write the same path.
    std::os::unix::fs::symlink(&folder, folder.join("link")).expect("a link");
    let same = folder.join("link/v.mkv");
    let refused = start(&graph(&(video("one", &file, "") + &video("two", &same, "")))).err().expect("two writers");
    assert!(refused.contains("one") && refused.contains("two"), "{refused}");

    let mut live = start(&graph(&video("one", &file, ""))).expect("a good graph");
    more_frames(&live, "one");
    let add = |live: &mut Live, id: &str, path: &Path| {
        live.edit(|edit| {
            edit.add_node(id, "write_video")?;
            edit.set_input(id, "image", &["camera.image"])?;
            edit.set_param(id, "path", &path.to_string_lossy().into_owned().into())
        })
    };
    let refused = add(&mut live, "two", &same).expect_err("two writers").to_string();
    assert!(refused.contains("one") && refused.contains("two"), "{refused}");
    let other = folder.join("w.mkv");
    add(&mut live, "two", &other).expect("a file of its own");
    more_frames(&live, "two");
    let refused = live.set_param("two", "path", &same.to_string_lossy().into_owned().into());
    let refused = refused.expect_err("two writers").to_string();
    assert!(refused.contains("one") && refused.contains("two"), "{refused}");
    let value = panoscope_graph::ParamValue::Path(same.clone());
    let refused = live.engine().set_param("two", "path", value).expect_err("two writers");
    assert!(matches!(&refused, SetError::Reopen { reason, .. } if reason.contains("`one`")), "{refused}");
    more_frames(&live, "two");
    let counts = (made(&live, "one"), end(&live, "two"));
    assert!(frames(&file) >= counts.0 && frames(&other) == counts.1);
    std::fs::remove_file(folder.join("link")).expect("it is removed");
    std::fs::remove_dir_all(folder).expect("it is removed");
}

#[test]
fn one_edit_swaps_files_and_renames_their_writer() {
    let folder = scratch("files-swap");
    let (v, w) = (folder.join("v.mkv"), folder.join("w.mkv"));
    let mut live = start(&graph(&(video("one", &v, "") + &video("two", &w, "")))).expect("a good graph");
    more_frames(&live, "one");
    live.apply_text(&graph(&(video("one", &w, "") + &video("two", &v, "")))).expect("they swap");
    more_frames(&live, "one");
    live.apply_text(&graph(&(video("three", &w, "") + &video("two", &v, "")))).expect("a new name");
    more_frames(&live, "three");
    end(&live, "three");
    let parts = ["v.mkv", "v.part2.mkv", "w.mkv", "w.part2.mkv", "w.part3.mkv"];
    assert_eq!(names(&folder), parts);
    assert!(parts.iter().all(|name| frames(&folder.join(name)) > 0));
    std::fs::remove_dir_all(folder).expect("it is removed");
}

#[test]
fn a_full_disk_stops_the_sink_once_and_fails_the_run() {
    let folder = scratch("files-full");
    // What is written there finds no room.
    std::os::unix::fs::symlink("/dev/full", folder.join("full.mkv")).expect("a link");
    let text = graph(&(video("out", &folder.join("full.mkv"), "") + &video("good", &folder.join("good.mkv"), "")));
    let mut live = start(&text).expect("a good graph");
    wait_until("the full disk is met", || !live.engine().report().stopped.is_empty());
    // Long enough for the shortest rests after a fault, were it opened again.
    let before = made(&live, "good");
    wait_until("the others go on", || made(&live, "good") > before + 100);
    let report = live.engine().report();
    assert!(report.stopped["out"].contains("the disk is full"), "{:?}", report.stopped);
    assert_eq!((report.nodes["out"].faults, report.nodes["out"].restarts), (1, 0));
    let faults = live.engine().recent_faults();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!((faults[0].node.as_str(), faults[0].done), ("out", Action::Bypass));
    // With another path it goes on; the run has failed nevertheless.
    let other: PathBuf = folder.join("room.mkv");
    live.set_param("out", "path", &other.to_string_lossy().into_owned().into()).expect("a good change");
    wait_until("it writes again", || std::fs::metadata(&other).is_ok_and(|m| m.len() > 10_000));
    let count = end(&live, "good");
    assert_eq!(frames(&folder.join("good.mkv")), count);
    assert!(frames(&other) > 0 && live.engine().report().stopped.contains_key("out"));
    std::fs::remove_dir_all(folder).expect("it is removed");
}
