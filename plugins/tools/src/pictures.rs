//! How unlike a model's training images an image is, from features that the model's network computes anyway.
//!
//! `export_detector.py` gives a detector a second output, `features` (1 x C x rows x columns, means over cells of 32 x 32 px), and writes the mean
//! and a whitening matrix of their image means into the metadata (`training/instruments/pictures.py`), separately for real and rendered training
//! images, which have little in common.

use panoscope_node::{Choice, Context};

use crate::calibration::numbers;
use crate::model::Model;
use crate::session::Tensor;

/// Name of the output.
const OUTPUT: &str = "features";
/// First word of the metadata: name of the format.
const FORMAT: &str = "panoscope-pictures-1";
/// Side of a cell of the output in px of the network's input.
const CELL: usize = 32;
/// Share of the limit below which a warning ends, so that it does not flicker at the limit.
const END_SHARE: f32 = 0.85;
/// Maximum contribution of the first image, as a share of the limit.
const FIRST_MOST: f32 = 0.99;
/// Maximum gap in time that the smoothing bridges, s; after a longer one it restarts.
const MAX_GAP_S: f32 = 5.0;

/// The statistics in a model's metadata cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` in the model's metadata does not fit the model: {reason}; export the model again")]
pub struct PicturesError {
    /// Key of the metadata.
    pub key: String,
    /// What is wrong.
    pub reason: String,
}

/// Separates the output `features` from the other outputs of a network.
pub fn split<'a, 'b>(outputs: &'b [Tensor<'a>]) -> (&'b [Tensor<'a>], Option<&'b Tensor<'a>>) {
    match outputs.split_last() {
        Some((last, rest)) if last.name == OUTPUT && !rest.is_empty() => (rest, Some(last)),
        _ => (outputs, None),
    }
}

/// Statistics of one kind of images.
#[derive(Clone, Debug, PartialEq)]
struct Kind {
    mean: Vec<f32>,
    /// Row by row, with as many rows and columns as `mean` has numbers.
    whitening: Vec<f32>,
    limit: f32,
}

/// Statistics of a model's training images.
#[derive(Clone, Debug, PartialEq)]
pub struct Pictures {
    kinds: Vec<Kind>,
    /// Feature means of the image.
    means: Vec<f32>,
    /// Difference from the mean of a kind.
    off: Vec<f32>,
}

impl Kind {
    /// Parses the numbers under `key`.
    fn read<'a>(
        key: &str,
        text: &str,
        channels: Option<usize>,
        metadata: &impl Fn(&str) -> Option<&'a str>,
    ) -> Result<Self, PicturesError> {
        let wrong = |reason: String| PicturesError { key: key.to_owned(), reason };
        let channels = channels.ok_or_else(|| wrong(format!("the model has no output `{OUTPUT}`")))?;
        let text = text.strip_prefix(FORMAT).ok_or_else(|| wrong(format!("it does not begin with `{FORMAT}`")))?;
        let all = numbers(text).ok_or_else(|| wrong("it contains something that is not a number".to_owned()))?;
        let wanted = channels * (channels + 1);
        if channels == 0 || all.len() != wanted {
            return Err(wrong(format!("it has {} numbers instead of {wanted} for {channels} channels", all.len())));
        }
        let key = format!("{key}_limit");
        let limit = metadata(&key).and_then(|text| text.trim().parse::<f32>().ok());
        let limit = limit.filter(|limit| limit.is_finite() && *limit > 0.0);
        let limit = limit.ok_or_else(|| PicturesError { key, reason: "expected a number above 0".to_owned() })?;
        let (mean, whitening) = all.split_at(channels);
        Ok(Self { mean: mean.to_vec(), whitening: whitening.to_vec(), limit })
    }

    /// Deviation of an image's feature means, as a share of the limit.
    fn unlikeness(&self, means: &[f32], off: &mut [f32]) -> f32 {
        for ((off, value), mean) in off.iter_mut().zip(means).zip(&self.mean) {
            *off = value - mean;
        }
        let along = |row: &[f32]| row.iter().zip(&*off).map(|(w, v)| w * v).sum::<f32>().powi(2);
        let sum: f32 = self.whitening.chunks_exact(self.mean.len()).map(along).sum();
        (sum / self.mean.len() as f32).sqrt() / self.limit
    }
}

