//! The audit log, which may have been changed.

use std::path::Path;

use panoscope_host::audit::{Event, Log, read};
use panoscope_host::loader::sealed::Fingerprint;

use crate::scratch;

/// Separates the head from the lines.
const HEAD: &[u8] = b"\n--\n";

/// A line with a correct hash, which the fuzzer cannot guess. `None` if the line is not an object.
fn sealed(line: &[u8]) -> Option<Vec<u8>> {
    let text = std::str::from_utf8(line).ok()?;
    let body = match text.find(",\"hash\":") {
        Some(at) => format!("{}}}", &text[..at]),
        None => text.to_owned(),
    };
    let start = body.strip_suffix('}')?;
    Some(format!("{start},\"hash\":\"{}\"}}", Fingerprint::of(body.as_bytes()).sha256).into_bytes())
}

fn check(file: &Path, lines: usize) {
    let report = read(file).expect("the file can be read");
    assert!(report.entries.len() + report.problems.len() <= 4 * lines + 2, "{} problems", report.problems.len());
    for problem in &report.problems {
        assert!(problem.line <= lines + 1 && problem.to_string().contains("/audit/"), "{problem}");
    }
    report.entries.iter().for_each(|entry| assert!(!entry.to_string().contains('\n'), "one line each"));
}

pub fn run(bytes: &[u8]) {
    let folder = scratch::path("audit");
    let _ = std::fs::remove_dir_all(&folder);
    let outside = scratch::file("outside.jsonl", b"");
    // A first line in front of `HEAD` is the head, which says where the log goes on.
    let (head, bytes) = match bytes.windows(HEAD.len()).position(|window| window == HEAD) {
        Some(at) => (Some(&bytes[..at]), &bytes[at + HEAD.len()..]),
        None => (None, bytes),
    };
    let lines = bytes.split(|byte| *byte == b'\n').count();
    let file = scratch::file("audit/audit-2026-01-02.jsonl", bytes);
    check(&file, lines);
    if let Some(head) = head {
        scratch::file("audit/head.json", head);
    }
    let parts: Vec<Vec<u8>> =
        bytes.split(|byte| *byte == b'\n').map(|line| sealed(line).unwrap_or_else(|| line.to_vec())).collect();
    let file = scratch::file("audit/audit-2026-01-02.jsonl", &parts.join(&b'\n'));
    check(&file, lines);
    check(&folder, lines);
    // Whatever is there, the next event is written and read again.
    let before = read(&folder).expect("the folder can be read").entries.len();
    let log = Log::new(&folder);
    if log.append(1_767_312_000_000, Event::EmergencyStop { stopped: true }).is_ok() {
        let after = read(&folder).expect("the folder can be read");
        assert!(after.entries.len() > before, "{before} lines, then {}", after.entries.len());
        assert!(after.entries.iter().any(|entry| entry.event == Event::EmergencyStop { stopped: true }));
    }
    assert_eq!(std::fs::read(outside).expect("it is there"), b"", "written outside the folder");
}

pub fn seeds() -> Vec<Vec<u8>> {
    let folder = scratch::path("audit-seeds");
    let _ = std::fs::remove_dir_all(&folder);
    let log = Log::new(&folder);
    for _ in 0..3 {
        log.append(1_767_312_000_000, Event::EmergencyStop { stopped: true }).expect("written");
    }
    let written = std::fs::read_dir(&folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let written = written.filter(|path| path.extension().is_some_and(|e| e == "jsonl"));
    let good = written.map(|path| std::fs::read(path).expect("its own file")).next().unwrap_or_default();
    let text = String::from_utf8_lossy(&good).into_owned();
    vec![
        good.clone(),
        good[..good.len() - 7].to_vec(),
        text.replace("\"line\":2", "\"line\":18446744073709551615").into_bytes(),
        text.replace("\"unix_ms\":1767312000000", "\"unix_ms\":-9223372036854775808").into_bytes(),
        [
            format!(
                "{{\"number\":3,\"hash\":\"{}\",\"file\":\"audit-2026-01-02.jsonl\",\"bytes\":{}}}",
                "0".repeat(64),
                good.len()
            )
            .as_bytes(),
            HEAD,
            &good[..],
        ]
        .concat(),
        [br#"{"number":18446744073709551615,"hash":"0","file":"../outside.jsonl","bytes":0}"#, HEAD, &good[..]]
            .concat(),
        text.lines().rev().collect::<Vec<_>>().join("\n").into_bytes(),
        b"{}\n{\"line\":1}\n".to_vec(),
        Vec::new(),
    ]
}
