//! Bounds the work of opening a model, before ONNX Runtime sees the file.
//!
//! Some small files keep ONNX Runtime busy for minutes while it opens them: it sorts, inlines and folds what they
//! describe, and some of that is quadratic or exponential in the length of the file. The amounts can be counted in the
//! file.

use std::collections::HashMap;
use std::ops::Range;

use super::{MAX_DEPTH, Malformed, Reader};

/// Maximum number of nodes of a model, including nested graphs, with a function's nodes counted once per call.
/// Detectors have up to some thousand. ONNX Runtime needs time in proportion to the square of this.
pub const MAX_NODES: u64 = 10_000;
/// Values that may be computed from constants while the model is opened, in any model and for each byte of the file.
const MAX_COMPUTED: u64 = 16 << 20;
const COMPUTED_PER_BYTE: u64 = 4;
/// Maximum number of iterations of a loop that cannot end earlier.
pub const MAX_TURNS: i64 = 100_000;

/// A model that takes too much work to open.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TooMuch {
    /// Not a complete ONNX file.
    #[error(transparent)]
    Malformed(#[from] Malformed),
    /// Too many nodes.
    #[error("it has {} nodes, with those of its functions and nested graphs, but the limit is {MAX_NODES}", shown(*.nodes))]
    Nodes {
        /// Number of nodes; [`u64::MAX`] for more than can be counted.
        nodes: u64,
    },
    /// Folding its constants would compute too many values.
    #[error("opening it would compute {} values from its constants, but the limit for its size is {most}", shown(*.values))]
    Constants {
        /// Number of values; [`u64::MAX`] when it overflows.
        values: u64,
        /// Maximum number of values.
        most: u64,
    },
    /// A loop without an end.
    #[error("it has a loop of {} iterations, but the limit is {MAX_TURNS}", .turns.map_or("unlimited".to_owned(), |turns| turns.to_string()))]
    Endless {
        /// Iterations that the model states.
        turns: Option<i64>,
    },
}

fn shown(count: u64) -> String {
    if count == u64::MAX { "more than 10^19".to_owned() } else { count.to_string() }
}

/// Checks that the work of opening a model is in proportion to its size.
///
/// # Errors
/// The limit that the model exceeds.
pub fn check(model: &[u8]) -> Result<(), TooMuch> {
    let mut work = Work { reader: Reader::new(model), functions: HashMap::new(), nodes: 0, computed: 0 };
    let mut graphs = Vec::new();
    work.each(0..model.len(), |work, field, part| {
        match field {
            7 => graphs.push(part),
            25 => work.function(part)?,
            _ => {}
        }
        Ok(())
    })?;
    for graph in graphs {
        work.graph(graph, &mut Vec::new())?;
    }
    Ok(())
}

/// Cost of a call of a model's function.
struct Function<'a> {
    /// Its own nodes.
    nodes: u64,
    /// Operators of its nodes, which may be functions.
    calls: Vec<Operator<'a>>,
    /// Nodes including those of called functions; `None` until they are counted.
    whole: Option<u64>,
    /// Whether its nodes are being counted: a function met again during the count is recursive, which ONNX Runtime
    /// refuses.
    is_counted: bool,
}

/// Domain and name.
type Operator<'a> = (&'a [u8], &'a [u8]);

/// A value that is known before the model runs.
#[derive(Clone, Copy)]
struct Constant {
    values: u64,
    /// Value of a scalar integer or boolean.
    number: Option<i64>,
}

/// Constants of a graph by name.
type Scope<'a> = HashMap<&'a [u8], Constant>;

struct Work<'a> {
    reader: Reader<'a>,
    functions: HashMap<Operator<'a>, Function<'a>>,
    nodes: u64,
    computed: u64,
}

/// The fields of a node that the count needs.
#[derive(Default)]
struct Node<'a> {
    inputs: Vec<&'a [u8]>,
    outputs: Vec<&'a [u8]>,
    operator: Operator<'a>,
    attributes: Vec<Range<usize>>,
}

/// The fields of a graph that the count needs.
#[derive(Default)]
struct Graph<'a> {
    inputs: Vec<&'a [u8]>,
    outputs: Vec<&'a [u8]>,
    nodes: Vec<Range<usize>>,
    tensors: Vec<Range<usize>>,
}

