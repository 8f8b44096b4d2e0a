//! Broken and hostile ONNX files, one for each kind of damage.

use super::onnx::{
    DETECTED, FLOAT, INT64, Message, Parts, floats, graph_attribute, int_attribute, ints, ints_attribute,
    literal_value, model, node, opset, tensor, tensor_attribute, value,
};

/// A file and a description of its damage.
pub struct Kind {
    pub name: String,
    pub bytes: Vec<u8>,
}

#[derive(Default)]
struct Kinds(Vec<Kind>);

impl Kinds {
    fn add(&mut self, name: impl Into<String>, bytes: Vec<u8>) {
        self.0.push(Kind { name: name.into(), bytes });
    }

    fn graph(&mut self, name: impl Into<String>, parts: &Parts) {
        self.add(name, parts.bytes());
    }
}

/// Files that a model of the kind `external` may name; the test creates the link, the pipe and the folder.
pub const LINK: &str = "link.bin";
pub const PIPE: &str = "pipe.bin";
pub const FOLDER: &str = "folder";

/// All kinds. The same in every run.
pub fn all() -> Vec<Kind> {
    let mut kinds = Kinds::default();
    cut(&mut kinds);
    wire_types(&mut kinds);
    data_types(&mut kinds);
    dimensions(&mut kinds);
    external(&mut kinds);
    structure(&mut kinds);
    nested(&mut kinds);
    versions(&mut kinds);
    bombs(&mut kinds);
    names(&mut kinds);
    foreign(&mut kinds);
    kinds.0
}

fn cut(kinds: &mut Kinds) {
    let whole = Parts::healthy().bytes();
    for part in 0..20 {
        kinds.add(format!("cut after {part} of 20 parts"), whole[..whole.len() * part / 20].to_vec());
    }
    kinds.add("the last byte is missing", whole[..whole.len() - 1].to_vec());
    kinds.add("one byte too many", [&whole[..], &[0]].concat());
    kinds.add("twice", [&whole[..], &whole[..]].concat());
}

fn wire_types(kinds: &mut Kinds) {
    for field in [1, 7, 8, 14] {
        for (wire, content) in [(1, &[0xff; 8][..]), (5, &[0xff; 4]), (3, &[]), (6, &[1])] {
            kinds.add(
                format!("field {field} of the model as wire type {wire}"),
                Message::default().raw(field, wire, content).0,
            );
        }
    }
    let long = [0xff; 11];
    kinds.add("a number of 11 bytes", Message::default().raw(1, 0, &long).0);
    kinds.add(
        "a length beyond memory",
        Message::default().raw(7, 2, &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f]).0,
    );
    kinds.add("field number 0", Message::default().raw(0, 0, &[1]).0);
}

fn data_types(kinds: &mut Kinds) {
    for kind in [0, 2, 6, 7, 8, 9, 10, 11, 14, 16, 20, 23, 99, -1] {
        let raw = vec![0x41; 84 * 84 * 4];
        let parts = Parts::healthy().tensors(vec![tensor("held", kind, &DETECTED, &raw)]);
        kinds.graph(format!("weights of type {kind}"), &parts);
        let mut parts = Parts::healthy();
        parts.inputs = vec![value("images", kind, &[1, 3, 64, 64])];
        kinds.graph(format!("an input of type {kind}"), &parts);
    }
}

