//! Lists of camera speeds on the command line.

use crate::error::Result;

/// Maximum speed of the phantom's camera, cm/s.
pub const MAX_CM_S: f64 = 20.0;
/// Maximum number of steps of a range.
const MAX_STEPS: f64 = 10.0;
/// Maximum number of speeds in a list.
const MAX_SPEEDS: usize = 100;

/// Speeds of a sweep, cm/s, ascending.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedList(pub Vec<f64>);

/// Errors of a list of speeds.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpeedListError {
    /// A part is not a number.
    #[error("`{text}` is not a number; give speeds in cm/s as `1,2.5,10` or a range as `0.5..10` or `0.5..10:0.5`")]
    NoNumber {
        /// The part.
        text: String,
    },
    /// A speed or step outside of the range of the phantom's camera.
    #[error("{speed_cm_s} cm/s is outside 0 to {MAX_CM_S}, the range of the phantom's camera")]
    OutOfRange {
        /// The speed, cm/s.
        speed_cm_s: f64,
    },
    /// The first end of a range is not below the second.
    #[error("the range `{range}` does not ascend; put the lower speed first")]
    NotAscending {
        /// The range.
        range: String,
    },
    /// The step of a range is so small that it has too many speeds.
    #[error("the range `{range}` has more than {MAX_SPEEDS} speeds; give a larger step")]
    StepTooSmall {
        /// The range.
        range: String,
    },
    /// The list has too many speeds.
    #[error("{count} speeds exceed the limit of {MAX_SPEEDS}")]
    TooMany {
        /// Number of speeds.
        count: usize,
    },
}

/// Parses a speed, cm/s.
fn speed(text: &str) -> Result<f64, SpeedListError> {
    let text = text.trim();
    let speed_cm_s: f64 = text.parse().map_err(|_| SpeedListError::NoNumber { text: text.to_owned() })?;
    if (0.0..=MAX_CM_S).contains(&speed_cm_s) { Ok(speed_cm_s) } else { Err(SpeedListError::OutOfRange { speed_cm_s }) }
}

/// A round step that divides a range into at most ten parts.
fn round_step(range: f64) -> f64 {
    let magnitude = 10f64.powf((range / MAX_STEPS).log10().floor());
    let fits = |step: &f64| range / step <= MAX_STEPS + 1e-9;
    [1.0, 2.0, 5.0, 10.0].map(|m| m * magnitude).into_iter().find(fits).unwrap_or(magnitude)
}

/// The speeds of a range: both ends and the multiples of a step between them.
fn range(text: &str, from: &str, rest: &str) -> Result<Vec<f64>, SpeedListError> {
    let (to, step) = match rest.split_once(':') {
        Some((to, step)) => (to, Some(speed(step)?)),
        None => (rest, None),
    };
    let (from, to) = (speed(from)?, speed(to)?);
    if from >= to {
        return Err(SpeedListError::NotAscending { range: text.to_owned() });
    }
    let step = step.unwrap_or_else(|| round_step(to - from));
    if step <= 0.0 || (to - from) / step > MAX_SPEEDS as f64 {
        return Err(SpeedListError::StepTooSmall { range: text.to_owned() });
    }
    let first = (from / step).floor() as i64 + 1;
    let multiples = (first..).map(|k| k as f64 * step).take_while(|v| *v < to - step * 1e-6);
    Ok([from].into_iter().chain(multiples.filter(|v| *v > from + step * 1e-6)).chain([to]).collect())
}

impl std::str::FromStr for SpeedList {
    type Err = SpeedListError;

    fn from_str(text: &str) -> Result<Self, SpeedListError> {
        let mut all = Vec::new();
        for part in text.split(',') {
            match part.split_once("..") {
                Some((from, rest)) => all.extend(range(part, from, rest)?),
                None => all.push(speed(part)?),
            }
        }
        all.sort_by(f64::total_cmp);
        all.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        if all.len() > MAX_SPEEDS {
            return Err(SpeedListError::TooMany { count: all.len() });
        }
        Ok(Self(all))
    }
}

#[cfg(test)]
mod tests {
    use super::SpeedList;

    fn speeds(text: &str) -> Vec<f64> {
        let list: SpeedList = text.parse().unwrap_or_else(|error| panic!("{text}: {error}"));
        list.0
    }

    #[test]
    fn a_range_has_its_ends_and_round_speeds_between() {
        assert_eq!(speeds("0.5..10"), [0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]);
        assert_eq!(speeds("0.5..2:0.5"), [0.5, 1.0, 1.5, 2.0]);
        assert_eq!(speeds("1..1.25:0.1"), [1.0, 1.1, 1.2000000000000002, 1.25]);
        assert_eq!(speeds("0..0.2").len(), 11);
        assert_eq!(speeds("3..4:5"), [3.0, 4.0]);
    }

    #[test]
    fn lists_and_ranges_are_joined_and_put_in_order() {
        assert_eq!(speeds("10, 2.5,0"), [0.0, 2.5, 10.0]);
        assert_eq!(
            speeds("2..4,2.5,3"),
            [
                2.0,
                2.2,
                2.4000000000000004,
                2.5,
                2.6,
                2.8000000000000003,
                3.0,
                3.2,
                3.4000000000000004,
                3.6,
                3.8000000000000003,
                4.0
            ]
        );
    }

    #[test]
    fn what_is_no_speed_is_refused_in_words() {
        for (text, words) in [
            ("", "not a number"),
            ("fast", "`fast` is not a number"),
            ("1,,2", "`` is not a number"),
            ("5..1", "`5..1` does not ascend"),
            ("2..2", "does not ascend"),
            ("-1", "outside 0 to 20"),
            ("1..300", "outside 0 to 20"),
            ("nan", "outside"),
            ("0..10:0", "larger step"),
            ("0..10:0.01", "larger step"),
            ("0..10:-1", "outside"),
            ("1..", "`` is not a number"),
        ] {
            let error = text.parse::<SpeedList>().expect_err(text).to_string();
            assert!(error.contains(words), "{text}: {error}");
        }
    }
}
