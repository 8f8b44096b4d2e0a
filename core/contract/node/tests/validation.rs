//! A node's own check of its parameters: in a graph's check, in `open`, and when the check itself misbehaves.

use std::cell::Cell;
use std::path::Path;

use panoscope_graph::from_abi::{node_types, whole};
use panoscope_graph::{NodeSetup, NodeType, ParamProblem, ParamValue, Severity, Wiring};
use panoscope_node::abi::{self, Str};
use panoscope_node::export::NodeTypeOf;
use panoscope_node::harness::{Harness, HarnessError, Setup};
use panoscope_node::*;

type TestResult = std::result::Result<(), HarnessError>;

// The test checks only the wiring of these ports.
#[allow(dead_code)]
#[derive(Ports)]
struct In<'f> {
    /// Picture.
    image: Option<AnyImage<'f>>,
    /// Pictures.
    more: Option<List<'f, AnyImage<'f>>>,
}

#[allow(dead_code)]
#[derive(Ports)]
struct Out<'f> {
    /// Picture.
    image: Slot<'f, AnyFormat>,
}

#[derive(Params)]
struct Band {
    /// Low end.
    #[param(default = 1, range = 0..=10)]
    low: u32,
    /// High end.
    #[param(default = 5, range = 0..=10)]
    high: u32,
}

// Per thread, so that other tests do not change the count.
thread_local!(static OPENED: Cell<u32> = const { Cell::new(0) });

struct Careful;

