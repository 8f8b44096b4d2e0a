//! The table that says what the inputs and outputs of a network are: in the graph (`table`) or in a file (`MODEL.toml` next to `MODEL.onnx`).
//!
//! ```toml
//! [inputs.left]            # the network's own name
//! port = "left"            # the node's port
//! order = "rgb"
//! range = [0, 1]
//!
//! [outputs.disparity]
//! port = "disparity"
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::image_input::Layout;
use crate::yolo::Layout as Family;

/// Maximum side of a network's image, px.
const MAX_SIDE: usize = 8192;

/// Why a table cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum TableError {
    /// No table is given.
    #[error("no table says what the inputs and outputs of {model} are; write {file}, or set `table`; `panoscope describe {model}` prints one", model = model.display(), file = file.display())]
    Missing { model: PathBuf, file: PathBuf },
    /// Two tables are given.
    #[error("`table` and `table_file` are both set; remove one")]
    Twice,
    /// The file cannot be read.
    #[error("cannot read the table {path}: {cause}", path = path.display())]
    Unreadable { path: PathBuf, cause: std::io::Error },
    /// The table is malformed.
    #[error("{source_name}, line {line}: {message}")]
    Malformed { source_name: String, line: usize, message: String },
    /// A value is not allowed.
    #[error("{source_name}: `{key}`: {message}")]
    Value {
        source_name: String,
        /// Key of the value, as in `inputs.left.std`.
        key: String,
        /// What is wrong, and what is allowed.
        message: String,
    },
}

/// Image that an input of the network takes.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, PartialOrd, Ord)]
#[serde(rename_all = "snake_case")]
pub enum InputPort {
    /// The only view.
    Image,
    /// Left rectified view.
    Left,
    /// Right rectified view.
    Right,
    /// The image of the previous tick.
    Previous,
}

impl InputPort {
    /// Name of the node's port.
    pub fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Left => "left",
            Self::Right => "right",
            Self::Previous => "previous",
        }
    }
}

/// Meaning of an output of the network.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, PartialOrd, Ord)]
#[serde(rename_all = "snake_case")]
pub enum OutputPort {
    /// Disparity of the left view.
    Disparity,
    /// Depth of the left view.
    Depth,
    /// Mask.
    Mask,
    /// Confidence.
    Confidence,
    /// Boxes of a detector.
    Detections,
    /// Motion in the image; two maps.
    Flow,
    /// Image.
    Image,
}

impl OutputPort {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Disparity => "disparity",
            Self::Depth => "depth",
            Self::Mask => "mask",
            Self::Confidence => "confidence",
            Self::Detections => "detections",
            Self::Flow => "flow",
            Self::Image => "image",
        }
    }

    /// Outputs of the node that it fills.
    pub fn outputs(self) -> &'static [&'static str] {
        match self {
            Self::Disparity => &["disparity"],
            Self::Depth => &["depth"],
            Self::Mask => &["mask"],
            Self::Confidence => &["confidence"],
            Self::Detections => &["detections"],
            Self::Flow => &["flow_x", "flow_y"],
            Self::Image => &["image"],
        }
    }
}

/// Order of the colour channels.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// Red first.
    Rgb,
    /// Blue first.
    Bgr,
    /// One channel.
    Gray,
}

/// How an image is fitted to the network's input.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum FitRule {
    /// Stretched to the input's size.
    #[default]
    Stretch,
    /// Scaled in proportion, at the upper left corner.
    Letterbox,
    /// Scaled in proportion, centred.
    LetterboxCentre,
    /// Not scaled: padded at the right and below to the next multiple.
    Multiple,
}

/// Function applied to a value after scale and offset.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// Identity.
    #[default]
    None,
    /// 1 / (1 + e^-v).
    Sigmoid,
    /// e^v.
    Exp,
    /// 1 / v.
    Inverse,
}

impl Activation {
    /// Applies the function.
    pub fn of(self, v: f32) -> f32 {
        match self {
            Self::None => v,
            Self::Sigmoid => 1.0 / (1.0 + (-v).exp()),
            Self::Exp => v.exp(),
            Self::Inverse => 1.0 / v,
        }
    }
}

