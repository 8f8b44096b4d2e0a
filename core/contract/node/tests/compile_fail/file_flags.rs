use std::path::PathBuf;

use panoscope_node::*;

#[derive(Params)]
struct Written {
    /// File to write.
    #[param(default = "out/a.png", writes, must_exist)]
    path: PathBuf,
}

#[derive(Params)]
struct Number {
    /// Number of files.
    #[param(default = 5, range = 0..=9, writes)]
    files: u32,
}

fn main() {}
