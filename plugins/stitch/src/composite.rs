//! `composite`: combines overlapping views and their homographies into one wide image (thesis, chapter 2.2 and Alg. 2.3).

use std::time::Duration;

use panoscope_imaging::Report;
use panoscope_imaging::lit::HeldMask;
use panoscope_imaging::stitch::{
    self, BlendMethod, BorderMethod, CompositeParams, Compositor, CropMethod, ExposureMethod, GeometryState, LazyView,
    MAX_VIEWS, Painter, SeamCost, SeamMethod,
};
use panoscope_node::abi::{self, Homography, Roi, Scalar};
use panoscope_node::device::{Device, given_up};
use panoscope_node::{
    Bgr8, Choice, Context, Gray8, Image, List, Mask, Node, NodeInfo, Open, Params, Ports, Result, Slot, TextPacket,
    Validation, Value, View, error,
};

use crate::gpu::warp::{SharedFrame, Warper, locked};
use crate::view_gain::ViewGain;

/// Method that finds the seam between two views.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Seam {
    /// Exact minimum cut of the reduced overlap.
    GraphCut,
    /// Shortest path through the reduced overlap.
    DynamicProgramming,
    /// Later views cover earlier ones.
    None,
}

/// Cost of the seam between two pixels.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Cost {
    /// Euclidean colour difference of the two views (thesis 2.2).
    Color,
    /// Colour difference divided by the local gradient: seams hide along edges (Kwatra et al. 2003, eq. 2).
    ColorGradient,
    /// The larger of the colour difference and its mean over the width of the transition.
    Transition,
}

/// Output while a frame's registration is lost or implausible.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum OnLost {
    /// The panorama of this frame's views with the last good homography, marked as lost.
    Last,
    /// None: the outputs stay empty until the next good frame (thesis 2.4.3).
    Skip,
}

/// Blending of the views along the seam.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Blend {
    /// Laplacian pyramid.
    MultiBand,
    /// Linear weights.
    Feather,
    /// A hard edge.
    None,
}

/// Exposure correction.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Exposure {
    /// One gain per view.
    Gain,
    /// One gain per view and colour.
    ChannelGain,
    /// None.
    None,
}

/// Treatment of the panorama's outer border, which is ragged where views end.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Border {
    /// Unchanged.
    AsIs,
    /// Fades to black.
    Fade,
    /// Black outside the largest upright rectangle that the views cover.
    Crop,
}

/// Region of the plane that the panorama shows.
#[derive(Choice, Clone, Copy, PartialEq)]
pub enum Crop {
    /// The whole canvas around the first good registration.
    None,
    /// The bounding box of the illuminated part of the views.
    Content,
    /// The largest upright rectangle that the views fill with illuminated pixels: no black border.
    Filled,
}