/// Unit of the values of an output.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Pixels of the network's input.
    Px,
    /// Cells of the output, which may have fewer cells than the input has pixels.
    Cells,
    /// Share of the width of the network's input, or of its height for vertical motion.
    Share,
    /// Millimetres.
    Mm,
    /// Centimetres.
    Cm,
    /// Metres.
    M,
}

/// Rule of an input of the network.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct InputRule {
    /// The node's port that it takes.
    pub port: InputPort,
    /// Order of the colours. Default: rgb, or gray for one channel.
    pub order: Option<Order>,
    /// Values that 0 and 255 are mapped to. Default: 0 and 1; 0 and 255 for bytes; -128 and 127 for signed bytes.
    pub range: Option<[f32; 2]>,
    /// Subtracted after that: one number, or one for each channel in the network's order.
    #[serde(default)]
    pub mean: Vec<f32>,
    /// Divides after that: one number, or one for each channel.
    #[serde(default)]
    pub std: Vec<f32>,
    /// How the image is fitted to the input.
    #[serde(default)]
    pub fit: FitRule,
    /// Width and height in px, if the network accepts any size.
    pub size: Option<[usize; 2]>,
    /// Multiple to which sides are padded, px, with `fit = "multiple"`.
    pub multiple: Option<usize>,
    /// Gray level of the padding, 0 to 255.
    #[serde(default = "default_border")]
    pub border: f32,
    /// Order of the axes, if the shape is ambiguous.
    pub axes: Option<Layout>,
}

fn default_border() -> f32 {
    114.0
}

fn one() -> f32 {
    1.0
}

/// Rule of an output of the network.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct OutputRule {
    /// Meaning of the output.
    pub port: OutputPort,
    /// Multiplies each value.
    #[serde(default = "one")]
    pub scale: f32,
    /// Added after the scale.
    #[serde(default)]
    pub offset: f32,
    /// Applied after the offset.
    #[serde(default)]
    pub activation: Activation,
    /// Unit of the result. Default: px for disparity and flow, mm for depth.
    pub unit: Option<Unit>,
    /// Index of the used channel, from 0, for an output with several.
    pub channel: Option<usize>,
    /// Values of black and white in an image.
    pub range: Option<[f32; 2]>,
    /// Order of the colours of an image.
    pub order: Option<Order>,
    /// Order of the axes, if the shape is ambiguous.
    pub axes: Option<Layout>,
    /// Family of a detector.
    #[serde(default)]
    pub family: Family,
}

/// Rules of the inputs and outputs of a network, by their names.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct PortTable {
    /// Inputs by name.
    pub inputs: BTreeMap<String, InputRule>,
    /// Outputs by name. Those that are not in the table are not used.
    pub outputs: BTreeMap<String, OutputRule>,
}

/// Default path of the table of a model: its name with the extension `toml`.
pub fn file_beside(model: &Path) -> PathBuf {
    model.with_extension("toml")
}

impl PortTable {
    /// The table of a model: `text`, else `file`, else the file next to the model.
    ///
    /// # Errors
    /// There is none, there are two, or it cannot be used.
    pub fn read(model: &Path, text: &str, file: &Path) -> Result<Self, TableError> {
        if !text.trim().is_empty() {
            return if file.as_os_str().is_empty() { Self::parse("`table`", text) } else { Err(TableError::Twice) };
        }
        let is_beside = file.as_os_str().is_empty();
        let file = if is_beside { file_beside(model) } else { file.to_owned() };
        match std::fs::read_to_string(&file) {
            Ok(text) => Self::parse(&file.display().to_string(), &text),
            Err(cause) if is_beside && cause.kind() == std::io::ErrorKind::NotFound => {
                Err(TableError::Missing { model: model.to_owned(), file })
            }
            Err(cause) => Err(TableError::Unreadable { path: file, cause }),
        }
    }

    /// Parses a table; `source_name` appears in messages.
    ///
    /// # Errors
    /// See [`TableError`].
    pub fn parse(source_name: &str, text: &str) -> Result<Self, TableError> {
        let table: Self = toml::from_str(text).map_err(|error| TableError::Malformed {
            source_name: source_name.to_owned(),
            line: error.span().map_or(1, |span| 1 + text[..span.start.min(text.len())].matches('\n').count()),
            message: error.message().to_owned(),
        })?;
        match table.wrong() {
            Some((key, message)) => Err(TableError::Value { source_name: source_name.to_owned(), key, message }),
            None => Ok(table),
        }
    }