impl Pictures {
    /// Reads the statistics of a model whose `features` have `channels` channels (`None`: it has no such output); `None` if it has none.
    ///
    /// # Errors
    /// Numbers are missing, not finite, or do not fit the output.
    pub fn read<'a>(
        channels: Option<usize>,
        metadata: impl Fn(&str) -> Option<&'a str>,
    ) -> Result<Option<Self>, PicturesError> {
        let keys = (1..).map(|number| if number == 1 { "pictures".to_owned() } else { format!("pictures_{number}") });
        let texts = keys.map_while(|key| metadata(&key).map(|text| (key, text)));
        let kinds: Vec<Kind> =
            texts.map(|(key, text)| Kind::read(&key, text, channels, &metadata)).collect::<Result<_, _>>()?;
        let zeros = vec![0.0; channels.unwrap_or(0)];
        Ok((!kinds.is_empty()).then(|| Self { kinds, means: zeros.clone(), off: zeros }))
    }

    /// Deviation of an image from the most similar kind of training images, as a share of the limit: above 1 it is unlike all of them. `size`: width
    /// and height of the image in the network's input, px. `None` if `features` have another form or are not finite.
    pub fn unlikeness(&mut self, features: &Tensor<'_>, size: [usize; 2]) -> Option<f32> {
        let [1, channels, rows, columns] = features.shape[..] else { return None };
        let values = features.data.floats()?;
        if channels != self.means.len() || rows * columns == 0 || values.len() < channels * rows * columns {
            return None;
        }
        let (across, down) = ((size[0] / CELL).clamp(1, columns), (size[1] / CELL).clamp(1, rows));
        let share = 1.0 / (across * down) as f32;
        for (plane, mean) in values.chunks_exact(rows * columns).zip(&mut self.means) {
            let lines = plane.chunks_exact(columns).take(down);
            *mean = lines.map(|line| line[..across].iter().sum::<f32>()).sum::<f32>() * share;
        }
        let each = self.kinds.iter().map(|kind| kind.unlikeness(&self.means, &mut self.off));
        each.filter(|value| value.is_finite()).min_by(f32::total_cmp)
    }
}

/// The smoothed deviation, and whether it is reported.
#[derive(Clone, Copy, Debug, Default)]
pub struct Monitor {
    smoothed: Option<f32>,
    last_ns: i64,
    is_on: bool,
}

impl Monitor {
    /// Adds an image captured at `capture_ns`. Older images weigh `1/e` after `smooth_s`. Returns the smoothed deviation, and whether images are
    /// unlike the training images: from 1 on, until it falls below 0.85.
    pub fn add(&mut self, unlikeness: f32, capture_ns: i64, smooth_s: f32) -> (f32, bool) {
        let passed_s = capture_ns.saturating_sub(self.last_ns) as f32 * 1e-9;
        self.last_ns = capture_ns;
        // The first picture alone says little.
        let first = unlikeness.min(FIRST_MOST);
        let before = self.smoothed.filter(|_| (0.0..=MAX_GAP_S).contains(&passed_s));
        let share = if smooth_s > 0.0 { 1.0 - (-passed_s / smooth_s).exp() } else { 1.0 };
        let smoothed = match before {
            _ if smooth_s <= 0.0 => unlikeness,
            Some(before) => before + share * (unlikeness - before),
            None => first,
        };
        self.smoothed = Some(smoothed);
        self.is_on = smoothed >= if self.is_on { END_SHARE } else { 1.0 };
        (smoothed, self.is_on)
    }
}

