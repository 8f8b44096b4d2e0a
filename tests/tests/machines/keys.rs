//! Machines with certificates: who may connect, and much traffic over one encrypted connection.

use std::path::{Path, PathBuf};
use std::process::Command;

use panoscope_tests::machines::{Machine, free_port, program};
use panoscope_tests::scratch;

use super::{ONE, PATIENT, machine};

/// Creates keys for machines; `None` if there is no program.
pub(super) fn keys(folder: &Path, names: &[&str]) -> Option<PathBuf> {
    let keys = folder.join("keys");
    let made = Command::new(program()?).arg("keys").arg(&keys).args(names).output().expect("it runs");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    Some(keys)
}

/// Runs a graph with the keys of a host, in a separate process, because the environment variable belongs to the process.
fn run_as(folder: &Path, keys: &Path, text: &str) -> (bool, String) {
    run_frames_as(folder, keys, text, 20)
}

/// The same with a number of frames.
fn run_frames_as(folder: &Path, keys: &Path, text: &str, frames: u64) -> (bool, String) {
    let graph = folder.join("graph.toml");
    std::fs::write(&graph, text).expect("a file");
    let mut command = Command::new(program().expect("a program"));
    command.args(["run", "--headless", "--frames", &frames.to_string()]).arg(&graph).env("PANOSCOPE_KEYS", keys);
    let done = command.output().expect("it runs");
    (done.status.success(), String::from_utf8_lossy(&done.stdout).into_owned() + &String::from_utf8_lossy(&done.stderr))
}

#[test]
fn only_machines_with_certificates_and_permission_connect() {
    let folder = scratch("machines-keys");
    let Some(keys) = keys(&folder, &["theatre", "ward", "rack=127.0.0.1"]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let strangers = folder.join("strangers");
    std::fs::create_dir_all(&strangers).expect("a folder");
    let strangers = self::keys(&strangers, &["theatre"]).expect("a program");
    let address = format!("tls/127.0.0.1:{}", free_port());
    let rack = keys.join("rack").display().to_string();
    let machines = ["--allow", "theatre", "--keys", &rack];
    let _rack = Machine::start(&[], "rack", &address, &machines, &folder).expect("a program");
    let text = ONE.to_owned() + &machine(&address, PATIENT);
    let (done, words) = run_as(&folder, &keys.join("theatre"), &text);
    assert!(done, "{words}");
    let (done, words) = run_as(&folder, &keys.join("ward"), &text);
    assert!(!done && words.contains("does not --allow this host"), "{words}");
    let (done, words) = run_as(&folder, &strangers.join("theatre"), &text);
    assert!(!done && words.contains("certificates of one authority"), "{words}");
    let (done, words) = run_as(&folder, &folder, &text);
    assert!(!done && words.contains("panoscope keys"), "{words}");
    let plain = text.replace("tls/", "tcp/");
    let (done, words) = run_as(&folder, &keys.join("theatre"), &plain);
    assert!(!done, "a server with certificates takes no host without: {words}");
    let _ = std::fs::remove_dir_all(&folder);
}

/// zenoh reads and writes a TLS connection from two threads without a lock; with the traffic of this graph that crashed or lost messages.
#[test]
fn many_pictures_pass_both_ways_through_one_encrypted_connection() {
    let folder = scratch("machines-busy-keys");
    let Some(keys) = keys(&folder, &["theatre", "rack=127.0.0.1"]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let address = format!("tls/127.0.0.1:{}", free_port());
    let rack = keys.join("rack").display().to_string();
    let rack = Machine::start(&[], "rack", &address, &["--allow", "theatre", "--keys", &rack], &folder);
    let mut text = "mode = \"batch\"\nplugins = [\"flow\", \"phantom\"]\n".to_owned();
    text += "[nodes.scope]\ntype = \"frames\"\nparams = { width_px = 640, height_px = 480, rate_hz = 1000.0 }\n";
    for at in 0..4 {
        text += &format!("[nodes.far{at}]\ntype = \"smooth\"\non = \"rack\"\nparams = {{ past_weight = 0 }}\n");
        text += "inputs = { image = \"scope.image\", past = \"scope.image\" }\n";
        text += &format!("[nodes.end{at}]\ntype = \"drain\"\ninputs = {{ image = \"far{at}.image\" }}\n");
    }
    text += &machine(&address, PATIENT);
    let (done, words) = run_frames_as(&folder, &keys.join("theatre"), &text, 100);
    assert!(done, "{words}\n{:?}", rack.expect("a program").log());
    let _ = std::fs::remove_dir_all(&folder);
}
