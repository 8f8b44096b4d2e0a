//! `onnx`: images reach the network as the table says, and its outputs return in pixels and units of the image.

use std::path::{Path, PathBuf};

use panoscope_node::harness::{Harness, Setup};
use panoscope_node::random::SplitMix64;
use panoscope_node::{Bgr8, Confidence, Depth, Disparity, Gray8, GrayF32, Mask};
use panoscope_tools::onnx::Onnx;

use crate::tiny_onnx::{BYTE, FLOAT, Fixed, HALF, SIGNED, WiredModel, folder, runtime_is_there};

fn params(model: &Path, table: &str, more: &str) -> String {
    format!("params = {{ model = {model:?}, table = {table:?} {more} }}")
}

fn open(model: &Path, table: &str, more: &str) -> Harness<Onnx> {
    Harness::<Onnx>::from_toml(&params(model, table, more)).unwrap_or_else(|error| panic!("{error}\n{table}"))
}

fn noise(len: usize) -> Vec<u8> {
    let mut random = SplitMix64(5);
    (0..len).map(|_| random.bits() as u8).collect()
}

/// A network that returns its input as floats.
fn echo(kind: i64, input: &[i64], output: &[i64]) -> WiredModel {
    WiredModel {
        inputs: vec![("x", kind, input.to_vec())],
        steps: vec![("Cast", vec!["x".into()], "y".into(), Some(FLOAT))],
        outputs: vec![("y", FLOAT, output.to_vec())],
        ..WiredModel::default()
    }
}

const SIZE: (usize, usize) = (24, 16);

#[test]
fn pixels_reach_the_network_in_its_type_and_order_and_come_back() {
    if !runtime_is_there() {
        return;
    }
    let folder = folder("echo");
    let (w, h) = (SIZE.0 as i64, SIZE.1 as i64);
    let image = noise(SIZE.0 * SIZE.1 * 3);
    for (kind, range) in
        [(FLOAT, "[-1, 1]"), (FLOAT, "[0, 255]"), (HALF, "[0, 1]"), (BYTE, "[0, 255]"), (SIGNED, "[-128, 127]")]
    {
        for (dims, axes) in [([1, 3, h, w], "nchw"), ([1, h, w, 3], "nhwc")] {
            for (order, back) in [("rgb", "rgb"), ("bgr", "bgr"), ("rgb", "bgr")] {
                let path = echo(kind, &dims, &dims).write(&folder, "m.onnx");
                let table = format!(
                    "[inputs.x]\nport = 'image'\norder = '{order}'\nrange = {range}\n[outputs.y]\nport = 'image'\norder = '{back}'\nrange = {range}\naxes = '{axes}'"
                );
                let mut node = open(&path, &table, "");
                let out = node.input_image::<Bgr8>("image", SIZE.0, SIZE.1, &image).process().expect("it runs");
                let got = out.plane::<Bgr8>("image").expect("an image");
                let most = if kind == HALF { 1 } else { 0 };
                for (index, (&a, pixel)) in got.data.iter().zip(image.chunks(3).flat_map(|p| [p, p, p])).enumerate() {
                    let channel = if order == back { index % 3 } else { 2 - index % 3 };
                    assert!(a.abs_diff(pixel[channel]) <= most, "{kind} {axes} {order} {back}: {a} at {index}");
                }
            }
        }
    }
}

#[test]
fn mean_and_deviation_are_those_of_the_network_s_channels() {
    if !runtime_is_there() {
        return;
    }
    let path = echo(FLOAT, &[1, 3, 4, 4], &[1, 3, 4, 4]).write(&folder("mean"), "m.onnx");
    // Blue 51, green 102, red 153: 0.2, 0.4 and 0.6; the network has red first.
    let table = |channel: usize| {
        format!(
            "[inputs.x]\nport = 'image'\nmean = [0.5, 0.3, 0.1]\nstd = [0.1, 0.5, 0.2]\n[outputs.y]\nport = 'depth'\nchannel = {channel}"
        )
    };
    let image: Vec<u8> = (0..16).flat_map(|_| [51, 102, 153]).collect();
    for (channel, expected) in [(0, 1.0), (1, 0.2), (2, 0.5)] {
        let mut node = open(&path, &table(channel), "");
        let out = node.input_image::<Bgr8>("image", 4, 4, &image).process().expect("it runs");
        let depth = out.plane::<Depth>("depth").expect("a map");
        assert!(depth.data.iter().all(|mm| (mm - expected).abs() < 1e-5), "{channel}: {:?}", depth.data);
    }
}

