//! Every function of the harness's host, called as a C plugin would, correctly and incorrectly.

use std::cell::Cell;
use std::ffi::c_void;
use std::ptr;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

use panoscope_node::abi::{self, Frame, Str};
use panoscope_node::harness::{Foreign, Harness, HarnessError, Level, Setup};
use panoscope_node::{Bgr8, Gray8};

type Script = fn(&mut abi::Call, &abi::Host) -> abi::Status;

thread_local! {
    /// What the node does in its next call.
    static SCRIPT: Cell<Script> = const { Cell::new(|_, _| abi::STATUS_OK) };
    static KEPT: Cell<Option<Frame>> = const { Cell::new(None) };
}

unsafe extern "C" fn open(call: *mut abi::OpenCall, _: *mut *mut c_void) -> abi::Status {
    // SAFETY: the harness passes a call and a host table that live until this function returns.
    let (call, host) = unsafe { (&*call, &*(*call).host) };
    // SAFETY: the host function takes the handle of the call being served.
    unsafe { host.alloc.expect("alloc")(call.call, 0, abi::FORMAT_BYTES, 0, 0, 0, 1) }
}

unsafe extern "C" fn open_well(_: *mut abi::OpenCall, _: *mut *mut c_void) -> abi::Status {
    abi::STATUS_OK
}

unsafe extern "C" fn process(_: *mut c_void, call: *mut abi::Call) -> abi::Status {
    // SAFETY: the harness passes a call and a host table that live until this function returns.
    let (call, host) = unsafe { (&mut *call, &*(*call).host) };
    SCRIPT.get()(call, host)
}

unsafe extern "C" fn close(_: *mut c_void) {}

const fn port(name: &'static str, packet: &'static str, formats: u32, flags: u32) -> abi::Port {
    let (name, packet) = (Str::new(name), Str::new(packet));
    abi::Port { name, doc: Str::EMPTY, packet, layout_hash: 0, formats, flags }
}

static INPUTS: [abi::Port; 1] = [port("image", "image", 1 << abi::FORMAT_BGR8, abi::PORT_OPTIONAL)];
static OUTPUTS: [abi::Port; 2] = [port("gray", "image", 1 << abi::FORMAT_GRAY8, 0), port("note", "text", 0, 0)];

const NODE: abi::NodeType = abi::NodeType {
    struct_size: size_of::<abi::NodeType>() as u32,
    kind: abi::KIND_COMPUTE,
    flags: 0,
    reserved: 0,
    name: Str::new("script"),
    family: Str::EMPTY,
    doc: Str::EMPTY,
    inputs: &raw const INPUTS as *const abi::Port,
    inputs_len: 1,
    outputs: &raw const OUTPUTS as *const abi::Port,
    outputs_len: 2,
    params: ptr::null(),
    params_len: 0,
    open: Some(open_well),
    process: Some(process),
    close: Some(close),
    save_state: None,
    load_state: None,
    validate: None,
    finish: None,
};
static SCRIPTED: abi::NodeType = NODE;
static GREEDY: abi::NodeType = abi::NodeType { name: Str::new("greedy"), open: Some(open), ..NODE };

struct Types([*const abi::NodeType; 2]);
// SAFETY: pointers to statics.
unsafe impl Sync for Types {}
static TYPES: Types = Types([&raw const SCRIPTED, &raw const GREEDY]);
static PLUGIN: abi::Plugin = abi::Plugin {
    magic: abi::MAGIC,
    abi_major: abi::ABI_MAJOR,
    abi_minor: abi::ABI_MINOR,
    struct_size: size_of::<abi::Plugin>() as u32,
    reserved: 0,
    name: Str::new("scripts"),
    version: Str::EMPTY,
    doc: Str::EMPTY,
    node_types: &raw const TYPES.0 as *const *const abi::NodeType,
    node_types_len: 2,
    note: ptr::null(),
    attach: None,
};

fn node(setup: Setup) -> Harness<Foreign> {
    // SAFETY: the descriptor above.
    unsafe { Harness::of_plugin(&PLUGIN, "script", setup) }.expect("opens")
}

/// Runs one script on a fresh node with a 2x1 input.
fn run(script: Script) -> Result<(), String> {
    SCRIPT.set(script);
    let mut node = node(Setup::default());
    let result = node.input_image::<Bgr8>("image", 2, 1, &[1, 2, 3, 4, 5, 6]).process();
    result.map(|_| ()).map_err(|e| e.to_string())
}

