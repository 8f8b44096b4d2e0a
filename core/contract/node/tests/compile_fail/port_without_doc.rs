use panoscope_node::*;

#[derive(Ports)]
struct In<'f> {
    left: Image<'f, Gray8>,
}

fn main() {}
