//! Every file that a sink writes is read back by another reader.

use std::fs;
use std::path::Path;

use opencv::core::{self, Mat, Vec3b};
use opencv::prelude::*;
use opencv::{imgcodecs, videoio};
use panoscope_node::abi::{CloudPoint, Detection, Homography, STATE_HELD, STATUS_STOPPED};
use panoscope_node::harness::{Files, Harness, Setup};
use panoscope_node::{Bgr8, Depth, Disparity, Gray8, Gray16, GrayF32, Mask};
use panoscope_sinks::preview::Preview;
use panoscope_sinks::write_cloud::WriteCloud;
use panoscope_sinks::write_images::WriteImages;
use panoscope_sinks::write_raw::WriteRaw;
use panoscope_sinks::write_table::WriteTable;
use panoscope_sinks::write_video::WriteVideo;

use crate::common::Folder;

fn read(path: &Path) -> Mat {
    let mat = imgcodecs::imread(path.to_str().unwrap(), imgcodecs::IMREAD_UNCHANGED).unwrap();
    assert!(mat.rows() > 0, "{} is unreadable", path.display());
    mat
}

/// A smooth image, which JPEG nearly preserves.
fn gradient(width: usize, height: usize, shift: usize) -> Vec<u8> {
    (0..height * width)
        .flat_map(|i| {
            let (x, y) = (i % width, i / width);
            [(x * 255 / width) as u8, (y * 255 / height) as u8, ((x + y + shift * 8) * 127 / (width + height)) as u8]
        })
        .collect()
}

