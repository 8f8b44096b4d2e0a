//! Makes the program's allocation functions the ones that plugins and their libraries call, so that they are counted.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let target = |key: &str| std::env::var(format!("CARGO_CFG_TARGET_{key}")).unwrap_or_default();
    if target("OS") == "linux" && target("ENV") == "gnu" {
        for symbol in ["malloc", "calloc", "realloc", "aligned_alloc", "posix_memalign", "memalign"] {
            println!("cargo:rustc-link-arg-bins=-Wl,--export-dynamic-symbol={symbol}");
        }
    }
}
