//! Models that do not fit their table are refused, with their shape and a valid one.

use panoscope_node::harness::Harness;
use panoscope_tools::onnx::Onnx;

use crate::tiny_onnx::{BYTE, DOUBLE, FLOAT, Fixed, HALF, INT64, SIGNED, WiredModel, folder, runtime_is_there};

const IMAGE: &str = "port = 'image'";
const LEFT_MASK: &str = "port = 'mask'";

/// Element type and shape of the input `x`, its keys in the table, shape of the constant output `y`, its keys, and the parts of the refusal: what
/// there is, and what would be valid.
type Odd<'a> = ((i64, &'a [i64]), &'a str, &'a [i64], &'a str, [&'a str; 2]);

const ODD_INPUTS: [Odd<'_>; 15] = [
    ((FLOAT, &[1, 4, 16, 32]), IMAGE, &[16, 32], LEFT_MASK, ["`x` f32 1x4x16x32", "1x3xHxW or 1xHxWx3 or 1x1xHxW"]),
    ((FLOAT, &[2, 3, 16, 32]), IMAGE, &[16, 32], LEFT_MASK, ["`x` f32 2x3x16x32", "1x3xHxW"]),
    ((FLOAT, &[1, 1, 3, 16, 32]), IMAGE, &[16, 32], LEFT_MASK, ["`x` f32 1x1x3x16x32", "1x3xHxW"]),
    ((FLOAT, &[512]), IMAGE, &[16, 32], LEFT_MASK, ["`x` f32 512", "1x3xHxW"]),
    ((FLOAT, &[]), IMAGE, &[16, 32], LEFT_MASK, ["`x` f32 number", "1x3xHxW"]),
    ((INT64, &[1, 3, 16, 32]), IMAGE, &[16, 32], LEFT_MASK, ["`x` i64 1x3x16x32", "f32, f16, u8 or i8, 1x3xHxW"]),
    ((DOUBLE, &[1, 3, 16, 32]), IMAGE, &[16, 32], LEFT_MASK, ["`x` f64 1x3x16x32", "f32, f16, u8 or i8, 1x3xHxW"]),
    ((FLOAT, &[1, 3, 9000, 32]), IMAGE, &[16, 32], LEFT_MASK, ["`x` f32 1x3x9000x32", "1x3xHxW"]),
    (
        (HALF, &[1, 1, 16, 32]),
        "port = 'image'\norder = 'rgb'",
        &[16, 32],
        LEFT_MASK,
        ["`x` f16 1x1x16x32", "in rgb for `image`"],
    ),
    (
        (BYTE, &[1, 3, 16, 32]),
        "port = 'image'\norder = 'gray'",
        &[16, 32],
        LEFT_MASK,
        ["`x` u8 1x3x16x32", "1x1xHxW or 1xHxWx1"],
    ),
    ((SIGNED, &[1, 16, 32, 3]), "port = 'image'\naxes = 'nchw'", &[16, 32], LEFT_MASK, ["`x` i8 1x16x32x3", "1x3xHxW"]),
    ((FLOAT, &[1, 3, -1, -1]), IMAGE, &[16, 32], LEFT_MASK, ["`x` f32 1x3x?x?", "size = [WIDTH, HEIGHT]"]),
    (
        (FLOAT, &[1, 3, 16, 32]),
        "port = 'image'\nsize = [64, 48]",
        &[16, 32],
        LEFT_MASK,
        ["`x` f32 1x3x16x32", "1x3x48x64"],
    ),
    (
        (FLOAT, &[1, 3, 16, 32]),
        "port = 'image'\nfit = 'multiple'",
        &[16, 32],
        LEFT_MASK,
        ["`x` f32 1x3x16x32", "1x3x?x?"],
    ),
    (
        (FLOAT, &[1, 1, 16, 32]),
        "port = 'image'\nmean = [1, 2, 3]",
        &[16, 32],
        LEFT_MASK,
        ["`x` f32 1x1x16x32", "1x3xHxW"],
    ),
];

const X: (i64, &[i64]) = (FLOAT, &[1, 3, 16, 32]);

