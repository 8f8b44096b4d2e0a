//! `capture`: views of cameras, files and pipelines, taken together.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use panoscope_node::abi::Calibration;
use panoscope_node::{
    Bgr8, Choice, Context, NoPorts, Node, NodeError, NodeInfo, Open, Parallel, Params, Ports, Result, Slot, Validation,
};

use crate::crop::{self, Halves, Rect};
use crate::source::{CaptureError, Grab, Lock, Picture, Request, Source, SourceName, unknown_element};

/// Most views of one node.
const MAX_VIEWS: usize = 4;
/// Media time of images, which tell no rate.
const IMAGE_FPS: f64 = 30.0;

/// How one source holds two views.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Every source is one view.
    None,
    /// The left view is the left half.
    SideBySide,
    /// The left view is the upper half.
    TopBottom,
}

/// When the node waits so that pictures come at their rate.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// In live mode; in batch mode pictures come as fast as they are read.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// What a damaged picture does.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnDamage {
    /// The node fails and names the file.
    Fail,
    /// The tick is empty, with a warning.
    Skip,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// Left view: view 0.
    pub left: Slot<'f, Bgr8>,
    /// Right view: view 1.
    pub right: Slot<'f, Bgr8>,
    /// View 0.
    pub view0: Slot<'f, Bgr8>,
    /// View 1.
    pub view1: Slot<'f, Bgr8>,
    /// View 2.
    pub view2: Slot<'f, Bgr8>,
    /// View 3.
    pub view3: Slot<'f, Bgr8>,
    /// Calibration of views 0 and 1, where a file is given.
    pub calibration: Slot<'f, Calibration>,
}

/// Parameters.
#[derive(Params)]
pub struct Settings {
    /// Left view: camera number or /dev/videoN, video file, image, folder of images, pattern (dir/*.png or img_%04d.png), stream address, or
    /// GStreamer pipeline (any text with !).
    #[param(default = "", reopen, file)]
    pub left: String,
    /// Right view, as `left`.
    #[param(default = "", reopen, file)]
    pub right: String,
    /// Up to four views instead of `left` and `right`, separated by semicolons.
    #[param(default = "", reopen)]
    pub views: String,
    /// Both views in one picture: only `left` is given, and it is cut in two.
    #[param(default = "none", reopen)]
    pub split: Split,
    /// Part of the picture in px: x, y, width, height for all views, or four numbers for each view. Width or height 0 reach to the
    /// edge. Views are split first.
    #[param(default = [], range = 0..=16, rectangles)]
    pub crop: Vec<f64>,
    /// Starts files again at their end.
    #[param(default = false, reopen)]
    pub r#loop: bool,
    /// Pictures per second of media time; 0 takes the video's own rate, and 30 for images.
    #[param(default = 0.0, range = 0.0..=1000.0, unit = "Hz", reopen)]
    pub rate_hz: f64,
    /// When to wait so that pictures come at their rate. Cameras keep their own pace.
    #[param(default = "auto")]
    pub pace: Pace,
    /// Ends after so many ticks; 0 never.
    #[param(default = 0, range = 0..=1000000000, unit = "frames")]
    pub frames: u64,
    /// Columns asked of cameras; 0 as they are.
    #[param(default = 0, range = 0..=16384, unit = "px", reopen)]
    pub width: u32,
    /// Rows asked of cameras; 0 as they are.
    #[param(default = 0, range = 0..=16384, unit = "px", reopen)]
    pub height: u32,
    /// Pictures per second asked of cameras; 0 as they are.
    #[param(default = 0.0, range = 0.0..=1000.0, unit = "Hz", reopen)]
    pub fps: f64,
    /// Holds exposure and gain of all cameras at what view 0 has found after `lock_after`.
    #[param(default = false, reopen)]
    pub lock_exposure: bool,
    /// Holds the white balance of all cameras at what view 0 has found after `lock_after`.
    #[param(default = false, reopen)]
    pub lock_white_balance: bool,
    /// Pictures that the automatics have to settle.
    #[param(default = 30, range = 0..=10000, unit = "frames", reopen)]
    pub lock_after: u64,
    /// What a damaged picture does.
    #[param(default = "fail")]
    pub on_damage: OnDamage,
    /// Calibration file of the first two views: OpenCV's FileStorage YAML or a Kalibr camera chain; the two files of ROS (left;
    /// right) or of OpenCV's sample (intrinsics; extrinsics) are separated by a semicolon.
    #[param(default = "", reopen, file)]
    pub calibration: String,
}

