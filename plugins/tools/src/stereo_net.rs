//! `stereo_net`: a network that matches two rectified views, with the map of a matcher as a hint, and says how far each disparity is to be trusted.
//!
//! The network (`plugins/stereo/training`) answers a disparity for every pixel, the scale of its error and the probability that the right view does
//! not show the point. It keeps what the matcher found where it trusts it, and fills and corrects the rest.

use std::path::PathBuf;

use ort::value::TensorElementType;
use panoscope_node::{
    AnyImage, Confidence, Context, Disparity, GrayF32, Image, Mask, Node, NodeInfo, Open, Parallel, Params, Ports,
    Result, Slot, View, ViewMut, error,
};

use crate::finite::{Rows, count_bad};
use crate::provider::Provider;
use crate::session::{Declared, InputValues, ModelSession, RunInput, Tensor, list_text};
use crate::yolo::picture_of;

mod frame;

use frame::{Frame, fill_map, fill_view};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Rectified left view, bgr8 or gray8.
    left: AnyImage<'f>,
    /// Rectified right view of the same instant, same size.
    right: AnyImage<'f>,
    /// Disparity of the left view by a matcher or a filter, px. Without it the network matches alone, which is less exact.
    matched: Option<Image<'f, Disparity>>,
    /// What of the left view is lit, not 0. The map is unknown elsewhere; without it all is lit.
    mask_left: Option<Image<'f, Mask>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// Disparity of the left view, px; NaN where unlit, and where the expected error exceeds `max_error_px`.
    disparity: Slot<'f, Disparity>,
    /// Confidence of each pixel, 0 to 1: what `measure` turns into the standard deviation that the network states.
    confidence: Slot<'f, Confidence>,
    /// Mean size of the error that the network expects at each pixel, px.
    error: Slot<'f, GrayF32>,
    /// 255 where the right view does not show the point, by the network.
    occluded: Slot<'f, Mask>,
}

/// Parameters.
#[derive(Params)]
pub struct StereoNetParams {
    /// ONNX file of the network.
    #[param(default = "models/stereo_net.onnx", reopen, must_exist, shipped)]
    model: PathBuf,
    /// Pixels whose expected error is larger are unknown; 0 keeps all.
    #[param(default = 0.0, range = 0.0..=100.0, step = 0.1, unit = "px")]
    max_error_px: f32,
    /// Factor by which views and map are shrunk before the network. 0 finds it from the width (1 below 1440 px, 2 from 1440, 3 from 2160, 4 from
    /// 2880) and from the range of `matched`, of which the network reaches 216 px.
    #[param(default = 0, range = 0..=8)]
    scale: usize,
    /// Number of threads of the network; 0 uses as many as the host has.
    #[param(default = 0, range = 0..=64, reopen)]
    threads: usize,
    /// Execution provider: the processor, or an accelerator if ONNX Runtime's library supports it and finds a device. Otherwise the processor is
    /// used, with a warning.
    #[param(default = "cpu", reopen)]
    provider: Provider,
}

/// Inputs of the network with their channels: views as RGB 0 to 1, the filled map in px, 1 where the matcher knows it. Each is 1xCxHxW.
const INPUTS: [(&str, usize); 4] = [("left", 3), ("right", 3), ("filled", 1), ("known", 1)];
/// Outputs of the network: px, px, 0 to 1. Each is 1x1xHxW.
const OUTPUTS: [&str; 3] = ["disparity", "scale", "occlusion"];
/// Side of the trial run, px.
const TRIAL_PX: usize = 64;
/// Network and matcher agree within so many of the errors that the network states, or within 1 px: 95 % of a Laplace distribution.
const AGREEING_ERRORS: f32 = 3.0;
/// Standard deviation of a Laplace distribution, in its scales.
const DEVIATION: f32 = std::f32::consts::SQRT_2;
/// A confidence of c has a standard deviation of this times (1 - c)^3, px, in `measure`.
const DOUBT_PX: f32 = 48.0;

/// The confidence that `measure` turns into the standard deviation of an error of this scale, px.
fn confidence_of(scale_px: f32) -> f32 {
    (1.0 - (DEVIATION * scale_px / DOUBT_PX).cbrt()).clamp(0.0, 1.0)
}

/// Matches views by a network.
pub struct StereoNet {
    session: ModelSession,
    /// As the network takes them.
    planes: [Vec<f32>; INPUTS.len()],
    /// Of each pixel, px.
    errors: Vec<f32>,
}

