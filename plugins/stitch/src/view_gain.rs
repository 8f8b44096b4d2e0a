//! Area that a panorama shows beyond one view, as a number and as text for a screen.

use std::fmt::Write;

use panoscope_node::abi::Scalar;
use panoscope_node::{Result, Slot, TextPacket};

/// Gain below which the text says that it is small, percent.
const LITTLE_PERCENT: f64 = 5.0;
/// Change of the gain that changes the text, percent.
const SAME_PERCENT: f64 = 0.75;

/// Gain of a panorama over its first view. Its text does not flicker between two numbers.
#[derive(Debug, Default)]
pub struct ViewGain {
    told_percent: Option<f64>,
    words: String,
}

impl ViewGain {
    /// Updates the gain with that of a tick, percent.
    pub fn update(&mut self, percent: f64) {
        if self.told_percent.is_some_and(|told| (percent - told).abs() <= SAME_PERCENT) {
            return;
        }
        let told = percent.round();
        self.told_percent = Some(told);
        self.words.clear();
        let _ = match told {
            ..1.0 => write!(self.words, "no wider than one view"),
            ..LITTLE_PERCENT => write!(self.words, "only {told:+.0} % over one view"),
            _ => write!(self.words, "{told:+.0} % over one view"),
        };
    }

    /// Writes the outputs that are read.
    ///
    /// # Errors
    /// The host has no frame memory left.
    pub fn set(&self, percent: f64, number: &mut Slot<'_, Scalar>, text: &mut Slot<'_, TextPacket>) -> Result<()> {
        if number.is_read() {
            number.set_scalar("gain over one view", percent, "%")?;
        }
        if text.is_read() {
            text.set_text(&self.words)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::ViewGain;

    #[test]
    fn words_are_whole_numbers_that_hold_still() {
        let mut gain = ViewGain::default();
        let mut words = |percent| {
            gain.update(percent);
            gain.words.clone()
        };
        assert_eq!(words(12.4), "+12 % over one view");
        assert_eq!([words(12.6), words(11.4)], ["+12 % over one view", "+12 % over one view"]);
        assert_eq!(words(13.1), "+13 % over one view");
        assert_eq!(words(3.2), "only +3 % over one view");
        assert_eq!(words(-2.0), "no wider than one view");
    }
}
