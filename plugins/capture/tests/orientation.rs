//! Images and videos whose metadata asks for a rotation.

use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use panoscope_node::Bgr8;
use panoscope_node::harness::Outputs;

use crate::common::{Folder, drain, encode};

const SIZE: (usize, usize) = (64, 48);
/// Blue, green, red.
const RED: [u8; 3] = [0, 0, 255];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [255, 0, 0];
const WHITE: [u8; 3] = [255; 3];

/// Red, green over blue, white.
fn quadrants() -> Vec<u8> {
    let (width, height) = SIZE;
    let colour = |x: usize, y: usize| [[RED, GREEN], [BLUE, WHITE]][y / (height / 2)][x / (width / 2)];
    (0..height).flat_map(|y| (0..width).flat_map(move |x| colour(x, y))).collect()
}

/// A JPEG of the quadrants with this orientation in its EXIF data.
fn tagged(orientation: u8) -> Vec<u8> {
    let mut rgb = quadrants();
    rgb.as_chunks_mut::<3>().0.iter_mut().for_each(|pixel| pixel.swap(0, 2));
    let mut bytes = Vec::new();
    let (width, height) = (SIZE.0 as u32, SIZE.1 as u32);
    JpegEncoder::new_with_quality(&mut bytes, 95).encode(&rgb, width, height, image::ExtendedColorType::Rgb8).unwrap();
    // A TIFF head and one entry: tag 0x0112, a short.
    let mut exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0]);
    let length = (exif.len() as u16 + 2).to_be_bytes();
    let segment = [&[0xFF, 0xE1][..], &length, &exif].concat();
    bytes.splice(2..2, segment);
    bytes
}

/// The colours of the quadrants that an output shows, rounded, and its size.
fn shown(out: &Outputs) -> ((usize, usize), [[u8; 3]; 4]) {
    let plane = out.plane::<Bgr8>("left").unwrap();
    let (width, height) = (plane.width, plane.height);
    let at = |x: usize, y: usize| {
        let start = 3 * (y * width + x);
        [0, 1, 2].map(|channel| if plane.data[start + channel] > 127 { 255 } else { 0 })
    };
    let ([left, right], [top, bottom]) = ([width / 4, 3 * width / 4], [height / 4, 3 * height / 4]);
    ((width, height), [at(left, top), at(right, top), at(left, bottom), at(right, bottom)])
}

#[test]
fn photographs_are_turned_as_their_exif_data_say() {
    let folder = Folder::new("exif");
    let upright = (SIZE, [RED, GREEN, BLUE, WHITE]);
    for (orientation, expected) in [
        (1, upright),
        (3, (SIZE, [WHITE, BLUE, GREEN, RED])),
        (6, ((48, 64), [BLUE, RED, WHITE, GREEN])),
        (8, ((48, 64), [GREEN, WHITE, RED, BLUE])),
    ] {
        std::fs::write(folder.0.join("a.jpg"), tagged(orientation)).unwrap();
        assert_eq!(shown(&drain(&mut folder.open(r#"left = "a.jpg""#))[0]), expected, "{orientation}");
        let stored = drain(&mut folder.open(r#"left = "a.jpg", orientation = "as_stored""#));
        assert_eq!(shown(&stored[0]), upright, "{orientation}");
    }
}

#[test]
fn videos_are_turned_as_their_display_matrix_says() {
    let folder = Folder::new("matrix");
    let path = folder.0.join("a.mp4");
    let encoder = "x264enc tune=zerolatency ! h264parse ! qtmux";
    encode(&path, 25.0, SIZE, encoder, (0..5).map(|index| (index, quadrants())));
    // The display matrix of the head of the track, in 16.16 and 2.30: a quarter turn clockwise.
    let mut bytes = std::fs::read(&path).unwrap();
    let head = bytes.windows(4).position(|name| name == b"tkhd").expect("a track") + 44;
    let matrix: [i32; 9] = [0, 1 << 16, 0, -(1 << 16), 0, 0, 48 << 16, 0, 1 << 30];
    bytes[head..head + 36].copy_from_slice(&matrix.map(i32::to_be_bytes).concat());
    std::fs::write(&path, bytes).unwrap();
    let all = drain(&mut folder.open(r#"left = "a.mp4""#));
    assert_eq!(all.len(), 5);
    for out in &all {
        assert_eq!(shown(out), ((48, 64), [BLUE, RED, WHITE, GREEN]));
    }
    let stored = drain(&mut folder.open(r#"left = "a.mp4", orientation = "as_stored""#));
    assert_eq!(shown(&stored[4]), (SIZE, [RED, GREEN, BLUE, WHITE]));
}

#[test]
fn a_video_of_another_program_is_turned() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/foreign/rotated_90.mp4");
    if !file.exists() {
        return panoscope_testing::skipped!("../shared/foreign/rotated_90.mp4 is not there");
    }
    let folder = Folder::new("foreign");
    let (size, colours) = shown(&drain(&mut folder.open(&format!("left = {:?}", file.display().to_string())))[0]);
    assert_eq!(size, (240, 320));
    let stored =
        drain(&mut folder.open(&format!("left = {:?}, orientation = \"as_stored\"", file.display().to_string())));
    assert_eq!(shown(&stored[0]), ((320, 240), [RED, GREEN, BLUE, WHITE]));
    assert!([[BLUE, RED, WHITE, GREEN], [GREEN, WHITE, RED, BLUE]].contains(&colours), "{colours:?}");
}
