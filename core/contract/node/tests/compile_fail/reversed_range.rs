use panoscope_node::*;

#[derive(Params)]
struct Settings {
    /// Width of the search.
    #[param(default = 64, range = 256..=16)]
    search_px: u32,
}

fn main() {}
