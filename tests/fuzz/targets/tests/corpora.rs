//! Replays the corpora of all fuzz targets, and their seeds, with the stable toolchain: no panic, no hang, no large allocation.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use panoscope_base::random::SplitMix64;
use panoscope_fuzz_targets::{TARGETS, Target};

/// Maximum number of files and bytes of a committed corpus.
const MAX_FILES: usize = 60;
const MAX_BYTES: usize = 100 << 10;
/// Time limit for one input, on a busy machine and without optimization. Normal inputs take milliseconds; those that this detects, hours.
const PATIENCE: Duration = Duration::from_secs(20);
/// Maximum size of a single allocation for an input; decoders of images may allocate their pixels.
const MAX_SIZE: usize = 64 << 20;
const MAX_PICTURE: usize = 512 << 20;

/// Records the largest allocation of each thread.
struct Watched;

thread_local! {
    static MAX_REQUEST: Cell<usize> = const { Cell::new(0) };
}

fn note(size: usize) {
    // A thread that ends has none any more.
    let _ = MAX_REQUEST.try_with(|largest| largest.set(largest.get().max(size)));
}

// SAFETY: every call is passed on to the system's allocator, which upholds the contract.
unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        // SAFETY: the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note(size);
        // SAFETY: the caller's promise.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Watched = Watched;

fn fuzz() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The committed inputs of a target: name and bytes.
fn corpus(target: &Target) -> Vec<(String, Vec<u8>)> {
    let folder = fuzz().join("corpus").join(target.name);
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    files.sort();
    let read = |path: PathBuf| {
        let bytes = std::fs::read(&path).expect("a file of the corpus");
        (path.file_name().unwrap_or_default().to_string_lossy().into_owned(), bytes)
    };
    files.into_iter().map(read).collect()
}

/// Runs one input. Returns what is wrong with it.
fn fault(target: &Target, bytes: &[u8]) -> Option<String> {
    MAX_REQUEST.set(0);
    let begun = Instant::now();
    let ended = catch_unwind(AssertUnwindSafe(|| (target.run)(bytes)));
    let (took, largest) = (begun.elapsed(), MAX_REQUEST.get());
    let limit = if ["picture", "truth_file"].contains(&target.name) { MAX_PICTURE } else { MAX_SIZE };
    if let Err(panic) = ended {
        return Some(format!("it panicked: {}", panoscope_engine::panic_words(&*panic)));
    }
    if took > PATIENCE {
        return Some(format!("it took {:.1} s", took.as_secs_f64()));
    }
    (largest > limit).then(|| format!("it allocated {largest} bytes at once"))
}

