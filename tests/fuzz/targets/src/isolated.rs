//! Messages from a process of isolated nodes to its host: descriptions of plugins, problems of parameters, and the messages of calls.
//!
//! The process may run untrusted code, so it may send anything. Here the host runs a whole graph whose middle node is played by a script; the node
//! after it reads every byte that it is given.

use std::ffi::c_void;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use panoscope_abi as abi;
use panoscope_base::packet::Table;
use panoscope_engine::isolation::Isolator;
use panoscope_engine::memory::{Domain, FrameRef, memory};
use panoscope_engine::{Engine, Options, Plugins};
use panoscope_graph::{Catalog, Graph, GraphText, check, from_abi};
use panoscope_host::isolate::played::{self, Piece, Played, Step};
use panoscope_host::loader::graph_file::Ready;
use panoscope_record::{RecordOptions, Recorder};

use crate::draw::Draw;

/// A description: an accepted one is checked like that of a loaded plugin, and is the same after it is written and read again.
pub fn description(bytes: &[u8]) {
    // SAFETY: the descriptor lives until the function returns; its pointers and lengths are those of what was read.
    let types = played::with_description(bytes, |plugin| unsafe {
        if let Ok(types) = from_abi::node_types(plugin) {
            assert_eq!(types.len(), (*plugin).node_types_len);
        }
        let len = (*plugin).node_types_len;
        let types: Vec<&abi::NodeType> = (0..len).map(|at| &**(*plugin).node_types.add(at)).collect();
        played::description_of(&types)
    });
    // Unknown bits of functions are not written again.
    assert!(types.is_none_or(|again| again.len() == bytes.len()), "written again, it differs");
    problems(bytes);
}

unsafe extern "C" fn invalid(call: *mut c_void, _: u32, _: u32, message: abi::Str, help: abi::Str) {
    // SAFETY: `problems` lends the sum, and the texts are lent for the call.
    unsafe {
        let sum = &mut *call.cast::<usize>();
        *sum += message.bytes().iter().chain(help.bytes()).map(|byte| usize::from(*byte)).sum::<usize>();
    }
}

fn problems(bytes: &[u8]) {
    let mut sum = 0_usize;
    // SAFETY: null pointers and zeros are values of all fields.
    let blank: abi::ValidateCall = unsafe { std::mem::zeroed() };
    let call = abi::ValidateCall { call: (&raw mut sum).cast(), invalid: Some(invalid), ..blank };
    // SAFETY: `sum` lives until this returns.
    let _ = unsafe { played::problems(bytes, &call) };
    assert!(sum <= 255 * bytes.len(), "every byte is read once");
}

pub fn description_seeds() -> Vec<Vec<u8>> {
    let nodes = nodes();
    // SAFETY: the descriptors live until the process ends.
    let whole = unsafe { played::description_of(&[&nodes.feed, &nodes.far, &nodes.taste]) };
    // SAFETY: as above.
    let one = unsafe { played::description_of(&[&nodes.far]) };
    let mut count = one.clone();
    count[..8].fill(0xff);
    let problem = [&[0xff, 0xff, 0xff, 0xff][..], &1u64.to_le_bytes(), &[0, 0, 0, 0, 1, 0, 0, 0]].concat();
    let problem = [&problem[..], &2u64.to_le_bytes(), b"no", &3u64.to_le_bytes(), b"yes"].concat();
    let many = [&0i32.to_le_bytes()[..], &90u64.to_le_bytes(), &[0; 90 * 24]].concat();
    vec![whole, one.clone(), one[..one.len() - 3].to_vec(), count, problem, many, vec![0; 8], Vec::new()]
}

