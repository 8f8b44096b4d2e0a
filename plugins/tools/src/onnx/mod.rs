//! `onnx`: any network as a node. A table says which image each input of the network takes and what its outputs are, see [`table`].

mod detector;
mod inputs;
mod maps;
mod mismatch;
pub mod table;

use std::path::{Path, PathBuf};

use panoscope_node::{
    AnyFormat, Bgr8, Confidence, Context, Depth, Disparity, Gray8, GrayF32, LabeledDetections, Mask, Node, NodeInfo,
    Open, Parallel, Params, Picture, Ports, Result, Slot, Validation, View, ViewMut,
};

use crate::provider::Provider;
use crate::session::{ModelSession, Tensor, Values, list_text};
use crate::yolo::{Damage, check_labels};
use detector::Detector;
use inputs::NetworkInput;
use maps::{Frame, MapOutput};
use mismatch::Mismatch;
use table::{InputPort, OutputPort, PortTable, TableError};

/// Inputs. Those that the table names must be connected and of one size. A tick in which one of them is empty has empty outputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Image for a network with one view, bgr8 or gray8.
    image: Option<Picture<'f>>,
    /// Left rectified view.
    left: Option<Picture<'f>>,
    /// Right rectified view of the same instant.
    right: Option<Picture<'f>>,
    /// View of the previous tick, for networks that estimate motion: the same output as `image`, with `delay = 1`.
    previous: Option<Picture<'f>>,
}

/// Outputs. Those that the table does not name stay empty. All have the size of `image`, or else of `left`.
#[derive(Ports)]
pub struct Out<'f> {
    /// Disparity, px of the image, positive, NaN = unknown.
    disparity: Slot<'f, Disparity>,
    /// Depth, mm, NaN = unknown.
    depth: Slot<'f, Depth>,
    /// Mask: 255 inside.
    mask: Slot<'f, Mask>,
    /// Confidence, 0 to 1.
    confidence: Slot<'f, Confidence>,
    /// Boxes in px of the image, highest score first, with their labels.
    detections: Slot<'f, LabeledDetections>,
    /// Motion to the right, px of the image.
    flow_x: Slot<'f, GrayF32>,
    /// Motion downwards, px of the image.
    flow_y: Slot<'f, GrayF32>,
    /// Image that the network outputs: bgr8 if it has three channels, gray8 if it has one.
    image: Slot<'f, AnyFormat>,
}

/// Parameters of `onnx`.
#[derive(Params)]
pub struct OnnxParams {
    /// ONNX file of the network.
    #[param(default = "", reopen, must_exist, file)]
    model: PathBuf,
    /// Table of inputs and outputs as TOML text, as in `[inputs.left] port = "left"` and `[outputs.disparity] port = "disparity"` on lines of their own.
    /// Empty: the file `table_file`. `panoscope describe MODEL.onnx` prints a table; the README of the plugins lists the keys.
    #[param(default = "", reopen)]
    table: String,
    /// File with the same keys. Empty: the model's name with the extension `toml`, in its folder; a lock of the graph includes it only if it is named
    /// here.
    #[param(default = "", reopen, file)]
    table_file: PathBuf,
    /// Value from which a pixel belongs to the mask, if the network outputs one number per pixel.
    #[param(default = 0.5, range = -1000.0..=1000.0)]
    mask_threshold: f32,
    /// Confidence below which pixels of disparity and depth are unknown. Takes effect if the network outputs a confidence.
    #[param(default = 0.0, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_confidence: f32,
    /// Minimum score of a box.
    #[param(default = 0.3, range = 0.001..=1.0, step = 0.01, unit = "ratio")]
    min_score: f32,
    /// Overlap (intersection over union) above which the box with the lower score is dropped, within a class.
    #[param(default = 0.5, range = 0.05..=1.0, step = 0.05, unit = "ratio")]
    max_overlap: f32,
    /// Maximum number of boxes in the output.
    #[param(default = 50, range = 1..=1000)]
    max_boxes: usize,
    /// File with the names of the classes, one per line. Empty: the names in the model file.
    #[param(default = "", reopen)]
    labels: PathBuf,
    /// Number of threads of the network; 0 uses as many as the host has.
    #[param(default = 0, range = 0..=64, reopen)]
    threads: usize,
    /// Execution provider: the processor, or an accelerator if ONNX Runtime's library supports it and finds a device. Otherwise the processor is
    /// used, with a warning.
    #[param(default = "cpu", reopen)]
    provider: Provider,
}

