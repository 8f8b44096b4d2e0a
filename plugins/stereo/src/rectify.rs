//! `rectify`: turns both views so that a point lies on one row in both (thesis, fig. 3.5).

use panoscope_imaging::lit::{LitFinder, LitPart};
use panoscope_imaging::shrink::shrink;
use panoscope_imaging::stereo::rotation::Matrix3;
use panoscope_imaging::stereo::{Rectification, RemapTable};
use panoscope_imaging::{Rect, View, ViewMut};
use panoscope_node::abi::{Calibration, Camera};
use panoscope_node::device::{Device, OnDevice};
use panoscope_node::{
    Bgr8, Choice, Context, Image, Mask, Node, NodeInfo, Open, Params, Ports, Result, Retained, Slot, Validation, Value,
    error,
};

use panoscope_data::calibration::packet as calibration;

use crate::gpu::rectify::{Rectifier, RectifyJob};
use crate::order::{OrderWatch, PairState};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view, not rectified.
    left: Image<'f, Bgr8>,
    /// Right view of the same instant.
    right: Image<'f, Bgr8>,
    /// Calibration of the cameras; the newest one is used until another arrives.
    calibration: Option<Value<'f, Calibration>>,
}

/// Outputs. All are empty while the views are swapped.
#[derive(Ports)]
pub struct Out<'f> {
    /// Rectified left view; black outside the camera's picture.
    left: Slot<'f, Bgr8>,
    /// Rectified right view.
    right: Slot<'f, Bgr8>,
    /// Calibration of the rectified views. Empty while one of them is late, which spoils what is measured.
    calibration: Slot<'f, Calibration>,
    /// 255 where the left view shows something: inside the scope's rim and inside what its camera covers. Empty while that is all of it.
    mask_left: Slot<'f, Mask>,
    /// The same of the right view.
    mask_right: Slot<'f, Mask>,
}

/// Parameters.
#[derive(Params)]
pub struct RectifyNodeParams {
    /// Passes the views on unchanged: for views that another program has rectified.
    #[param(default = false)]
    bypass: bool,
    /// What becomes of views without a calibration.
    #[param(default = "refuse")]
    uncalibrated: Uncalibrated,
    /// Factor by which views are shrunk, their calibration with them: each pixel is the mean of a block. All that follows works on fewer pixels.
    /// 0 finds the smallest factor whose views are at most 1280 px wide: 2 for 1920 px, 3 for 3840.
    #[param(default = 1, range = 0..=8)]
    scale: usize,
    /// Finds the dark rim of round and bordered scopes, from what stays dark over time and has the shape of a rim, and leaves it out of the masks.
    #[param(default = true)]
    find_rim: bool,
    /// What shrinks and turns the views. A GPU makes the same bytes; it pays for views of 1920x1080 and more. Without one the processor does it, with a warning.
    #[param(default = "cpu")]
    device: Device,
}

/// Width of the views that a `scale` of 0 leaves as they are, px.
const MODERATE_WIDTH_PX: usize = 1280;

/// The factor that a parameter `scale` stands for, for views of a width in px.
fn factor(scale: usize, width: usize) -> usize {
    if scale > 0 { scale } else { width.div_ceil(MODERATE_WIDTH_PX).clamp(1, 8) }
}

/// See [`RectifyNodeParams::uncalibrated`].
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Uncalibrated {
    /// The node fails.
    Refuse,
    /// The views are handed on as they are, without a calibration, until one arrives.
    Pass,
}

/// Maps of one calibration.
struct Maps {
    source: Calibration,
    /// By which the views are shrunk first.
    factor: usize,
    target: Calibration,
    /// `None` when the views are rectified already.
    tables: Option<[RemapTable; 2]>,
    /// What of the views the cameras cover.
    valid: Option<[LitPart; 2]>,
    /// The tables on the GPU.
    rectifier: OnDevice<Rectifier>,
    device: Device,
}

/// See the module.
pub struct Rectify {
    maps: Option<Maps>,
    /// A view that was shrunk, before it is turned.
    small: Vec<u8>,
    masks: [MaskMaker; 2],
    order: OrderWatch,
    /// Views have been handed on without a calibration.
    is_passing: bool,
}

/// Whether the cameras are those of the rectified views, so that every pixel stays where it is.
fn is_level(source: &Calibration, target: &Calibration, rectification: &Rectification) -> bool {
    const EYE: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    (source.left, source.right) == (target.left, target.right)
        && (rectification.rotation_left, rectification.rotation_right) == (EYE, EYE)
}

