//! The node `composite_mesh`: what it draws, holds and refuses.

use panoscope_node::abi::{self, Calibration, Homography, Roi};
use panoscope_node::harness::{Harness, Setup};
use panoscope_node::{Bgr8, Disparity, Gray8};
use panoscope_stitch::{CompositeMesh, EvaluateStitch};

const SIZE: (usize, usize) = (320, 240);

/// Two planes, 12 px apart in disparity, with a ramp between them.
fn disparity(x: f64) -> f64 {
    100.0 + 12.0 * ((x - 200.0) / 60.0).clamp(0.0, 1.0)
}

fn map() -> Vec<f32> {
    (0..SIZE.0 * SIZE.1)
        .map(|i| (i % SIZE.0) as f64)
        .map(|x| if x > disparity(x) { disparity(x) as f32 } else { f32::NAN })
        .collect()
}

/// Colour of the striped tissue at a position of the left view.
fn tissue(x: f64, y: f64) -> [u8; 3] {
    let wave = 60.0 * (0.35 * x + (0.04 * y).sin()).sin() + 30.0 * (0.21 * y).sin();
    [110.0, 90.0, 140.0].map(|base| (base + wave) as u8)
}

fn views() -> [Vec<u8>; 2] {
    let left = (0..SIZE.0 * SIZE.1).flat_map(|i| tissue((i % SIZE.0) as f64, (i / SIZE.0) as f64));
    let right = (0..SIZE.0 * SIZE.1).flat_map(|i| {
        let (u, y) = ((i % SIZE.0) as f64, (i / SIZE.0) as f64);
        let x = (0..50).fold(u + 100.0, |x, _| u + disparity(x));
        tissue(x, y)
    });
    [left.collect(), right.collect()]
}

fn plane(state: u32) -> Homography {
    Homography { left_from_right: [1.0, 0.0, 106.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], rms_px: 4.0, inliers: 100, state }
}

fn node(params: &str) -> Harness<CompositeMesh> {
    let seam = "seam = \"dynamic_programming\", blend = \"feather\", blend_px = 24";
    Harness::open(Setup::new(&format!("params = {{ {seam}{params} }}"))).unwrap()
}

struct Made {
    panorama: Vec<u8>,
    size: (usize, usize),
    canvas: Roi,
    /// Rows of the mesh table, if there is one.
    mesh: Option<Vec<f64>>,
}

fn tick(node: &mut Harness<CompositeMesh>, map: Option<&[f32]>, homography: Homography) -> Made {
    let [left, right] = views();
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &left).input_image::<Bgr8>("right", SIZE.0, SIZE.1, &right);
    if let Some(map) = map {
        node.input_image::<Disparity>("disparity", SIZE.0, SIZE.1, map);
    }
    let out = node.input_value("homography", homography).process().unwrap();
    let panorama = out.plane::<Bgr8>("panorama").unwrap();
    let mesh = (!out.is_empty("mesh").unwrap())
        .then(|| out.table("mesh").unwrap().rows().flat_map(|row| row.iter().copied()).collect());
    Made {
        panorama: panorama.data.to_vec(),
        size: (panorama.width, panorama.height),
        canvas: out.value("canvas").unwrap(),
        mesh,
    }
}

/// Root mean square difference from the tissue where both views see, levels.
fn difference(made: &Made) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for y in 12..SIZE.1 - 12 {
        for x in 130..SIZE.0 - 12 {
            let (u, v) = (x as i32 + made.canvas.x, y as i32 + made.canvas.y);
            let at = (v as usize * made.size.0 + u as usize) * 3;
            for (shown, truth) in made.panorama[at..at + 3].iter().zip(tissue(x as f64, y as f64)) {
                squares += (f64::from(*shown) - f64::from(truth)).powi(2);
                count += 1.0;
            }
        }
    }
    f64::sqrt(squares / count)
}

#[test]
fn with_a_disparity_the_panorama_is_whole() {
    let whole = tick(&mut node(""), Some(&map()), plane(abi::STATE_FRESH));
    let broken = tick(&mut node(""), None, plane(abi::STATE_FRESH));
    assert!(whole.mesh.is_some() && broken.mesh.is_none());
    let (whole, broken) = (difference(&whole), difference(&broken));
    assert!(whole < 8.0 && broken > 2.0 * whole, "{whole} levels with the disparity, {broken} without");
}