impl OnnxParams {
    fn read_table(&self) -> Result<PortTable, TableError> {
        PortTable::read(&self.model, &self.table, &self.table_file)
    }
}

/// Runs a network.
pub struct Onnx {
    path: PathBuf,
    session: ModelSession,
    /// The first one has the image that sets the size of the outputs.
    inputs: Vec<NetworkInput>,
    maps: Vec<MapOutput>,
    detector: Option<Detector>,
    confidence: Vec<f32>,
    damage: Damage,
}

/// Checks that the table and the graph connect the same ports.
fn check_wiring(table: &PortTable, check: &mut Validation<'_>) {
    use InputPort::{Image, Left, Previous, Right};
    for port in [Image, Left, Right, Previous] {
        let name = port.name();
        let rule = table.inputs.iter().find(|(_, rule)| rule.port == port);
        match (rule, check.is_connected(name)) {
            (Some((network, _)), Some(false)) => check.node_error(
                format!("input `{name}` is not connected; the table gives it to the network's input `{network}`"),
                "connect it, or name another port in the table",
            ),
            (None, Some(true)) => check.node_error(
                format!("input `{name}` is connected; the table gives it to no input of the network"),
                "disconnect it, or name it in the table",
            ),
            _ => {}
        }
    }
    use OutputPort as O;
    for port in [O::Disparity, O::Depth, O::Mask, O::Confidence, O::Detections, O::Flow, O::Image] {
        if let Some(name) = port.outputs().iter().find(|name| !table.gives(port) && check.is_read(name) == Some(true)) {
            let made: Vec<&str> = table.outputs.values().flat_map(|rule| rule.port.outputs()).copied().collect();
            check.node_error(
                format!("output `{name}` is read; the table makes {}", made.join(", ")),
                format!("read another output, or give one of the network's outputs the port `{}`", port.name()),
            );
        }
    }
}

/// The inputs of a network according to its table; that of the first port comes first.
fn network_inputs(session: &ModelSession, table: &PortTable) -> Result<Vec<NetworkInput>, Mismatch> {
    let path = session.path();
    for (side, declared, names) in [
        ("input", session.inputs(), table.inputs.keys().collect::<Vec<_>>()),
        ("output", session.outputs(), table.outputs.keys().collect()),
    ] {
        if let Some(name) = names.into_iter().find(|name| declared.iter().all(|d| d.name != **name)) {
            let (path, name) = (path.to_owned(), name.clone());
            return Err(Mismatch::NoSuch { path, side, name, found: list_text(declared) });
        }
    }
    let mut inputs = Vec::new();
    for declared in session.inputs() {
        let Some(rule) = table.inputs.get(&declared.name) else {
            let (name, found) = (declared.name.clone(), declared.to_string());
            return Err(Mismatch::Unnamed { path: path.to_owned(), name, found });
        };
        inputs.push(NetworkInput::new(path, declared, rule)?);
    }
    inputs.sort_by_key(|input| input.port);
    Ok(inputs)
}

fn find<'a, 'b>(tensors: &'b [Tensor<'a>], name: &str) -> Option<&'b Tensor<'a>> {
    tensors.iter().find(|tensor| tensor.name == name)
}

impl Onnx {
    /// Runs the network once on gray images: shapes of outputs are known only then, and the first run is the slowest.
    fn try_out(&mut self, table: &PortTable, params: &OnnxParams, pool: &dyn Parallel) -> Result<()> {
        for input in &mut self.inputs {
            let (width, height) = input.size;
            let gray = vec![127; width * height];
            input.prepare(View::new(&gray, width, height, 1), pool);
        }
        let size = self.inputs[0].size;
        let run: Vec<_> = self.inputs.iter_mut().map(NetworkInput::run_input).collect();
        let (path, maps) = (&self.path, &self.maps);
        let end_to_end = self.session.metadata("end2end").is_some_and(|v| v.eq_ignore_ascii_case("true"));
        let names = self.session.metadata("names").map(str::to_owned);
        self.detector = self.session.run(&run, |tensors| -> Result<_> {
            for map in maps {
                if let Some(tensor) = find(tensors, &map.name) {
                    map.grid(path, tensor, size)?;
                }
            }
            let detector = Detector::new(path, table, tensors, size, end_to_end)?;
            detector.map(|d| d.with_labels(path, names.as_deref(), &params.labels)).transpose()
        })??;
        Ok(())
    }
}

