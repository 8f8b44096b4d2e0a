//! Tests built with AddressSanitizer or ThreadSanitizer, which need the nightly compiler.
//!
//! Plugins and the program are those of the ordinary build, because a library with a sanitizer cannot be loaded into
//! every test program; allocations of plugins are still checked. Accesses inside of plugins are not checked, nor those
//! in processes of isolated nodes, which run the program; their host's reading of messages is fuzzed under
//! AddressSanitizer (target `isolated_call`).
//!
//! One kind of test cannot run: both sanitizers replace the heap, so the C library's heap counters are useless
//! (`heap::tests`).

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::coverage::nightly;
use crate::process;
use crate::workspace::Workspace;

/// The runtime keeps plugins mapped and ends by `_exit`, so remaining allocations are not leaks. It has its own signal
/// handlers.
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

    /// Cargo of the nightly toolchain, which builds with the sanitizer into a separate folder.
    ///
    /// # Errors
    /// The toolchain or the sources of the standard library, which ThreadSanitizer needs, are missing.
    pub fn cargo(self, workspace: &Workspace) -> Result<Command> {
        let sysroot = process::capture(nightly("rustc").args(["--print", "sysroot"]))
            .context("sanitizers need the nightly toolchain: run `rustup toolchain install nightly`")?;
        let library = Path::new(sysroot.trim()).join("lib/rustlib/src/rust/library/Cargo.lock");
        if self == Self::Thread && !library.is_file() {
            bail!(
                "ThreadSanitizer needs the sources of the standard library: run `rustup component add rust-src --toolchain nightly`"
            );
        }
        let mut cargo = nightly("cargo");
        cargo.current_dir(&workspace.root).env("CARGO_TARGET_DIR", workspace.target.join(self.folder()));
        cargo.env("RUSTFLAGS", format!("{} -Cunsafe-allow-abi-mismatch=sanitizer", self.flag()));
        Ok(cargo)
    }

    /// Name of its folder in the target folder.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Address => "asan",
            Self::Thread => "tsan",
        }
    }

    /// Arguments for `cargo nextest run`: with an explicit target, build scripts and macros are built without the
    /// sanitizer.
    pub fn arguments(self) -> &'static [&'static str] {
        match self {
            Self::Address => &["--target", TARGET],
            Self::Thread => &["--target", TARGET, "-Zbuild-std"],
        }
    }
}

/// Target that is built with sanitizers.
const TARGET: &str = "x86_64-unknown-linux-gnu";
