use panoscope_node::*;

#[derive(Params)]
struct Settings {
    /// Width of the search.
    #[param(default = 512, range = 16..=256, unit = "px")]
    search_px: u32,
}

fn main() {}
