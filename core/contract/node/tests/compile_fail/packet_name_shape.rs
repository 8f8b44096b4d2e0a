use panoscope_node::*;

#[repr(C)]
#[derive(Clone, Copy, Packet)]
#[packet(name = "heart beat")]
struct Beat {
    rate_hz: f64,
}

fn main() {}
