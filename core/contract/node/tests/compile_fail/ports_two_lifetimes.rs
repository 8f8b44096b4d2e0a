use panoscope_node::*;

#[derive(Ports)]
struct In<'a, 'b> {
    /// Left view.
    left: Image<'a, Gray8>,
    /// Right view.
    right: Image<'b, Gray8>,
}

fn main() {}
