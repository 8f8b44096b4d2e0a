//! Makes a program's allocation and exit functions the ones that plugins and their libraries call, so that allocations
//! are counted and no library can exit the program without a message.

fn main() {
    // A change of this file counts by itself; it is the build script of two packages.
    println!("cargo:rerun-if-changed=Cargo.toml");
    let target = |key: &str| std::env::var(format!("CARGO_CFG_TARGET_{key}")).unwrap_or_default();
    if target("OS") == "linux" && target("ENV") == "gnu" {
        for symbol in ["malloc", "calloc", "realloc", "aligned_alloc", "posix_memalign", "memalign"] {
            println!("cargo:rustc-link-arg-bins=-Wl,--export-dynamic-symbol={symbol}");
        }
        for symbol in ["exit", "_exit", "_Exit", "quick_exit"] {
            println!("cargo:rustc-link-arg-bins=-Wl,--export-dynamic-symbol={symbol}");
        }
    }
}