fn dimensions(kinds: &mut Kinds) {
    let many = vec![1; 2000];
    let shapes: [(&str, &[i64]); 11] = [
        ("no", &[]),
        ("zero", &[0]),
        ("negative", &[-1, 84, 84]),
        ("smallest", &[i64::MIN, 1, 1]),
        ("largest", &[i64::MAX]),
        ("2^31 x 2^31", &[1 << 31, 1 << 31]),
        ("overflowing", &[1 << 62, 4, 1]),
        ("2^40", &[1 << 40]),
        ("too few", &[1, 84]),
        ("too many", &[1, 84, 84, 84]),
        ("2000", &many),
    ];
    for (name, dims) in shapes {
        let raw = vec![0; 84 * 84 * 4];
        kinds.graph(
            format!("weights with {name} dimensions"),
            &Parts::healthy().tensors(vec![tensor("held", FLOAT, dims, &raw)]),
        );
        let mut parts = Parts::healthy();
        parts.inputs = vec![literal_value("images", FLOAT, dims)];
        kinds.graph(format!("an input with {name} dimensions"), &parts);
        let mut parts = Parts::healthy();
        parts.outputs = vec![literal_value("output0", FLOAT, dims)];
        kinds.graph(format!("an output with {name} dimensions"), &parts);
    }
    let sizes =
        [("a picture of 1 px", 1), ("a picture of 2^20 px a side", 1 << 20), ("a picture of 2^40 px a side", 1 << 40)];
    for (name, side) in sizes {
        let mut parts = Parts::healthy();
        parts.inputs = vec![value("images", FLOAT, &[1, 3, side, side])];
        kinds.graph(name, &parts);
    }
    for channels in [0, 1, 4, 1 << 33] {
        let mut parts = Parts::healthy();
        parts.inputs = vec![value("images", FLOAT, &[1, channels, 64, 64])];
        kinds.graph(format!("a picture of {channels} channels"), &parts);
    }
}

fn external(kinds: &mut Kinds) {
    let entry = |key: &str, value: &[u8]| Message::default().text(1, key).bytes(2, value);
    let held = |entries: &[Message]| {
        let blank = DETECTED.iter().fold(Message::default(), |m, &d| m.int(1, d)).int(2, FLOAT).text(8, "held");
        blank.messages(13, entries).int(14, 1)
    };
    let long = "x".repeat(10_000);
    let deep = "../".repeat(3000) + "etc/passwd";
    let places = [
        "/etc/passwd",
        "../secret.bin",
        "../../secret.bin",
        "a/../../secret.bin",
        "./secret.bin",
        "",
        ".",
        "..",
        "/",
        "//secret.bin",
        "/proc/self/mem",
        "/dev/zero",
        "/dev/stdin",
        LINK,
        PIPE,
        FOLDER,
        "gone.bin",
        "m.onnx",
        "~/.ssh/id_rsa",
        "file:///etc/passwd",
        "C:\\secret.bin",
        "nul\0.bin",
        &long,
        &deep,
    ];
    for place in places {
        let short: String = place.chars().take(24).collect();
        kinds.graph(
            format!("weights in {short:?}"),
            &Parts::healthy().tensors(vec![held(&[entry("location", place.as_bytes())])]),
        );
    }
    kinds.graph(
        "weights in a place that is not UTF-8",
        &Parts::healthy().tensors(vec![held(&[entry("location", &[0xff, 0xfe])])]),
    );
    kinds.graph("weights in no place", &Parts::healthy().tensors(vec![held(&[])]));
    let offsets = ["-1", "18446744073709551615", "9223372036854775807", "x", ""];
    for offset in offsets {
        for key in ["offset", "length"] {
            let entries = [entry("location", b"weights.bin"), entry(key, offset.as_bytes())];
            kinds.graph(format!("weights with {key} {offset:?}"), &Parts::healthy().tensors(vec![held(&entries)]));
        }
    }
    let both = held(&[entry("location", b"weights.bin")]).bytes(9, &[0; 16]);
    kinds.graph("weights inside and outside", &Parts::healthy().tensors(vec![both]));
    // The first location is harmless, the second counts.
    let two = [entry("location", b"weights.bin"), entry("location", b"../secret.bin")];
    kinds.graph("weights in two places", &Parts::healthy().tensors(vec![held(&two)]));
    let hidden = tensor_attribute("value", &held(&[entry("location", b"../secret.bin")]));
    let constant = node("Constant", &[], &["output0"]).message(5, &hidden);
    kinds.graph("weights outside, in an attribute", &Parts::healthy().nodes(vec![constant]));
    let sparse = Message::default().message(1, &held(&[entry("location", b"/etc/passwd")])).int(3, 4);
    kinds.add("weights outside, in a sparse tensor", model(&Parts::healthy().graph().message(15, &sparse)).0);
    let training =
        Message::default().message(1, &Message::default().message(5, &held(&[entry("location", b"/etc/passwd")])));
    kinds.add("weights outside, for training", model(&Parts::healthy().graph()).message(20, &training).0);
}

