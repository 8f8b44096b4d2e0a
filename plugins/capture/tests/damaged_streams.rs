//! A campaign of damaged videos, seeded: bits flipped, parts cut out, cut off or zeroed. No frame that is shown may have pixels of an earlier one,
//! and nothing may crash.
//!
//! A flipped bit can leave data that are valid and mean something else. No decoder sees that. In a JPEG it changes pixels but cannot bring earlier
//! ones back. In H.264 it can; this is counted and bounded, and networks, which have checksums, do not deliver such data.
//!
//! A short sample runs with the ordinary tests; `cargo xtask test damaged-streams` runs 1,000. PANOSCOPE_DAMAGE_CASES and PANOSCOPE_DAMAGE_SEED
//! choose how many and which.

use crate::common;
use std::fs;
use std::path::Path;

use crate::common::{Folder, encode, scene};
use panoscope_node::Bgr8;
use panoscope_node::harness::Outputs;
use panoscope_node::random::SplitMix64;

const SIZE: (usize, usize) = (320, 240);
const PICTURES: usize = 36;
const FPS: f64 = 25.0;
/// Side of the compared areas, px.
const AREA: usize = 16;
/// Mean difference of an area's pixels below which both decode the same data.
const SAME: f64 = 2.0;
/// Of this many frames of damaged H.264, at most one may contain stale areas that no decoder can detect.
const MAX_STALE: usize = 50;
const FLIPPED: &str = "flipped";
/// Number of earlier frames that an area is compared with.
const BEFORE: usize = 12;

struct Video {
    name: &'static str,
    bytes: Vec<u8>,
    pictures: Vec<Vec<u8>>,
}

/// What was shown of one damaged video.
#[derive(Debug, Default)]
struct Shown {
    whole: usize,
    withheld: usize,
    /// Frames with damaged areas that contain nothing of earlier frames.
    wrong: usize,
    /// Number of areas with pixels of an earlier frame, and of frames with such areas.
    stale: usize,
    stale_pictures: usize,
}

fn pixels(out: &Outputs) -> Option<Vec<u8>> {
    if out.is_empty("left").unwrap() {
        return None;
    }
    let plane = out.plane::<Bgr8>("left").unwrap();
    assert_eq!((plane.width, plane.height), SIZE);
    Some((0..plane.height).flat_map(|y| plane.row(y)[..3 * SIZE.0].to_vec()).collect())
}

