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
    /// Interpolation between pixels.
    #[param(default = "cubic")]
    method: Method,
}

fn main() {}