fn structure(kinds: &mut Kinds) {
    let of = |nodes: Vec<Message>| Parts::healthy().nodes(nodes);
    let identity = |from: &str, to: &str| node("Identity", &[from], &[to]);
    kinds.graph(
        "two nodes that need each other",
        &of(vec![identity("b", "a"), identity("a", "b"), identity("a", "output0")]),
    );
    kinds.graph("a node that needs itself", &of(vec![identity("output0", "output0")]));
    kinds.graph("an output made twice", &of(vec![identity("held", "output0"), identity("held", "output0")]));
    kinds.graph("an input that nothing makes", &of(vec![identity("nothing", "output0")]));
    kinds.graph("an output that nothing makes", &of(vec![identity("held", "other")]));
    kinds.graph("no node", &of(Vec::new()));
    kinds.graph("an unknown operator", &of(vec![node("Frobnicate", &["held"], &["output0"])]));
    kinds.graph("an operator of an unknown domain", &of(vec![identity("held", "output0").text(7, "org.nobody")]));
    kinds.graph("an operator without a name", &of(vec![node("", &["held"], &["output0"])]));
    kinds.graph("a node without inputs and outputs", &of(vec![node("Identity", &[], &[])]));
    kinds.graph("a node with too many inputs", &of(vec![node("Identity", &["held"; 500], &["output0"])]));
    kinds.graph(
        "an attribute of a wrong type",
        &of(vec![
            node("Concat", &["held", "held"], &["output0"])
                .message(5, &Message::default().text(1, "axis").text(4, "x").int(20, 3)),
        ]),
    );
    kinds.graph(
        "an attribute without a type",
        &of(vec![node("Concat", &["held"], &["output0"]).message(5, &Message::default().text(1, "axis").int(3, 0))]),
    );
    kinds.graph(
        "an axis out of range",
        &of(vec![node("Concat", &["held"], &["output0"]).message(5, &int_attribute("axis", i64::MIN))]),
    );
    let chain: Vec<Message> = (0..20_000).map(|k| identity(&format!("v{k}"), &format!("v{}", k + 1))).collect();
    let ends = [vec![identity("held", "v0")], chain, vec![identity("v20000", "output0")]].concat();
    kinds.graph("20,000 nodes in a chain", &of(ends));
    let fan: Vec<Message> = (0..20_000).map(|k| identity("held", &format!("w{k}"))).collect();
    kinds.graph("20,000 nodes side by side", &of([fan, vec![identity("held", "output0")]].concat()));
    let weights = || floats("held", &DETECTED, 0.0);
    kinds.graph("weights given twice", &Parts::healthy().tensors(vec![weights(), weights()]));
    let mut parts = Parts::healthy();
    parts.inputs = Vec::new();
    kinds.graph("no input", &parts);
    parts.inputs = vec![value("images", FLOAT, &[1, 3, 64, 64]), value("more", FLOAT, &[1])];
    kinds.graph("two inputs", &parts);
    parts.inputs = vec![value("images", FLOAT, &[1, 3, 64, 64]); 2];
    kinds.graph("one input twice", &parts);
    let mut parts = Parts::healthy();
    parts.outputs = Vec::new();
    kinds.graph("no output", &parts);
    parts.outputs = (0..5000).map(|_| value("output0", FLOAT, &DETECTED)).collect();
    kinds.graph("one output 5,000 times", &parts);
    let mut parts = Parts::healthy().nodes(Vec::new());
    parts.outputs = vec![value("images", FLOAT, &[1, 3, 64, 64])];
    kinds.graph("the input is the output", &parts);
    let function = |name: &str, calls: &str| {
        let call = node(calls, &["x"], &["y"]).text(7, "own");
        Message::default()
            .text(1, name)
            .text(4, "x")
            .text(5, "y")
            .message(7, &call)
            .message(9, &opset("", 13))
            .message(9, &opset("own", 1))
            .text(10, "own")
    };
    let calling = |functions: &[Message]| {
        let graph = Parts::healthy().nodes(vec![node("First", &["held"], &["output0"]).text(7, "own")]).graph();
        model(&graph).message(8, &opset("own", 1)).messages(25, functions).0
    };
    kinds.add("a function that calls itself", calling(&[function("First", "First")]));
    kinds.add("functions that call each other", calling(&[function("First", "Second"), function("Second", "First")]));
    kinds.add("a function that is not there", calling(&[]));
    let doubling: Vec<Message> = (0..40)
        .map(|k| {
            let (name, next) = (if k == 0 { "First".to_owned() } else { format!("F{k}") }, format!("F{}", k + 1));
            let calls = [node(&next, &["x"], &["a"]).text(7, "own"), node(&next, &["a"], &["y"]).text(7, "own")];
            let last = [node("Identity", &["x"], &["a"]), node("Identity", &["a"], &["y"])];
            let body = if k == 39 { last } else { calls };
            Message::default()
                .text(1, &name)
                .text(4, "x")
                .text(5, "y")
                .messages(7, &body)
                .message(9, &opset("", 13))
                .message(9, &opset("own", 1))
                .text(10, "own")
        })
        .collect();
    kinds.add("functions that double 40 times", calling(&doubling));
}

