//! Videos of every codec are read back by GStreamer and ffprobe: numbers and times of the frames, and what a kill leaves.

use crate::common;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::{Folder, decode, numbered};
use panoscope_node::harness::{Harness, Setup};
use panoscope_node::{Bgr8, Gray8};
use panoscope_sinks::write_video::WriteVideo;

const SIZE_PX: (usize, usize) = (160, 96);
const CHILD: &str = "PANOSCOPE_TEST_VIDEO_CHILD";

/// Codecs and files that hold them.
const FILES: &[(&str, &str)] = &[
    ("mjpg", "mkv"),
    ("h264", "mkv"),
    ("hevc", "mkv"),
    ("mpeg4", "mkv"),
    ("vp8", "mkv"),
    ("ffv1", "mkv"),
    ("vp8", "webm"),
    ("mjpg", "mp4"),
    ("h264", "mp4"),
    ("hevc", "mp4"),
    ("mpeg4", "mp4"),
    ("mjpg", "mov"),
    ("h264", "mov"),
    ("hevc", "mov"),
    ("mpeg4", "mov"),
    ("vp8", "mov"),
    ("mjpg", "avi"),
    ("h264", "avi"),
    ("mpeg4", "avi"),
];

fn open(folder: &Path, params: &str) -> Harness<WriteVideo> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(folder)).unwrap()
}

fn write(node: &mut Harness<WriteVideo>, number: u64, time_ms: i64) {
    node.at_tick(number, time_ms * 1_000_000);
    let picture = numbered(SIZE_PX, number);
    node.input_image::<Bgr8>("image", SIZE_PX.0, SIZE_PX.1, &picture).process().unwrap();
}

/// Times of the frames in ms as ffprobe reads them.
fn probed_ms(path: &Path) -> Option<Vec<i64>> {
    let probe = Command::new("ffprobe")
        .args(["-v", "error", "-select_streams", "v:0", "-show_entries", "frame=best_effort_timestamp_time"])
        .args(["-of", "csv=p=0"])
        .arg(path)
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&probe.stdout).into_owned();
    assert!(probe.status.success() && probe.stderr.is_empty(), "{}", String::from_utf8_lossy(&probe.stderr));
    let ms = |line: &str| (line.trim_end_matches(',').parse::<f64>().unwrap() * 1000.0).round() as i64;
    Some(text.lines().filter(|line| !line.is_empty()).map(ms).collect())
}

