use panoscope_node::*;

#[repr(C)]
#[derive(Clone, Copy, Packet)]
#[packet(name = "beat")]
struct Beat(f64);

fn main() {}