impl Maps {
    fn new(source: &Calibration, factor: usize, device: Device, cx: &Context<'_>) -> Result<Self> {
        let small = calibration::shrunk(source, factor as u32);
        let rectification = calibration::rectification(&small)?;
        let target = match source.is_rectified {
            0 => calibration::rectified(&small, &rectification),
            _ => small,
        };
        if source.is_rectified != 0 || is_level(&small, &target, &rectification) {
            // Views that stay as they are need nothing.
            let gpu = if factor > 1 { device } else { Device::Cpu };
            let mut rectifier = OnDevice::default();
            rectifier.choose(gpu, cx, |gpu| Rectifier::new(gpu, factor, None));
            return Ok(Self { source: *source, factor, target, tables: None, valid: None, rectifier, device });
        }
        let (left, right) = (calibration::camera(&small.left)?, calibration::camera(&small.right)?);
        let all = Rect::whole(rectification.width, rectification.height);
        let tables = [
            RemapTable::left(&left, &rectification, all, cx.pool())?,
            RemapTable::right(&right, &rectification, all, cx.pool())?,
        ];
        for ((side, camera), table) in [("left", &left), ("right", &right)].into_iter().zip(&tables) {
            if table.is_folded() {
                cx.warn(&format!(
                    "the distortion of the {side} camera turns back {:.0} px from its centre: what lies beyond is left out. Calibrate with the board near the borders of the view",
                    camera.fold_px().unwrap_or_default() * factor as f64
                ));
            }
        }
        let valid = Some(tables.each_ref().map(RemapTable::valid));
        let mut rectifier = OnDevice::default();
        rectifier.choose(device, cx, |gpu| Rectifier::new(gpu, factor, Some(tables.each_ref())));
        Ok(Self { source: *source, factor, target, tables: Some(tables), valid, rectifier, device })
    }
}

/// A rectified view that is on the GPU alone, of which few pixels are made from the camera's view: the same values.
struct Unfetched<'a> {
    view: View<'a, u8>,
    factor: usize,
    map: Option<&'a RemapTable>,
}

impl Unfetched<'_> {
    /// A pixel of the shrunk view.
    fn shrunk(&self, x: usize, y: usize) -> [u8; 3] {
        let area = (self.factor * self.factor) as u32;
        let mut sums = [area / 2; 3];
        for y in y * self.factor..(y + 1) * self.factor {
            let pixels = &self.view.row(y)[3 * x * self.factor..3 * (x + 1) * self.factor];
            for pixel in pixels.as_chunks::<3>().0 {
                sums.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += u32::from(*value));
            }
        }
        sums.map(|sum| (sum / area) as u8)
    }

    /// The brightest channel of a pixel.
    fn level(&self, x: usize, y: usize) -> u32 {
        let [b, g, r] = match self.map {
            Some(map) => map.pixel(x, y, |x, y| self.shrunk(x, y)),
            None => self.shrunk(x, y),
        };
        u32::from(b.max(g).max(r))
    }
}

/// Finds what of a view is lit, and keeps the mask of it.
#[derive(Default)]
struct MaskMaker {
    finder: LitFinder,
    part: LitPart,
    mask: Option<Retained<Mask>>,
}

impl MaskMaker {
    /// Hands the mask of a view on, which is `handed` on too; none while all of it is lit. A view that is on the GPU stays
    /// there.
    fn make(
        &mut self,
        handed: &Slot<'_, Bgr8>,
        unfetched: Option<Unfetched<'_>>,
        out: &mut Slot<'_, Mask>,
        valid: Option<&LitPart>,
        find_rim: bool,
    ) -> Result<()> {
        if !out.is_read() {
            return Ok(());
        }
        // A view that is not read is not made.
        let Some(made) = handed.retain() else { return Ok(()) };
        let [width, height] = [made.frame().width, made.frame().height].map(|n| n as usize);
        let mut is_new = self.part.size() != (width, height);
        if find_rim {
            is_new |= match unfetched {
                Some(view) => self.finder.look_at((width, height), |x, y| view.level(x, y), valid),
                None => self.finder.look(made.view(), valid),
            };
        } else {
            self.finder.forget();
            is_new |= valid.map_or(!self.part.is_whole(), |valid| self.part != *valid);
        }
        if is_new {
            self.part = match (find_rim, valid) {
                (true, _) if self.finder.part().size() == (width, height) => self.finder.part().clone(),
                (_, Some(valid)) => valid.clone(),
                (_, None) => LitPart::whole(width, height),
            };
            self.mask = None;
        }
        if self.part.is_whole() {
            return Ok(());
        }
        if let Some(mask) = &self.mask {
            return out.forward_anew(mask);
        }
        self.part.write_mask(out.alloc(width, height)?);
        self.mask = out.retain();
        Ok(())
    }
}