/// Parses a script. Each step: kind, number of pieces, pieces; see [`piece`].
fn script(bytes: &[u8]) -> Vec<Step> {
    let kinds = played::kinds();
    let (mut draw, mut steps) = (Draw(bytes), Vec::new());
    while !draw.0.is_empty() && steps.len() < 64 {
        let (kind, count) = (draw.u8(), draw.u8());
        let (mut before, mut body, mut is_raw) = (Vec::new(), Vec::new(), false);
        let mut stated_len = None;
        for _ in 0..count % 32 {
            match draw.u8() % 14 {
                // What came so far goes before the message.
                9 => before.append(&mut body),
                // No such part: the numbers are the message's first.
                10 => is_raw = true,
                11 => stated_len = Some(draw.u32()),
                tag => body.push(piece(tag, &mut draw)),
            }
        }
        let pieces = if is_raw { body } else { std::iter::once(Piece::Counted(before)).chain(body).collect() };
        let kind = kinds.get(usize::from(kind)).copied().unwrap_or(u32::from(kind));
        steps.push(Step { kind, stated_len, pieces });
    }
    steps
}

fn piece(tag: u8, draw: &mut Draw<'_>) -> Piece {
    match tag {
        0 => Piece::Raw(u32::from(draw.u8()).to_le_bytes().to_vec()),
        1 => Piece::Raw(draw.u32().to_le_bytes().to_vec()),
        2 => Piece::Raw(u64::from(draw.u8()).to_le_bytes().to_vec()),
        3 => Piece::Raw(draw.u64().to_le_bytes().to_vec()),
        4 => Piece::Counted(vec![Piece::Raw(draw.bytes(200).to_vec())]),
        5 => Piece::Input,
        6 => Piece::Stock,
        7 => Piece::Made,
        12 => Piece::Raw(draw.bytes(200).to_vec()),
        13 => Piece::InputBuffer,
        // The number of a kind, for what goes before a message.
        _ => {
            let kinds = played::kinds();
            Piece::Raw(kinds[usize::from(draw.u8()) % kinds.len()].to_le_bytes().to_vec())
        }
    }
}

const WIDTH: u32 = 16;
const HEIGHT: u32 = 8;
const FRAMES: u64 = 4;

