use panoscope_node::*;

#[repr(C)]
#[derive(Clone, Copy, Packet)]
#[packet(name = "beat")]
struct Beat {
    name: &'static str,
}

fn main() {}