struct View {
    source: Source,
    picture: Picture,
    result: std::result::Result<(), String>,
    name: String,
}

/// Takes the pictures of all views: first all are grabbed, then decoded on the host's threads.
pub struct Capture {
    /// One per source; a split source serves two views.
    sources: Vec<Mutex<View>>,
    halves: Option<Halves>,
    rate_hz: f64,
    frame: u64,
    due: Option<Instant>,
    lost_told: bool,
    sizes_told: bool,
    reconnects: u64,
    calibration: Option<Calibration>,
}

/// The texts that name sources, each with the parameter it stands in; the error tells the parameter that is wrong.
fn source_texts(params: &Settings) -> std::result::Result<Vec<(&'static str, &str)>, (&'static str, String)> {
    let pair = [params.left.trim(), params.right.trim()];
    let list: Vec<&str> = params.views.split([';', '\n']).map(str::trim).filter(|t| !t.is_empty()).collect();
    let texts: Vec<(&'static str, &str)> = match (pair, list.is_empty()) {
        (["", ""], true) => {
            let words = "no source: give `left` and `right` (camera, video, images or pipeline), `left` with `split`, or `views`";
            return Err(("left", words.to_owned()));
        }
        (["", ""], false) => list.into_iter().map(|text| ("views", text)).collect(),
        (_, false) => return Err(("views", "give either `views` or `left` and `right`, not both".to_owned())),
        (["", _], true) => return Err(("right", "`right` is given without `left`".to_owned())),
        ([left, ""], true) => vec![("left", left)],
        ([left, right], true) => vec![("left", left), ("right", right)],
    };
    if texts.len() > MAX_VIEWS {
        return Err(("views", format!("{} views are given, {MAX_VIEWS} are the most", texts.len())));
    }
    if params.split != Split::None && texts.len() != 1 {
        return Err(("split", "`split` cuts one picture in two: give `left` only".to_owned()));
    }
    Ok(texts)
}

impl Settings {
    fn halves(&self) -> Option<Halves> {
        match self.split {
            Split::None => None,
            Split::SideBySide => Some(Halves::SideBySide),
            Split::TopBottom => Some(Halves::TopBottom),
        }
    }

    /// Reports crops that no picture, or not the first one of a view's images, can be cut by.
    fn check_crops(&self, names: &[Option<SourceName>], check: &mut Validation<'_>) {
        let views = if self.split == Split::None { names.len() } else { 2 };
        for view in 0..views {
            let crop = match crop::of_view(&self.crop, view, views) {
                Ok(Some(crop)) => crop,
                Ok(None) => return,
                Err(why) => return check.error("crop", why, ""),
            };
            let name = names.get(if self.split == Split::None { view } else { 0 }).and_then(Option::as_ref);
            let checked = match name.and_then(SourceName::picture_size) {
                Some((width, height)) => {
                    let whole = Rect::whole(width, height);
                    self.halves().map_or(whole, |halves| whole.half(halves, view)).part(crop).map(drop)
                }
                // The picture is not known yet: only what no picture holds is refused.
                None => crop::whole_numbers(crop).map(drop),
            };
            if let Err(why) = checked {
                return check.error("crop", format!("view {view}: {why}"), "give x, y, width, height in px");
            }
        }
    }
}

/// Reads the calibration, if a file is given.
fn calibration_of(text: &str, folder: &Path) -> Result<Option<Calibration>> {
    let files: Vec<PathBuf> =
        text.split(';').map(str::trim).filter(|t| !t.is_empty()).map(|t| folder.join(t)).collect();
    if files.is_empty() {
        return Ok(None);
    }
    panoscope_calibration::read(&files).map(Some).map_err(|error| NodeError::new(format!("calibration: {error}")))
}