/// Hands both masks on.
fn make_masks(
    makers: &mut [MaskMaker; 2],
    out: &mut Out<'_>,
    [unfetched_left, unfetched_right]: [Option<Unfetched<'_>>; 2],
    valid: Option<&[LitPart; 2]>,
    params: &RectifyNodeParams,
) -> Result<()> {
    let [left, right] = makers;
    let [valid_left, valid_right] = valid.map_or([None, None], |[left, right]| [Some(left), Some(right)]);
    left.make(&out.left, unfetched_left, &mut out.mask_left, valid_left, params.find_rim)?;
    right.make(&out.right, unfetched_right, &mut out.mask_right, valid_right, params.find_rim)
}

/// Shrinks and turns both views on the GPU, where they stay. Whether it did; a GPU that fails is given up.
fn make_on_gpu(maps: &mut Maps, input: &In<'_>, out: &mut Out<'_>, cx: &Context<'_>) -> Result<bool> {
    let size = (maps.target.left.width as usize, maps.target.left.height as usize);
    maps.rectifier.attempt(cx, |rectifier| {
        let slots = [(&input.left, &mut out.left), (&input.right, &mut out.right)];
        let mut jobs = [None, None];
        for ((view, slot), job) in slots.into_iter().zip(&mut jobs).filter(|((_, slot), _)| slot.is_read()) {
            *job = Some(RectifyJob { view: view.on_device()?, out: slot.alloc_on_device(size.0, size.1)? });
        }
        rectifier.run(jobs)
    })
}

/// Hands a view on, shrunk and turned by the map, if there is one.
fn make(
    view: &Image<'_, Bgr8>,
    out: &mut Slot<'_, Bgr8>,
    (factor, map): (usize, Option<&RemapTable>),
    small: &mut Vec<u8>,
    cx: &Context<'_>,
) -> Result<()> {
    if factor == 1 && map.is_none() {
        return out.forward(view.frame());
    }
    if !out.is_read() {
        return Ok(());
    }
    let (width, height) = (view.width() / factor, view.height() / factor);
    let Some(map) = map else {
        shrink(view.view(), factor, out.alloc(width, height)?, cx.pool());
        return Ok(());
    };
    let mut source = view.view();
    if factor > 1 {
        small.resize(width * height * 3, 0);
        shrink(source, factor, ViewMut::new(small, width, height, 3), cx.pool());
        source = View::new(small, width, height, 3);
    }
    map.remap(source, out.alloc(width, height)?, cx.pool())?;
    Ok(())
}

/// Whether a view has the size that the calibration was made for.
fn check_size(side: &str, (width, height): (usize, usize), camera: &Camera) -> Result<()> {
    if (width, height) == (camera.width as usize, camera.height as usize) {
        return Ok(());
    }
    Err(error!("the {side} view is {width}x{height}, the calibration was made for {}x{}", camera.width, camera.height))
}

impl Rectify {
    /// Passes both views on, smaller by `factor`, without the rectification.
    fn pass(
        &mut self,
        cx: &Context<'_>,
        input: &In<'_>,
        out: &mut Out<'_>,
        factor: usize,
        params: &RectifyNodeParams,
    ) -> Result<()> {
        make(&input.left, &mut out.left, (factor, None), &mut self.small, cx)?;
        make(&input.right, &mut out.right, (factor, None), &mut self.small, cx)?;
        make_masks(&mut self.masks, out, [None, None], None, params)
    }

    /// Makes new maps where the calibration, the factor or the device has changed.
    fn renew_maps(
        &mut self,
        cx: &Context<'_>,
        given: Option<&Calibration>,
        factor: usize,
        params: &RectifyNodeParams,
    ) -> Result<()> {
        let given = given.or(self.maps.as_ref().map(|maps| &maps.source)).copied();
        if let Some(given) = given
            && self.maps.as_ref().is_none_or(|maps| {
                maps.factor != factor || maps.device != params.device || !calibration::same(&maps.source, &given)
            })
        {
            if self.maps.as_ref().is_some_and(|maps| !calibration::same(&maps.source, &given)) {
                cx.info("the calibration has changed: new maps");
            }
            self.maps = None;
            self.masks = Default::default();
            self.maps = Some(Maps::new(&given, factor, params.device, cx)?);
            if std::mem::replace(&mut self.is_passing, false) {
                cx.info("a calibration has arrived: the views are rectified from now on");
            }
        }
        Ok(())
    }
}

impl Node for Rectify {
    const INFO: NodeInfo =
        NodeInfo::compute("rectify", "stereo", "Turns both views so that a point lies on one row in both.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = RectifyNodeParams;

    fn validate(params: &RectifyNodeParams, check: &mut Validation<'_>) {
        if params.bypass || check.is_connected("calibration") != Some(false) {
            return;
        }
        if params.uncalibrated == Uncalibrated::Refuse {
            check.node_error(
                "there is no calibration to rectify by: input `calibration` is not connected",
                "connect it, as in calibration = \"scope.calibration\", or set bypass = true when the views are rectified already",
            );
        } else {
            check.node_warning(
                "there is no calibration to rectify by: the views stay as they are, and nothing is known of their depth",
                "connect it, as in calibration = \"scope.calibration\"",
            );
        }
    }

    fn open(_: &Open<'_>, _: &RectifyNodeParams) -> Result<Self> {
        Ok(Self {
            maps: None,
            small: Vec::new(),
            masks: Default::default(),
            order: OrderWatch::default(),
            is_passing: false,
        })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &RectifyNodeParams,
    ) -> Result<()> {
        let factor = factor(params.scale, input.left.width());
        let size = (input.left.width() / factor, input.left.height() / factor);
        if size.0 == 0 || size.1 == 0 {
            let (width, height) = (input.left.width(), input.left.height());
            return Err(error!("views of {width}x{height} cannot be shrunk by {factor}: set a smaller `scale`"));
        }
        let views = [input.left.view(), input.right.view()];
        let same_size = (views[0].width, views[0].height) == (views[1].width, views[1].height);
        if params.bypass {
            if let Some(given) = &input.calibration {
                let state = if same_size { self.order.look(cx, views, given, true) } else { PairState::Fits };
                if state == PairState::Exchanged {
                    return Ok(());
                }
                if state == PairState::Fits {
                    out.calibration
                        .set(Calibration { is_rectified: 1, ..calibration::shrunk(given, factor as u32) })?;
                }
            }
            return self.pass(cx, &input, &mut out, factor, params);
        }
        self.renew_maps(cx, input.calibration.as_deref(), factor, params)?;
        let Some(maps) = &mut self.maps else {
            if params.uncalibrated == Uncalibrated::Pass {
                if !std::mem::replace(&mut self.is_passing, true) {
                    cx.warn("no calibration has arrived: the views stay as they are, and nothing is known of their depth. Connect `calibration`");
                }
                return self.pass(cx, &input, &mut out, factor, params);
            }
            return Err(error!(
                "no calibration has arrived: connect `calibration`, or set `bypass` when the views are rectified already"
            ));
        };
        check_size("left", (input.left.width(), input.left.height()), &maps.source.left)?;
        check_size("right", (input.right.width(), input.right.height()), &maps.source.right)?;
        match self.order.look(cx, views, &maps.source, maps.source.is_rectified != 0) {
            PairState::Fits => out.calibration.set(maps.target)?,
            PairState::Late => {}
            PairState::Exchanged => return Ok(()),
        }
        let is_on_gpu = make_on_gpu(maps, &input, &mut out, cx)?;
        let [left, right] = match &maps.tables {
            Some([left, right]) => [Some(left), Some(right)],
            None => [None, None],
        };
        let mut unfetched = [None, None];
        if is_on_gpu {
            unfetched = [(views[0], left), (views[1], right)].map(|(view, map)| Some(Unfetched { view, factor, map }));
        } else {
            make(&input.left, &mut out.left, (factor, left), &mut self.small, cx)?;
            make(&input.right, &mut out.right, (factor, right), &mut self.small, cx)?;
        }
        make_masks(&mut self.masks, &mut out, unfetched, maps.valid.as_ref(), params)
    }
}
