//! A seeded campaign of damaged and foreign models. Each is opened and run in a child process. It must end within a second, with an error that names
//! the file or with an answer, must not crash the process, and must not read a file outside the model's folder.
//!
//! A short sample runs with the ordinary tests; `cargo xtask test hostile-models` runs 200. PANOSCOPE_HOSTILE_CASES and PANOSCOPE_HOSTILE_SEED choose
//! how many and which.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::tiny_onnx::{Fixed, Message, TinyModel, folder, runtime_is_there, tensor, wrap};
use panoscope_node::Bgr8;
use panoscope_node::harness::Harness;
use panoscope_node::random::SplitMix64;
use panoscope_tools::mask_rcnn::MaskRcnn;
use panoscope_tools::onnx::Onnx;
use panoscope_tools::yolo::Yolo;

/// Set in the child: the case to open.
const CASE: &str = "PANOSCOPE_HOSTILE_CASE";
/// A file outside the folder of every model, which a model names.
const SECRET: &str = "secret.bin";

/// A detector that outputs a few boxes.
fn detector(chance: &mut SplitMix64) -> TinyModel {
    let mut values = vec![0.0f32; 84 * 7];
    for _ in 0..4 {
        let row = chance.below(84);
        values[row * 7..row * 7 + 7].copy_from_slice(&[0.5, 0.5, 0.3, 0.2, 0.9, 0.8, 0.1]);
    }
    TinyModel {
        input: vec![1, 3, 64, 64],
        outputs: vec![("output", vec![1, 84, 7], Fixed::Floats(values))],
        metadata: vec![("names", "{0: 'grasper', 1: 'hook'}".into())],
    }
}

/// A segmenter with one instance.
fn segmenter() -> TinyModel {
    TinyModel {
        input: vec![3, 64, 64],
        outputs: vec![
            ("boxes", vec![1, 4], Fixed::Floats(vec![5.0, 5.0, 50.0, 40.0])),
            ("labels", vec![1], Fixed::Ints(vec![1])),
            ("scores", vec![1], Fixed::Floats(vec![0.9])),
            ("masks", vec![1, 1, 28, 28], Fixed::Floats(vec![0.7; 784])),
        ],
        metadata: vec![("family", "torchvision".into())],
    }
}

/// Numbers that no sound network outputs.
fn wild(chance: &mut SplitMix64) -> f32 {
    let all = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, -0.0, 1e-45, 1e30];
    if chance.below(3) == 0 { f32::from_bits(chance.bits() as u32) } else { all[chance.below(all.len())] }
}

fn cut(chance: &mut SplitMix64) -> Vec<u8> {
    let whole = detector(chance).bytes();
    let end = chance.below(whole.len());
    whole[..end].to_vec()
}

fn flipped(chance: &mut SplitMix64) -> Vec<u8> {
    let mut bytes = if chance.below(3) == 0 { segmenter().bytes() } else { detector(chance).bytes() };
    for _ in 0..1 + chance.below(12) {
        // Structure stands at the begin and the end, weights between.
        let near = chance.below(2) == 0;
        let at = if near { chance.below(bytes.len().min(400)) } else { chance.below(bytes.len()) };
        bytes[at] ^= 1 << chance.below(8);
    }
    bytes
}

/// Nested branches: deep, or wide, or both.
fn bomb(chance: &mut SplitMix64) -> Vec<u8> {
    let (depth, width) = [(500, 1), (15, 1), (12, 2), (3, 40), (40, 1)][chance.below(5)];
    let mut graph = Message::default().text(2, "inner");
    for _ in 0..depth {
        let attribute = |name: &str| Message::default().text(1, name).message(6, &graph).int(20, 5);
        let mut node = Message::default().text(1, "images").text(2, "output").text(4, "If");
        for branch in 0..width {
            node = node.message(5, &attribute(if branch % 2 == 0 { "then_branch" } else { "else_branch" }));
        }
        graph = Message::default().message(1, &node).text(2, "outer");
        if graph.0.len() > 4 << 20 {
            break;
        }
    }
    wrap(&graph, &[])
}

