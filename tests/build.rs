//! Prepares sources of the engine for `tests/shuttle`: the same text, with the locks, atomics and threads of a scheduler that explores interleavings.
//!
//! Each subject becomes a module with the sources that it needs and its models. A mutation makes another module of the subject with one change in one
//! source; a model of the subject must fail there.

use std::fmt::Write;
use std::path::{Path, PathBuf};

/// A part of the engine, its sources in order of use, and the file of its models.
struct Subject {
    name: &'static str,
    sources: &'static [&'static str],
}

const SUBJECTS: &[Subject] = &[
    Subject { name: "frames", sources: &["sync", "memory"] },
    Subject { name: "params", sources: &["sync", "params"] },
    Subject { name: "region", sources: &["sync", "memory", "region"] },
    Subject { name: "abandon", sources: &["thread_id", "busy"] },
    Subject { name: "join", sources: &["sync", "memory", "region", "light", "join"] },
    Subject { name: "pool", sources: &["sync", "thread_id", "pool"] },
    Subject { name: "leave", sources: &["sync", "leave", "runner"] },
    Subject { name: "apply", sources: &["sync", "memory", "region", "light", "join", "change_lock"] },
];

/// A deliberate defect in one source of a subject.
struct Mutation {
    name: &'static str,
    subject: &'static str,
    source: &'static str,
    from: &'static str,
    to: &'static str,
}

const MUTATIONS: &[Mutation] = &[
    Mutation {
        name: "a_gone_buffer_is_retained",
        subject: "frames",
        source: "memory",
        from: "while count != 0 {",
        to: "while count != u32::MAX {",
    },
    Mutation {
        name: "a_release_frees_before_the_last",
        subject: "frames",
        source: "memory",
        from: "if pool.references[slot].fetch_sub(1, Ordering::Release) == 1 {",
        to: "pool.references[slot].store(before - 1, Ordering::Release); if before == 1 {",
    },
    Mutation {
        name: "the_version_is_set_outside_the_lock",
        subject: "params",
        source: "params",
        from: "let mut place = lock(&self.snapshot);\n        // Under the lock, so that the version belongs to the snapshot that stays when two threads write.\n        self.version.store(snapshot.version(), Ordering::Release);\n        *place = snapshot;",
        to: "self.version.store(snapshot.version(), Ordering::Release);\n        *lock(&self.snapshot) = snapshot;",
    },
    Mutation {
        name: "a_tick_is_admitted_beside_another",
        subject: "region",
        source: "region",
        from: "state.in_flight == 0 && self.open(state)",
        to: "self.open(state)",
    },
    Mutation {
        name: "a_tick_overtakes_those_that_waited",
        subject: "region",
        source: "region",
        from: "state.handing = next.is_some();",
        to: "state.handing = false;",
    },
    Mutation {
        name: "a_left_call_ends_another",
        subject: "abandon",
        source: "busy",
        from: "self.since_ns.compare_exchange(start_ns.max(1), 0, Ordering::AcqRel, Ordering::Relaxed).is_ok()",
        to: "self.since_ns.swap(0, Ordering::AcqRel) != ABANDONED && start_ns != 0",
    },
    Mutation {
        name: "a_call_begins_before_it_is_described",
        subject: "abandon",
        source: "busy",
        from: "self.source.store(tick.source |",
        to: "self.since_ns.store(start_ns.max(1), Ordering::Release);\n        self.source.store(tick.source |",
    },
    Mutation {
        name: "a_running_node_is_fired",
        subject: "join",
        source: "join",
        from: "self.turn == Turn::Idle",
        to: "!self.is_finished()",
    },
    Mutation {
        name: "a_finished_node_is_fired",
        subject: "join",
        source: "join",
        from: "(false, true) => Turn::Finished,",
        to: "(false, true) => Turn::Idle,",
    },
    Mutation {
        name: "a_sleeping_worker_is_not_woken",
        subject: "pool",
        source: "pool",
        from: "let wake = state.idle > 0;",
        to: "let wake = state.idle > 0 && state.urgent.len() > 1;",
    },
    Mutation {
        name: "two_threads_take_one_chunk",
        subject: "pool",
        source: "pool",
        from: "let index = self.next.fetch_add(1, Ordering::Relaxed);",
        to: "let index = self.next.load(Ordering::Relaxed); self.next.store(index + 1, Ordering::Relaxed);",
    },
    Mutation {
        name: "an_abandoned_worker_continues",
        subject: "pool",
        source: "pool",
        from: "state.given_up.extend(&stuck);",
        to: "",
    },
    Mutation {
        name: "a_withdrawn_request_is_accepted",
        subject: "leave",
        source: "leave",
        from: "self.0.load(Ordering::Acquire) == Self::ACCEPTED",
        to: "true",
    },
    Mutation {
        name: "a_wake_is_lost",
        subject: "leave",
        source: "runner",
        from: "self.wake.store(true, Ordering::Release);\n        if let",
        to: "if let",
    },
    Mutation {
        name: "two_changes_at_once",
        subject: "apply",
        source: "change_lock",
        from: "*held = true;\n        ChangeGuard(self)",
        to: "ChangeGuard(self)",
    },
    Mutation {
        name: "a_pause_admits_ticks",
        subject: "apply",
        source: "region",
        from: "!state.paused && state.in_flight <",
        to: "state.in_flight <",
    },
    Mutation {
        name: "a_rewired_node_loses_its_packets",
        subject: "apply",
        source: "join",
        from: "slot.inherit(old);",
        to: "let _ = (&slot, old);",
    },
];

