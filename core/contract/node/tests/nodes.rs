//! Small nodes through the harness: what an author writes, and what a graph sees of it.

use std::path::PathBuf;

use panoscope_node::abi::{self, Detection, Roi};
use panoscope_node::harness::{Harness, HarnessError, Level, Setup};
use panoscope_node::*;

type TestResult = std::result::Result<(), HarnessError>;

/// Ports of a filter from any image to any image.
#[derive(Ports)]
struct AnyIn<'f> {
    /// Any image.
    image: AnyImage<'f>,
}

#[derive(Ports)]
struct AnyOut<'f> {
    /// The same image.
    image: Slot<'f, AnyFormat>,
}

struct PassThrough;

impl Node for PassThrough {
    const INFO: NodeInfo = NodeInfo::compute("pass_through", "filter", "Hands images on.");
    type In<'f> = AnyIn<'f>;
    type Out<'f> = AnyOut<'f>;
    type Params = ();

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: AnyIn<'f>, mut out: AnyOut<'f>, _: &()) -> Result<()> {
        out.image.forward(input.image.frame())
    }
}

#[test]
fn a_forwarded_frame_is_the_same_buffer() -> TestResult {
    let mut node = Harness::<PassThrough>::from_toml("")?;
    let out = node.input_image::<Bgr8>("image", 2, 1, &[1, 2, 3, 4, 5, 6]).process()?;
    assert_eq!(out.plane::<Bgr8>("image")?.data, [1, 2, 3, 4, 5, 6]);
    assert_eq!(node.allocated_bytes(), 0);
    assert_eq!(node.copies(), 0);
    assert_ne!(out.buffer("image")?.pool, 0);
    let out = node.input_image::<GrayF32>("image", 1, 1, &[0.5]).process()?;
    assert_eq!(out.plane::<GrayF32>("image")?.data, [0.5]);
    let wrong = out.plane::<Gray8>("image").unwrap_err();
    assert_eq!(wrong.to_string(), "output `image`: expected format 1, got 5");
    Ok(())
}

#[derive(Ports)]
struct GrayIn<'f> {
    /// Picture.
    image: Image<'f, Gray8>,
}

#[derive(Ports)]
struct GrayOut<'f> {
    /// Negative of the picture.
    image: Slot<'f, Gray8>,
    /// The picture with a white pixel at its origin.
    marked: Slot<'f, Gray8>,
}

struct Negative;

impl Node for Negative {
    const INFO: NodeInfo = NodeInfo::compute("negative", "filter", "Dark becomes bright.");
    type In<'f> = GrayIn<'f>;
    type Out<'f> = GrayOut<'f>;
    type Params = ();

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: GrayIn<'f>, mut out: GrayOut<'f>, _: &()) -> Result<()> {
        let image = input.image.view();
        if out.image.is_read() {
            let mut made = out.image.alloc(image.width, image.height)?;
            for y in 0..image.height {
                made.row_mut(y).iter_mut().zip(image.row(y)).for_each(|(to, from)| *to = 255 - from);
            }
            cx.metric("made", 1.0);
        }
        if out.marked.is_read() {
            out.marked.alloc_copy(&input.image)?.row_mut(0)[0] = 255;
        }
        Ok(())
    }
}

#[test]
fn strides_are_kept_apart_from_pixels() -> TestResult {
    let mut node = Harness::<Negative>::from_toml("")?;
    let padded = [1, 2, 99, 3, 4, 99];
    let out = node.input_image_with_stride::<Gray8>("image", 2, 2, 3, &padded).process()?;
    assert_eq!(out.plane::<Gray8>("image")?.data, [254, 253, 252, 251]);
    let marked = out.plane::<Gray8>("marked")?;
    assert_eq!((marked.row(0), marked.row(1)), (&[255, 2][..], &[3, 4][..]));
    assert_eq!(node.copies(), 1, "the host counts the copy");
    Ok(())
}