fn outside(chance: &mut SplitMix64) -> Vec<u8> {
    let places = [
        "../secret.bin",
        "/etc/hostname",
        "./../secret.bin",
        "a/../../secret.bin",
        "..",
        "/proc/self/maps",
        "link.bin",
        "gone.bin",
        "//secret.bin",
    ];
    let entry = |k: &str, v: &str| Message::default().text(1, k).text(2, v);
    let mut held = Message::default().int(1, 84 * 7).int(2, 1).text(8, "output_held");
    held = held.message(13, &entry("location", places[chance.below(places.len())]));
    if chance.below(2) == 0 {
        held = held.message(13, &entry("offset", "18446744073709551615")).message(13, &entry("length", "99999999999"));
    }
    let node = Message::default().text(1, "output_held").text(2, "output").text(4, "Identity");
    wrap(&Message::default().message(1, &node).text(2, "g").message(5, &held.int(14, 1)), &[])
}

fn nan_answers(chance: &mut SplitMix64) -> Vec<u8> {
    if chance.below(3) == 0 {
        let mut model = segmenter();
        model.outputs[0].2 = Fixed::Floats((0..4).map(|_| wild(chance)).collect());
        model.outputs[1].2 = Fixed::Ints(vec![chance.bits() as i64]);
        model.outputs[2].2 = Fixed::Floats(vec![wild(chance)]);
        model.outputs[3].2 = Fixed::Floats((0..784).map(|_| wild(chance)).collect());
        return model.bytes();
    }
    let mut model = detector(chance);
    model.outputs[0].2 = Fixed::Floats((0..84 * 7).map(|_| wild(chance)).collect());
    model.bytes()
}

fn label_tables(chance: &mut SplitMix64) -> Vec<u8> {
    let mut model = detector(chance);
    let tables = [
        "{99999999999999999999: 'a'}".to_owned(),
        "{4294967295: 'a'}".to_owned(),
        "['a']".to_owned(),
        "{".repeat(5000),
        "'".repeat(5001),
        "{0: 'a\\".to_owned(),
        "[\"\u{0}\n\r\", 'b']".to_owned(),
        format!("['{}', 'b']", "x".repeat(1 << 20)),
        format!("[{}]", "'a',".repeat(20_000)),
        "\u{fffd}\u{202e}".to_owned(),
    ];
    model.metadata = vec![("names", tables[chance.below(tables.len())].clone())];
    model.bytes()
}

/// Shapes that promise more data than there are, inputs that are not images.
fn odd_shapes(chance: &mut SplitMix64) -> Vec<u8> {
    let mut model = detector(chance);
    match chance.below(5) {
        0 => model.input = vec![1, 3, 1 << 40, 1 << 40],
        1 => model.input = vec![1, 3, -1, -1],
        2 => model.input = vec![chance.bits() as i64 >> 40, 3, 64, 64],
        3 => model.outputs[0].1 = vec![1, 1 << 50, 7],
        _ => {
            let held = tensor("output", &[1 << 31, 1 << 31], &Fixed::Floats(vec![0.0; 4]));
            return wrap(&Message::default().text(2, "g").message(5, &held), &[]);
        }
    }
    model.bytes()
}

fn foreign(chance: &mut SplitMix64) -> Vec<u8> {
    let begins: [&[u8]; 6] = [b"\x7fELF\x02\x01\x01", b"PK\x03\x04", b"\x89PNG\r\n\x1a\n", b"GGUF", b"{\"a\": 1}", b""];
    let mut bytes = begins[chance.below(begins.len())].to_vec();
    bytes.extend((0..chance.below(5000)).map(|_| chance.bits() as u8));
    bytes
}

/// Makes the bytes of a file.
type Make = fn(&mut SplitMix64) -> Vec<u8>;

/// Kinds of damage, in turn.
const KINDS: [(&str, Make); 8] = [
    ("cut", cut),
    ("flipped", flipped),
    ("bomb", bomb),
    ("outside", outside),
    ("nan", nan_answers),
    ("labels", label_tables),
    ("shapes", odd_shapes),
    ("foreign", foreign),
];