fn alloc(call: &abi::Call, output: u32, format: u32, size: (u32, u32), stride: u32, len: usize) -> abi::Status {
    // SAFETY: the functions belong to this call.
    unsafe { (*call.host).alloc.expect("alloc")(call.call, output, format, size.0, size.1, stride, len) }
}

#[test]
fn alloc_gives_aligned_fresh_memory() {
    let script: Script = |call, host| {
        assert_eq!(alloc(call, 0, abi::FORMAT_GRAY8, (3, 2), 8, 16), abi::STATUS_OK);
        // SAFETY: the output was just made.
        let frame = unsafe { *call.outputs };
        assert_eq!((frame.width, frame.height, frame.stride_bytes, frame.len), (3, 2, 8, 16));
        assert_eq!(frame.data as usize % 64, 0);
        // SAFETY: 16 bytes were asked for; the buffer is held by the output.
        unsafe {
            assert_eq!(std::slice::from_raw_parts(frame.data, 16), [0xA5; 16]);
            assert_eq!(host.resolve.expect("resolve")(host.ctx, frame.buffer), frame.data);
            let nowhere = abi::BufferId { offset: 1, ..frame.buffer };
            assert!(host.resolve.expect("resolve")(host.ctx, nowhere).is_null());
        }
        abi::STATUS_OK
    };
    assert_eq!(run(script), Ok(()));
}

#[test]
fn alloc_rejects_invalid_arguments() {
    let refused = |script: Script| run(script).expect_err("the contract was broken");
    let broke = "the node violated the ABI: ";
    assert_eq!(refused(|c, _| alloc(c, 2, 1, (1, 1), 1, 1)), format!("{broke}it made output 2, there are 2"));
    assert_eq!(
        refused(|c, _| alloc(c, 0, abi::FORMAT_F32, (1, 1), 4, 4)),
        format!("{broke}output 0 was made with format 5, which it does not declare")
    );
    assert_eq!(refused(|c, _| alloc(c, 0, 1, (4, 2), 3, 8)), format!("{broke}output 0: 4x2 with 3 bytes a row"));
    assert_eq!(refused(|c, _| alloc(c, 0, 1, (0, 2), 3, 8)), format!("{broke}output 0: 0x2 with 3 bytes a row"));
    assert_eq!(refused(|c, _| alloc(c, 0, 1, (4, 2), 4, 7)), format!("{broke}output 0: 7 bytes are too few for 4x2"));
    // SAFETY: the type `greedy` allocates while it opens, where there are no outputs.
    let greedy = unsafe { Harness::<Foreign>::of_plugin(&PLUGIN, "greedy", Setup::default()) };
    let words = greedy.err().map(|e| e.to_string());
    assert_eq!(words, Some(format!("{broke}it made output 0, there are 0")));
}

#[test]
fn forward_and_make_mut() {
    let script: Script = |call, host| {
        // SAFETY: the call has one input and two outputs; the functions take the handle of this call.
        unsafe {
            let (input, out) = (*call.inputs, call.outputs);
            let (forward, make_mut) = (host.forward.expect("forward"), host.make_mut.expect("make_mut"));
            assert_eq!(forward(call.call, 1, &input), abi::STATUS_OK);
            assert_eq!(((*out.add(1)).buffer, (*out.add(1)).data), (input.buffer, input.data));
            assert_eq!(make_mut(call.call, 1), abi::STATUS_OK);
            let copy = *out.add(1);
            assert_ne!(copy.data, input.data);
            assert_eq!(std::slice::from_raw_parts(copy.data, copy.len), [1, 2, 3, 4, 5, 6]);
            // Only this output holds the buffer, so there is no second copy.
            assert_eq!(make_mut(call.call, 1), abi::STATUS_OK);
            assert_eq!((*out.add(1)).data, copy.data);
            assert_eq!(forward(call.call, 1, &Frame::EMPTY), abi::STATUS_OK);
            assert!((*out.add(1)).is_empty());
        }
        abi::STATUS_OK
    };
    SCRIPT.set(script);
    let mut node = node(Setup::default());
    let out = node.input_image::<Bgr8>("image", 2, 1, &[1, 2, 3, 4, 5, 6]).process().expect("runs");
    assert!(out.is_empty("note").expect("an output") && out.bytes("note").expect("an output").is_empty());
    assert_eq!((node.copies(), node.allocated_bytes()), (1, 0));
    let refused = |script: Script| run(script).expect_err("the contract was broken");
    let far: Script = |c, h| {
        // SAFETY: the harness checks the number.
        unsafe { h.forward.expect("forward")(c.call, 7, c.inputs) }
    };
    let null: Script = |c, h| {
        // SAFETY: the harness checks the pointer.
        unsafe { h.forward.expect("forward")(c.call, 0, ptr::null()) }
    };
    let empty: Script = |c, h| {
        // SAFETY: the harness checks the output.
        unsafe { h.make_mut.expect("make_mut")(c.call, 0) }
    };
    assert!(refused(far).ends_with("output 7, there are 2"));
    assert!(refused(null).ends_with("a null frame"));
    assert!(refused(empty).ends_with("output 0, which is empty"));
    let foreign: Script = |c, h| {
        let foreign = Frame { buffer: abi::BufferId { pool: u32::MAX, home: 0, offset: 0 }, ..Frame::EMPTY };
        // SAFETY: the harness checks the frame.
        unsafe { h.forward.expect("")(c.call, 0, &foreign) }
    };
    assert!(refused(foreign).ends_with("a buffer that it does not hold"));
}

