use panoscope_node::*;

#[derive(Params)]
struct Settings {
    /// Width of the search.
    #[param(default = 65, range = 16..=256, step = 16)]
    search_px: u32,
}

fn main() {}