/// Parameters of the composite.
#[derive(Params, Clone, PartialEq)]
pub struct CompositeNodeParams {
    /// Method that finds the seam between two views.
    #[param(default = "graph_cut")]
    seam: Seam,
    /// Factor by which the overlap is reduced before the seam is found; 1 finds it at full size. 0 selects the factor by the width of the views: 10
    /// up to 1280 px, 15 for 1920, 30 for 3840.
    #[param(default = 0, range = 0..=64)]
    seam_scale: u32,
    /// Maximum number of frames before the seam is found again.
    #[param(default = 15, range = 1..=10000, unit = "frames")]
    seam_interval: u32,
    /// Cost of the seam between two pixels.
    #[param(default = "color_gradient")]
    seam_cost: Cost,
    /// Minimum improvement in colour difference for a new seam to replace the previous one; 0 ignores the previous seam.
    #[param(default = 0.5, range = 0.0..=20.0, step = 0.1, unit = "levels")]
    seam_hold: f32,
    /// Blending of the views along the seam.
    #[param(default = "multi_band")]
    blend: Blend,
    /// Width of the transition across the seam.
    #[param(default = 32, range = 0..=256, unit = "px")]
    blend_px: u32,
    /// Exposure correction.
    #[param(default = "channel_gain")]
    exposure: Exposure,
    /// Width of the panorama; 0 takes it from the first good registration.
    #[param(default = 0, range = 0..=8192, unit = "px")]
    canvas_width: u32,
    /// Height of the panorama; 0 takes it from the first good registration.
    #[param(default = 0, range = 0..=8192, unit = "px")]
    canvas_height: u32,
    /// Margin around the first good registration, so that the canvas need not move.
    #[param(default = 16, range = 0..=512, unit = "px")]
    canvas_margin: u32,
    /// Number of consecutive frames that must leave the canvas before it grows; 0 never grows it.
    #[param(default = 0, range = 0..=10000, unit = "frames")]
    canvas_grow: u32,
    /// Region of the plane that the panorama shows. A crop is held: its size changes rarely, in steps. Has no effect with a fixed width and height.
    #[param(default = "none")]
    crop: Crop,
    /// Time for which a larger region must have been covered before a cropped panorama grows, or a bounding box must have been wrong before it
    /// changes.
    #[param(default = 4.0, range = 0.0..=60.0, step = 0.5, unit = "s")]
    crop_hold: f32,
    /// Treatment of the panorama's outer border.
    #[param(default = "as_is")]
    border: Border,
    /// Width of a fading border.
    #[param(default = 24, range = 1..=512, unit = "px")]
    border_px: u32,
    /// Draws an arrow that points up in the left view.
    #[param(default = false)]
    up_cue: bool,
    /// Direction of up in the left view, clockwise from the top of the image.
    #[param(default = 0.0, range = -180.0..=180.0, step = 1.0, unit = "deg")]
    up_deg: f32,
    /// Marks frames whose registration is lost.
    #[param(default = true)]
    mark_lost: bool,
    /// Output while a frame's registration is lost or implausible.
    #[param(default = "last")]
    pub(crate) on_lost: OnLost,
    /// What draws panoramas of two views. A GPU sometimes rounds positions differently, by 1/64 px; it is worthwhile for views of 1920x1080 and
    /// more, and with views that are on the GPU. The panorama stays there, unless marks or a border are drawn on it. The processor still finds and
    /// blends the seam, for which it reads samples and the columns around the seam. Without a GPU, and for more views, the processor draws.
    #[param(default = "cpu")]
    pub(crate) device: Device,
}

/// The compositor of a node, and the device that it draws with.
pub(crate) struct Drawer {
    pub kernel: Compositor,
    masks: [HeldMask; MAX_VIEWS],
    device: Device,
    /// Images for a painter on the GPU.
    frame: SharedFrame,
    /// Number of seams found since the node was opened.
    seams: u64,
    gain: ViewGain,
    /// Capture time of the last tick, ns.
    captured_ns: Option<i64>,
}

impl Drawer {
    pub(crate) fn new(params: &CompositeNodeParams, report: &dyn Report) -> Self {
        let kernel = Compositor::new(params.kernel());
        let mut drawer = Self {
            kernel,
            masks: Default::default(),
            device: Device::Cpu,
            frame: SharedFrame::default(),
            seams: 0,
            gain: ViewGain::default(),
            captured_ns: None,
        };
        drawer.choose(params.device, report);
        drawer
    }

    fn choose(&mut self, device: Device, report: &dyn Report) {
        if device != self.device {
            self.device = device;
            let painter = device.open(report, |gpu| Warper::new(gpu, self.frame.clone()));
            self.kernel.set_painter(painter.map(|warper| Box::new(warper) as Box<dyn Painter>));
        }
    }

    /// Gives the views of the tick to a painter on the GPU, if there is one that draws them.
    fn give_views(&self, scene: &Scene<'_>) {
        if self.kernel.has_painter() && scene.count <= 2 {
            // A view that does not get there is missed by the painter, which is then given up.
            let views = scene.views().iter().filter_map(|view| view.0.on_device().ok());
            let mut frame = locked(&self.frame);
            frame.views.clear();
            frame.views.extend(views);
        }
    }