/// Number of nodes that each model is opened with.
const NODES: usize = 3;

/// Opens the model with all nodes and runs it on images of 1x1 and of the given size; prints the result. Never panics because of the model.
fn child(path: &Path, big: bool) {
    let sizes = if big { [(1usize, 1usize), (8000, 6000)] } else { [(1, 1), (33, 70)] };
    let say = |words: String| println!("ANSWER {}", words.replace('\n', " "));
    match Harness::<Yolo>::from_toml(&format!("params = {{ model = {path:?}, min_score = 0.01 }}")) {
        Err(error) => say(format!("yolo refuses: {error}")),
        Ok(mut node) => {
            for (w, h) in sizes {
                match node.input_image::<Bgr8>("image", w, h, &vec![90; w * h * 3]).process() {
                    Err(error) => say(format!("yolo at {w}x{h}: {error}")),
                    Ok(out) => {
                        let found = out.detections("detections").expect("a run without an error answers");
                        let inside = found.items().iter().all(|d| {
                            d.x_px >= 0.0
                                && d.y_px >= 0.0
                                && d.x_px + d.width_px <= w as f32 + 0.5
                                && d.y_px + d.height_px <= h as f32 + 0.5
                        });
                        assert!(inside, "a box outside the picture");
                        say(format!("yolo at {w}x{h}: {} boxes", found.items().len()));
                    }
                }
            }
        }
    }
    match Harness::<MaskRcnn>::from_toml(&format!("params = {{ model = {path:?}, min_score = 0.01 }}")) {
        Err(error) => say(format!("mask_rcnn refuses: {error}")),
        Ok(mut node) => {
            for (w, h) in sizes {
                match node.input_image::<Bgr8>("image", w, h, &vec![90; w * h * 3]).process() {
                    Err(error) => say(format!("mask_rcnn at {w}x{h}: {error}")),
                    Ok(out) => {
                        let found = out.instances("instances").expect("a run without an error answers");
                        say(format!("mask_rcnn at {w}x{h}: {} instances", found.detections().items().len()));
                    }
                }
            }
        }
    }
    let table = "[inputs.images]\nport = 'image'\nfit = 'letterbox'\n[outputs.output]\nport = 'detections'";
    match Harness::<Onnx>::from_toml(&format!("params = {{ model = {path:?}, table = {table:?}, min_score = 0.01 }}")) {
        Err(error) => say(format!("onnx refuses: {error}")),
        Ok(mut node) => {
            for (w, h) in sizes {
                match node.input_image::<Bgr8>("image", w, h, &vec![90; w * h * 3]).process() {
                    Err(error) => say(format!("onnx at {w}x{h}: {error}")),
                    Ok(out) => {
                        let found = out.detections("detections").expect("a run without an error answers");
                        say(format!("onnx at {w}x{h}: {} boxes", found.items().len()));
                    }
                }
            }
        }
    }
}

/// Time limit of one case: a second for the work, more on a busy machine. Scaled by the time that a healthy model takes here and now.
fn patience(healthy: Duration) -> Duration {
    Duration::from_secs(1) + 4 * healthy
}

