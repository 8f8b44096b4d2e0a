//! Descriptors as a careless C author might write them: each error names the mistake and its location.

use std::ffi::c_void;
use std::ptr;

use panoscope_graph::from_abi::{FromAbiError, ParamSnapshot, node_types};
use panoscope_graph::{NodeType, ParamKind, ParamValue};
use panoscope_node::abi::{self, Str};

unsafe extern "C" fn open(_: *mut abi::OpenCall, _: *mut *mut c_void) -> abi::Status {
    abi::STATUS_OK
}
unsafe extern "C" fn process(_: *mut c_void, _: *mut abi::Call) -> abi::Status {
    abi::STATUS_OK
}
unsafe extern "C" fn close(_: *mut c_void) {}

const PORT: abi::Port = abi::Port {
    name: Str::new("image"),
    doc: Str::new("A picture."),
    packet: Str::new("image"),
    layout_hash: 0,
    formats: 1 << abi::FORMAT_BGR8,
    flags: 0,
};

const PARAM: abi::Param = abi::Param {
    name: Str::new("gain"),
    doc: Str::new("A factor."),
    unit: Str::new("ratio"),
    kind: abi::PARAM_INT,
    flags: 0,
    default_number: 1.0,
    min: 0.0,
    max: 8.0,
    step: 0.0,
    default_text: Str::EMPTY,
    choices: ptr::null(),
    choices_len: 0,
    default_floats: ptr::null(),
    default_floats_len: 0,
};

/// A plugin of one node type that a test modifies.
struct Parts {
    inputs: Vec<abi::Port>,
    outputs: Vec<abi::Port>,
    params: Vec<abi::Param>,
    node: abi::NodeType,
    plugin: abi::Plugin,
    /// Number of entries of the type in the list.
    times: usize,
}

fn parts() -> Parts {
    Parts {
        inputs: vec![PORT],
        outputs: vec![PORT],
        params: vec![PARAM],
        node: abi::NodeType {
            struct_size: size_of::<abi::NodeType>() as u32,
            kind: abi::KIND_COMPUTE,
            flags: 0,
            reserved: 0,
            name: Str::new("filter"),
            family: Str::new("filter"),
            doc: Str::new("A filter."),
            inputs: ptr::null(),
            inputs_len: 1,
            outputs: ptr::null(),
            outputs_len: 1,
            params: ptr::null(),
            params_len: 1,
            open: Some(open),
            process: Some(process),
            close: Some(close),
            save_state: None,
            load_state: None,
            validate: None,
            finish: None,
        },
        plugin: abi::Plugin {
            magic: abi::MAGIC,
            abi_major: abi::ABI_MAJOR,
            abi_minor: abi::ABI_MINOR,
            struct_size: size_of::<abi::Plugin>() as u32,
            reserved: 0,
            name: Str::new("demo"),
            version: Str::new("1"),
            doc: Str::EMPTY,
            node_types: ptr::null(),
            node_types_len: 0,
            note: ptr::null(),
            attach: None,
        },
        times: 1,
    }
}

fn read(spoil: impl FnOnce(&mut Parts)) -> Result<Vec<NodeType>, FromAbiError> {
    let mut parts = parts();
    // A test that sets a pointer itself leaves one that is not null.
    spoil(&mut parts);
    let (node, plugin) = (&mut parts.node, &mut parts.plugin);
    if node.inputs_len == 1 {
        (node.inputs, node.inputs_len) = (parts.inputs.as_ptr(), parts.inputs.len());
    }
    if node.outputs_len == 1 {
        (node.outputs, node.outputs_len) = (parts.outputs.as_ptr(), parts.outputs.len());
    }
    if node.params_len == 1 {
        (node.params, node.params_len) = (parts.params.as_ptr(), parts.params.len());
    }
    let list = vec![&raw const *node; parts.times];
    if plugin.node_types_len == 0 {
        (plugin.node_types, plugin.node_types_len) = (list.as_ptr(), list.len());
    }
    // SAFETY: pointers that are neither null nor misaligned point into `parts` and `list`.
    unsafe { node_types(plugin) }
}

fn says(spoil: impl FnOnce(&mut Parts)) -> String {
    read(spoil).err().map(|e| e.to_string()).unwrap_or_else(|| "nothing wrong".to_owned())
}