#[test]
fn stills_come_back_exactly_from_png() {
    let folder = Folder::new("png");
    let bgr = gradient(31, 17, 0);
    let mut node = folder.open::<WriteImages>(r#"path = "deep/er/{seq:3}.png", every = 2"#);
    for _ in 0..3 {
        node.input_image::<Bgr8>("image", 31, 17, &bgr).process().unwrap();
    }
    drop(node);
    assert_eq!(fs::read_dir(folder.0.join("deep/er")).unwrap().count(), 2);
    let back = read(&folder.0.join("deep/er/002.png"));
    assert_eq!(back.data_bytes().unwrap(), bgr);

    let gray16: Vec<u16> = (0..6).map(|i| i * 10_000).collect();
    folder.open::<WriteImages>(r#"path = "g.png""#).input_image::<Gray16>("image", 3, 2, &gray16).process().unwrap();
    assert_eq!(read(&folder.0.join("g.png")).data_typed::<u16>().unwrap(), gray16);

    let mut both = folder.open::<WriteImages>(r#"path = "two.png""#);
    both.input_image::<Gray8>("image", 2, 1, &[7, 9]).input_image::<Mask>("mask", 2, 1, &[0, 255]);
    both.process().unwrap();
    assert_eq!(read(&folder.0.join("two_mask.png")).data_bytes().unwrap(), [0, 255]);
    assert_eq!(read(&folder.0.join("two_image.png")).data_bytes().unwrap(), [7, 9]);
    assert!(folder.names().iter().all(|name| !name.ends_with("tmp-part")));
}

#[test]
fn the_last_picture_is_written_at_the_end() {
    let folder = Folder::new("last");
    let mut node = folder.open::<WriteImages>(r#"path = "still.png", at_end = true"#);
    for shift in 0..3 {
        node.input_image::<Bgr8>("image", 20, 10, &gradient(20, 10, shift)).process().unwrap();
    }
    assert!(folder.names().is_empty());
    assert_eq!(node.kept_buffers(), 1);
    drop(node);
    assert_eq!(read(&folder.0.join("still.png")).data_bytes().unwrap(), gradient(20, 10, 2));
}

#[test]
fn errors_name_the_file_and_the_help() {
    let folder = Folder::new("errors");
    let refused = |params: &str| {
        let setup = Setup::new(&format!("params = {{ {params} }}")).graph_dir(&folder.0);
        Harness::<WriteImages>::open(setup).err().unwrap().to_string()
    };
    let message = refused(r#"path = "a.gif""#);
    assert!(message.contains("`gif`") && message.contains("png, jpg"), "{message}");
    fs::write(folder.0.join("file"), b"").unwrap();
    let message = refused(r#"path = "file/a.png""#);
    assert!(message.contains("file/a.png") && message.contains("is a file, not a folder"), "{message}");
    let mut node = folder.open::<WriteImages>(r#"path = "a.png""#);
    let message = node.input_image::<GrayF32>("image", 1, 1, &[1.0]).process().err().unwrap().to_string();
    assert!(message.contains("colorize"), "{message}");
    if Path::new("/dev/full").exists() {
        std::os::unix::fs::symlink("/dev/full", folder.0.join("full.jsonl")).unwrap();
        let mut node = folder.open::<WriteTable>(r#"path = "full.jsonl""#);
        let message = node.input_text("text", "x").process().err().unwrap().to_string();
        assert!(message.contains("full.jsonl") && message.contains("the disk is full"), "{message}");
    }
}

#[test]
fn float_planes_come_back_exactly() {
    let folder = Folder::new("raw");
    let plane: Vec<f32> = (0..15).map(|i| if i == 4 { f32::NAN } else { i as f32 * 0.37 }).collect();
    let same =
        |back: &[f32]| back.iter().zip(&plane).all(|(a, b)| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan());
    for ending in ["pfm", "tif"] {
        let mut node = folder.open::<WriteRaw>(&format!(r#"path = "{{seq}}.{ending}""#));
        node.input_image::<Disparity>("disparity", 5, 3, &plane).process().unwrap();
        let back = read(&folder.0.join(format!("000000.{ending}")));
        assert_eq!((back.cols(), back.rows(), back.typ()), (5, 3, core::CV_32FC1));
        assert!(same(back.data_typed::<f32>().unwrap()), "{ending}");
    }
    let mut node = folder.open::<WriteRaw>(r#"path = "{port}.npy""#);
    node.input_image::<Disparity>("disparity", 5, 3, &plane).input_image::<Depth>("depth", 5, 3, &plane);
    node.process().unwrap();
    let bytes = fs::read(folder.0.join("depth.npy")).unwrap();
    let floats: Vec<f32> = bytes[bytes.len() - 60..].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    assert!(same(&floats) && folder.0.join("disparity.npy").exists());
    // Colour and 16 bits in a TIFF, read by OpenCV's decoder.
    let bgr = gradient(7, 4, 1);
    let mut node = folder.open::<WriteRaw>(r#"path = "c.tiff""#);
    node.input_image::<Bgr8>("image", 7, 4, &bgr).process().unwrap();
    assert_eq!(read(&folder.0.join("c.tiff")).data_bytes().unwrap(), bgr);
    let mut node = folder.open::<WriteRaw>(r#"path = "g.tif""#);
    node.input_image::<Gray16>("image", 2, 1, &[1, 65_000]).process().unwrap();
    assert_eq!(read(&folder.0.join("g.tif")).data_typed::<u16>().unwrap(), [1, 65_000]);
    let mut node = folder.open::<WriteRaw>(r#"path = "g.pgm""#);
    node.input_image::<Gray16>("image", 2, 1, &[1, 65_000]).process().unwrap();
    assert_eq!(read(&folder.0.join("g.pgm")).data_typed::<u16>().unwrap(), [1, 65_000]);
    let message = folder
        .open::<WriteRaw>(r#"path = "g.pfm""#)
        .input_image::<Gray8>("image", 1, 1, &[1])
        .process()
        .err()
        .unwrap()
        .to_string();
    assert!(message.contains("PFM holds floats"), "{message}");
}

#[test]
fn clouds_leave_out_unknown_points_and_mark_filled_ones() {
    let folder = Folder::new("ply");
    let point = |x_mm, bgr| CloudPoint { x_mm, y_mm: 2.0, z_mm: 50.0, bgr, filled: 0 };
    let guess = CloudPoint { filled: 1, ..point(-1.5, [4, 5, 6]) };
    let points = [point(1.0, [1, 2, 3]), point(f32::NAN, [0; 3]), guess];
    folder.open::<WriteCloud>(r#"path = "c.ply""#).input_cloud("cloud", 3, 1, &points).process().unwrap();
    let bytes = fs::read(folder.0.join("c.ply")).unwrap();
    let body = b"end_header\n";
    let at = bytes.windows(body.len()).position(|w| w == body).unwrap() + body.len();
    let head = std::str::from_utf8(&bytes[..at]).unwrap();
    assert!(
        head.starts_with("ply\nformat binary_little_endian 1.0\n") && head.contains("element vertex 2\n"),
        "{head}"
    );
    assert!(head.ends_with("property uchar blue\nproperty uchar filled\nend_header\n"), "{head}");
    assert_eq!(bytes.len() - at, 2 * 16);
    let float = |i: usize| f32::from_le_bytes(bytes[at + i..at + i + 4].try_into().unwrap());
    assert_eq!((float(0), float(4), float(8), float(16)), (1.0, 2.0, 50.0, -1.5));
    assert_eq!((&bytes[at + 12..at + 16], bytes[at + 31]), (&[3, 2, 1, 0][..], 1));
}

fn boxes() -> [Detection; 2] {
    let item = |x_px, class_index, track_id| Detection {
        x_px,
        y_px: 1.0,
        width_px: 4.0,
        height_px: 2.0,
        score: 0.9,
        class_index,
        track_id,
    };
    [item(1.5, 1, 7), item(3.0, 0, -1)]
}

#[test]
fn coco_files_parse_and_their_masks_fit() {
    let folder = Folder::new("coco");
    let mut node = folder.open::<WriteTable>(r#"path = "d.json""#);
    // Two masks of 3 x 2 px.
    node.input_instances("instances", &boxes(), "hook\nclip\"per", (3, 2), &[0b1010_0000, 0b1100_0000, 0, 0]);
    node.process().unwrap();
    drop(node);
    let json: serde_json::Value = serde_json::from_slice(&fs::read(folder.0.join("d.json")).unwrap()).unwrap();
    assert_eq!(json["images"][0]["file_name"], "000000.png");
    assert_eq!(json["categories"][1]["name"], "clip\"per");
    let first = &json["annotations"][0];
    assert_eq!((first["category_id"].as_u64(), first["area"].as_u64()), (Some(2), Some(4)));
    assert_eq!(first["bbox"], serde_json::json!([1.5, 1, 4, 2]));
    assert_eq!(first["segmentation"], serde_json::json!({ "size": [2, 3], "counts": [0, 2, 1, 2, 1] }));
    assert_eq!((first["track_id"].as_i64(), first["score"].as_f64()), (Some(7), Some(0.9)));
    assert!(json["annotations"][1].get("track_id").is_none());
    assert_eq!(json["annotations"][1]["area"], 0);
    assert_eq!(folder.names(), ["d.json"]);
}

#[test]
fn the_journal_of_a_run_that_was_cut_off_is_kept() {
    let folder = Folder::new("journal");
    let journal = folder.0.join("d.json.journal");
    fs::write(&journal, "boxes").unwrap();
    let mut node = folder.open::<WriteTable>(r#"path = "d.json""#);
    for _ in 0..2 {
        node.input_detections("detections", &boxes(), "\"image\":\n],\"annotations\":[", (640, 480)).process().unwrap();
    }
    let written = fs::read_to_string(folder.0.join("d.part2.json.journal")).unwrap();
    assert_eq!(written.lines().count(), 2);
    assert!(written.lines().all(|line| serde_json::from_str::<serde_json::Value>(line).is_ok()), "{written}");
    assert!(node.logs().iter().any(|line| line.message.contains("was cut off")), "{:?}", node.logs());
    drop(node);
    let json: serde_json::Value = serde_json::from_slice(&fs::read(folder.0.join("d.part2.json")).unwrap()).unwrap();
    let len = |key: &str| json[key].as_array().unwrap().len();
    assert_eq!((len("images"), len("annotations"), len("categories")), (2, 4, 2), "{json}");
    assert_eq!(json["categories"][0]["name"], "\"image\":");
    assert_eq!(fs::read_to_string(journal).unwrap(), "boxes");
    assert_eq!(folder.names(), ["d.json.journal", "d.part2.json"]);
}

/// Opens a sink on a symbolic link, writes once and closes it.
fn write_through_link(folder: &Folder, name: &str) {
    use std::os::unix::fs::{MetadataExt, symlink};
    let (target, link) = (folder.0.join(format!("target of {name}")), folder.0.join("new/folder").join(name));
    fs::write(&target, "kept").unwrap();
    let params = format!("path = \"new/folder/{name}\"");
    let place = || {
        fs::create_dir_all(link.parent().unwrap()).unwrap();
        symlink(&target, &link).unwrap();
    };
    if name.ends_with("json") || name.ends_with("csv") {
        let mut node = folder.open::<WriteTable>(&params);
        place();
        node.input_detections("detections", &boxes(), "hook\nclipper", (640, 480)).process().unwrap();
    } else if name.ends_with("png") {
        let mut node = folder.open::<WriteImages>(&params);
        place();
        node.input_image::<Bgr8>("image", 64, 48, &gradient(64, 48, 1)).process().unwrap();
    } else {
        let mut node = folder.open::<WriteVideo>(&params);
        place();
        node.input_image::<Bgr8>("image", 64, 48, &gradient(64, 48, 1)).process().unwrap();
    }
    assert_eq!(fs::read_to_string(&target).unwrap(), "kept", "{name}");
    let found = link.symlink_metadata().unwrap();
    assert!(found.is_file() && found.len() > 0, "{name}");
    assert_eq!(found.mode() & 0o777, 0o600, "{name}");
    assert_eq!(folder.0.join("new").metadata().unwrap().mode() & 0o777, 0o700);
}

#[test]
fn files_are_private_and_never_written_through_a_link() {
    let folder = Folder::new("links");
    for name in ["d.json", "d.csv", "p.png", "v.mkv", "v.mp4"] {
        write_through_link(&folder, name);
    }
}

#[test]
fn json_lines_hold_every_packet() {
    let folder = Folder::new("jsonl");
    let mut node = folder.open::<WriteTable>(r#"path = "t.jsonl""#);
    let homography = Homography {
        left_from_right: [1.0, 0.0, f64::NAN, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        rms_px: 0.5,
        inliers: 9,
        state: STATE_HELD,
    };
    node.input_value("homography", homography)
        .input_table("table", &["a_mm", "b"], &[1.0, 2.5, f64::NAN, 4.0])
        .input_text("text", "line\n\"two\"")
        .input_detections("detections", &boxes(), "hook\nclipper", (640, 480));
    node.process().unwrap();
    node.process().unwrap();
    let text = fs::read_to_string(folder.0.join("t.jsonl")).unwrap();
    let lines: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(lines.len(), 2);
    assert_eq!(lines[0]["homography"]["state"], "held");
    assert_eq!(lines[0]["homography"]["left_from_right"][2], serde_json::Value::Null);
    assert_eq!(lines[0]["table"], serde_json::json!([{ "a_mm": 1, "b": 2.5 }, { "a_mm": null, "b": 4 }]));
    assert_eq!(lines[0]["text"], "line\n\"two\"");
    assert_eq!(lines[0]["detections"][0]["label"], "clipper");
    assert_eq!(lines[1]["seq"], 1);
}

#[test]
fn csv_has_one_line_per_row() {
    let folder = Folder::new("csv");
    let mut node = folder.open::<WriteTable>(r#"path = "t.csv""#);
    node.process().unwrap();
    node.input_table("table", &["a_mm", "b"], &[1.0, 2.5, f64::NAN, 4.0]).input_text("text", "x, y").process().unwrap();
    node.input_table("table", &["b", "new"], &[5.0, 6.0]).process().unwrap();
    let text = fs::read_to_string(folder.0.join("t.csv")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "seq,source,capture_ms,text,a_mm,b");
    assert_eq!(lines[1], "1,0,33.333333,\"x, y\",1,2.5");
    assert_eq!(lines[2], "1,0,33.333333,\"x, y\",,4");
    assert_eq!(lines[3], "2,0,66.666666,,,5");
    assert!(node.logs().iter().any(|l| l.message.contains("`new`")));
}

struct Video {
    frames: Vec<Mat>,
    times_ms: Vec<f64>,
}

fn read_video(path: &Path) -> Video {
    let mut capture = videoio::VideoCapture::from_file(path.to_str().unwrap(), videoio::CAP_FFMPEG).unwrap();
    assert!(capture.is_opened().unwrap(), "{} does not open", path.display());
    let (mut frames, mut times_ms) = (Vec::new(), Vec::new());
    let mut mat = Mat::default();
    while capture.read(&mut mat).unwrap() {
        times_ms.push(capture.get(videoio::CAP_PROP_POS_MSEC).unwrap());
        frames.push(mat.clone());
    }
    Video { frames, times_ms }
}

fn mean_difference(mat: &Mat, bgr: &[u8]) -> f64 {
    let bytes = mat.data_bytes().unwrap();
    assert_eq!(bytes.len(), bgr.len());
    bytes.iter().zip(bgr).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / bgr.len() as f64
}

#[test]
fn videos_come_back_with_their_times() {
    let folder = Folder::new("mkv");
    let mut node = folder.open::<WriteVideo>(r#"path = "new/v.mkv""#);
    // The third picture was dropped on the way: the video keeps the gap.
    for (index, ms) in [0_i64, 40, 120, 160, 200].into_iter().enumerate() {
        node.at_tick(index as u64, 5_000_000_000 + ms * 1_000_000);
        node.input_image::<Bgr8>("image", 64, 48, &gradient(64, 48, index)).process().unwrap();
    }
    drop(node);
    let video = read_video(&folder.0.join("new/v.mkv"));
    assert_eq!(video.frames.len(), 5);
    assert_eq!(video.times_ms.iter().map(|t| t.round() as i64).collect::<Vec<_>>(), [0, 40, 120, 160, 200]);
    for (index, frame) in video.frames.iter().enumerate() {
        let difference = mean_difference(frame, &gradient(64, 48, index));
        assert!(difference < 3.0, "frame {index} differs by {difference}");
    }
}

#[test]
fn a_video_of_the_time_that_passed_lasts_as_long_as_it_took() {
    let folder = Folder::new("passed");
    let mut node = folder.open::<WriteVideo>(r#"path = "v.mkv", time = "passed""#);
    let step = std::time::Duration::from_millis(30);
    for index in 0..4_i64 {
        // A slow machine: its source says 1 ms, 30 ms pass.
        node.at_tick(index as u64, index * 1_000_000);
        node.input_image::<Bgr8>("image", 64, 48, &gradient(64, 48, 0)).process().unwrap();
        std::thread::sleep(step);
    }
    drop(node);
    let times = read_video(&folder.0.join("v.mkv")).times_ms;
    assert!(times.windows(2).all(|t| t[1] - t[0] >= 29.0), "{times:?}");
}

#[test]
fn a_constant_rate_file_shows_each_picture_for_its_time() {
    let folder = Folder::new("rate");
    let mut node = folder.open::<WriteVideo>(r#"path = "v.avi""#);
    // 30 Hz, then 10 Hz: 2 s in all.
    let times_ns = (0..30).map(|k| k * 1_000_000_000 / 30).chain((0..10).map(|k| 1_000_000_000 + k * 100_000_000));
    for (index, ns) in times_ns.enumerate() {
        node.at_tick(index as u64, ns);
        node.input_image::<Bgr8>("image", 64, 48, &gradient(64, 48, index)).process().unwrap();
    }
    node.finish().unwrap();
    let video = read_video(&folder.0.join("v.avi"));
    assert_eq!(video.frames.len(), 30 + 9 * 3 + 1);
    assert!((video.times_ms.last().unwrap() - 1900.0).abs() < 40.0, "{:?}", video.times_ms.last());
}

#[test]
fn a_reopened_sink_goes_on_in_the_next_part() {
    let folder = Folder::new("parts");
    let mut video = folder.open::<WriteVideo>(r#"path = "v.mkv""#);
    let mut lines = folder.open::<WriteTable>(r#"path = "t.jsonl""#);
    let mut coco = folder.open::<WriteTable>(r#"path = "d.json""#);
    for index in 0..9 {
        video.input_image::<Bgr8>("image", 64, 48, &gradient(64, 48, index)).process().unwrap();
        lines.input_text("text", "x").process().unwrap();
        coco.input_detections("detections", &boxes(), "hook\nclipper", (640, 480)).process().unwrap();
        if index % 3 == 2 {
            video.reopen().unwrap();
            lines.reopen().unwrap();
            coco.reopen().unwrap();
        }
    }
    drop((video, lines, coco));
    let names = ["d", "t", "v"].iter().zip(["json", "jsonl", "mkv"]);
    let names = names.flat_map(|(n, e)| [format!("{n}.{e}"), format!("{n}.part2.{e}"), format!("{n}.part3.{e}")]);
    assert_eq!(folder.names(), names.collect::<Vec<_>>(), "and no empty part at the end");
    for part in ["v.mkv", "v.part2.mkv", "v.part3.mkv"] {
        assert_eq!(read_video(&folder.0.join(part)).frames.len(), 3, "{part}");
    }
    let text: String =
        ["t.jsonl", "t.part2.jsonl", "t.part3.jsonl"].map(|p| fs::read_to_string(folder.0.join(p)).unwrap()).concat();
    assert_eq!(text.lines().count(), 9);
    for part in ["d.json", "d.part2.json", "d.part3.json"] {
        let json: serde_json::Value = serde_json::from_slice(&fs::read(folder.0.join(part)).unwrap()).unwrap();
        assert_eq!(json["images"].as_array().unwrap().len(), 3, "{part}");
    }
}

#[test]
fn an_instance_that_is_thrown_away_touches_nothing() {
    let folder = Folder::new("unused");
    for (name, text) in [("v.mkv", "a video"), ("t.jsonl", "lines"), ("d.json", "boxes")] {
        fs::write(folder.0.join(name), text).unwrap();
        let setup = || Setup::new(&format!("params = {{ path = \"{name}\" }}")).graph_dir(&folder.0);
        // Closed without having been finished, as one of a refused edit.
        if name == "v.mkv" {
            Harness::<WriteVideo>::open(setup()).unwrap().discard();
        } else {
            Harness::<WriteTable>::open(setup()).unwrap().discard();
        }
        assert_eq!(fs::read_to_string(folder.0.join(name)).unwrap(), text);
    }
    assert_eq!(folder.names(), ["d.json", "t.jsonl", "v.mkv"]);
    // A run that met nothing leaves no earlier run's numbers behind.
    folder.open::<WriteTable>(r#"path = "t.jsonl""#).finish().unwrap();
    assert_eq!(fs::read_to_string(folder.0.join("t.jsonl")).unwrap(), "");
}

#[test]
fn an_unwritable_place_is_found_when_a_sink_opens() {
    let folder = Folder::new("unwritable");
    let refused = |path: &str| {
        let setup = Setup::new(&format!("params = {{ path = \"{path}\" }}")).graph_dir(&folder.0);
        let video = path.ends_with("mkv");
        if video { Harness::<WriteVideo>::open(setup).err() } else { Harness::<WriteTable>::open(setup).err() }
    };
    for path in ["/proc/nowhere/v.mkv", "/proc/nowhere/t.csv", "/proc/self/maps.jsonl"] {
        let message = refused(path).unwrap_or_else(|| panic!("{path} was accepted")).to_string();
        assert!(message.contains(path), "{message}");
    }
}

#[test]
fn one_file_has_one_writer() {
    let folder = Folder::new("writers");
    let run = Files::default();
    let setup = |id: &str| Setup::new("params = { path = \"t.csv\" }").graph_dir(&folder.0).node_id(id).files(&run);
    let first = Harness::<WriteTable>::open(setup("first")).unwrap();
    let message = Harness::<WriteTable>::open(setup("second")).err().unwrap().to_string();
    assert!(message.contains("`first`") && message.contains("t.csv"), "{message}");
    drop(first);
    Harness::<WriteTable>::open(setup("second")).unwrap();
}

#[test]
fn a_full_disk_is_an_error_that_reopening_does_not_repair() {
    let folder = Folder::new("full");
    for name in ["t.jsonl", "t.csv", "v.mkv"] {
        std::os::unix::fs::symlink("/dev/full", folder.0.join(name)).unwrap();
        let setup = Setup::new(&format!("params = {{ path = \"{name}\" }}")).graph_dir(&folder.0);
        let error = if name == "v.mkv" {
            let mut node = Harness::<WriteVideo>::open(setup).unwrap();
            node.input_image::<Bgr8>("image", 8, 6, &gradient(8, 6, 0)).process().err()
        } else {
            Harness::<WriteTable>::open(setup).unwrap().input_text("text", "x").process().err()
        };
        let error = error.unwrap();
        assert_eq!(error.status(), Some(STATUS_STOPPED), "{name}: {error}");
    }
}

#[test]
fn a_video_that_was_never_finished_plays_to_its_last_frame() {
    let folder = Folder::new("crash");
    let mut node = folder.open::<WriteVideo>(r#"path = "v.mkv", fps = 25.0"#);
    for index in 0..6 {
        node.input_image::<Bgr8>("image", 64, 48, &gradient(64, 48, index)).process().unwrap();
    }
    // What a crash would leave now, and the same with half of the last frame.
    let bytes = fs::read(folder.0.join("v.mkv")).unwrap();
    fs::write(folder.0.join("crash.mkv"), &bytes).unwrap();
    fs::write(folder.0.join("torn.mkv"), &bytes[..bytes.len() - 300]).unwrap();
    assert_eq!(read_video(&folder.0.join("crash.mkv")).frames.len(), 6);
    assert!(read_video(&folder.0.join("torn.mkv")).frames.len() >= 5);
}

#[test]
fn other_sizes_are_fitted_with_one_warning() {
    let folder = Folder::new("letterbox");
    let mut node = folder.open::<WriteVideo>(r#"path = "v.mkv""#);
    node.input_image::<Bgr8>("image", 64, 48, &gradient(64, 48, 0)).process().unwrap();
    for _ in 0..2 {
        node.input_image::<Gray8>("image", 32, 48, &[200; 32 * 48]).process().unwrap();
    }
    assert_eq!(node.logs().iter().filter(|l| l.message.contains("black borders")).count(), 1);
    drop(node);
    let video = read_video(&folder.0.join("v.mkv"));
    let pixel = |x, y| *video.frames[2].at_2d::<Vec3b>(y, x).unwrap();
    assert!(pixel(32, 24)[0] > 190 && pixel(2, 24)[0] < 12 && pixel(62, 24)[0] < 12);
}

#[test]
fn other_codecs_write_what_opencv_reads() {
    let folder = Folder::new("codecs");
    for (codec, name) in [
        ("ffv1", "a.mkv"),
        ("mpeg4", "b.mp4"),
        ("vp8", "c.webm"),
        ("h264", "d.mkv"),
        ("mjpg", "e.avi"),
        ("hevc", "f.mkv"),
        ("h264", "g.mp4"),
        ("hevc", "h.mov"),
        ("mjpg", "i.mp4"),
    ] {
        let mut node = folder.open::<WriteVideo>(&format!(r#"path = "{name}", codec = "{codec}""#));
        for index in 0..4 {
            // Odd sides on purpose.
            node.input_image::<Bgr8>("image", 65, 49, &gradient(65, 49, index)).process().unwrap();
        }
        drop(node);
        let video = read_video(&folder.0.join(name));
        assert_eq!(video.frames.len(), 4, "{codec}");
        let last = &video.frames[3];
        // Chroma planes of half the size need even sides.
        let even = matches!(codec, "h264" | "hevc");
        assert_eq!((last.cols(), last.rows()), if even { (66, 50) } else { (65, 49) }, "{codec}");
        let picture = last.roi(core::Rect::new(0, 0, 65, 49)).unwrap().try_clone().unwrap();
        let difference = mean_difference(&picture, &gradient(65, 49, 3));
        assert!(difference < if codec == "ffv1" { 1e-9 } else { 6.0 }, "{codec}: {difference}");
    }
}

#[test]
fn a_preview_holds_one_frame() {
    let mut node = Harness::<Preview>::from_toml("").unwrap();
    for index in 0..5 {
        node.input_image::<Bgr8>("image", 8, 6, &gradient(8, 6, index)).process().unwrap();
        assert_eq!(node.kept_buffers(), 1);
    }
    assert_eq!(node.metric("frames"), Some(5.0));
}