#[test]
fn every_codec_keeps_all_pictures_and_their_times() {
    let folder = Folder::new("all_codecs");
    // 25 Hz with a gap of three pictures.
    let times_ms: Vec<i64> = (0..30).map(|k| if k < 20 { k * 40 } else { k * 40 + 120 }).collect();
    for (codec, ending) in FILES {
        let file = folder.0.join(format!("{codec}.{ending}"));
        let mut node = open(&folder.0, &format!(r#"path = "{codec}.{ending}", codec = "{codec}""#));
        for (number, time_ms) in times_ms.iter().enumerate() {
            write(&mut node, number as u64, *time_ms);
        }
        node.finish().unwrap();
        drop(node);
        let pictures = decode(&file);
        let mut numbers: Vec<u64> = pictures.iter().map(|p| p.number().expect("a number")).collect();
        let times: Vec<i64> =
            pictures.iter().map(|p| p.time_ns.map_or(-1, |ns| (ns as f64 / 1e6).round() as i64)).collect();
        if *ending == "avi" {
            // A constant rate: the picture before the gap is repeated.
            assert_eq!(numbers.len(), 33, "{codec}.{ending}: {numbers:?}");
            numbers.dedup();
        } else {
            assert_eq!(times, times_ms, "{codec}.{ending}");
        }
        assert_eq!(numbers, (0..30).collect::<Vec<_>>(), "{codec}.{ending}");
        if let Some(probed) = probed_ms(&file)
            && *ending != "avi"
        {
            assert_eq!(probed, times_ms, "{codec}.{ending} by ffprobe");
        }
    }
}

#[test]
fn ffv1_brings_back_every_bit() {
    let folder = Folder::new("lossless");
    // Odd sides, and noise that no lossy codec keeps.
    let (width, height) = (65, 49);
    let noise = |seed: u32| -> Vec<u8> {
        let mut state = seed;
        let next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        std::iter::repeat_with(next).take(width * height * 3).collect()
    };
    let mut node = open(&folder.0, r#"path = "v.mkv", codec = "ffv1""#);
    for number in 0..5 {
        node.at_tick(u64::from(number), i64::from(number) * 33_000_000);
        node.input_image::<Bgr8>("image", width, height, &noise(number)).process().unwrap();
    }
    let gray: Vec<u8> = noise(9)[..width * height].to_vec();
    node.at_tick(5, 165_000_000);
    node.input_image::<Gray8>("image", width, height, &gray).process().unwrap();
    node.finish().unwrap();
    let pictures = decode(&folder.0.join("v.mkv"));
    assert_eq!(pictures.len(), 6);
    for (number, picture) in pictures.iter().take(5).enumerate() {
        assert_eq!(picture.size_px, (width, height));
        assert!(picture.bgr == noise(number as u32), "picture {number} differs");
    }
    let expected: Vec<u8> = gray.iter().flat_map(|&g| [g, g, g]).collect();
    assert!(pictures[5].bgr == expected, "the gray picture differs");
}

#[test]
fn quality_parameters_change_the_size() {
    let folder = Folder::new("quality");
    let len = |name: &str, params: &str| {
        let mut node = open(&folder.0, &format!(r#"path = "{name}", {params}"#));
        (0..20).for_each(|number| write(&mut node, number, number as i64 * 40));
        node.finish().unwrap();
        std::fs::metadata(folder.0.join(name)).unwrap().len()
    };
    for (codec, good, poor) in [
        ("h264", "crf = 12", "crf = 40"),
        ("hevc", "crf = 12", "crf = 40"),
        ("mjpg", "quality = 95", "quality = 20"),
        ("mpeg4", "quality = 95", "quality = 20"),
        ("vp8", "quality = 95", "quality = 20"),
    ] {
        let good = len(&format!("{codec}_good.mkv"), &format!(r#"codec = "{codec}", {good}"#));
        let poor = len(&format!("{codec}_poor.mkv"), &format!(r#"codec = "{codec}", {poor}"#));
        assert!(good as f64 > poor as f64 * 1.3, "{codec}: {good} and {poor} bytes");
    }
}

#[test]
fn files_that_cannot_hold_a_codec_are_refused() {
    let folder = Folder::new("refused");
    for (codec, ending) in [("ffv1", "avi"), ("hevc", "avi"), ("vp8", "mp4"), ("ffv1", "mov"), ("h264", "webm")] {
        let setup = Setup::new(&format!(r#"params = {{ path = "v.{ending}", codec = "{codec}" }}"#));
        let found = Harness::<WriteVideo>::problems(&setup.graph_dir(&folder.0), &["image"]).unwrap();
        let message = found.iter().map(|problem| problem.message.as_str()).collect::<String>();
        assert!(message.contains(&format!("a .{ending} file cannot hold")), "{codec}.{ending}: {message}");
    }
}

#[test]
fn pictures_below_16_px_are_refused_where_the_file_cannot_hold_them() {
    let folder = Folder::new("small");
    for (ending, is_held) in [("mp4", false), ("mov", false), ("avi", false), ("mkv", true)] {
        let name = format!("v.{ending}");
        let mut node = open(&folder.0, &format!(r#"path = "{name}""#));
        let outcome = node.input_image::<Bgr8>("image", 40, 8, &[90; 40 * 8 * 3]).process();
        match outcome.err().map(|error| error.to_string()) {
            None => assert!(is_held, "{ending}"),
            Some(error) => {
                let words = "cannot hold frames of 40x8 px, it needs at least 16x16: write .mkv";
                assert!(!is_held && error.contains(&name) && error.contains(words), "{error}");
                // Larger ones are written afterwards.
                node.input_image::<Bgr8>("image", 40, 16, &[90; 40 * 16 * 3]).process().unwrap();
            }
        }
        node.finish().unwrap();
        assert_eq!(decode(&folder.0.join(&name)).len(), 1);
    }
}

/// Runs in the child: writes frames and prints each that was accepted, until it is killed.
fn write_until_killed(codec: &str, folder: &Path) -> ! {
    use std::io::Write as _;
    let mut node = open(folder, &format!(r#"path = "{codec}.mkv", codec = "{codec}""#));
    for number in 0.. {
        write(&mut node, number % 4096, number as i64 * 20);
        let mut out = std::io::stdout().lock();
        writeln!(out, "written {number}").unwrap();
        out.flush().unwrap();
    }
    unreachable!()
}

#[test]
fn a_killed_writer_leaves_every_accepted_picture() {
    if let Ok(job) = std::env::var(CHILD) {
        let (codec, folder) = job.split_once(':').unwrap();
        write_until_killed(codec, Path::new(folder));
    }
    let folder = Folder::new("killed");
    for (codec, kill_after) in [("mjpg", 23), ("h264", 41), ("hevc", 17), ("mpeg4", 30), ("vp8", 12), ("ffv1", 25)] {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "video::a_killed_writer_leaves_every_accepted_picture", "--nocapture"])
            .env(CHILD, format!("{codec}:{}", folder.0.display()))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut accepted = None;
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        for line in lines.by_ref() {
            let line = line.unwrap();
            accepted = line.split("written ").nth(1).and_then(|n| n.parse::<u64>().ok()).or(accepted);
            if accepted >= Some(kill_after) {
                break;
            }
        }
        child.kill().unwrap();
        // What was accepted before the kill came.
        for line in lines {
            let line = line.unwrap();
            accepted = line.split("written ").nth(1).and_then(|n| n.parse::<u64>().ok()).or(accepted);
        }
        child.wait().unwrap();
        let accepted = accepted.unwrap();
        let pictures = decode(&folder.0.join(format!("{codec}.mkv")));
        let numbers: Vec<u64> = pictures.iter().filter_map(common::Decoded::number).collect();
        let expected: Vec<u64> = (0..=accepted).collect();
        assert!(
            numbers.len() > accepted as usize && numbers[..expected.len()] == expected,
            "{codec}: {accepted} accepted, found {numbers:?}"
        );
    }
}