#[test]
fn a_good_descriptor_becomes_a_catalog_entry() {
    let types = read(|_| ()).expect("nothing wrong");
    assert_eq!((types[0].name.as_str(), types[0].plugin.as_str(), types.len()), ("filter", "demo", 1));
    assert_eq!(types[0].inputs[0].packet.formats, ["bgr8"]);
    assert_eq!(types[0].params[0].kind, ParamKind::Int { default: 1, min: Some(0), max: Some(8), step: None });
    let free = read(|p| {
        (p.params[0].kind, p.params[0].min, p.params[0].max) = (abi::PARAM_FLOAT, f64::NEG_INFINITY, f64::MAX);
    });
    let kind = free.expect("nothing wrong")[0].params[0].kind.clone();
    assert_eq!(kind, ParamKind::Float { default: 1.0, min: None, max: None, step: None });
}

#[test]
fn the_plugin_as_a_whole() {
    // SAFETY: null is allowed.
    assert_eq!(unsafe { node_types(ptr::null()) }, Err(FromAbiError::NoDescriptor));
    assert!(says(|p| p.plugin.magic = 7).contains("0x0000000000000007"));
    assert_eq!(
        says(|p| p.plugin.abi_major = 9),
        "the plugin was built for ABI 9, this host has ABI 1: rebuild the plugin"
    );
    assert!(says(|p| p.plugin.struct_size = 8).starts_with("the plugin's descriptor: struct_size is 8; it must be"));
    assert_eq!(says(|p| p.plugin.node_types_len = 2), "plugin `demo`: node_types is a null pointer, its length is 2");
    assert!(says(|p| p.plugin.node_types_len = 1 << 40).contains("more than the 1024 allowed"));
    assert_eq!(says(|p| p.times = 2), "plugin `demo`: node type `filter` is declared twice");
    let latin1 = Str { ptr: b"f\xfcr".as_ptr(), len: 3 };
    assert_eq!(says(|p| p.plugin.name = latin1), "the plugin's descriptor: name is not UTF-8 text");
    assert!(says(|p| p.plugin.name = Str::new("my plugin")).contains("`my plugin` is not a valid name"));
}

#[test]
fn node_types_one_by_one() {
    assert!(says(|p| p.node.struct_size = 0).starts_with("plugin `demo`, node type 1: struct_size is 0"));
    assert!(says(|p| p.node.name = Str::EMPTY).starts_with("plugin `demo`, node type 1: `` is not a valid name"));
    assert_eq!(
        says(|p| p.node.kind = 7),
        "plugin `demo`, node type `filter`: kind is 0x7, which this host does not know"
    );
    assert!(says(|p| p.node.flags = 64).contains("flags is 0x40"));
    assert!(says(|p| p.node.process = None).ends_with("the function `process` is missing"));
    assert!(says(|p| p.node.inputs_len = 3).contains("inputs is a null pointer, its length is 3"));
    assert!(says(|p| p.node.inputs_len = 0).contains("no inputs and is not marked as a source"));
    let misaligned = ptr::without_provenance(9);
    assert!(says(|p| (p.node.inputs, p.node.inputs_len) = (misaligned, 2)).contains("misaligned"));
}

#[test]
fn ports_one_by_one() {
    let twice = says(|p| p.inputs.push(PORT));
    assert_eq!(twice, "plugin `demo`, node type `filter`: input `image` is declared twice");
    assert!(says(|p| p.inputs[0].flags = 8).contains("flags is 0x8"));
    assert!(says(|p| p.outputs[0].flags = abi::PORT_OPTIONAL).contains("output `image`: flags is 0x1"));
    assert!(says(|p| p.inputs[0].formats = 0).contains("names its formats"));
    assert!(says(|p| p.inputs[0].formats = 1 << 20).contains("formats is 0x100000"));
    assert!(says(|p| p.inputs[0].packet = Str::new("mask")).contains("its formats do not fit a `mask` packet"));
    let any = |p: &mut Parts| (p.outputs[0].packet, p.outputs[0].formats) = (Str::new("any"), 0);
    assert!(says(any).contains("only inputs may take `any`"));
}