/// Output of a child and its duration; an error if it crashed or did not end.
fn ask(program: &Path, model: &Path, big: bool, most: Duration) -> Result<(Vec<String>, Duration), String> {
    let mut command = Command::new(program);
    command.args(["hostile_campaign::child_of_the_campaign", "--exact", "--nocapture", "--ignored"]);
    command.env(CASE, model).env("PANOSCOPE_HOSTILE_BIG", if big { "1" } else { "0" });
    let begun = Instant::now();
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().map_err(|e| e.to_string())?;
    let status = loop {
        match child.try_wait().map_err(|e| e.to_string())? {
            Some(status) => break status,
            None if begun.elapsed() > most => {
                // It may have ended meanwhile.
                let _ = child.kill();
                let _ = child.wait();
                return Err(format!("did not end within {:.1} s", most.as_secs_f64()));
            }
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    };
    let took = begun.elapsed();
    let mut text = String::new();
    if let Some(mut out) = child.stdout.take() {
        std::io::Read::read_to_string(&mut out, &mut text).map_err(|e| e.to_string())?;
    }
    let answers: Vec<String> =
        text.lines().filter_map(|l| l.split_once("ANSWER ").map(|(_, words)| words.to_owned())).collect();
    if !status.success() {
        return Err(format!("ended with {status}: {}", text.lines().last().unwrap_or("")));
    }
    if answers.len() < NODES { Err(format!("said only {answers:?}")) } else { Ok((answers, took)) }
}

/// Started by the campaign in its own process.
#[test]
#[ignore = "started by the campaign"]
fn child_of_the_campaign() {
    let Some(path) = std::env::var_os(CASE) else {
        panoscope_testing::skipped!("no case was named");
        return;
    };
    child(Path::new(&path), std::env::var("PANOSCOPE_HOSTILE_BIG").is_ok_and(|v| v == "1"));
}

#[test]
fn no_model_does_harm() {
    if !runtime_is_there() {
        return;
    }
    let number = |name: &str, otherwise: usize| {
        std::env::var(name).map_or(otherwise, |v| v.parse().unwrap_or_else(|_| panic!("{name} is a number, not {v:?}")))
    };
    let (cases, seed) = (number("PANOSCOPE_HOSTILE_CASES", 16), number("PANOSCOPE_HOSTILE_SEED", 1));
    let home = folder("campaign");
    // What a model may try to reach: it holds no number that a healthy answer holds.
    std::fs::write(home.join(SECRET), [0x7f; 84 * 7 * 4]).expect("written");
    let program = std::env::current_exe().expect("this program");
    let healthy = home.join("healthy");
    std::fs::create_dir_all(&healthy).expect("a folder");
    let model = detector(&mut SplitMix64(1)).write(&healthy, "m.onnx");
    let mut base = Duration::ZERO;
    for big in [false, true] {
        let (answers, took) = ask(&program, &model, big, Duration::from_secs(120)).expect("a healthy model answers");
        assert!(answers[0].contains("boxes") && !answers[0].contains(" 0 boxes"), "{answers:?}");
        base = base.max(took);
    }
    let mut failures = Vec::new();
    let mut refused = 0;
    let mut slowest = (Duration::ZERO, String::new());
    for case in 0..cases {
        let mut chance = SplitMix64((seed as u64) << 32 | case as u64);
        let (kind, make) = KINDS[case % KINDS.len()];
        let place = home.join(format!("case{case}"));
        std::fs::create_dir_all(&place).expect("a folder");
        #[cfg(unix)]
        std::os::unix::fs::symlink(home.join(SECRET), place.join("link.bin")).expect("linked");
        let path: PathBuf = place.join("m.onnx");
        std::fs::write(&path, make(&mut chance)).expect("written");
        match ask(&program, &path, case % 20 == 4, patience(base)) {
            Err(reason) => failures.push(format!("case {case} ({kind}): {reason}")),
            Ok((answers, took)) => {
                let words = answers.iter().filter(|a| a.contains("refuses"));
                refused += usize::from(words.clone().count() == NODES);
                // A refusal names the file, so that one knows which to mend.
                if let Some(bad) = words.clone().find(|a| !a.contains("m.onnx")) {
                    failures.push(format!("case {case} ({kind}): the refusal names no file: {bad}"));
                }
                if kind == "outside" && words.count() != NODES {
                    failures.push(format!("case {case} ({kind}): opened: {answers:?}"));
                }
                if took > slowest.0 {
                    slowest = (took, format!("case {case} ({kind})"));
                }
            }
        }
    }
    println!(
        "{cases} models from seed {seed}: {refused} refused, {} answered, {} failures; healthy {:.2} s, slowest {:.2} s: {}",
        cases - refused - failures.len().min(cases - refused),
        failures.len(),
        base.as_secs_f64(),
        slowest.0.as_secs_f64(),
        slowest.1
    );
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
