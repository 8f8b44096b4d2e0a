use panoscope_node::*;

#[derive(Ports)]
struct In<'f>(Image<'f, Gray8>);

fn main() {}
