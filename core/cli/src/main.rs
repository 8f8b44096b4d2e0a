//! The program `panoscope`; see the library.

panoscope_engine::guard_exits!();

fn main() {
    panoscope_cli::main()
}