#[test]
fn an_output_without_reader_is_not_computed() -> TestResult {
    let mut node = Harness::<Negative>::open(Setup::new("").read_only(&["marked"]))?;
    let out = node.input_image::<Gray8>("image", 1, 1, &[7]).process()?;
    assert!(out.is_empty("image")?);
    assert_eq!(out.plane::<Gray8>("marked")?.data, [255]);
    assert_eq!(node.metric("made"), None);
    let wrong = Harness::<Negative>::open(Setup::new("").read_only(&["mark"])).err().map(|e| e.to_string());
    assert_eq!(wrong.as_deref(), Some("there is no output `mark`; there are: image, marked"));
    Ok(())
}

#[test]
fn mistakes_in_a_test_are_named() -> TestResult {
    let mut node = Harness::<Negative>::from_toml("")?;
    let mut fails = |give: &dyn Fn(&mut Harness<Negative>)| {
        give(&mut node);
        node.process().err().map(|e| e.to_string()).unwrap_or_default()
    };
    assert_eq!(fails(&|_| ()), "input `image` is required: give it a frame or call `input_empty`");
    assert_eq!(
        fails(&|n| {
            n.input_image::<Gray8>("left", 1, 1, &[0]);
        }),
        "there is no input `left`; there are: image"
    );
    assert_eq!(
        fails(&|n| {
            n.input_image::<Bgr8>("image", 1, 1, &[0, 0, 0]);
        }),
        "input `image` takes gray8, it was given bgr8"
    );
    assert_eq!(
        fails(&|n| {
            n.input_image::<Mask>("image", 1, 1, &[0]);
        }),
        "input `image` takes `image`, it was given `mask`"
    );
    assert_eq!(
        fails(&|n| {
            n.input_image::<Gray8>("image", 2, 2, &[0; 3]);
        }),
        "input `image`: 2x2 pixels with 2 elements a row need 4 elements, 3 were given"
    );
    let twice = |n: &mut Harness<Negative>| {
        n.input_image::<Gray8>("image", 1, 1, &[0]).input_image::<Gray8>("image", 1, 1, &[0]);
    };
    assert_eq!(fails(&twice), "input `image` was given twice, but it is not a list");
    // A mistake does not affect the next call.
    assert!(node.input_image::<Gray8>("image", 1, 1, &[0]).process().is_ok());
    Ok(())
}

#[test]
fn an_empty_required_input_skips_the_node() -> TestResult {
    let mut node = Harness::<Negative>::from_toml("")?;
    let out = node.process_empty(&["image"])?;
    assert!(out.skipped() && out.is_empty("image")? && out.is_empty("marked")?);
    assert!(node.metrics().is_empty(), "the node was not called");
    Ok(())
}

#[derive(Ports)]
struct MixedIn<'f> {
    /// Any number of views.
    views: List<'f, Image<'f, Gray8>>,
    /// Where to look.
    roi: Option<Value<'f, Roi>>,
    /// More views; need not be connected.
    extra: Option<List<'f, Image<'f, Gray8>>>,
}

#[derive(Ports)]
struct MixedOut<'f> {
    /// What arrived.
    summary: Slot<'f, TextPacket>,
    /// Mean of each view that is not empty.
    means: Slot<'f, TableData>,
}

struct Mixed;

impl Node for Mixed {
    const INFO: NodeInfo = NodeInfo::compute("mixed", "filter", "Reports what arrived.");
    type In<'f> = MixedIn<'f>;
    type Out<'f> = MixedOut<'f>;
    type Params = ();

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: MixedIn<'f>, mut out: MixedOut<'f>, _: &()) -> Result<()> {
        let sizes: Vec<String> = input
            .views
            .iter()
            .map(|view| view.map_or("-".to_owned(), |v| format!("{}x{}", v.width(), v.height())))
            .collect();
        let roi = input.roi.map_or("none".to_owned(), |roi| format!("{}+{}", roi.x, roi.width));
        let extra = input.extra.map_or(0, |list| list.len());
        out.summary.set_text(&format!("views {}; roi {roi}; extra {extra}", sizes.join(" ")))?;
        let mut rows = Vec::new();
        for (index, view) in input.views.iter().enumerate() {
            let Some(view) = view else { continue };
            let view = view.view();
            let sum: f64 = (0..view.height).flat_map(|y| view.row(y)).map(|v| f64::from(*v)).sum();
            rows.extend([index as f64, sum / (view.width * view.height) as f64]);
        }
        out.means.set_table(&["index", "mean_gray"], &rows)
    }
}