/// A file that is not such a network.
#[derive(Debug, thiserror::Error)]
pub enum NotStereoNet {
    /// An input or output is missing.
    #[error("{path} has no {side} `{name}`; it has {found}: `stereo_net` runs models/stereo_net.onnx and networks of its training, `onnx` others", path = path.display())]
    NoSuch {
        /// The file.
        path: PathBuf,
        /// `input` or `output`.
        side: &'static str,
        /// What is missing.
        name: &'static str,
        /// What the file has.
        found: String,
    },
    /// An input of another shape or type.
    #[error("{path} wants {found}, `stereo_net` gives f32 `left` and `right` 1x3x?x?, `filled` and `known` 1x1x?x?; export the network again by its training", path = path.display())]
    Input {
        /// The file.
        path: PathBuf,
        /// Its declaration.
        found: String,
    },
    /// An answer of another shape or type.
    #[error("{path} answers {found}, `stereo_net` reads f32 `{name}` 1x1x{rows}x{columns}; export the network again by its training", path = path.display())]
    Output {
        /// The file.
        path: PathBuf,
        /// Name of the output.
        name: &'static str,
        /// What it is.
        found: String,
        /// Columns of the inputs, px.
        columns: usize,
        /// Rows of the inputs, px.
        rows: usize,
    },
}

/// Refuses a file with other inputs and outputs.
fn check(session: &ModelSession) -> Result<(), NotStereoNet> {
    let path = || session.path().to_owned();
    let find = |side, name: &'static str, all: &[Declared]| {
        let found = all.iter().find(|declared| declared.name == name).cloned();
        found.ok_or_else(|| NotStereoNet::NoSuch { path: path(), side, name, found: list_text(all) })
    };
    for (name, channels) in INPUTS {
        let input = find("input", name, session.inputs())?;
        let fits = |dim: i64, wanted: i64| dim < 0 || dim == wanted;
        let is_image = matches!(input.dims[..], [batch, planes, rows, columns]
            if fits(batch, 1) && fits(planes, channels as i64) && rows < 0 && columns < 0);
        if !is_image || input.element != Some(TensorElementType::Float32) {
            return Err(NotStereoNet::Input { path: path(), found: input.to_string() });
        }
    }
    // Values that nothing gives would fail only in the run.
    if let Some(other) = session.inputs().iter().find(|input| INPUTS.iter().all(|(name, _)| *name != input.name)) {
        return Err(NotStereoNet::Input { path: path(), found: other.to_string() });
    }
    OUTPUTS.into_iter().try_for_each(|name| find("output", name, session.outputs()).map(drop))
}

/// Runs the network on its planes and hands its three outputs to `read`.
fn run<T>(
    session: &mut ModelSession,
    planes: &[Vec<f32>; INPUTS.len()],
    (columns, rows): (usize, usize),
    read: impl FnOnce([&[f32]; 3]) -> Result<T>,
) -> Result<T> {
    let inputs: Vec<_> = INPUTS
        .iter()
        .zip(planes)
        .map(|((name, channels), plane)| RunInput {
            name,
            dims: vec![1, *channels as i64, rows as i64, columns as i64],
            values: InputValues::F32(plane),
        })
        .collect();
    let path = session.path().to_owned();
    session.run(&inputs, |tensors| -> Result<T> {
        count_bad(&path, tensors, Rows::Whole)?;
        let plane = |name: &'static str| {
            let found = tensors.iter().find(|tensor| tensor.name == name);
            let values = found.and_then(|tensor| tensor.data.floats()).filter(|v| v.len() == columns * rows);
            values.ok_or_else(|| {
                let found = found.map_or_else(|| "nothing".to_owned(), Tensor::to_string);
                NotStereoNet::Output { path: path.clone(), name, found, columns, rows }
            })
        };
        read([plane(OUTPUTS[0])?, plane(OUTPUTS[1])?, plane(OUTPUTS[2])?])
    })?
}

impl StereoNet {
    /// Fills the network's inputs.
    fn prepare(&mut self, frame: &Frame, input: &In<'_>, pool: &dyn Parallel) -> Result<()> {
        let [left, right, filled, known] = &mut self.planes;
        fill_view(frame, picture_of(&input.left)?, 0, pool, left);
        fill_view(frame, picture_of(&input.right)?, frame.offset, pool, right);
        fill_map(frame, input.matched.as_ref().map(Image::view), filled, known);
        Ok(())
    }
}

