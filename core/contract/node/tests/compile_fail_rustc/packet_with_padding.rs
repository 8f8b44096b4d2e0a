use panoscope_node::*;

#[repr(C)]
#[derive(Clone, Copy, Packet)]
#[packet(name = "beat")]
struct Beat {
    beats: u32,
    rate_hz: f64,
}

fn main() {}