#[test]
fn both_views_reach_a_network_for_pairs() {
    if !runtime_is_there() {
        return;
    }
    // Gray, of which the network takes the difference.
    let model = WiredModel {
        inputs: vec![("a", FLOAT, vec![1, 1, 8, 12]), ("b", FLOAT, vec![1, 8, 12])],
        steps: vec![("Sub", vec!["a".into(), "b".into()], "d".into(), None)],
        outputs: vec![("d", FLOAT, vec![1, 1, 8, 12])],
        ..WiredModel::default()
    };
    let path = model.write(&folder("pair"), "m.onnx");
    let table = "[inputs.a]\nport = 'left'\norder = 'gray'\nrange = [0, 255]\n[inputs.b]\nport = 'right'\norder = 'gray'\nrange = [0, 255]\n[outputs.d]\nport = 'disparity'";
    let mut node = open(&path, table, "");
    let mut disparity = |left: u8, right: u8| {
        node.input_image::<Gray8>("left", 12, 8, &[left; 96]);
        // In colours: gray as OpenCV makes it.
        node.input_image::<Bgr8>("right", 12, 8, &[right; 288]);
        let out = node.process().expect("it runs");
        out.plane::<Disparity>("disparity").expect("a map").data.to_vec()
    };
    assert_eq!(disparity(200, 140), [60.0; 96]);
    assert!(disparity(140, 200).iter().all(|px| px.is_nan()), "a disparity that is not positive is unknown");
    node.input_image::<Gray8>("left", 12, 8, &[1; 96]).input_image::<Gray8>("right", 10, 8, &[1; 80]);
    let error = node.process().err().expect("refused").to_string();
    assert!(error.contains("`left` is 12x8, but `right` is 10x8"), "{error}");
    node.input_image::<Gray8>("left", 12, 8, &[1; 96]).input_empty("right");
    let out = node.process().expect("a tick without one of the views");
    assert!(out.is_empty("disparity").expect("an output"));
}

#[test]
fn a_network_of_any_size_takes_the_image_s_own_filled_up() {
    if !runtime_is_there() {
        return;
    }
    let path = echo(FLOAT, &[-1, 3, -1, -1], &[-1, 3, -1, -1]).write(&folder("multiple"), "m.onnx");
    let table = "[inputs.x]\nport = 'image'\nfit = 'multiple'\nmultiple = 16\n[outputs.y]\nport = 'image'";
    let mut node = open(&path, table, "");
    for (w, h) in [(50, 40), (32, 16), (7, 33)] {
        let image = noise(w * h * 3);
        let out = node.input_image::<Bgr8>("image", w, h, &image).process().expect("it runs");
        let got = out.plane::<Bgr8>("image").expect("an image");
        assert_eq!((got.width, got.height, got.data == image), (w, h, true));
    }
    let table = "[inputs.x]\nport = 'image'\nsize = [12, 8]\n[outputs.y]\nport = 'image'";
    let out = open(&path, table, "").input_image::<Bgr8>("image", 12, 8, &[9; 288]).process().expect("it runs");
    assert_eq!(out.plane::<Bgr8>("image").expect("an image").data, [9; 288]);
}

/// A network with one input of 32 x 16 px and constant outputs.
fn constants() -> WiredModel {
    WiredModel { inputs: vec![("x", FLOAT, vec![1, 3, 16, 32])], ..WiredModel::default() }
}

const INPUT: &str = "[inputs.x]\nport = 'image'\n";