impl Node for Onnx {
    const INFO: NodeInfo =
        NodeInfo::blocking("onnx", "tools", "Runs any network; a table says what its inputs and outputs are.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = OnnxParams;

    fn validate(params: &OnnxParams, check: &mut Validation<'_>) {
        check_labels(check, &params.labels);
        if params.model.as_os_str().is_empty() {
            return check.error("model", "no model is given", "name an ONNX file, as in model = \"network.onnx\"");
        }
        match params.read_table() {
            Ok(table) => check_wiring(&table, check),
            Err(error @ TableError::Missing { .. }) => check.error("model", error.to_string(), ""),
            Err(error) => {
                let param = if params.table.trim().is_empty() { "table_file" } else { "table" };
                check.error(param, error.to_string(), "");
            }
        }
    }

    fn open(open: &Open<'_>, params: &OnnxParams) -> Result<Self> {
        let table = params.read_table()?;
        let threads = if params.threads == 0 { open.pool().threads() } else { params.threads };
        let session = ModelSession::open(&params.model, threads, params.provider)?;
        params.provider.warn_if_refused(open, session.path(), session.refused());
        let inputs = network_inputs(&session, &table)?;
        let is_map = |rule: &table::OutputRule| rule.port != OutputPort::Detections;
        let maps = table.outputs.iter().filter(|(_, rule)| is_map(rule));
        let maps = maps.map(|(name, rule)| MapOutput::new(name, rule)).collect();
        let (path, confidence, damage) = (session.path().to_owned(), Vec::new(), Damage::default());
        let mut node = Self { path, session, inputs, maps, detector: None, confidence, damage };
        node.try_out(&table, params, open.pool())?;
        Ok(node)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &OnnxParams) -> Result<()> {
        let given = |port: InputPort| match port {
            InputPort::Image => input.image,
            InputPort::Left => input.left,
            InputPort::Right => input.right,
            InputPort::Previous => input.previous,
        };
        let mut frame = None;
        for index in 0..self.inputs.len() {
            let port = self.inputs[index].port;
            let Some(picture) = given(port) else { return Ok(()) };
            let size = (picture.width(), picture.height());
            let placement = self.inputs[index].prepare(picture.view(), cx.pool());
            let first = *frame.get_or_insert(Frame { image: size, input: self.inputs[0].size, placement });
            self.inputs[0].same_size(first.image, port, size)?;
        }
        let Some(frame) = frame else { return Ok(()) };
        let run: Vec<_> = self.inputs.iter_mut().map(NetworkInput::run_input).collect();
        let (path, maps, detector) = (&self.path, &mut self.maps, &mut self.detector);
        let (confidence, damage) = (&mut self.confidence, &mut self.damage);
        self.session.run(&run, |tensors| -> Result<()> {
            let mut writer = Writer { path, tensors, frame, params, pool: cx.pool(), confidence };
            // What is known about certainty decides about the other maps.
            maps.sort_by_key(|map| map.rule.port != OutputPort::Confidence);
            for map in maps {
                writer.write(map, &mut out)?;
            }
            let Some(detector) = detector else { return Ok(()) };
            detector.find(path, tensors, &frame, params)?;
            damage.report(cx, path, detector.bad());
            damage.report_left_out(cx, detector.left_out(), ("max_boxes", params.max_boxes));
            detector.write(&mut out.detections, frame.image)
        })?
    }
}

/// Writes the maps of one run.
struct Writer<'a, 't> {
    path: &'a Path,
    tensors: &'a [Tensor<'t>],
    frame: Frame,
    params: &'a OnnxParams,
    pool: &'a dyn Parallel,
    /// Confidence of each pixel of the image; empty until it has been written.
    confidence: &'a mut Vec<f32>,
}

