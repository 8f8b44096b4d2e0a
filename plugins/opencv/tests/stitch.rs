//! OpenCV's registration and stitching behind our ports give the result of a plain program (`reference.cpp`): the same homography, the same canvas,
//! the same image. Optimizations of the nodes must not change it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use panoscope_imaging::geometry::Homography as Map;
use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::harness::Harness;
use panoscope_node::{Bgr8, Gray8, Mask};
use panoscope_opencv::{CompositeOpencv, RegisterOpencv};

const SIZE: (usize, usize) = (320, 240);
/// Maps right-view pixels to left-view pixels.
const TRUE_MAP: Map = Map([0.99, -0.02, 130.0, 0.015, 1.01, -4.0, 1e-5, -2e-5, 1.0]);
/// Brightness of the right view relative to the left one.
const RIGHT_GAIN: f64 = 0.85;
/// A disc in front of the plane: centre and radius in the left view, and its offset in the right one, px.
const DISC: ([f64; 2], f64, f64) = ([225.0, 120.0], 24.0, 14.0);
/// `composite_opencv`'s default.
const MARGIN_PX: i32 = 16;
/// Sides of the canvas are rounded up to a multiple of this.
const CELL_PX: i32 = 16;

fn lattice(x: i64, y: i64, seed: u32) -> f64 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77) ^ seed;
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 13)).wrapping_mul(0x297A_2D39);
    f64::from(h >> 16) / 65536.0
}

/// Smooth noise of three scales, 0 to 1.
fn texture(x: f64, y: f64, seed: u32) -> f64 {
    let at = |side: f64, seed: u32| {
        let (u, v) = (x / side, y / side);
        let (i, j) = (u.floor() as i64, v.floor() as i64);
        let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
        let (s, t) = (smooth(u - u.floor()), smooth(v - v.floor()));
        let row = |j| lattice(i, j, seed) * (1.0 - s) + lattice(i + 1, j, seed) * s;
        row(j) * (1.0 - t) + row(j + 1) * t
    };
    0.4 * at(5.0, seed) + 0.35 * at(11.0, seed ^ 7) + 0.25 * at(37.0, seed ^ 13)
}

/// Left and right view, BGR.
fn pair() -> [Vec<u8>; 2] {
    let render = |map: Map, disc_shift: f64, gain: f64| {
        let mut out = Vec::new();
        for index in 0..SIZE.0 * SIZE.1 {
            let [x, y] = map.map([(index % SIZE.0) as f64, (index / SIZE.0) as f64]);
            let (centre, radius, _) = DISC;
            let inside = (x - centre[0] - disc_shift).hypot(y - centre[1]) < radius;
            let value = if inside { 60.0 * texture(x - disc_shift, y, 99) } else { 60.0 + 180.0 * texture(x, y, 5) };
            out.extend([0.8, 0.9, 1.0].map(|tint| (value * tint * gain).round() as u8));
        }
        out
    };
    [render(Map::identity(), 0.0, 1.0), render(TRUE_MAP, DISC.2, RIGHT_GAIN)]
}

fn gray(bgr: &[u8]) -> Vec<u8> {
    let luma = |p: &[u8]| 0.114 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.299 * f64::from(p[2]);
    bgr.chunks_exact(3).map(|p| luma(p).round() as u8).collect()
}

fn swapped(pixels: &[u8]) -> Vec<u8> {
    pixels.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]).collect()
}

/// Output of the plain program.
struct Reference {
    map: [f64; 9],
    /// Position of the left view on the canvas.
    corner: (i32, i32),
    size: (usize, usize),
    bgr: Vec<u8>,
}

/// The program, compiled once.
fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference.cpp");
        let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("opencv-reference");
        let asked = Command::new("pkg-config").args(["--cflags", "opencv4"]).output();
        let flags = asked.ok().filter(|o| o.status.success()).map(|o| String::from_utf8_lossy(&o.stdout).into_owned());
        let flags = flags.unwrap_or_else(|| "-I/usr/include/opencv4".to_owned());
        let libraries = ["core", "imgproc", "imgcodecs", "features2d", "calib3d", "stitching"];
        // The plugin's own build has compiled C++ against the same headers.
        let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".to_owned());
        panoscope_testing::made_once(&program, &[&source], |program| {
            let output = Command::new(&compiler)
                .args(["-std=c++17", "-O1"])
                .args(flags.split_whitespace())
                .arg(&source)
                .arg("-o")
                .arg(program)
                .args(libraries.map(|name| format!("-lopencv_{name}")))
                .output()
                .unwrap_or_else(|error| panic!("{compiler}: {error}"));
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        });
        program
    })
}