#[test]
fn every_input_is_survived() {
    let (mut count, mut faults) = (0, Vec::new());
    for target in TARGETS {
        let seeds = (target.seeds)();
        assert!(!seeds.is_empty(), "{} has no seeds", target.name);
        let seeds = seeds.into_iter().enumerate().map(|(number, bytes)| (format!("seed-{number:02}"), bytes));
        for (name, bytes) in corpus(target).into_iter().chain(seeds) {
            count += 1;
            if let Some(fault) = fault(target, &bytes) {
                faults.push(format!("{}/{name}: {fault}", target.name));
            }
        }
    }
    println!("{count} inputs of {} targets", TARGETS.len());
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Changes an input at random: bits, numbers, pieces removed, doubled or taken from another input.
fn damaged(random: &mut SplitMix64, inputs: &[Vec<u8>]) -> Vec<u8> {
    const NUMBERS: [&[u8]; 10] = [
        b"0",
        b"-1",
        b"1e308",
        b"nan",
        b"9223372036854775807",
        b"18446744073709551616",
        &[0xff; 8],
        &[0; 8],
        &[0xff, 0xff, 0xff, 0x7f],
        &[0, 0, 0, 0x80],
    ];
    let mut bytes = inputs[random.below(inputs.len())].clone();
    for _ in 0..1 + random.below(4) {
        let at = random.below(bytes.len() + 1);
        let end = (at + 1 + random.below(16)).min(bytes.len());
        match random.below(7) {
            0 | 1 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            2 if at < end => drop(bytes.drain(at..end)),
            3 => drop(bytes.splice(at..at, NUMBERS[random.below(NUMBERS.len())].iter().copied())),
            4 if at < end => drop(bytes.splice(at..end, NUMBERS[random.below(NUMBERS.len())].iter().copied())),
            5 if at < end => {
                let piece = bytes[at..end].to_vec();
                drop(bytes.splice(at..at, piece));
            }
            _ => {
                let other = &inputs[random.below(inputs.len())];
                let from = random.below(other.len() + 1);
                let to = (from + random.below(64)).min(other.len());
                drop(bytes.splice(at..at, other[from..to].iter().copied()));
            }
        }
    }
    bytes
}

/// A short unguided pass; `cargo xtask fuzz` goes far deeper. PANOSCOPE_FUZZ_CASES sets the number of inputs for each target, PANOSCOPE_FUZZ_SEED
/// selects others.
#[test]
fn damaged_inputs_are_survived() {
    let number = |name: &str, otherwise: u64| {
        std::env::var(name).map_or(otherwise, |v| v.parse().unwrap_or_else(|_| panic!("{name} is a number, not {v:?}")))
    };
    let (cases, seed) = (number("PANOSCOPE_FUZZ_CASES", 150), number("PANOSCOPE_FUZZ_SEED", 1));
    let only = std::env::var("PANOSCOPE_FUZZ_TARGET").ok();
    let mut faults = Vec::new();
    for target in TARGETS.iter().filter(|target| only.as_ref().is_none_or(|name| target.name == name)) {
        let mut inputs: Vec<Vec<u8>> = corpus(target).into_iter().map(|(_, bytes)| bytes).collect();
        inputs.extend((target.seeds)());
        for case in 0..cases {
            let bytes = damaged(&mut SplitMix64(seed << 32 | case), &inputs);
            if let Some(fault) = fault(target, &bytes) {
                let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz-{}-{seed}-{case}", target.name));
                std::fs::write(&file, &bytes).expect("the target folder can be written");
                faults.push(format!("{} {case} ({}): {fault}", target.name, file.display()));
                if faults.len() > 40 {
                    break;
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_target_has_a_file_and_a_small_corpus() {
    for target in TARGETS {
        let files = corpus(target);
        let bytes: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
        assert!(
            files.len() <= MAX_FILES && bytes <= MAX_BYTES,
            "{}: {} files, {bytes} bytes",
            target.name,
            files.len()
        );
    }
    let stems = |folder: &str| -> BTreeSet<String> {
        let entries = std::fs::read_dir(fuzz().join(folder)).expect("a folder").flatten();
        entries.filter_map(|entry| Some(entry.path().file_stem()?.to_string_lossy().into_owned())).collect()
    };
    let names: BTreeSet<String> = TARGETS.iter().map(|target| target.name.to_owned()).collect();
    assert_eq!(stems("fuzz_targets"), names);
    assert!(stems("corpus").is_subset(&names), "a corpus without a target");
    let manifest = std::fs::read_to_string(fuzz().join("Cargo.toml")).expect("the manifest");
    for name in names {
        assert!(manifest.contains(&format!("name = \"{name}\"")), "{name} is missing in the manifest");
    }
}

#[test]
fn a_parser_that_panics_is_noticed() {
    let broken = Target { name: "broken", run: |bytes| assert!(bytes.is_empty()), seeds: Vec::new };
    assert_eq!(fault(&broken, b""), None);
    assert!(fault(&broken, b"x").is_some_and(|words| words.contains("panicked")));
    let greedy =
        Target { name: "greedy", run: |_| drop(std::hint::black_box(vec![0u8; MAX_SIZE + 1])), seeds: Vec::new };
    assert!(fault(&greedy, b"x").is_some_and(|words| words.contains("allocated")));
}
