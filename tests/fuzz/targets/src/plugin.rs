//! Plugin files before they are loaded, and lock files.

use std::borrow::Cow;
use std::cell::Cell;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use panoscope_abi as abi;
use panoscope_host::loader::elf::{ElfError, OnDisk, Parts, read_note};
use panoscope_host::loader::keys::{SecretKey, Trust};
use panoscope_host::loader::lock::Lock;

use crate::scratch;

/// Counts the bytes that are read from a file.
struct Counted<'b> {
    bytes: &'b [u8],
    read: Cell<u64>,
}

impl Parts for Counted<'_> {
    fn size(&self) -> u64 {
        self.bytes.len() as u64
    }

    fn part(&self, at: u64, len: u64) -> Result<Cow<'_, [u8]>, ElfError> {
        self.read.set(self.read.get() + len);
        assert!(at + len <= self.size(), "bytes {at} to {} of {} are read", at + len, self.size());
        self.bytes.part(at, len)
    }
}

pub fn note(bytes: &[u8]) {
    let counted = Counted { bytes, read: Cell::new(0) };
    let found = read_note(&counted);
    // The search for plugins reads every file of a folder.
    assert!(counted.read.get() <= 4 * bytes.len() as u64 + (1 << 20), "{} bytes are read", counted.read.get());
    let on_disk = OnDisk::open(&scratch::file("plugin.so", bytes)).expect("its own file");
    assert_eq!(read_note(&on_disk), found, "on disk as in memory");
    match found {
        Ok(note) => {
            let holds = |text: &str| text.is_empty() || bytes.windows(text.len()).any(|part| part == text.as_bytes());
            assert!(holds(&note.name) && holds(&note.version), "{note:?}");
            assert!(note.node_types.iter().all(|name| !name.is_empty() && holds(name)), "{note:?}");
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// A shared library with one segment and the given sections, each with its type.
fn library(sections: &[(u32, Vec<u8>)]) -> Vec<u8> {
    let mut out = b"\x7fELF\x02\x01\x01".to_vec();
    out.resize(16, 0);
    out.extend(3u16.to_le_bytes());
    out.extend(if cfg!(target_arch = "x86_64") { 62u16 } else { 183 }.to_le_bytes());
    out.extend(1u32.to_le_bytes());
    let body: usize = sections.iter().map(|(_, bytes)| bytes.len()).sum();
    let (programs, data) = (64u64, 64 + 56u64);
    out.extend(0u64.to_le_bytes());
    out.extend(programs.to_le_bytes());
    out.extend((data + body as u64).to_le_bytes());
    out.extend(0u32.to_le_bytes());
    for number in [64, 56, 1, 64, sections.len() as u16, 0u16] {
        out.extend(number.to_le_bytes());
    }
    // One segment over the whole body.
    out.extend(1u32.to_le_bytes());
    out.extend(4u32.to_le_bytes());
    for number in [data, 0, 0, body as u64, body as u64, 8] {
        out.extend(number.to_le_bytes());
    }
    sections.iter().for_each(|(_, bytes)| out.extend(bytes));
    let mut at = data;
    for (kind, bytes) in sections {
        out.extend(0u32.to_le_bytes());
        out.extend(kind.to_le_bytes());
        for number in [0, 0, at, bytes.len() as u64, 0, 4, 0] {
            out.extend(number.to_le_bytes());
        }
        at += bytes.len() as u64;
    }
    out
}

fn note_section(owner: &[u8], name: &str, nodes: &str) -> Vec<u8> {
    let padded = |text: &str, len: usize| {
        let mut bytes = text.as_bytes().to_vec();
        bytes.resize(len, 0);
        bytes
    };
    let mut body = [abi::ABI_MAJOR.to_le_bytes(), abi::ABI_MINOR.to_le_bytes()].concat();
    body.extend(padded(name, abi::NOTE_NAME_LEN));
    body.extend(padded("0.1.0", abi::NOTE_VERSION_LEN));
    body.extend(padded(nodes, abi::NOTE_NODES_LEN));
    let mut out: Vec<u8> =
        [owner.len() as u32, body.len() as u32, abi::NOTE_TYPE].iter().flat_map(|n| n.to_le_bytes()).collect();
    out.extend(owner);
    out.resize(out.len().next_multiple_of(4), 0);
    out.extend(body);
    out
}

pub fn note_seeds() -> Vec<Vec<u8>> {
    let ours = note_section(&abi::NOTE_OWNER, "stitch", "composite,register_surf,");
    let foreign = note_section(b"GNU\0", "x", "");
    let good = library(&[(7, foreign.clone()), (7, ours.clone()), (1, vec![0; 16])]);
    let mut many = library(&vec![(7, Vec::new()); 40]);
    // All sections span the whole file.
    let (len, table) = (many.len(), many.len() - 40 * 64);
    for entry in many[table..].chunks_exact_mut(64) {
        entry[24..32].copy_from_slice(&0u64.to_le_bytes());
        entry[32..40].copy_from_slice(&(len as u64).to_le_bytes());
    }
    vec![
        good.clone(),
        library(&[(7, [foreign, ours].concat())]),
        library(&[]),
        good[..good.len() - 100].to_vec(),
        good[..70].to_vec(),
        many,
    ]
}

/// A lock file next to a graph, with a trusted key and without one.
pub fn lock(bytes: &[u8]) {
    let file = scratch::file("lock/graph.toml.lock", bytes);
    let graph = file.with_file_name("graph.toml");
    match Lock::read(&graph) {
        Ok(lock) => {
            let lock = lock.expect("the file is there");
            let copy = scratch::path("lock/copy.toml");
            lock.write(&copy).expect("written");
            assert_eq!(Lock::read(&copy).expect("its own text"), Some(lock.clone()));
            // A file that could not be read when it was locked never fits.
            let has_unread = lock.files.iter().any(|file| file.sha256.is_empty());
            assert!(lock.differences(&lock).is_empty() || has_unread || has_repeated_names(&lock));
            judge(&graph, lock);
        }
        Err(error) => assert!(error.to_string().contains("graph.toml.lock"), "{error}"),
    }
}

/// Checks that a lock is accepted only as its key signed it.
fn judge(graph: &Path, mut lock: Lock) {
    let secret = secret_key();
    let (nobody, mut trust) = (Trust::default(), Trust::default());
    trust.add(secret.public());
    for trusted in [&nobody, &trust] {
        match lock.check_signature(graph, trusted) {
            Ok(None) => assert!(trusted.is_empty(), "a key is needed"),
            Ok(Some(name)) => assert!(!trusted.is_empty() && name == secret.public().name(), "{name}"),
            Err(error) => assert!(error.to_string().contains("graph.toml.lock"), "{error}"),
        }
    }
    let unsigned = lock.digest();
    lock.sign(&secret);
    assert_eq!(lock.digest(), unsigned, "a signature is of what it signs, not of itself");
    assert!(matches!(lock.check_signature(graph, &trust), Ok(Some(_))), "its own signature");
    assert!(lock.check_signature(graph, &nobody).is_err(), "a key that nobody trusts");
    let Some(first) = lock.files.first_mut() else { return };
    first.bytes ^= 1;
    assert!(lock.check_signature(graph, &trust).is_err(), "another length");
    let before = lock.clone();
    lock.files.remove(0);
    assert!(lock.check_signature(graph, &trust).is_err(), "a file less");
    assert!(!before.differences(&lock).is_empty() && !lock.differences(&before).is_empty());
}

/// The same key in every run, so that signed inputs stay valid.
fn secret_key() -> SecretKey {
    let file = scratch::path("lock/key");
    if !file.exists() {
        let text = format!("panoscope-secret-key 1 {}\n", "07".repeat(32));
        scratch::file("lock/key", text.as_bytes());
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).expect("its own file");
    }
    SecretKey::read(&file).expect("a key")
}

fn has_repeated_names(lock: &Lock) -> bool {
    let mut names: Vec<_> = lock.files.iter().map(|file| (file.kind, &file.name)).collect();
    names.sort();
    names.windows(2).any(|pair| pair[0] == pair[1])
}

pub fn lock_seeds() -> Vec<Vec<u8>> {
    let file = |kind: &str, name: &str| {
        format!("[[file]]\nkind = \"{kind}\"\nname = \"{name}\"\nbytes = 3\nsha256 = \"{}\"\n", "ab".repeat(32))
    };
    let head = "version = 2\nprogram = \"0.1.0\"\n";
    let kinds = [
        "graph",
        "part",
        "overlay",
        "plugin",
        "library",
        "program",
        "model",
        "weights",
        "runtime",
        "calibration",
        "file",
        "input",
    ];
    let of_each_kind: String = kinds.iter().map(|kind| file(kind, "a;2")).collect();
    let good = format!("{head}{}", file("graph", "g.toml"));
    let signature =
        |key: &str, signature: &str| format!("{good}[signature]\nkey = \"{key}\"\ned25519 = \"{signature}\"\n");
    let public = secret_key().public().hex();
    let mut signed = Lock::parse(&good).expect("a lock");
    signed.sign(&secret_key());
    let place = scratch::path("lock/signed.toml");
    let signed = signed.write(&place).map(|file| std::fs::read_to_string(&file).expect("its own file"));
    let texts = [
        format!("{head}{of_each_kind}"),
        format!("{head}file = []\n"),
        "version = 7\nprogram = \"1\"\nfile = []\n".to_owned(),
        "version = 2\nprogram = 1\n".to_owned(),
        [head, &file("graph", "g.toml"), &file("graph", "g.toml")].concat(),
        good.replace(&"ab".repeat(32), ""),
        signed.expect("written"),
        signature(&public, &"0".repeat(128)),
        signature(&public, "no digits"),
        signature("", ""),
        good.clone(),
        "a.".repeat(500),
    ];
    let mut all: Vec<Vec<u8>> = texts.into_iter().map(String::into_bytes).collect();
    all.push(vec![0xff, 0xfe]);
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../graphs");
    let locks = std::fs::read_dir(shipped).into_iter().flatten().flatten().map(|entry| entry.path());
    all.extend(locks.filter(|p| p.extension().is_some_and(|e| e == "lock")).filter_map(|p| std::fs::read(p).ok()));
    all
}