fn poisoned<T>(error: std::sync::PoisonError<T>) -> T {
    error.into_inner()
}

impl Capture {
    /// Grabs all sources; `None` when one has ended, `Some(false)` when a device is away.
    fn grab(&mut self, cx: &Context<'_>) -> Option<bool> {
        let mut times: Vec<Instant> = Vec::new();
        let mut lost = None;
        for view in &mut self.sources {
            let view = view.get_mut().unwrap_or_else(poisoned);
            match view.source.grab() {
                Grab::Ready(time) => times.push(time),
                Grab::Lost => lost = Some(view.name.clone()),
                Grab::End => {
                    if let Some(words) = view.source.cut_off() {
                        cx.warn(&words);
                    }
                    return None;
                }
            }
        }
        if let Some(name) = lost {
            if !self.lost_told {
                self.lost_told = true;
                self.reconnects += 1;
                cx.warn(&format!("{name} is gone: its outputs stay empty until it comes back"));
            }
            return Some(false);
        }
        if self.lost_told {
            self.lost_told = false;
            cx.info("all cameras are back");
        }
        cx.metric("reconnects", self.reconnects as f64);
        if let (Some(first), Some(last)) = (times.iter().min(), times.iter().max()) {
            cx.metric("skew_ms", last.duration_since(*first).as_secs_f64() * 1e3);
        }
        Some(true)
    }

    /// Waits until the next picture is due.
    fn wait(&mut self, cx: &Context<'_>, pace: Pace) {
        let paced = match pace {
            Pace::Auto => !cx.is_batch(),
            Pace::On => true,
            Pace::Off => false,
        };
        let devices = self.sources.iter_mut().any(|v| v.get_mut().unwrap_or_else(poisoned).source.is_device());
        if !paced || devices {
            self.due = None;
            return;
        }
        let step = Duration::from_secs_f64(1.0 / self.rate_hz);
        let now = Instant::now();
        let due = self.due.unwrap_or(now);
        std::thread::sleep(due.saturating_duration_since(now));
        // After a long pause the pictures that were missed are not made up for.
        self.due = Some(if now > due + step { now } else { due } + step);
    }

    fn lock(&mut self, cx: &Context<'_>, params: &Settings) {
        if !(params.lock_exposure || params.lock_white_balance) || self.frame != params.lock_after {
            return;
        }
        let mut found: Option<Lock> = None;
        for view in &mut self.sources {
            let view = view.get_mut().unwrap_or_else(poisoned);
            let Some(device) = view.source.device_mut() else { continue };
            let values = *found.get_or_insert_with(|| device.found());
            let lock = Lock {
                exposure: values.exposure.filter(|_| params.lock_exposure),
                white_balance_k: values.white_balance_k.filter(|_| params.lock_white_balance),
            };
            if !device.set_lock(lock) {
                cx.warn(&format!("{} does not take the locked exposure or white balance", view.name));
            }
        }
        if found.is_none() {
            cx.warn("exposure and white balance are locked on cameras only: there is none");
        }
    }

    /// The calibration, if there is one and it was made for views of this size.
    fn calibration_for(&mut self, cx: &Context<'_>, parts: &[(usize, Rect)]) -> Result<Option<Calibration>> {
        let Some(calibration) = &mut self.calibration else { return Ok(None) };
        for (view, (_, rect)) in parts.iter().take(2).enumerate() {
            let camera = if view == 0 { &mut calibration.left } else { &mut calibration.right };
            if camera.width == 0 {
                (camera.width, camera.height) = (rect.width as u32, rect.height as u32);
                cx.info(&format!("the calibration tells no size: view {view} is taken to be what it was made for"));
            }
            if (camera.width as usize, camera.height as usize) != (rect.width, rect.height) {
                return Err(NodeError::new(format!(
                    "calibration: it was made for views of {}x{}, view {view} is {}x{}",
                    camera.width, camera.height, rect.width, rect.height
                )));
            }
        }
        Ok(Some(*calibration))
    }