#[test]
fn lists_and_optional_inputs() -> TestResult {
    let mut node = Harness::<Mixed>::from_toml("")?;
    assert!(node.node_type().inputs[2].list && node.node_type().inputs[2].optional);
    let out = node
        .input_image::<Gray8>("views", 2, 1, &[10, 20])
        .input_empty("views")
        .input_image::<Gray8>("views", 1, 1, &[7])
        .input_value("roi", Roi { x: 5, y: 0, width: 40, height: 1 })
        .process()?;
    assert_eq!(out.text("summary")?, "views 2x1 - 1x1; roi 5+40; extra 0");
    let table = out.table("means")?;
    assert_eq!(table.names().collect::<Vec<_>>(), ["index", "mean_gray"]);
    assert_eq!(table.rows().collect::<Vec<_>>(), [[0.0, 15.0], [2.0, 7.0]]);

    let view = [1_u8];
    node.input_image::<Gray8>("views", 1, 1, &view).input_image::<Gray8>("extra", 1, 1, &view);
    assert_eq!(node.process_empty(&["roi"])?.text("summary")?, "views 1x1; roi none; extra 1");
    let wrong = node.input_value("views", Roi::default()).process().err().map(|e| e.to_string());
    assert_eq!(wrong.as_deref(), Some("input `views` takes `image`, it was given `roi`"));
    Ok(())
}

/// A packet type of this plugin's own.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Packet)]
#[packet(name = "heart_beat")]
struct HeartBeat {
    rate_hz: f64,
    phase_rad: f32,
    beats: u32,
}

/// Same name, other fields.
#[repr(C)]
#[derive(Clone, Copy, Packet)]
#[packet(name = "heart_beat")]
struct OtherHeartBeat {
    rate_hz: f64,
    phase_rad: f32,
    count: u32,
}

#[derive(Ports)]
struct BeatIn<'f> {
    /// Beat so far.
    beat: Value<'f, HeartBeat>,
    /// What was found.
    found: Option<Detections<'f>>,
    /// What was found, with masks.
    instances: Option<Instances<'f>>,
    /// Points.
    cloud: Option<Cloud<'f>>,
    /// A note.
    note: Option<Text<'f>>,
    /// Numbers.
    table: Option<Table<'f>>,
}

#[derive(Ports)]
struct BeatOut<'f> {
    /// Beat after this tick.
    beat: Slot<'f, HeartBeat>,
    /// The found things.
    found: Slot<'f, LabeledDetections>,
    /// The found things with masks.
    instances: Slot<'f, LabeledInstances>,
    /// The points, one mm further right.
    cloud: Slot<'f, PointCloud>,
    /// The note, louder.
    note: Slot<'f, TextPacket>,
}

struct Beat;

impl Node for Beat {
    const INFO: NodeInfo = NodeInfo::compute("beat", "filter", "Hands every kind of packet on.");
    type In<'f> = BeatIn<'f>;
    type Out<'f> = BeatOut<'f>;
    type Params = ();

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: BeatIn<'f>, mut out: BeatOut<'f>, _: &()) -> Result<()> {
        out.beat.set(HeartBeat { beats: input.beat.beats + 1, ..*input.beat })?;
        if let Some(found) = input.found {
            let labels: Vec<&str> = found.labels().collect();
            out.found.set_detections(found.items(), &labels.join("\n"), found.image_size())?;
        }
        if let Some(instances) = input.instances {
            let list = instances.detections();
            let masks: Vec<u8> = (0..list.items().len()).flat_map(|i| instances.mask(i).iter().map(|b| !b)).collect();
            out.instances.set_instances(list.items(), list.label(0), list.image_size(), &masks)?;
        }
        if let Some(cloud) = input.cloud {
            let made = out.cloud.alloc_cloud(cloud.width(), cloud.height())?;
            for (to, from) in made.data.iter_mut().zip(cloud.points()) {
                *to = abi::CloudPoint { x_mm: from.x_mm + 1.0, ..*from };
            }
        }
        if let Some(note) = input.note {
            let rows = input.table.map_or(0, |t| t.rows().count());
            out.note.set_text(&format!("{}{}", note.to_uppercase(), "!".repeat(rows)))?;
        }
        Ok(())
    }
}