impl Node for StereoNet {
    const INFO: NodeInfo = NodeInfo::blocking(
        "stereo_net",
        "stereo",
        "A network that matches two rectified views, with a matcher's map as a hint, and states its error.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = StereoNetParams;

    fn open(open: &Open<'_>, params: &StereoNetParams) -> Result<Self> {
        let threads = if params.threads == 0 { open.pool().threads() } else { params.threads };
        let mut session = ModelSession::open(&params.model, threads, params.provider)?;
        params.provider.warn_if_refused(open, session.path(), session.refused());
        check(&session)?;
        // The shapes of its answers are known only from a run.
        let pixels = TRIAL_PX * TRIAL_PX;
        let planes = INPUTS.map(|(_, channels)| vec![0.5; channels * pixels]);
        run(&mut session, &planes, (TRIAL_PX, TRIAL_PX), |_| Ok(()))?;
        Ok(Self { session, planes, errors: Vec::new() })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &StereoNetParams,
    ) -> Result<()> {
        let size = (input.left.width(), input.left.height());
        let others = [
            ("right", Some((input.right.width(), input.right.height()))),
            ("matched", input.matched.as_ref().map(|map| (map.width(), map.height()))),
            ("mask_left", input.mask_left.as_ref().map(|mask| (mask.width(), mask.height()))),
        ];
        for (name, other) in others {
            if let Some(other) = other.filter(|other| *other != size) {
                return Err(error!("`left` is {}x{}, `{name}` is {}x{}", size.0, size.1, other.0, other.1));
            }
        }
        let matched = input.matched.as_ref().map(Image::view);
        let frame = Frame::new(size, params.scale, matched);
        self.prepare(&frame, &input, cx.pool())?;
        let (session, errors) = (&mut self.session, &mut self.errors);
        let mask = input.mask_left.as_ref().map(Image::view);
        let write = |maps: [&[f32]; 3]| write(&frame, maps, (matched, mask), (params.max_error_px, errors), &mut out);
        run(session, &self.planes, frame.padded, write)
    }
}

/// Writes the outputs that are read.
fn write(
    frame: &Frame,
    [disparity, scale, occlusion]: [&[f32]; 3],
    (matched, mask): (Option<View<'_, f32>>, Option<View<'_, u8>>),
    (max_error_px, errors): (f32, &mut Vec<f32>),
    out: &mut Out<'_>,
) -> Result<()> {
    let ((width, height), factor) = (frame.size, frame.factor as f32);
    errors.resize(width * height, 0.0);
    let mut stated = ViewMut::new(&mut errors[..], width, height, 1);
    frame.enlarge(scale, &mut stated, |value| value * factor);
    let mut map = out.disparity.alloc(width, height)?;
    frame.enlarge(disparity, &mut map, |value| (value + frame.offset as f32) * factor);
    if let Some(matched) = matched {
        keep_matched(&mut map, matched, errors);
    }
    for (y, errors) in errors.chunks_exact(width.max(1)).enumerate().filter(|_| max_error_px > 0.0) {
        let row = map.row_mut(y).iter_mut().zip(errors);
        row.filter(|(_, error)| **error > max_error_px).for_each(|(out, _)| *out = f32::NAN);
    }
    let clear = |map: &mut ViewMut<'_, f32>, value: f32| {
        let Some(mask) = mask else { return };
        for y in 0..height {
            let row = map.row_mut(y).iter_mut().zip(mask.row(y));
            row.filter(|(_, lit)| **lit == 0).for_each(|(out, _)| *out = value);
        }
    };
    clear(&mut map, f32::NAN);
    let from_errors = |slot: &mut ViewMut<'_, f32>, unlit: f32, of: fn(f32) -> f32| {
        for (y, errors) in errors.chunks_exact(width.max(1)).enumerate() {
            slot.row_mut(y).iter_mut().zip(errors).for_each(|(out, error)| *out = of(*error));
        }
        clear(slot, unlit);
    };
    if out.confidence.is_read() {
        from_errors(&mut out.confidence.alloc(width, height)?, 0.0, confidence_of);
    }
    if out.error.is_read() {
        from_errors(&mut out.error.alloc(width, height)?, f32::NAN, |error| error);
    }
    if out.occluded.is_read() {
        let mut plane = out.occluded.alloc(width, height)?;
        for y in 0..height {
            let from = &occlusion[(y / frame.factor).min(frame.small.1 - 1) * frame.padded.0..];
            for (x, out) in plane.row_mut(y).iter_mut().enumerate() {
                *out = if from[(x / frame.factor).min(frame.small.0 - 1)] > 0.5 { 255 } else { 0 };
            }
        }
    }
    Ok(())
}

/// Takes the matcher's value where the network agrees within the error that it states: it is finer, most of all where views were shrunk.
fn keep_matched(map: &mut ViewMut<'_, f32>, matched: View<'_, f32>, errors: &[f32]) {
    for (y, errors) in errors.chunks_exact(matched.width.max(1)).enumerate() {
        for ((out, value), error) in map.row_mut(y).iter_mut().zip(matched.row(y)).zip(errors) {
            // False for NaN.
            if (*value - *out).abs() <= (AGREEING_ERRORS * error).max(1.0) {
                *out = *value;
            }
        }
    }
}