/// What happens to the instruments in images that are too unlike the model's training images.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unlike {
    /// They are kept; a warning is logged.
    Keep,
    /// They are dropped, so that nothing follows them.
    Drop,
}

/// Monitors how unlike a model's training images a node's images are.
pub struct Familiarity {
    statistics: Option<Pictures>,
    monitor: Monitor,
    is_unlike: bool,
}

impl Familiarity {
    /// From the metadata of a model whose `features` have `channels` channels (`None`: it has no such output).
    ///
    /// # Errors
    /// See [`Pictures::read`].
    pub fn new(model: &Model, channels: Option<usize>) -> Result<Self, PicturesError> {
        let statistics = Pictures::read(channels, |key| model.metadata(key))?;
        Ok(Self { statistics, monitor: Monitor::default(), is_unlike: false })
    }

    /// See [`Pictures::unlikeness`]; `None` without statistics.
    pub fn unlikeness(&mut self, features: Option<&Tensor<'_>>, size: [usize; 2]) -> Option<f32> {
        self.statistics.as_mut()?.unlikeness(features?, size)
    }

    /// Adds an image's deviation; sets the metrics `unlikeness` and `unlike`, and warns when images become unlike the training images of the model at
    /// `path`. Returns the smoothed deviation.
    pub fn add(&mut self, cx: &Context<'_>, path: &std::path::Path, unlikeness: f32, smooth_s: f32) -> f32 {
        let (smoothed, is_unlike) = self.monitor.add(unlikeness, cx.tick().capture_ns, smooth_s);
        cx.metric("unlikeness", f64::from(smoothed));
        cx.metric("unlike", f64::from(u8::from(is_unlike)));
        if is_unlike && !self.is_unlike {
            cx.warn(&format!(
                "images are unlike the training images of {} ({smoothed:.1} times its limit): it may miss or misname instruments",
                path.display()
            ));
        }
        self.is_unlike = is_unlike;
        smoothed
    }

    /// Whether instruments are dropped now.
    pub fn drops(&self, unlike: Unlike) -> bool {
        self.is_unlike && unlike == Unlike::Drop
    }

    /// Message for a screen; empty while images are familiar.
    pub fn message(&self, unlike: Unlike) -> &'static str {
        match (self.is_unlike, self.drops(unlike)) {
            (false, _) => "",
            (true, false) => "instruments may be missed or misnamed: unfamiliar images",
            (true, true) => "instruments are not followed: unfamiliar images",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::Values;

    fn read(
        channels: Option<usize>,
        text: &'static str,
        limit: &'static str,
    ) -> Result<Option<Pictures>, PicturesError> {
        Pictures::read(channels, |key| match key {
            "pictures" => Some(text),
            "pictures_limit" => Some(limit),
            _ => None,
        })
    }

    #[test]
    fn the_deviation_is_that_of_the_cells_which_the_picture_fills() {
        let mut pictures = read(Some(2), "panoscope-pictures-1 1 2  2 0  0 0.5", "2").expect("fits").expect("is there");
        // Three columns, two rows; the picture fills two columns and one row.
        let values = [3.0, 5.0, 99.0, 99.0, 99.0, 99.0, 4.0, 8.0, 99.0, 99.0, 99.0, 99.0];
        let features = |values| Tensor { name: OUTPUT, shape: vec![1, 2, 2, 3], data: Values::Float(values) };
        // Means 4 and 6, less 1 and 2: 3 and 4, whitened 6 and 2; root of (36 + 4) / 2; half of it is the share of the limit.
        let got = pictures.unlikeness(&features(&values), [70, 40]).expect("a number");
        assert!((got - 20f32.sqrt() / 2.0).abs() < 1e-5, "{got}");
        // Smaller than a cell: the first one.
        assert!(pictures.unlikeness(&features(&values), [9, 9]).is_some());
        assert_eq!(pictures.unlikeness(&features(&[f32::NAN; 12]), [70, 40]), None);
        let other = Tensor { name: OUTPUT, shape: vec![1, 3, 2, 2], data: Values::Float(&values) };
        assert_eq!(pictures.unlikeness(&other, [70, 40]), None);
    }

    #[test]
    fn a_picture_is_judged_by_the_kind_that_it_is_most_like() {
        let second = "panoscope-pictures-1 10 1";
        let of = |more: Option<&'static str>| {
            Pictures::read(Some(1), move |key| match key {
                "pictures" => Some("panoscope-pictures-1 0 1"),
                "pictures_limit" => Some("2"),
                "pictures_2" => more,
                "pictures_2_limit" => Some("1"),
                _ => None,
            })
        };
        let features =
            |value: &'static [f32]| Tensor { name: OUTPUT, shape: vec![1, 1, 1, 1], data: Values::Float(value) };
        let mut one = of(None).expect("fits").expect("is there");
        assert_eq!(one.unlikeness(&features(&[10.5]), [32, 32]), Some(5.25));
        let mut both = of(Some(second)).expect("fits").expect("is there");
        assert_eq!(both.unlikeness(&features(&[10.5]), [32, 32]), Some(0.5));
        assert_eq!(both.unlikeness(&features(&[1.0]), [32, 32]), Some(0.5));
        assert_eq!(both.unlikeness(&features(&[6.0]), [32, 32]), Some(3.0));
        let error = of(Some("panoscope-pictures-1 1")).expect_err("a number is missing").to_string();
        assert!(error.contains("`pictures_2`"), "{error}");
    }

