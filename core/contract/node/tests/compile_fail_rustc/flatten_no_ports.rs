use panoscope_node::*;

#[derive(Ports)]
struct In<'f> {
    #[ports(flatten)]
    left: Image<'f, Gray8>,
}

fn main() {}