fn nested(kinds: &mut Kinds) {
    for (depth, width) in [(10_000, 1), (1000, 1), (100, 1), (17, 1), (14, 2), (3, 60)] {
        let mut graph = Message::default()
            .message(1, &node("Identity", &["held"], &["inner"]))
            .message(12, &value("inner", FLOAT, &DETECTED));
        for level in 0..depth {
            let branch = |name: &str| graph_attribute(name, &graph);
            let mut one = node("If", &["condition"], &["inner"]);
            for k in 0..width {
                one = one.message(5, &branch(if k % 2 == 0 { "then_branch" } else { "else_branch" }));
            }
            graph = Message::default()
                .message(1, &one)
                .text(2, &format!("l{level}"))
                .message(12, &value("inner", FLOAT, &DETECTED));
            if graph.0.len() > 16 << 20 {
                break;
            }
        }
        kinds.add(format!("graphs in graphs, {depth} deep and {width} wide"), model(&graph).0);
    }
    // Attributes in attributes: no kind of message that holds itself is left out.
    let mut list = Message::default();
    for _ in 0..5000 {
        list = Message::default().message(1, &Message::default().message(5, &Message::default().message(11, &list)));
    }
    kinds.add("lists of graphs, 5,000 deep", model(&list).0);
}

fn versions(kinds: &mut Kinds) {
    let graph = Parts::healthy().graph();
    for version in [0, -1, 1, 9999, 1 << 40] {
        kinds.add(
            format!("opset {version}"),
            Message::default().int(1, 8).message(7, &graph).message(8, &opset("", version)).0,
        );
        kinds.add(
            format!("format {version}"),
            Message::default().int(1, version).message(7, &graph).message(8, &opset("", 13)).0,
        );
    }
    kinds.add("no opset", Message::default().int(1, 8).message(7, &graph).0);
    kinds.add("no format", Message::default().message(7, &graph).message(8, &opset("", 13)).0);
    kinds.add("two opsets of one domain", model(&graph).message(8, &opset("", 9)).0);
    kinds.add("an opset of an unknown domain", model(&graph).message(8, &opset("org.nobody", 1)).0);
    kinds.add("two graphs", model(&graph).message(7, &graph).0);
}

