//! Permissions of the process that guards an arm: real-time priority, locked memory, a folder for latched stops.

use std::process::{Command, Stdio};

use super::State;
use crate::beside;

/// The guard's program.
const PROGRAM: &str = "panoscope-arm";

/// Lines of the report: state, name, and remedy.
pub type Lines = Vec<(State, String, String)>;

/// Runs the guard's program, because its permissions can differ from those of this program.
pub fn lines() -> Lines {
    let absent = |words: String| vec![(State::Optional, PROGRAM.to_owned(), words)];
    let program = beside::file(PROGRAM).unwrap_or_default();
    if !program.is_file() {
        return absent(format!("graphs with `arm_serial` or `arm_ur` need it: {} does not exist", program.display()));
    }
    let output = Command::new(&program).arg("--check").stdin(Stdio::null()).stderr(Stdio::null()).output();
    let text = match output {
        Ok(output) => String::from_utf8_lossy(&output.stdout).into_owned(),
        Err(error) => return absent(format!("{} cannot be started: {error}", program.display())),
    };
    match text.lines().map(read).collect::<Option<Lines>>() {
        Some(lines) if !lines.is_empty() => lines,
        _ => absent(format!("{} does not report; it belongs to another version of Panoscope", program.display())),
    }
}

/// Reads a line of `panoscope-arm --check`: `ok` or `absent`, name and details, separated by tabs.
fn read(line: &str) -> Option<(State, String, String)> {
    let mut parts = line.split('\t');
    let state = match parts.next()? {
        "ok" => State::Fine,
        "absent" => State::Optional,
        _ => return None,
    };
    Some((state, parts.next()?.to_owned(), parts.next()?.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_arm_guard::check::Check;
    use panoscope_arm_guard::realtime::{self, Granted};

    #[test]
    fn what_the_guard_writes_is_read() {
        let check = Check {
            granted: Granted { locked_memory: true, real_time: false },
            priority_limit: Some(0),
            memory_limit_kib: None,
            folder: "/somewhere/arms".into(),
            folder_problem: Some("no space\tleft".to_owned()),
        };
        let mut text = Vec::new();
        check.write(&mut text).expect("memory");
        let text = String::from_utf8(text).expect("text");
        let lines = text.lines().map(read).collect::<Option<Lines>>().expect("lines");
        assert_eq!(lines.len(), check.findings().len());
        for (line, (is_fine, what, about)) in lines.iter().zip(check.findings()) {
            assert_eq!((line.0 == State::Fine, line.1.as_str(), &line.2), (is_fine, what, &about.replace('\t', " ")));
        }
        assert!(read("real_time=true").is_none());
        assert_eq!(super::super::PRIORITY, realtime::PRIORITY);
    }
}
