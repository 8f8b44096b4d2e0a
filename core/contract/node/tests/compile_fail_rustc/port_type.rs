use panoscope_node::*;

#[derive(Ports)]
struct In<'f> {
    /// Left view.
    left: &'f [u8],
}

fn main() {}
