//! `capture`: views of cameras, files and pipelines, taken together.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use panoscope_node::abi::Calibration;
use panoscope_node::{
    Bgr8, Choice, Context, NoPorts, Node, NodeError, NodeInfo, Open, Parallel, Params, Ports, Rect, Result, Slot,
    Validation,
};

use crate::crop::{self, Halves};
use crate::depth::Depth;
use crate::position::{Position, ViewPosition};
use crate::source::{CaptureError, Demands, Lock, SourceName, unknown_element};
use crate::views::{Taken, View, Views, pair_by_numbers};

/// Most views of one node.
const MAX_VIEWS: usize = 4;
/// Media time of images, which tell no rate.
const IMAGE_FPS: f64 = 30.0;
/// Longest wait for a picture's time: a jump in a file's times is not waited for.
const LONGEST_PAUSE: Duration = Duration::from_millis(1500);
/// Between two empty ticks of a lost device.
const LOST_PAUSE: Duration = Duration::from_millis(50);

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
    /// The node fails and names the file: in batch mode its pictures end there, in live mode it goes on with the next one.
    Fail,
    /// The tick is empty, with a warning, and the next picture comes.
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
    /// GStreamer pipeline (any text with !). Pictures of folders and patterns are paired by the numbers in their names, videos by time.
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
    /// Starts files again at their end. In batch mode single images are one tick without it.
    #[param(default = false, reopen)]
    pub r#loop: bool,
    /// Pictures per second of media time, of all views; 0 takes the videos' own times, and 30 for images.
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
    /// Bits of pictures that have more than eight: 12 makes 4095 white. 0 finds it from their values and says so.
    #[param(default = 0, range = 0..=16)]
    pub bit_depth: u32,
    /// Longest time that a camera, stream or pipeline may take to open.
    #[param(default = 10.0, range = 0.1..=600.0, unit = "s", reopen)]
    pub open_limit_s: f64,
    /// Calibration file of the first two views: OpenCV's FileStorage YAML or a Kalibr camera chain; the two files of ROS (left;
    /// right) or of OpenCV's sample (intrinsics; extrinsics) are separated by a semicolon.
    #[param(default = "", reopen, file)]
    pub calibration: String,
}

/// Takes the pictures of all views: first all are grabbed, then decoded on the host's threads.
pub struct Capture {
    /// One per source; a split source serves two views.
    views: Views,
    halves: Option<Halves>,
    depth: Depth,
    white: f32,
    frame: u64,
    /// Ticks of this instance.
    since_open: u64,
    /// Capture time of the newest tick; -1 before the first.
    capture_ns: i64,
    /// Clock and capture time that the pace counts from.
    pace_from: Option<(Instant, i64)>,
    /// The same for devices, whose capture time is the clock's.
    clock_from: Option<(Instant, i64)>,
    has_ended: bool,
    is_lost: bool,
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
                    crop::part(self.halves().map_or(whole, |halves| halves.of(whole, view)), crop).map(drop)
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

impl Capture {
    /// Grabs all views; `None` when nothing comes of this tick, which is empty then.
    ///
    /// # Errors
    /// A view that ended too early, in batch mode also a device that is gone.
    fn grab(&mut self, cx: &Context<'_>, params: &Settings) -> Result<Option<()>> {
        let mut taken = self.views.grab(cx);
        if taken == Taken::End {
            if let Some(words) = self.views.left_over() {
                cx.warn(&words);
            }
            // Nothing at all came: starting anew would find the same.
            if params.r#loop && self.since_open > 0 {
                let last_s = self.capture_ns.max(0) as f64 / 1e9;
                self.views.rewind(last_s)?;
                taken = self.views.grab(cx);
            }
        }
        match taken {
            Taken::Ready => {}
            Taken::End => {
                self.end(cx);
                return Ok(None);
            }
            Taken::Failed(words) => return Err(self.ended_early(words)),
            Taken::Lost(words) if cx.is_batch() => return Err(self.ended_early(words)),
            Taken::Lost(words) => {
                self.set_time(cx);
                if !self.is_lost {
                    self.is_lost = true;
                    self.reconnects += 1;
                    cx.fault(&format!(
                        "{words}: outputs stay empty, and it is opened again every few seconds until it comes back"
                    ));
                }
                cx.metric("lost", 1.0);
                self.frame += 1;
                // An empty tick now and then shows that the node lives, without spinning.
                std::thread::sleep(LOST_PAUSE);
                return Ok(None);
            }
        }
        if self.is_lost {
            self.is_lost = false;
            cx.info("all sources are back");
        }
        cx.metric("lost", 0.0);
        cx.metric("reconnects", self.reconnects as f64);
        cx.metric("skew_ms", self.views.skew_ms());
        cx.metric("unpaired", self.views.unpaired() as f64);
        Ok(Some(()))
    }

