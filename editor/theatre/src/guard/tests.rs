//! Processes that misbehave: scripts that say what a test wrote into a file.

use super::*;
use crate::link::{self, Block, Message, Picture};
use crate::{Plan, Verified};

use std::os::unix::fs::PermissionsExt;

/// Sends the messages and sleeps.
const ONCE: &str = "#!/bin/sh\ncat \"$0.bytes\" >&0\nexec sleep 1000\n";
/// Sends the messages again and again.
const ALWAYS: &str = "#!/bin/sh\nwhile cat \"$0.bytes\" >&0; do sleep 0.05; done\n";

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A guard of a script that sends bytes.
fn guard(name: &str, script: &str, bytes: &[u8]) -> (Guard, Folder) {
    let folder = std::env::temp_dir().join(format!("panoscope_guard_{name}_{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    let file = folder.join("worker");
    std::fs::write(folder.join("worker.bytes"), bytes).expect("written");
    std::fs::write(&file, script).expect("written");
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755)).expect("it may be run");
    let program = Program { file, arguments: Vec::new() };
    (Guard::new(program, folder.join("g.toml")).expect("a thread"), Folder(folder))
}

fn bytes(messages: &[Message]) -> Vec<u8> {
    let mut bytes = Vec::new();
    messages.iter().for_each(|message| link::send(&mut bytes, message).expect("memory takes it"));
    bytes
}

/// What the guard says about a process that was asked to check a graph.
fn refused(name: &str, script: &str, messages: &[u8]) -> String {
    let (guard, _folder) = guard(name, script, messages);
    guard.prepare("", &GraphOptions::default());
    guard.wait_prepared().expect_err("it cannot be opened").message
}

#[test]
fn a_process_that_falls_silent_is_ended() {
    let said = refused("silent", ONCE, &bytes(&[Message::Beat { rounds: 1 }]));
    assert_eq!(said, "the process that runs the graph did not answer for one second and was ended");
}

#[test]
fn a_process_may_end_slowly() {
    let script = "#!/bin/sh\ncat \"$0.bytes\" >&0\nsleep 2\ntouch \"$0.done\"\n";
    let (mut guard, folder) = guard("slow_end", script, &bytes(&[Message::Beat { rounds: 1 }]));
    guard.prepare("", &GraphOptions::default());
    let until = Instant::now() + Duration::from_secs(60);
    while guard.processes().0.is_none() {
        assert!(Instant::now() < until, "no process is started");
        std::thread::sleep(Duration::from_millis(10));
    }
    guard.close();
    assert!(folder.0.join("worker.done").exists(), "it was ended before its files were finished");
}

#[test]
fn a_process_that_sends_nonsense_is_ended() {
    let said = refused("nonsense", ONCE, b"\x05\0\0\0{\"x\":");
    assert_eq!(said, "the process that runs the graph sent a malformed message and was ended");
    let picture = Picture {
        output: Output::new("a", "b"),
        size_px: (1, 1),
        text: String::new(),
        seq: 0,
        source: 0,
        age_ns: None,
        made_ns: 0,
        pixels: Some(Block { slot: link::SLOTS, width: 1, height: 1 }),
        cloud: None,
        rig: None,
    };
    let said = refused("picture", ONCE, &bytes(&[Message::Picture(Box::new(picture))]));
    assert_eq!(said, "the process that runs the graph sent a malformed picture and was ended");
}

#[test]
fn a_program_that_ends_or_is_missing_is_named() {
    let said = refused("ends", "#!/bin/sh\nexit 3\n", b"");
    assert_eq!(said, "the process that runs the graph ended by itself (exit code 3)");
    let said = refused("missing", "#!/no/such/shell\n", b"");
    assert!(said.starts_with("the process that runs the graph could not be started: "), "{said}");
}

#[test]
fn a_process_that_lives_but_is_stuck_is_replaced() {
    let opened = Opened {
        plan: Plan::default(),
        verified: Verified::Never,
        text: String::new(),
        lock: None,
        overridden: None,
        sealed: false,
    };
    let messages = bytes(&[Message::Prepared(Ok(Some(Box::new(opened)))), Message::Beat { rounds: 7 }]);
    let (guard, _folder) = guard("stuck", ALWAYS, &messages);
    guard.prepare("", &GraphOptions::default());
    let opened = guard.wait_prepared().expect("it says that it can be opened");
    let first = guard.processes().0;
    guard.begin("", &GraphOptions::default(), &opened);
    guard.run("");
    let state = || lock(&guard.owner.shared.state).recovery.outage(Instant::now());
    let until = Instant::now() + Duration::from_secs(60);
    while state().is_none() {
        assert!(Instant::now() < until, "nothing is noticed");
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(state().expect("an outage").why.english(), "was stuck for five seconds and was ended");
    while guard.processes().0.is_none() {
        assert!(Instant::now() < until, "no other process is started");
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_ne!(guard.processes().0, first);
    // A picture never comes, so the camera is not claimed to be there.
    assert_eq!(state().expect("an outage").stage, crate::OutageStage::Dark);
}