/// Runs a graph whose middle node sends these messages.
pub fn calls(bytes: &[u8]) {
    // The frame memory and the domains are those of the process.
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let host = host();
    let script: Arc<[Step]> = script(bytes).into();
    let _secret = secret();
    let before = memory().in_use_bytes();
    let options = Options {
        threads: 1,
        frames: Some(FRAMES),
        paced: false,
        hang: Duration::from_secs(5),
        open_limit: Duration::from_secs(5),
        close_limit: Duration::from_secs(5),
        ..Options::default()
    };
    let plugins = With { host, script };
    if let Ok(engine) = Engine::start(host.graph.clone(), &host.catalog, &plugins, options) {
        assert!(engine.wait(Some(Duration::from_secs(15))), "the run does not end");
        engine.close(Duration::from_secs(5));
        let report = engine.report();
        assert_eq!(report.nodes["feed"].faults, 0, "a fault of another node");
        assert_eq!(report.nodes["taste"].faults, 0, "{:?}", engine.recent_faults());
    }
    // A thread of the engine may still be on its way out.
    let end = Instant::now() + Duration::from_secs(5);
    while memory().in_use_bytes() > before {
        assert!(Instant::now() < end, "frames are never given back");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Memory of another group to which the played process is never given access.
const SECRET: &[u8] = b"a picture of another group";

/// A frame of another group.
fn secret() -> (Domain, FrameRef) {
    let domain = Domain::written_elsewhere().expect("a domain");
    let len = (WIDTH * HEIGHT) as usize;
    let (buffer, data) = memory().allocate_in(domain.number(), len).expect("a frame");
    // SAFETY: a new buffer of at least `len` bytes, of which this is the one reference.
    let frame = unsafe {
        data.copy_from_nonoverlapping(SECRET.as_ptr(), SECRET.len());
        FrameRef::adopt(abi::Frame { buffer, data, len, ..abi::Frame::EMPTY })
    };
    (domain, frame)
}

/// A recording of a run of this graph, without the played node.
pub fn recorded(file: &Path) {
    let host = host();
    let text = "mode = \"batch\"\nplugins = [\"simple\"]\n[nodes.feed]\ntype = \"feed\"\n\
        [nodes.taste]\ntype = \"taste\"\ninputs = { image = \"feed.image\" }\n";
    let text = GraphText::parse("graph.toml".as_ref(), text);
    let (graph, warnings) =
        check(&text, &host.catalog).into_result().unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
    let (catalog, loader) = (host.catalog.clone(), Arc::default());
    let ready = Ready { text, graph, catalog, loader, warnings, seal: None };
    let options = RecordOptions { file: Some(file.to_owned()), ..RecordOptions::default() };
    let recorder = Recorder::start(options, panoscope_record::head(&ready)).expect("a recording");
    let options =
        Options { threads: 1, frames: Some(2), paced: false, observer: Some(recorder.clone()), ..Options::default() };
    let plugins = With { host, script: Arc::new([]) };
    let engine = Engine::start(ready.graph, &ready.catalog, &plugins, options).expect("a run");
    assert!(engine.wait(Some(Duration::from_secs(30))), "the run does not end");
    engine.close(Duration::from_secs(5));
    let recorded = recorder.finish();
    assert!(recorded.failed.is_none() && recorded.ticks == 2, "{recorded:?}");
}

struct With {
    host: &'static Simple,
    script: Arc<[Step]>,
}

impl Plugins for With {
    fn entry(&self, _: &str, node_type: &str) -> Option<&'static abi::NodeType> {
        match node_type {
            "feed" => Some(&self.host.nodes.feed),
            "far" => Some(&self.host.nodes.far),
            "taste" => Some(&self.host.nodes.taste),
            _ => None,
        }
    }

    fn isolator(&self) -> Option<Arc<dyn Isolator>> {
        Some(Arc::new(Played(Arc::clone(&self.script))))
    }

    fn files(&self, _: &[String]) -> Vec<(String, PathBuf)> {
        Vec::new()
    }
}

/// The plugin, and the graph `feed -> far -> taste`.
struct Simple {
    nodes: Nodes,
    catalog: Catalog,
    graph: Graph,
}

struct Nodes {
    feed: abi::NodeType,
    far: abi::NodeType,
    taste: abi::NodeType,
}

// SAFETY: the pointers are to memory that is never changed nor freed.
unsafe impl Send for Simple {}
// SAFETY: as above.
unsafe impl Sync for Simple {}

fn host() -> &'static Simple {
    static HOST: OnceLock<Simple> = OnceLock::new();
    HOST.get_or_init(|| {
        let nodes = nodes();
        let types = [&raw const nodes.feed, &raw const nodes.far, &raw const nodes.taste];
        // SAFETY: null pointers and zeros are values of all fields.
        let blank: abi::Plugin = unsafe { std::mem::zeroed() };
        let plugin = abi::Plugin {
            magic: abi::MAGIC,
            abi_major: abi::ABI_MAJOR,
            abi_minor: abi::ABI_MINOR,
            struct_size: size_of::<abi::Plugin>() as u32,
            name: abi::Str::new("simple"),
            node_types: types.as_ptr(),
            node_types_len: types.len(),
            ..blank
        };
        // SAFETY: the descriptor lives until the function returns, and the result refers to nothing of it.
        let node_types = unsafe { from_abi::node_types(&raw const plugin) }.expect("node types");
        let catalog = Catalog { plugins: vec!["simple".to_owned()], node_types, ..Catalog::default() };
        let text = "mode = \"batch\"\nplugins = [\"simple\"]\n[nodes.feed]\ntype = \"feed\"\n\
            [nodes.far]\ntype = \"far\"\nisolate = \"group\"\non_fault = \"stop\"\ninputs = { image = \"feed.image\" }\n\
            [nodes.taste]\ntype = \"taste\"\ninputs = { image = \"far.image\", table = \"far.table\" }\n";
        let checked = check(&GraphText::parse("graph.toml".as_ref(), text), &catalog).into_result();
        let (graph, _) = checked.unwrap_or_else(|mistakes| panic!("{}", mistakes.render(false)));
        Simple { nodes, catalog, graph }
    })
}

