use panoscope_node::*;

#[derive(Params)]
struct Shared {
    /// Lets a stop go.
    #[param(default = 0, range = 0..=9)]
    reset: u32,
}

#[derive(Params)]
struct Settings {
    #[param(flatten)]
    shared: Shared,
    /// Lets another stop go.
    #[param(default = 0, range = 0..=9)]
    reset: u32,
}

#[derive(Params)]
struct Twice {
    #[param(flatten)]
    one: Shared,
    #[param(flatten)]
    other: Shared,
}

fn main() {}