#[test]
fn a_smaller_disparity_does_as_well() {
    let large = map();
    let small = |y: usize| large[y * SIZE.0..(y + 1) * SIZE.0].iter().step_by(2).map(|d| d / 2.0);
    let small: Vec<f32> = (0..SIZE.1).step_by(2).flat_map(small).collect();
    let made = |size: (usize, usize), map: &[f32]| {
        let mut node = node("");
        let [left, right] = views();
        node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &left)
            .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &right)
            .input_image::<Disparity>("disparity", size.0, size.1, map)
            .input_value("homography", plane(abi::STATE_FRESH));
        node.process().map(|out| {
            let panorama = out.plane::<Bgr8>("panorama").unwrap();
            let size = (panorama.width, panorama.height);
            Made { panorama: panorama.data.to_vec(), size, canvas: out.value("canvas").unwrap(), mesh: None }
        })
    };
    let whole = difference(&made((SIZE.0 / 2, SIZE.1 / 2), &small).expect("a panorama"));
    assert!(whole < 8.0, "{whole} levels");
    let error = made((SIZE.0, SIZE.1 / 2), &large[..SIZE.0 * SIZE.1 / 2]).err().expect("an error").to_string();
    assert!(error.contains("320x120") && error.contains("320x240") && error.contains("integer factor"), "{error}");
}

#[test]
fn the_mesh_is_held_while_depth_or_homography_is_lost() {
    let mut node = node("");
    let good = tick(&mut node, Some(&map()), plane(abi::STATE_FRESH));
    assert_eq!(node.metric("mesh_held"), Some(0.0));
    let nothing = vec![f32::NAN; SIZE.0 * SIZE.1];
    let held = tick(&mut node, Some(&nothing), plane(abi::STATE_FRESH));
    assert_eq!((node.metric("mesh_held"), &held.mesh), (Some(1.0), &good.mesh));
    // Smoke: a wrong disparity beside a homography that is only held does not count.
    let wrong: Vec<f32> = map().iter().map(|d| d + 9.0).collect();
    for state in [abi::STATE_HELD, abi::STATE_LOST] {
        assert_eq!(tick(&mut node, Some(&wrong), plane(state)).mesh, good.mesh, "state {state}");
    }
    // Nor does one that folds the view over.
    let mut folded = plane(abi::STATE_FRESH);
    folded.left_from_right[6] = -0.02;
    assert_eq!(tick(&mut node, Some(&wrong), folded).mesh, good.mesh);
    assert_eq!(tick(&mut node, None, plane(abi::STATE_FRESH)).mesh, good.mesh);
}

#[test]
fn a_calibration_of_other_views_is_refused() {
    // SAFETY: plain numbers; all zeros are a value of every field.
    let mut other: Calibration = unsafe { std::mem::zeroed() };
    (other.left.width, other.left.height, other.right.width, other.right.height) = (640, 480, 640, 480);
    let mut node = node("");
    let [left, right] = views();
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &left)
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &right)
        .input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &map())
        .input_value("homography", plane(abi::STATE_FRESH))
        .input_value("calibration", other);
    let error = node.process().err().expect("an error").to_string();
    assert!(error.contains("640x480") && error.contains("320x240") && error.contains("connect"), "{error}");
}

#[test]
fn the_judge_reads_the_mesh() {
    let mut composite = node("");
    let made = tick(&mut composite, Some(&map()), plane(abi::STATE_FRESH));
    let mesh = made.mesh.expect("a mesh");
    let [left, right] = views();
    let canvas_size = made.size;
    // The seam runs down where the plane is 6 px off.
    let shown: Vec<u8> = (0..canvas_size.0 * canvas_size.1)
        .map(|i| if ((i % canvas_size.0) as i32) < made.canvas.x + 280 { 1 } else { 2 })
        .collect();
    let judged = |with_mesh: bool| {
        let mut judge = Harness::<EvaluateStitch>::open(Setup::new("params = { every = 1 }")).unwrap();
        judge
            .input_image::<Bgr8>("left", SIZE.0, SIZE.1, &left)
            .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &right)
            .input_value("homography", plane(abi::STATE_FRESH))
            .input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &map())
            .input_image::<Gray8>("shown", canvas_size.0, canvas_size.1, &shown)
            .input_value("canvas", made.canvas);
        if with_mesh {
            let names = ["x_px", "y_px", "right_x_px", "right_y_px", "left_x_px", "left_y_px"];
            judge.input_table("mesh", &names, &mesh);
        }
        let out = judge.process().unwrap();
        let table = out.table("table").unwrap();
        let row = table.rows().next().unwrap();
        let column = |name: &str| row[table.names().position(|n| n == name).unwrap()];
        ["align_px", "seam_break_px", "stretch_pct"].map(column)
    };
    let ([align, broken, stretch], [plane_align, plane_broken, plane_stretch]) = (judged(true), judged(false));
    assert!(align < 0.5 && broken < 0.5, "{align} {broken}");
    assert!(plane_align > 3.0 && plane_broken > 5.0, "{plane_align} {plane_broken}");
    assert!(stretch < 5.0 && plane_stretch == 0.0, "{stretch}");
    let mut judge = Harness::<EvaluateStitch>::open(Setup::new("")).unwrap();
    judge
        .input_image::<Bgr8>("left", SIZE.0, SIZE.1, &left)
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &right)
        .input_table("mesh", &["a", "b"], &[1.0, 2.0]);
    let error = judge.process().err().expect("an error").to_string();
    assert!(error.contains("`mesh`") && error.contains("composite_mesh"), "{error}");
}

