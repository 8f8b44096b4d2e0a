//! The check of an ONNX file before ONNX Runtime opens it, and what `panoscope describe` reads of it.

use panoscope_base::onnx;

use crate::scratch;

// The source of the plugin `tools` itself: two plugins linked into one program would both define the entry symbol.
#[allow(dead_code)]
#[path = "../../../../plugins/tools/src/onnx_file.rs"]
mod onnx_file;

pub fn run(bytes: &[u8]) {
    let _ = onnx::signature::signature(bytes);
    scratch::file("model/weights.bin", &[0; 16]);
    let path = scratch::file("model/m.onnx", bytes);
    match onnx_file::read(&path) {
        Ok(model) => assert!(model.bytes.len() <= bytes.len()),
        Err(error) => assert!(error.to_string().contains("m.onnx"), "{error}"),
    }
}

/// A protobuf varint.
fn varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

/// A length-delimited field.
fn field(number: u64, bytes: &[u8]) -> Vec<u8> {
    [varint(number << 3 | 2), varint(bytes.len() as u64), bytes.to_vec()].concat()
}

fn number(field: u64, value: u64) -> Vec<u8> {
    [varint(field << 3), varint(value)].concat()
}

pub fn seeds() -> Vec<Vec<u8>> {
    let entry = |key: &[u8], value: &[u8]| field(13, &[field(1, key), field(2, value)].concat());
    let outside = |location: &[u8]| [vec![8, 4, 16, 1], field(8, b"w"), entry(b"location", location)].concat();
    let tensor = |location: &[u8]| field(5, &outside(location));
    let node = field(1, &[field(1, b"w"), field(2, b"output"), field(4, b"Identity")].concat());
    let opset = || field(8, &[field(1, b""), vec![16, 13]].concat());
    let model = |graph: &[u8]| [vec![8, 8], field(7, graph), opset()].concat();
    let mut nested = field(2, b"inner");
    for _ in 0..20 {
        let attribute = field(5, &[field(1, b"then_branch"), field(6, &nested)].concat());
        nested = field(1, &[field(4, b"If"), attribute].concat());
    }
    let call = |operator: &str, domain: &str, inputs: &[&str], outputs: &[&str]| {
        let texts =
            |number, texts: &[&str]| texts.iter().flat_map(|t| field(number, t.as_bytes())).collect::<Vec<u8>>();
        [texts(1, inputs), texts(2, outputs), field(4, operator.as_bytes()), field(7, domain.as_bytes())].concat()
    };
    // Functions that call the next one twice, in a circle, and one that is not there.
    let functions = |count: usize, calls: &dyn Fn(usize) -> String| {
        let all = (0..count).flat_map(|k| {
            let inside = field(7, &call(&calls(k), "own", &["x"], &["y"])).repeat(2);
            field(25, &[field(1, format!("F{k}").as_bytes()), inside, field(10, b"own")].concat())
        });
        [model(&field(1, &call("F0", "own", &["x"], &["y"]))), all.collect()].concat()
    };
    // Constants: whole numbers in each of their forms, lists that double.
    let constant = |name: &str, parts: Vec<Vec<u8>>| field(5, &[parts.concat(), field(8, name.as_bytes())].concat());
    let doubling: Vec<u8> = (0..40)
        .flat_map(|k| {
            let (from, to) = (format!("c{k}"), format!("c{}", k + 1));
            field(1, &call("Concat", "", &[&from, &from], &[&to]))
        })
        .collect();
    let attribute =
        |number_of_field: u64, bytes: &[u8]| field(5, &[field(1, b"value"), field(number_of_field, bytes)].concat());
    let with = |attribute: Vec<u8>| model(&field(1, &[call("Constant", "", &[], &["c"]), attribute].concat()));
    let value = |number_of_field: u64, name: &str| field(number_of_field, &field(1, name.as_bytes()));
    let looped = |count: Vec<Vec<u8>>, condition: Vec<Vec<u8>>, from: &str, inputs: &[&str]| {
        let body = [
            field(1, &call("Identity", "", &[from], &["go_on"])),
            constant("inside", vec![vec![8, 1], number(5, 1)]),
            value(11, "turn"),
            value(11, "go"),
            value(12, "go_on"),
        ];
        let node =
            [call("Loop", "", inputs, &["y"]), field(5, &[field(1, b"body"), field(6, &body.concat())].concat())];
        model(&[field(1, &node.concat()), constant("count", count), constant("yes", condition)].concat())
    };
    let most = i64::MAX as u64;
    let both = ["count", "yes"];
    let truth = || vec![vec![8, 1], field(9, &[1])];
    // An input with one axis of any length, an output that is not a tensor, and metadata.
    let dims = [field(1, &number(1, 3)), field(1, &field(2, b"any"))].concat();
    let tensor_type = field(2, &field(1, &[number(1, 10), field(2, &dims)].concat()));
    let declared = [
        field(11, &[field(1, b"image"), tensor_type].concat()),
        field(12, &[field(1, b"list"), field(2, &field(4, b""))].concat()),
    ];
    let described = [model(&declared.concat()), field(14, &[field(1, b"task"), field(2, b"pose")].concat())].concat();
    let plain = model(&[node.clone(), field(2, b"g"), tensor(b"weights.bin")].concat());
    let appended = |name: &str, bytes: &[u8]| [onnx::bundle_header(name, bytes.len() as u64), bytes.to_vec()].concat();
    let sparse = field(15, &field(1, &outside(b"weights.bin")));
    vec![
        plain.clone(),
        model(&[node, tensor(b"../secret"), tensor(b"/etc/passwd")].concat()),
        model(&tensor(b"absent.bin")),
        model(&tensor(b"")),
        model(&sparse),
        [model(b""), field(20, &field(1, &tensor(b"weights.bin")))].concat(),
        model(&nested),
        model(b""),
        functions(12, &|k| format!("F{}", k + 1)),
        functions(40, &|k| format!("F{}", k + 1)),
        functions(70, &|k| format!("F{}", k + 1)),
        functions(5, &|k| format!("F{}", (k + 1) % 5)),
        functions(2, &|_| "Gone".to_owned()),
        model(&[doubling, constant("c0", vec![number(1, 1)])].concat()),
        with(attribute(5, &[vec![8, 3], field(8, b"c"), field(9, &[0; 12])].concat())),
        with(attribute(10, &[field(1, &[2, 3]), field(8, b"c")].concat())),
        with(attribute(11, &field(1, &call("Add", "", &["a", "b"], &["d"])))),
        with(attribute(22, &field(1, &outside(b"weights.bin")))),
        with(attribute(23, &field(2, &outside(b"weights.bin")))),
        looped(vec![number(7, most)], truth(), "go", &both),
        looped(vec![field(7, &varint(most))], vec![field(5, &[1])], "inside", &both),
        looped(vec![field(9, &most.to_le_bytes())], truth(), "turn", &both),
        looped(vec![number(7, 9)], truth(), "go", &both),
        looped(vec![number(1, 2), number(7, most)], truth(), "go", &both),
        looped(Vec::new(), truth(), "go", &["", "yes"]),
        looped(Vec::new(), truth(), "go", &["", ""]),
        looped(Vec::new(), vec![field(9, &[0])], "go", &["", "yes"]),
        [plain.clone(), appended("weights.bin", b"abc"), appended("more.bin", b"")].concat(),
        [plain.clone(), appended("weights.bin", b"abc"), field(7, b"")].concat(),
        [plain.clone(), field(52_001, b"")].concat(),
        [plain.clone(), field(52_001, &[field(1, &[0xff]), number(3, 1)].concat())].concat(),
        [plain.clone(), vec![9], vec![0; 8], vec![13], vec![0; 4]].concat(),
        [plain.clone(), vec![9, 0]].concat(),
        [plain.clone(), vec![0x80]].concat(),
        [plain.clone(), vec![0xff; 11]].concat(),
        [plain, vec![11]].concat(),
        described,
        b"no model".to_vec(),
    ]
}
