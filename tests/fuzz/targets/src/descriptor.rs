//! Descriptors of plugins: structures in memory, built from the bytes. Pointers are null, misaligned or valid for their length, as the contract
//! requires.

use std::ffi::c_void;

use panoscope_abi as abi;
use panoscope_graph::from_abi;

use crate::draw::Draw;

unsafe extern "C" fn open(_: *mut abi::OpenCall, _: *mut *mut c_void) -> abi::Status {
    abi::STATUS_INVALID
}

unsafe extern "C" fn process(_: *mut c_void, _: *mut abi::Call) -> abi::Status {
    abi::STATUS_INVALID
}

unsafe extern "C" fn close(_: *mut c_void) {}

/// A text from the bytes; sometimes with an invalid pointer or length.
fn text(draw: &mut Draw<'_>) -> abi::Str {
    match draw.u8() {
        250 => abi::Str { ptr: std::ptr::null(), len: 3 },
        251 => abi::Str { ptr: draw.0.as_ptr(), len: usize::MAX },
        252 => abi::Str::EMPTY,
        _ => {
            let bytes = draw.bytes(40);
            abi::Str { ptr: bytes.as_ptr(), len: bytes.len() }
        }
    }
}

/// A pointer and a length for a list.
fn list<T>(draw: &mut Draw<'_>, items: &[T]) -> (*const T, usize) {
    match draw.u8() {
        250 => (std::ptr::null(), 2),
        251 => (items.as_ptr(), usize::MAX),
        252 => (items.as_ptr().cast::<u8>().wrapping_add(1).cast(), 1),
        253 => (std::ptr::null(), 0),
        _ => (items.as_ptr(), items.len()),
    }
}

/// A set of flags that is often valid.
fn flags(draw: &mut Draw<'_>) -> u32 {
    match draw.u8() {
        255 => draw.u32(),
        small => u32::from(small),
    }
}

fn number(draw: &mut Draw<'_>) -> f64 {
    match draw.u8() {
        255 => draw.f64(),
        254 => f64::INFINITY,
        253 => f64::NEG_INFINITY,
        252 => 1e16,
        small => f64::from(small) - 100.0,
    }
}

fn port(draw: &mut Draw<'_>) -> abi::Port {
    const PACKETS: [&str; 8] = ["image", "mask", "disparity", "cloud", "any", "table", "own", "tip"];
    let name = text(draw);
    let packet = match draw.u8() {
        255 => text(draw),
        index => abi::Str::new(PACKETS[usize::from(index) % PACKETS.len()]),
    };
    abi::Port { name, doc: text(draw), packet, layout_hash: draw.u64(), formats: flags(draw), flags: flags(draw) }
}

