//! Containers, codecs and pixel formats; times; live sources.

use std::time::{Duration, Instant};

use crate::common::{Folder, drain, drain_to_failure, encode, number, scene, value};
use panoscope_capture::capture::Capture;
use panoscope_node::Bgr8;
use panoscope_node::harness::{Harness, Level, Setup};

const SIZE: (usize, usize) = (160, 128);

fn live(folder: &Folder, params: &str) -> Harness<Capture> {
    Harness::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&folder.0)).unwrap()
}

#[test]
fn every_container_gives_its_pictures_in_order_with_their_times() {
    let folder = Folder::new("formats");
    for (name, encoder) in [
        ("a.avi", "jpegenc ! avimux"),
        ("jpeg.mkv", "jpegenc ! matroskamux"),
        ("h264.mkv", "x264enc key-int-max=8 ! h264parse ! matroskamux"),
        ("b_frames.mp4", "x264enc bframes=3 b-adapt=false key-int-max=12 ! h264parse ! mp4mux"),
        ("h264.avi", "x264enc tune=zerolatency ! video/x-h264,stream-format=byte-stream ! h264parse ! avimux"),
        ("ffv1.mkv", "avenc_ffv1 ! matroskamux"),
        ("vp8.mkv", "vp8enc deadline=1 ! matroskamux"),
    ] {
        encode(&folder.0.join(name), 25.0, SIZE, encoder, (0..24).map(|index| (index, scene(index + 7, SIZE))));
        let mut node = folder.open(&format!(r#"left = "{name}", right = "{name}""#));
        let all = drain(&mut node);
        let shown: Vec<Option<usize>> = all.iter().map(|out| number(out, "left")).collect();
        assert_eq!(shown, (7..31).map(Some).collect::<Vec<_>>(), "{name}: {:?}", node.logs());
        for (index, out) in all.iter().enumerate() {
            let expected_ns = index as i64 * 40_000_000;
            assert!((out.tick().capture_ns - expected_ns).abs() <= 1_000_000, "{name} {index}: {:?}", out.tick());
            assert_eq!(number(out, "right"), number(out, "left"), "{name}");
            assert_eq!(out.arrived_ns(), None, "a file has no arrival");
        }
        assert_eq!(node.metric("damaged"), Some(0.0), "{name}");
    }
}

#[test]
fn a_whole_file_is_not_called_cut_off_whatever_its_times_are() {
    let folder = Folder::new("times");
    let encoded = |name: &str, encoder: &str, at: &[usize]| {
        let path = folder.0.join(name);
        encode(&path, 25.0, SIZE, encoder, at.iter().map(|index| (*index, scene(index % 60 + 1, SIZE))));
        std::fs::read(path).unwrap()
    };
    // Frames that are shown for longer, and a recording that begins after an hour.
    let uneven = [0, 1, 2, 40, 41, 200, 201, 202, 203];
    encoded("uneven.mkv", "x264enc ! h264parse ! matroskamux", &uneven);
    let late: Vec<usize> = (90_000..90_020).collect();
    encoded("late.mkv", "jpegenc ! matroskamux", &late);
    // A clock that jumps by nine minutes.
    let transport = "x264enc key-int-max=8 ! h264parse ! mpegtsmux";
    let first = encoded("first.ts", transport, &(0..20).collect::<Vec<_>>());
    let second = encoded("second.ts", transport, &(13_500..13_520).collect::<Vec<_>>());
    std::fs::write(folder.0.join("jump.ts"), [first, second].concat()).unwrap();
    for (name, count) in [("uneven.mkv", 9), ("late.mkv", 20), ("jump.ts", 40)] {
        let mut node = folder.open(&format!(r#"left = "{name}""#));
        let (all, failure) = drain_to_failure(&mut node);
        assert_eq!((all.len(), failure), (count, None), "{name}");
    }
    // Half of a file that states its length.
    let bytes = std::fs::read(folder.0.join("late.mkv")).unwrap();
    std::fs::write(folder.0.join("half.mkv"), &bytes[..bytes.len() / 2]).unwrap();
    let (all, failure) = drain_to_failure(&mut folder.open(r#"left = "half.mkv""#));
    let failure = failure.expect("it is cut off");
    assert!(all.len() < 15 && failure.contains("is truncated"), "{failure}");
}

#[test]
fn pixels_that_gstreamer_does_not_know_are_named_and_end_nothing() {
    let folder = Folder::new("pixels");
    // Headers of FFV1 key frames: gray of 10 and 12 bits, and RGB of 16 bits.
    for (name, header) in [
        ("gray10le", [134, 36, 167, 245, 213, 171, 86, 173, 90, 181, 106, 109]),
        ("gray12le", [134, 44, 23, 245, 213, 171, 86, 173, 90, 181, 106, 109]),
        ("gbrp16le", [128, 235, 25, 222, 18, 36, 72, 145, 34, 68, 137, 5]),
    ] {
        let file = folder.0.join(name);
        std::fs::write(&file, [&header[..], &[0; 64]].concat()).unwrap();
        let caps = "video/x-ffv,ffvversion=1,width=64,height=48,framerate=25/1";
        // The queue keeps the decoder from reading the file itself, without the caps.
        let source = format!("filesrc location={} blocksize=4000 ! {caps} ! queue", file.display());
        let message = folder.refused(&format!("left = '{source}'"));
        assert!(message.contains(&format!("pixel format `{name}`")) && message.contains("ffmpeg"), "{message}");
    }
}

#[test]
fn jpegs_without_a_container_are_all_shown() {
    let folder = Folder::new("jpegs");
    let name = "a \"b\" \\ c.mjpeg";
    encode(&folder.0.join("a.mjpeg"), 25.0, SIZE, "jpegenc", (0..10).map(|index| (index, scene(index + 7, SIZE))));
    std::fs::rename(folder.0.join("a.mjpeg"), folder.0.join(name)).unwrap();
    let mut node = folder.open(&format!("left = '{name}'"));
    let shown: Vec<Option<usize>> = drain(&mut node).iter().map(|out| number(out, "left")).collect();
    assert_eq!(shown, (7..17).map(Some).collect::<Vec<_>>(), "{:?}", node.logs());
}

#[test]
fn a_gif_is_refused_at_once() {
    let folder = Folder::new("gif");
    std::fs::write(folder.0.join("a.gif"), b"GIF89a").unwrap();
    let begun = Instant::now();
    let message = folder.refused(r#"left = "a.gif""#);
    assert!(message.contains("GIF files are not supported") && message.contains("ffmpeg"), "{message}");
    assert!(begun.elapsed() < Duration::from_secs(5), "{message}");
}

#[test]
fn pipelines_end_in_any_format() {
    let folder = Folder::new("tails");
    let frames = (0..6).map(|index| (index, scene(index + 1, SIZE)));
    encode(&folder.0.join("v.mkv"), 25.0, SIZE, "x264enc ! h264parse ! matroskamux", frames);
    let file = folder.0.join("v.mkv").display().to_string();
    for tail in [
        " ! matroskademux",
        " ! decodebin",
        " ! decodebin ! appsink",
        " ! decodebin ! videoconvert ! video/x-raw,format=YUY2",
        " ! decodebin ! videoconvert ! video/x-raw,format=YUY2 ! appsink name=mine",
        " ! decodebin ! videoconvert ! video/x-raw,format=GRAY8",
        " ! decodebin ! videoconvert ! video/x-raw,format=RGBA ! appsink",
        " ! decodebin ! videoconvert ! jpegenc",
        " ! decodebin ! videoconvert ! x264enc ! appsink",
    ] {
        let text = format!("filesrc location={file}{tail}");
        if tail.contains("x264enc ! appsink") {
            // An appsink of the user's own is given what no picture is.
            let message = folder.refused(&format!("left = '{text}'"));
            assert!(message.contains("does not open"), "{message}");
            continue;
        }
        let all = drain(&mut folder.open(&format!("left = '{text}'")));
        let shown: Vec<Option<usize>> = all.iter().map(|out| number(out, "left")).collect();
        assert_eq!(shown, (1..7).map(Some).collect::<Vec<_>>(), "{tail}");
    }
}

#[test]
fn luma_and_chroma_have_the_values_of_the_standard() {
    let folder = Folder::new("levels");
    for format in ["I420", "NV12", "Y42B", "YUY2", "Y444"] {
        for (color, level) in [("0xffffffff", 255_u8), ("0xff808080", 128), ("0xff000000", 0)] {
            let caps = format!("video/x-raw,format={format},width=34,height=25,colorimetry=bt709");
            let text = format!("videotestsrc num-buffers=1 pattern=solid-color foreground-color={color} ! {caps}");
            let mut node = folder.open(&format!("left = '{text}'"));
            let out = node.process().unwrap();
            let plane = out.plane::<Bgr8>("left").unwrap();
            // The generator rounds chroma, which hardly changes green.
            let green = plane.row(24)[3 * 33 + 1];
            assert!(green.abs_diff(level) <= 1, "{format} {color}: {green}");
        }
    }
}

#[test]
fn deep_gray_keeps_its_depth() {
    let folder = Folder::new("gray16");
    let text = "videotestsrc num-buffers=2 pattern=white ! video/x-raw,format=GRAY16_LE,width=32,height=24";
    let mut node = folder.open(&format!(r#"left = "{text}""#));
    assert!(value(&node.process().unwrap(), "left") >= 235);
    assert!(node.logs().iter().any(|line| line.message.contains("more than 8 bits")), "{:?}", node.logs());
}

#[test]
fn interlaced_pictures_are_made_of_one_field_and_odd_pixels_are_kept() {
    let folder = Folder::new("interlaced");
    let combed = image::GrayImage::from_fn(720, 576, |_, y| image::Luma([if y % 2 == 0 { 40 } else { 200 }]));
    combed.save(folder.0.join("combed.png")).unwrap();
    let caps = "video/x-raw,interlace-mode=(string)interleaved,pixel-aspect-ratio=(fraction)12/11";
    let text = format!(
        "filesrc location={} ! decodebin ! imagefreeze num-buffers=6 ! videoconvert ! video/x-raw,format=I420 ! capssetter caps=\"{caps}\"",
        folder.0.join("combed.png").display()
    );
    let mut node = folder.open(&format!("left = '{text}'"));
    let all = drain(&mut node);
    assert!(all.len() >= 5, "{}", all.len());
    let left = all[2].plane::<Bgr8>("left").unwrap();
    assert_eq!((left.width, left.height), (720, 576), "pixels are never resampled");
    for y in 2..570 {
        // Dark rows, as videos hold them; the other field is bright.
        assert!(left.row(y)[300] < 50, "row {y} is {}: the other field shows", left.row(y)[300]);
    }
    let said = |words: &str| node.logs().iter().any(|line| line.level == Level::Info && line.message.contains(words));
    assert!(said("12:11") && said("fx and fy") && said("interlaced"), "{:?}", node.logs());
}

#[test]
fn a_picture_in_a_queue_is_as_old_as_its_light() {
    let folder = Folder::new("age");
    let source = "videotestsrc is-live=true ! video/x-raw,width=64,height=48,framerate=30/1";
    let queue = "queue max-size-buffers=0 max-size-bytes=0 max-size-time=0 min-threshold-time=700000000";
    for (text, min_ms, max_ms) in [(source.to_owned(), 0.0, 500.0), (format!("{source} ! {queue}"), 600.0, 1500.0)] {
        let mut node = live(&folder, &format!(r#"left = "{text}", timeout_s = 5.0"#));
        let mut times = Vec::new();
        for _ in 0..20 {
            let out = node.process().unwrap();
            if !out.is_empty("left").unwrap() {
                times.push((out.arrived_ns().unwrap(), out.tick().capture_ns));
            }
        }
        let age_ms = node.metric("latency_ms").unwrap();
        assert!(age_ms >= min_ms && age_ms < max_ms, "{text}: {age_ms} ms");
        // Media time of a live source is its arrival.
        for pair in times.windows(2) {
            assert_eq!(pair[1].0 - pair[0].0, pair[1].1 - pair[0].1, "{pair:?}");
        }
    }
}

#[test]
fn views_that_never_meet_are_said() {
    let folder = Folder::new("apart");
    let source = "videotestsrc is-live=true ! video/x-raw,width=64,height=48,framerate=30/1";
    // A tolerance that two free-running views hardly ever meet, and one that they always do.
    let queue = "queue max-size-buffers=0 max-size-bytes=0 max-size-time=0 min-threshold-time=600000000";
    let views = format!(r#"left = "{source}", right = "{source} ! {queue}", timeout_s = 1.0"#);
    let mut node = live(&folder, &views);
    let begin = Instant::now();
    loop {
        let out = node.process().unwrap();
        if let Some(words) = out.fault() {
            assert!(words.contains("arrived within") && words.contains("tolerance_ms"), "{words}");
            return;
        }
        assert!(begin.elapsed() < Duration::from_secs(60), "{:?}", node.logs());
    }
}
