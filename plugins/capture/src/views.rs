//! The views of one node, grabbed together: frames of one instant.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use panoscope_data::calibration::views::matched;
use panoscope_media::input::Signal;
use panoscope_node::Context;

use crate::live::Live;
use crate::pairing::Grabbed;
use crate::source::{CaptureError, Clock, Demands, Grab, Picture, Source, SourceName, Stream};

/// Rates that differ by at most this share count as equal.
const SAME_RATE: f64 = 0.01;
/// Frames further apart than this share of the fastest view's period do not belong together.
const TOLERANCE: f64 = 0.5;
/// Assumed rate of live sources that state none, Hz.
const LIVE_FPS: f64 = 30.0;
/// Maximum number of file names that a message lists.
const LISTED: usize = 6;

/// One source and its newest frame.
pub struct View {
    /// The camera, file or pipeline.
    pub source: Source,
    /// The newest frame.
    pub picture: Picture,
    /// Whether the tick has a frame of it.
    pub is_there: bool,
    /// Result of decoding the newest frame.
    pub result: Result<(), CaptureError>,
    /// The source's name for messages.
    pub name: String,
    /// The source as the parameters name it.
    pub text: String,
    /// Whether a frame was grabbed that belongs to no tick, because another view ended.
    is_ahead: bool,
}

/// All views of a node. Each is behind a lock, because images are decoded on several threads.
pub struct Views {
    list: Vec<Mutex<View>>,
    live: Live,
    /// Arrival of the tick's oldest live frame, ns of `CLOCK_MONOTONIC`.
    arrived_ns: Option<i64>,
    /// Rate of frames without a timestamp, or of all frames when it `is_forced`.
    rate_hz: f64,
    is_forced: bool,
    /// Frames further apart than this do not belong together, s.
    tolerance_s: f64,

    /// Time between two ticks, s.
    period_s: f64,
    /// Whether all views have one rate, so that every frame should have a partner.
    is_one_rate: bool,
    /// Media time at which the present round of a loop began, s.
    pub round_s: f64,
    unpaired: u64,
    skew_ms: f64,
}

/// The first [`LISTED`] file names, as text.
fn listed(files: &[PathBuf]) -> String {
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut text = files.iter().take(LISTED).map(name).collect::<Vec<_>>().join(", ");
    if files.len() > LISTED {
        text.push_str(&format!(" and {} more", files.len() - LISTED));
    }
    text
}

/// Two views with the same image files, for example one folder given for both.
pub fn same_files(names: &[SourceName]) -> Option<[usize; 2]> {
    let images = |index: usize| match &names[index] {
        SourceName::Images(files) if files.len() > 1 => Some(files),
        _ => None,
    };
    let pairs = (0..names.len()).flat_map(|a| (0..a).map(move |b| [b, a]));
    pairs.into_iter().find(|[a, b]| images(*a).is_some() && images(*a) == images(*b))
}

/// Pairs the images of folders and patterns by the numbers in their names; lists of files keep their order. Returns remarks for the user.
pub fn pair_by_numbers(names: &mut [SourceName], texts: &[String]) -> Vec<String> {
    let mut remarks = Vec::new();
    let is_pattern = |index: usize| !texts[index].trim().contains('\n');
    let series: Vec<usize> =
        (0..names.len()).filter(|&index| matches!(names[index], SourceName::Images(_)) && is_pattern(index)).collect();
    if series.len() < 2 {
        return remarks;
    }
    let files = |index: usize| match &names[index] {
        SourceName::Images(files) => files.clone(),
        _ => Vec::new(),
    };
    let found = matched(&series.iter().map(|&index| files(index)).collect::<Vec<_>>());
    for (&index, lonely) in series.iter().zip(&found.lonely) {
        if !lonely.is_empty() {
            remarks.push(format!(
                "{} of `{}` without a partner in every other view are skipped: {}",
                if lonely.len() == 1 { "1 image".to_owned() } else { format!("{} images", lonely.len()) },
                texts[index],
                listed(lonely)
            ));
        }
    }
    if !found.by_number && !remarks.is_empty() {
        remarks.push("the names share no numbers: images are paired in the order of their names".to_owned());
    }
    for (index, files) in series.into_iter().zip(found.views) {
        names[index] = SourceName::Images(files);
    }
    remarks
}