    /// Source and rectangle of a view.
    fn part(&mut self, view: usize, crops: &[f64]) -> Result<(usize, Rect)> {
        let views = if self.halves.is_some() { 2 } else { self.sources.len() };
        let source = if self.halves.is_some() { 0 } else { view };
        let picture = &self.sources[source].get_mut().unwrap_or_else(poisoned).picture;
        let mut rect = Rect::whole(picture.width, picture.height);
        if let Some(halves) = self.halves {
            rect = rect.half(halves, view);
        }
        if let Some(crop) = crop::of_view(crops, view, views).map_err(NodeError::new)? {
            rect = rect.part(crop).map_err(|why| NodeError::new(format!("view {view}: {why}")))?;
        }
        if rect.width == 0 || rect.height == 0 {
            let name = &self.sources[source].get_mut().unwrap_or_else(poisoned).name;
            return Err(NodeError::new(format!("{name}: a picture of {rect:?} is too small to be split")));
        }
        Ok((source, rect))
    }

    /// Makes two outputs of one view: they share one buffer.
    fn write_pair(
        &mut self,
        first: &mut Slot<'_, Bgr8>,
        second: &mut Slot<'_, Bgr8>,
        source: usize,
        rect: Rect,
    ) -> Result<()> {
        if !first.is_read() {
            return self.write(second, source, rect);
        }
        self.write(first, source, rect)?;
        if second.is_read() { second.forward_from(first) } else { Ok(()) }
    }

    /// Makes the output of one view, if anyone reads it.
    fn write(&mut self, slot: &mut Slot<'_, Bgr8>, source: usize, rect: Rect) -> Result<()> {
        if !slot.is_read() {
            return Ok(());
        }
        let picture = &self.sources[source].get_mut().unwrap_or_else(poisoned).picture;
        let mut out = slot.alloc(rect.width, rect.height)?;
        let stride = picture.width * 3;
        for y in 0..rect.height {
            let start = (rect.y + y) * stride + rect.x * 3;
            out.row_mut(y).copy_from_slice(&picture.bgr[start..start + rect.width * 3]);
        }
        Ok(())
    }
}