type Done = Result<(), TooMuch>;

impl<'a> Work<'a> {
    /// Calls `take` with number and bytes of each length-delimited field.
    fn each(&mut self, range: Range<usize>, mut take: impl FnMut(&mut Self, u64, Range<usize>) -> Done) -> Done {
        let mut at = range.start;
        while at < range.end {
            let field = self.reader.field(&mut at, range.end)?;
            if let Some(bytes) = field.bytes {
                take(self, field.number, bytes)?;
            }
        }
        Ok(())
    }

    fn bytes(&self, range: Range<usize>) -> &'a [u8] {
        &self.reader.data[range]
    }

    /// The name in a field 1 of a message.
    fn name(&mut self, range: Range<usize>) -> Result<&'a [u8], TooMuch> {
        let mut name: &'a [u8] = b"";
        self.each(range, |work, field, part| {
            if field == 1 {
                name = work.bytes(part);
            }
            Ok(())
        })?;
        Ok(name)
    }

    fn node(&mut self, range: Range<usize>) -> Result<Node<'a>, TooMuch> {
        let mut node = Node::default();
        self.each(range, |work, field, part| {
            match field {
                1 => node.inputs.push(work.bytes(part)),
                2 => node.outputs.push(work.bytes(part)),
                4 => node.operator.1 = work.bytes(part),
                5 => node.attributes.push(part),
                7 => node.operator.0 = work.bytes(part),
                _ => {}
            }
            Ok(())
        })?;
        Ok(node)
    }

    fn function(&mut self, range: Range<usize>) -> Done {
        let (mut name, mut calls): (Operator<'a>, Vec<Operator<'a>>) = Default::default();
        self.each(range, |work, field, part| {
            match field {
                1 => name.1 = work.bytes(part),
                7 => calls.push(work.node(part)?.operator),
                10 => name.0 = work.bytes(part),
                _ => {}
            }
            Ok(())
        })?;
        let nodes = calls.len() as u64;
        self.functions.insert(name, Function { nodes, calls, whole: None, is_counted: false });
        Ok(())
    }

    /// Nodes that an operator stands for: those of the function, or one.
    fn nodes_of(&mut self, operator: Operator<'a>) -> u64 {
        // A list in place of recursion: functions may call each other in a chain as long as the file.
        let mut waiting = vec![operator];
        while let Some(&current) = waiting.last() {
            let Some(function) = self.functions.get_mut(&current).filter(|function| function.whole.is_none()) else {
                waiting.pop();
                continue;
            };
            let was_counted = std::mem::replace(&mut function.is_counted, true);
            let (nodes, calls) = (function.nodes, std::mem::take(&mut function.calls));
            let is_open = |call: &&Operator<'a>| {
                self.functions.get(*call).is_some_and(|called| called.whole.is_none() && !called.is_counted)
            };
            let before = waiting.len();
            if !was_counted {
                waiting.extend(calls.iter().filter(is_open));
            }
            let whole = (waiting.len() == before).then(|| {
                let called = calls.iter().filter_map(|call| self.functions.get(call)?.whole);
                called.fold(nodes, u64::saturating_add)
            });
            if let Some(function) = self.functions.get_mut(&current) {
                (function.calls, function.whole) = (calls, whole);
            }
        }
        self.functions.get(&operator).and_then(|function| function.whole).unwrap_or(0).saturating_add(1)
    }

    /// Counts a graph and those in it. `scopes` are the constants of the graphs around it.
    fn graph(&mut self, range: Range<usize>, scopes: &mut Vec<Scope<'a>>) -> Done {
        if scopes.len() > 4 * MAX_DEPTH {
            // `weight_files` refuses it, with the reason.
            return Ok(());
        }
        let graph = self.parts(range)?;
        let mut scope = Scope::new();
        for tensor in graph.tensors {
            let (name, constant) = self.tensor(tensor)?;
            scope.insert(name, constant);
        }
        scopes.push(scope);
        for node in graph.nodes {
            let node = self.node(node)?;
            self.nodes = self.nodes.saturating_add(self.nodes_of(node.operator));
            if self.nodes > MAX_NODES {
                return Err(TooMuch::Nodes { nodes: self.nodes });
            }
            self.run(&node, scopes)?;
        }
        scopes.pop();
        Ok(())
    }

    fn parts(&mut self, range: Range<usize>) -> Result<Graph<'a>, TooMuch> {
        let mut graph = Graph::default();
        self.each(range, |work, field, part| {
            match field {
                1 => graph.nodes.push(part),
                5 => graph.tensors.push(part),
                11 => graph.inputs.push(work.name(part)?),
                12 => graph.outputs.push(work.name(part)?),
                _ => {}
            }
            Ok(())
        })?;
        Ok(graph)
    }

    /// Name and size of a tensor.
    fn tensor(&mut self, range: Range<usize>) -> Result<(&'a [u8], Constant), TooMuch> {
        let (mut at, mut values, mut name, mut number): (_, u64, &'a [u8], _) = (range.start, 1, b"", None);
        let mut times = |dimension: u64| values = values.saturating_mul(dimension);
        while at < range.end {
            let field = self.reader.field(&mut at, range.end)?;
            match (field.number, field.bytes) {
                (1, None) => times(field.value),
                (1, Some(packed)) => {
                    let mut inside = packed.start;
                    while inside < packed.end {
                        times(self.reader.varint(&mut inside, packed.end)?);
                    }
                }
                (7, None) => number = Some(field.value as i64),
                (5 | 7, Some(packed)) => {
                    let mut inside = packed.start;
                    number = self.reader.varint(&mut inside, packed.end).ok().map(|value| value as i64);
                }
                (8, Some(bytes)) => name = self.bytes(bytes),
                (9, Some(bytes)) => {
                    let mut word = [0; 8];
                    let bytes = self.bytes(bytes);
                    if let Some(word) = word.get_mut(..bytes.len()) {
                        word.copy_from_slice(bytes);
                        number = Some(i64::from_le_bytes(word_of(word)));
                    }
                }
                _ => {}
            }
        }
        Ok((name, Constant { values, number: number.filter(|_| values == 1) }))
    }

    /// Counts one node: the values that it folds from constants, and the graphs in it.
    fn run(&mut self, node: &Node<'a>, scopes: &mut Vec<Scope<'a>>) -> Done {
        let mut tensors = Vec::new();
        for attribute in &node.attributes {
            let mut graphs = Vec::new();
            self.each(attribute.clone(), |work, field, part| {
                match field {
                    5 => tensors.push(work.tensor(part)?.1),
                    6 | 11 => graphs.push(part),
                    _ => {}
                }
                Ok(())
            })?;
            for graph in graphs {
                if node.operator.1 == b"Loop" {
                    self.check_end(node, graph.clone(), scopes)?;
                }
                self.graph(graph, scopes)?;
            }
        }
        let made = match (node.operator.1, tensors.first()) {
            (b"Constant", Some(constant)) => Some(*constant),
            (b"Constant" | b"Loop" | b"If" | b"Scan", _) => None,
            (operator, _) => {
                let inputs: Option<Vec<Constant>> =
                    node.inputs.iter().filter(|name| !name.is_empty()).map(|name| known(scopes, name)).collect();
                let inputs = inputs.filter(|inputs| !inputs.is_empty());
                inputs.map(|inputs| {
                    let sizes = inputs.iter().map(|input| input.values);
                    let values = match operator {
                        b"Concat" => sizes.fold(0, u64::saturating_add),
                        _ => sizes.fold(0, u64::max),
                    };
                    let number = inputs[0].number.filter(|_| operator == b"Identity");
                    Constant { values, number }
                })
            }
        };
        let (Some(made), Some(scope)) = (made, scopes.last_mut()) else { return Ok(()) };
        node.outputs.iter().for_each(|name| _ = scope.insert(name, made));
        self.computed = self.computed.saturating_add(made.values.saturating_mul(node.outputs.len() as u64));
        let most = MAX_COMPUTED.saturating_add(COMPUTED_PER_BYTE.saturating_mul(self.reader.data.len() as u64));
        if self.computed > most {
            return Err(TooMuch::Constants { values: self.computed, most });
        }
        Ok(())
    }

    /// Refuses a loop of many iterations whose condition stays true because its body passes it through.
    fn check_end(&mut self, node: &Node<'a>, body: Range<usize>, scopes: &[Scope<'a>]) -> Done {
        let given = |index: usize| node.inputs.get(index).filter(|name| !name.is_empty());
        let turns = match given(0).map(|name| known(scopes, name).and_then(|constant| constant.number)) {
            Some(Some(turns)) if turns > MAX_TURNS => Some(turns),
            None => None,
            Some(_) => return Ok(()),
        };
        let is_true = |constant: Constant| constant.number.is_some_and(|number| number != 0);
        if given(1).is_some_and(|name| !known(scopes, name).is_some_and(is_true)) {
            return Ok(());
        }
        let graph = self.parts(body)?;
        let mut inside = Scope::new();
        for tensor in graph.tensors {
            let (name, constant) = self.tensor(tensor)?;
            inside.insert(name, constant);
        }
        let mut passes_on = HashMap::new();
        for node in graph.nodes {
            let node = self.node(node)?;
            if let (b"Identity", [from], [to]) = (node.operator.1, &node.inputs[..], &node.outputs[..]) {
                passes_on.insert(*to, *from);
            }
        }
        let Some(mut goes_on) = graph.outputs.first().copied() else { return Ok(()) };
        for _ in 0..passes_on.len() {
            goes_on = passes_on.get(goes_on).copied().unwrap_or(goes_on);
        }
        let stays = graph.inputs.get(1) == Some(&goes_on)
            || inside.get(goes_on).copied().or_else(|| known(scopes, goes_on)).is_some_and(is_true);
        if stays { Err(TooMuch::Endless { turns }) } else { Ok(()) }
    }
}