#[test]
fn every_packet_family_survives_a_hop() -> TestResult {
    let mut node = Harness::<Beat>::from_toml("")?;
    let beat = HeartBeat { rate_hz: 1.2, phase_rad: 0.5, beats: 3 };
    let item = |class_index| Detection {
        x_px: 1.0,
        y_px: 2.0,
        width_px: 3.0,
        height_px: 4.0,
        score: 0.5,
        class_index,
        track_id: -1,
    };
    let point = abi::CloudPoint { x_mm: 1.0, y_mm: 2.0, z_mm: 3.0, bgr: [4, 5, 6], filled: 0 };
    let out = node
        .input_value("beat", beat)
        .input_detections("found", &[item(0), item(1)], "grasper\nhook", (640, 480))
        .input_instances("instances", &[item(0)], "hook", (9, 2), &[0x0F; 4])
        .input_cloud("cloud", 1, 2, &[point; 2])
        .input_text("note", "bleeding")
        .input_table("table", &["a"], &[1.0, 2.0])
        .process()?;
    assert_eq!(out.value::<HeartBeat>("beat")?, HeartBeat { beats: 4, ..beat });
    let found = out.detections("found")?;
    assert_eq!(found.items(), [item(0), item(1)]);
    assert_eq!((found.label(1), found.label(2), found.image_size()), ("hook", "", (640, 480)));
    assert_eq!(out.instances("instances")?.mask(0), [0xF0; 4]);
    assert_eq!(out.instances("instances")?.mask(1), [0_u8; 0]);
    assert_eq!(out.cloud("cloud")?, [abi::CloudPoint { x_mm: 2.0, ..point }; 2]);
    assert_eq!(out.text("note")?, "BLEEDING!!");

    let out = node.input_value("beat", beat).input_text("note", "").process()?;
    assert!(out.is_empty("found")? && !out.is_empty("note")?, "a text without letters is not an empty output");
    assert_eq!(out.text("note")?, "");
    let other = OtherHeartBeat { rate_hz: 0.0, phase_rad: 0.0, count: 0 };
    let wrong = node.input_value("beat", other).process().err().map(|e| e.to_string());
    assert_eq!(wrong.as_deref(), Some("input `beat` takes `heart_beat` of another layout"));
    Ok(())
}

/// Interpolation between pixels.
#[derive(Choice, Clone, Copy, Debug, PartialEq)]
enum Method {
    /// The nearest one.
    Nearest,
    /// A weighted mean.
    BiLinear,
}

#[derive(Params)]
struct EveryParams {
    /// A switch.
    #[param(default = true)]
    on: bool,
    /// A whole number.
    #[param(default = 64, range = 16..=256, step = 16, unit = "px", reopen)]
    search_px: u32,
    /// A signed number.
    #[param(default = -3, range = -10..=10)]
    shift: i64,
    /// A number.
    #[param(default = 0.5, range = 0.0..=1.0, unit = "ratio")]
    share: f32,
    /// A choice.
    #[param(default = "bi_linear")]
    method: Method,
    /// A text.
    #[param(default = "abc")]
    label: String,
    /// A file.
    #[param(default = "", must_exist)]
    file: PathBuf,
    /// A rectangle.
    #[param(default = [0, 0.5], range = 0..=4)]
    rect: Vec<f64>,
}

struct Every {
    opened_with: u32,
    dir: PathBuf,
    id: String,
}

#[derive(Ports)]
struct EveryOut<'f> {
    /// The parameters as text.
    text: Slot<'f, TextPacket>,
}

