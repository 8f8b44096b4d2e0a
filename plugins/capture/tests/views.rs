//! Every kind of source that needs no hardware, and every way it can be wrong.

use std::fs;
use std::path::Path;

use crate::common::{Folder, WIDTH, drain, drain_to_failure, value, write_video};
use panoscope_capture::capture::Capture;
use panoscope_node::Bgr8;
use panoscope_node::abi::Calibration;
use panoscope_node::harness::{Harness, Setup};

#[test]
fn the_shortest_pattern_ends_the_source() {
    let folder = Folder::new("pattern");
    for index in 0..12 {
        folder.image(&format!("l{index}.png"), index, WIDTH);
    }
    for index in 0..3 {
        folder.image(&format!("r_{index:04}.bmp"), 100 + index, WIDTH);
    }
    let all = drain(&mut folder.open(r#"left = "l*.png", right = "r_%04d.bmp", rate_hz = 25.0"#));
    assert_eq!(all.len(), 3);
    for (index, out) in all.iter().enumerate() {
        let index = index as u8;
        assert_eq!((value(out, "left"), value(out, "right")), (index, 100 + index));
        assert_eq!((value(out, "view0"), value(out, "view1")), (index, 100 + index));
        assert_eq!(out.buffer("left").unwrap(), out.buffer("view0").unwrap());
        assert_eq!(out.buffer("right").unwrap(), out.buffer("view1").unwrap());
        assert!(out.is_empty("view2").unwrap());
        assert_eq!(out.tick().capture_ns, i64::from(index) * 40_000_000);
    }
    let all = drain(&mut folder.open(r#"left = "l*.png", right = "r_%04d.bmp", loop = true, frames = 14"#));
    let values: Vec<(u8, u8)> = all.iter().map(|o| (value(o, "left"), value(o, "right") - 100)).collect();
    // A pair stays a pair: the views start again together.
    assert_eq!(values[10..], [(1, 1), (2, 2), (0, 0), (1, 1)]);
}

#[test]
fn pictures_that_are_shown_again_are_not_copied_again() {
    let folder = Folder::new("again");
    for index in 0..3 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    let mut node = folder.open(r#"left = "%d.png", loop = true, crop = [2, 0, 10, 8]"#);
    let mut once = 0;
    for round in 0..3 {
        for index in 0..3 {
            let out = node.process().unwrap();
            assert_eq!((value(&out, "left"), out.plane::<Bgr8>("left").unwrap().row(0)[1]), (index, 2));
            assert_eq!(out.tick().seq, 3 * round + u64::from(index));
        }
        once = if round == 0 { node.allocated_bytes() } else { once };
        assert_eq!((node.allocated_bytes(), node.copies()), (once, 0), "round {round}");
    }
    // The host ends a node that retains too many frames.
    fs::create_dir(folder.0.join("many")).unwrap();
    for index in 0..200 {
        folder.image(&format!("many/{index}.png"), index, WIDTH);
    }
    let mut many = folder.open(r#"left = "many/%d.png", loop = true"#);
    (0..200).for_each(|index| assert_eq!(value(&many.process().unwrap(), "left"), index));
    assert!(many.kept_buffers() > 0 && many.kept_buffers() < 128, "{} frames", many.kept_buffers());
    // Another part of a picture is another frame.
    node.set_params(r#"params = { left = "%d.png", loop = true, crop = [4, 0, 10, 8] }"#).unwrap();
    assert_eq!(node.process().unwrap().plane::<Bgr8>("left").unwrap().row(0)[1], 4);
    // A sequence that ends keeps nothing.
    let mut node = folder.open(r#"left = "%d.png""#);
    assert_eq!(drain(&mut node).len(), 3);
    assert_eq!(node.kept_buffers(), 0);
}

#[test]
fn one_image_is_repeated_beside_a_sequence() {
    let folder = Folder::new("single");
    for index in 0..3 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    folder.image("still.png", 77, WIDTH);
    let all = drain(&mut folder.open(r#"left = "%d.png", right = "still.png""#));
    assert_eq!(all.iter().map(|o| value(o, "right")).collect::<Vec<_>>(), [77, 77, 77]);
}

#[test]
fn crops_and_halves() {
    let folder = Folder::new("crop");
    folder.image("a.png", 1, WIDTH);
    let mut node = folder.open(r#"left = "a.png", right = "a.png", loop = true, crop = [0, 0, 10, 8, 6, 0, 10, 8]"#);
    let out = node.process().unwrap();
    let (left, right) = (out.plane::<Bgr8>("left").unwrap(), out.plane::<Bgr8>("right").unwrap());
    assert_eq!((left.width, right.width, left.row(0)[1], right.row(0)[1]), (10, 10, 0, 6));
    node.set_params(r#"params = { left = "a.png", right = "a.png", loop = true, crop = [9, 0, 10, 8] }"#).unwrap();
    let message = node.process().err().unwrap().to_string();
    assert!(message.contains("extends beyond the frame of 16x8"), "{message}");
    let out = folder.open(r#"left = "a.png", split = "side_by_side""#).process().unwrap();
    let right = out.plane::<Bgr8>("right").unwrap();
    assert_eq!((right.width, right.height, right.row(0)[1]), (8, 8, 8));
    let out = folder.open(r#"left = "a.png", split = "top_bottom", crop = [0, 1, 0, 0]"#).process().unwrap();
    let right = out.plane::<Bgr8>("right").unwrap();
    assert_eq!((right.width, right.height, right.row(0)[2]), (16, 3, 5));
}

#[test]
fn four_views_and_only_what_is_read() {
    let folder = Folder::new("four");
    for index in 0..4 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    let toml = r#"params = { views = "0.png; 1.png; 2.png; 3.png" }"#;
    let out = folder.open(&toml["params = { ".len()..toml.len() - 2]).process().unwrap();
    assert_eq!(["view0", "view1", "view2", "view3"].map(|p| value(&out, p)), [0, 1, 2, 3]);
    let setup = Setup::new(toml).graph_dir(&folder.0).batch().threads(2).read_only(&["view3"]);
    let mut node = Harness::<Capture>::open(setup).unwrap();
    let out = node.process().unwrap();
    assert_eq!(value(&out, "view3"), 3);
    assert!(out.is_empty("left").unwrap() && out.is_empty("view0").unwrap());
    assert!(node.metric("skew_ms").is_some_and(|skew| skew >= 0.0));
}

#[test]
fn views_of_different_size_are_passed_on_with_one_warning() {
    let folder = Folder::new("sizes");
    folder.image("a.png", 1, WIDTH);
    folder.image("b.png", 2, WIDTH / 2);
    let mut node = folder.open(r#"left = "a.png", right = "b.png", loop = true"#);
    for _ in 0..2 {
        let out = node.process().unwrap();
        assert_eq!((out.plane::<Bgr8>("left").unwrap().width, out.plane::<Bgr8>("right").unwrap().width), (16, 8));
    }
    assert_eq!(node.logs().iter().filter(|l| l.message.contains("differ in size (16x8 and 8x8)")).count(), 1);
}

#[test]
fn mistakes_are_named() {
    let folder = Folder::new("mistakes");
    folder.image("a.png", 1, WIDTH);
    fs::write(folder.0.join("note.txt"), "no video").unwrap();
    let absolute = folder.0.join("b.png").display().to_string();
    let cases = [
        (r#"left = "b.png""#, absolute.as_str()),
        (r#"left = "*.jpg""#, "no image matches"),
        (r#"left = "note.txt""#, "it is not a video that GStreamer supports"),
        (r#"left = "4711""#, "/dev/video4711"),
        ("", "no source"),
        (r#"right = "a.png""#, "without `left`"),
        (r#"left = "a.png", views = "a.png""#, "not both"),
        (r#"views = "a.png;a.png;a.png;a.png;a.png""#, "exceed the limit of 4"),
        (r#"left = "a.png", right = "a.png", split = "top_bottom""#, "`split`"),
        (r#"left = "nosuchelement ! appsink""#, "`nosuchelement"),
    ];
    for (params, words) in cases {
        let message = folder.refused(params);
        assert!(message.contains(words), "{params}: {message}");
    }
}

#[test]
fn damaged_images_are_named_and_never_shown() {
    let folder = Folder::new("damage");
    for ending in ["png", "jpg", "bmp"] {
        for index in 0..3 {
            folder.image(&format!("{index}.{ending}"), 10 + index, 64);
        }
        let path = folder.0.join(format!("1.{ending}"));
        let bytes = fs::read(&path).unwrap();
        // Cut off, not an image at all, empty.
        for damage in [&bytes[..bytes.len() * 2 / 3], b"nothing", b""] {
            fs::write(&path, damage).unwrap();
            let mut node = folder.open(&format!(r#"left = "*.{ending}""#));
            node.process().unwrap();
            let result = node.process();
            let message = match result {
                Err(error) => error.to_string(),
                Ok(_) => panic!("a damaged {ending} of {} bytes was shown", damage.len()),
            };
            assert!(message.contains(&path.display().to_string()), "{message}");
            let mut node = folder.open(&format!(r#"left = "*.{ending}", on_damage = "skip""#));
            let all = drain(&mut node);
            assert_eq!(all.iter().map(|o| o.is_empty("left").unwrap()).collect::<Vec<_>>(), [false, true, false]);
            assert!(node.logs().iter().any(|l| l.message.contains("this tick stays empty")));
        }
    }
    // One flipped byte in the middle of a PNG breaks its checksum.
    let path = folder.0.join("0.png");
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    fs::write(&path, bytes).unwrap();
    assert!(folder.open(r#"left = "0.png""#).process().is_err());
}

#[test]
fn videos_play_loop_and_keep_their_rate() {
    let folder = Folder::new("video");
    write_video(&folder.0.join("v.avi"), 6);
    let all = drain(&mut folder.open(r#"left = "v.avi", right = "v.avi""#));
    assert_eq!(all.len(), 6);
    for (index, out) in all.iter().enumerate() {
        assert!(value(out, "left").abs_diff(index as u8 * 20) < 6);
        assert_eq!(value(out, "left"), value(out, "right"));
        assert_eq!(out.tick().capture_ns, index as i64 * 50_000_000);
    }
    let all = drain(&mut folder.open(r#"left = "v.avi", loop = true, frames = 13"#));
    assert_eq!(all.len(), 13);
    assert!(value(&all[7], "left").abs_diff(20) < 6 && value(&all[12], "left").abs_diff(0) < 6);
    // A file that is cut off ends early and says so.
    let bytes = fs::read(folder.0.join("v.avi")).unwrap();
    write_video(&folder.0.join("long.avi"), 60);
    let bytes_long = fs::read(folder.0.join("long.avi")).unwrap();
    assert!(bytes_long.len() > bytes.len());
    fs::write(folder.0.join("long.avi"), &bytes_long[..bytes_long.len() / 2]).unwrap();
    let (all, failure) = drain_to_failure(&mut folder.open(r#"left = "long.avi""#));
    let message = failure.expect("an end before the end is a fault");
    assert!(all.len() < 60 && message.contains("long.avi") && message.contains("of 60"), "{message}");
}

#[test]
fn a_loop_goes_on_where_an_instance_stopped_at_the_end_of_a_round() {
    let folder = Folder::new("loop-resumed");
    write_video(&folder.0.join("v.avi"), 6);
    let settings = r#"left = "v.avi", loop = true"#;
    let mut first = folder.open(settings);
    for _ in 0..6 {
        assert!(!first.process().unwrap().ended());
    }
    let state = first.save_state().unwrap().unwrap();
    let mut second = folder.open(settings);
    second.load_state(&state).unwrap();
    let next = second.process().unwrap();
    assert!(!next.ended(), "the loop ended with the instance that stopped");
    assert_eq!((value(&next, "left") / 10, next.tick().capture_ns), (0, 300_000_000));
}

#[test]
fn a_pipeline_gives_pictures() {
    let folder = Folder::new("gst");
    let pipeline = "videotestsrc num-buffers=5 pattern=white ! video/x-raw,width=32,height=24";
    let all = drain(&mut folder.open(&format!(r#"left = "{pipeline}""#)));
    assert_eq!(all.len(), 5);
    let left = all[0].plane::<Bgr8>("left").unwrap();
    assert_eq!((left.width, left.height), (32, 24));
    assert!(value(&all[4], "left") > 230);
}

#[test]
fn real_pairs() {
    let doc = Path::new("/usr/share/doc/opencv-doc/examples/data");
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/stereo/hamlyn_640x480");
    let mut checked = 0;
    if doc.join("leuvenA.jpg").exists() {
        checked += 1;
        let setup = Setup::new(r#"params = { left = "leuvenA.jpg", right = "leuvenB.jpg", frames = 2 }"#);
        let all = drain(&mut Harness::<Capture>::open(setup.graph_dir(doc)).unwrap());
        assert_eq!(all.len(), 2);
        let (left, right) = (all[1].plane::<Bgr8>("left").unwrap(), all[1].plane::<Bgr8>("right").unwrap());
        assert!(left.width > 500 && right.width > 500 && left.data != right.data);
    } else {
        panoscope_testing::skipped!("Debian's opencv-doc is not installed");
    }
    if shared.is_dir() {
        checked += 1;
        let toml = r#"params = { left = "left", right = "right", crop = [0, 0, 420, 480, 220, 0, 420, 480] }"#;
        let all = drain(&mut Harness::<Capture>::open(Setup::new(toml).graph_dir(shared).batch()).unwrap());
        assert_eq!(all.len(), 25);
        let left = all[24].plane::<Bgr8>("left").unwrap();
        assert_eq!((left.width, left.height), (420, 480));
    } else {
        panoscope_testing::skipped!("../shared/data/stereo/hamlyn_640x480 is not there");
    }
    assert!(checked > 0, "no pair was read: install Debian's opencv-doc (`cargo xtask setup` does)");
}

const CALIBRATION: &str = "%YAML:1.0
---
image_width: 16
image_height: 8
M1: [ 20., 0., 7.5, 0., 20., 3.5, 0., 0., 1. ]
M2: [ 20., 0., 7.5, 0., 20., 3.5, 0., 0., 1. ]
R: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: [ -4., 0., 0. ]
";

#[test]
fn a_calibration_travels_with_the_views() {
    let folder = Folder::new("calibration");
    folder.image("a.png", 1, WIDTH);
    folder.image("wide.png", 1, 2 * WIDTH);
    let write = |text: &str| fs::write(folder.0.join("scope.yml"), text).unwrap();
    let views = |name: &str| format!(r#"left = "{name}", right = "{name}", calibration = "scope.yml""#);
    write(CALIBRATION);
    let out = folder.open(&views("a.png")).process().unwrap();
    let found: Calibration = out.value("calibration").unwrap();
    assert_eq!((found.left.fx, found.baseline_mm, found.right.width), (20.0, 4.0, 16));
    // Pixels that are no squares (a PAL endoscope's) have two focal lengths.
    write(&CALIBRATION.replace("20., 0., 7.5, 0., 20.", "20., 0., 7.5, 0., 21.8"));
    let left = folder.open(&views("a.png")).process().unwrap().value::<Calibration>("calibration").unwrap().left;
    assert_eq!((left.fx, left.fy), (20.0, 21.8));
    // A file without a size takes that of the views.
    write(&CALIBRATION.replace("image_width: 16\nimage_height: 8\n", ""));
    let out = folder.open(&views("a.png")).process().unwrap();
    assert_eq!(out.value::<Calibration>("calibration").unwrap().left.height, 8);
    // Without a file there is none.
    assert!(folder.open(r#"left = "a.png""#).process().unwrap().is_empty("calibration").unwrap());
    write(CALIBRATION);
    let message = folder.open(&views("wide.png")).process().err().unwrap().to_string();
    assert!(message.contains("made for views of 16x8, but view 0 is 32x8"), "{message}");
    for (text, words) in [
        (CALIBRATION.replace("-4.", "4."), "disparities would be negative"),
        (CALIBRATION[..CALIBRATION.find("R: ").unwrap()].to_owned(), "(`R`) is missing"),
        (CALIBRATION[..CALIBRATION.len() - 8].to_owned(), "scope.yml:"),
    ] {
        write(&text);
        let message = folder.refused(&views("a.png"));
        assert!(message.contains(words), "{message}");
    }
    fs::remove_file(folder.0.join("scope.yml")).unwrap();
    let message = folder.refused(&views("a.png"));
    assert!(message.contains("scope.yml") && message.contains("No such file"), "{message}");
}

/// A random texture without repetition, in cells of a few px.
fn texture(x: u32, y: u32) -> u8 {
    let layer = |cell: u32, seed: u32| {
        let (x, y) = (x / cell, y / cell);
        let hash = (x.wrapping_mul(0x9E37_79B9) ^ y.wrapping_mul(0x85EB_CA6B) ^ seed).wrapping_mul(0xC2B2_AE35);
        (hash ^ hash >> 15).wrapping_mul(0x27D4_EB2F) >> 25
    };
    ((layer(5, 1) + layer(11, 2) + layer(23, 3)) / 2) as u8
}

#[test]
fn a_check_names_files_that_are_exchanged() {
    const SIZE: (u32, u32) = (320, 240);
    let folder = Folder::new("exchanged");
    let view = |shift: u32| image::GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| image::Luma([texture(x + shift, y)]));
    view(0).save(folder.0.join("l_1.png")).unwrap();
    view(25).save(folder.0.join("r_1.png")).unwrap();
    let both = image::GrayImage::from_fn(2 * SIZE.0, SIZE.1, |x, y| {
        image::Luma([if x < SIZE.0 { texture(x + 25, y) } else { texture(x - SIZE.0, y) }])
    });
    both.save(folder.0.join("halves.png")).unwrap();
    let text = CALIBRATION
        .replace("image_width: 16\nimage_height: 8\n", "image_width: 320\nimage_height: 240\n")
        .replace("20., 0., 7.5, 0., 20., 3.5", "300., 0., 160., 0., 300., 120.");
    assert!(text.contains("300., 0., 160.") && text.contains("image_width: 320"), "{text}");
    fs::write(folder.0.join("scope.yml"), text).unwrap();
    let problems = |sources: &str| {
        let setup = Setup::new(&format!("params = {{ {sources}, calibration = \"scope.yml\" }}")).graph_dir(&folder.0);
        format!("{:?}", Harness::<Capture>::problems(&setup, &[]).unwrap())
    };
    for sources in [r#"left = "r_1.png", right = "l_1.png""#, r#"left = "r_*.png", right = "l_*.png""#] {
        let said = problems(sources);
        assert!(said.contains("left and right appear to be swapped") && said.contains("swap the sources"), "{said}");
    }
    let said = problems(r#"left = "halves.png", split = "side_by_side""#);
    assert!(said.contains("left and right appear to be swapped") && said.contains("connect output `right`"), "{said}");
    let said = problems(r#"left = "l_*.png", right = "r_*.png""#);
    assert!(!said.contains("swapped"), "{said}");
    // Another image of the same name is looked at again.
    view(25).save(folder.0.join("l_1.png")).unwrap();
    view(0).save(folder.0.join("r_1.png")).unwrap();
    assert!(problems(r#"left = "l_*.png", right = "r_*.png""#).contains("appear to be swapped"));
}