fn bombs(kinds: &mut Kinds) {
    let plain = Parts::healthy;
    for power in [24, 30, 31, 40, 62] {
        let dims = ints("dims", &[1 << power]);
        kinds.graph(
            format!("a constant of 2^{power} values"),
            &plain().with(vec![node("ConstantOfShape", &["dims"], &["big"])], vec![dims], "big"),
        );
        let (one, dims) = (floats("one", &[1], 1.0), ints("dims", &[1 << power]));
        kinds.graph(
            format!("one value expanded to 2^{power}"),
            &plain().with(vec![node("Expand", &["one", "dims"], &["big"])], vec![one, dims], "big"),
        );
    }
    let (one, repeats) = (floats("one", &[1], 1.0), ints("repeats", &[1 << 36]));
    kinds.graph(
        "a tile repeated 2^36 times",
        &plain().with(vec![node("Tile", &["one", "repeats"], &["big"])], vec![one, repeats], "big"),
    );
    let scalar = |name: &str, value: f32| tensor(name, FLOAT, &[], &value.to_le_bytes());
    let range = vec![scalar("a", 0.0), scalar("b", 1e12), scalar("c", 1.0)];
    kinds.graph(
        "a range of 10^12 numbers",
        &plain().with(vec![node("Range", &["a", "b", "c"], &["big"])], range, "big"),
    );
    let range = vec![scalar("a", 0.0), scalar("b", 1.0), scalar("c", 0.0)];
    kinds
        .graph("a range with steps of 0", &plain().with(vec![node("Range", &["a", "b", "c"], &["big"])], range, "big"));
    let doubling: Vec<Message> = (0..40)
        .map(|k| {
            node("Concat", &[&format!("c{k}"), &format!("c{k}")], &[&format!("c{}", k + 1)])
                .message(5, &int_attribute("axis", 0))
        })
        .collect();
    kinds.graph("a list doubled 40 times", &plain().with(doubling, vec![floats("c0", &[1], 1.0)], "c40"));
    let attribute = |operator: &str, inputs: &[&str], attributes: &[Message]| {
        node(operator, inputs, &["big"]).messages(5, attributes)
    };
    let kernel = floats("kernel", &[1, 3, 3, 3], 0.1);
    let convolutions: [(&str, &str, &[i64]); 8] = [
        ("pads of 2^30", "pads", &[1 << 30; 4]),
        ("negative pads", "pads", &[-5; 4]),
        ("strides of 0", "strides", &[0, 0]),
        ("negative strides", "strides", &[-1, -1]),
        ("dilations of 2^40", "dilations", &[1 << 40; 2]),
        ("a kernel of 0", "kernel_shape", &[0, 0]),
        ("a kernel of 2^40", "kernel_shape", &[1 << 40; 2]),
        ("one pad", "pads", &[1]),
    ];
    for (name, key, values) in convolutions {
        let conv = attribute("Conv", &["images", "kernel"], &[ints_attribute(key, values)]);
        kinds.graph(format!("a convolution with {name}"), &plain().with(vec![conv], vec![kernel.clone()], "big"));
    }
    for (name, group) in [("0", 0), ("negative", -3), ("2^40", 1 << 40)] {
        let conv = attribute("Conv", &["images", "kernel"], &[int_attribute("group", group)]);
        kinds
            .graph(format!("a convolution with {name} groups"), &plain().with(vec![conv], vec![kernel.clone()], "big"));
    }
    for (name, values) in [("0", [0, 0]), ("2^40", [1 << 40, 1 << 40]), ("negative", [-2, -2])] {
        let pool = attribute("MaxPool", &["images"], &[ints_attribute("kernel_shape", &values)]);
        kinds.graph(format!("pooling with a kernel of {name}"), &plain().with(vec![pool], Vec::new(), "big"));
    }
    for (name, shape) in [
        ("2^40", vec![1 << 40]),
        ("two unknowns", vec![-1, -1]),
        ("negative", vec![-7]),
        ("an overflow", vec![1 << 62, 4]),
    ] {
        kinds.graph(
            format!("reshaped to {name}"),
            &plain().with(vec![node("Reshape", &["held", "shape"], &["big"])], vec![ints("shape", &shape)], "big"),
        );
    }
    for (name, index) in [("beyond the end", 1 << 40), ("before the begin", -(1 << 40)), ("the smallest", i64::MIN)] {
        let gather = attribute("Gather", &["held", "index"], &[int_attribute("axis", 0)]);
        kinds.graph(format!("an index {name}"), &plain().with(vec![gather], vec![ints("index", &[index])], "big"));
    }
    let depth = vec![ints("depth", &[1 << 40]), ints("index", &[1]), floats("two", &[2], 1.0)];
    kinds.graph(
        "a choice of 2^40",
        &plain().with(vec![node("OneHot", &["index", "depth", "two"], &["big"])], depth, "big"),
    );
    let padding = |amount: i64| {
        vec![node("Pad", &["images", "amount"], &["big"])].into_iter().zip([ints("amount", &[amount; 8])]).next()
    };
    for amount in [1 << 20, -(1 << 20), i64::MAX] {
        if let Some((pad, tensor)) = padding(amount) {
            kinds.graph(format!("a picture padded by {amount}"), &plain().with(vec![pad], vec![tensor], "big"));
        }
    }
    let scales = floats("scales", &[4], 1e6);
    let resize = node("Resize", &["images", "", "scales"], &["big"]);
    kinds.graph("a picture enlarged a million times", &plain().with(vec![resize], vec![scales], "big"));
    let random = attribute("RandomNormal", &[], &[ints_attribute("shape", &[1 << 40])]);
    kinds.graph("2^40 random numbers", &plain().with(vec![random], Vec::new(), "big"));
    let count = tensor("count", INT64, &[], &i64::MAX.to_le_bytes());
    let yes = tensor("yes", 9, &[], &[1]);
    let body = Message::default()
        .message(1, &node("Identity", &["go"], &["go_on"]))
        .message(1, &node("Add", &["sum", "sum"], &["next"]))
        .text(2, "body")
        .message(11, &value("turn", INT64, &[]))
        .message(11, &value("go", 9, &[]))
        .message(11, &value("sum", FLOAT, &DETECTED))
        .message(12, &value("go_on", 9, &[]))
        .message(12, &value("next", FLOAT, &DETECTED));
    let forever = attribute("Loop", &["count", "yes", "held"], &[graph_attribute("body", &body)]);
    kinds.graph("a loop without end", &plain().with(vec![forever], vec![count, yes], "big"));
}