impl Node for Every {
    const INFO: NodeInfo = NodeInfo::blocking("every", "source", "Shows its parameters.").source().side_effects();
    type In<'f> = NoPorts;
    type Out<'f> = EveryOut<'f>;
    type Params = EveryParams;

    fn open(open: &Open<'_>, params: &EveryParams) -> Result<Self> {
        open.info(&format!("opened with {}", params.search_px));
        let (dir, id) = (open.graph_dir().to_owned(), open.node_id().to_owned());
        Ok(Self { opened_with: params.search_px, dir, id })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: EveryOut<'f>, p: &EveryParams) -> Result<()> {
        if cx.tick().seq == 9 {
            cx.end();
            return Ok(());
        }
        let file = p.file.strip_prefix(&self.dir).unwrap_or(&p.file).display().to_string();
        let (on, search, shift, share, method) = (p.on, p.search_px, p.shift, p.share, p.method);
        out.text.set_text(&format!(
            "{}: {on} {search}/{} {shift} {share} {method:?} {} [{file}] {:?}",
            self.id, self.opened_with, p.label, p.rect
        ))
    }
}

#[test]
fn every_kind_of_parameter() -> TestResult {
    let here = env!("CARGO_MANIFEST_DIR");
    let mut node = Harness::<Every>::open(Setup::new("").graph_dir(here).node_id("all"))?;
    assert_eq!(node.process()?.text("text")?, "all: true 64/64 -3 0.5 BiLinear abc [] [0.0, 0.5]");
    node.set_params(
        "params.on = false\nparams.shift = 4\nparams.share = 1\nparams.method = \"nearest\"\nparams.label = \"x y\"\n\
         params.file = \"Cargo.toml\"\nparams.rect = [1, 2.5, 3]",
    )?;
    assert_eq!(node.process()?.text("text")?, "all: false 64/64 4 1 Nearest x y [Cargo.toml] [1.0, 2.5, 3.0]");
    assert_eq!(node.logs().len(), 1, "live parameters do not reopen");
    node.set_params("params = { search_px = 128 }")?;
    assert_eq!(node.process()?.text("text")?, "all: true 128/128 -3 0.5 BiLinear abc [] [0.0, 0.5]");
    assert_eq!(node.logs()[1].message, "opened with 128");
    assert_eq!(node.logs()[1].level, Level::Info);
    Ok(())
}

#[test]
fn parameters_are_checked_like_a_graph_file() -> TestResult {
    let mut node = Harness::<Every>::from_toml("")?;
    let wrong = node.set_params("params = { serch_px = 64, shift = 99, method = \"cubic\" }").unwrap_err().to_string();
    for part in [
        "node.toml:1:",
        "`every` has no parameter `serch_px`",
        "did you mean `search_px`?",
        "`shift` is 99; allowed: -10 to 10",
        "`cubic` is not a choice of `method`",
    ] {
        assert!(wrong.contains(part), "{part:?} is missing in:\n{wrong}");
    }
    let wrong = node.set_params("params.search_px = 65").unwrap_err().to_string();
    assert!(wrong.contains("in steps of 16"), "{wrong}");
    let wrong = node.set_params("\nparams.file = \"no_such_file\"").unwrap_err().to_string();
    assert!(wrong.contains("node.toml:2:") && wrong.contains("does not exist"), "{wrong}");
    assert!(node.process()?.text("text")?.contains("64/64"), "the old parameters stay");
    Ok(())
}

#[test]
fn a_source_ends_and_keeps_time() -> TestResult {
    let mut node = Harness::<Every>::from_toml("")?;
    assert!(node.node_type().source && node.node_type().side_effects);
    let first = node.process()?;
    assert_eq!((first.tick().seq, first.tick().capture_ns), (0, 0));
    assert!(!first.ended());
    let last = node.at_tick(9, 300_000_000).process()?;
    assert!(last.ended() && last.is_empty("text")?);
    assert_eq!(node.process()?.tick().seq, 10);
    Ok(())
}
