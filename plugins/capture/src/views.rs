//! The views of one node: taken together, pictures of one instant.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use panoscope_calibration::views::matched;
use panoscope_node::Context;

use crate::source::{CaptureError, Clock, Demands, Grab, Picture, Source, SourceName};

/// Rates that differ by no more than this share are meant to be one.
const SAME_RATE: f64 = 0.01;
/// Names of files that a message lists.
const LISTED: usize = 6;

/// One source and its newest picture.
pub struct View {
    /// The camera, file or pipeline.
    pub source: Source,
    /// The newest picture.
    pub picture: Picture,
    /// Result of decoding it.
    pub result: Result<(), CaptureError>,
    /// The source's name for messages.
    pub name: String,
    /// The source as the parameters name it.
    pub text: String,
    /// A picture was grabbed that belongs to no tick, because another view ended.
    is_ahead: bool,
}

/// Result of grabbing one picture of every view.
#[derive(Debug, PartialEq, Eq)]
pub enum Grabbed {
    /// All are there.
    Ready,
    /// A view has no more pictures.
    End,
    /// A view has no more pictures although more were promised.
    Failed(String),
    /// A device is gone.
    Lost(String),
}

/// All views of a node. They lie behind locks because they are decoded on several threads at a time.
pub struct Views {
    list: Vec<Mutex<View>>,
    /// Rate of pictures that have no time of their own, and of all when it `is_forced`.
    rate_hz: f64,
    is_forced: bool,
    /// Pictures further apart in time than this do not belong together, s.
    tolerance_s: f64,
    /// Time between two ticks, s.
    period_s: f64,
    /// One rate for all: every picture should have a partner.
    is_one_rate: bool,
    /// Media time at which the present round of a loop began, s.
    pub round_s: f64,
    unpaired: u64,
    skew_ms: f64,
}

/// Up to [`LISTED`] file names.
fn listed(files: &[PathBuf]) -> String {
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut text = files.iter().take(LISTED).map(name).collect::<Vec<_>>().join(", ");
    if files.len() > LISTED {
        text.push_str(&format!(" and {} more", files.len() - LISTED));
    }
    text
}

/// Pairs the pictures of folders and patterns by the numbers in their names; lists of files keep their order. Returns remarks for the user.
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
                if lonely.len() == 1 { "1 picture".to_owned() } else { format!("{} pictures", lonely.len()) },
                texts[index],
                listed(lonely)
            ));
        }
    }
    if !found.by_number && !remarks.is_empty() {
        remarks.push("the names share no numbers: the pictures are paired in the order of their names".to_owned());
    }
    for (index, files) in series.into_iter().zip(found.views) {
        names[index] = SourceName::Images(files);
    }
    remarks
}

impl Views {
    /// Opens all sources; `rate_hz` 0 takes the first rate that a source has, else `default_hz`.
    ///
    /// # Errors
    /// As [`Source::open`].
    pub fn open(
        names: &[SourceName],
        texts: Vec<String>,
        demands: Demands,
        is_repeated: bool,
        (rate_hz, default_hz): (f64, f64),
    ) -> Result<Self, CaptureError> {
        let mut list = Vec::new();
        for (name, text) in names.iter().zip(texts) {
            let source = Source::open(name, demands, is_repeated)?;
            list.push(View {
                source,
                picture: Picture::default(),
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
        Ok(Self {
            list: list.into_iter().map(Mutex::new).collect(),
            rate_hz,
            is_forced,
            tolerance_s: 0.5 / fastest,
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

    /// All views; decoding threads lock one each.
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

    /// Rate of pictures without a time of their own.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Time between the first and the last picture of the tick, ms: of media time where sources have one, else of the clock.
    pub fn skew_ms(&self) -> f64 {
        self.skew_ms
    }

    /// Number of pictures without a partner although all views have one rate.
    pub fn unpaired(&self) -> u64 {
        self.unpaired
    }

    /// A warning where the views' rates differ.
    pub fn rates_in_words(&mut self) -> Option<String> {
        if self.is_one_rate {
            return None;
        }
        let rate_hz = self.rate_hz;
        let rates: Vec<String> = self
            .iter()
            .filter(|view| !view.source.is_still() && !view.source.is_device())
            .map(|view| format!("{} has {:.3} per second", view.name, view.source.native_fps().unwrap_or(rate_hz)))
            .collect();
        Some(format!(
            "the views have different rates ({}): pictures are paired by time, those between are skipped",
            rates.join(", ")
        ))
    }

    /// Whether a source sets the pace by itself.
    pub fn has_device(&mut self) -> bool {
        self.iter().any(|view| view.source.is_device())
    }

    /// Whether nothing but stills is shown, which have no end.
    pub fn are_stills(&mut self) -> bool {
        self.iter().all(|view| view.source.is_still())
    }

    /// Media time of the tick, s: that of the first view that has one.
    pub fn media_s(&mut self) -> Option<f64> {
        let (rate_hz, is_forced, round_s) = (self.rate_hz, self.is_forced, self.round_s);
        self.iter().find_map(|view| view.source.media_s(rate_hz, is_forced)).map(|time| round_s + time)
    }

    /// Grabs one picture of every view, then more of those that are behind the others in time.
    pub fn grab(&mut self, cx: &Context<'_>, clock: Clock<'_>) -> Grabbed {
        let all: Vec<usize> = (0..self.len()).collect();
        self.iter().for_each(|view| view.is_ahead = false);
        let mut times = Vec::with_capacity(self.len());
        match self.grab_some(&all, &mut times, clock) {
            Grabbed::Ready => {}
            other => return other,
        }
        if let (Some(first), Some(last)) = (times.iter().min(), times.iter().max()) {
            self.skew_ms = last.saturating_sub(*first) as f64 * 1e-6;
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
                        "the picture of {name} at {oldest:.3} s has no partner within {:.1} ms in every other view and is skipped",
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
                    times.push(time);
                    view.is_ahead = true;
                    continue;
                }
                Grab::Failed(words) => Grabbed::Failed(words),
                Grab::Lost => Grabbed::Lost(format!("{} is gone after {} frames", view.name, view.source.grabbed())),
                Grab::End => Grabbed::End,
            };
            // A failure matters more than an end.
            if result == Grabbed::Ready || result == Grabbed::End {
                result = next;
            }
        }
        result
    }

    /// A warning about pictures left in some views when another one has ended.
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

    /// Starts all views again, one period after the end.
    ///
    /// # Errors
    /// As [`Source::rewind`].
    pub fn rewind(&mut self, last_s: f64) -> Result<(), CaptureError> {
        self.round_s = last_s + self.period_s;
        self.iter().try_for_each(|view| view.source.rewind())
    }
}