impl Node for Capture {
    const INFO: NodeInfo = NodeInfo::blocking(
        "capture",
        "source",
        "Views of cameras, video files, images or GStreamer pipelines, taken together.",
    )
    .source()
    .exclusive();
    type In<'f> = NoPorts;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn validate(params: &Settings, check: &mut Validation<'_>) {
        let folder = check.graph_dir();
        if let Err(error) = calibration_of(&params.calibration, folder) {
            check.error("calibration", error.message(), "");
        } else if params.calibration.trim().is_empty() && check.is_read("calibration") == Some(true) {
            let message = "output `calibration` is read and stays empty: no calibration file is given";
            check.warning("calibration", message, "give a file, as in calibration = \"stereo.yaml\"");
        }
        let texts = match source_texts(params) {
            Ok(texts) => texts,
            Err((param, why)) => return check.error(param, why, ""),
        };
        let mut names = Vec::with_capacity(texts.len());
        for (param, text) in texts {
            if text.contains('!')
                && let Some(element) = unknown_element(text)
            {
                let message = format!("the pipeline names `{element}`, which is no GStreamer element of this machine");
                check.error(
                    param,
                    message,
                    "correct the name, or install its plugin; gst-inspect-1.0 lists all elements",
                );
            }
            names.push(match SourceName::parse(text, folder) {
                Ok(name) => Some(name),
                // A camera may be plugged in until the graph runs.
                Err(error @ CaptureError::NoDevice { .. }) => {
                    check.warning(param, error.to_string(), "plug it in before the graph runs");
                    None
                }
                Err(error) => {
                    check.error(param, error.to_string(), "");
                    None
                }
            });
        }
        params.check_crops(&names, check);
        let views = if params.split == Split::None { names.len() } else { 2 };
        let missing = [("right", 1), ("view1", 1), ("view2", 2), ("view3", 3)];
        if let Some((output, _)) =
            missing.iter().find(|(name, view)| *view >= views && check.is_read(name) == Some(true))
        {
            let message = format!(
                "output `{output}` is read and stays empty: {views} view{} given",
                if views == 1 { " is" } else { "s are" }
            );
            check.node_warning(message, "name one more source, or `split` the picture");
        }
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let calibration = calibration_of(&params.calibration, open.graph_dir())?;
        let request = Request { width: params.width, height: params.height, fps: params.fps };
        let mut sources = Vec::new();
        for (_, text) in source_texts(params).map_err(|(_, why)| NodeError::new(why))? {
            let name = SourceName::parse(text, open.graph_dir())?;
            let source = Source::open(&name, request, params.r#loop)?;
            let view = View { source, picture: Picture::default(), result: Ok(()), name: name.in_words() };
            sources.push(Mutex::new(view));
        }
        let native = sources.iter_mut().find_map(|v| v.get_mut().unwrap_or_else(poisoned).source.native_fps());
        let rate_hz = if params.rate_hz > 0.0 { params.rate_hz } else { native.unwrap_or(IMAGE_FPS) };
        let halves = params.halves();
        Ok(Self {
            sources,
            halves,
            rate_hz,
            frame: 0,
            due: None,
            lost_told: false,
            sizes_told: false,
            reconnects: 0,
            calibration,
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, params: &Settings) -> Result<()> {
        if params.frames > 0 && self.frame >= params.frames {
            cx.end();
            return Ok(());
        }
        self.wait(cx, params.pace);
        cx.set_capture_ns((self.frame as f64 * 1e9 / self.rate_hz).round() as i64);
        match self.grab(cx) {
            None => {
                cx.end();
                return Ok(());
            }
            Some(false) => {
                // An empty tick now and then shows that the node lives, without spinning.
                self.frame += 1;
                std::thread::sleep(Duration::from_millis(50));
                return Ok(());
            }
            Some(true) => {}
        }
        self.frame += 1;
        self.lock(cx, params);
        let sources = &self.sources;
        cx.pool().run(sources.len(), &|index| {
            let mut view = sources[index].lock().unwrap_or_else(poisoned);
            let view = &mut *view;
            view.result = view.source.retrieve(&mut view.picture).map_err(|error| error.to_string());
        });
        for view in &mut self.sources {
            let view = view.get_mut().unwrap_or_else(poisoned);
            if let Err(why) = std::mem::replace(&mut view.result, Ok(())) {
                match params.on_damage {
                    OnDamage::Fail => return Err(NodeError::new(why)),
                    OnDamage::Skip => {
                        cx.warn(&format!("{why}: this tick stays empty"));
                        return Ok(());
                    }
                }
            }
        }
        let views = if self.halves.is_some() { 2 } else { self.sources.len() };
        let mut parts = Vec::with_capacity(MAX_VIEWS);
        for view in 0..views {
            parts.push(self.part(view, &params.crop)?);
        }
        let differing = parts.iter().find(|p| (p.1.width, p.1.height) != (parts[0].1.width, parts[0].1.height));
        if let Some((_, rect)) = differing
            && !self.sizes_told
        {
            self.sizes_told = true;
            cx.warn(&format!(
                "the views differ in size ({}x{} and {}x{}): each is passed on as it is",
                parts[0].1.width, parts[0].1.height, rect.width, rect.height
            ));
        }
        if out.calibration.is_read()
            && let Some(calibration) = self.calibration_for(cx, &parts)?
        {
            out.calibration.set(calibration)?;
        }
        for (view, (source, rect)) in parts.into_iter().enumerate() {
            match view {
                0 => self.write_pair(&mut out.left, &mut out.view0, source, rect)?,
                1 => self.write_pair(&mut out.right, &mut out.view1, source, rect)?,
                2 => self.write(&mut out.view2, source, rect)?,
                _ => self.write(&mut out.view3, source, rect)?,
            }
        }
        Ok(())
    }
}
