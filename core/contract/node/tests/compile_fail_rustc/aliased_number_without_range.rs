use panoscope_node::*;

type Pixels = u32;

#[derive(Params)]
struct Settings {
    /// Width of the search.
    #[param(default = 64)]
    search: Pixels,
}

fn main() {}
