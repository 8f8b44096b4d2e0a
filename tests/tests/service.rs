//! The systemd unit that runs a graph as a service.

use std::path::Path;
use std::process::Command;

use panoscope_tests::{root, scratch};

const UNIT: &str = "core/xtask/package/panoscope@.service";

/// The text of the unit, with the program replaced by one that every system has.
fn unit() -> String {
    let text = std::fs::read_to_string(root().join(UNIT)).expect("the unit");
    text.replace("/usr/bin/panoscope run", "/bin/true run")
}

#[test]
fn systemd_accepts_the_unit() {
    if Command::new("systemd-analyze").arg("--version").output().is_err() {
        panoscope_testing::skipped!("there is no systemd-analyze");
        return;
    }
    let folder = scratch("service");
    let verify = |text: &str| {
        let file = folder.join("panoscope@surgeon.service");
        std::fs::write(&file, text).expect("a file");
        let output = Command::new("systemd-analyze").args(["verify", "--man=no"]).arg(&file).output().expect("it runs");
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        // Units of this system may have remarks of their own.
        words.lines().filter(|line| line.contains("panoscope")).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(verify(&unit()), Vec::<String>::new());
    let wrong = unit().replace("ProtectSystem=strict", "ProtectSystm=strict");
    assert!(verify(&wrong).iter().any(|line| line.contains("ProtectSystm")), "a misspelt setting is found");
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn the_unit_runs_a_graph_that_ships_with_options_of_run() {
    let text = unit();
    let value = |key: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(key));
        line.unwrap_or_else(|| panic!("no {key}"))
    };
    assert_eq!(value("ExecStart="), "/bin/true run ${GRAPH} --headless --log-format json $OPTIONS");
    assert_eq!(value("StartLimitIntervalSec="), "0", "it waits for a camera however long");
    let example = text.lines().next().expect("a first line");
    let graph = example.split('`').nth(1).and_then(|command| command.split('@').nth(1)).expect("an example");
    assert!(root().join(format!("graphs/{graph}.toml")).is_file(), "{graph}");
    assert!(Path::new(value("Environment=GRAPH=")).starts_with("/usr/share/panoscope/graphs"));
}