#[test]
fn retain_and_release_are_counted() {
    let keep: Script = |call, host| {
        // SAFETY: the call has one input.
        unsafe {
            KEPT.set(Some(*call.inputs));
            host.retain.expect("retain")(host.ctx, (*call.inputs).buffer);
        }
        abi::STATUS_OK
    };
    let give_back: Script = |call, host| {
        if let Some(kept) = KEPT.take() {
            // SAFETY: the buffer was retained in the call before.
            unsafe {
                assert_eq!(host.resolve.expect("resolve")(host.ctx, kept.buffer), kept.data);
                assert_eq!(*kept.data, 9);
                assert_ne!((*call.inputs).buffer, kept.buffer);
                host.release.expect("release")(host.ctx, kept.buffer);
            }
        }
        abi::STATUS_OK
    };
    let mut node = node(Setup::default());
    SCRIPT.set(keep);
    node.input_image::<Bgr8>("image", 1, 1, &[9; 3]).process().expect("runs");
    assert_eq!(node.kept_buffers(), 1);
    SCRIPT.set(give_back);
    node.input_image::<Bgr8>("image", 1, 1, &[8; 3]).process().expect("runs");
    assert_eq!(node.kept_buffers(), 0);
    let nowhere = run(|call, host| {
        // SAFETY: the harness checks the buffer and records one that does not exist.
        unsafe { host.release.expect("")(host.ctx, abi::BufferId { offset: 1 << 40, ..(*call.inputs).buffer }) };
        abi::STATUS_OK
    });
    assert!(nowhere.expect_err("broken").ends_with("it released a buffer that nobody holds"));
    let gone = run(|call, host| {
        // SAFETY: the harness checks the buffer and records one that does not exist.
        unsafe { host.retain.expect("")(host.ctx, abi::BufferId { offset: 1 << 40, ..(*call.inputs).buffer }) };
        abi::STATUS_OK
    });
    assert!(gone.expect_err("broken").ends_with("it retained a buffer that is gone"));
}

static SUM: AtomicUsize = AtomicUsize::new(0);
static ENTERED: AtomicU32 = AtomicU32::new(0);

unsafe extern "C" fn add(data: *mut c_void, chunk: usize) {
    assert_eq!(data.addr(), 0x10);
    SUM.fetch_add(chunk, Ordering::Relaxed);
    if ENTERED.load(Ordering::Relaxed) < 3 {
        ENTERED.fetch_add(1, Ordering::Relaxed);
        // Waits until three threads are here.
        while ENTERED.load(Ordering::Relaxed) < 3 {
            std::thread::yield_now();
        }
    }
}

