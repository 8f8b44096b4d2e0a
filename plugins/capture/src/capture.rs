//! `capture`: synchronised views of cameras, files and pipelines.

mod holding;
mod resuming;

use std::time::Duration;

use panoscope_data::bit_depth::{Deep, Remark, White};
use panoscope_media::input::monotonic_ns;
use panoscope_node::abi::Calibration;
use panoscope_node::{
    Bgr8, Context, NoPorts, Node, NodeError, NodeInfo, Open, Parallel, Ports, Rect, Result, Slot, Validation,
};

use crate::crop::{self, Halves};
use crate::kept_frames::KeptFrames;
use crate::pairing::Grabbed;
use crate::playing::Steps;
use crate::position::Position;
use crate::settings::{MAX_VIEWS, OnDamage, Pace, Settings};
use crate::source::{Clock, Demands, Lock, SourceName, Stream};
use crate::timing::{Time, Timing};
use crate::views::{View, Views, pair_by_numbers, same_files};

/// Metric with the index of the shown frame of a file, from 0.
const FRAME: &str = "frame";
/// Rate of image files, which have no timestamps, Hz.
const IMAGE_FPS: f64 = 30.0;
/// Names of the views in messages, by their number.
const VIEW_NAMES: [&str; MAX_VIEWS] = ["left view", "right view", "third view", "fourth view"];

/// Output ports of `capture`.
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
    /// Calibration of views 0 and 1, if a file is given.
    pub calibration: Slot<'f, Calibration>,
}

/// The region of a source's newest frame that one output shows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part {
    /// Number of the view, from 0.
    pub view: usize,
    /// Number of the source; a split source serves two views.
    pub source: usize,
    /// Region of the frame, px.
    pub rect: Rect,
}

/// Grabs the frames of all views. Streams are decoded on GStreamer's threads, images on the host's.
pub struct Capture {
    /// One per source; a split source serves two views.
    views: Views,
    halves: Option<Halves>,
    depth: White,
    white: f32,
    kept: KeptFrames,
    frame: u64,
    /// Number of ticks since this instance was opened.
    since_open: u64,
    timing: Timing,
    steps: Steps,
    /// Arrival of the tick's oldest live frame by the host's clock, ns.
    arrived_ns: Option<i64>,
    has_ended: bool,
    /// Numbers of the lost views, while something is lost. Empty when all views deliver, but frames that do not belong together.
    lost: Option<Vec<usize>>,
    sizes_warned: bool,
    /// Size of the first frame of view 0.
    first_size: Option<(usize, usize)>,
    damage_warned: bool,
    reconnects: u64,
    calibration: Option<Calibration>,
}

