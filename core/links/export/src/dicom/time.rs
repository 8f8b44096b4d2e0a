//! Local dates and times in DICOM's format.

use std::time::SystemTime;

use chrono::{DateTime, Local};

/// A moment in local time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Date, such as `20260309`.
    pub date: String,
    /// Time, such as `070500.250`.
    pub time: String,
    /// Offset from UTC, `+0100`.
    pub offset: String,
}

impl Moment {
    /// A moment of the system's clock.
    pub fn of(time: SystemTime) -> Self {
        let local: DateTime<Local> = time.into();
        Self {
            date: local.format("%Y%m%d").to_string(),
            time: local.format("%H%M%S%.3f").to_string(),
            offset: local.format("%z").to_string(),
        }
    }

    /// The current moment.
    pub fn now() -> Self {
        Self::of(SystemTime::now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_have_the_forms_of_da_and_tm() {
        let moment = Moment::of(SystemTime::UNIX_EPOCH + std::time::Duration::from_millis(1_772_323_200_250));
        assert!(moment.date.starts_with("2026") && moment.date.len() == 8, "{moment:?}");
        assert!(moment.time.ends_with("00.250") && moment.time.len() == 10, "{moment:?}");
        assert!(moment.offset.len() == 5, "{moment:?}");
    }
}