#[test]
fn parallel_for_uses_the_threads_it_says() {
    SCRIPT.set(|_, host| {
        assert_eq!((host.threads, host.abi_major, host.struct_size as usize), (3, 1, size_of::<abi::Host>()));
        let run = host.parallel_for.expect("parallel_for");
        // SAFETY: `add` takes any index and this pointer.
        unsafe {
            assert_eq!(run(host.ctx, 100, Some(add), ptr::without_provenance_mut(0x10)), abi::STATUS_OK);
            assert_eq!(run(host.ctx, 0, Some(add), ptr::null_mut()), abi::STATUS_OK);
            assert_eq!(run(host.ctx, 1, None, ptr::null_mut()), abi::STATUS_INVALID);
        }
        abi::STATUS_OK
    });
    node(Setup::default().threads(3)).process().expect("runs");
    assert_eq!(SUM.load(Ordering::Relaxed), 4950);
}

#[test]
fn a_file_is_claimed_and_begun_in_parts() {
    let path = std::env::temp_dir().join(format!("panoscope_claimed_{}.csv", std::process::id()));
    std::fs::write(&path, "earlier").expect("temporary files can be written");
    thread_local! {
        static ANSWERS: std::cell::RefCell<Vec<(abi::Status, String)>> = const { std::cell::RefCell::new(Vec::new()) };
    }
    SCRIPT.set(|call, host| {
        let claim = host.claim_file.expect("claim_file");
        let path = std::env::temp_dir().join(format!("panoscope_claimed_{}.csv", std::process::id()));
        for action in [abi::CLAIM_HOLD, abi::CLAIM_BEGIN, abi::CLAIM_BEGIN, abi::CLAIM_BEGIN_NEW] {
            let mut answer = Str::EMPTY;
            // SAFETY: the host function takes the handle of the call being served; the returned text is read before the next host call.
            let (status, text) = unsafe {
                let path = Str::borrow(path.to_str().expect("UTF-8"));
                (claim(call.call, path, action, &raw mut answer), answer.text().unwrap_or("?").to_owned())
            };
            ANSWERS.with_borrow_mut(|all| all.push((status, text)));
        }
        // SAFETY: the host function takes the handle of the call being served.
        assert!(unsafe { host.clock_ns.expect("clock_ns")(call.call) } >= 0);
        abi::STATUS_OK
    });
    let run = panoscope_node::harness::Files::default();
    let mut first = node(Setup::default().node_id("first").files(&run));
    first.process().expect("runs");
    let name = |part: &str| path.with_extension(part).to_string_lossy().into_owned();
    let answers = ANSWERS.take();
    let expected = ["csv", "csv", "part2.csv", "part3.csv"].map(|part| (abi::STATUS_OK, name(part)));
    assert_eq!(answers, expected);
    let mut second = node(Setup::default().node_id("second").files(&run));
    second.process().expect("runs");
    assert!(ANSWERS.take().iter().all(|answer| *answer == (abi::STATUS_INVALID, "first".to_owned())));
    drop(first);
    second.process().expect("runs");
    assert_eq!(ANSWERS.take()[1], (abi::STATUS_OK, name("part4.csv")), "what was written in this run stays");
    std::fs::remove_file(path).expect("it is removed");
}

#[test]
fn ages_count_from_arrival() {
    SCRIPT.set(|call, host| {
        let (age, arrived) = (host.age_ns.expect("age_ns"), host.arrived_ns.expect("arrived_ns"));
        // SAFETY: the host functions take the handle of the call being served.
        unsafe {
            for input in 0..2 {
                host.metric.expect("metric")(call.call, Str::new("age"), age(call.call, input) as f64);
                host.metric.expect("metric")(call.call, Str::new("arrived"), arrived(call.call, input) as f64);
            }
            host.set_arrived_ns.expect("set_arrived_ns")(call.call, i64::MAX);
            host.set_lag_ns.expect("set_lag_ns")(call.call, -5);
            host.metric.expect("metric")(call.call, Str::new("tick"), age(call.call, abi::INPUT_TICK) as f64);
        }
        abi::STATUS_OK
    });
    let mut node = node(Setup::default());
    let image = [0; 3];
    let out = node.at_tick(0, 1_000).at_clock(9_000).input_image::<Bgr8>("image", 1, 1, &image);
    let ns = std::time::Duration::from_nanos;
    let out = out.input_age("image", ns(2_000)).tick_age(ns(500)).process().expect("runs");
    let seen: Vec<f64> = node.metrics().iter().map(|m| m.value).collect();
    assert_eq!(seen, [2_000.0, 7_000.0, i64::MAX as f64, i64::MIN as f64, 500.0], "input 1 does not exist");
    assert!(out.arrived_ns().is_some_and(|ns| ns < 1 << 60), "not in the future: {:?}", out.arrived_ns());
    assert_eq!(out.lag_ns(), Some(0), "not in the future");
    // By default the light arrives with its tick.
    node.at_tick(1, 5_000).input_image::<Bgr8>("image", 1, 1, &image).process().expect("runs");
    assert_eq!((node.metrics()[5].value, node.metrics()[6].value), (0.0, 5_000.0));
    let wrong = node.input_age("imaeg", std::time::Duration::ZERO).process().err().map(|e| e.to_string());
    assert!(wrong.is_some_and(|words| words.contains("no input `imaeg`")));
}

