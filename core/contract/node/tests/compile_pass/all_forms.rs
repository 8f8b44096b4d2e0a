//! Forms that are right but seldom used.
use panoscope_node::*;

const WIDEST: u32 = 4 * 64;
type Pixels = u32;

/// Raw identifiers keep their plain name.
#[derive(Ports)]
struct In<'f> {
    /// A port named like a keyword.
    r#type: Option<Image<'f, Bgr8>>,
}

#[derive(Ports)]
struct Nothing {}

#[derive(Ports)]
struct NoFields;

#[derive(Choice)]
enum Method {
    /// The only one.
    Only,
}

#[derive(Params)]
struct Settings {
    /// Constants may stand in a range.
    #[param(default = WIDEST / 2, range = 16..=WIDEST, step = 16, unit = "px")]
    search_px: Pixels,
    /// Negative numbers.
    #[param(default = -0.5, range = -1.0..=1.0)]
    shift: f64,
    /// A list without a range of lengths, picked on a picture.
    #[param(default = [], points)]
    points: Vec<f64>,
    /// A choice, and a trailing comma.
    #[param(default = "only", reopen,)]
    r#method: Method,
}

#[repr(C, align(8))]
#[derive(Clone, Copy, Packet)]
#[packet(name = "beat")]
struct Beat {
    rate_hz: f64,
    name: [u8; 8],
}

fn name(text: abi::Str) -> &'static str {
    unsafe { text.text() }.unwrap_or("")
}

fn main() {
    assert_eq!(name(<In<'static> as Ports<'static>>::PORTS[0].name), "type");
    assert!(<Nothing as Ports<'static>>::PORTS.is_empty() && <NoFields as Ports<'static>>::PORTS.is_empty());
    assert_eq!(Settings::PARAMS[0].default_number, 128.0);
    assert_eq!((Settings::PARAMS[1].default_number, Settings::PARAMS[1].min), (-0.5, -1.0));
    assert_eq!((name(Settings::PARAMS[3].name), Settings::PARAMS[3].default_number), ("method", 0.0));
    assert_eq!(Settings::PARAMS[2].flags, abi::PARAM_POINTS);
    assert_eq!(Beat::NAME, "beat");
}
