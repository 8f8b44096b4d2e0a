use panoscope_node::*;

#[derive(Params)]
struct Settings {
    /// Threshold.
    #[param(default = 64, range = 0..=256)]
    threshold: u8,
}

fn main() {}