impl Node for Careful {
    const INFO: NodeInfo = NodeInfo::compute("careful", "filter", "Checks its parameters.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Band;

    fn validate(params: &Band, check: &mut Validation<'_>) {
        if params.low > params.high {
            check.error("low", format!("`low` is {}, above `high`, which is {}", params.low, params.high), "swap them");
        }
        if params.high == 9 {
            check.warning("high", format!("{} of {:?} is high", check.node_id(), check.graph_dir().file_name()), "");
        }
        assert!(params.high != 10, "ten is too much");
        if check.is_connected("image") == Some(false) && check.is_read("image") == Some(true) {
            check.node_error("`image` is not connected", "connect it");
        }
        if check.connections("more") > Some(2) {
            check.node_error("more than two", "");
        }
    }

    fn open(_: &Open<'_>, _: &Band) -> Result<Self> {
        OPENED.set(OPENED.get() + 1);
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, _: In<'f>, _: Out<'f>, _: &Band) -> Result<()> {
        Ok(())
    }
}

fn problems(params: &str, connected: &[&str]) -> Vec<(Severity, Option<usize>, String)> {
    let setup = Setup::new(&format!("params = {{ {params} }}")).graph_dir("/films").node_id("band");
    let problems = Harness::<Careful>::problems(&setup, connected).expect("a good text");
    problems.into_iter().map(|p| (p.severity, p.param, p.message)).collect()
}

#[test]
fn parameters_and_wiring_are_judged_without_opening() {
    let before = OPENED.get();
    assert_eq!(problems("low = 5", &["image"]), []);
    let found = problems("low = 6", &["image"]);
    assert_eq!(found, [(Severity::Error, Some(0), "`low` is 6, above `high`, which is 5".to_owned())]);
    let found = problems("high = 9", &["image", "more", "more"]);
    assert_eq!(found, [(Severity::Warning, Some(1), "band of Some(\"films\") is high".to_owned())]);
    let found = problems("low = 6", &["more", "more", "more"]);
    let words: Vec<&str> = found.iter().map(|(_, _, words)| words.as_str()).collect();
    assert_eq!(words, ["`low` is 6, above `high`, which is 5", "`image` is not connected", "more than two"]);
    assert_eq!(OPENED.get(), before);
}

#[test]
fn a_check_that_panics_is_a_problem_and_no_crash() {
    let found = problems("high = 10", &["image"]);
    let [(Severity::Error, None, words)] = &found[..] else { panic!("{found:?}") };
    assert!(
        words.contains("panicked at core/contract/node/tests/validation.rs:") && words.ends_with("ten is too much"),
        "{words}"
    );
}

#[test]
fn open_refuses_what_the_check_refuses() -> TestResult {
    let error = Harness::<Careful>::from_toml("params = { low = 6 }").err().expect("refused").to_string();
    assert!(error.contains("`low` is 6, above `high`, which is 5; swap them"), "{error}");
    // `open` does not know the wiring, and a warning does not fail it.
    let before = OPENED.get();
    Harness::<Careful>::from_toml("params = { high = 9 }")?;
    assert_eq!(OPENED.get(), before + 1);
    Ok(())
}

fn described(node: *const abi::NodeType) -> NodeType {
    let list = [node];
    let plugin = abi::Plugin {
        magic: abi::MAGIC,
        abi_major: abi::ABI_MAJOR,
        abi_minor: abi::ABI_MINOR,
        struct_size: size_of::<abi::Plugin>() as u32,
        reserved: 0,
        name: Str::new("demo"),
        version: Str::new("1"),
        doc: Str::EMPTY,
        node_types: list.as_ptr(),
        node_types_len: 1,
        note: std::ptr::null(),
        attach: None,
    };
    // SAFETY: the descriptors are made by this crate's macros; their lengths are correct.
    unsafe { node_types(&plugin) }.expect("a good descriptor").remove(0)
}

fn ask(node_type: &NodeType) -> Option<Vec<ParamProblem>> {
    let wiring = Wiring { connections: vec![1, 0], outputs_read: 1 };
    let params = [ParamValue::Int(6), ParamValue::Int(5)];
    let setup =
        NodeSetup { node_id: "n", params: &params, graph_dir: Path::new(""), batch: true, wiring: Some(&wiring) };
    Some(node_type.validator.as_ref()?.problems(&setup))
}

#[test]
fn a_node_of_an_older_plugin_has_no_check() {
    // The size of the struct before `validate` was appended; the block ends right behind it.
    let size = std::mem::offset_of!(abi::NodeType, validate);
    let layout = std::alloc::Layout::from_size_align(size, align_of::<abi::NodeType>()).expect("a layout");
    let full = NodeTypeOf::<Careful>::NODE_TYPE;
    // SAFETY: `size` bytes are copied from a longer struct into a block of that size; fields past it are not touched.
    let old = unsafe {
        let old = std::alloc::alloc(layout).cast::<abi::NodeType>();
        std::ptr::copy_nonoverlapping((&raw const full).cast::<u8>(), old.cast(), size);
        (&raw mut (*old).struct_size).write(size as u32);
        old
    };
    let described = described(old);
    assert_eq!((described.name.as_str(), described.params.len()), ("careful", 2));
    assert!(described.validator.is_none());
    // SAFETY: accepted above, and never freed.
    let whole = unsafe { whole(old) };
    assert!(whole.validate.is_none() && whole.open.is_some() && whole.params_len == 2);
}

/// A check as a C plugin may have it: it reports invalid problems, and too many.
unsafe extern "C" fn wild(call: *mut abi::ValidateCall) -> abi::Status {
    // SAFETY: the host's call is valid for its length.
    unsafe {
        let call = &*call;
        let invalid = call.invalid.expect("a sink");
        let not_text = Str { ptr: b"\xff!".as_ptr(), len: 2 };
        invalid(call.call, 77, 9000, not_text, Str::EMPTY);
        for _ in 0..1000 {
            invalid(call.call, abi::PROBLEM_WARNING, 1, Str::new("again"), Str::new("stop"));
        }
    }
    abi::STATUS_OK
}

unsafe extern "C" fn mute(_: *mut abi::ValidateCall) -> abi::Status {
    abi::STATUS_INVALID
}

#[test]
fn a_wild_check_is_kept_within_bounds() {
    let with = |validate: unsafe extern "C" fn(*mut abi::ValidateCall) -> abi::Status| {
        let node = abi::NodeType { validate: Some(validate), ..NodeTypeOf::<Careful>::NODE_TYPE };
        ask(&described(&node)).expect("a check")
    };
    let found = with(wild);
    assert_eq!(found.len(), 64);
    assert_eq!((found[0].severity, found[0].param, found[0].message.as_str()), (Severity::Error, None, "\u{fffd}!"));
    assert_eq!((found[1].severity, found[1].param, found[1].help.as_str()), (Severity::Warning, Some(1), "stop"));
    let found = with(mute);
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].message, "the node refused its parameters without a message (status -4)");
}

#[test]
fn flags_of_paths_reach_the_catalog_and_contradictions_are_refused() {
    #[derive(Params)]
    #[allow(dead_code)]
    struct Files {
        /// Written.
        #[param(default = "out/a.png", writes)]
        out: std::path::PathBuf,
        /// Comes along.
        #[param(default = "models/a.onnx", must_exist, shipped)]
        model: std::path::PathBuf,
    }
    let flags: Vec<u32> = Files::PARAMS.iter().map(|p| p.flags).collect();
    assert_eq!(flags, [abi::PARAM_WRITES, abi::PARAM_MUST_EXIST | abi::PARAM_SHIPPED]);
    let node = abi::NodeType { params: Files::PARAMS.as_ptr(), params_len: 2, ..NodeTypeOf::<Careful>::NODE_TYPE };
    let params = described(&node).params;
    assert_eq!([params[0].writes, params[0].shipped], [true, false]);
    assert_eq!([params[1].writes, params[1].shipped], [false, true]);
}
