//! Tiny ONNX files written by the tests: one image in, fixed tensors out.

use std::path::{Path, PathBuf};

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// A protobuf message under construction.
#[derive(Clone, Default)]
pub struct Message(pub Vec<u8>);

impl Message {
    pub fn int(mut self, field: u64, value: i64) -> Self {
        varint(&mut self.0, field << 3);
        varint(&mut self.0, value as u64);
        self
    }

    pub fn bytes(mut self, field: u64, value: &[u8]) -> Self {
        varint(&mut self.0, field << 3 | 2);
        varint(&mut self.0, value.len() as u64);
        self.0.extend_from_slice(value);
        self
    }

    pub fn text(self, field: u64, value: &str) -> Self {
        self.bytes(field, value.as_bytes())
    }

    pub fn message(self, field: u64, value: &Message) -> Self {
        self.bytes(field, &value.0)
    }
}

/// Values of an output.
#[derive(Clone)]
pub enum Fixed {
    Floats(Vec<f32>),
    Halves(Vec<f32>),
    Ints(Vec<i64>),
    Bytes(Vec<u8>),
    SignedBytes(Vec<i8>),
}

impl Fixed {
    /// Element type and bytes.
    fn raw(&self) -> (i64, Vec<u8>) {
        match self {
            Self::Floats(v) => (FLOAT, v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Self::Halves(v) => (HALF, v.iter().flat_map(|x| half::f16::from_f32(*x).to_le_bytes()).collect()),
            Self::Ints(v) => (INT64, v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Self::Bytes(v) => (BYTE, v.clone()),
            Self::SignedBytes(v) => (SIGNED, v.iter().map(|x| *x as u8).collect()),
        }
    }
}

/// A model whose output does not depend on the image.
pub struct TinyModel {
    pub input: Vec<i64>,
    pub outputs: Vec<(&'static str, Vec<i64>, Fixed)>,
    pub metadata: Vec<(&'static str, String)>,
}

pub const FLOAT: i64 = 1;
pub const BYTE: i64 = 2;
pub const SIGNED: i64 = 3;
pub const INT64: i64 = 7;
pub const HALF: i64 = 10;
pub const DOUBLE: i64 = 11;

/// Name, element type and shape of an input or output.
pub fn value_info(name: &str, kind: i64, dims: &[i64]) -> Message {
    let dim = |&d: &i64| if d < 0 { Message::default().text(2, "any") } else { Message::default().int(1, d) };
    let shape = dims.iter().fold(Message::default(), |m, d| m.message(1, &dim(d)));
    let tensor = Message::default().int(1, kind).message(2, &shape);
    Message::default().text(1, name).message(2, &Message::default().message(1, &tensor))
}

/// A named tensor.
pub fn tensor(name: &str, dims: &[i64], values: &Fixed) -> Message {
    let (kind, raw) = values.raw();
    let m = dims.iter().fold(Message::default(), |m, &d| m.int(1, d));
    m.int(2, kind).text(8, name).bytes(9, &raw)
}

/// Name, element type and shape of an input or output.
pub type Port = (&'static str, i64, Vec<i64>);

/// A model with the inputs, steps and constants that a test gives it.
#[derive(Default)]
pub struct WiredModel {
    pub inputs: Vec<Port>,
    /// Operator, names of its inputs, name of its output, and what a `Cast` casts to.
    pub steps: Vec<(&'static str, Vec<String>, String, Option<i64>)>,
    pub held: Vec<(String, Vec<i64>, Fixed)>,
    pub outputs: Vec<Port>,
    pub metadata: Vec<(&'static str, String)>,
}

impl WiredModel {
    /// With one more output, a constant.
    pub fn with(mut self, name: &'static str, dims: &[i64], values: Fixed) -> Self {
        let held = format!("{name}_held");
        self.steps.push(("Identity", vec![held.clone()], name.to_owned(), None));
        self.outputs.push((name, values.raw().0, dims.to_vec()));
        self.held.push((held, dims.to_vec(), values));
        self
    }

    pub fn bytes(&self) -> Vec<u8> {
        let mut graph = Message::default();
        for (operator, inputs, output, cast) in &self.steps {
            let mut node = inputs.iter().fold(Message::default(), |node, input| node.text(1, input));
            node = node.text(2, output).text(4, operator);
            if let Some(kind) = cast {
                node = node.message(5, &Message::default().text(1, "to").int(3, *kind).int(20, 2));
            }
            graph = graph.message(1, &node);
        }
        graph = graph.text(2, "tiny");
        for (name, dims, values) in &self.held {
            graph = graph.message(5, &tensor(name, dims, values));
        }
        for (name, kind, dims) in &self.inputs {
            graph = graph.message(11, &value_info(name, *kind, dims));
        }
        for (name, kind, dims) in &self.outputs {
            graph = graph.message(12, &value_info(name, *kind, dims));
        }
        wrap(&graph, &self.metadata)
    }

    /// Writes the file into the test's folder.
    pub fn write(&self, folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, self.bytes()).expect("the test's folder can be written");
        path
    }
}

impl TinyModel {
    pub fn bytes(&self) -> Vec<u8> {
        let model = WiredModel { inputs: vec![("images", FLOAT, self.input.clone())], ..WiredModel::default() };
        let outputs = self.outputs.iter();
        let mut model = outputs.fold(model, |model, (name, dims, values)| model.with(name, dims, values.clone()));
        model.metadata = self.metadata.clone();
        model.bytes()
    }

    /// Writes the file into the test's folder.
    pub fn write(&self, folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, self.bytes()).expect("the test's folder can be written");
        path
    }
}

/// A model around a graph: opset 13, format 8.
pub fn wrap(graph: &Message, metadata: &[(&'static str, String)]) -> Vec<u8> {
    let opset = Message::default().text(1, "").int(2, 13);
    let mut model = Message::default().int(1, 8).message(7, graph).message(8, &opset);
    for (key, value) in metadata {
        model = model.message(14, &Message::default().text(1, key).text(2, value));
    }
    model.0
}

/// Whether ONNX Runtime is installed; reports a skip when it is not.
pub fn runtime_is_there() -> bool {
    match panoscope_tools::runtime_library::environment() {
        Ok(_) => true,
        Err(e) => {
            panoscope_testing::skipped!("{e}");
            false
        }
    }
}

/// An empty folder for this test.
pub fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("tools-{name}"));
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("the target folder can be written");
    path
}
