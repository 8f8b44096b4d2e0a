use panoscope_node::*;

#[derive(Ports)]
struct In {
    /// Left view.
    left: Image<'static, Gray8>,
}

fn main() {}