fn names(kinds: &mut Kinds) {
    let bad: [(&str, Vec<u8>); 5] = [
        ("not UTF-8", vec![0xff, 0xfe, 0x80]),
        ("with a zero", b"a\0b".to_vec()),
        ("of a megabyte", vec![b'x'; 1 << 20]),
        ("from right to left", "\u{202e}evil".as_bytes().to_vec()),
        ("with line feeds", b"a\n\x1b[31mb".to_vec()),
    ];
    for (name, bytes) in bad {
        let graph = |field: u64| Parts::healthy().graph().bytes(field, &bytes);
        kinds.add(format!("a graph with a name {name}"), model(&graph(2)).0);
        let one = Message::default().bytes(1, &bytes).text(2, "output0").text(4, "Identity");
        kinds.graph(format!("a node with an input {name}"), &Parts::healthy().nodes(vec![one]));
        let one = node("", &["held"], &["output0"]).bytes(4, &bytes);
        kinds.graph(format!("an operator with a name {name}"), &Parts::healthy().nodes(vec![one]));
        let entry = Message::default().bytes(1, &bytes).bytes(2, &bytes);
        kinds.add(format!("metadata with a name {name}"), model(&Parts::healthy().graph()).message(14, &entry).0);
    }
    let labels = ["{99999999999999999999: 'a'}", "{4294967295: 'a'}", "{0: 'a\\", "[\"\u{0}\n\r\", 'b']"];
    let long = ["{".repeat(5000), "'".repeat(5001), format!("[{}]", "'a',".repeat(20_000))];
    for text in labels.into_iter().map(str::to_owned).chain(long) {
        let short: String = text.chars().take(16).collect();
        let entry = Message::default().text(1, "names").text(2, &text);
        kinds.add(format!("labels {short:?}"), model(&Parts::healthy().graph()).message(14, &entry).0);
    }
}

fn foreign(kinds: &mut Kinds) {
    let begins: [(&str, &[u8]); 10] = [
        ("an executable", b"\x7fELF\x02\x01\x01"),
        ("a zip file", b"PK\x03\x04"),
        ("a picture", b"\x89PNG\r\n\x1a\n"),
        ("another model", b"GGUF"),
        ("JSON", b"{\"a\": 1}"),
        ("a text", b"hello, I am a text\n"),
        ("nothing", b""),
        ("a pickled object", b"\x80\x02}q\x00X"),
        ("a program", b"#!/bin/sh\nexit 0\n"),
        ("HDF5", b"\x89HDF\r\n\x1a\n"),
    ];
    for (name, bytes) in begins {
        kinds.add(name, bytes.to_vec());
    }
    kinds.add("a million zeros", vec![0; 1 << 20]);
    kinds.add("a million ones", vec![0xff; 1 << 20]);
}