/// Up to eight bytes, zero-padded.
fn word_of(bytes: &[u8]) -> [u8; 8] {
    let mut word = [0; 8];
    word[..bytes.len()].copy_from_slice(bytes);
    word
}

/// The constant called `name` in the innermost graph that has one.
fn known(scopes: &[Scope<'_>], name: &[u8]) -> Option<Constant> {
    scopes.iter().rev().find_map(|scope| scope.get(name)).copied()
}

#[cfg(test)]
mod tests {
    use super::super::push_varint;
    use super::super::tests::field;
    use super::*;

    fn number(field: u64, value: u64) -> Vec<u8> {
        let mut out = Vec::new();
        push_varint(&mut out, field << 3);
        push_varint(&mut out, value);
        out
    }

    fn node(operator: &str, domain: &str, inputs: &[&str], outputs: &[&str]) -> Vec<u8> {
        let texts = |number, texts: &[&str]| texts.iter().flat_map(|text| field(number, text.as_bytes())).collect();
        let (inputs, outputs): (Vec<u8>, Vec<u8>) = (texts(1, inputs), texts(2, outputs));
        [inputs, outputs, field(4, operator.as_bytes()), field(7, domain.as_bytes())].concat()
    }

    fn model(nodes: &[Vec<u8>], tensors: &[Vec<u8>], functions: &[Vec<u8>]) -> Vec<u8> {
        let all = |number, parts: &[Vec<u8>]| parts.iter().flat_map(|part| field(number, part)).collect::<Vec<u8>>();
        [field(7, &[all(1, nodes), all(5, tensors)].concat()), all(25, functions)].concat()
    }

    fn tensor(name: &str, dims: &[u64], raw: &[u8]) -> Vec<u8> {
        let dims: Vec<u8> = dims.iter().flat_map(|dim| number(1, *dim)).collect();
        [dims, field(8, name.as_bytes()), field(9, raw)].concat()
    }

    fn function(name: &str, calls: &[&str]) -> Vec<u8> {
        let nodes: Vec<u8> = calls.iter().flat_map(|call| field(7, &node(call, "own", &["x"], &["y"]))).collect();
        [field(1, name.as_bytes()), nodes, field(10, b"own")].concat()
    }

    fn nodes(result: Result<(), TooMuch>) -> u64 {
        match result {
            Err(TooMuch::Nodes { nodes }) => nodes,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn nodes_are_counted_through_graphs_and_functions() {
        let plain = |count: u64| vec![node("Add", "", &["a", "b"], &["c"]); count as usize];
        assert_eq!(check(&model(&plain(MAX_NODES), &[], &[])), Ok(()));
        assert_eq!(nodes(check(&model(&plain(MAX_NODES + 1), &[], &[]))), MAX_NODES + 1);
        let nested = |count: u64| {
            let graph: Vec<u8> = plain(count).iter().flat_map(|node| field(1, node)).collect();
            let branches = [field(5, &field(6, &graph)), field(5, &field(11, &graph))].concat();
            model(&[[node("If", "", &["c"], &["d"]), branches].concat()], &[], &[])
        };
        assert_eq!(check(&nested(MAX_NODES / 2 - 1)), Ok(()));
        assert!(nodes(check(&nested(MAX_NODES / 2))) > MAX_NODES);
        // Each function calls the next twice.
        let doubling = |depth: usize| {
            let names: Vec<String> = (0..=depth).map(|k| format!("F{k}")).collect();
            let functions: Vec<_> = (0..depth).map(|k| function(&names[k], &[names[k + 1].as_str(); 2])).collect();
            model(&[node("F0", "own", &["x"], &["y"])], &[], &functions)
        };
        assert_eq!(check(&doubling(12)), Ok(()));
        assert_eq!(nodes(check(&doubling(40))), (1 << 41) - 1);
        assert_eq!(nodes(check(&doubling(100))), u64::MAX);
        // Of functions that call each other there is no end, which ONNX Runtime says itself.
        let circle = [function("F0", &["F1"]), function("F1", &["F0", "F1"])];
        assert_eq!(check(&model(&[node("F0", "own", &[], &[])], &[], &circle)), Ok(()));
    }

    #[test]
    fn constants_that_grow_are_refused() {
        let doubling = |times: usize| {
            let name = |k: usize| format!("c{k}");
            let nodes: Vec<_> =
                (0..times).map(|k| node("Concat", "", &[&name(k), &name(k)], &[&name(k + 1)])).collect();
            model(&nodes, &[tensor("c0", &[1], &[0; 4])], &[])
        };
        assert_eq!(check(&doubling(23)), Ok(()));
        assert!(matches!(check(&doubling(30)), Err(TooMuch::Constants { values, .. }) if values > MAX_COMPUTED));
        assert!(check(&doubling(80)).is_err(), "no overflow");
        // What is computed from a picture is no constant.
        let nodes: Vec<_> = (0..60).map(|_| node("Concat", "", &["x", "x"], &["x"])).collect();
        assert_eq!(check(&model(&nodes, &[], &[])), Ok(()));
    }

    #[test]
    fn a_loop_that_nothing_ends_is_refused() {
        let looped = |turns: i64, start: u8, from: &str| {
            let value = |field_number: u64, name: &str| field(field_number, &field(1, name.as_bytes()));
            let body = [
                field(1, &node("Identity", "", &[from], &["between"])),
                field(1, &node("Identity", "", &["between"], &["go_on"])),
                value(11, "turn"),
                value(11, "go"),
                value(12, "go_on"),
            ];
            let attribute = field(5, &[field(1, b"body"), field(6, &body.concat())].concat());
            let tensors = [tensor("count", &[], &turns.to_le_bytes()), tensor("yes", &[1], &[start])];
            model(&[[node("Loop", "", &["count", "yes"], &["y"]), attribute].concat()], &tensors, &[])
        };
        assert_eq!(check(&looped(i64::MAX, 1, "go")), Err(TooMuch::Endless { turns: Some(i64::MAX) }));
        assert_eq!(check(&looped(i64::MAX, 1, "yes")), Err(TooMuch::Endless { turns: Some(i64::MAX) }));
        assert_eq!(check(&looped(i64::MAX, 1, "computed")), Ok(()), "something may end it");
        assert_eq!(check(&looped(i64::MAX, 0, "go")), Ok(()), "it does not begin");
        assert_eq!(check(&looped(MAX_TURNS, 1, "go")), Ok(()));
    }

    #[test]
    fn damaged_files_are_errors() {
        let whole = model(&[node("Add", "", &["a"], &["b"])], &[tensor("c", &[3], &[0; 12])], &[function("F", &["G"])]);
        assert_eq!(check(&whole), Ok(()));
        for cut in 1..whole.len() {
            let _ = check(&whole[..cut]);
        }
        assert!(matches!(check(&[0x3a, 0x7f]), Err(TooMuch::Malformed(_))));
    }
}
