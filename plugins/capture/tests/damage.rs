//! Damaged files are named with their location, end a batch or are skipped, and never show pixels of another frame.

use crate::common;
use std::fs;
use std::path::Path;

use crate::common::{Folder, WIDTH, drain, drain_to_failure, value, warned, write_video_at};
use panoscope_node::Bgr8;
use panoscope_node::harness::{Harness, Setup};
use tiff::encoder::colortype::{Gray32Float, GrayI16};

fn cut(path: &Path, parts: usize) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..bytes.len() / parts]).unwrap();
}

#[test]
fn a_batch_ends_at_a_damaged_picture_with_its_place() {
    let folder = Folder::new("batch");
    for index in 0..5 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    cut(&folder.0.join("2.png"), 2);
    let mut node = folder.open(r#"left = "*.png""#);
    let (all, failure) = drain_to_failure(&mut node);
    assert_eq!(all.len(), 2);
    let message = failure.unwrap();
    for words in ["STATUS_END", "2.png", "image 3 of 5", "on_damage"] {
        assert!(message.contains(words), "{words}: {message}");
    }
    // It stays ended, whoever asks.
    assert!(node.process().unwrap().ended());
}

#[test]
fn a_source_that_failed_goes_on_with_the_next_picture() {
    let folder = Folder::new("next");
    for index in 0..5 {
        folder.image(&format!("{index}.png"), index, WIDTH);
    }
    cut(&folder.0.join("2.png"), 2);
    let setup = Setup::new(r#"params = { left = "*.png", pace = "off", rate_hz = 10.0 }"#).graph_dir(&folder.0);
    let mut node = Harness::<panoscope_capture::capture::Capture>::open(setup).unwrap();
    let (mut before, failure) = drain_to_failure(&mut node);
    assert!(failure.is_some_and(|words| words.contains("2.png") && !words.contains("STATUS_END")));
    let state = node.save_state().unwrap().unwrap();
    node.reopen().unwrap();
    node.load_state(&state).unwrap();
    let after = drain(&mut node);
    before.extend(after);
    let seen: Vec<(u8, i64)> = before.iter().map(|o| (value(o, "left"), o.tick().capture_ns / 1_000_000)).collect();
    assert_eq!(seen, [(0, 0), (1, 100), (3, 300), (4, 400)]);
    // Other sources begin at their start, nonsense is refused.
    let mut other = folder.open(r#"left = "?.png""#);
    other.load_state(&state).unwrap();
    assert_eq!(value(&other.process().unwrap(), "left"), 0);
    assert!(other.load_state(b"nonsense").is_err());
}

#[test]
fn a_video_goes_on_where_it_was() {
    let folder = Folder::new("position");
    for frames in [20, 620_usize] {
        write_video_at(&folder.0.join("v.avi"), 20.0, (0..frames).map(|index| (index % 120) as u8 * 2));
        let mut node = folder.open(r#"left = "v.avi""#);
        for _ in 0..frames - 10 {
            node.process().unwrap();
        }
        let state = node.save_state().unwrap().unwrap();
        node.reopen().unwrap();
        node.load_state(&state).unwrap();
        let rest = drain(&mut node);
        assert_eq!(rest.len(), 10, "{frames}");
        for (index, out) in rest.iter().enumerate() {
            let frame = frames - 10 + index;
            assert!(value(out, "left").abs_diff((frame % 120) as u8 * 2) <= 3, "{frame}");
            assert_eq!(out.tick().capture_ns, frame as i64 * 50_000_000);
        }
    }
}

#[test]
fn a_position_is_reached_before_the_next_picture_is_asked_for() {
    // The host waits longer for a state than for a picture; and a source that is replaced twice in a row keeps its position.
    let folder = Folder::new("reached");
    write_video_at(&folder.0.join("v.avi"), 20.0, (0..40).map(|index| index * 2));
    let mut node = folder.open(r#"left = "v.avi""#);
    for _ in 0..30 {
        node.process().unwrap();
    }
    let state = node.save_state().unwrap().unwrap();
    for _ in 0..2 {
        node.reopen().unwrap();
        node.load_state(&state).unwrap();
        assert_eq!(node.save_state().unwrap().as_ref(), Some(&state));
    }
    assert!(value(&node.process().unwrap(), "left").abs_diff(60) <= 3);
}

#[test]
fn a_video_that_lacks_frames_ends_with_a_fault() {
    let folder = Folder::new("lacks");
    let path = folder.0.join("v.avi");
    write_video_at(&path, 20.0, (0..100).map(|index| index * 2));
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() * 58 / 100]).unwrap();
    let (all, failure) = drain_to_failure(&mut folder.open(r#"left = "v.avi", on_damage = "skip""#));
    let message = failure.expect("the end comes too early");
    assert!(all.len() > 40 && all.len() < 65, "{}", all.len());
    assert!(message.contains("STATUS_END") && message.contains("of 100 frames"), "{message}");
}

/// Where the frames of an AVI are: behind their `00db` and length.
fn chunks(bytes: &[u8]) -> Vec<std::ops::Range<usize>> {
    let mut found = Vec::new();
    let mut at = bytes.windows(4).position(|word| word == b"movi").unwrap() + 4;
    while bytes.get(at..at + 4) == Some(b"00db") {
        let length = u32::from_le_bytes(bytes[at + 4..at + 8].try_into().unwrap()) as usize;
        found.push(at + 8..at + 8 + length);
        at += 8 + length.next_multiple_of(2);
    }
    found
}

#[test]
fn a_damaged_frame_of_a_video_shows_nothing_of_the_one_before() {
    type Damage<'d> = &'d dyn Fn(&mut [u8]);
    let folder = Folder::new("stale");
    let path = folder.0.join("v.avi");
    write_video_at(&path, 20.0, (0..8).map(|index| 30 * index));
    let whole = fs::read(&path).unwrap();
    let frames = chunks(&whole);
    assert_eq!(frames.len(), 8);
    let range = frames[4].clone();
    let damages: [Damage<'_>; 3] = [
        // Nothing behind the first half, nothing but noise, nothing at all.
        &|frame| {
            let half = frame.len() / 2;
            frame[half..].fill(0);
        },
        &|frame| frame.iter_mut().enumerate().for_each(|(index, byte)| *byte = (index * 7 + 1) as u8),
        &|frame| frame.fill(0),
    ];
    for (number, damage) in damages.iter().enumerate() {
        let mut bytes = whole.clone();
        damage(&mut bytes[range.clone()]);
        fs::write(&path, &bytes).unwrap();
        let mut node = folder.open(r#"left = "v.avi", on_damage = "skip""#);
        let all = drain(&mut node);
        let shown: Vec<Option<u8>> =
            all.iter().map(|o| (!o.is_empty("left").unwrap()).then(|| value(o, "left"))).collect();
        assert_eq!(shown.len(), 8, "{number}: {shown:?}");
        for (index, gray) in shown.iter().enumerate() {
            match gray {
                Some(gray) => assert!(index != 4 && gray.abs_diff(30 * index as u8) < 6, "{number}: {shown:?}"),
                None => assert_eq!(index, 4, "{number}: {shown:?}"),
            }
        }
        assert!(warned(&node, "frame 5 of 8"), "{:?}", node.logs());
        let (all, failure) = drain_to_failure(&mut folder.open(r#"left = "v.avi""#));
        assert!(all.len() == 4 && failure.is_some_and(|words| words.contains("frame 5 of 8")));
    }
}

#[test]
fn a_cut_off_jpeg_with_a_preview_inside_is_refused() {
    let folder = Folder::new("preview");
    folder.image("a.jpg", 90, 64);
    let bytes = fs::read(folder.0.join("a.jpg")).unwrap();
    // A preview in an application segment ends with an end marker of its own.
    let preview = [&[0xFF, 0xE1, 0, 10, 0xFF, 0xD8, 0, 0, 0, 0][..], &[0xFF, 0xD9]].concat();
    let with_preview = [&bytes[..2], &preview, &bytes[2..]].concat();
    fs::write(folder.0.join("a.jpg"), &with_preview).unwrap();
    assert!(value(&folder.open(r#"left = "a.jpg""#).process().unwrap(), "left").abs_diff(90) < 30);
    fs::write(folder.0.join("a.jpg"), &with_preview[..with_preview.len() - 20]).unwrap();
    let message = folder.open(r#"left = "a.jpg""#).process().err().unwrap().to_string();
    assert!(message.contains("truncated"), "{message}");
}

#[test]
fn parts_that_a_decoder_leaves_open_are_not_shown() {
    let folder = Folder::new("open_parts");
    for name in ["a.tif", "a.bmp", "a.ppm"] {
        folder.image(name, 90, 64);
        let path = folder.0.join(name);
        let whole = fs::read(&path).unwrap();
        assert!(folder.open(&format!(r#"left = "{name}""#)).process().is_ok(), "{name}");
        for length in (0..whole.len()).step_by(whole.len() / 12) {
            fs::write(&path, &whole[..length]).unwrap();
            let Ok(out) = folder.open(&format!(r#"left = "{name}""#)).process() else { continue };
            // What is shown is all there: the picture's own first byte, column and row.
            let shown = out.plane::<Bgr8>("left").unwrap();
            assert_eq!((shown.width, shown.height), (64, 8), "{name} {length}");
            let last = &shown.row(7)[63 * 3..64 * 3];
            assert_eq!(last, [90, 63, 7], "{name} cut to {length} of {}", whole.len());
        }
    }
}

#[test]
fn a_webp_is_read_whole_or_not_at_all() {
    let folder = Folder::new("webp");
    let path = folder.0.join("a.webp");
    let picture = "videotestsrc num-buffers=1 pattern=smpte ! video/x-raw,format=RGB,width=64,height=48";
    common::launch(&format!("{picture} ! webpenc lossless=true ! filesink location={}", path.display()));
    let pixels = || {
        let out = folder.open(r#"left = "a.webp""#).process().ok()?;
        Some(out.plane::<Bgr8>("left").unwrap().data.to_vec())
    };
    let (bytes, whole) = (fs::read(&path).unwrap(), pixels().unwrap());
    assert!(
        whole.len() >= 3 * 64 * 48 && whole.iter().any(|value| *value > 200) && whole.iter().any(|value| *value < 50)
    );
    for parts in 1..12 {
        fs::write(&path, &bytes[..bytes.len() * parts / 12]).unwrap();
        assert!(pixels().is_none_or(|shown| shown == whole), "{parts} of 12 parts");
    }
}

fn write_deep(path: &Path, values: &[u16], columns: u32) {
    let rows = values.len() as u32 / columns;
    image::ImageBuffer::<image::Luma<u16>, _>::from_raw(columns, rows, values.to_vec()).unwrap().save(path).unwrap();
}

fn write_tiff<C: tiff::encoder::colortype::ColorType>(path: &Path, values: &[C::Inner], columns: u32)
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let rows = values.len() as u32 / columns;
    let mut encoder = tiff::encoder::TiffEncoder::new(fs::File::create(path).unwrap()).unwrap();
    encoder.write_image::<C>(columns, rows, values).unwrap();
}

fn row(out: &panoscope_node::harness::Outputs, port: &str) -> Vec<u8> {
    out.plane::<Bgr8>(port).unwrap().row(0).iter().step_by(3).copied().collect()
}

#[test]
fn twelve_bits_in_sixteen_are_scaled_by_what_is_there() {
    let folder = Folder::new("deep");
    write_deep(&folder.0.join("l0.png"), &[0, 512, 1024, 2048], 4);
    write_deep(&folder.0.join("l1.png"), &[0, 1024, 3072, 4095], 4);
    write_deep(&folder.0.join("r0.png"), &[0, 64, 128, 256], 4);
    write_deep(&folder.0.join("r1.png"), &[0, 64, 128, 4000], 4);
    let mut node = folder.open(r#"left = "l*.png", right = "r*.png""#);
    let all = drain(&mut node);
    // One white for both views and all pictures, though the first pair is darker.
    assert_eq!(row(&all[0], "left"), [0, 32, 64, 128]);
    assert_eq!(row(&all[0], "right"), [0, 4, 8, 16]);
    assert_eq!(row(&all[1], "left"), [0, 64, 191, 255]);
    let warnings =
        node.logs().iter().filter(|line| line.message.contains("4095") && line.message.contains("bit_depth"));
    assert_eq!(warnings.count(), 1, "{:?}", node.logs());
    let mut node = folder.open(r#"left = "l*.png", bit_depth = 10"#);
    let all = drain(&mut node);
    assert_eq!(row(&all[0], "left"), [0, 128, 255, 255]);
    assert!(warned(&node, "bit_depth = 10"), "{:?}", node.logs());
    let all = drain(&mut folder.open(r#"left = "l*.png", bit_depth = 16"#));
    assert_eq!(row(&all[1], "left"), [0, 4, 12, 16]);
    // Eight bits stay as they are.
    folder.image("e.png", 200, WIDTH);
    assert_eq!(value(&folder.open(r#"left = "e.png", bit_depth = 12"#).process().unwrap(), "left"), 200);
}

#[test]
fn floats_are_read() {
    let folder = Folder::new("float");
    write_tiff::<Gray32Float>(&folder.0.join("unit.tif"), &[0.0, 0.25, 0.5, 1.0], 4);
    write_tiff::<Gray32Float>(&folder.0.join("deep.tif"), &[-5.0, f32::NAN, 2048.0, 4000.0], 4);
    write_tiff::<Gray32Float>(&folder.0.join("far.tif"), &[0.0, 1e6, 0.0, 0.0], 4);
    let shown = |name: &str| folder.open(&format!(r#"left = "{name}""#)).process().map(|out| row(&out, "left"));
    assert_eq!(shown("unit.tif").unwrap(), [0, 64, 128, 255]);
    assert_eq!(shown("deep.tif").unwrap(), [0, 0, 128, 249]);
    let message = shown("far.tif").err().unwrap().to_string();
    assert!(message.contains("far.tif") && message.contains("1000000") && message.contains("scale"), "{message}");
    // What is not understood is said precisely.
    write_tiff::<GrayI16>(&folder.0.join("signed.tif"), &[0, 1, 2, 3], 4);
    let message = shown("signed.tif").err().map(|error| error.to_string());
    assert!(message.unwrap().contains("signed 16-bit"));
    // EXR: linear light, white is 1.
    let exr = image::Rgb32FImage::from_raw(2, 1, vec![0.0, 0.25, 0.5, 1.0, 0.5, -1.0]).unwrap();
    exr.save(folder.0.join("a.exr")).unwrap();
    let out = folder.open(r#"left = "a.exr""#).process().unwrap();
    assert_eq!(out.plane::<Bgr8>("left").unwrap().row(0)[..6], [128, 64, 0, 0, 128, 255]);
    let bytes = fs::read(folder.0.join("a.exr")).unwrap();
    fs::write(folder.0.join("a.exr"), &bytes[..bytes.len() - 3]).unwrap();
    assert!(folder.open(r#"left = "a.exr""#).process().is_err());
}
