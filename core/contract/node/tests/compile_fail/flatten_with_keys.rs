use panoscope_node::*;

#[derive(Params)]
struct Shared {
    /// Lets a stop go.
    #[param(default = 0, range = 0..=9)]
    reset: u32,
}

#[derive(Params)]
struct Settings {
    #[param(flatten, reopen)]
    shared: Shared,
}

fn main() {}