fn nodes() -> Nodes {
    let port = |name: &'static str, packet: &'static str, formats: u32, flags: u32| abi::Port {
        name: abi::Str::new(name),
        doc: abi::Str::new("A port."),
        packet: abi::Str::new(packet),
        layout_hash: 0,
        formats,
        flags,
    };
    let gray = abi::format_bit(abi::FORMAT_GRAY8);
    let list = |ports: Vec<abi::Port>| -> (*const abi::Port, usize) {
        let ports: &'static [abi::Port] = Vec::leak(ports);
        (ports.as_ptr(), ports.len())
    };
    let node = |name: &'static str, flags: u32, inputs: Vec<abi::Port>, outputs: Vec<abi::Port>, process| {
        let ((inputs, inputs_len), (outputs, outputs_len)) = (list(inputs), list(outputs));
        // SAFETY: null pointers, absent functions and zeros are values of all fields.
        let blank: abi::NodeType = unsafe { std::mem::zeroed() };
        abi::NodeType {
            struct_size: size_of::<abi::NodeType>() as u32,
            kind: abi::KIND_COMPUTE,
            flags,
            name: abi::Str::new(name),
            family: abi::Str::new("test"),
            doc: abi::Str::new("A node."),
            inputs,
            inputs_len,
            outputs,
            outputs_len,
            open: Some(open),
            process: Some(process),
            close: Some(close),
            save_state: (name == "far").then_some(save_state),
            load_state: (name == "far").then_some(load_state),
            ..blank
        }
    };
    let image = |flags| port("image", "image", gray, flags);
    let table = |flags| port("table", "table", 0, flags);
    let optional = abi::PORT_OPTIONAL;
    Nodes {
        feed: node("feed", abi::NODE_SOURCE, Vec::new(), vec![image(0)], feed),
        far: node("far", 0, vec![image(0)], vec![image(0), table(0)], nothing),
        taste: node("taste", 0, vec![image(optional), table(optional)], Vec::new(), taste),
    }
}

unsafe extern "C" fn open(_: *mut abi::OpenCall, _: *mut *mut c_void) -> abi::Status {
    abi::STATUS_OK
}

unsafe extern "C" fn close(_: *mut c_void) {}

unsafe extern "C" fn save_state(_: *mut c_void, _: *const abi::Host, _: *mut c_void) -> abi::Status {
    abi::STATUS_OK
}

unsafe extern "C" fn load_state(_: *mut c_void, _: *const u8, _: usize) -> abi::Status {
    abi::STATUS_OK
}

unsafe extern "C" fn nothing(_: *mut c_void, _: *mut abi::Call) -> abi::Status {
    abi::STATUS_INVALID
}

/// Makes a frame.
unsafe extern "C" fn feed(_: *mut c_void, call: *mut abi::Call) -> abi::Status {
    // SAFETY: the contract: the call and its table live until this returns.
    let call = unsafe { &mut *call };
    call.tick.capture_ns = call.tick.seq as i64 * 1_000_000;
    // SAFETY: as above.
    let Some(alloc) = (unsafe { (*call.host).alloc }) else { return abi::STATUS_INVALID };
    // SAFETY: as above; the output has the bytes that were asked for.
    unsafe {
        let status = alloc(call.call, 0, abi::FORMAT_GRAY8, WIDTH, HEIGHT, WIDTH, (WIDTH * HEIGHT) as usize);
        if status == abi::STATUS_OK {
            (*call.outputs).data.write_bytes(7, (WIDTH * HEIGHT) as usize);
        }
        status
    }
}

/// Reads all bytes of its inputs.
unsafe extern "C" fn taste(_: *mut c_void, call: *mut abi::Call) -> abi::Status {
    // SAFETY: the contract: the call and its inputs live until this returns.
    let inputs = unsafe { std::slice::from_raw_parts((*call).inputs, (*call).inputs_len) };
    for (at, input) in inputs.iter().enumerate().filter(|(_, input)| !input.is_empty()) {
        // SAFETY: the host lends the bytes of an input.
        let bytes = unsafe { std::slice::from_raw_parts(input.data, input.len) };
        std::hint::black_box(bytes.iter().map(|byte| u64::from(*byte)).sum::<u64>());
        assert!(!bytes.starts_with(SECRET), "a frame that the process was not given");
        if at == 0 {
            assert!(input.format == abi::FORMAT_GRAY8, "a picture of format {}", input.format);
            let need = (input.height as usize - 1) * input.stride_bytes as usize + input.width as usize;
            assert!(need <= input.len, "{}x{} in {} bytes", input.width, input.height, input.len);
        } else if let Ok(table) = Table::parse(bytes) {
            assert!(table.byte_len() <= input.len);
        }
    }
    abi::STATUS_OK
}