impl Views {
    /// Opens all sources. `rate_hz` 0: the first rate that a source has, else `default_hz`. `tolerance_ms` 0: half a period.
    ///
    /// # Errors
    /// As [`Source::open`].
    pub fn open(
        names: &[SourceName],
        texts: Vec<String>,
        demands: Demands,
        is_repeated: bool,
        (rate_hz, default_hz): (f64, f64),
        tolerance_ms: f64,
    ) -> Result<Self, CaptureError> {
        let signal = Arc::new(Signal::default());
        let mut list = Vec::new();
        for (name, text) in names.iter().zip(texts) {
            let source = Source::open(name, demands, is_repeated, &signal)?;
            list.push(View {
                source,
                picture: Picture::default(),
                is_there: false,
                result: Ok(()),
                name: name.in_words(),
                text,
                is_ahead: false,
            });
        }
        let is_forced = rate_hz > 0.0;
        let native = list.iter().find_map(|view| view.source.native_fps());
        let rate_hz = if is_forced { rate_hz } else { native.unwrap_or(default_hz) };
        let timed = list.iter().filter(|view| !view.source.is_still() && !view.source.is_device());
        let rates: Vec<f64> =
            timed.map(|view| if is_forced { rate_hz } else { view.source.native_fps().unwrap_or(rate_hz) }).collect();
        let fastest = rates.iter().copied().reduce(f64::max).unwrap_or(rate_hz);
        let slowest = rates.iter().copied().reduce(f64::min).unwrap_or(rate_hz);
        let is_one_rate = rates.iter().all(|rate| fastest - rate <= SAME_RATE * fastest);
        let live = list.iter().filter(|view| view.source.is_device());
        let live_hz = live.filter_map(|view| view.source.native_fps()).reduce(f64::max).unwrap_or(LIVE_FPS);
        let tolerance_s = |rate_hz: f64| if tolerance_ms > 0.0 { tolerance_ms * 1e-3 } else { TOLERANCE / rate_hz };
        Ok(Self {
            live: Live::new(signal, tolerance_s(live_hz), demands.silence_limit),
            list: list.into_iter().map(Mutex::new).collect(),
            arrived_ns: None,
            rate_hz,
            is_forced,
            tolerance_s: tolerance_s(fastest),
            period_s: 1.0 / slowest,
            is_one_rate,
            round_s: 0.0,
            unpaired: 0,
            skew_ms: 0.0,
        })
    }

    /// Number of sources.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// All views; each decoding thread locks one.
    pub fn locked(&self) -> &[Mutex<View>] {
        &self.list
    }

