use panoscope_node::*;

#[derive(Choice)]
enum Method {
    /// The nearest one.
    Nearest(u32),
}

fn main() {}
