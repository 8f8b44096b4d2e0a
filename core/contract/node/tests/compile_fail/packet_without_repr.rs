use panoscope_node::*;

#[derive(Clone, Copy, Packet)]
#[packet(name = "beat")]
struct Beat {
    rate_hz: f64,
}

fn main() {}
