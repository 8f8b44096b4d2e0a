//! Prepares the sources of the engine with threads, locks, clocks and maps of the simulated world in place of those of `std`, with frames that are
//! overwritten when they are released, and with the defects of `mutations.rs`, which a test enables. Nothing else is changed; the engine itself does
//! not depend on the simulation.

use std::path::{Path, PathBuf};

#[path = "src/engine/mutations.rs"]
mod mutations;

use mutations::{Change, MUTATIONS};

/// Modules of `std` that the world replaces.
const REPLACED: [&str; 5] = ["std::sync::", "std::thread::", "std::time::", "std::hint::", "std::collections::"];
const WORLD: &str = "panoscope_sim::world::";

/// Frames are filled with a pattern when they are allocated and when they are released, so that reading old pixels is detected.
const POISON: [Change; 2] = [
    Change {
        file: "memory/mod.rs",
        from: "            pool.put_back(slot as u32);\n",
        to: "            // SAFETY: the last reference is gone, so nobody reads or writes the slot.\n\
             \x20           unsafe { crate::poison(pool.base.add(slot << pool.bits), pool.room()) };\n\
             \x20           pool.put_back(slot as u32);\n",
    },
    Change {
        file: "memory/mod.rs",
        from: "        let id = BufferId { pool: number + 1, home: 0, offset };\n",
        to: "        let id = BufferId { pool: number + 1, home: 0, offset };\n\
             \x20       // SAFETY: the slot was handed out to this caller alone.\n\
             \x20       unsafe { crate::poison(pool.base.add(offset as usize), pool.room()) };\n",
    },
];

/// Resets what a process has learned about its processors between two runs, so that each run starts like the first.
const FORGET: [Change; 2] = [
    Change {
        file: "node/runner.rs",
        from: "static PAUSE: Pause = Pause::new();\n",
        to: "static PAUSE: Pause = Pause::new();\n\
             pub(crate) fn forget_pause() {\n\
             \x20   PAUSE.until_ns.store(0, Ordering::Relaxed);\n\
             \x20   PAUSE.next_ns.store(PAUSE_NS[0], Ordering::Relaxed);\n\
             }\n",
    },
    Change { file: "node/mod.rs", from: "\nmod runner;\n", to: "\npub(crate) mod runner;\n" },
];

fn main() {
    let engine = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../core/runtime/engine/src");
    let out = PathBuf::from(std::env::var("OUT_DIR").expect("cargo names a folder")).join("engine");
    println!("cargo::rerun-if-changed={}", engine.display());
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/engine/mutations.rs");
    let _ = std::fs::remove_dir_all(&out);
    let mut unused: Vec<&Change> =
        POISON.iter().chain(&FORGET).chain(MUTATIONS.iter().map(|(_, change)| change)).collect();
    lay_out(&engine, &engine, &out, &mut unused);
    let unused: Vec<_> = unused.iter().map(|change| format!("{}: {}", change.file, change.from)).collect();
    assert!(unused.is_empty(), "no such lines in the engine; write these changes anew: {unused:#?}");
}

fn lay_out(root: &Path, folder: &Path, out: &Path, unused: &mut Vec<&Change>) {
    std::fs::create_dir_all(out).expect("the folder can be written");
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    for entry in entries {
        let path = entry.expect("the folder can be read").path();
        let name = path.file_name().expect("a file has a name");
        if path.is_dir() {
            lay_out(root, &path, &out.join(name), unused);
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let file = path.strip_prefix(root).expect("inside").to_string_lossy().into_owned();
        let text = simulated(&file, text, unused);
        std::fs::write(out.join(name), text).expect("the folder can be written");
    }
}

fn simulated(file: &str, mut text: String, unused: &mut Vec<&Change>) -> String {
    if file == "clock.rs" {
        return "pub use panoscope_sim::world::time::now_ns;\n\npub(crate) fn keep() {}\n".to_owned();
    }
    let mine = |change: &&Change| change.file == file && text.matches(change.from).count() == 1;
    let (now, later): (Vec<&Change>, Vec<&Change>) = unused.drain(..).partition(mine);
    *unused = later;
    for change in now {
        text = text.replacen(change.from, change.to, 1);
    }
    assert!(
        !text.contains("use std::{"),
        "{file}: import modules of `std` one by one, so that the simulated ones replace them"
    );
    // The sources are a module here and not a crate.
    text = text.replace("crate::", "crate::engine::");
    // The engine's own tests run where it is.
    text = text.replace("#[cfg(test)]", "#[cfg(any())]");
    for module in REPLACED {
        let replacement = module.replace("std::", WORLD);
        text = text.replace(module, &replacement);
    }
    if file == "lib.rs" {
        // It is included into another file, which has attributes and documentation of its own.
        text = text.lines().filter(|line| !line.starts_with("//!")).flat_map(|line| [line, "\n"]).collect();
    }
    text
}