    /// The first value that is not allowed: its key, and what is allowed.
    fn wrong(&self) -> Option<(String, String)> {
        for (part, is_empty) in [("inputs", self.inputs.is_empty()), ("outputs", self.outputs.is_empty())] {
            if is_empty {
                return Some((part.to_owned(), format!("empty; name the network's {part}, as in [{part}.NAME]")));
            }
        }
        let ports: Vec<InputPort> = self.inputs.values().map(|rule| rule.port).collect();
        for (index, (name, rule)) in self.inputs.iter().enumerate() {
            let wrong = rule.wrong().or_else(|| {
                let is_twice = ports[..index].contains(&rule.port);
                is_twice.then(|| ("port", format!("`{}` is already used by another input", rule.port.name())))
            });
            if let Some((key, message)) = wrong {
                return Some((format!("inputs.{name}.{key}"), message));
            }
        }
        let ports: Vec<OutputPort> = self.outputs.values().map(|rule| rule.port).collect();
        for (index, (name, rule)) in self.outputs.iter().enumerate() {
            let wrong = rule.wrong().or_else(|| {
                // Boxes and scores of a detector may be two outputs.
                let is_twice = rule.port != OutputPort::Detections && ports[..index].contains(&rule.port);
                is_twice.then(|| ("port", format!("`{}` is already used by another output", rule.port.name())))
            });
            if let Some((key, message)) = wrong {
                return Some((format!("outputs.{name}.{key}"), message));
            }
        }
        None
    }

    /// Whether any output is `port`.
    pub fn gives(&self, port: OutputPort) -> bool {
        self.outputs.values().any(|rule| rule.port == port)
    }
}