fn reference(views: &[Vec<u8>; 2], megapixels: f64, finder: &str, cost: &str) -> Reference {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("stitch-{megapixels}-{finder}-{cost}"));
    std::fs::create_dir_all(&folder).unwrap();
    for (name, view) in ["left.ppm", "right.ppm"].iter().zip(views) {
        let mut file = format!("P6 {} {} 255\n", SIZE.0, SIZE.1).into_bytes();
        file.extend(swapped(view));
        std::fs::write(folder.join(name), file).unwrap();
    }
    let output = Command::new(program())
        .current_dir(&folder)
        .args(["left.ppm", "right.ppm", "out.ppm", &megapixels.to_string(), finder, cost, "1", "1"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let words = String::from_utf8(output.stdout).unwrap();
    let line = |name: &str| -> Vec<f64> {
        let line = words.lines().find_map(|l| l.strip_prefix(name)).unwrap_or_else(|| panic!("no {name}: {words}"));
        line.split_whitespace().map(|word| word.parse().unwrap()).collect()
    };
    let canvas = line("canvas");
    let size = (canvas[2] as usize, canvas[3] as usize);
    let file = std::fs::read(folder.join("out.ppm")).unwrap();
    let bgr = swapped(&file[file.len() - size.0 * size.1 * 3..]);
    Reference { map: line("homography").try_into().unwrap(), corner: (canvas[0] as i32, canvas[1] as i32), size, bgr }
}

/// Maximum distance between the images of the right view's corners under two maps, px.
fn corner_distance(a: &[f64; 9], b: &[f64; 9]) -> f64 {
    let corners = |map: &[f64; 9]| Map(*map).map_corners(SIZE.0, SIZE.1).unwrap();
    corners(a).iter().zip(corners(b)).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).fold(0.0, f64::max)
}

fn registered(views: &[Vec<u8>; 2], params: &str) -> Homography {
    let mut node = Harness::<RegisterOpencv>::from_toml(&format!("params = {{ {params} }}")).unwrap();
    for (name, view) in ["left", "right"].iter().zip(views) {
        node.input_image::<Gray8>(name, SIZE.0, SIZE.1, &gray(view));
    }
    node.process().unwrap().value::<Homography>("homography").unwrap()
}

#[test]
fn the_registration_finds_what_the_plain_program_finds() {
    let views = pair();
    let plain = reference(&views, 0.0, "graph_cut", "color");
    assert!(corner_distance(&plain.map, &TRUE_MAP.0) < 1.0, "{:?}", plain.map);
    // As a graph has it, as the bench has it, and on views shrunk to a little more than half.
    for (params, within_px) in [("", 0.5), ("mutual = false, threads = 2", 0.5), ("work_megapixels = 0.05", 1.0)] {
        let found = registered(&views, params);
        assert_eq!(found.state, abi::STATE_FRESH, "{params}");
        assert!(found.inliers >= 100, "{params}: {}", found.inliers);
        let off = corner_distance(&found.left_from_right, &plain.map);
        assert!(off < within_px, "{params}: {off} px from the plain program's");
        let off = corner_distance(&found.left_from_right, &TRUE_MAP.0);
        assert!(off < 1.0, "{params}: {off} px from the truth");
    }
}

/// Every other band of rows is displaced by 16 px in the left view, so that no plane fits both.
#[test]
fn features_that_no_plane_explains_are_lost_and_said() {
    let bands = |shift: i64| -> Vec<u8> {
        let at = |index: usize| {
            let (x, y) = ((index % SIZE.0) as i64, (index / SIZE.0) as i64);
            let band = (y / 40 % 2) * 16;
            let value = 60.0 + 180.0 * texture((x - shift - if shift == 0 { 0 } else { band }) as f64, y as f64, 5);
            [value.round() as u8; 3]
        };
        (0..SIZE.0 * SIZE.1).flat_map(at).collect()
    };
    let views = [bands(100), bands(0)];
    let params = |limit: &str| format!("ratio = 0.9, ransac_px = 20.0, max_rms_px = {limit}");
    let found = registered(&views, &params("0.0"));
    assert!(found.state == abi::STATE_FRESH && found.rms_px > 4.0, "{} {}", found.state, found.rms_px);
    let mut node = Harness::<RegisterOpencv>::from_toml(&format!("params = {{ {} }}", params("4.0"))).unwrap();
    node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &gray(&views[0])).input_image::<Gray8>(
        "right",
        SIZE.0,
        SIZE.1,
        &gray(&views[1]),
    );
    let lost = node.process().unwrap().value::<Homography>("homography").unwrap();
    assert_eq!((lost.state, lost.inliers), (abi::STATE_LOST, 0));
    assert!(node.logs().iter().any(|line| line.message.contains("`max_rms_px` allows 4")), "{:?}", node.logs());
}