    /// Whether the homographies of the scene are used.
    pub(crate) fn accepts(&mut self, scene: &Scene<'_>) -> Result<bool> {
        Ok(self.kernel.accepts(scene.views(), &scene.maps[..scene.count], scene.state)?)
    }

    /// Updates the masks of the views.
    pub(crate) fn take_masks(&mut self, inputs: &SceneInputs<'_, '_>) -> Result<()> {
        let given = inputs.masks.map_or(0, List::len);
        if given > 0 && inputs.views.map(List::len) != Some(given) {
            let count = inputs.views.map_or(0, List::len);
            return Err(error!("{given} masks are connected for {count} views: connect one for each, or none"));
        }
        for (view, held) in self.masks.iter_mut().enumerate() {
            let (mask, image) = match inputs.views {
                Some(views) => (inputs.masks.and_then(|masks| masks.get(view)), views.get(view)),
                None => (
                    inputs.pair_masks.get(view).copied().flatten().copied(),
                    inputs.pair.get(view).copied().flatten().copied(),
                ),
            };
            if let (Some(mask), Some(image)) = (&mask, &image)
                && (mask.width(), mask.height()) != (image.width(), image.height())
            {
                let (mask_name, name) = match (inputs.views, view) {
                    (Some(_), _) => (format!("mask {view} of `masks`"), format!("view {view} of `views`")),
                    (None, 0) => ("`mask_left`".to_owned(), "`left`".to_owned()),
                    (None, _) => ("`mask_right`".to_owned(), "`right`".to_owned()),
                };
                return Err(error!(
                    "{mask_name} is {}x{}, but {name} is {}x{}: connect the mask of this view",
                    mask.width(),
                    mask.height(),
                    image.width(),
                    image.height()
                ));
            }
            if held.update(mask.as_ref().map(Image::view)) {
                self.kernel.set_lit(view, held.part());
            }
        }
        Ok(())
    }

    /// Updates changed parameters.
    pub(crate) fn set_params(&mut self, params: &CompositeNodeParams, report: &dyn Report) {
        let wanted = params.kernel();
        if *self.kernel.params() != wanted {
            self.kernel.set_params(wanted);
        }
        self.choose(params.device, report);
    }
}

impl CompositeNodeParams {
    pub(crate) fn kernel(&self) -> CompositeParams {
        let fixed = self.canvas_width > 0 && self.canvas_height > 0;
        CompositeParams {
            seam: match self.seam {
                Seam::GraphCut => SeamMethod::GraphCut,
                Seam::DynamicProgramming => SeamMethod::DynamicProgramming,
                Seam::None => SeamMethod::None,
            },
            seam_scale: self.seam_scale as usize,
            seam_interval_frames: self.seam_interval,
            seam_cost: match self.seam_cost {
                Cost::Color => SeamCost::Color,
                Cost::ColorGradient => SeamCost::ColorGradient,
                Cost::Transition => SeamCost::Transition,
            },
            seam_hold_levels: self.seam_hold,
            blend: match self.blend {
                Blend::MultiBand => BlendMethod::MultiBand,
                Blend::Feather => BlendMethod::Feather,
                Blend::None => BlendMethod::None,
            },
            blend_px: self.blend_px as usize,
            exposure: match self.exposure {
                Exposure::Gain => ExposureMethod::Gain,
                Exposure::ChannelGain => ExposureMethod::ChannelGain,
                Exposure::None => ExposureMethod::None,
            },
            canvas: fixed.then_some((self.canvas_width as usize, self.canvas_height as usize)),
            canvas_margin_px: self.canvas_margin as usize,
            canvas_grow_after_frames: self.canvas_grow,
            crop: match self.crop {
                Crop::None => CropMethod::None,
                Crop::Content => CropMethod::Content,
                Crop::Filled => CropMethod::Filled,
            },
            crop_hold_s: self.crop_hold,
            border: match self.border {
                Border::AsIs => BorderMethod::AsIs,
                Border::Fade => BorderMethod::Fade,
                Border::Crop => BorderMethod::Crop,
            },
            border_px: self.border_px as usize,
            up_cue_deg: self.up_cue.then_some(self.up_deg),
            mark_lost: self.mark_lost,
            ..CompositeParams::default()
        }
    }
}