    #[test]
    fn statistics_that_do_not_fit_are_refused_with_their_key() {
        assert_eq!(Pictures::read(Some(2), |_| None), Ok(None));
        for (channels, text, limit, part) in [
            (None, "panoscope-pictures-1 1 1", "1", "no output `features`"),
            (Some(1), "1 1", "1", "panoscope-pictures-1"),
            (Some(1), "panoscope-pictures-1 1 x", "1", "not a number"),
            (Some(2), "panoscope-pictures-1 1 2 3", "1", "3 numbers instead of 6 for 2 channels"),
            (Some(1), "panoscope-pictures-1 1 1", "0", "`pictures_limit`"),
            (Some(1), "panoscope-pictures-1 1 1", "nan", "`pictures_limit`"),
        ] {
            let error = read(channels, text, limit).expect_err(text).to_string();
            assert!(error.contains(part) && error.contains("export"), "{error}");
        }
    }

    #[test]
    fn a_warning_comes_late_and_goes_late() {
        let mut monitor = Monitor::default();
        let at = |tick: i64| tick * 66_000_000;
        // A single odd picture among usual ones says nothing.
        for tick in 0..40 {
            let value = if tick == 20 { 4.0 } else { 0.7 };
            assert!(!monitor.add(value, at(tick), 2.0).1, "tick {tick}");
        }
        let begins = (40..200).find(|tick| monitor.add(1.6, at(*tick), 2.0).1).expect("it begins");
        assert!((45..60).contains(&begins), "after {begins} ticks");
        // Just below the limit it stays.
        assert!((begins + 1..begins + 200).all(|tick| monitor.add(0.95, at(tick), 2.0).1));
        let from = begins + 200;
        let ends = (from..from + 200).find(|tick| !monitor.add(0.5, at(*tick), 2.0).1).expect("it ends");
        assert!(ends > from + 5, "{ends}");
        // After a gap, or when time goes back, it begins anew.
        assert_eq!(monitor.add(0.2, at(ends) + 9_000_000_000, 2.0), (0.2, false));
        assert_eq!(monitor.add(3.0, 0, 2.0), (0.99, false));
        assert!(monitor.add(3.0, 66_000_000, 2.0).1);
    }
}