    /// Nothing comes any more.
    fn end(&mut self, cx: &Context<'_>) {
        self.has_ended = true;
        if self.views.unpaired() > 0 {
            cx.warn(&format!(
                "{} pictures were left out because no other view had a partner for them",
                self.views.unpaired()
            ));
        }
        cx.end();
    }

    fn ended_early(&mut self, words: String) -> NodeError {
        self.has_ended = true;
        NodeError::ended_early(words)
    }

    /// Gives the tick its capture time: that of the file, or of the clock for devices; always later than the one before.
    fn set_time(&mut self, cx: &Context<'_>) {
        let media_s = self.views.media_s();
        let next_ns = match media_s {
            Some(media_s) => (media_s * 1e9).round() as i64,
            None if self.views.has_device() => {
                let (start, first_ns) = *self.clock_from.get_or_insert((Instant::now(), self.capture_ns + 1));
                first_ns + start.elapsed().as_nanos() as i64
            }
            None => (self.frame as f64 * 1e9 / self.views.rate_hz()).round() as i64,
        };
        self.capture_ns = next_ns.max(self.capture_ns + 1);
        cx.set_capture_ns(self.capture_ns);
    }

    /// Waits until the picture is due.
    fn wait(&mut self, cx: &Context<'_>, pace: Pace) {
        let is_paced = match pace {
            Pace::Auto => !cx.is_batch(),
            Pace::On => true,
            Pace::Off => false,
        };
        if !is_paced || self.views.has_device() {
            self.pace_from = None;
            return;
        }
        let now = Instant::now();
        let (start, first_ns) = *self.pace_from.get_or_insert((now, self.capture_ns));
        let due = start + Duration::from_nanos((self.capture_ns - first_ns).max(0) as u64);
        let step = Duration::from_secs_f64(1.0 / self.views.rate_hz());
        let pause = due.saturating_duration_since(now);
        std::thread::sleep(pause.min(LONGEST_PAUSE));
        // After a long pause the pictures that were missed are not made up for.
        if now > due + step || pause > LONGEST_PAUSE {
            self.pace_from = Some((Instant::now(), self.capture_ns));
        }
    }

    /// Decodes what was grabbed; `false` when a damaged picture leaves the tick empty.
    ///
    /// # Errors
    /// A damaged picture, by file and number.
    fn decode(&mut self, cx: &Context<'_>, params: &Settings) -> Result<bool> {
        let views = self.views.locked();
        cx.pool().run(views.len(), &|index| {
            let mut view = views[index].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let view = &mut *view;
            view.result = view.source.retrieve(&mut view.picture).map_err(|error| error.to_string());
        });
        let Some(why) = self.views.iter().find_map(|view| std::mem::replace(&mut view.result, Ok(())).err()) else {
            return Ok(true);
        };
        match params.on_damage {
            OnDamage::Skip => {
                cx.warn(&format!("{why}: this tick stays empty"));
                Ok(false)
            }
            OnDamage::Fail => {
                let words = format!("{why}; with `on_damage = \"skip\"` such a picture is left out");
                // In live mode the node is opened again and goes on with the next picture.
                Err(if cx.is_batch() { self.ended_early(words) } else { NodeError::new(words) })
            }
        }
    }

    /// One white for the pictures of all views.
    fn find_white(&mut self, cx: &Context<'_>, bits: u32) -> Result<()> {
        let views = self.views.locked();
        let guards: Vec<_> =
            views.iter().map(|view| view.lock().unwrap_or_else(std::sync::PoisonError::into_inner)).collect();
        let pictures = guards.iter().map(|view| (view.name.as_str(), &view.picture));
        let series = || guards.iter().flat_map(|view| view.source.peaks()).collect();
        self.white = self.depth.white(cx, bits, pictures, series)?;
        Ok(())
    }