/// Inputs of the composite: `left`, `right` and `homography`, or `views` and `homographies`.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view; the panorama is in its plane.
    left: Option<Image<'f, Bgr8>>,
    /// Right view of the same instant.
    right: Option<Image<'f, Bgr8>>,
    /// Maps right-view pixels to left-view pixels.
    homography: Option<Value<'f, Homography>>,
    /// Two to eight views instead of `left` and `right`; the panorama is in the plane of the first.
    views: Option<List<'f, Image<'f, Bgr8>>>,
    /// One homography for each further view of `views`, which maps its pixels to the first view's.
    homographies: Option<List<'f, Value<'f, Homography>>>,
    /// Nonzero where `left` is illuminated: only those pixels are shown, compared and blended. Unconnected: all pixels.
    mask_left: Option<Image<'f, Mask>>,
    /// Nonzero where `right` is illuminated.
    mask_right: Option<Image<'f, Mask>>,
    /// Nonzero where each of `views` is illuminated, in their order. Unconnected: all pixels.
    masks: Option<List<'f, Image<'f, Mask>>>,
}

/// Outputs of the composite.
#[derive(Ports)]
pub struct Out<'f> {
    /// The panorama; black outside all views.
    panorama: Slot<'f, Bgr8>,
    /// 255 inside the views, 0 elsewhere.
    mask: Slot<'f, Mask>,
    /// Rectangle of the first view in the panorama, px.
    canvas: Slot<'f, Roi>,
    /// View that each pixel shows: 0 none, 1 the first, 2 the second and so on.
    shown: Slot<'f, Gray8>,
    /// Area of the panorama beyond that of the first view, percent. In a cropped panorama only illuminated pixels count.
    gain: Slot<'f, Scalar>,
    /// The same as text: `+12 % over one view`. It changes rarely.
    gain_text: Slot<'f, TextPacket>,
}

/// The `composite` node.
pub struct Composite {
    drawer: Drawer,
}

/// Inputs for the views of a tick: two of them with their homography, or a list with one homography for each but the first.
pub(crate) struct SceneInputs<'i, 'f> {
    pub pair: [Option<&'i Image<'f, Bgr8>>; 2],
    pub pair_masks: [Option<&'i Image<'f, Mask>>; 2],
    pub homography: Option<&'i Homography>,
    pub views: Option<&'i List<'f, Image<'f, Bgr8>>>,
    pub homographies: Option<&'i List<'f, Value<'f, Homography>>>,
    pub masks: Option<&'i List<'f, Image<'f, Mask>>>,
}

/// A view of a tick, which is copied to the host's memory when it is read there.
#[derive(Clone, Copy)]
pub(crate) struct SceneView<'f>(pub Image<'f, Bgr8>);

impl LazyView for SceneView<'_> {
    fn layout(&self) -> View<'_, u8> {
        let stride = self.0.frame().stride_bytes as usize;
        View { data: &[], width: self.0.width(), height: self.0.height(), stride, channels: 3 }
    }

    fn pixels(&self) -> View<'_, u8> {
        self.0.view()
    }
}

/// The views of a tick and their maps to the first one.
pub(crate) struct Scene<'f> {
    views: [SceneView<'f>; MAX_VIEWS],
    pub maps: [[f64; 9]; MAX_VIEWS],
    /// State of each map.
    pub states: [u32; MAX_VIEWS],
    pub count: usize,
    /// The worst of these states.
    pub state: GeometryState,
}

