use panoscope_node::*;

#[repr(C)]
#[derive(Clone, Copy, Packet)]
struct Beat {
    rate_hz: f64,
}

fn main() {}
