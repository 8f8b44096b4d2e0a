//! Tests built with AddressSanitizer or ThreadSanitizer, which the nightly compiler has.
//!
//! Plugins and the program stay those of the ordinary build: a library with a sanitizer of its own cannot be loaded into every test program, and
//! allocations of a plugin are seen all the same. So accesses inside of plugins are not judged, nor those of the processes of isolated nodes, which run
//! the program; what their host makes of any message is fuzzed under AddressSanitizer (target `isolated_call`).
//!
//! One kind of test cannot run: both sanitizers have a heap of their own, so the C library's counters of its heap say nothing (`heap::tests`).

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::coverage::nightly;
use crate::process;
use crate::workspace::Workspace;

/// The runtime keeps plugins mapped and leaves by `_exit`: what is then still allocated is no leak. The handlers of signals are its own.
pub const ASAN_OPTIONS: &str =
    "detect_leaks=0:handle_segv=0:handle_abort=0:use_sigaltstack=0:detect_stack_use_after_return=1";

/// A sanitizer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sanitizer {
    /// Accesses outside of live memory.
    Address,
    /// Data races.
    Thread,
}

impl Sanitizer {
    fn flag(self) -> &'static str {
        match self {
            Self::Address => "-Zsanitizer=address",
            Self::Thread => "-Zsanitizer=thread",
        }
    }

    /// Cargo of the nightly toolchain, which builds with the sanitizer into a folder of its own.
    ///
    /// # Errors
    /// The toolchain is missing, or the sources of the standard library, which ThreadSanitizer has to see.
    pub fn cargo(self, workspace: &Workspace) -> Result<Command> {
        let sysroot = process::capture(nightly("rustc").args(["--print", "sysroot"]))
            .context("sanitizers need the nightly toolchain: `rustup toolchain install nightly`")?;
        let library = Path::new(sysroot.trim()).join("lib/rustlib/src/rust/library/Cargo.lock");
        if self == Self::Thread && !library.is_file() {
            bail!(
                "ThreadSanitizer needs the sources of the standard library: `rustup component add rust-src --toolchain nightly`"
            );
        }
        let mut cargo = nightly("cargo");
        cargo.current_dir(&workspace.root).env("CARGO_TARGET_DIR", workspace.target.join(self.folder()));
        cargo.env("RUSTFLAGS", format!("{} -Cunsafe-allow-abi-mismatch=sanitizer", self.flag()));
        Ok(cargo)
    }

    /// Its folder below the target folder.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Address => "asan",
            Self::Thread => "tsan",
        }
    }

    /// For `cargo nextest run`: with a named target, build scripts and macros are built without the sanitizer.
    pub fn arguments(self) -> &'static [&'static str] {
        match self {
            Self::Address => &["--target", TARGET],
            Self::Thread => &["--target", TARGET, "-Zbuild-std"],
        }
    }
}

/// The machine that sanitizers exist for here.
const TARGET: &str = "x86_64-unknown-linux-gnu";