impl<'f> Scene<'f> {
    /// A scene of one view.
    fn new(first: Image<'f, Bgr8>) -> Self {
        Self {
            views: [SceneView(first); MAX_VIEWS],
            maps: [stitch::IDENTITY; MAX_VIEWS],
            states: [abi::STATE_FRESH; MAX_VIEWS],
            count: 1,
            state: GeometryState::Fresh,
        }
    }

    /// All views.
    pub(crate) fn views(&self) -> &[SceneView<'f>] {
        &self.views[..self.count]
    }

    /// Columns and rows of a view.
    pub(crate) fn size(&self, view: usize) -> (usize, usize) {
        (self.views[view].0.width(), self.views[view].0.height())
    }

    fn push(&mut self, view: Image<'f, Bgr8>, map: &Homography) -> Result<()> {
        if self.count == MAX_VIEWS {
            return Err(error!("the connected views exceed the limit of {MAX_VIEWS}"));
        }
        self.views[self.count] = SceneView(view);
        (self.maps[self.count], self.states[self.count]) = (map.left_from_right, map.state);
        // The worst state of all views decides.
        self.state = match (map.state, self.state) {
            (abi::STATE_LOST, _) | (_, GeometryState::Lost) => GeometryState::Lost,
            (abi::STATE_HELD, _) | (_, GeometryState::Held) => GeometryState::Held,
            _ => GeometryState::Fresh,
        };
        self.count += 1;
        Ok(())
    }

    /// `None` while a view or its homography is missing.
    pub(crate) fn of(input: &SceneInputs<'_, 'f>) -> Result<Option<Self>> {
        if let Some(views) = input.views {
            let Some(first) = views.get(0) else { return Ok(None) };
            let mut scene = Self::new(first);
            let maps = input.homographies;
            let given = maps.map_or(0, List::len);
            if given + 1 != views.len() {
                return Err(error!(
                    "{} views need {} homographies, but {given} are connected",
                    views.len(),
                    views.len() - 1
                ));
            }
            for index in 1..views.len() {
                let (Some(view), Some(map)) = (views.get(index), maps.and_then(|m| m.get(index - 1))) else {
                    return Ok(None);
                };
                scene.push(view, &map)?;
            }
            return Ok(Some(scene));
        }
        let [Some(left), Some(right)] = input.pair else { return Ok(None) };
        let mut scene = Self::new(*left);
        let lost = Homography { left_from_right: stitch::IDENTITY, rms_px: 0.0, inliers: 0, state: abi::STATE_LOST };
        scene.push(*right, input.homography.unwrap_or(&lost))?;
        Ok(Some(scene))
    }
}

/// Outputs that belong to a panorama.
pub(crate) struct Slots<'s, 'f> {
    pub panorama: &'s mut Slot<'f, Bgr8>,
    pub mask: &'s mut Slot<'f, Mask>,
    pub canvas: &'s mut Slot<'f, Roi>,
    pub shown: &'s mut Slot<'f, Gray8>,
    pub gain: &'s mut Slot<'f, Scalar>,
    pub gain_text: &'s mut Slot<'f, TextPacket>,
}

