//! Panoramas by disparity from real cameras, which are never level.

use panoscope_engine::{Options, Outcome};
use panoscope_tests::{root, run_disturbed, scratch};

const SIZE: (u32, u32) = (320, 240);
/// The right view shows the content of the left one, this many px further left and lower.
const SHIFT: (u32, u32) = (60, 9);
const FRAMES: u64 = 6;

/// Random gray values, smoothed: matchers need texture, mesh and seam need no noise.
fn texture(x: u32, y: u32) -> u8 {
    let value = |x: u32, y: u32| {
        let mut hash =
            u64::from(x).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ u64::from(y).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
        hash = (hash ^ (hash >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        f64::from((hash >> 56) as u8)
    };
    const CELL: u32 = 5;
    let (column, row) = (x / CELL, y / CELL);
    let (u, v) = (f64::from(x % CELL) / f64::from(CELL), f64::from(y % CELL) / f64::from(CELL));
    let mix = |a: f64, b: f64, part: f64| a + (b - a) * part;
    let upper = mix(value(column, row), value(column + 1, row), u);
    let lower = mix(value(column, row + 1), value(column + 1, row + 1), u);
    mix(upper, lower, v) as u8
}

#[test]
fn views_on_different_rows_are_rectified_and_joined() {
    for part in ["panorama_mesh", "panorama_grid"] {
        let folder = scratch(&format!("not-level-{part}"));
        let picture = |shift: (u32, u32)| {
            image::GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| image::Luma([texture(x + shift.0, y + 100 - shift.1)]))
        };
        picture((0, 0)).save(folder.join("left.png")).expect("written");
        picture(SHIFT).save(folder.join("right.png")).expect("written");
        let matrix = |name: &str, rows: usize, numbers: &[f64]| {
            let columns = numbers.len() / rows;
            format!("{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: {numbers:?}\n")
        };
        let (cx, cy) = (f64::from(SIZE.0 - 1) / 2.0, f64::from(SIZE.1 - 1) / 2.0);
        let camera = |cy: f64| [400.0, 0.0, cx, 0.0, 400.0, cy, 0.0, 0.0, 1.0];
        let yaml = [
            format!("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n", SIZE.0, SIZE.1),
            matrix("M1", 3, &camera(cy)),
            matrix("M2", 3, &camera(cy + f64::from(SHIFT.1))),
            matrix("R", 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
            matrix("T", 3, &[-6.0, 0.0, 0.0]),
        ];
        std::fs::write(folder.join("scope.yml"), yaml.concat()).expect("written");
        let graph = format!(
            r#"
mode = "batch"
plugins = ["capture", "flow"]
[nodes.scope]
type = "capture"
params = {{ left = "left.png", right = "right.png", calibration = "scope.yml", loop = true }}
[nodes.wide]
graph = "{}"
inputs = {{ left = "scope.left", right = "scope.right", calibration = "scope.calibration" }}
[nodes.end]
type = "drain"
inputs = {{ image = "wide.panorama" }}
"#,
            root().join(format!("graphs/parts/{part}.toml")).display()
        );
        let run = run_disturbed(&folder, &graph, Options { frames: Some(FRAMES), ..Options::default() }, |_| ());
        assert_eq!(run.outcome, Outcome::Done, "{part}: {:?}", run.faults);
        let points = run.report.nodes["wide/join/register"].metrics["grid_points"];
        println!("{part}: {points} points of the grid");
        assert!(points >= 60.0, "{part}: {points} points of the grid have a disparity");
        let _ = std::fs::remove_dir_all(&folder);
    }
}

#[test]
fn views_without_a_calibration_are_joined_by_their_features() {
    for part in ["panorama_mesh", "panorama_grid"] {
        let folder = scratch(&format!("no-calibration-{part}"));
        for (name, shift) in [("left", (0, 0)), ("right", SHIFT)] {
            let picture = image::GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
                image::Luma([texture(x + shift.0, y + 100 - shift.1)])
            });
            picture.save(folder.join(format!("{name}.png"))).expect("written");
        }
        let graph = |calibration: &str| {
            format!(
                r#"
mode = "batch"
plugins = ["capture", "flow"]
[nodes.scope]
type = "capture"
params = {{ left = "left.png", right = "right.png", loop = true }}
[nodes.wide]
graph = "{}"
inputs = {{ left = "scope.left", right = "scope.right"{calibration} }}
[nodes.end]
type = "drain"
inputs = {{ image = "wide.panorama" }}
"#,
                root().join(format!("graphs/parts/{part}.toml")).display()
            )
        };
        // Its output stays empty, or nothing is connected.
        for calibration in [", calibration = \"scope.calibration\"", ""] {
            let options = Options { frames: Some(FRAMES), ..Options::default() };
            let run = run_disturbed(&folder, &graph(calibration), options, |_| ());
            assert_eq!(run.outcome, Outcome::Done, "{part}: {:?}", run.faults);
            assert!(run.faults.is_empty(), "{part}: {:?}", run.faults);
            assert_eq!(run.report.nodes["end"].count, FRAMES, "{part}");
            let metrics = &run.report.nodes["wide/join/register"].metrics;
            assert!(metrics["lost_in_a_row"] == 0.0 && metrics["rms_px"] < 1.0, "{part}: {metrics:?}");
        }
        let _ = std::fs::remove_dir_all(&folder);
    }
}
