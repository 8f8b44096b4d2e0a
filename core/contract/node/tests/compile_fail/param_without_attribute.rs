use panoscope_node::*;

#[derive(Params)]
struct Settings {
    /// Width of the search.
    search_px: u32,
}

fn main() {}
