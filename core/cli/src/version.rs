//! `panoscope --version`: the version, and what decides whether plugins, recordings and graphs of other versions fit it.

use std::sync::LazyLock;

use panoscope_abi::{ABI_MAJOR, ABI_MINOR};
use panoscope_base::Simd;
use panoscope_record::format;

/// Commit of a release build; `cargo xtask` sets it.
const COMMIT: Option<&str> = option_env!("PANOSCOPE_COMMIT");

static LONG: LazyLock<String> = LazyLock::new(|| {
    let paths = if Simd::detect().avx2() { "x86-64-v3 (AVX2)" } else { "portable" };
    format!(
        "{}\ncommit: {}\nplugins: contract {ABI_MAJOR}.0 to {ABI_MAJOR}.{ABI_MINOR}\nrecordings: formats {} to {}\nkernels: {paths}",
        env!("CARGO_PKG_VERSION"),
        COMMIT.unwrap_or("unknown, a development build"),
        format::OLDEST_FORMAT,
        format::FORMAT,
    )
});

/// Text of `--version`; `-V` prints the number alone.
pub fn long() -> &'static str {
    &LONG
}
