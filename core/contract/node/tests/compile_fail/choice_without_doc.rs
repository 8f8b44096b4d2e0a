use panoscope_node::*;

#[derive(Choice)]
enum Method {
    Nearest,
}

fn main() {}
