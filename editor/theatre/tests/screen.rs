//! The program itself on a virtual screen: its two processes, their ends, and what is left of them.

use crate::common;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::program::{Running, Screen, children, signal, until_gone};
use crate::common::window::GRAPH;
use crate::common::{Folder, has_plugin};
use crate::video::whole_frames;
use panoscope_host::audit::{Event, read};

fn events(running: &Running) -> Vec<Event> {
    let report = read(&running.log()).expect("the log");
    assert!(report.problems.is_empty(), "{report:?}");
    report.entries.into_iter().map(|entry| entry.event).collect()
}

/// Waits until the log has an event.
fn until_logged(running: &mut Running, what: &str, is: impl Fn(&Event) -> bool) {
    let until = Instant::now() + common::PATIENCE;
    while !running.log().is_dir() || !events(running).iter().any(&is) {
        assert!(running.end().is_none(), "it has ended: {what}");
        assert!(Instant::now() < until, "{what}: {:?}", events(running));
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The files that a process has mapped to run code of them.
fn code_of(pid: i32) -> String {
    let maps = std::fs::read_to_string(format!("/proc/{pid}/maps")).expect("it runs");
    maps.lines().filter(|line| line.contains("r-xp")).map(|line| format!("{line}\n")).collect()
}

#[test]
fn the_window_loads_no_plugin_and_is_the_last_to_lose_its_memory() {
    if !has_plugin("flow") {
        return;
    }
    let Some(screen) = Screen::start() else { return };
    let mut running = Running::start(&screen, Folder::new("screen_code"), GRAPH, &[]);
    let workers = running.until_workers(2);
    until_logged(&mut running, "it is opened", |event| matches!(event, Event::Opened { .. }));
    assert!(code_of(workers[0]).contains("memfd:libflow.so"), "{}", code_of(workers[0]));
    let own = code_of(running.pid());
    assert!(!own.contains("memfd:lib") && !own.contains("opencv"), "{own}");
    // The second may have just started.
    let until = Instant::now() + common::PATIENCE;
    let score = |pid: i32| std::fs::read_to_string(format!("/proc/{pid}/oom_score_adj")).expect("it runs");
    for pid in workers {
        while score(pid).trim() != "500" {
            assert!(Instant::now() < until, "process {pid}: {}", score(pid));
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// Waits until the views are shown and go on: together they cover more than half of the screen, and every image of their cameras differs from the
/// last one in every pixel. An outage that begins or ends changes the screen too, but less often.
fn until_views(running: &mut Running, screen: &Screen) {
    const CHANGES: usize = 8;
    let until = Instant::now() + common::PATIENCE;
    let is_bright = |pixel: &[u8; 4]| pixel[..3].iter().all(|value| *value > 24);
    let (mut last, mut changes, mut is_shown) = (screen.pixels(), 0, false);
    while changes < CHANGES || !is_shown {
        std::thread::sleep(Duration::from_millis(100));
        let now = screen.pixels();
        let changed = now.iter().zip(&last).filter(|(now, last)| now != last).count();
        // What is around the views is nearly black, and they are grey, but for a part that is dark and wanders.
        let bright = now.iter().filter(|pixel| is_bright(pixel)).count();
        let views = now.len() / 2;
        if changed > views {
            changes += 1;
            is_shown |= bright > views;
        }
        assert!(running.end().is_none(), "it has ended");
        assert!(Instant::now() < until, "{changes} changes; {bright} of {} pixels are bright", now.len());
        last = now;
    }
}

#[test]
fn the_window_outlives_its_process_and_shows_pictures_again() {
    if !has_plugin("flow") {
        return;
    }
    let Some(screen) = Screen::start() else { return };
    let mut running = Running::start(&screen, Folder::new("screen_kill"), GRAPH, &[]);
    let pids = running.until_workers(2);
    until_views(&mut running, &screen);
    signal(pids[0], "KILL");
    until_logged(&mut running, "the crash", |event| matches!(event, Event::ProcessEnded { .. }));
    until_views(&mut running, &screen);
    signal(running.pid(), "TERM");
    assert!(running.until_end().success());
    until_gone(&pids);
    let all = events(&running);
    assert!(
        matches!(&all[..], [Event::Opened { .. }, Event::ProcessEnded { cause }, Event::Closed] if cause.contains("SIGKILL")),
        "{all:?}"
    );
}

/// Waits until a video has some whole frames.
fn until_frames(running: &mut Running, film: &Path) {
    let until = Instant::now() + common::PATIENCE;
    while std::fs::read(film).map_or(0, |bytes| whole_frames(&bytes).0) < 10 {
        assert!(running.end().is_none(), "it has ended");
        assert!(Instant::now() < until, "{} has no frames", film.display());
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_killed_process_takes_nothing_of_the_video_with_it() {
    if !has_plugin("flow") || !has_plugin("sinks") {
        return;
    }
    let Some(screen) = Screen::start() else { return };
    let text = GRAPH.replace("\"fixtures\"]", "\"fixtures\", \"sinks\"]")
        + "\n[nodes.film]\ntype = \"write_video\"\ninputs = { image = \"camera.image\" }\nparams = { path = \"film.mkv\" }\n";
    let mut running = Running::start(&screen, Folder::new("screen_film"), &text, &[]);
    let pids = running.until_workers(2);
    let [film, next] = ["film.mkv", "film.part2.mkv"].map(|name| running.folder.0.join(name));
    until_frames(&mut running, &film);
    let seen = std::fs::read(&film).expect("the video");
    signal(pids[0], "KILL");
    until_gone(&pids[..1]);
    let left = std::fs::read(&film).expect("the video");
    assert!(left.starts_with(&seen), "what was written stays");
    until_frames(&mut running, &next);
    signal(running.pid(), "TERM");
    assert!(running.until_end().success());
    assert!(std::fs::read(&film).expect("the video") == left, "the next process leaves it alone");
    // The part that was completed has an index behind its frames.
    let bytes = std::fs::read(&next).expect("the next part");
    let (frames, end) = whole_frames(&bytes);
    assert!(
        frames >= 10 && bytes[end..].starts_with(&[0x1C, 0x53, 0xBB, 0x6B]),
        "{frames} frames, then {:02x?}",
        &bytes[end..]
    );
}

#[test]
fn a_screenshot_is_written_and_ends_the_window() {
    if !has_plugin("flow") {
        return;
    }
    let Some(screen) = Screen::start() else { return };
    let folder = Folder::new("screen_shot");
    let picture = folder.0.join("shot.png");
    let words = ["--screenshot", picture.to_str().expect("a plain path"), "--after", "3"];
    let mut running = Running::start(&screen, folder, GRAPH, &words);
    assert!(running.until_end().success());
    let shown = image::open(&picture).expect("a screenshot").to_rgb8();
    // Words and buttons, whether or not images came in this time.
    assert!(shown.pixels().any(|p| p.0.iter().all(|value| *value > 200)), "something is drawn");
    assert_eq!(events(&running).last(), Some(&Event::Closed));
}

#[test]
fn a_killed_window_leaves_no_process() {
    if !has_plugin("flow") {
        return;
    }
    let Some(screen) = Screen::start() else { return };
    let mut running = Running::start(&screen, Folder::new("screen_gone"), GRAPH, &[]);
    let pids = running.until_workers(2);
    // Even a stopped one goes on, to end.
    signal(pids[0], "STOP");
    signal(running.pid(), "KILL");
    running.until_end();
    until_gone(&pids);
}

#[test]
fn a_signal_ends_the_window_and_its_processes_in_good_order() {
    if !has_plugin("flow") {
        return;
    }
    let Some(screen) = Screen::start() else { return };
    let mut running = Running::start(&screen, Folder::new("screen_term"), GRAPH, &[]);
    let pids = running.until_workers(2);
    signal(running.pid(), "TERM");
    assert!(running.until_end().success());
    until_gone(&pids);
    assert!(children(running.pid()).is_empty());
    assert_eq!(events(&running).last(), Some(&Event::Closed));
}

#[test]
fn a_process_of_the_theatre_cannot_be_started_by_hand() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_panoscope-theatre"))
        .args(["theatre-worker", "9", "g.toml"])
        .stdin(std::process::Stdio::null())
        .output()
        .expect("it starts");
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains("`theatre-worker` is started by the theatre only"), "{text}");
}

#[test]
fn without_a_screen_the_program_says_what_to_do() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_panoscope-theatre"))
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/../../graphs/panorama.toml"))
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("WAYLAND_SOCKET")
        .output()
        .expect("it starts");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && text.contains("this session has no screen"), "{text}");
}