#[test]
fn params_one_by_one() {
    let param = |spoil: &dyn Fn(&mut abi::Param)| says(|p| spoil(&mut p.params[0]));
    let head = "plugin `demo`, node type `filter`, parameter `gain`: ";
    assert_eq!(param(&|p| p.kind = 99), format!("{head}kind is 0x63, which this host does not know"));
    assert_eq!(param(&|p| p.default_number = 9.0), format!("{head}the default 9 lies outside the range 0 to 8"));
    assert_eq!(param(&|p| p.default_number = f64::NAN), format!("{head}the default NaN lies outside the range 0 to 8"));
    assert_eq!(param(&|p| p.min = 9.0), format!("{head}the range 9 to 8 is empty"));
    assert_eq!(param(&|p| p.max = 1.5), format!("{head}1.5 is not a limit for a whole number"));
    assert!(param(&|p| p.default_number = 0.5).contains("must be whole numbers"));
    assert!(param(&|p| p.step = 2.0).contains("is not on the steps of 2 that begin at 0"));
    assert!(param(&|p| p.step = -1.0).contains("-1 is no step"));
    assert!(param(&|p| p.flags = abi::PARAM_MUST_EXIST).contains("only a path can be asked to exist"));
    assert!(param(&|p| p.flags = abi::PARAM_POINTS).contains("only a list of numbers can hold points"));
    assert!(param(&|p| p.flags = abi::PARAM_FILE).contains("only a text or a path can name a file"));
    assert!(param(&|p| p.flags = abi::PARAM_POINTS | abi::PARAM_RECTANGLES).contains("as points, as rectangles or as"));
    assert!(param(&|p| p.name = Str::new("two words")).contains("`two words` is not a valid name"));
    assert!(param(&|p| (p.kind, p.default_number) = (abi::PARAM_BOOL, 2.0)).contains("0 or 1, not 2"));
    assert!(param(&|p| p.kind = abi::PARAM_CHOICE).contains("the default is entry 1 of 0 choices"));
    static WORDS: [Str; 2] = [Str::new("same"), Str::new("same")];
    let words = |p: &mut abi::Param| (p.kind, p.choices, p.choices_len) = (abi::PARAM_CHOICE, WORDS.as_ptr(), 2);
    assert!(param(&words).contains("choice `same` is declared twice"));
    static NUMBERS: [f64; 2] = [0.0, f64::INFINITY];
    let list = |p: &mut abi::Param| {
        (p.kind, p.default_floats, p.default_floats_len) = (abi::PARAM_FLOATS, NUMBERS.as_ptr(), 2);
    };
    assert!(param(&list).contains("not finite"));
    assert!(param(&|p| (p.kind, p.min) = (abi::PARAM_FLOATS, 1.0)).contains("has 0 numbers; allowed: 1 to 8"));
    assert!(param(&|p| (p.kind, p.default_text.len) = (abi::PARAM_TEXT, 4)).contains("default_text is a null pointer"));
}

#[test]
fn values_cross_as_they_are() {
    let snapshot = ParamSnapshot::new(&[
        ParamValue::Bool(true),
        ParamValue::Int(-7),
        ParamValue::Float(0.5),
        ParamValue::Choice { index: 2, name: "third".into() },
        ParamValue::Text("wörds".into()),
        ParamValue::Path("/a/b".into()),
        ParamValue::Floats(vec![1.0, 2.0]),
    ]);
    let moved = snapshot;
    let v = moved.values();
    let kinds: Vec<u32> = v.iter().map(|v| v.kind).collect();
    assert_eq!(kinds, [1, 2, 3, 4, 5, 6, 7]);
    assert_eq!((v[0].int_value, v[1].int_value, v[2].float_value, v[3].index), (1, -7, 0.5, 2));
    // SAFETY: the snapshot is alive.
    let (texts, floats) = unsafe {
        let texts = [v[3].text.text(), v[4].text.text(), v[5].text.text()];
        (texts, std::slice::from_raw_parts(v[6].floats, v[6].floats_len))
    };
    assert_eq!(texts, [Some("third"), Some("wörds"), Some("/a/b")]);
    assert_eq!(floats, [1.0, 2.0]);
}