#[test]
fn maps_come_in_the_units_of_their_ports() {
    if !runtime_is_there() {
        return;
    }
    // Cells of 2 x 2 px of the input; the image is twice as large as the input.
    let (cells, left): (usize, Vec<f32>) =
        (16 * 8, (0..16 * 8).map(|i| if i % 16 < 8 { 0.25 } else { 0.75 }).collect());
    let model = constants()
        .with("disp", &[1, 1, 8, 16], Fixed::Halves(vec![3.0; cells]))
        .with("inverse", &[1, 8, 16, 1], Fixed::Floats(vec![4.0; cells]))
        .with("raw", &[8, 16], Fixed::SignedBytes(left.iter().map(|p| if *p < 0.5 { -2 } else { 2 }).collect()))
        .with("sure", &[1, 8, 16], Fixed::Bytes(left.iter().map(|p| (p * 256.0) as u8).collect()))
        .with("flow", &[1, 2, 8, 16], Fixed::Floats([vec![1.0; cells], vec![-2.0; cells]].concat()));
    let path = model.write(&folder("units"), "m.onnx");
    let table = format!(
        "{INPUT}[outputs.disp]\nport = 'disparity'\nunit = 'cells'\n[outputs.inverse]\nport = 'depth'\nactivation = 'inverse'\nunit = 'm'\n\
         [outputs.raw]\nport = 'mask'\nscale = 0.5\nactivation = 'sigmoid'\n[outputs.sure]\nport = 'confidence'\nscale = 0.00390625\n[outputs.flow]\nport = 'flow'"
    );
    let run = |more: &str, table: &str| {
        let mut node = open(&path, table, more);
        node.input_image::<Bgr8>("image", 64, 32, &[90; 64 * 32 * 3]).process().expect("it runs")
    };
    let out = run("", &table);
    let at = |x: usize| 16 * 64 + x;
    assert_eq!(out.plane::<Disparity>("disparity").expect("a map").data, [12.0; 64 * 32]);
    assert_eq!(out.plane::<Depth>("depth").expect("a map").data, [250.0; 64 * 32]);
    // 1 / (1 + e) and 1 / (1 + 1 / e), below and above one half.
    let mask = out.plane::<Mask>("mask").expect("a map");
    assert_eq!((mask.data[at(5)], mask.data[at(60)]), (0, 255));
    let sure = out.plane::<Confidence>("confidence").expect("a map");
    assert_eq!((sure.data[at(5)], sure.data[at(60)], sure.data[at(31)] < sure.data[at(32)]), (0.25, 0.75, true));
    assert_eq!(out.plane::<GrayF32>("flow_x").expect("a map").data, [2.0; 64 * 32]);
    assert_eq!(out.plane::<GrayF32>("flow_y").expect("a map").data, [-4.0; 64 * 32]);
    let mask = run(", mask_threshold = 0.9", &table).plane::<Mask>("mask").expect("a map").data.to_vec();
    assert!(mask.iter().all(|v| *v == 0));
    let out = run(", min_confidence = 0.5", &table);
    let disparity = out.plane::<Disparity>("disparity").expect("a map");
    assert!(disparity.data[at(5)].is_nan() && disparity.data[at(60)] == 12.0);
    assert!(out.plane::<Depth>("depth").expect("a map").data[at(5)].is_nan());
    // What the table leaves out stays empty.
    let out = run("", &format!("{INPUT}[outputs.sure]\nport = 'confidence'"));
    assert!(["disparity", "mask", "detections", "image"].iter().all(|name| out.is_empty(name).expect("an output")));
}

#[test]
fn classes_of_pixels_become_a_mask() {
    if !runtime_is_there() {
        return;
    }
    let labels: Vec<i64> = (0..16 * 32).map(|i| i % 3).collect();
    let scores: Vec<f32> = (0..3).flat_map(|c| labels.iter().map(move |l| f32::from(u8::from(*l == c)))).collect();
    let model = constants().with("labels", &[1, 16, 32], Fixed::Ints(labels.clone())).with(
        "scores",
        &[1, 3, 16, 32],
        Fixed::Floats(scores),
    );
    let path = model.write(&folder("classes"), "m.onnx");
    for (output, keys, class) in [
        ("labels", "", None),
        ("scores", "", None),
        ("labels", "channel = 2", Some(2)),
        ("scores", "channel = 2", Some(2)),
    ] {
        let mut node = open(&path, &format!("{INPUT}[outputs.{output}]\nport = 'mask'\n{keys}"), "");
        let out = node.input_image::<Bgr8>("image", 32, 16, &[90; 32 * 16 * 3]).process().expect("it runs");
        let expected: Vec<u8> =
            labels.iter().map(|l| if class.map_or(*l != 0, |c| *l == c) { 255 } else { 0 }).collect();
        assert_eq!(out.plane::<Mask>("mask").expect("a mask").data, expected, "{output} {keys}");
    }
}

