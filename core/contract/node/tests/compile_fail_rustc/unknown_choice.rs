use panoscope_node::*;

#[derive(Choice)]
enum Method {
    /// The nearest one.
    Nearest,
    /// A weighted mean.
    BiLinear,
}

#[derive(Params)]
struct Settings {
    /// How pixels between others are found.
    #[param(default = "cubic")]
    method: Method,
}

fn main() {}