/// A script as bytes: kinds are indices into [`played::kinds`].
#[derive(Clone, Default)]
struct Script(Vec<u8>);

const DONE: u8 = 0;
const ALLOC: u8 = 1;
const FORWARD: u8 = 2;
const MAKE_MUT: u8 = 3;
const RETAIN: u8 = 4;
const RELEASE: u8 = 5;
const LOG: u8 = 6;
const FAIL: u8 = 7;
const METRIC: u8 = 8;
const CLAIM_FILE: u8 = 9;
const CLOCK: u8 = 10;
const SET_ARRIVED: u8 = 11;
const ARRIVED: u8 = 12;
const AGE: u8 = 13;
const SET_LAG: u8 = 14;
const SAVE: u8 = 15;
const PLACED: u8 = 16;
const COPIED: u8 = 17;
const FLUSH: u8 = 18;

const INPUT: &[u8] = &[5];
const STOCK: &[u8] = &[6];
const MADE: &[u8] = &[7];
const BEFORE: &[u8] = &[9];
const INPUT_BUFFER: &[u8] = &[13];

impl Script {
    fn step(mut self, kind: u8, pieces: &[Vec<u8>]) -> Self {
        self.0.extend([kind, pieces.len() as u8]);
        pieces.iter().for_each(|piece| self.0.extend_from_slice(piece));
        self
    }

    /// The end of a request: preceding messages, and the status.
    fn done(self, before: &[Vec<u8>]) -> Self {
        self.step(DONE, &[before, &[BEFORE.to_vec(), small(0)]].concat())
    }

    /// The end of a tick: preceding messages, and the first output.
    fn made(self, before: &[Vec<u8>], output: &[Vec<u8>]) -> Self {
        let tick = [BEFORE.to_vec(), small(0), raw(&[0; 24]), long(2)];
        self.step(DONE, &[before, &tick, output, &[raw(&[0; 60]), text(b"")]].concat())
    }

    /// A script that opens, makes an output at each tick, and closes.
    fn around(self, tick: impl Fn(Self) -> Self) -> Self {
        (0..FRAMES).fold(self.done(&[]), |script, _| tick(script)).done(&[])
    }
}

fn small(value: u8) -> Vec<u8> {
    vec![0, value]
}

fn flag(value: bool) -> Vec<u8> {
    raw(&[u8::from(value)])
}

fn long(value: u8) -> Vec<u8> {
    vec![2, value]
}

fn longest() -> Vec<u8> {
    [&[3][..], &[0xff; 8]].concat()
}

fn raw(bytes: &[u8]) -> Vec<u8> {
    [&[12, bytes.len() as u8], bytes].concat()
}

fn text(bytes: &[u8]) -> Vec<u8> {
    [&[4, bytes.len() as u8], bytes].concat()
}

fn kind(kind: u8) -> Vec<u8> {
    vec![8, kind]
}

fn picture() -> [Vec<u8>; 5] {
    let [format, width, height] = [abi::FORMAT_GRAY8, WIDTH, HEIGHT].map(|number| small(number as u8));
    [format, width.clone(), height, width, long((WIDTH * HEIGHT) as u8)]
}

/// A frame of another group, in the pool that it has while there is no other group.
fn foreign() -> Vec<Vec<u8>> {
    let [format, width, height, stride, len] = picture();
    let buffer = secret().1.frame().buffer;
    let buffer = raw(&[&buffer.pool.to_le_bytes()[..], &buffer.offset.to_le_bytes()].concat());
    vec![buffer, len, format, width, height, stride, raw(&[0; 24])]
}

