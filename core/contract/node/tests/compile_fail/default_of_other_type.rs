use panoscope_node::*;

#[derive(Params)]
struct Settings {
    /// Width of the search.
    #[param(default = "wide", range = 16..=256)]
    search_px: u32,
}

fn main() {}