/// The tissue as the camera `along` baselines right of and below the left one sees it.
fn seen_from(along: [f64; 2]) -> Vec<u8> {
    let pixel = |i: usize| {
        let (u, v) = ((i % SIZE.0) as f64, (i / SIZE.0) as f64);
        let x = (0..50).fold(u + 100.0 * along[0], |x, _| u + along[0] * disparity(x));
        tissue(x, v + along[1] * disparity(x))
    };
    (0..SIZE.0 * SIZE.1).flat_map(pixel).collect()
}

/// Disparity where the camera `along` baselines away sees the point too.
fn known_with(along: [f64; 2]) -> Vec<f32> {
    let known = |i: usize| {
        let (x, y) = ((i % SIZE.0) as f64, (i / SIZE.0) as f64);
        let d = disparity(x);
        if x >= along[0] * d && y >= along[1] * d { d as f32 } else { f32::NAN }
    };
    (0..SIZE.0 * SIZE.1).map(known).collect()
}

#[test]
fn four_views_follow_what_two_pairs_know_of_the_first() {
    let cameras = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
    let joined = |with_depth: bool| {
        let mut node = node("");
        for along in cameras {
            node.input_image::<Bgr8>("views", SIZE.0, SIZE.1, &seen_from(along));
            if along != [0.0, 0.0] {
                let map = [1.0, 0.0, 106.0 * along[0], 0.0, 1.0, 106.0 * along[1], 0.0, 0.0, 1.0];
                node.input_value("homographies", Homography { left_from_right: map, ..plane(abi::STATE_FRESH) });
            }
        }
        for along in [cameras[1], cameras[2]].into_iter().filter(|_| with_depth) {
            node.input_image::<Disparity>("disparities", SIZE.0, SIZE.1, &known_with(along));
        }
        let out = node.process().unwrap();
        let panorama = out.plane::<Bgr8>("panorama").unwrap();
        let mesh = (!out.is_empty("mesh").unwrap()).then(|| {
            let table = out.table("mesh").unwrap();
            assert_eq!(table.names().next(), Some("view"));
            let rows: Vec<Vec<f64>> = table.rows().map(<[f64]>::to_vec).collect();
            rows
        });
        let made = Made {
            panorama: panorama.data.to_vec(),
            size: (panorama.width, panorama.height),
            canvas: out.value("canvas").unwrap(),
            mesh: None,
        };
        (made, mesh)
    };
    let ((whole, mesh), (broken, none)) = (joined(true), joined(false));
    let (whole, broken) = (difference(&whole), difference(&broken));
    assert!(whole < 8.0 && broken > 2.0 * whole, "{whole} levels with the disparities, {broken} without");
    assert!(none.is_none());
    let mesh = mesh.expect("meshes");
    for (number, along) in [(2.0, cameras[1]), (3.0, cameras[2]), (4.0, cameras[3])] {
        // Where both see, off the rims.
        let inside =
            |row: &&Vec<f64>| row[0] == number && (140.0..300.0).contains(&row[1]) && (140.0..220.0).contains(&row[2]);
        let errors = mesh.iter().filter(inside).map(|row| {
            let d = disparity(row[1]);
            (row[3] - (row[1] - along[0] * d)).hypot(row[4] - (row[2] - along[1] * d))
        });
        let errors: Vec<f64> = errors.collect();
        assert!(errors.len() > 20 && errors.iter().all(|error| *error < 1.5), "view {number}: {errors:?}");
    }
}

#[test]
fn a_calibration_beside_several_views_is_an_error_of_the_graph() {
    let connected = ["views", "views", "homographies", "disparities", "calibration"];
    let problems = Harness::<CompositeMesh>::problems(&Setup::new(""), &connected).unwrap();
    assert!(
        problems.iter().any(|problem| format!("{problem:?}").contains("leave `calibration` unconnected")),
        "{problems:?}"
    );
    let fits = Harness::<CompositeMesh>::problems(&Setup::new(""), &connected[..4]).unwrap();
    assert!(fits.is_empty(), "{fits:?}");
}
