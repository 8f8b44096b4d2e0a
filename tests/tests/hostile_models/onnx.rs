//! Writes ONNX files, valid or not. Field numbers are those of `onnx.proto3`.

/// A protobuf message under construction.
#[derive(Clone, Default)]
pub struct Message(pub Vec<u8>);

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

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

    /// A field with any wire type and content.
    pub fn raw(mut self, field: u64, wire: u64, content: &[u8]) -> Self {
        varint(&mut self.0, field << 3 | wire);
        self.0.extend_from_slice(content);
        self
    }

    pub fn messages<'m>(self, field: u64, all: impl IntoIterator<Item = &'m Message>) -> Self {
        all.into_iter().fold(self, |m, one| m.message(field, one))
    }
}

pub const FLOAT: i64 = 1;
pub const INT64: i64 = 7;

/// An input or output of a graph.
pub fn value(name: &str, kind: i64, dims: &[i64]) -> Message {
    let shape = dims.iter().fold(Message::default(), |m, &dim| {
        let one = if dim < 0 { Message::default().text(2, "any") } else { Message::default().int(1, dim) };
        m.message(1, &one)
    });
    typed(name, kind, &shape)
}

/// As [`value`], with unchanged dimensions, including negative ones.
pub fn literal_value(name: &str, kind: i64, dims: &[i64]) -> Message {
    let shape = dims.iter().fold(Message::default(), |m, &dim| m.message(1, &Message::default().int(1, dim)));
    typed(name, kind, &shape)
}

fn typed(name: &str, kind: i64, shape: &Message) -> Message {
    let tensor = Message::default().int(1, kind).message(2, shape);
    Message::default().text(1, name).message(2, &Message::default().message(1, &tensor))
}

/// A tensor of given type, dimensions and bytes.
pub fn tensor(name: &str, kind: i64, dims: &[i64], raw: &[u8]) -> Message {
    dims.iter().fold(Message::default(), |m, &d| m.int(1, d)).int(2, kind).text(8, name).bytes(9, raw)
}

pub fn floats(name: &str, dims: &[i64], value: f32) -> Message {
    let count = dims.iter().product::<i64>().max(0) as usize;
    tensor(name, FLOAT, dims, &value.to_le_bytes().repeat(count))
}

pub fn ints(name: &str, values: &[i64]) -> Message {
    let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    tensor(name, INT64, &[values.len() as i64], &raw)
}

/// A node: operator, inputs, outputs.
pub fn node(operator: &str, inputs: &[&str], outputs: &[&str]) -> Message {
    let with_inputs = inputs.iter().fold(Message::default(), |m, name| m.text(1, name));
    outputs.iter().fold(with_inputs, |m, name| m.text(2, name)).text(4, operator)
}

/// An attribute with a whole number.
pub fn int_attribute(name: &str, value: i64) -> Message {
    Message::default().text(1, name).int(3, value).int(20, 2)
}

/// An attribute with whole numbers.
pub fn ints_attribute(name: &str, values: &[i64]) -> Message {
    values.iter().fold(Message::default().text(1, name), |m, &v| m.int(8, v)).int(20, 7)
}

/// An attribute with a tensor.
pub fn tensor_attribute(name: &str, value: &Message) -> Message {
    Message::default().text(1, name).message(5, value).int(20, 4)
}

/// An attribute with a graph.
pub fn graph_attribute(name: &str, graph: &Message) -> Message {
    Message::default().text(1, name).message(6, graph).int(20, 5)
}

pub fn opset(domain: &str, version: i64) -> Message {
    Message::default().text(1, domain).int(2, version)
}

/// A model around a graph: format 8, opset 13.
pub fn model(graph: &Message) -> Message {
    Message::default().int(1, 8).message(7, graph).message(8, &opset("", 13))
}

/// Shape of the output of a detector of 80 classes on an image of 64 x 64 px.
pub const DETECTED: [i64; 3] = [1, 84, 84];
const PICTURE: [i64; 4] = [1, 3, 64, 64];

/// The parts of a detector's graph: nodes, initializers, inputs, outputs.
#[derive(Clone)]
pub struct Parts {
    pub nodes: Vec<Message>,
    pub tensors: Vec<Message>,
    pub inputs: Vec<Message>,
    pub outputs: Vec<Message>,
}

impl Parts {
    /// A detector that always outputs the tensor `held`.
    pub fn healthy() -> Self {
        Self {
            nodes: vec![node("Identity", &["held"], &["output0"])],
            tensors: vec![floats("held", &DETECTED, 0.0)],
            inputs: vec![value("images", FLOAT, &PICTURE)],
            outputs: vec![value("output0", FLOAT, &DETECTED)],
        }
    }

    pub fn graph(&self) -> Message {
        Message::default()
            .messages(1, &self.nodes)
            .text(2, "g")
            .messages(5, &self.tensors)
            .messages(11, &self.inputs)
            .messages(12, &self.outputs)
    }

    pub fn bytes(&self) -> Vec<u8> {
        model(&self.graph()).0
    }

    pub fn nodes(mut self, nodes: Vec<Message>) -> Self {
        self.nodes = nodes;
        self
    }

    pub fn tensors(mut self, tensors: Vec<Message>) -> Self {
        self.tensors = tensors;
        self
    }

    /// Inserts nodes before the last one; their results are added to the output so that no optimizer drops them.
    pub fn with(mut self, nodes: Vec<Message>, tensors: Vec<Message>, result: &str) -> Self {
        let mut all = nodes;
        all.push(node("ReduceSum", &[result], &["sum_of_all"]).message(5, &int_attribute("keepdims", 0)));
        all.push(node("Add", &["held", "sum_of_all"], &["output0"]));
        self.nodes = all;
        self.tensors.extend(tensors);
        self
    }
}