impl Capture {
    /// Grabs all views, played at `speed`. Returns `None` for an empty tick, and at the end of paused files.
    ///
    /// # Errors
    /// A view ended too early; in batch mode also: a device is gone.
    fn grab(
        &mut self,
        cx: &Context<'_>,
        clock: Clock<'_>,
        params: &Settings,
        (speed, is_paused): (f64, bool),
    ) -> Result<Option<()>> {
        let mut grabbed = self.views.grab(cx, clock, self.lost.is_some());
        if grabbed == Grabbed::End {
            if let Some(words) = self.views.left_over() {
                cx.warn(&words);
            }
            // Without any tick so far, starting again would end again.
            if params.r#loop && self.frame > 0 {
                self.views.rewind(self.timing.media_s())?;
                grabbed = self.views.grab(cx, clock, self.lost.is_some());
            }
        }
        match grabbed {
            Grabbed::Ready => {
                if self.lost.is_some() && self.views.iter().all(|view| view.is_there) {
                    self.lost = None;
                    cx.info("all sources are available again");
                }
            }
            Grabbed::End if is_paused => return Ok(None),
            Grabbed::End => {
                self.end(cx);
                return Ok(None);
            }
            Grabbed::Failed(words) => return Err(self.ended_early(words)),
            Grabbed::Lost(words) if cx.is_batch() => return Err(self.ended_early(words)),
            Grabbed::Lost(words) => {
                self.report_loss(cx, &words);
                if !self.views.iter().any(|view| view.is_there) {
                    self.set_time(cx, clock, speed);
                    self.frame += 1;
                    return Ok(None);
                }
            }
        }
        cx.metric("lost", f64::from(u8::from(self.lost.is_some())));
        cx.metric("reconnects", self.reconnects as f64);
        cx.metric("skew_ms", self.views.skew_ms());
        cx.metric("unpaired", self.views.unpaired() as f64);
        if self.views.has_device() {
            cx.metric("dropped", self.views.dropped() as f64);
        }
        Ok(Some(()))
    }

    /// Reports views that were newly lost, and those that are back while others are still lost.
    fn report_loss(&mut self, cx: &Context<'_>, reason: &str) {
        let lost = self.views.lost();
        let before = self.lost.replace(lost.clone());
        let names = |views: &[usize]| views.iter().map(|view| VIEW_NAMES[*view]).collect::<Vec<_>>().join(" and the ");
        if before.as_ref().is_none_or(|before| lost.iter().any(|view| !before.contains(view))) {
            self.reconnects += 1;
            // The only view, or both halves of one picture, need no name.
            let prefix = match self.views.len() > 1 && !lost.is_empty() {
                true => format!("{} lost: {reason}", names(&lost)),
                false => reason.to_owned(),
            };
            cx.fault(&format!("{prefix}. Outputs without a frame stay empty until it is back; retrying every second"));
        } else if let Some(before) = before {
            let back: Vec<usize> = before.into_iter().filter(|view| !lost.contains(view)).collect();
            if !back.is_empty() {
                cx.info(&format!("{} is back", names(&back)));
            }
        }
        cx.metric("lost", 1.0);
    }

    /// Ends the source and reports frames that remain.
    fn end(&mut self, cx: &Context<'_>) {
        self.has_ended = true;
        if self.views.unpaired() > 0 {
            cx.warn(&format!(
                "{} frames were skipped because no other view had a partner for them",
                self.views.unpaired()
            ));
        }
        cx.end();
    }

    fn ended_early(&mut self, words: String) -> NodeError {
        self.has_ended = true;
        NodeError::ended_early(words)
    }

    /// Sets the tick's capture time: from the file, or from the clock for devices.
    fn set_time(&mut self, cx: &Context<'_>, clock: Clock<'_>, speed: f64) {
        // Both clocks count at one rate from different starts.
        self.arrived_ns = self.views.arrived_ns().map(|arrived_ns| clock() - (monotonic_ns() - arrived_ns));
        let time = match self.views.media_s() {
            Some(media_s) => Time::Media(media_s),
            None if self.views.has_device() => Time::Device(self.arrived_ns),
            None => Time::Rate(self.frame, self.views.rate_hz()),
        };
        cx.set_capture_ns(self.timing.advance(time, speed, clock));
        if let Some(arrived_ns) = self.arrived_ns {
            cx.set_arrived_ns(arrived_ns);
        }
    }

    /// Waits until the frame is due.
    fn wait(&mut self, cx: &Context<'_>, clock: Clock<'_>, pace: Pace, period_s: f64) {
        let is_paced = match pace {
            Pace::Auto => !cx.is_batch(),
            Pace::On => true,
            Pace::Off => false,
        };
        if is_paced && !self.views.has_device() {
            self.timing.wait(Duration::from_secs_f64(period_s), clock);
        } else {
            self.timing.reset_pace();
        }
    }

    /// Reads the images that were grabbed and takes the frames of streams; `false` when a damaged frame leaves the tick empty.
    ///
    /// # Errors
    /// A damaged frame, by file and number.
    fn decode(&mut self, cx: &Context<'_>, params: &Settings) -> Result<bool> {
        let views = self.views.locked();
        cx.pool().run(views.len(), &|index| {
            let mut view = views[index].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let view = &mut *view;
            if view.is_there {
                view.result = view.source.retrieve(&mut view.picture);
                if params.is_upright() {
                    view.picture.turn_upright();
                }
            } else {
                view.picture.clear();
            }
        });
        cx.metric("damaged", self.views.total(Stream::damaged) as f64);
        let failed = self.views.iter().find_map(|view| {
            let why = std::mem::replace(&mut view.result, Ok(())).err()?;
            Some((why, view.source.newest_mut().is_some()))
        });
        let Some((why, is_live)) = failed else {
            self.damage_warned = false;
            return Ok(true);
        };
        if is_live {
            // One warning for each series: a stream may be damaged until its next key picture.
            if !std::mem::replace(&mut self.damage_warned, true) {
                cx.warn(&format!("{why}: outputs stay empty until an undamaged frame arrives"));
            }
            return Ok(false);
        }
        match params.on_damage {
            OnDamage::Skip => {
                cx.warn(&format!("{why}: this tick stays empty"));
                Ok(false)
            }
            OnDamage::Fail => {
                let words = format!("{why}; set `on_damage = \"skip\"` to skip damaged frames");
                // In live mode the host opens the node again, which continues with the next picture.
                Err(if cx.is_batch() { self.ended_early(words) } else { NodeError::new(words) })
            }
        }
    }

    /// Finds one white level for the frames of all views.
    fn find_white(&mut self, cx: &Context<'_>, bits: u32) -> Result<()> {
        let views = self.views.locked();
        let guards: Vec<_> =
            views.iter().map(|view| view.lock().unwrap_or_else(std::sync::PoisonError::into_inner)).collect();
        let images = guards.iter().filter_map(|view| {
            let is_float = view.picture.is_float();
            Some(Deep { name: &view.name, peak: view.picture.peak()?, is_float })
        });
        let series = || guards.iter().flat_map(|view| view.source.peaks()).collect();
        let (white, remark) = self.depth.of(bits, images, series).map_err(|error| NodeError::new(error.to_string()))?;
        match remark {
            Some(Remark::Info(words)) => cx.info(&words),
            Some(Remark::Warning(words)) => cx.warn(&words),
            None => {}
        }
        self.white = white;
        Ok(())
    }

    fn lock(&mut self, cx: &Context<'_>, params: &Settings) {
        if !(params.lock_exposure || params.lock_white_balance) || self.since_open != params.lock_after {
            return;
        }
        let mut found: Option<Lock> = None;
        for view in self.views.iter() {
            let Some(device) = view.source.device_mut() else { continue };
            let values = *found.get_or_insert_with(|| device.automatic_values());
            let lock = Lock {
                exposure: values.exposure.filter(|_| params.lock_exposure),
                white_balance_k: values.white_balance_k.filter(|_| params.lock_white_balance),
            };
            if !device.set_lock(lock) {
                cx.warn(&format!("{} does not accept the locked exposure or white balance", view.name));
            }
        }
        if found.is_none() {
            cx.warn("exposure and white balance cannot be locked: no source is a camera");
        }
    }

    /// Opens parsed sources. `texts` are their names in messages and in the saved position.
    ///
    /// # Errors
    /// A source does not open.
    pub(crate) fn of_sources(
        open: &Open<'_>,
        params: &Settings,
        names: &[SourceName],
        texts: Vec<String>,
        calibration: Option<Calibration>,
    ) -> Result<Self> {
        let demands = Demands {
            width: params.width,
            height: params.height,
            fps: params.fps,
            open_limit: Duration::from_secs_f64(params.open_limit_s.max(0.0)),
            silence_limit: Duration::from_secs_f64(params.timeout_s.max(0.0)),
            is_lossless: open.is_batch(),
        };
        let mut views =
            Views::open(names, texts, demands, params.r#loop, (params.rate_hz, IMAGE_FPS), params.tolerance_ms)?;
        for remark in views.remarks() {
            open.info(&remark);
        }
        if let Some(words) = views.rates_in_words() {
            open.warn(&words);
        }
        let halves = params.halves();
        Ok(Self {
            views,
            halves,
            depth: White::default(),
            white: 255.0,
            kept: KeptFrames::default(),
            frame: 0,
            since_open: 0,
            timing: Timing::default(),
            steps: Steps::default(),
            arrived_ns: None,
            has_ended: false,
            lost: None,
            sizes_warned: false,
            first_size: None,
            damage_warned: false,
            reconnects: 0,
            calibration,
        })
    }

    /// Takes the frames of the next tick: a region for each view that has one. Returns `None` for an empty tick and at the end.
    ///
    /// # Errors
    /// As [`Node::process`] of this node.
    pub(crate) fn take(&mut self, cx: &Context<'_>, params: &Settings) -> Result<Option<Vec<Part>>> {
        // Stills have no end: in batch mode they are one tick unless `loop` is set.
        let is_shown = cx.is_batch() && !params.r#loop && self.frame > 0 && self.views.are_stills();
        if self.has_ended || is_shown || (params.frames > 0 && self.frame >= params.frames) {
            cx.end();
            return Ok(None);
        }
        let Some(first_ns) = cx.clock_ns() else {
            return Err(NodeError::new("this host has no clock: `capture` needs a newer Panoscope"));
        };
        let clock = || cx.clock_ns().unwrap_or(first_ns);
        // Cameras set their own pace, and a still image has none.
        let plays_file = !self.views.has_device() && !self.views.are_stills();
        let speed = if plays_file && !cx.is_batch() { params.playing.speed } else { 1.0 };
        let is_paused = plays_file && !cx.is_batch() && params.playing.paused;
        if self.steps.holds(cx, &params.playing) && plays_file && self.since_open > 0 {
            return self.hold(cx, &clock, params);
        }
        if self.grab(cx, &clock, params, (speed, is_paused))?.is_none() {
            return if is_paused { self.hold(cx, &clock, params) } else { Ok(None) };
        }
        self.set_time(cx, &clock, speed);
        self.wait(cx, &clock, params.pace, 1.0 / (self.views.rate_hz() * speed));
        self.frame += 1;
        self.since_open += 1;
        if plays_file {
            cx.metric(FRAME, self.picture_index() as f64);
        }
        self.lock(cx, params);
        if !self.decode(cx, params)? {
            return Ok(None);
        }
        self.find_white(cx, params.bit_depth)?;
        self.parts(cx, &clock, params).map(Some)
    }

    /// The region of the newest frame that each view shows.
    ///
    /// # Errors
    /// A crop does not fit a frame.
    fn parts(&mut self, cx: &Context<'_>, clock: Clock<'_>, params: &Settings) -> Result<Vec<Part>> {
        let views = if self.halves.is_some() { 2 } else { self.views.len() };
        let mut parts = Vec::with_capacity(MAX_VIEWS);
        for view in 0..views {
            parts.extend(self.part(view, &params.crop)?);
        }
        let size = |part: &Part| (part.rect.width, part.rect.height);
        let differing = parts.iter().find(|part| size(part) != size(&parts[0]));
        if let Some(Part { rect, .. }) = differing
            && !self.sizes_warned
        {
            self.sizes_warned = true;
            cx.warn(&format!(
                "the views differ in size ({}x{} and {}x{}): each is forwarded unchanged",
                parts[0].rect.width, parts[0].rect.height, rect.width, rect.height
            ));
        }
        if let Some(Part { rect, .. }) = parts.first() {
            let (width, height) = *self.first_size.get_or_insert((rect.width, rect.height));
            if (rect.width, rect.height) != (width, height) && !std::mem::replace(&mut self.sizes_warned, true) {
                cx.warn(&format!(
                    "frame {} is {}x{}, those before it are {width}x{height}: each is forwarded unchanged",
                    self.frame, rect.width, rect.height
                ));
            }
        }
        if let Some(arrived_ns) = self.arrived_ns {
            cx.metric("latency_ms", (clock() - arrived_ns) as f64 * 1e-6);
        }
        Ok(parts)
    }

    /// Index of the newest frame of view 0 in its source, from 0.
    pub(crate) fn picture_index(&mut self) -> u64 {
        self.views.view(0).source.grabbed().saturating_sub(1)
    }

    /// Width and height of the newest frame of view 0 as stored, before it is split or cropped.
    pub(crate) fn stored_size(&mut self) -> (usize, usize) {
        let picture = &self.views.view(0).picture;
        (picture.width, picture.height)
    }

    /// Replaces the calibration from the next tick on.
    pub(crate) fn set_calibration(&mut self, calibration: Option<Calibration>) {
        self.calibration = calibration;
    }

    /// The calibration, if there is one and it fits views of this size.
    ///
    /// # Errors
    /// The calibration was made for views of another size.
    pub(crate) fn calibration_for(&mut self, cx: &Context<'_>, parts: &[Part]) -> Result<Option<Calibration>> {
        let Some(calibration) = &mut self.calibration else { return Ok(None) };
        for Part { view, rect, .. } in parts.iter().filter(|part| part.view < 2) {
            let camera = if *view == 0 { &mut calibration.left } else { &mut calibration.right };
            if camera.width == 0 {
                (camera.width, camera.height) = (rect.width as u32, rect.height as u32);
                cx.info(&format!("the calibration states no image size: assuming the size of view {view}"));
            }
            if (camera.width as usize, camera.height as usize) != (rect.width, rect.height) {
                let is_turned = (camera.height as usize, camera.width as usize) == (rect.width, rect.height);
                let help = if is_turned {
                    ": `orientation` selects whether frames are rotated as their metadata says"
                } else {
                    ""
                };
                return Err(NodeError::new(format!(
                    "the calibration was made for views of {}x{}, but view {view} is {}x{}{help}",
                    camera.width, camera.height, rect.width, rect.height
                )));
            }
        }
        Ok(Some(*calibration))
    }

    /// The region that a view shows; `None` while it has no frame.
    fn part(&mut self, view: usize, crops: &[f64]) -> Result<Option<Part>> {
        let views = if self.halves.is_some() { 2 } else { self.views.len() };
        let source = if self.halves.is_some() { 0 } else { view };
        if !self.views.view(source).is_there {
            return Ok(None);
        }
        let picture = &self.views.view(source).picture;
        let mut rect = Rect::whole(picture.width, picture.height);
        if let Some(halves) = self.halves {
            rect = halves.of(rect, view);
        }
        if let Some(crop) = crop::of_view(crops, view, views)? {
            rect = crop::part(rect, crop).map_err(|error| NodeError::new(format!("view {view}: {error}")))?;
        }
        if rect.width == 0 || rect.height == 0 {
            let name = &self.views.view(source).name;
            return Err(NodeError::new(format!("{name}: a frame of {rect:?} is too small to be split")));
        }
        Ok(Some(Part { view, source, rect }))
    }

    /// Sets two outputs to one view; both share one buffer.
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

    /// Sets the output of one view if something reads it.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub(crate) fn write(&mut self, slot: &mut Slot<'_, Bgr8>, source: usize, rect: Rect) -> Result<()> {
        if !slot.is_read() {
            return Ok(());
        }
        let white = self.white;
        let View { picture, .. } = self.views.view(source);
        if self.kept.forward(picture, rect, slot)? {
            return Ok(());
        }
        let mut out = slot.alloc(rect.width, rect.height)?;
        for y in 0..rect.height {
            picture.write_row(rect.x, rect.y + y, white, out.row_mut(y));
        }
        self.kept.keep(picture, rect, slot);
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
        params.check(check);
    }

    fn open(open: &Open<'_>, params: &Settings) -> Result<Self> {
        let calibration = params.read_calibration(open.graph_dir())?;
        if let Some(doubt) = calibration.as_ref().and_then(panoscope_data::calibration::doubt) {
            open.warn(&format!("calibration {}: {doubt}", params.calibration));
        }
        let texts = params.source_texts()?;
        let texts: Vec<String> = texts.into_iter().map(|(_, text)| text.to_owned()).collect();
        let names = texts.iter().map(|text| SourceName::parse(text, open.graph_dir()));
        let mut names = names.collect::<std::result::Result<Vec<_>, _>>()?;
        if let Some([a, b]) = same_files(&names) {
            return Err(NodeError::new(format!(
                "views {a} and {b} read the same files, `{}`: give each view its own folder or pattern, such as left_*.png and right_*.png",
                texts[b]
            )));
        }
        for remark in pair_by_numbers(&mut names, &texts) {
            open.warn(&remark);
        }
        Self::of_sources(open, params, &names, texts, calibration)
    }

    fn process<'f>(&mut self, cx: &Context<'f>, _: NoPorts, mut out: Out<'f>, params: &Settings) -> Result<()> {
        let Some(parts) = self.take(cx, params)? else { return Ok(()) };
        if out.calibration.is_read()
            && let Some(calibration) = self.calibration_for(cx, &parts)?
        {
            out.calibration.set(calibration)?;
        }
        for Part { view, source, rect } in parts {
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
        Some(self.position().to_bytes())
    }

    fn load_state(&mut self, state: &[u8]) -> Result<()> {
        let Some(position) = Position::from_bytes(state) else {
            return Err(NodeError::new("the saved position is malformed"));
        };
        self.resume(&position);
        Ok(())
    }
}
