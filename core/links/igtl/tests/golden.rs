//! Our bytes are those of the OpenIGTLink library and of pyigtl, byte for byte, and theirs are read as what was
//! written.

use std::path::Path;
use std::process::Command;

use crate::common::{LIBRARY, PYIGTL, golden, of_library, of_pyigtl};
use panoscope_igtl::{Message, Reader};

fn compare(text: &str, message: fn(&str) -> Message<'static>) {
    let lines = golden(text);
    assert!(lines.len() >= 14, "{} messages", lines.len());
    for (name, bytes) in lines {
        let expected = message(name);
        let mut ours = Vec::new();
        expected.encode(&mut ours).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(ours, bytes, "{name} is written otherwise");
        let read = Message::decode(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(read, expected, "{name} is read otherwise");
        let mut reader = Reader::default();
        reader.fill(&mut bytes.as_slice()).expect("bytes in memory");
        let raw = reader.next_message().unwrap_or_else(|error| panic!("{name}: {error}")).expect("a message");
        assert_eq!(raw.bytes, bytes, "{name}: the CRC fits");
    }
}

#[test]
fn the_librarys_bytes_are_ours() {
    compare(LIBRARY, of_library);
}

#[test]
fn pyigtls_bytes_are_ours() {
    compare(PYIGTL, of_pyigtl);
}

/// What a program prints; `None` where it is not there or fails.
fn output(command: &mut Command) -> Option<String> {
    let output = command.output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

fn sources() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden"))
}

#[test]
fn the_library_of_this_machine_writes_the_golden_bytes() {
    if !Path::new("/usr/include/openigtlink/igtlMessageBase.h").is_file() {
        return panoscope_testing::skipped!("libopenigtlink-dev is not installed");
    }
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("write_golden");
    let mut build = Command::new("c++");
    build.args(["-w", "-I/usr/include/openigtlink", "-o"]).arg(&program).arg(sources().join("write_golden.cpp"));
    let built = build.arg("-lOpenIGTLink").output().expect("a C++ compiler");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    assert_eq!(output(&mut Command::new(program)).expect("it runs"), LIBRARY);
}

#[test]
fn pyigtl_of_this_machine_writes_the_golden_bytes() {
    let mut python = Command::new("python3");
    python.arg(sources().join("write_golden.py")).env("PYTHONDONTWRITEBYTECODE", "1");
    if let Some(folder) = std::env::var_os("PANOSCOPE_PYTHON_PEERS") {
        python.env("PYTHONPATH", folder);
    }
    match output(&mut python) {
        Some(text) => assert_eq!(text, PYIGTL),
        None => panoscope_testing::skipped!("pyigtl is not installed; `cargo xtask test` fetches it"),
    }
}
