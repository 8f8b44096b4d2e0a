use panoscope_node::*;

#[derive(Params)]
struct Settings {
    /// Width of the window.
    #[param(default = 64, range = 16..=256, unit = "mm")]
    window_px: u32,
}

#[derive(Params)]
struct Speeds {
    /// Speed of the camera.
    #[param(default = 5.0, range = 0.0..=25.0, unit = "mm")]
    camera_mm_s: f64,
}

fn main() {}
