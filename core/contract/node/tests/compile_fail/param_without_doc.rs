use panoscope_node::*;

#[derive(Params)]
struct Settings {
    #[param(default = 64, range = 16..=256, unit = "px")]
    search_px: u32,
}

fn main() {}