pub fn call_seeds() -> Vec<Vec<u8>> {
    let [format, width, height, stride, len] = picture();
    let description = [small(0), format.clone(), width.clone(), height.clone(), stride.clone(), len.clone()];
    let none = [raw(&[0; 60])];
    let alloc = |script: Script| script.step(ALLOC, &description);
    let placed = [&[kind(PLACED)][..], &description].concat();
    let in_stock = [STOCK.to_vec(), len, format, width, height, stride, raw(&[0; 24])];
    let forward = [kind(FORWARD), small(0), flag(true), INPUT.to_vec()];
    let retain = [kind(RETAIN), INPUT_BUFFER.to_vec()];
    let release = [kind(RELEASE), INPUT_BUFFER.to_vec()];
    let begin = || Script::default().done(&[]);
    let scripts = [
        // A node that keeps to the protocol: asks for buffers, uses those that it was given, forwards, copies.
        Script::default().around(|s| alloc(s).made(&[], &[MADE.to_vec()])),
        Script::default().around(|s| s.made(&forward, &[INPUT.to_vec()])),
        (1..FRAMES).fold(alloc(begin()).made(&[], &[MADE.to_vec()]), |s, _| s.made(&placed, &in_stock)).done(&[]),
        Script::default().around(|s| {
            s.step(FORWARD, &[small(0), flag(true), INPUT.to_vec()])
                .step(MAKE_MUT, &[small(0), INPUT.to_vec()])
                .made(&[], &[MADE.to_vec()])
        }),
        Script::default().around(|s| s.made(&[], &none)),
        // A table, logs, metrics, ages, files.
        Script::default().around(|s| {
            s.step(ALLOC, &[small(1), small(abi::FORMAT_BYTES as u8), small(0), small(0), small(0), long(64)])
                .step(LOG, &[small(1), text(b"hello")])
                .step(CLOCK, &[])
                .step(ARRIVED, &[small(0)])
                .step(AGE, &[vec![1, 0xff, 0xff, 0xff, 0xff]])
                .step(CLAIM_FILE, &[small(0), text(b"/nowhere/a.csv")])
                .step(FLUSH, &[])
                .step(
                    DONE,
                    &[&[small(0), raw(&[0; 24]), long(2), raw(&[0; 60])][..], &[MADE.to_vec(), text(b"")]].concat(),
                )
        }),
        Script::default().around(|s| {
            let metric =
                [kind(METRIC), text(b"share"), long(1), kind(SET_LAG), longest(), kind(SET_ARRIVED), longest()];
            s.made(&metric, &none)
        }),
        Script::default().around(|s| s.made(&[&retain[..], &release].concat(), &none)),
        // One that does not.
        Script::default().around(|s| s.made(&[&retain[..]; 10].concat(), &none)),
        Script::default().around(|s| s.made(&[&release[..]; 3].concat(), &none)),
        begin().made(&[kind(FORWARD), small(0), flag(true), small(9), long(0), longest(), raw(&[0; 40])], &none),
        begin().made(&[kind(FORWARD), small(0), flag(false), INPUT.to_vec()], &[INPUT.to_vec()]),
        begin().made(&[&[kind(FORWARD), small(0), flag(true)][..], &foreign()].concat(), &foreign()),
        begin().made(&[kind(PLACED), small(0), small(1), small(255), small(255), small(255), longest()], &none),
        begin().made(&[kind(COPIED), small(0)], &none),
        begin().made(&[], &[INPUT.to_vec()]),
        begin().step(ALLOC, &[small(0), small(1), small(255), small(255), small(255), longest()]).made(&[], &none),
        begin().step(MAKE_MUT, &[small(200), raw(&[0; 60])]).step(ALLOC, &[small(7)]),
        begin().step(FAIL, &[text(b"it failed")]).step(DONE, &[vec![1, 0xff, 0xff, 0xff, 0xff]]),
        begin().step(SAVE, &[text(b"state")]).made(&[], &none),
        begin().step(CLAIM_FILE, &[small(200), text(b"\xff")]).step(LOG, &[longest(), text(b"\x1b[31m")]),
        begin().step(DONE, &[vec![10], longest()]),
        begin().step(DONE, &[vec![11, 0xff, 0xff, 0xff, 0xff]]),
        begin().step(DONE, &[vec![11, 0xff, 0xff, 0x0f, 0x00]]),
        begin().step(77, &[]),
        Script::default().step(DONE, &[vec![1, 0, 0, 0, 0x80]]),
        Script::default().step(FAIL, &[text(b"no")]).step(DONE, &[vec![1, 0xff, 0xff, 0xff, 0xff]]),
        Script::default(),
    ];
    scripts.into_iter().map(|script| script.0).collect()
}