#[test]
fn logs_metrics_and_failures_reach_the_host() {
    SCRIPT.set(|call, host| {
        let (log, metric) = (host.log.expect("log"), host.metric.expect("metric"));
        // SAFETY: the host functions take the handle of the call being served.
        unsafe {
            for (level, words) in [(1, "a"), (2, "b"), (3, "c"), (4, "d")] {
                log(call.call, level, Str::borrow(words));
            }
            metric(call.call, Str::new("inliers"), 12.0);
            metric(call.call, Str::new("inliers"), 13.0);
            host.fail.expect("fail")(call.call, Str::new("first words"));
            host.fail.expect("fail")(call.call, Str { ptr: b"last w\xf6rds".as_ptr(), len: 10 });
        }
        abi::STATUS_ERROR
    });
    let mut node = node(Setup::default());
    let error = node.process().err();
    assert_eq!(error.as_ref().and_then(HarnessError::status), Some(abi::STATUS_ERROR));
    assert_eq!(error.map(|e| e.to_string()).as_deref(), Some("process returned STATUS_ERROR: last w\u{fffd}rds"));
    let levels: Vec<Level> = node.logs().iter().map(|l| l.level).collect();
    assert_eq!(levels, [Level::Error, Level::Warn, Level::Info, Level::Debug]);
    assert_eq!((node.metric("inliers"), node.metrics().len()), (Some(13.0), 2));
    let mute = run(|_, _| abi::STATUS_PANIC);
    assert_eq!(mute, Err("process returned STATUS_PANIC: the node failed without an error message".to_owned()));
    let odd = run(|call, host| {
        // SAFETY: the host function takes the handle of the call being served.
        unsafe { host.log.expect("log")(call.call, 17, Str::EMPTY) };
        abi::STATUS_OK
    });
    assert!(odd.expect_err("broken").ends_with("a log line of level 17"));
}

#[test]
fn random_numbers_depend_on_node_and_tick_only() {
    SCRIPT.set(|call, host| {
        for _ in 0..3 {
            // SAFETY: the host functions take the handle of the call being served.
            unsafe {
                let number = host.random.expect("random")(call.call);
                host.metric.expect("metric")(call.call, Str::new("random"), (number >> 12) as f64);
            }
        }
        abi::STATUS_OK
    });
    let numbers = |id: &str, threads, seq| {
        let mut node = node(Setup::default().node_id(id).threads(threads));
        node.at_tick(seq, 0).process().expect("runs");
        node.metrics().iter().map(|m| m.value).collect::<Vec<_>>()
    };
    let first = numbers("a", 1, 5);
    assert!(first[0] != first[1] && first[1] != first[2]);
    assert_eq!(first, numbers("a", 4, 5));
    assert_ne!(first, numbers("a", 1, 6));
    assert_ne!(first, numbers("b", 1, 5));
}

#[test]
fn flags_and_ticks_are_passed() {
    SCRIPT.set(|call, _| {
        assert_eq!((call.flags, call.tick.seq, call.tick.capture_ns), (abi::CALL_BATCH, 7, 70));
        assert_eq!((call.outputs_read, call.input_ranges_len, call.inputs_len), (0b10, 1, 0));
        call.tick.capture_ns = 99;
        abi::STATUS_OK
    });
    let mut node = node(Setup::default().batch().read_only(&["note"]));
    let out = node.at_tick(7, 70).process().expect("runs");
    assert_eq!(out.tick().capture_ns, 99);
    let wrong = out.plane::<Gray8>("gray").err().map(|e| e.to_string());
    assert_eq!(wrong.as_deref(), Some("output `gray` is empty"));
}
