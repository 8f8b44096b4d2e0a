//! Numbers on the command line.

use std::ops::RangeInclusive;

/// A text that is not the required number.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NumberError {
    /// It is not a number.
    #[error("{text} is not a {what}")]
    NoNumber {
        /// The given value.
        text: String,
        /// The requirement.
        what: &'static str,
    },
    /// It is outside the range.
    #[error("{range}")]
    OutOfRange {
        /// The range in words.
        range: &'static str,
    },
}

/// Reads a number within a range; `what` and `words` name number and range in errors.
pub fn number_in(
    text: &str,
    range: RangeInclusive<f64>,
    what: &'static str,
    words: &'static str,
) -> Result<f64, NumberError> {
    let number: f64 = text.parse().map_err(|_| NumberError::NoNumber { text: text.to_owned(), what })?;
    if range.contains(&number) { Ok(number) } else { Err(NumberError::OutOfRange { range: words }) }
}

#[cfg(test)]
mod tests {
    use super::number_in;

    #[test]
    fn what_is_no_number_and_what_is_out_of_range_is_refused() {
        let read = |text| number_in(text, 0.0..=f64::MAX, "number", "a number from 0 on");
        assert_eq!(read("0.5"), Ok(0.5));
        assert_eq!(read("half").unwrap_err().to_string(), "half is not a number");
        for text in ["-1", "nan", "inf"] {
            assert_eq!(read(text).unwrap_err().to_string(), "a number from 0 on", "{text}");
        }
    }
}
