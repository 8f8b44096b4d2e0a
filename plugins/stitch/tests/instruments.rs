//! Instruments in the composite by a mesh: with a mask, an instrument just in front of the tissue stays whole.

use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::harness::{Harness, Setup};
use panoscope_node::{Bgr8, Disparity, Gray8, Mask};
use panoscope_stitch::CompositeMesh;

const SIZE: (usize, usize) = (320, 240);
/// Disparity of the tissue, and of the instrument: too little in front to be distinguished from a fold.
const TISSUE_PX: f64 = 106.0;
const TOOL_PX: f64 = 111.0;

/// Whether a pixel is on the bar, which extends from the right border far into the overlap.
fn is_tool(x: f64, y: f64) -> bool {
    x > 150.0 && (108.0..132.0).contains(&y)
}

fn picture(shift: f64) -> Vec<u8> {
    let pixel = |i: usize| {
        let (x, y) = ((i % SIZE.0) as f64, (i / SIZE.0) as f64);
        let tool_x = if shift > 0.0 { x + TOOL_PX } else { x };
        let wave = 60.0 * (0.35 * (x + shift) + (0.04 * y).sin()).sin() + 30.0 * (0.21 * y).sin();
        // What the left view shows of the tissue is off in the nearer half of what both see: the seam would rather run across the bar.
        let haze = if shift == 0.0 && x < 230.0 { 50.0 } else { 0.0 };
        if is_tool(tool_x, y) { [120; 3] } else { [110.0, 90.0, 140.0].map(|base| (base + wave - haze).max(0.0) as u8) }
    };
    (0..SIZE.0 * SIZE.1).flat_map(pixel).collect()
}

/// Number of the bar's pixels in the overlap from the left and from the right view.
fn shown(node: &mut Harness<CompositeMesh>, hint: &dyn Fn(&mut Harness<CompositeMesh>)) -> [usize; 2] {
    let (left, right) = (picture(0.0), picture(TISSUE_PX));
    let map: Vec<f32> = (0..SIZE.0 * SIZE.1)
        .map(|i| ((i % SIZE.0) as f64, (i / SIZE.0) as f64))
        .map(|(x, y)| (x, if is_tool(x, y) { TOOL_PX } else { TISSUE_PX }))
        .map(|(x, d)| if x > d { d as f32 } else { f32::NAN })
        .collect();
    let mut counts = [0; 2];
    for _ in 0..3 {
        node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &left)
            .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &right)
            .input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &map);
        hint(node);
        let map = [1.0, 0.0, TISSUE_PX, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let plane = Homography { left_from_right: map, rms_px: 1.0, inliers: 100, state: abi::STATE_FRESH };
        let out = node.input_value("homography", plane).process().unwrap();
        let (shown, canvas) = (out.plane::<Gray8>("shown").unwrap(), out.value::<Roi>("canvas").unwrap());
        counts = [0; 2];
        for y in 108..132 {
            let row = shown.row((y + canvas.y) as usize);
            for x in 150..SIZE.0 as i32 {
                let view = row[(x + canvas.x) as usize];
                counts[usize::from(view == 2)] += 1;
            }
        }
    }
    counts
}

fn node(params: &str) -> Harness<CompositeMesh> {
    let seam = "seam = \"dynamic_programming\", seam_cost = \"transition\", blend = \"feather\", blend_px = 24, exposure = \"none\"";
    Harness::open(Setup::new(&format!("params = {{ {seam}{params} }}"))).unwrap()
}

#[test]
fn an_instrument_in_a_mask_comes_from_one_view() {
    let mask: Vec<u8> =
        (0..SIZE.0 * SIZE.1).map(|i| if is_tool((i % SIZE.0) as f64, (i / SIZE.0) as f64) { 255 } else { 0 }).collect();
    let masked = |node: &mut Harness<CompositeMesh>| {
        node.input_image::<Mask>("mask", SIZE.0, SIZE.1, &mask);
    };
    let lesser =
        |params: &str, hint: &dyn Fn(&mut Harness<CompositeMesh>)| shown(&mut node(params), hint).into_iter().min();
    let found = lesser("", &|_| {});
    assert!(found > Some(400), "without a detector the seam crosses it: {found:?}");
    assert_eq!(lesser("", &masked), Some(0), "in a mask");
    let found = lesser(", instruments = false", &masked);
    assert!(found > Some(400), "switched off: {found:?}");
}

#[test]
fn a_mask_of_another_size_is_refused() {
    let mut node = node("");
    let (left, right) = (picture(0.0), picture(TISSUE_PX));
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &left)
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &right)
        .input_image::<Mask>("mask", 16, 12, &[0; 16 * 12]);
    let error = node.process().err().expect("an error").to_string();
    assert!(error.contains("16x12") && error.contains("320x240") && error.contains("mask of the left view"), "{error}");
}