/// Draws the panorama of a tick and fills the other outputs.
pub(crate) fn draw(drawer: &mut Drawer, cx: &Context<'_>, scene: &Scene<'_>, slots: Slots<'_, '_>) -> Result<()> {
    drawer.give_views(scene);
    let Drawer { kernel, frame, seams, gain, captured_ns, .. } = drawer;
    let (views, maps, state) = (scene.views(), &scene.maps[..scene.count], scene.state);
    let now_ns = cx.tick().capture_ns;
    if let Some(elapsed_ns) = captured_ns.replace(now_ns).and_then(|before| u64::try_from(now_ns - before).ok()) {
        kernel.set_frame_interval(Duration::from_nanos(elapsed_ns));
    }
    let canvas = kernel.canvas(views, maps, state)?;
    let mask_is_read = slots.mask.is_read();
    let mut mask = if mask_is_read { Some(slots.mask.alloc(canvas.width, canvas.height)?) } else { None };
    let stays = kernel.can_stay_on_device(views, maps, state)?;
    // Without room on the GPU the panorama comes back.
    let on_device = stays.then(|| slots.panorama.alloc_on_device(canvas.width, canvas.height).ok()).flatten();
    locked(frame).panorama = on_device;
    let report = if on_device.is_some() {
        let (report, drawn) = kernel.compose_on_device(views, maps, state, cx.pool(), mask.as_mut())?;
        if let Some(drawn) = drawn {
            slots.panorama.alloc(canvas.width, canvas.height)?.data.copy_from_slice(drawn.data);
        }
        report
    } else {
        let mut panorama = slots.panorama.alloc(canvas.width, canvas.height)?;
        kernel.compose(views, maps, state, cx.pool(), &mut panorama, mask.as_mut())?
    };
    if let Some(reason) = kernel.take_painter_fault() {
        cx.warn(&given_up(&reason));
    }
    cx.metric("seam_cost_levels", f64::from(report.seam_cost));
    cx.metric("seam_ms", report.seam_time.as_secs_f64() * 1e3);
    *seams += u64::from(report.seam_found);
    cx.metric("seams_found", *seams as f64);
    cx.metric("view_gain_pct", report.view_gain_percent);
    gain.update(report.view_gain_percent);
    gain.set(report.view_gain_percent, slots.gain, slots.gain_text)?;
    if slots.shown.is_read() {
        kernel.shown(&mut slots.shown.alloc(canvas.width, canvas.height)?)?;
    }
    let (width, height) = scene.size(0);
    let (width, height) = (width as i32, height as i32);
    slots.canvas.set(Roi { x: canvas.left, y: canvas.top, width, height })
}

/// Reports connected views and homographies whose numbers do not match.
pub(crate) fn check_views(check: &mut Validation<'_>) {
    let count = |name: &str| check.connections(name);
    let (Some(views), Some(maps), Some(left), Some(right)) =
        (count("views"), count("homographies"), count("left"), count("right"))
    else {
        return;
    };
    if views > MAX_VIEWS {
        check.node_error(format!("{views} connected views exceed the limit of {MAX_VIEWS}"), "connect fewer");
    } else if views > 0 && maps + 1 != views {
        check.node_error(
            format!("{views} views need {} homographies, but {maps} are connected", views - 1),
            "connect one homography for each view but the first",
        );
    } else if views == 0 && (left == 0 || right == 0) {
        check.node_warning("no two views are connected", "connect `left` and `right`, or `views`");
    }
}

impl Node for Composite {
    const INFO: NodeInfo = NodeInfo::compute(
        "composite",
        "stitch",
        "Warps overlapping views onto one plane, finds the seam between them and blends them there.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = CompositeNodeParams;

    fn validate(_: &CompositeNodeParams, check: &mut Validation<'_>) {
        check_views(check);
    }

    fn open(open: &Open<'_>, params: &CompositeNodeParams) -> Result<Self> {
        Ok(Self { drawer: Drawer::new(params, open) })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &CompositeNodeParams,
    ) -> Result<()> {
        self.drawer.set_params(params, cx);
        let inputs = SceneInputs {
            pair: [input.left.as_ref(), input.right.as_ref()],
            pair_masks: [input.mask_left.as_ref(), input.mask_right.as_ref()],
            homography: input.homography.as_deref(),
            views: input.views.as_ref(),
            homographies: input.homographies.as_ref(),
            masks: input.masks.as_ref(),
        };
        self.drawer.take_masks(&inputs)?;
        let Some(scene) = Scene::of(&inputs)? else { return Ok(()) };
        if params.on_lost == OnLost::Skip && !self.drawer.accepts(&scene)? {
            return Ok(());
        }
        let Out { panorama, mask, canvas, shown, gain, gain_text } = &mut out;
        let slots = Slots { panorama, mask, canvas, shown, gain, gain_text };
        draw(&mut self.drawer, cx, &scene, slots)
    }
}
