use panoscope_node::*;

#[derive(Params)]
struct Settings {
    #[param(flatten)]
    search_px: u32,
}

fn main() {}