/// Path of a source in the engine.
fn path_of(source: &str) -> &str {
    match source {
        "memory" => "memory/mod",
        "memory_pool" => "memory/pool",
        "join_slot" => "join/slot",
        "runner" => "node/runner",
        source => source,
    }
}

/// A source with the scheduler's locks, as part of the module `module`.
fn instrumented(file: &Path, module: &str, mutation: Option<&Mutation>) -> String {
    let text = std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    // Their own tests run with the engine.
    let mut text = text.split("#[cfg(test)]").next().unwrap_or_default().to_owned();
    if let Some(Mutation { name, from, to, .. }) = mutation {
        let places = text.matches(from).count();
        assert_eq!(places, 1, "the mutation `{name}` fits {places} places of {}: {from}", file.display());
        text = text.replace(from, to);
    }
    if file.ends_with("thread_id.rs") {
        // Its counter is one for all models of a subject, which run side by side: the scheduler must not see it.
        text = text.replace("std::sync::atomic", "core::sync::atomic");
    }
    // `include!` takes no module documentation.
    let lines = text.lines().filter(|line| !line.starts_with("//!") && !APART.contains(line));
    let text: String = lines.flat_map(|line| [line, "\n"]).collect();
    text
        // Threads of the model have small stacks, and it needs private memory only.
        .replace("const DOMAINS: usize = 16;", "const DOMAINS: usize = 1;")
        .replace("crate::", &format!("crate::{module}::"))
        .replace("std::sync::", "crate::shim::sync::")
        .replace("std::thread::", "crate::shim::thread::")
        .replace("std::hint::spin_loop", "crate::shim::hint::spin_loop")
        .replace("thread_local!", "shuttle::thread_local!")
}

/// Modules that a model has in another form, or not at all.
const APART: [&str; 5] = ["mod device;", "mod domain;", "mod homes;", "mod pool;", "mod slot;"];

/// Writes the sources of a subject, and adds its module to `modules`.
fn lay_out(subject: &Subject, mutation: Option<&Mutation>, engine: &Path, out: &Path, modules: &mut String) {
    let module = mutation.map_or(subject.name, |mutation| mutation.name);
    let folder = out.join(module);
    std::fs::create_dir_all(&folder).expect("the folder can be written");
    let write = |source: &str| {
        let mutation = mutation.filter(|mutation| mutation.source == source);
        let file = engine.join(format!("{}.rs", path_of(source)));
        let target = folder.join(format!("{source}.rs"));
        std::fs::write(&target, instrumented(&file, module, mutation)).expect("the folder can be written");
        format!("include!({target:?});")
    };
    writeln!(
        modules,
        "pub mod {module} {{\nuse crate::stubs::{{clock, current_node, decide, outbox, retained, scratch}};"
    )
    .expect("a text");
    for &source in subject.sources {
        let include = write(source);
        let include = match source {
            "memory" => {
                let pool = write("memory_pool");
                let more = support("memory_extra.rs");
                format!("{include}\nmod pool {{ {pool} }}\ninclude!({more:?});")
            }
            "join" => {
                let slot = write("join_slot");
                format!("{include}\nmod slot {{ {slot} }}")
            }
            // Its thread-locals are set as those of the standard library are.
            "pool" | "thread_id" => format!("use crate::shim::{{Assign, Exchange}};\n{include}"),
            _ => include,
        };
        writeln!(modules, "pub mod {source} {{ {include} }}").expect("a text");
    }
    let models = support(&format!("models/{}.rs", subject.name));
    writeln!(modules, "pub mod models {{ include!({models:?}); }}\n}}").expect("a text");
}

fn support(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/shuttle").join(file)
}

fn main() {
    let engine = Path::new(env!("CARGO_MANIFEST_DIR")).join("../core/runtime/engine/src");
    let out = PathBuf::from(std::env::var("OUT_DIR").expect("cargo names a folder"));
    let mut modules = String::new();
    for subject in SUBJECTS {
        lay_out(subject, None, &engine, &out, &mut modules);
        for source in subject.sources {
            println!("cargo::rerun-if-changed={}", engine.join(format!("{}.rs", path_of(source))).display());
        }
    }
    for part in ["memory/pool.rs", "join/slot.rs"] {
        println!("cargo::rerun-if-changed={}", engine.join(part).display());
    }
    println!("cargo::rerun-if-changed=build.rs");
    for mutation in MUTATIONS {
        let subject = SUBJECTS.iter().find(|subject| subject.name == mutation.subject);
        let subject = subject.unwrap_or_else(|| panic!("no subject `{}`", mutation.subject));
        assert!(subject.sources.contains(&mutation.source), "`{}` is no source of its subject", mutation.name);
        lay_out(subject, Some(mutation), &engine, &out, &mut modules);
    }
    let names: Vec<&str> = MUTATIONS.iter().map(|mutation| mutation.name).collect();
    writeln!(modules, "/// All mutations.\npub const MUTATIONS: &[&str] = &{names:?};").expect("a text");
    std::fs::write(out.join("subjects.rs"), modules).expect("the folder can be written");
}