    /// View `index`, from 0.
    pub fn view(&mut self, index: usize) -> &mut View {
        self.list[index].get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    /// All views in order.
    pub fn iter(&mut self) -> impl Iterator<Item = &mut View> {
        self.list.iter_mut().map(|view| view.get_mut().unwrap_or_else(PoisonError::into_inner))
    }

    /// Numbers of the views whose device or stream is gone.
    pub fn lost(&mut self) -> Vec<usize> {
        let views = self.iter().enumerate();
        views.filter_map(|(index, view)| view.source.stream().filter(|s| !s.is_connected()).map(|_| index)).collect()
    }

    /// Rate of frames without a timestamp, Hz.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Arrival of the tick's oldest frame of a live view, ns of `CLOCK_MONOTONIC`; `None` without such a view.
    pub fn arrived_ns(&self) -> Option<i64> {
        self.arrived_ns
    }

    /// Sums a count over all streams.
    pub fn total(&mut self, count: impl Fn(&Stream) -> u64) -> u64 {
        self.iter().filter_map(|view| view.source.stream().map(&count)).sum()
    }

    /// Unusual properties of the streams' frames, as text.
    pub fn remarks(&mut self) -> Vec<String> {
        self.iter().filter_map(|view| view.source.stream()?.remark()).collect()
    }

    /// Time between the first and the last frame of the tick, ms: media time if the sources have it, else arrival.
    pub fn skew_ms(&self) -> f64 {
        self.skew_ms
    }

    /// Number of frames without a partner although all views have one rate.
    pub fn unpaired(&self) -> u64 {
        self.unpaired + self.live.unpaired
    }

    /// Number of live frames that were dropped because newer ones arrived.
    pub fn dropped(&mut self) -> u64 {
        self.live.superseded + self.total(Stream::dropped)
    }

    /// A warning if the views' rates differ.
    pub fn rates_in_words(&mut self) -> Option<String> {
        if self.is_one_rate {
            return None;
        }
        let rate_hz = self.rate_hz;
        let rates: Vec<String> = self
            .iter()
            .filter(|view| !view.source.is_still() && !view.source.is_device())
            .map(|view| {
                format!("{} has {:.3} frames per second", view.name, view.source.native_fps().unwrap_or(rate_hz))
            })
            .collect();
        Some(format!(
            "the views have different rates ({}): frames are paired by time, and frames in between are skipped",
            rates.join(", ")
        ))
    }

    /// Whether a source sets the pace itself.
    pub fn has_device(&mut self) -> bool {
        self.iter().any(|view| view.source.is_device())
    }

    /// Whether all views are stills, which have no end.
    pub fn are_stills(&mut self) -> bool {
        self.iter().all(|view| view.source.is_still())
    }

    /// Media time of the tick, s: that of the first view that has one.
    pub fn media_s(&mut self) -> Option<f64> {
        let (rate_hz, is_forced, round_s) = (self.rate_hz, self.is_forced, self.round_s);
        self.iter().find_map(|view| view.source.media_s(rate_hz, is_forced)).map(|time| round_s + time)
    }

    /// Takes one frame of every view: the newest live ones that arrived together, and the next ones of the others, then more of those that lag in
    /// media time. Lost or silent live views have none.
    pub fn grab(&mut self, cx: &Context<'_>, clock: Clock<'_>, is_lost: bool) -> Grabbed {
        self.arrived_ns = None;
        let (mut live, mut others) = (Vec::new(), Vec::new());
        for (index, view) in self.list.iter_mut().enumerate() {
            let view = view.get_mut().unwrap_or_else(PoisonError::into_inner);
            (view.is_ahead, view.is_there) = (false, false);
            match view.source.newest_mut() {
                Some(stream) => live.push((stream, &mut view.is_there)),
                None => others.push(index),
            }
        }
        let mut loss = None;
        if !live.is_empty() {
            let (mut streams, is_there): (Vec<_>, Vec<_>) = live.into_iter().unzip();
            let grabbed = self.live.grab(&mut streams, clock, is_lost);
            is_there.into_iter().zip(&self.live.is_taken).for_each(|(is_there, is_taken)| *is_there = *is_taken);
            match grabbed {
                Grabbed::Ready => {}
                Grabbed::Lost(words) if self.live.is_taken.contains(&true) => loss = Some(words),
                other => return other,
            }
            (self.skew_ms, self.arrived_ns) = (self.live.skew_ms, Some(self.live.arrived_ns));
        }
        match self.grab_others(&others, cx, clock) {
            Grabbed::Ready => loss.map_or(Grabbed::Ready, Grabbed::Lost),
            other => other,
        }
    }

    /// Takes the next frames of the views that are not live, and more of those that lag.
    fn grab_others(&mut self, others: &[usize], cx: &Context<'_>, clock: Clock<'_>) -> Grabbed {
        let mut times = Vec::with_capacity(self.len());
        match self.grab_some(others, &mut times, clock) {
            Grabbed::Ready => {}
            other => return other,
        }
        if let (Some(first), Some(last)) = (times.iter().min(), times.iter().max()) {
            self.skew_ms = last.saturating_sub(*first) as f64 * 1e-6;
            self.arrived_ns = Some(self.arrived_ns.map_or(*first, |arrived| arrived.min(*first)));
        }
        let (rate_hz, is_forced, tolerance_s) = (self.rate_hz, self.is_forced, self.tolerance_s);
        loop {
            let timed: Vec<(usize, f64)> = self
                .iter()
                .enumerate()
                .filter_map(|(index, view)| Some((index, view.source.media_s(rate_hz, is_forced)?)))
                .collect();
            let Some(newest) = timed.iter().map(|(_, time)| *time).reduce(f64::max) else { return Grabbed::Ready };
            let oldest = timed.iter().fold(newest, |oldest, (_, time)| oldest.min(*time));
            let behind: Vec<usize> =
                timed.iter().filter(|(_, time)| *time < newest - tolerance_s).map(|(index, _)| *index).collect();
            if behind.is_empty() {
                if timed.len() > 1 {
                    self.skew_ms = (newest - oldest) * 1e3;
                }
                return Grabbed::Ready;
            }
            if self.is_one_rate {
                if self.unpaired == 0 {
                    let name = self.view(behind[0]).name.clone();
                    cx.warn(&format!(
                        "the frame of {name} at {oldest:.3} s has no partner within {:.1} ms in every other view and is skipped",
                        tolerance_s * 1e3
                    ));
                }
                self.unpaired += behind.len() as u64;
            }
            match self.grab_some(&behind, &mut times, clock) {
                Grabbed::Ready => {}
                other => return other,
            }
        }
    }

    fn grab_some(&mut self, which: &[usize], times: &mut Vec<i64>, clock: Clock<'_>) -> Grabbed {
        let mut result = Grabbed::Ready;
        for &index in which {
            let view = self.view(index);
            let next = match view.source.grab(clock) {
                Grab::Ready(time) => {
                    times.extend(time);
                    (view.is_ahead, view.is_there) = (true, true);
                    continue;
                }
                Grab::Failed(words) => Grabbed::Failed(words),
                Grab::Lost(words) => Grabbed::Lost(words),
                Grab::End => Grabbed::End,
            };
            // A failure matters more than an end.
            if result == Grabbed::Ready || result == Grabbed::End {
                result = next;
            }
        }
        result
    }

    /// A warning about frames left in some views when another one has ended.
    pub fn left_over(&mut self) -> Option<String> {
        let more = |view: &View| match view.source.is_still() || view.source.is_device() {
            true => 0,
            false => view.source.left() + u64::from(view.is_ahead),
        };
        let left = self.iter().map(|view| (more(view), view)).filter(|(more, _)| *more > 0);
        let left: Vec<String> = left.map(|(more, view)| format!("{} has {more} more", view.name)).collect();
        let ended = self.iter().find(|view| more(view) == 0 && !view.source.is_still()).map(|view| view.name.clone());
        let ended = ended.filter(|_| !left.is_empty())?;
        Some(format!("{ended} has ended; {}, without a partner", left.join(", ")))
    }

    /// Restarts all views, one period after the end.
    ///
    /// # Errors
    /// As [`Source::rewind`].
    pub fn rewind(&mut self, last_s: f64) -> Result<(), CaptureError> {
        self.round_s = last_s + self.period_s;
        self.iter().try_for_each(|view| view.source.rewind())
    }
}