/// Plays a video. Returns pixels and number of each tick, and the failure at its end.
fn play(folder: &Folder, name: &str) -> Option<Vec<(usize, Option<Vec<u8>>)>> {
    let mut node = folder.try_open(&format!(r#"left = "{name}", on_damage = "skip""#)).ok()?;
    let mut all = Vec::new();
    while let Ok(out) = node.process() {
        if out.ended() {
            break;
        }
        all.push(((out.tick().capture_ns as f64 * 1e-9 * FPS).round() as usize, pixels(&out)));
    }
    Some(all)
}

fn area_difference(a: &[u8], b: &[u8], x: usize, y: usize) -> f64 {
    let mut sum = 0_u32;
    for row in y..y + AREA {
        let start = 3 * (row * SIZE.0 + x);
        sum += a[start..start + 3 * AREA]
            .iter()
            .zip(&b[start..start + 3 * AREA])
            .map(|(a, b)| u32::from(a.abs_diff(*b)))
            .sum::<u32>();
    }
    f64::from(sum) / (3 * AREA * AREA) as f64
}

fn difference(a: &[u8], b: &[u8]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64
}

fn judge(video: &Video, ticks: &[(usize, Option<Vec<u8>>)], shown: &mut Shown) {
    // Times count from the first picture: where that one is lost, all are earlier by as much.
    let first = ticks.iter().find_map(|(tick, pixels)| Some((*tick, pixels.as_ref()?)));
    let nearest = |pixels: &[u8]| {
        let all = video.pictures.iter().enumerate();
        all.min_by(|a, b| difference(a.1, pixels).total_cmp(&difference(b.1, pixels))).map_or(0, |(index, _)| index)
    };
    let offset = first.map_or(0, |(tick, pixels)| nearest(pixels).saturating_sub(tick));
    for (tick, pixels) in ticks {
        let Some(pixels) = pixels else {
            shown.withheld += 1;
            continue;
        };
        let Some(own) = video.pictures.get(tick + offset) else {
            shown.wrong += 1;
            continue;
        };
        let (mut wrong, mut stale) = (0, 0);
        for y in (0..SIZE.1).step_by(AREA) {
            for x in (0..SIZE.0).step_by(AREA) {
                let off = area_difference(pixels, own, x, y);
                if off <= SAME {
                    continue;
                }
                wrong += 1;
                let earlier = &video.pictures[(tick + offset).saturating_sub(BEFORE)..tick + offset];
                stale += usize::from(earlier.iter().any(|old| area_difference(pixels, old, x, y) < off / 3.0));
            }
        }
        shown.stale += stale;
        shown.stale_pictures += usize::from(stale > 0);
        if wrong == 0 {
            shown.whole += 1;
        } else {
            shown.wrong += 1;
        }
    }
}

/// Damages the bytes in one way, either after the first tenth of the file, where headers and the first keyframe are, or anywhere.
fn damage(bytes: &mut Vec<u8>, chance: &mut SplitMix64) -> &'static str {
    let start = if chance.below(8) == 0 { 0 } else { bytes.len() / 10 };
    let place = |chance: &mut SplitMix64, length: usize| start + chance.below(length - start);
    let length = bytes.len();
    match chance.below(6) {
        0..=2 => {
            for _ in 0..1 + chance.below(8) {
                let at = place(chance, length);
                bytes[at] ^= 1 << chance.below(8);
            }
            FLIPPED
        }
        3 => {
            let at = place(chance, length);
            let end = (at + 1 + chance.below(3000)).min(length);
            bytes[at..end].fill(0);
            "zeroed"
        }
        4 => {
            let at = place(chance, length);
            let end = (at + 1 + chance.below(4000)).min(length);
            bytes.drain(at..end);
            "cut out"
        }
        _ => {
            let at = place(chance, length);
            bytes.truncate(at);
            "cut off"
        }
    }
}

fn made(folder: &Folder, name: &'static str, encoder: &str) -> Video {
    let path = folder.0.join(name);
    encode(&path, FPS, SIZE, encoder, (0..PICTURES).map(|index| (index, scene(index + 1, SIZE))));
    let ticks = play(folder, name).unwrap();
    let pictures: Vec<Vec<u8>> = ticks.into_iter().map(|(_, pixels)| pixels.unwrap()).collect();
    assert_eq!(pictures.len(), PICTURES, "{name}");
    Video { name, bytes: fs::read(path).unwrap(), pictures }
}

fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

#[test]
fn no_stale_pixels_are_shown() {
    let (cases, seed) = (from_environment("PANOSCOPE_DAMAGE_CASES", 24), from_environment("PANOSCOPE_DAMAGE_SEED", 1));
    let folder = Folder::new("damaged_streams");
    let videos = [
        made(&folder, "jpeg.avi", "jpegenc quality=80 ! avimux"),
        made(&folder, "jpeg.mkv", "jpegenc quality=80 ! matroskamux"),
        made(
            &folder,
            "cabac.mkv",
            "x264enc key-int-max=12 tune=zerolatency bitrate=1500 ! video/x-h264,profile=main ! h264parse ! matroskamux",
        ),
        made(
            &folder,
            "cavlc.mkv",
            "x264enc key-int-max=12 cabac=false bitrate=1500 ! video/x-h264,profile=baseline ! h264parse ! matroskamux",
        ),
        made(
            &folder,
            "b_frames.mkv",
            "x264enc key-int-max=12 bframes=2 b-adapt=false bitrate=1500 ! h264parse ! matroskamux",
        ),
    ];
    let mut totals: Vec<Shown> = videos.iter().map(|_| Shown::default()).collect();
    // Of codecs that predict, where bits were flipped.
    let mut valid = Shown::default();
    let mut refused = 0;
    for case in 0..cases {
        let mut chance = SplitMix64(seed.wrapping_mul(0x9E37_79B9).wrapping_add(case));
        let index = chance.below(videos.len());
        let video = &videos[index];
        let mut bytes = video.bytes.clone();
        let kind = damage(&mut bytes, &mut chance);
        let name = format!("case.{}", Path::new(video.name).extension().unwrap().to_str().unwrap());
        fs::write(folder.0.join(&name), &bytes).unwrap();
        let Some(ticks) = play(&folder, &name) else {
            refused += 1;
            continue;
        };
        let mut now = Shown::default();
        judge(video, &ticks, &mut now);
        let is_invisible = kind == FLIPPED && !video.name.starts_with("jpeg");
        let total = if is_invisible { &mut valid } else { &mut totals[index] };
        total.whole += now.whole;
        total.withheld += now.withheld;
        total.wrong += now.wrong;
        total.stale += now.stale;
        total.stale_pictures += now.stale_pictures;
        if now.stale > 0 || now.wrong > 0 {
            println!("case {case}: {} {kind}: {} stale areas, {} wrong pictures", video.name, now.stale, now.wrong);
            if let Some(keep) = std::env::var_os("PANOSCOPE_DAMAGE_KEEP") {
                fs::write(Path::new(&keep).join(format!("{case}_{}", video.name)), &bytes).unwrap();
            }
        }
    }
    for (video, shown) in videos.iter().zip(&totals) {
        println!("{}: {shown:?}", video.name);
    }
    println!("flipped bits in H.264: {valid:?}");
    println!("{cases} damaged videos, {refused} refused");
    assert_eq!(totals.iter().map(|shown| shown.stale).sum::<usize>(), 0, "stale areas were shown");
    assert!(totals.iter().all(|shown| shown.whole > 0), "{totals:?}");
    assert!(valid.stale_pictures * MAX_STALE <= valid.whole + valid.wrong + valid.withheld, "{valid:?}");
}

#[test]
fn pictures_that_lack_packets_are_withheld_until_the_next_key_picture() {
    let folder = Folder::new("lost_packets");
    let (mut whole, mut withheld, mut missing) = (0, 0, 0);
    for (name, options) in [("main.mkv", "tune=zerolatency"), ("b_frames.mkv", "bframes=2 b-adapt=false")] {
        let video =
            made(&folder, name, &format!("x264enc key-int-max=9 {options} bitrate=1500 ! h264parse ! matroskamux"));
        let network =
            "rtph264pay mtu=400 config-interval=-1 ! identity drop-probability=0.01 ! rtph264depay ! h264parse";
        for _ in 0..4 {
            let text =
                format!("filesrc location={} ! matroskademux ! h264parse ! {network}", folder.0.join(name).display());
            // The first packets may be lost, too.
            let Ok(mut node) = folder.try_open(&format!("left = '{text}', on_damage = 'skip'")) else { continue };
            let mut shown = 0;
            while let Ok(out) = node.process() {
                if out.ended() {
                    break;
                }
                let Some(pixels) = pixels(&out) else {
                    withheld += 1;
                    continue;
                };
                let drawn = common::number(&out, "left").expect("a whole picture has a number");
                let own = &video.pictures[drawn - 1];
                assert!(difference(&pixels, own) <= 0.1, "{name}: picture {drawn} is not as it was sent");
                shown += 1;
            }
            whole += shown;
            missing += PICTURES - shown;
        }
    }
    println!("{whole} shown, {withheld} withheld, {missing} not shown");
    assert!(whole > 20 && withheld > 5, "{whole} shown, {withheld} withheld");
}