pub fn run(bytes: &[u8]) {
    let mut draw = Draw(bytes);
    let draw = &mut draw;
    let choices: Vec<abi::Str> = (0..draw.u8() % 5).map(|_| text(draw)).collect();
    let floats: Vec<f64> = (0..draw.u8() % 5).map(|_| number(draw)).collect();
    let inputs: Vec<abi::Port> = (0..draw.u8() % 4).map(|_| port(draw)).collect();
    let outputs: Vec<abi::Port> = (0..draw.u8() % 4).map(|_| port(draw)).collect();
    let params: Vec<abi::Param> = (0..draw.u8() % 5)
        .map(|_| {
            let (choices, choices_len) = list(draw, &choices);
            let (default_floats, default_floats_len) = list(draw, &floats);
            abi::Param {
                name: text(draw),
                doc: text(draw),
                unit: text(draw),
                kind: flags(draw) % 10,
                flags: flags(draw),
                default_number: number(draw),
                min: number(draw),
                max: number(draw),
                step: number(draw),
                default_text: text(draw),
                choices,
                choices_len,
                default_floats,
                default_floats_len,
            }
        })
        .collect();
    let nodes: Vec<abi::NodeType> = (0..draw.u8() % 3)
        .map(|_| {
            let has = draw.u8();
            let (inputs, inputs_len) = list(draw, &inputs);
            let (outputs, outputs_len) = list(draw, &outputs);
            let (params, params_len) = list(draw, &params);
            // SAFETY: null pointers, absent functions and zeros are values of all fields.
            let blank: abi::NodeType = unsafe { std::mem::zeroed() };
            abi::NodeType {
                // A smaller size is that of an older plugin; a larger one would promise memory that is not there.
                struct_size: match draw.u8() {
                    255 => draw.u32() % (size_of::<abi::NodeType>() as u32 + 1),
                    254 => abi::NodeType::FIRST_SIZE as u32,
                    _ => size_of::<abi::NodeType>() as u32,
                },
                kind: flags(draw) % 5,
                flags: flags(draw),
                name: text(draw),
                family: text(draw),
                doc: text(draw),
                inputs,
                inputs_len,
                outputs,
                outputs_len,
                params,
                params_len,
                open: (has & 1 == 0).then_some(open),
                process: (has & 2 == 0).then_some(process),
                close: (has & 4 == 0).then_some(close),
                ..blank
            }
        })
        .collect();
    let mut pointers: Vec<*const abi::NodeType> = nodes.iter().map(std::ptr::from_ref).collect();
    if draw.u8() == 255 {
        pointers.push(std::ptr::null());
    }
    let (node_types, node_types_len) = list(draw, &pointers);
    // SAFETY: as for the node types.
    let blank: abi::Plugin = unsafe { std::mem::zeroed() };
    let plugin = abi::Plugin {
        magic: if draw.u8() == 255 { draw.u64() } else { abi::MAGIC },
        abi_major: if draw.u8() == 255 { draw.u32() } else { abi::ABI_MAJOR },
        abi_minor: abi::ABI_MINOR,
        struct_size: if draw.u8() == 255 { draw.u32() } else { size_of::<abi::Plugin>() as u32 },
        name: text(draw),
        version: text(draw),
        doc: text(draw),
        node_types,
        node_types_len,
        ..blank
    };
    // SAFETY: every pointer is null, misaligned, or points to memory above that lives until the end of this function. Lengths beyond that memory are
    // beyond the limits of the reader, which refuses them before it follows the pointer.
    let found = unsafe { from_abi::node_types(&raw const plugin) };
    match found {
        Ok(types) => {
            assert_eq!(types.len(), node_types_len);
            for found in &types {
                assert!(!found.name.is_empty() && (found.source || !found.inputs.is_empty()));
                let mut names: Vec<&str> = found.params.iter().map(|param| param.name.as_str()).collect();
                names.sort_unstable();
                assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "{names:?}");
                let json = serde_json::to_string(found).expect("a node type is JSON");
                let back: panoscope_graph::NodeType = serde_json::from_str(&json).expect("its own JSON");
                assert_eq!(serde_json::to_string(&back).expect("a node type is JSON"), json);
            }
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Bytes from which [`text`] draws this text.
fn seed_text(text: &str) -> Vec<u8> {
    [&[0, text.len() as u8], text.as_bytes()].concat()
}

/// Bytes from which [`port`] draws this port; `packet` is an index into its list.
fn seed_port(name: &str, packet: u8, formats: u8, flags: u8) -> Vec<u8> {
    [&seed_text(name)[..], &[packet], &seed_text("A port."), &[0; 8], &[formats, flags]].concat()
}

/// Bytes from which [`run`] draws a parameter, with unchanged lists. Each number is a byte minus 100.
fn seed_param(name: &str, kind: u8, flags: u8, numbers: [u8; 4], text: &str) -> Vec<u8> {
    let texts = [seed_text(name), seed_text("A parameter."), seed_text("px")].concat();
    [&[0, 0], &texts[..], &[kind, flags], &numbers, &seed_text(text)].concat()
}

/// A plugin with one node.
struct Seed {
    choices: Vec<&'static str>,
    /// Numbers of a parameter.
    floats: Vec<u8>,
    inputs: Vec<Vec<u8>>,
    outputs: Vec<Vec<u8>>,
    params: Vec<Vec<u8>>,
    /// Bits of missing functions; changes to the lists of inputs, outputs and parameters; struct size, kind, flags.
    node: [u8; 7],
    name: &'static str,
    /// A null pointer among the node types; changes to their list; magic, version and size are valid if 0.
    plugin: [u8; 5],
    plugin_name: &'static str,
}

impl Seed {
    fn plain() -> Self {
        Self {
            choices: vec!["near", "far"],
            floats: vec![101, 102],
            inputs: vec![seed_port("input", 0, 2, 0)],
            outputs: vec![seed_port("output", 0, 6, 0), seed_port("depth", 2, 0, 0)],
            params: Vec::new(),
            node: [0; 7],
            name: "blur",
            plugin: [0; 5],
            plugin_name: "filters",
        }
    }

    fn with(change: impl FnOnce(&mut Self)) -> Vec<u8> {
        let mut seed = Self::plain();
        change(&mut seed);
        seed.bytes()
    }

    fn param(param: Vec<u8>) -> Vec<u8> {
        Self::with(|seed| seed.params = vec![param])
    }

    fn bytes(&self) -> Vec<u8> {
        let list = |items: &[Vec<u8>]| [&[items.len() as u8], &items.concat()[..]].concat();
        let choices: Vec<Vec<u8>> = self.choices.iter().map(|choice| seed_text(choice)).collect();
        let floats: Vec<Vec<u8>> = self.floats.iter().map(|value| vec![*value]).collect();
        let node = [&[1][..], &self.node, &seed_text(self.name), &seed_text("filter"), &seed_text("Blurs.")].concat();
        let lists =
            [list(&choices), list(&floats), list(&self.inputs), list(&self.outputs), list(&self.params)].concat();
        let plugin = [seed_text(self.plugin_name), seed_text("0.1"), seed_text("Filters.")].concat();
        [&lists[..], &node, &self.plugin, &plugin].concat()
    }
}

pub fn seeds() -> Vec<Vec<u8>> {
    let [boolean, int, float, choice, text, path, floats] = [
        abi::PARAM_BOOL,
        abi::PARAM_INT,
        abi::PARAM_FLOAT,
        abi::PARAM_CHOICE,
        abi::PARAM_TEXT,
        abi::PARAM_PATH,
        abi::PARAM_FLOATS,
    ]
    .map(|kind| kind as u8);
    let [exists, points, rectangles, file, writes, shipped] = [
        abi::PARAM_MUST_EXIST,
        abi::PARAM_POINTS,
        abi::PARAM_RECTANGLES,
        abi::PARAM_FILE,
        abi::PARAM_WRITES,
        abi::PARAM_SHIPPED,
    ]
    .map(|flag| flag as u8);
    let range = [105, 100, 110, 101];
    let endless = [105, 253, 254, 100];
    let mut all = vec![Seed::plain().bytes()];
    // Parameters: kind, flags, default, least, most, step.
    let params: [(u8, u8, [u8; 4]); 34] = [
        (boolean, 1, [101, 100, 100, 100]),
        (boolean, 0, [102, 100, 100, 100]),
        (int, 0, range),
        (int, 0, endless),
        (int, 0, [105, 100, 110, 102]),
        (int, 0, [104, 100, 110, 102]),
        (int, 0, [252, 100, 254, 100]),
        (int, 0, [120, 100, 110, 101]),
        (int, 0, [105, 110, 100, 101]),
        (int, 0, [105, 100, 110, 254]),
        (int, 0, [105, 100, 110, 99]),
        (int, 0, [105, 252, 110, 100]),
        (float, 0, range),
        (float, 0, endless),
        (float, 0, [254, 253, 254, 100]),
        (choice, 0, [101, 100, 100, 100]),
        (choice, 0, [109, 100, 100, 100]),
        (text, file, range),
        (text, points, range),
        (text, exists, range),
        (path, exists, range),
        (path, file, range),
        (path, writes, range),
        (path, writes | exists, range),
        (path, shipped | 1, range),
        (floats, points, [100, 100, 110, 100]),
        (floats, rectangles, [100, 101, 254, 100]),
        (floats, points | rectangles, range),
        (floats, file, range),
        (floats, 0, [100, 103, 110, 100]),
        (int, writes, range),
        (int, shipped, range),
        (8, 0, range),
        (int, 128, range),
    ];
    all.extend(
        params.iter().map(|(kind, flags, numbers)| Seed::param(seed_param("size", *kind, *flags, *numbers, "a"))),
    );
    // Numbers in full: a default, a limit and a step that are no whole numbers, and NaN.
    for value in [0.5, f64::NAN] {
        for at in 0..4 {
            let mut numbers: Vec<Vec<u8>> = range.iter().map(|byte| vec![*byte]).collect();
            numbers[at] = [&[255][..], &f64::to_le_bytes(value)].concat();
            for kind in [int, float] {
                let texts = [seed_text("size"), seed_text(""), seed_text("")].concat();
                all.push(Seed::param([&[0, 0], &texts[..], &[kind, 0], &numbers.concat(), &seed_text("")].concat()));
            }
        }
    }
    let param = |name: &str| seed_param(name, int, 0, range, "");
    all.push(Seed::with(|seed| seed.params = vec![param("a"), param("a")]));
    all.push(Seed::with(|seed| seed.params = vec![param("a"), param("b"), param("9")]));
    for choices in [vec!["a", "a"], vec![""], vec!["a\n"], vec![]] {
        all.push(Seed::with(|seed| {
            (seed.choices, seed.params) = (choices, vec![seed_param("side", choice, 0, [100, 100, 100, 100], "")]);
        }));
    }
    all.push(Seed::with(|seed| {
        (seed.floats, seed.params) = (vec![254], vec![seed_param("points", floats, 0, [100, 100, 110, 100], "")]);
    }));
    // Lists of a parameter that are null, misaligned or too long.
    for (choices, values) in [(250, 0), (251, 0), (252, 0), (253, 0), (0, 250), (0, 251), (0, 252), (0, 253)] {
        let kind = if choices == 0 { floats } else { choice };
        let mut changed = seed_param("side", kind, 0, [100, 100, 110, 100], "");
        (changed[0], changed[1]) = (choices, values);
        all.push(Seed::param(changed));
    }
    // Ports.
    let ports = [
        seed_port("a", 0, 0, 0),
        seed_port("a", 0, 128, 0),
        seed_port("a", 1, 4, 0),
        seed_port("a", 1, 2, 1),
        seed_port("a", 3, 0, 2),
        seed_port("a", 4, 0, 3),
        seed_port("a", 5, 0, 4),
        seed_port("a b", 0, 2, 0),
        seed_port("", 6, 0, 0),
        [&seed_text("a")[..], &[255], &seed_text("own packet"), &seed_text(""), &[0; 8], &[0, 0]].concat(),
        [&seed_text("a")[..], &[255], &seed_text("own"), &[250], &[0; 8], &[0, 0]].concat(),
        [&seed_text("a")[..], &[255], &seed_text("own"), &[251], &[0; 8], &[0, 0]].concat(),
        [&seed_text("a")[..], &[255], &seed_text("own"), &[0, 2, 0xff, 0xfe], &[0; 8], &[0, 0]].concat(),
    ];
    for port in ports {
        all.push(Seed::with(|seed| seed.inputs = vec![port.clone()]));
        all.push(Seed::with(|seed| seed.outputs = vec![port]));
    }
    all.push(Seed::with(|seed| seed.inputs = vec![seed_port("a", 0, 2, 0); 2]));
    all.push(Seed::with(|seed| seed.inputs.clear()));
    all.push(Seed::with(|seed| (seed.inputs, seed.node) = (Vec::new(), [0, 0, 0, 0, 0, 0, 1])));
    // Nodes and plugins.
    let nodes: [[u8; 7]; 15] = [
        [1, 0, 0, 0, 0, 0, 0],
        [2, 0, 0, 0, 0, 0, 0],
        [4, 0, 0, 0, 0, 0, 0],
        [0, 250, 0, 0, 0, 0, 0],
        [0, 251, 0, 0, 0, 0, 0],
        [0, 252, 0, 0, 0, 0, 0],
        [0, 0, 253, 0, 0, 0, 0],
        [0, 0, 251, 0, 0, 0, 0],
        [0, 0, 0, 252, 0, 0, 0],
        [0, 0, 0, 0, 254, 1, 0],
        [0, 0, 0, 0, 0, 2, 6],
        [0, 0, 0, 0, 0, 3, 0],
        [0, 0, 0, 0, 0, 0, 8],
        [0, 0, 0, 251, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 7],
    ];
    all.extend(nodes.iter().map(|node| Seed::with(|seed| seed.node = *node)));
    all.push(Seed::with(|seed| seed.name = "no name"));
    all.push(Seed::with(|seed| seed.plugin_name = "9"));
    all.push(Seed::with(|seed| seed.plugin_name = "two-words"));
    for plugin in [[255, 0, 0, 0, 0], [0, 250, 0, 0, 0], [0, 251, 0, 0, 0], [0, 252, 0, 0, 0], [0, 253, 0, 0, 0]] {
        all.push(Seed::with(|seed| seed.plugin = plugin));
    }
    let whole = Seed::plain().bytes();
    // Sizes and numbers in full: the bytes behind the 255 are the number.
    let at = whole.len() - seed_text("filters").len() - seed_text("0.1").len() - seed_text("Filters.").len();
    for (place, number) in [(3, &[9u8; 8][..]), (2, &[9; 4]), (1, &[9, 0, 0, 0])] {
        all.push([&whole[..at - place], &[255], number, &whole[at - place + 1..]].concat());
    }
    all.extend([vec![0; 40], vec![255; 60], (0..=255).collect()]);
    all
}
