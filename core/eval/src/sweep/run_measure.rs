//! Measures of a run as stored in files, and the statistic for comparisons of runs.

use serde::{Deserialize, Serialize};

use super::error::PointError;
use super::measure::Summary;

/// A measure of a run. JSON has no NaN: unknown values are null.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunMeasure {
    /// Measure as requested.
    pub name: String,
    /// Mean of the finite values; the following statistics are also of these.
    pub mean: Option<f64>,
    /// Median.
    pub median: Option<f64>,
    /// Minimum.
    pub min: Option<f64>,
    /// Maximum.
    pub max: Option<f64>,
    /// Standard deviation.
    pub deviation: Option<f64>,
    /// The last value.
    pub last: Option<f64>,
    /// Number of finite values.
    pub count: u64,
    /// Number of values that were not finite.
    pub missing: u64,
    /// Failed calls of any node in the run.
    #[serde(default)]
    pub failed_calls: u64,
    /// Reason for the absence of values.
    pub failed: Option<String>,
}

impl RunMeasure {
    pub(super) fn of(name: &str, result: &Result<Summary, PointError>) -> Self {
        let of = |value: fn(&Summary) -> f64| result.as_ref().ok().map(value).filter(|v| v.is_finite());
        Self {
            name: name.to_owned(),
            mean: of(|s| s.mean),
            median: of(|s| s.median),
            min: of(|s| s.min),
            max: of(|s| s.max),
            deviation: of(|s| s.deviation),
            last: of(|s| s.last),
            count: result.as_ref().map_or(0, |s| s.count),
            missing: result.as_ref().map_or(0, |s| s.missing),
            failed_calls: result.as_ref().map_or(0, |s| s.failed_calls),
            failed: result.as_ref().err().map(|why| why.reason.clone()),
        }
    }

    /// Columns of a table: suffix after the measure's name, and value.
    pub fn columns(&self) -> [(&'static str, Option<f64>); 6] {
        [
            ("mean", self.mean),
            ("median", self.median),
            ("min", self.min),
            ("max", self.max),
            ("deviation", self.deviation),
            ("last", self.last),
        ]
    }
}

/// Statistic of a measure for comparisons of runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Statistic {
    /// Mean over the run.
    Mean,
    /// Median.
    Median,
    /// Minimum.
    Min,
    /// Maximum.
    Max,
    /// The last value, for measures that count from the start.
    Last,
}

impl Statistic {
    /// All statistics.
    pub const ALL: [Self; 5] = [Self::Mean, Self::Median, Self::Min, Self::Max, Self::Last];

    /// The statistic with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|statistic| statistic.name() == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Median => "median",
            Self::Min => "min",
            Self::Max => "max",
            Self::Last => "last",
        }
    }

    /// Its value in a measure; `None` if unknown.
    pub fn of(self, measure: &RunMeasure) -> Option<f64> {
        measure.columns().into_iter().find(|(name, _)| *name == self.name()).and_then(|(_, value)| value)
    }
}