    fn lock(&mut self, cx: &Context<'_>, params: &Settings) {
        if !(params.lock_exposure || params.lock_white_balance) || self.since_open != params.lock_after {
            return;
        }
        let mut found: Option<Lock> = None;
        for view in self.views.iter() {
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
        let views = if self.halves.is_some() { 2 } else { self.views.len() };
        let source = if self.halves.is_some() { 0 } else { view };
        let picture = &self.views.view(source).picture;
        let mut rect = Rect::whole(picture.width, picture.height);
        if let Some(halves) = self.halves {
            rect = halves.of(rect, view);
        }
        if let Some(crop) = crop::of_view(crops, view, views).map_err(NodeError::new)? {
            rect = crop::part(rect, crop).map_err(|why| NodeError::new(format!("view {view}: {why}")))?;
        }
        if rect.width == 0 || rect.height == 0 {
            let name = &self.views.view(source).name;
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
        let white = self.white;
        let View { picture, .. } = self.views.view(source);
        let mut out = slot.alloc(rect.width, rect.height)?;
        for y in 0..rect.height {
            picture.write_row(rect.x, rect.y + y, white, out.row_mut(y));
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
        let demands = Demands {
            width: params.width,
            height: params.height,
            fps: params.fps,
            open_limit: Duration::from_secs_f64(params.open_limit_s.max(0.0)),
        };
        let texts = source_texts(params).map_err(|(_, why)| NodeError::new(why))?;
        let texts: Vec<String> = texts.into_iter().map(|(_, text)| text.to_owned()).collect();
        let names = texts.iter().map(|text| SourceName::parse(text, open.graph_dir()));
        let mut names = names.collect::<std::result::Result<Vec<_>, _>>()?;
        for remark in pair_by_numbers(&mut names, &texts) {
            open.warn(&remark);
        }
        let mut views = Views::open(&names, texts, demands, params.r#loop, (params.rate_hz, IMAGE_FPS))?;
        if let Some(words) = views.rates_in_words() {
            open.warn(&words);
        }
        let halves = params.halves();
        Ok(Self {
            views,
            halves,
            depth: Depth::default(),
            white: 255.0,
            frame: 0,
            since_open: 0,
            capture_ns: -1,
            pace_from: None,
            clock_from: None,
            has_ended: false,
            is_lost: false,
            sizes_told: false,
            reconnects: 0,
            calibration,
        })
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, params: &Settings) -> Result<()> {
        // Single images have no end of their own: in batch mode they are one tick unless they are to be repeated.
        let is_shown = cx.is_batch() && !params.r#loop && self.frame > 0 && self.views.are_stills();
        if self.has_ended || is_shown || (params.frames > 0 && self.frame >= params.frames) {
            cx.end();
            return Ok(());
        }
        if self.grab(cx, params)?.is_none() {
            return Ok(());
        }
        self.set_time(cx);
        self.wait(cx, params.pace);
        self.frame += 1;
        self.since_open += 1;
        self.lock(cx, params);
        if !self.decode(cx, params)? {
            return Ok(());
        }
        self.find_white(cx, params.bit_depth)?;
        let views = if self.halves.is_some() { 2 } else { self.views.len() };
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

    fn save_state(&self) -> Option<Vec<u8>> {
        let views = self.views.locked().iter().map(|view| {
            let view = view.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            ViewPosition {
                text: view.text.clone(),
                grabbed: view.source.grabbed(),
                next_file: view.source.next_file().map(Path::to_owned),
            }
        });
        let (frame, capture_ns, round_s) = (self.frame, self.capture_ns, self.views.round_s);
        Some(Position { frame, capture_ns, round_s, views: views.collect() }.to_bytes())
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        let Some(position) = Position::from_bytes(state) else {
            return Err(NodeError::new("the position is not one of `capture`"));
        };
        let texts: Vec<String> = self.views.iter().map(|view| view.text.clone()).collect();
        // Other sources than before begin at their start.
        if !texts.iter().eq(position.views.iter().map(|view| &view.text)) {
            return Ok(());
        }
        (self.frame, self.capture_ns, self.views.round_s) = (position.frame, position.capture_ns, position.round_s);
        for (view, position) in self.views.iter().zip(&position.views) {
            view.source.go_to(position.grabbed, position.next_file.as_deref());
        }
        Ok(())
    }
}
