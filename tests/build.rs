//! Lays sources of the engine out for `tests/shuttle.rs`: the same text, with the locks and atomics of a scheduler that tries orders out.

use std::path::Path;

fn main() {
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/engine/src");
    let out = std::env::var("OUT_DIR").expect("cargo names a folder");
    let modules = [("memory/mod", "memory"), ("memory/pool", "pool")];
    let files = ["params", "region", "busy", "sync"].map(|name| (name, name));
    for (file, name) in modules.into_iter().chain(files) {
        let file = sources.join(format!("{file}.rs"));
        println!("cargo::rerun-if-changed={}", file.display());
        let text = std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        // Their own tests run with the engine; `include!` takes no module documentation.
        let text = text.split("#[cfg(test)]").next().unwrap_or_default();
        let lines =
            text.lines().filter(|line| !line.starts_with("//!") && !["mod domain;", "mod pool;"].contains(line));
        let text: String = lines.flat_map(|line| [line, "\n"]).collect();
        // Threads of the model have small stacks, and it needs private memory only.
        let text = text.replace("const DOMAINS: usize = 16;", "const DOMAINS: usize = 1;");
        // A cell that is filled once at its first use; the model fills it before any thread starts.
        let text = text.replace("use std::sync::{Mutex, OnceLock};", "use std::sync::OnceLock;\nuse std::sync::Mutex;");
        let text =
            text.replace("std::sync::", "shuttle::sync::").replace("shuttle::sync::OnceLock", "std::sync::OnceLock");
        std::fs::write(Path::new(&out).join(format!("{name}.rs")), text).expect("the folder can be written");
    }
}