type Wrong = Option<(&'static str, String)>;

fn wrong_range(range: Option<[f32; 2]>) -> Wrong {
    let [low, high] = range?;
    let is_range = low.is_finite() && high.is_finite() && low < high;
    (!is_range).then(|| ("range", "two numbers, the lower first, as in [0, 1]".to_owned()))
}

impl InputRule {
    fn wrong(&self) -> Wrong {
        let channels = if self.order == Some(Order::Gray) { 1 } else { 3 };
        for (key, numbers) in [("mean", &self.mean), ("std", &self.std)] {
            let fits = [0, 1, channels].contains(&numbers.len()) && numbers.iter().all(|v| v.is_finite());
            if !fits {
                return Some((key, format!("{} numbers; expected 1 or {channels}", numbers.len())));
            }
        }
        if self.std.iter().any(|v| *v <= 0.0) {
            return Some(("std", "expected a number above 0".to_owned()));
        }
        if let Some([width, height]) = self.size
            && (width == 0 || height == 0 || width.max(height) > MAX_SIDE)
        {
            return Some(("size", format!("{width}x{height}; expected 1 to {MAX_SIDE} px")));
        }
        if self.size.is_some() && self.fit == FitRule::Multiple {
            return Some(("size", "with `fit = \"multiple\"` the size follows the image; remove one".to_owned()));
        }
        if self.multiple.is_some_and(|multiple| !(1..=1024).contains(&multiple)) {
            return Some(("multiple", "expected 1 to 1024 px".to_owned()));
        }
        if self.multiple.is_some() && self.fit != FitRule::Multiple {
            return Some(("multiple", "takes effect with `fit = \"multiple\"`; set it".to_owned()));
        }
        if !(0.0..=255.0).contains(&self.border) {
            return Some(("border", "expected 0 to 255".to_owned()));
        }
        wrong_range(self.range)
    }
}

impl OutputRule {
    fn wrong(&self) -> Wrong {
        use OutputPort::{Confidence, Depth, Detections, Disparity, Flow, Image, Mask};
        let units: &[Unit] = match self.port {
            Disparity | Flow => &[Unit::Px, Unit::Cells, Unit::Share],
            Depth => &[Unit::Mm, Unit::Cm, Unit::M],
            _ => &[],
        };
        let port = self.port.name();
        if self.unit.is_some_and(|unit| !units.contains(&unit)) {
            let message = match self.port {
                Disparity | Flow => format!("{port} is in \"px\", \"cells\" or \"share\""),
                Depth => format!("{port} is in \"mm\", \"cm\" or \"m\""),
                _ => format!("{port} has no unit; remove it"),
            };
            return Some(("unit", message));
        }
        if !self.scale.is_finite() || self.scale == 0.0 || !self.offset.is_finite() {
            return Some(("scale", "expected finite numbers, and `scale` not 0".to_owned()));
        }
        let takes = |ports: &[OutputPort]| ports.contains(&self.port);
        for (key, is_set, is_taken) in [
            ("channel", self.channel.is_some(), takes(&[Disparity, Depth, Mask, Confidence])),
            ("range", self.range.is_some(), takes(&[Image])),
            ("order", self.order.is_some(), takes(&[Image])),
            ("family", self.family != Family::Auto, takes(&[Detections])),
            ("activation", self.activation != Activation::None, !takes(&[Detections, Flow])),
            ("axes", self.axes.is_some(), !takes(&[Detections])),
        ] {
            if is_set && !is_taken {
                return Some((key, format!("has no effect on {port}; remove it")));
            }
        }
        wrong_range(self.range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "[inputs.left]\nport = \"left\"\n[outputs.d]\nport = \"disparity\"\n";

    #[test]
    fn a_table_has_defaults() {
        let table = PortTable::parse("t", GOOD).expect("a table");
        let left = &table.inputs["left"];
        assert_eq!((left.port, left.fit, left.border), (InputPort::Left, FitRule::Stretch, 114.0));
        assert_eq!((table.outputs["d"].scale, table.outputs["d"].unit), (1.0, None));
        assert!(table.gives(OutputPort::Disparity) && !table.gives(OutputPort::Depth));
    }

    #[test]
    fn mistakes_are_named_with_their_key_or_line() {
        for (text, part) in [
            ("inputs", "t, line 1:"),
            (
                "[inputs.left]\nport = \"middle\"\n[outputs.d]\nport = \"disparity\"\n",
                "t, line 2: unknown variant `middle`",
            ),
            (&format!("{GOOD}colour = 1\n"), "t, line 5: unknown field `colour`"),
            (
                "[inputs.a]\nport = \"left\"\n[inputs.b]\nport = \"left\"\n[outputs.d]\nport = \"depth\"\n",
                "`inputs.b.port`: `left` is already used",
            ),
            (&GOOD.replace("[inputs.left]\n", "[inputs.left]\nmean = [1, 2]\n"), "`inputs.left.mean`: 2 numbers"),
            (
                &GOOD.replace("[inputs.left]\n", "[inputs.left]\nstd = [0]\n"),
                "`inputs.left.std`: expected a number above 0",
            ),
            (&GOOD.replace("[inputs.left]\n", "[inputs.left]\nrange = [1, 0]\n"), "`inputs.left.range`"),
            (&GOOD.replace("[inputs.left]\n", "[inputs.left]\nsize = [0, 9]\n"), "`inputs.left.size`: 0x9"),
            (&GOOD.replace("[inputs.left]\n", "[inputs.left]\nmultiple = 32\n"), "fit = \"multiple\""),
            (&format!("{GOOD}unit = \"mm\"\n"), "`outputs.d.unit`: disparity is in \"px\""),
            (&format!("{GOOD}scale = 0\n"), "`outputs.d.scale`"),
            (&format!("{GOOD}order = \"rgb\"\n"), "`outputs.d.order`: has no effect on disparity"),
            ("[inputs.a]\nport = \"image\"\n[outputs]\n", "`outputs`: empty"),
        ] {
            let error = PortTable::parse("t", text).expect_err(text).to_string();
            assert!(error.contains(part), "{error} instead of {part}");
        }
    }

    #[test]
    fn a_missing_table_is_told_with_what_to_do() {
        let none = Path::new("");
        let error = PortTable::read(Path::new("/nowhere/m.onnx"), "", none).expect_err("none").to_string();
        assert!(error.contains("/nowhere/m.toml") && error.contains("panoscope describe /nowhere/m.onnx"), "{error}");
        assert!(matches!(PortTable::read(none, GOOD, Path::new("a.toml")), Err(TableError::Twice)));
        let error = PortTable::read(none, "", Path::new("/nowhere/a.toml")).expect_err("none").to_string();
        assert!(error.contains("cannot read the table /nowhere/a.toml"), "{error}");
    }
}
