//! The walk through an ONNX file before ONNX Runtime sees it.

use crate::scratch;

// The source of the plugin `tools` itself: two plugins linked into one program would both define the entry symbol.
#[allow(dead_code)]
#[path = "../../../../plugins/tools/src/onnx_file.rs"]
mod onnx_file;

pub fn run(bytes: &[u8]) {
    scratch::file("model/weights.bin", &[0; 16]);
    let path = scratch::file("model/m.onnx", bytes);
    match onnx_file::read(&path) {
        Ok(model) => assert!(model.bytes.len() <= bytes.len()),
        Err(error) => assert!(error.to_string().contains("m.onnx"), "{error}"),
    }
}

/// A length-delimited field.
fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![number << 3 | 2];
    let mut len = bytes.len();
    while len >= 0x80 {
        out.push(len as u8 | 0x80);
        len >>= 7;
    }
    out.push(len as u8);
    out.extend_from_slice(bytes);
    out
}

pub fn seeds() -> Vec<Vec<u8>> {
    let entry = |key: &[u8], value: &[u8]| field(13, &[field(1, key), field(2, value)].concat());
    let tensor =
        |location: &[u8]| field(5, &[vec![8, 4, 16, 1], field(8, b"w"), entry(b"location", location)].concat());
    let node = field(1, &[field(1, b"w"), field(2, b"output"), field(4, b"Identity")].concat());
    let model =
        |graph: &[u8]| [vec![8, 8], field(7, graph), field(8, &[field(1, b""), vec![16, 13]].concat())].concat();
    let mut nested = field(2, b"inner");
    for _ in 0..20 {
        let attribute = field(5, &[field(1, b"then_branch"), field(6, &nested)].concat());
        nested = field(1, &[field(4, b"If"), attribute].concat());
    }
    vec![
        model(&[node.clone(), field(2, b"g"), tensor(b"weights.bin")].concat()),
        model(&[node, tensor(b"../secret"), tensor(b"/etc/passwd")].concat()),
        model(&nested),
        model(b""),
        b"no model".to_vec(),
    ]
}