impl Writer<'_, '_> {
    fn write(&mut self, map: &mut MapOutput, out: &mut Out<'_>) -> Result<()> {
        let is_gated = self.params.min_confidence > 0.0;
        let is_read = match map.rule.port {
            OutputPort::Disparity => out.disparity.is_read(),
            OutputPort::Depth => out.depth.is_read(),
            OutputPort::Mask => out.mask.is_read(),
            OutputPort::Confidence => out.confidence.is_read() || is_gated,
            OutputPort::Flow => out.flow_x.is_read() || out.flow_y.is_read(),
            OutputPort::Image => out.image.is_read(),
            OutputPort::Detections => false,
        };
        let Some(tensor) = find(self.tensors, &map.name).filter(|_| is_read) else { return Ok(()) };
        let frame = &self.frame;
        // A network of free size may answer with other shapes.
        let grid = map.grid(self.path, tensor, frame.input)?;
        let ((width, height), at) = (frame.image, (frame, &grid));
        let channel = (map.rule.channel.unwrap_or(0), 0);
        match map.rule.port {
            OutputPort::Confidence => {
                self.confidence.resize(width * height, 0.0);
                // NaN is not above 0.
                let finish = |value: f32, _| if value > 0.0 { value.min(1.0) } else { 0.0 };
                map.fill(tensor, at, channel, (self.confidence, 1, 0), self.pool, finish);
                if out.confidence.is_read() {
                    out.confidence.alloc(width, height)?.data.copy_from_slice(self.confidence);
                }
            }
            OutputPort::Disparity | OutputPort::Depth => {
                let (confidence, least) = (&*self.confidence, self.params.min_confidence);
                let is_sure = |index: usize| !is_gated || confidence.get(index).is_none_or(|value| *value >= least);
                let finish = |value: f32, index: usize| {
                    if value.is_finite() && value > 0.0 && is_sure(index) { value } else { f32::NAN }
                };
                let plane = match map.rule.port {
                    OutputPort::Disparity => out.disparity.alloc(width, height)?,
                    _ => out.depth.alloc(width, height)?,
                };
                map.fill(tensor, at, channel, (plane.data, 1, 0), self.pool, finish);
            }
            OutputPort::Mask => {
                let plane = out.mask.alloc(width, height)?;
                let is_classes =
                    matches!(tensor.data, Values::Int(_)) || (grid.channels > 1 && map.rule.channel.is_none());
                if is_classes {
                    map.fill_classes(tensor, frame, &grid, plane.data);
                } else {
                    let least = self.params.mask_threshold;
                    let finish = |value: f32, _| if value >= least { 255 } else { 0 };
                    map.fill(tensor, at, channel, (plane.data, 1, 0), self.pool, finish);
                }
            }
            OutputPort::Flow => {
                for (axis, slot) in [&mut out.flow_x, &mut out.flow_y].into_iter().enumerate() {
                    if slot.is_read() {
                        let plane = slot.alloc(width, height)?;
                        map.fill(tensor, at, (axis, axis), (plane.data, 1, 0), self.pool, |value, _| value);
                    }
                }
            }
            OutputPort::Image => {
                let [low, high] = map.rule.range.unwrap_or([0.0, 1.0]);
                // Casts of floats saturate.
                let finish = |value: f32, _| ((value - low) * (255.0 / (high - low))).round() as u8;
                let plane: ViewMut<'_, u8> = match grid.channels {
                    1 => out.image.alloc_as::<Gray8>(width, height)?,
                    _ => out.image.alloc_as::<Bgr8>(width, height)?,
                };
                let is_bgr = map.rule.order == Some(table::Order::Bgr);
                for c in 0..grid.channels {
                    let to = if is_bgr || grid.channels == 1 { c } else { 2 - c };
                    map.fill(tensor, at, (c, 0), (&mut *plane.data, grid.channels, to), self.pool, finish);
                }
            }
            OutputPort::Detections => {}
        }
        Ok(())
    }
}
