//! What the stereo stages refuse, and why.

use std::fmt;

/// Why a stereo stage could not run.
#[derive(Clone, Debug, PartialEq)]
pub enum StereoError {
    /// Two images that must have one size do not.
    SizeMismatch {
        /// What was being compared, for example `right view`.
        what: &'static str,
        /// Columns and rows expected.
        expected: (usize, usize),
        /// Columns and rows found.
        found: (usize, usize),
    },
    /// An image has the wrong number of channels.
    Channels {
        /// The image, as the message names it.
        what: &'static str,
        /// Channels accepted, in words.
        expected: &'static str,
        /// Channels of that image.
        found: usize,
    },
    /// A parameter lies outside its range.
    Parameter {
        /// The parameter, as nodes name it.
        name: &'static str,
        /// Its value, as text.
        value: String,
        /// What is accepted.
        accepted: &'static str,
    },
    /// A file's bytes are not what they should be.
    Format {
        /// The file format.
        format: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A calibration cannot be used.
    Calibration {
        /// What is wrong.
        reason: String,
    },
    /// The device that holds the frames failed. The same call with frames in the host's memory does without it.
    Device {
        /// The device's message.
        reason: String,
    },
}

impl fmt::Display for StereoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SizeMismatch { what, expected, found } => {
                write!(f, "{what} is {}x{}, expected {}x{}", found.0, found.1, expected.0, expected.1)
            }
            Self::Channels { what, expected, found } => write!(f, "{what} has {found} channels, expected {expected}"),
            Self::Parameter { name, value, accepted } => write!(f, "{name} = {value} is refused: accepted {accepted}"),
            Self::Format { format, reason } => write!(f, "not a usable {format} file: {reason}"),
            Self::Calibration { reason } => write!(f, "calibration is refused: {reason}"),
            Self::Device { reason } => f.write_str(reason),
        }
    }
}

impl std::error::Error for StereoError {}

pub(crate) fn check_size(
    what: &'static str,
    expected: (usize, usize),
    found: (usize, usize),
) -> Result<(), StereoError> {
    if expected == found { Ok(()) } else { Err(StereoError::SizeMismatch { what, expected, found }) }
}

pub(crate) fn check_channels(
    what: &'static str,
    accepted: &[usize],
    words: &'static str,
    found: usize,
) -> Result<(), StereoError> {
    if accepted.contains(&found) { Ok(()) } else { Err(StereoError::Channels { what, expected: words, found }) }
}
