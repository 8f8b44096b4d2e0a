use panoscope_node::*;

#[derive(Params)]
struct Settings {
    /// Width of the search.
    #[param(default = 64, range = 16..=256)]
    search_px: Option<u32>,
}

fn main() {}