/// Mean difference between the node's image and the program's where a view exists, gray levels; and the same only near the disc.
fn difference(views: &[Vec<u8>; 2], plain: &Reference, params: &str) -> (f64, f64) {
    let mut node = Harness::<CompositeOpencv>::from_toml(&format!("params = {{ {params} }}")).unwrap();
    let map = Homography { left_from_right: plain.map, rms_px: 0.5, inliers: 100, state: abi::STATE_FRESH };
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &views[0])
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &views[1])
        .input_value("homography", map);
    let out = node.process().unwrap();
    let (picture, mask) = (out.plane::<Bgr8>("panorama").unwrap(), out.plane::<Mask>("mask").unwrap());
    let place = out.value::<Roi>("canvas").unwrap();
    // The same canvas but for the room that is kept free around it, and sides of whole cells.
    let shift = (place.x - plain.corner.0, place.y - plain.corner.1);
    let wider = (picture.width as i32 - plain.size.0 as i32, picture.height as i32 - plain.size.1 as i32);
    for (what, got, room) in [
        ("left", shift.0, MARGIN_PX..=MARGIN_PX),
        ("top", shift.1, MARGIN_PX..=MARGIN_PX),
        ("width", wider.0, 2 * MARGIN_PX..=2 * MARGIN_PX + CELL_PX),
        ("height", wider.1, 2 * MARGIN_PX..=2 * MARGIN_PX + CELL_PX),
    ] {
        let wanted = room.start() - 2..=room.end() + 2;
        assert!(wanted.contains(&got), "{what}: {got} px more than the plain program's, not {wanted:?}");
    }
    let (mut all, mut near) = ((0.0, 0), (0.0, 0));
    for y in 0..plain.size.1 {
        for x in 0..plain.size.0 {
            let (u, v) = ((x as i32 + shift.0) as usize, (y as i32 + shift.1) as usize);
            if mask.row(v)[u] == 0 {
                continue;
            }
            let (a, b) = (&picture.row(v)[3 * u..3 * u + 3], &plain.bgr[3 * (y * plain.size.0 + x)..][..3]);
            let apart: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / 3.0;
            all = (all.0 + apart, all.1 + 1);
            let (centre, radius, shift_px) = DISC;
            let from_left = (x as f64 - f64::from(plain.corner.0), y as f64 - f64::from(plain.corner.1));
            if (from_left.0 - centre[0] - shift_px / 2.0).hypot(from_left.1 - centre[1]) < radius + shift_px {
                near = (near.0 + apart, near.1 + 1);
            }
        }
    }
    assert!(all.1 * 20 > plain.size.0 * plain.size.1 * 17, "covered: {} of {:?}", all.1, plain.size);
    (all.0 / f64::from(all.1 as u32), near.0 / f64::from(near.1))
}

#[test]
fn the_composite_paints_what_the_plain_program_paints() {
    let views = pair();
    let cases = [
        (0.0, "graph_cut", "color"),
        (0.02, "graph_cut", "color"),
        (0.0, "graph_cut", "color_grad"),
        (0.02, "dynamic_programming", "color"),
    ];
    for (megapixels, finder, cost) in cases {
        let plain = reference(&views, megapixels, finder, cost);
        let params = format!("seam_megapixels = {megapixels:?}, seam = \"{finder}\", seam_cost = \"{cost}\"");
        let (all, near) = difference(&views, &plain, &params);
        assert!(all < 0.5 && near < 1.0, "{params}: {all} levels, {near} near the disc");
        // What a node would paint that left out the seam, or the gains.
        let (_, seamless) = difference(&views, &plain, "seam = \"none\"");
        assert!(
            seamless > 4.0 * near.max(0.5),
            "{params}: without a seam {seamless} levels near the disc, {near} with it"
        );
        let (ungained, _) = difference(&views, &plain, &format!("{params}, gain = false"));
        assert!(ungained > 4.0 * all.max(0.5), "{params}: without gains {ungained} levels, {all} with them");
    }
}