#[test]
fn boxes_come_in_px_of_the_image_with_names() {
    if !runtime_is_there() {
        return;
    }
    // A YOLOv8 head of 64 x 64 px: 84 cells, two classes.
    let mut values = vec![0.0; 6 * 84];
    [32.0, 32.0, 16.0, 8.0, 0.0, 0.9].iter().enumerate().for_each(|(k, v)| values[k * 84 + 10] = *v);
    let mut model = WiredModel { inputs: vec![("x", HALF, vec![1, 3, 64, 64])], ..WiredModel::default() };
    model = model.with("boxes", &[1, 6, 84], Fixed::Halves(values));
    model.metadata = vec![("names", "{0: 'grasper', 1: 'hook'}".into())];
    let path = model.write(&folder("boxes"), "m.onnx");
    let table = "[inputs.x]\nport = 'image'\nfit = 'letterbox_centre'\n[outputs.boxes]\nport = 'detections'";
    let mut node = open(&path, table, "");
    let out = node.input_image::<Bgr8>("image", 128, 96, &vec![90; 128 * 96 * 3]).process().expect("it runs");
    let found = out.detections("detections").expect("boxes");
    let [item] = found.items() else { panic!("{:?}", found.items()) };
    assert_eq!([item.x_px, item.y_px, item.width_px, item.height_px], [48.0, 40.0, 32.0, 16.0]);
    assert_eq!((found.label(item.class_index), found.image_size()), ("hook", (128, 96)));
    assert!((item.score - 0.9).abs() < 1e-3);
}

#[test]
fn the_table_may_stand_beside_the_model() {
    if !runtime_is_there() {
        return;
    }
    let folder = folder("beside");
    let path = constants().with("sure", &[1, 16, 32], Fixed::Floats(vec![0.5; 512])).write(&folder, "m.onnx");
    let table = format!("{INPUT}[outputs.sure]\nport = 'confidence'\n");
    std::fs::write(folder.join("m.toml"), &table).expect("written");
    std::fs::write(folder.join("other.toml"), table.replace("confidence", "mask")).expect("written");
    let gives = |more: &str, output: &str| {
        let text = format!("params = {{ model = {path:?} {more} }}");
        let mut node = Harness::<Onnx>::from_toml(&text).unwrap_or_else(|error| panic!("{error}"));
        let out = node.input_image::<Bgr8>("image", 32, 16, &[90; 32 * 16 * 3]).process().expect("it runs");
        !out.is_empty(output).expect("an output")
    };
    assert!(gives("", "confidence"));
    assert!(gives(&format!(", table_file = {:?}", folder.join("other.toml")), "mask"));
}

#[test]
fn wiring_that_does_not_suit_the_table_is_found_before_the_model_opens() {
    let file: PathBuf = folder("wiring").join("m.onnx");
    std::fs::write(&file, b"not looked at").expect("written");
    let table = "[inputs.a]\nport = 'left'\n[inputs.b]\nport = 'right'\n[outputs.d]\nport = 'disparity'";
    let problems = |connected: &[&str], read: &[&str], table: &str| {
        let setup = Setup::new(&params(&file, table, "")).read_only(read);
        let found = Harness::<Onnx>::problems(&setup, connected).expect("a table");
        found.iter().map(|p| format!("{} {}", p.message, p.help)).collect::<Vec<_>>().join("\n")
    };
    assert_eq!(problems(&["left", "right"], &["disparity"], table), "");
    let words = problems(&["left"], &["disparity"], table);
    assert!(words.contains("input `right` is not connected") && words.contains("network's input `b`"), "{words}");
    let words = problems(&["left", "right", "image"], &["disparity"], table);
    assert!(words.contains("input `image` is connected; the table gives it to no input"), "{words}");
    let words = problems(&["left", "right"], &["depth"], table);
    assert!(words.contains("output `depth` is read; the table makes disparity"), "{words}");
    let words = problems(&["left"], &[], "[inputs.a]\nport = 'middle'");
    assert!(words.contains("`table`, line 2: unknown variant `middle`"), "{words}");
    let words = problems(&["left"], &[], "");
    assert!(words.contains("m.toml") && words.contains("panoscope describe"), "{words}");
}