const ODD_OUTPUTS: [Odd<'_>; 13] = [
    (X, IMAGE, &[1, 2, 16, 32], "port = 'disparity'", ["`y` 1x2x16x32", "`disparity`: 1x1xHxW"]),
    (X, IMAGE, &[512], "port = 'depth'", ["`y` 512", "`depth`: 1x1xHxW"]),
    (X, IMAGE, &[1, 1, 1, 16, 32], "port = 'confidence'", ["`y` 1x1x1x16x32", "`confidence`: 1x1xHxW"]),
    (X, IMAGE, &[2, 1, 16, 32], "port = 'disparity'", ["`y` 2x1x16x32", "`disparity`: 1x1xHxW"]),
    (X, IMAGE, &[1, 1, 16, 32], "port = 'flow'", ["`y` 1x1x16x32", "`flow`: 1x2xHxW or 1xHxWx2"]),
    (X, IMAGE, &[1, 3, 16, 32], "port = 'flow'", ["`y` 1x3x16x32", "`flow`: 1x2xHxW"]),
    (X, IMAGE, &[1, 4, 16, 32], "port = 'image'", ["`y` 1x4x16x32", "`image`: 1x3xHxW"]),
    (X, IMAGE, &[1, 1, 32, 16], "port = 'disparity'", ["`y` 1x1x32x16", "HxW in proportion to 16x32"]),
    (X, IMAGE, &[1, 1, 16, 16], "port = 'depth'", ["`y` 1x1x16x16", "HxW in proportion to 16x32"]),
    (X, IMAGE, &[1, 3, 16, 32], "port = 'mask'\nchannel = 40", ["`y` 1x3x16x32", "with channel 40"]),
    (X, IMAGE, &[1, 16, 32, 2], "port = 'flow'\naxes = 'nchw'", ["`y` 1x16x32x2", "`flow`: 1x2xHxW"]),
    (X, IMAGE, &[1, 7, 11], "port = 'detections'", ["`y` 1x7x11", "1x10x(5+C)"]),
    (X, IMAGE, &[], "port = 'confidence'", ["`y` number", "`confidence`: 1x1xHxW"]),
];

fn refusal(odd: &Odd<'_>, path: &std::path::Path) -> String {
    let ((kind, input), input_keys, output, output_keys, _) = odd;
    let count = output.iter().product::<i64>().max(1) as usize;
    let model = WiredModel { inputs: vec![("x", *kind, input.to_vec())], ..WiredModel::default() };
    let model = model.with("y", output, Fixed::Floats(vec![0.5; count]));
    std::fs::write(path, model.bytes()).expect("written");
    let table = format!("[inputs.x]\n{input_keys}\n[outputs.y]\n{output_keys}");
    let opened = Harness::<Onnx>::from_toml(&format!("params = {{ model = {path:?}, table = {table:?} }}"));
    opened.err().unwrap_or_else(|| panic!("opened: {kind} {input:?} {input_keys} {output:?} {output_keys}")).to_string()
}

#[test]
fn models_that_do_not_suit_their_table_are_refused_with_both_shapes() {
    if !runtime_is_there() {
        return;
    }
    let path = folder("odd").join("m.onnx");
    let mut wrong = Vec::new();
    for odd in ODD_INPUTS.iter().chain(&ODD_OUTPUTS) {
        let said = refusal(odd, &path);
        if !odd.4.iter().all(|part| said.contains(part)) || !said.contains("m.onnx") {
            wrong.push(format!("{:?} are missing in: {said}", odd.4));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn names_that_only_one_of_model_and_table_has_are_told() {
    if !runtime_is_there() {
        return;
    }
    let folder = folder("odd_names");
    let model = WiredModel {
        inputs: vec![("x", FLOAT, vec![1, 3, 16, 32]), ("iterations", INT64, vec![1])],
        ..WiredModel::default()
    };
    let path = model.with("y", &[16, 32], Fixed::Floats(vec![0.5; 512])).write(&folder, "m.onnx");
    for (table, parts) in [
        (
            "[inputs.left]\nport = 'left'\n[outputs.y]\nport = 'mask'",
            ["names input `left`", "`x` f32 1x3x16x32, `iterations` i64 1"],
        ),
        ("[inputs.x]\nport = 'left'\n[outputs.z]\nport = 'mask'", ["names output `z`", "`y` f32 16x32"]),
        ("[inputs.x]\nport = 'left'\n[outputs.y]\nport = 'mask'", ["`iterations` i64 1", "[inputs.iterations]"]),
    ] {
        let opened = Harness::<Onnx>::from_toml(&format!("params = {{ model = {path:?}, table = {table:?} }}"));
        let error = opened.err().expect("refused").to_string();
        assert!(parts.iter().all(|part| error.contains(part)) && error.contains("m.onnx"), "{error}");
    }
}

#[test]
fn a_network_that_answers_no_number_is_refused() {
    if !runtime_is_there() {
        return;
    }
    let model = WiredModel { inputs: vec![("x", FLOAT, vec![1, 3, 16, 32])], ..WiredModel::default() };
    let path = model.with("y", &[16, 32], Fixed::Floats(vec![f32::NAN; 512])).write(&folder("odd_nan"), "m.onnx");
    let table = "[inputs.x]\nport = 'image'\n[outputs.y]\nport = 'depth'";
    let opened = Harness::<Onnx>::from_toml(&format!("params = {{ model = {path:?}, table = {table:?} }}"));
    let error = opened.err().expect("refused").to_string();
    assert!(error.contains("m.onnx is broken: 512 of 512 values of its output `y`"), "{error}");
}
