//! A kill at any moment while saving, writing a still or recording a clip leaves no partial file; a graph in which everything fails does not
//! take the window down.

use crate::common;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::common::{Folder, Window, has_plugin};
use eframe::egui::{Key, Modifiers};
use panoscope_editor_model::disk;
use panoscope_editor_model::pixels::Pixels;
use panoscope_editor_model::session::Session;
use panoscope_theatre::{with_clip, write_still};

const CHILD: &str = "PANOSCOPE_TEST_SAVE_FOREVER";

fn text(letter: char) -> String {
    format!("# {letter}\n{}", format!("{}\n", letter.to_string().repeat(99)).repeat(4000))
}

#[test]
fn a_kill_while_saving_leaves_a_whole_file() {
    if let Some(path) = std::env::var_os(CHILD) {
        let (path, texts) = (PathBuf::from(path), ['a', 'b'].map(text));
        loop {
            texts.iter().for_each(|text| disk::save(&path, text).expect("it is saved"));
        }
    }
    let folder = std::env::temp_dir().join(format!("panoscope_kill_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("temporary files can be written");
    let (path, texts) = (folder.join("g.toml"), ['a', 'b'].map(text));
    disk::save(&path, &texts[0]).expect("it is saved");
    let (mut kills, mut saves) = (0u64, 0);
    while kills < 30 {
        let this = std::env::current_exe().expect("a test has a file");
        let mut child = Command::new(this)
            .args(["--exact", "kill::a_kill_while_saving_leaves_a_whole_file", "--nocapture"])
            .env(CHILD, &path)
            .stdout(std::process::Stdio::null())
            .spawn()
            .expect("it starts");
        let before = std::fs::metadata(&path).and_then(|m| m.modified()).ok();
        // Evenly spaced times hit all parts of a save.
        std::thread::sleep(Duration::from_micros(40_000 + kills * 1_370));
        child.kill().expect("it is killed");
        child.wait().expect("it ended");
        kills += 1;
        saves += u64::from(before != std::fs::metadata(&path).and_then(|m| m.modified()).ok());
        let now = std::fs::read_to_string(&path).expect("the file is there");
        assert!(texts.contains(&now), "half a file after kill {kills}: {} bytes", now.len());
        let kept = std::fs::read_to_string(disk::backup_of(&path)).unwrap_or_else(|_| texts[0].clone());
        assert!(texts.contains(&kept), "half a backup after kill {kills}: {} bytes", kept.len());
    }
    assert!(saves > 0, "nothing was saved in between");
    std::fs::remove_dir_all(&folder).expect("it is removed");
}

/// Starts this test in a process of its own with a variable set to a file, and kills it some time after that file has `bytes`.
fn kill_after(test: &str, variable: &str, value: &Path, bytes: u64, after: Duration) {
    let this = std::env::current_exe().expect("a test has a file");
    let mut child = Command::new(this)
        .args(["--exact", test, "--nocapture"])
        .env(variable, value)
        .stdout(std::process::Stdio::null())
        .spawn()
        .expect("it starts");
    let until = Instant::now() + common::PATIENCE;
    while std::fs::metadata(value).map_or(0, |m| m.len()) < bytes && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(after);
    child.kill().expect("it is killed");
    child.wait().expect("it ended");
}

const STILLS: &str = "PANOSCOPE_TEST_STILLS_FOREVER";

#[test]
fn a_kill_while_keeping_a_still_leaves_whole_pictures() {
    let picture = |value: u8| Pixels { width: 320, height: 240, rgba: [value, 7, 9, 255].repeat(320 * 240) };
    if let Some(path) = std::env::var_os(STILLS) {
        let path = PathBuf::from(path);
        for value in (0..=255).cycle() {
            write_still(&path, &picture(value)).expect("it is kept");
        }
    }
    let folder = Folder::new("kill_still");
    let path = folder.0.join("still_0001.png");
    for kill in 0..12u64 {
        let after = Duration::from_micros(kill * 2_310);
        kill_after("kill::a_kill_while_keeping_a_still_leaves_whole_pictures", STILLS, &path, 1, after);
        let found = image::open(&path).unwrap_or_else(|e| panic!("half a picture after kill {kill}: {e}"));
        let rgb = found.to_rgb8().into_raw();
        assert!(rgb.chunks_exact(3).all(|p| p == &rgb[..3]), "two pictures in one after kill {kill}");
        std::fs::remove_file(&path).expect("it was kept");
    }
}

const CLIP: &str = "PANOSCOPE_TEST_CLIP_FOREVER";
const CLIPPED: &str = "name = \"clip\"\nplugins = [\"flow\"]\n[nodes.camera]\ntype = \"frames\"\nparams = { width_px = 320, height_px = 240, rate_hz = 200.0 }\n";

/// Frames of a clip that was cut off anywhere: every one but the last must be a whole JPEG.
fn whole_frames(bytes: &[u8]) -> usize {
    const CLUSTER: [u8; 4] = [0x1F, 0x43, 0xB6, 0x75];
    assert!(bytes.is_empty() || bytes.starts_with(&[0x1A, 0x45, 0xDF, 0xA3]), "no Matroska");
    let Some(mut at) = bytes.windows(4).position(|w| w == CLUSTER) else { return 0 };
    let mut frames = 0;
    while let Some(size) = bytes.get(at + 4..at + 12) {
        assert_eq!(bytes[at..at + 4], CLUSTER, "something between two frames at {at}");
        let size = u64::from_be_bytes(size.try_into().expect("eight bytes")) & !(0xFF << 56);
        let Some(body) = bytes.get(at + 12..at + 12 + size as usize) else { break };
        let jpeg = body.windows(2).position(|w| w == [0xFF, 0xD8]).map(|start| &body[start..]);
        let jpeg = jpeg.unwrap_or_else(|| panic!("frame {frames} is not a JPEG"));
        assert!(jpeg.ends_with(&[0xFF, 0xD9]), "frame {frames} is cut off inside");
        frames += 1;
        at += 12 + size as usize;
    }
    frames
}

#[test]
fn a_kill_while_recording_keeps_every_whole_frame() {
    if let Some(path) = std::env::var_os(CLIP) {
        let path = PathBuf::from(path);
        let (text, _) = with_clip(CLIPPED, &panoscope_editor_model::observe::Output::new("camera", "image"), &path)
            .expect("it is a graph");
        let session = Session::new(&path.with_extension("toml"), &[], None).expect("threads");
        session.run(&text);
        loop {
            std::thread::sleep(Duration::from_secs(60));
        }
    }
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let folder = Folder::new("kill_clip");
    let mut most = 0;
    for kill in 0..6u64 {
        let path = folder.0.join(format!("clip_{kill}.mkv"));
        // Times that lie apart evenly fall on all parts of a frame, whose period is 5 ms.
        let after = Duration::from_micros(kill * 7_370);
        kill_after("kill::a_kill_while_recording_keeps_every_whole_frame", CLIP, &path, 60_000, after);
        let frames = std::fs::read(&path).map_or(0, |bytes| whole_frames(&bytes));
        most = most.max(frames);
    }
    assert!(most > 5, "at most {most} frames");
}

#[test]
fn a_graph_in_which_everything_fails_takes_no_window_down() {
    if !has_plugin("flow") {
        return;
    }
    let mut text = "plugins = [\"flow\", \"fixtures\"]\n[nodes.camera]\ntype = \"frames\"\nparams = { width_px = 32, height_px = 24, rate_hz = 50.0 }\n".to_owned();
    for (k, how) in ["panic", "error"].iter().enumerate() {
        text += &format!(
            "[nodes.f{k}]\ntype = \"failing\"\ninputs = {{ image = \"camera.image\" }}\nparams = {{ how = \"{how}\", first = 2, ticks = 1000000 }}\n"
        );
        text += &format!("[nodes.s{k}]\ntype = \"drain\"\ninputs = {{ image = \"f{k}.image\" }}\n");
    }
    let folder = Folder::new("all_fail");
    let mut window = Window::run(&folder.write("g.toml", &text));
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(2) {
        window.key(Modifiers::NONE, Key::N);
        window.key(Modifiers::NONE, Key::M);
        std::thread::sleep(Duration::from_millis(20));
    }
    let engine = window.app().session().handle().engine().expect("it runs");
    let report = engine.report();
    assert!(report.nodes["camera"].count > 20 && !engine.is_finished());
    assert!(report.nodes["f0"].faults > 0 && report.nodes["f1"].faults > 0);
}

#[test]
fn a_model_that_ends_its_reader_takes_no_window_down() {
    if !has_plugin("flow") || !has_plugin("fixtures") {
        return;
    }
    let folder = Folder::new("bad_model");
    for text in ["good", "abort"] {
        std::fs::write(folder.0.join(format!("{text}.onnx")), text).expect("temporary files can be written");
    }
    let graph = |model: &str| {
        format!(
            "plugins = [\"flow\", \"fixtures\"]\n[nodes.camera]\ntype = \"frames\"\nparams = {{ width_px = 32, height_px = 24, rate_hz = 50.0 }}\n\
             [nodes.net]\ntype = \"model_reader\"\ninputs = {{ image = \"camera.image\" }}\nparams = {{ model = \"{model}.onnx\" }}\n\
             [nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"net.image\" }}\n"
        )
    };
    let session = Session::new(&folder.0.join("g.toml"), &[], None).expect("threads");
    let settled = |session: &Session| {
        let until = Instant::now() + common::PATIENCE;
        while session.status().busy && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(2));
        }
        session.status()
    };
    for running in [false, true] {
        session.run(&graph("abort"));
        let problem = settled(&session).problem.expect("the model is refused");
        assert!(problem.message.contains("abort.onnx") && problem.message.contains("SIGABRT"), "{problem:?}");
        assert_eq!(problem.node.as_deref(), Some("net"));
        assert_eq!(session.status().running.contains("good.onnx"), running, "the old graph keeps running");
        session.run(&graph("good"));
        assert_eq!(settled(&session).problem, None);
    }
}
