use panoscope_node::*;

#[derive(Params)]
struct Settings(u32);

fn main() {}
