//! Structs of parameters and ports that are flattened into others: one list, in the order of the fields.

use panoscope_node::abi::{self, Roi};
use panoscope_node::harness::{Harness, HarnessError};
use panoscope_node::*;

/// Stands two levels deep.
#[derive(Params)]
struct Inner {
    /// Deepest.
    #[param(default = 3, range = 0..=9, unit = "px")]
    deepest_px: u32,
}

#[derive(Params)]
struct Shared {
    /// A switch.
    #[param(default = true)]
    is_on: bool,
    #[param(flatten)]
    inner: Inner,
    /// A text.
    #[param(default = "a", reopen)]
    word: String,
}

#[derive(Params)]
struct Tail {
    /// A number behind.
    #[param(default = 0.5, range = 0.0..=1.0)]
    last: f64,
}

#[derive(Params)]
struct Settings {
    /// In front.
    #[param(default = 1, range = 0..=4)]
    front: u32,
    #[param(flatten)]
    shared: Shared,
    /// In the middle.
    #[param(default = 2, range = 0..=4)]
    middle: u32,
    #[param(flatten)]
    tail: Tail,
}

#[derive(Ports)]
struct Views<'f> {
    /// Left view.
    left: Image<'f, Gray8>,
    /// Right view.
    right: Option<Image<'f, Gray8>>,
}

#[derive(Ports)]
struct In<'f> {
    #[ports(flatten)]
    views: Views<'f>,
    /// A region.
    roi: Option<Value<'f, Roi>>,
}

#[derive(Ports)]
struct Regions<'f> {
    /// Of the left view.
    roi_left: Slot<'f, Roi>,
    /// Of the right view.
    roi_right: Slot<'f, Roi>,
}

#[derive(Ports)]
struct Out<'f> {
    /// Left view, as it came.
    left: Slot<'f, Gray8>,
    #[ports(flatten)]
    regions: Regions<'f>,
    #[ports(flatten)]
    nothing: NoPorts,
    /// The values of all parameters.
    values: Slot<'f, TextPacket>,
}

struct Nested;

impl Node for Nested {
    const INFO: NodeInfo = NodeInfo::compute("nested", "filter", "Hands on what it is given.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn open(_: &Open<'_>, _: &Settings) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, p: &Settings) -> Result<()> {
        let NoPorts = out.nothing;
        out.left.forward(input.views.left.frame())?;
        let width = |view: Option<usize>| Roi { width: view.map_or(-1, |width| width as i32), ..Roi::default() };
        out.regions.roi_left.set(width(Some(input.views.left.width())))?;
        out.regions.roi_right.set(width(input.views.right.as_ref().map(Image::width)))?;
        let x = input.roi.map_or(-1, |roi| roi.x);
        let Shared { is_on, inner, word } = &p.shared;
        let words = format!("{} {is_on} {} {word} {} {} {x}", p.front, inner.deepest_px, p.middle, p.tail.last);
        out.values.set_text(&words)
    }
}

fn text(text: abi::Str) -> &'static str {
    // SAFETY: the derive names declarations by static texts.
    unsafe { text.text() }.unwrap_or("")
}

#[test]
fn flattened_parameters_stand_in_the_place_of_their_field() {
    let names: Vec<&str> = Settings::PARAMS.iter().map(|p| text(p.name)).collect();
    assert_eq!(names, ["front", "is_on", "deepest_px", "word", "middle", "last"]);
    let deepest = &Settings::PARAMS[2];
    assert_eq!((text(deepest.doc), text(deepest.unit)), ("Deepest.", "px"));
    assert_eq!((deepest.kind, deepest.default_number, deepest.min, deepest.max), (abi::PARAM_INT, 3.0, 0.0, 9.0));
    let word = &Settings::PARAMS[3];
    assert_eq!((word.flags, text(word.default_text)), (abi::PARAM_REOPEN, "a"));
}

#[test]
fn flattened_ports_stand_in_the_place_of_their_field() {
    let names = |ports: &[abi::Port]| ports.iter().map(|p| text(p.name)).collect::<Vec<_>>();
    assert_eq!(names(<In<'static> as Ports<'static>>::PORTS), ["left", "right", "roi"]);
    assert_eq!(names(<Out<'static> as Ports<'static>>::PORTS), ["left", "roi_left", "roi_right", "values"]);
    let right = &<In<'static> as Ports<'static>>::PORTS[1];
    assert_eq!((text(right.doc), right.flags), ("Right view.", abi::PORT_OPTIONAL));
}

#[test]
fn values_and_frames_reach_the_fields_of_flattened_structs() -> std::result::Result<(), HarnessError> {
    let toml = "params.front = 4\nparams.is_on = false\nparams.deepest_px = 7\nparams.word = \"b\"\nparams.middle = 0\nparams.last = 0.25";
    let mut node = Harness::<Nested>::from_toml(toml)?;
    node.input_image::<Gray8>("left", 2, 1, &[1, 2]);
    node.input_image::<Gray8>("right", 3, 1, &[3, 4, 5]);
    let out = node.input_value("roi", Roi { x: 8, ..Roi::default() }).process()?;
    assert_eq!(out.text("values")?, "4 false 7 b 0 0.25 8");
    assert_eq!(out.plane::<Gray8>("left")?.data, [1, 2]);
    assert_eq!(out.value::<Roi>("roi_left")?.width, 2);
    assert_eq!(out.value::<Roi>("roi_right")?.width, 3);
    Ok(())
}

#[test]
fn another_number_of_values_is_refused() {
    let values = panoscope_graph::from_abi::ParamSnapshot::new(&[
        panoscope_graph::ParamValue::Int(1),
        panoscope_graph::ParamValue::Int(2),
    ]);
    let refused = Settings::read(values.values()).err().map(|error| error.to_string());
    assert_eq!(refused.as_deref(), Some("6 parameters are declared, but the host passed 2"));
}
