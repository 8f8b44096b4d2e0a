//! What stitching shows during an incident, and how soon it recovers (thesis, section 2.4.3).

use std::path::Path;

use panoscope_tests::{run, scratch};
use serde_json::Value;

const FIRST: usize = 8;
const COUNT: usize = 8;
const TICKS: usize = 24;
/// Maximum number of good frames until stitching must have recovered.
const RECOVERY: usize = 3;
const HOLD: usize = 2;
/// Maximum distance of a correct registration from the best plane, px: tissue is not a plane, and other planes fit it as well.
const RIGHT_PX: f64 = 10.0;
const SIZE: (f64, f64) = (320.0, 240.0);

struct Ran {
    states: Vec<String>,
    /// Root mean square distance of each tick's registration from the true plane, over the part of the right view that the left one also sees, px.
    off_px: Vec<f64>,
    pictures: Vec<image::RgbImage>,
}

fn lines(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).expect("the numbers of this run");
    text.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

fn matrix(line: &Value) -> [f64; 9] {
    std::array::from_fn(|i| line["homography"]["left_from_right"][i].as_f64().expect("nine numbers"))
}

fn map(m: &[f64; 9], x: f64, y: f64) -> (f64, f64) {
    let w = m[6] * x + m[7] * y + m[8];
    ((m[0] * x + m[1] * y + m[2]) / w, (m[3] * x + m[4] * y + m[5]) / w)
}

fn off_px(found: &[f64; 9], truth: &[f64; 9]) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for i in 0..20 * 15 {
        let (x, y) = (f64::from(i % 20) * 16.0 + 8.0, f64::from(i / 20) * 16.0 + 8.0);
        let ((a, b), (u, v)) = (map(found, x, y), map(truth, x, y));
        if u >= 0.0 && v >= 0.0 && u < SIZE.0 && v < SIZE.1 {
            squares += (a - u).powi(2) + (b - v).powi(2);
            count += 1.0;
        }
    }
    (squares / count).sqrt()
}

fn play(incident: &str) -> Ran {
    let folder = scratch(&format!("recovery-{incident}"));
    let place = folder.display();
    let graph = format!(
        r#"
mode = "batch"
plugins = ["phantom", "stitch", "sinks"]
[nodes.scope]
type = "phantom"
params = {{ scene = "bowel", seed = 3, width = 320, height = 240, incident = "{incident}", incident_first = {FIRST}, incident_count = {COUNT} }}
[nodes.register]
type = "register_surf"
inputs = {{ left = "scope.left", right = "scope.right" }}
params = {{ scale = 1, hold_frames = {HOLD} }}
[nodes.wide]
type = "composite"
inputs = {{ left = "scope.left", right = "scope.right", homography = "register.homography" }}
[nodes.found]
type = "write_table"
inputs = {{ homography = "register.homography" }}
params = {{ path = "{place}/found.jsonl" }}
[nodes.truth]
type = "write_table"
inputs = {{ homography = "scope.homography" }}
params = {{ path = "{place}/truth.jsonl" }}
[nodes.pictures]
type = "write_images"
inputs = {{ image = "wide.panorama" }}
params = {{ path = "{place}/{{seq:3}}.png" }}
"#
    );
    let done = run(&folder.join("graph.toml"), &graph, TICKS as u64, 2);
    assert!(done.log.is_empty(), "{incident}: {:?}", done.log);
    let (found, truth) = (lines(&folder.join("found.jsonl")), lines(&folder.join("truth.jsonl")));
    assert_eq!((found.len(), truth.len()), (TICKS, TICKS));
    let states = found.iter().map(|l| l["homography"]["state"].as_str().expect("a state").to_owned()).collect();
    let off_px = found.iter().zip(&truth).map(|(f, t)| off_px(&matrix(f), &matrix(t))).collect();
    let picture = |i| image::open(folder.join(format!("{i:03}.png"))).expect("a picture of this run").to_rgb8();
    let pictures = (0..TICKS).map(picture).collect();
    let _ = std::fs::remove_dir_all(&folder);
    Ran { states, off_px, pictures }
}

/// Whether the red frame of a lost registration runs along the border.
fn is_marked(picture: &image::RgbImage) -> bool {
    let (width, height) = picture.dimensions();
    let places = [(1, height / 2), (width - 2, height / 2), (width / 2, 1), (width / 2, height - 2)];
    places.iter().all(|(x, y)| {
        let [r, g, b] = picture.get_pixel(*x, *y).0;
        r > 200 && g < 80 && b < 80
    })
}

fn check(incident: &str, seen: bool, at_once: bool) {
    let ran = play(incident);
    let end = if at_once { FIRST } else { FIRST + COUNT };
    let right = |i: usize| ran.states[i] == "fresh" && ran.off_px[i] < RIGHT_PX;
    let states: Vec<String> = (0..TICKS).map(|i| format!("{i} {} {:.1}", ran.states[i], ran.off_px[i])).collect();
    assert!((0..FIRST).all(right), "{incident}: wrong before anything happened: {states:?}");
    assert!((end..end + RECOVERY).any(right), "{incident}: not back within {RECOVERY} good pictures: {states:?}");
    assert!((end + RECOVERY..TICKS).all(right), "{incident}: did not stay: {states:?}");
    for i in FIRST..if at_once { FIRST } else { end } {
        assert!(seen || ran.states[i] != "fresh", "{incident}: a registration on nothing is called fresh: {states:?}");
        assert!(ran.states[i] != "fresh" || right(i), "{incident}: a wrong registration is called fresh: {states:?}");
    }
    let size = ran.pictures[0].dimensions();
    for (i, picture) in ran.pictures.iter().enumerate() {
        assert_eq!(picture.dimensions(), size, "{incident}: the canvas changed at {i}");
        assert_eq!(
            is_marked(picture),
            ran.states[i] == "lost",
            "{incident}: the mark of picture {i} ({})",
            ran.states[i]
        );
    }
    if !seen {
        // The first bad pictures are held, then lost; the left view goes on living in its place.
        assert_eq!(ran.states[FIRST..FIRST + HOLD + 1], ["held", "held", "lost"], "{states:?}");
        let column = |i: usize| (20..60).map(|x| i32::from(ran.pictures[i].get_pixel(x, 120).0[1])).sum::<i32>();
        assert!((column(FIRST + HOLD) - column(FIRST - 1)).abs() < 40 * 24, "the left view is where it was");
    }
}

#[test]
fn a_covered_lens() {
    check("covered", false, false);
}

#[test]
fn smoke() {
    check("smoke", true, false);
}

#[test]
fn a_shaken_scope() {
    check("blur", true, false);
}

#[test]
fn a_jump() {
    check("jump", true, true);
}
